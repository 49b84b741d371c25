"""Profile likelihood of any parameter: chi-square against its value, minimized over everything else."""

from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np

from fitting.identifiability import threshold_95
from fitting.intervals import Pieces, Profile, pieces_within
from fitting.parameters import displayed
from fitting.problem import INNER_STEPS, Problem
from fitting.result import FitResult, SpectralEstimate

_ERRORS = 4.0
_STEPS = 60


@dataclass(frozen=True, eq=False)
class ProfileLikelihood:
    """Chi-square against one parameter.

    Args:
        name: of the parameter.
        wavelength_nm: of a value of a spectrum, nm; None for a number.
        values: of the parameter, ascending; radians for angles.
        chi_square: minimized over everything else, shape of ``values``.
        best: the best value.
        minimum: chi-square there.
        level: by which the ends of the 95 % interval exceed it.
        interval_95: where chi-square stays below; several pieces if it has several minima.
        closed: whether all ends of it lie within ``values``.
        unit: "rad", "nm" or "1".
    """

    name: str
    wavelength_nm: float | None
    values: np.ndarray
    chi_square: np.ndarray
    best: float
    minimum: float
    level: float
    interval_95: Pieces
    closed: bool
    unit: str

    def displayed(self, number: Any) -> Any:
        """A value, or an array of them, as it is printed: degrees for an angle."""
        return displayed(number, self.unit)

    def plot(self, path: str | PathLike[str]) -> None:
        """Draw it to a picture file.

        Raises:
            OSError: the file cannot be written.
            ValueError: its ending is not .png, .pdf or .svg.
        """
        from fitting.plots import plot_profile

        plot_profile(self, path)


def profile_likelihood(
    result: FitResult, name: str, *, wavelength_nm: float | None = None, points: int = 41
) -> ProfileLikelihood:
    """The profile likelihood of a fitted parameter.

    Args:
        result: of ``fit``.
        name: a key of ``result.estimates``.
        wavelength_nm: for a spectrum that is free at each wavelength: which one, nm.
        points: how many values to begin with; more are added where the interval ends.

    Returns:
        The profile around the best value, as far as four standard errors, or over the whole allowed range if
        there is no standard error.

    Raises:
        ValueError: there is no such parameter, or no such wavelength.
    """
    problem = result.problem
    if points < 5:
        raise ValueError(f"points is {points!r}; expected at least 5")
    if name not in result.estimates:
        raise ValueError(f"{name!r} is not a fitted parameter; expected one of {', '.join(result.estimates)}")
    level = threshold_95(result.degrees_of_freedom, result.uncertainty_estimated)
    if isinstance(result.estimates[name], SpectralEstimate):
        return _of_spectrum(result, problem, name, wavelength_nm, points, level)
    if wavelength_nm is not None:
        raise ValueError(f"{name!r} is one number; expected no wavelength")
    slot = result.numbers.index(name)
    parameter, estimate = problem.numbers[slot], result.estimates[name]
    profile = Profile(problem, slot, result.found.table, result.found.minima)
    low, high = _reach(estimate, (float(parameter.lower), float(parameter.upper)))
    # From the best value outwards: each point starts where its neighbor ended.
    for side in (
        np.linspace(estimate.value, high, points // 2 + 1),
        np.linspace(estimate.value, low, points // 2 + 1),
    ):
        for value in side[1:]:
            profile.cost(np.array([value]))
    pieces, closed = profile.region(result.chi_square, level)
    return ProfileLikelihood(
        name,
        None,
        profile.values,
        profile.points.chi_square,
        estimate.value,
        result.chi_square,
        level,
        pieces,
        closed,
        parameter.unit,
    )


def _reach(estimate: Any, bounds: tuple[float, float]) -> tuple[float, float]:
    """How far to go: four standard errors, or the whole range."""
    error = estimate.standard_error
    low, high = estimate.interval_95[0][0], estimate.interval_95[-1][1]
    reach = _ERRORS * error if np.isfinite(error) else np.inf
    low = min(estimate.value - reach, low - 0.3 * (estimate.value - low))
    high = max(estimate.value + reach, high + 0.3 * (high - estimate.value))
    low, high = max(low, bounds[0]), min(high, bounds[1])
    if not (np.isfinite(low) and np.isfinite(high)):
        raise ValueError("the parameter is not determined and has no finite range; expected a prior or bounds")
    return float(low), float(high)


def _of_spectrum(
    result: FitResult, problem: Problem, name: str, wavelength_nm: float | None, points: int, level: float
) -> ProfileLikelihood:
    estimate = result.estimates[name]
    if name not in problem.free_names:
        raise ValueError(
            f"{name!r} follows from coefficients; expected the name of one of these, or a free spectrum"
        )
    if wavelength_nm is None or not np.isclose(estimate.wavelengths_nm, wavelength_nm).any():
        raise ValueError(
            f"wavelength_nm is {wavelength_nm!r}; expected one of the {len(estimate.wavelengths_nm)} wavelengths "
            f"of {name!r}, {estimate.wavelengths_nm[0]:g} to {estimate.wavelengths_nm[-1]:g} nm"
        )
    place = int(np.argmin(np.abs(estimate.wavelengths_nm - wavelength_nm)))
    row = problem.free_names.index(name)
    bounds = np.asarray(problem.data.spectral_bounds, np.float64)[:, row]
    best, error = float(estimate.value[place]), float(estimate.standard_error[place])
    low, high = bounds
    if np.isfinite(best) and np.isfinite(error):
        low, high = max(best - _ERRORS * error, low), min(best + _ERRORS * error, high)
    values = np.linspace(low, high, points)
    values = np.unique(np.append(values, best)) if np.isfinite(best) else values
    start = result.found.minima.take([0])
    spectra = np.repeat(start.spectra, len(values), axis=0)
    spectra[:, row, place] = values
    movable = np.ones(spectra.shape, dtype=bool)
    movable[:, row, place] = False
    ends = problem.descend(
        np.repeat(start.values, len(values), axis=0),
        spectra,
        spectra_movable=movable,
        inner=INNER_STEPS,
        outer=_STEPS,
    )
    pieces, closed = pieces_within(values, ends.chi_square - result.chi_square, level)
    return ProfileLikelihood(
        name, float(wavelength_nm), values, ends.chi_square, best, result.chi_square, level, pieces, closed, "1"
    )
