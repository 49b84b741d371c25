"""Whether residuals look like noise along the wavelength: a runs test of their signs, and their autocorrelation.

Both look for residuals that are too much alike at neighboring wavelengths; a fit makes those of pure noise a little
too different, which costs power but raises no false alarm.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import ndtr  # type: ignore[import-untyped]

if TYPE_CHECKING:
    from fitting.problem import Problem
    from fitting.result import FitResult

ALARM = 1e-3
"""Probability below which residuals are called structured."""

_ROUNDING = 1e-5
"""Misfits of this size come from the rounding of a file; fraction."""

_FEWEST = 4
"""Wavelengths below which the order of signs says nothing."""


@dataclass(frozen=True)
class Runs:
    """Wald-Wolfowitz runs test of the signs of residuals.

    Args:
        count: runs of one sign along the wavelength, summed over directions.
        expected: their mean if the wavelengths are in random order.
        standard_deviation: likewise; 0 if it cannot differ.
        probability: of as few runs, or fewer.
    """

    count: int
    expected: float
    standard_deviation: float
    probability: float


@dataclass(frozen=True)
class Autocorrelation:
    """Correlation of standardized residuals at neighboring wavelengths.

    Args:
        value: the sum of products of neighbors over that of squares; 0 expected, 1 at most.
        statistic: the sum of products in its standard deviations.
        probability: of as large a statistic, or a larger one.
    """

    value: float
    statistic: float
    probability: float


@dataclass(frozen=True)
class Structure:
    """What the order of residuals along the wavelength says.

    Args:
        runs: of their signs.
        autocorrelation: of their values.
        probability: that independent noise of symmetric distribution looks as structured: twice the smaller one
            of the two, because there are two tests, times the count of wavelength grids.
    """

    runs: Runs
    autocorrelation: Autocorrelation
    probability: float

    @property
    def structured(self) -> bool:
        """Whether noise looks like that less than once in a thousand fits."""
        return self.probability < ALARM

    def sentence(self) -> str:
        """The statistics and what they may mean."""
        runs = self.runs
        return (
            "the residuals are structured, because neighboring wavelengths go together (lag-1 autocorrelation "
            f"{self.autocorrelation.value:.2g}; {runs.count} runs of one sign where {runs.expected:.3g} ± "
            f"{runs.standard_deviation:.2g} are expected; probability {self.probability:.1g} for independent "
            "noise): the model is wrong, or the noise is correlated between wavelengths, so that intervals are too "
            "short"
        )


def runs_test(residuals: Float[np.ndarray, "d l"], used: int = 0) -> Runs:
    """Wald-Wolfowitz runs test of signs along the wavelength, in each direction, summed over directions.

    For one direction with N₊ positive and N₋ negative residuals, N together, the expected count of runs is
    1 + 2 N₊ N₋ / N and the variance 2 N₊ N₋ (2 N₊ N₋ - N) / (N² (N - 1)). Residuals of several directions may be
    dependent at one wavelength (a spectrum that is free there makes them so), hence all directions are put in
    random order together: the mean and variance are those of Σ A(πᵢ, πᵢ₊₁) over permutations π, where A(i, j) is the
    count of directions whose residuals at wavelengths i and j have equal signs less that of different ones. The
    probability is that of a normal distribution, with half a run of correction for continuity.

    Args:
        residuals: in any unit, at wavelengths in order, shape (D, L). NaN is missing and ends a run; exact zeros
            likewise.
        used: how many spectra are free at each wavelength. If any is, directions depend on each other, and differently
            at distant wavelengths: the variance is then at least that of the sum of independent A(i, i + 1).

    References:
        [Wald1940]; [Mantel1967] for the moments over permutations.
    """
    signs = np.sign(np.where(np.isfinite(residuals), residuals, 0.0))
    signs = signs[:, np.any(signs != 0, axis=0)]
    size = signs.shape[1]
    alike = signs.T @ signs
    # Each value opens a run unless the one before it is there and has the same sign.
    present = np.abs(signs)
    total, pairs = float(np.trace(alike, 1)), float(np.sum(present[:, 1:] * present[:, :-1]))
    count = int(np.sum(present) - pairs + (pairs - total) / 2)
    if size < _FEWEST:
        return Runs(count, float(count), 0.0, 1.0)
    mean, variance = _moments(alike)
    if used:
        variance = max(variance, float(np.sum((np.diag(alike, 1) - mean / (size - 1)) ** 2)))
    # A change of order by which one run is gained costs two in the sum.
    expected, deviation = count + (total - mean) / 2, np.sqrt(max(variance, 0.0)) / 2
    if deviation < 1e-9:
        return Runs(count, expected, 0.0, 1.0)
    return Runs(count, expected, float(deviation), float(ndtr((count + 0.5 - expected) / deviation)))


def _moments(alike: Float[np.ndarray, "l l"]) -> tuple[float, float]:
    """Mean and variance of the sum of a symmetric matrix's entries along a random path through all its rows."""
    size = len(alike)
    off = alike - np.diag(np.diag(alike))
    whole, rows, squares = np.sum(off), np.sum(np.sum(off, axis=1) ** 2), np.sum(off**2)
    ordered = size * (size - 1.0)
    touching = (rows - squares) / (ordered * (size - 2))
    apart = (whole**2 - 4 * rows + 2 * squares) / (ordered * (size - 2) * (size - 3))
    steps = size - 1.0
    mean = steps * whole / ordered
    second = steps * squares / ordered + 2 * (size - 2) * touching
    second += (steps**2 - steps - 2 * (size - 2)) * apart
    return float(mean), float(second - mean**2)


def autocorrelation_test(residuals: Float[np.ndarray, "d l"], used: int = 0) -> Autocorrelation:
    """Lag-1 autocorrelation of residuals along the wavelength, over all directions.

    The sum of the products p of neighbors is compared with √Σ (D / (D - Q)) p²: for noise of any symmetric
    distribution and any size at each wavelength, the signs of the products are tossed coins, and the ratio is close
    to standard normal, with the tails of a normal distribution at most. The factor D / (D - Q) bounds what the Q
    spectra that are free at each wavelength add by making D directions dependent.

    Args:
        residuals: standardized, at wavelengths in order, shape (D, L). NaN is missing: its neighbors are neighbors
            of nothing.
        used: how many spectra are free at each wavelength, Q. Wavelengths with no more than Q directions say
            nothing.
    """
    products = residuals[:, 1:] * residuals[:, :-1]
    present = np.isfinite(products)
    products = np.where(present, products, 0.0)
    counts = present.sum(axis=0)
    kept = counts > used
    spread = np.where(kept, counts / np.where(kept, counts - used, 1), 0.0) * np.sum(products**2, axis=0)
    total, scale = float(np.sum(products[:, kept])), float(np.sqrt(np.sum(spread)))
    power = np.nansum(residuals**2)
    if scale == 0:
        return Autocorrelation(0.0, 0.0, 1.0)
    return Autocorrelation(total / float(power), total / scale, float(ndtr(-total / scale)))


def structure_of(residuals: Sequence[Float[np.ndarray, "_ l"]], used: Sequence[int] | int = 0) -> Structure | None:
    """Both tests together.

    Args:
        residuals: standardized, NaN where missing, shape (D, L) for each wavelength grid.
        used: spectra that are free at each wavelength, for each grid or all of them.

    Returns:
        The grid that looks most structured; None if there is nothing to test.
    """
    counts = [used] * len(residuals) if isinstance(used, int) else list(used)
    found = []
    for one, spectra in zip(residuals, counts, strict=True):
        enough = np.isfinite(one).sum(axis=0) > spectra
        known = np.where(enough, one, np.nan)
        if enough.sum() < _FEWEST:
            continue
        runs, correlation = runs_test(known, spectra), autocorrelation_test(known, spectra)
        found.append(Structure(runs, correlation, 2 * min(runs.probability, correlation.probability)))
    if not found:
        return None
    worst = min(found, key=lambda one: one.probability)
    return Structure(worst.runs, worst.autocorrelation, min(1.0, worst.probability * len(found)))


def structure_in(
    problem: "Problem", misfits: Sequence[np.ndarray], bound: Bool[np.ndarray, " u"] | None = None
) -> Structure | None:
    """Both tests for the residuals of a fit.

    Measurements with the same wavelengths count as further directions, those with others as further grids. Where a
    free spectrum lies on a bound, its residuals have one sign by necessity and are left out.

    Args:
        problem: what was fitted.
        misfits: measured less predicted, NaN where missing, shape (D, L) for each measurement.
        bound: at which of all wavelengths a free spectrum lies on a bound, shape (U,).

    Returns:
        None if there is nothing to test: fewer than four wavelengths with a residual to spare, or misfits that are
        those of rounding, or too small to move any estimate by its standard error (chi-square below 1).
    """
    every = np.concatenate([m[np.isfinite(m)] for m in misfits])
    if not every.size or np.mean(every**2) < _ROUNDING**2:
        return None
    rows: dict[bytes, list[np.ndarray]] = {}
    slots: dict[bytes, set[int]] = {}
    chi_square = 0.0
    for part, misfit, measurement in zip(problem.layout.parts, misfits, problem.measurements, strict=True):
        assert measurement.standard_uncertainty is not None
        standardized = misfit / measurement.standard_uncertainty
        chi_square += float(np.nansum(standardized**2))
        if bound is not None:
            standardized = np.where(bound[part.places], np.nan, standardized)
        grid = part.wavelengths_nm.tobytes()
        rows.setdefault(grid, []).append(standardized)
        taken = {row for slot in part.spectral if slot.source is None for row in slot.rows}
        slots[grid] = slots.get(grid, set()) | taken
    if chi_square < 1:
        return None
    return structure_of([np.concatenate(some) for some in rows.values()], [len(some) for some in slots.values()])


def residual_structure(result: "FitResult") -> Structure | None:
    """Whether the residuals of a fit look like noise along the wavelength.

    Args:
        result: of ``fit``.

    Returns:
        Both tests, see ``runs_test`` and ``autocorrelation_test``; None if there is nothing to test.
    """
    return structure_in(result.problem, result.misfits, on_bound(result.problem, result.estimates))


def on_bound(problem: "Problem", estimates: Any) -> Bool[np.ndarray, " u"] | None:
    """At which of all wavelengths a free spectrum lies on a bound; None if no spectrum is free."""
    spectra = [estimates[name].at_bound for name in problem.free_names]
    return np.any(spectra, axis=0) if spectra else None
