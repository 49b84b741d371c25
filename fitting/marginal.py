"""What draws say of one number or spectrum: median, spread, intervals, and how far chains agree."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.stats import norm, rankdata  # type: ignore[import-untyped]

from fitting.parameters import displayed

_SHARES = [0.025, 0.15865525, 0.5, 0.84134475, 0.975]


@dataclass(frozen=True)
class Marginal:
    """One number's posterior, in Python units: radians for angles.

    Args:
        median: of the draws.
        mean: of the draws.
        standard_deviation: of the draws.
        interval_68: equal-tailed.
        interval_95: equal-tailed.
        r_hat: rank-normalized split R-hat; near 1 where chains agree. NaN for a single chain.
        effective_samples: how many independent draws the draws are worth.
        autocorrelation_time: of the ensemble, steps; NaN for independent draws.
        unit: "rad", "nm" or "1".
    """

    median: float
    mean: float
    standard_deviation: float
    interval_68: tuple[float, float]
    interval_95: tuple[float, float]
    r_hat: float
    effective_samples: float
    autocorrelation_time: float
    unit: str = "1"

    def displayed(self, number: Any) -> Any:
        """A number, or an array of them, as it is printed: degrees for an angle."""
        return displayed(number, self.unit)


@dataclass(frozen=True, eq=False)
class SpectralMarginal:
    """A free spectrum's posterior at each wavelength, shape (L,) throughout.

    Args:
        wavelengths_nm: nm.
        median: of the draws.
        mean: of the draws.
        standard_deviation: of the draws.
        interval_68: equal-tailed, lower and upper ends.
        interval_95: likewise.
    """

    wavelengths_nm: np.ndarray
    median: np.ndarray
    mean: np.ndarray
    standard_deviation: np.ndarray
    interval_68: tuple[np.ndarray, np.ndarray]
    interval_95: tuple[np.ndarray, np.ndarray]


def marginal(values: np.ndarray, effective: float, time: float, unit: str) -> Marginal:
    """Of the draws of all chains."""
    whole = values.reshape(-1)
    ends = np.quantile(whole, _SHARES)
    return Marginal(
        float(ends[2]),
        float(np.mean(whole)),
        float(np.std(whole)),
        (float(ends[1]), float(ends[3])),
        (float(ends[0]), float(ends[4])),
        r_hat(values),
        effective,
        time,
        unit,
    )


def of_spectra(spectra: dict[str, np.ndarray], wavelengths_nm: np.ndarray) -> dict[str, SpectralMarginal]:
    """Of the draws of all chains, shape (chains, draws, L) each."""
    found = {}
    for name, values in spectra.items():
        whole = values.reshape(-1, values.shape[-1])
        ends = np.quantile(whole, _SHARES, axis=0)
        spread = np.std(whole, axis=0)
        sides = (ends[1], ends[3]), (ends[0], ends[4])
        found[name] = SpectralMarginal(wavelengths_nm, ends[2], np.mean(whole, axis=0), spread, *sides)
    return found


def r_hat(chains: Float[np.ndarray, "chains draws"]) -> float:
    """Rank-normalized split R-hat of several chains; NaN for a single one.

    References:
        [Vehtari2021, eq. 4 and section 4.1]
    """
    count, draws = chains.shape
    if count < 2 or draws < 4:
        return math.nan
    half = draws // 2
    split = np.concatenate([chains[:, :half], chains[:, -half:]])
    found = []
    for values in (split, np.abs(split - np.median(split))):
        ranks = rankdata(values).reshape(values.shape)
        z = norm.ppf((ranks - 0.375) / (ranks.size + 0.25))
        within = float(np.mean(np.var(z, axis=1, ddof=1)))
        between = float(half * np.var(np.mean(z, axis=1), ddof=1))
        found.append(math.sqrt(((half - 1) / half * within + between / half) / within) if within > 0 else math.nan)
    return max(found)
