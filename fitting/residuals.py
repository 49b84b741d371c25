"""Whether residuals look like noise along the wavelength.

If the noise is independent and symmetric, the products of the residuals at neighboring wavelengths have the
signs of tossed coins, whatever their sizes: their sum over the root of the sum of their squares is close to
standard normal and its tails are no heavier. The same holds of the residuals' signs alone, which is a runs test
that outliers do not disturb. A fit makes the residuals of pure noise a little too different, which costs power
and raises no false alarm.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr  # type: ignore[import-untyped]

if TYPE_CHECKING:
    from fitting.problem import Problem
    from fitting.result import FitResult

ALARM = 1e-3
"""Probability below which residuals are called structured."""

_ROUNDING = 1e-5
"""Misfits of this size come from the rounding of a file; fraction."""


@dataclass(frozen=True)
class Structure:
    """What the order of residuals along the wavelength says.

    Args:
        autocorrelation: of neighboring residuals, the sum of products over that of squares; 0 expected.
        alike: pairs of neighbors with the same sign.
        pairs: of neighbors; half of them are expected to be alike.
        probability: that independent noise of symmetric distribution looks as structured: twice the smaller one
            of the two tests'.
    """

    autocorrelation: float
    alike: int
    pairs: int
    probability: float

    @property
    def structured(self) -> bool:
        """Whether noise looks like that less than once in a thousand fits."""
        return self.probability < ALARM

    def sentence(self) -> str:
        """The statistics and what they may mean."""
        return (
            "the residuals are structured, because neighboring wavelengths go together (autocorrelation "
            f"{self.autocorrelation:.2g}, {self.alike} of {self.pairs} pairs have the same sign; probability "
            f"{self.probability:.1g} for independent noise): the model is wrong, or the noise is correlated "
            "between wavelengths and standard errors are too small"
        )


def structure_of(residuals: Sequence[Float[np.ndarray, "_ _"]], together: bool = False) -> Structure | None:
    """Both tests.

    Args:
        residuals: standardized, NaN where missing, shape (D, L) for each wavelength grid.
        together: the directions of a wavelength depend on each other, as where a spectrum is free there: their
            products are added before they count as one coin.

    Returns:
        None if no neighbors are there.
    """
    products = [_neighbors(one) for one in residuals]
    signs = [_neighbors(np.sign(one)) for one in residuals]
    pairs = int(sum(np.sum(s != 0) for s in signs))
    if not pairs:
        return None
    smallest = min(_probability(products, together), _probability(signs, together))
    power = sum(float(np.nansum(one**2)) for one in residuals)
    return Structure(
        autocorrelation=sum(float(np.sum(p)) for p in products) / power,
        alike=int(sum(np.sum(s > 0) for s in signs)),
        pairs=pairs,
        probability=min(1.0, 2 * smallest),
    )


def _neighbors(values: Float[np.ndarray, "d l"]) -> Float[np.ndarray, "d l-1"]:
    """Products of neighbors; 0 where one is missing."""
    return np.nan_to_num(values[:, 1:] * values[:, :-1], nan=0.0)


def _probability(products: Sequence[np.ndarray], together: bool) -> float:
    """Of so large a sum of products with random signs, or a larger one."""
    coins = np.concatenate([np.sum(p, axis=0) if together else p.ravel() for p in products])
    scale = float(np.sqrt(np.sum(coins**2)))
    return float(ndtr(-np.sum(coins) / scale)) if scale > 0 else 1.0


def structure_in(
    problem: "Problem", misfits: Sequence[np.ndarray], estimates: Mapping[str, Any]
) -> Structure | None:
    """Both tests for the residuals of a fit.

    Wavelengths say nothing where a free spectrum leaves no residual to spare, or lies on a bound, so that
    residuals have one sign by necessity.

    Args:
        problem: what was fitted.
        misfits: measured less predicted, NaN where missing, shape (D, L) for each measurement.
        estimates: by name.

    Returns:
        None if there is nothing to test: no degree of freedom, no neighbors, or misfits that are those of rounding
        or too small to move any estimate by its standard error (chi-square below 1).
    """
    every = np.concatenate([m[np.isfinite(m)] for m in misfits])
    if problem.degrees_of_freedom == 0 or not every.size or np.mean(every**2) < _ROUNDING**2:
        return None
    grids: dict[bytes, list[np.ndarray]] = {}
    places: dict[bytes, np.ndarray] = {}
    free_rows: dict[bytes, set[int]] = {}
    for part, misfit, measurement in zip(problem.layout.parts, misfits, problem.measurements, strict=True):
        assert measurement.standard_uncertainty is not None
        grid = part.wavelengths_nm.tobytes()
        grids.setdefault(grid, []).append(misfit / measurement.standard_uncertainty)
        places[grid] = part.places
        taken = {row for slot in part.spectral if slot.source is None for row in slot.rows}
        free_rows[grid] = free_rows.get(grid, set()) | taken
    spectra = [estimates[name].at_bound for name in problem.free_names]
    rows = []
    for grid, parts in grids.items():
        standardized = np.concatenate(parts)
        silent = np.isfinite(standardized).sum(axis=0) <= len(free_rows[grid])
        if spectra:
            silent |= np.any(spectra, axis=0)[places[grid]]
        rows.append(np.where(silent, np.nan, standardized))
    if sum(float(np.nansum(one**2)) for one in rows) < 1:
        return None
    return structure_of(rows, together=bool(spectra))


def residual_structure(result: "FitResult") -> Structure | None:
    """Whether the residuals of a fit look like noise along the wavelength.

    Args:
        result: of ``fit``.

    Returns:
        The tests, which every fit makes for its warnings; None if there is nothing to test.
    """
    return structure_in(result.problem, result.misfits, result.estimates)
