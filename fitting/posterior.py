"""A sampled posterior: draws by name, what they say, and how far they can be trusted."""

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from os import PathLike
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.stats import norm, rankdata  # type: ignore[import-untyped]

from fitting import files
from fitting.density import Density
from fitting.parameters import displayed
from fitting.result import FitResult

_AT_KINK = (
    "{} lies at a kink of the model: with the truth exactly there, equal-tailed intervals of a flat prior cover "
    "less than they say (76 to 89 % for 95 %); the profile likelihood's interval holds"
)


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
class Posterior:
    """Draws from the posterior of a fit.

    Args:
        method: "nested", "emcee" or "importance".
        chains: draws of each number by name, shape (chains, draws), in Python units (radians); those of an
            ensemble without burn-in.
        spectra: likewise of each free spectrum, shape (chains, draws, L).
        wavelengths_nm: of the spectra, shape (L,).
        log_density: of the posterior at each draw, up to a constant, shape (chains, draws).
        estimates: by name, for the numbers.
        acceptance: share of accepted proposals of an ensemble, None otherwise.
        log_evidence: logarithm of the likelihood averaged over the priors, None if a prior has no finite volume
            or the method does not tell.
        warnings: each one sentence.
        converged: whether the draws can be used.
        message: why, or what is missing.
        result: the fit.
    """

    method: str
    chains: dict[str, np.ndarray]
    spectra: dict[str, np.ndarray]
    wavelengths_nm: np.ndarray
    log_density: np.ndarray
    estimates: dict[str, Marginal]
    acceptance: float | None
    log_evidence: float | None
    warnings: tuple[str, ...]
    converged: bool
    message: str
    result: FitResult = field(repr=False)
    density: Density = field(repr=False)

    @property
    def samples(self) -> dict[str, np.ndarray]:
        """All draws by name, shape (draws,) each, (draws, L) for spectra; radians for angles."""
        whole = {name: values.reshape(-1) for name, values in self.chains.items()}
        return whole | {name: s.reshape(-1, s.shape[-1]) for name, s in self.spectra.items()}

    def summary(self) -> str:
        """A table to read."""
        rows: list[tuple[str, ...]] = [
            ("parameter", "median", "std. deviation", "95 % interval", "effective samples")
        ]
        for name, one in self.estimates.items():
            scale = float(one.displayed(one.standard_deviation))
            digits = int(np.clip(1 - math.floor(math.log10(scale)), 0, 8)) if scale > 0 else 4
            unit = {"rad": " deg", "nm": " nm"}.get(one.unit, "")
            low, high = (one.displayed(end) for end in one.interval_95)
            rows.append(
                (
                    name,
                    f"{one.displayed(one.median):.{digits}f}{unit}",
                    f"{scale:.{digits}f}",
                    f"{low:.{digits}f} to {high:.{digits}f}",
                    f"{one.effective_samples:.0f}",
                )
            )
        widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
        lines = [
            "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
        ]
        lines += ["", f"{self.method}: {self.message}"]
        return "\n".join(lines + [f"warning: {warning}" for warning in self.warnings])

    def to_dict(self) -> dict[str, Any]:
        """What `fit.json` says of it: plain numbers, angles in degrees, None for what does not exist."""

        def plain(value: float) -> float | None:
            return float(value) if math.isfinite(value) else None

        return {
            "method": self.method,
            "converged": self.converged,
            "message": self.message,
            "warnings": list(self.warnings),
            "draws": int(self.log_density.size),
            "acceptance": self.acceptance,
            "log_evidence": self.log_evidence,
            "parameters": {
                name: {
                    "unit": "deg" if one.unit == "rad" else one.unit,
                    "median": float(one.displayed(one.median)),
                    "mean": float(one.displayed(one.mean)),
                    "standard_deviation": float(one.displayed(one.standard_deviation)),
                    "interval_68": [float(one.displayed(end)) for end in one.interval_68],
                    "interval_95": [float(one.displayed(end)) for end in one.interval_95],
                    "r_hat": plain(one.r_hat),
                    "effective_samples": plain(one.effective_samples),
                    "autocorrelation_time": plain(one.autocorrelation_time),
                }
                for name, one in self.estimates.items()
            },
        }

    def to_csv(self, path: str | PathLike[str]) -> None:
        """Write all draws, one per line; angles in degrees, in columns named so.

        Raises:
            OSError: the file cannot be written.
        """
        chains, draws = self.log_density.shape
        columns = {
            "chain": np.repeat(np.arange(chains), draws).astype(float),
            "draw": np.tile(np.arange(draws), chains).astype(float),
        }
        for name, values in self.chains.items():
            unit = self.estimates[name].unit
            columns[_column(name, unit)] = np.asarray(displayed(values, unit)).reshape(-1)
        for name, whole in self.spectra.items():
            for k, nm in enumerate(self.wavelengths_nm):
                columns[f"{name}_{nm:g}nm"] = whole[..., k].reshape(-1)
        columns["log_density"] = self.log_density.reshape(-1)
        lines = [",".join(columns)]
        lines += [",".join(files.number(v) for v in row) for row in zip(*columns.values(), strict=True)]
        files.write(path, "\n".join(lines) + "\n")

    def to_netcdf(self, path: str | PathLike[str]) -> None:
        """Write all draws as NetCDF 3, with dimensions chain, draw and wavelength_nm; angles in degrees.

        Raises:
            OSError: the file cannot be written.
        """
        from scipy.io import netcdf_file  # type: ignore[import-untyped]

        contents = io.BytesIO()
        file = netcdf_file(contents, "w", version=2)
        for name, size in zip(("chain", "draw"), self.log_density.shape, strict=True):
            file.createDimension(name, size)
        if self.spectra:
            file.createDimension("wavelength_nm", len(self.wavelengths_nm))
            file.createVariable("wavelength_nm", "d", ("wavelength_nm",))[:] = self.wavelengths_nm
        for name, values in self.chains.items():
            unit = self.estimates[name].unit
            variable = file.createVariable(_column(name, unit), "d", ("chain", "draw"))
            variable[:] = displayed(values, unit)
            variable.units = {"rad": "degree", "nm": "nm"}.get(unit, "1")
        for name, whole in self.spectra.items():
            file.createVariable(_column(name, "1"), "d", ("chain", "draw", "wavelength_nm"))[:] = whole
        file.createVariable("log_density", "d", ("chain", "draw"))[:] = self.log_density
        file.method = self.method
        file.flush()
        files.write(path, contents.getvalue())

    def corner(self, path: str | PathLike[str]) -> None:
        """Draw the marginal and pairwise distributions of the numbers to a picture file.

        Raises:
            OSError: the file cannot be written.
            ValueError: its ending is not .png, .pdf or .svg.
        """
        from fitting.posterior_plots import plot_corner

        plot_corner(self, path)

    def trace(self, path: str | PathLike[str]) -> None:
        """Draw the draws in their order, see ``corner``."""
        from fitting.posterior_plots import plot_trace

        plot_trace(self, path)

    def predictive(self, path: str | PathLike[str]) -> None:
        """Draw what was measured against the 95 % band of what the posterior predicts, see ``corner``."""
        from fitting.posterior_plots import plot_predictive

        plot_predictive(self, path)

    def predicted(self, draws: int = 200) -> tuple[np.ndarray, ...]:
        """Recorded values at some draws, without noise, shape (draws, D, L) for each measurement."""
        count = self.log_density.size
        chosen = np.unique(np.linspace(0, count - 1, min(draws, count)).astype(int))
        values = np.stack([self.chains[name].reshape(-1)[chosen] for name in self.density.names], axis=1)
        free = [self.spectra[name].reshape(count, -1)[chosen] for name in self.density.problem.free_names]
        shape = len(chosen), *self.density.setting.spectra.shape
        spectra = np.stack(free, axis=1) if free else np.zeros(shape)
        return self.density.predicted(self.density.natural(values), spectra)


def _column(name: str, unit: str) -> str:
    return {"rad": f"{name}_deg", "nm": f"{name}_nm"}.get(unit, name)


def assembled(
    result: FitResult,
    density: Density,
    method: str,
    natural: Float[np.ndarray, "chains draws p"],
    spectra: Float[np.ndarray, "chains draws q u"],
    log_density: Float[np.ndarray, "chains draws"],
    *,
    effective: np.ndarray,
    time: np.ndarray | None,
    acceptance: float | None,
    log_evidence: float | None,
    warnings: Sequence[str],
    converged: bool,
    message: str,
) -> Posterior:
    """A posterior from draws in natural coordinates.

    Raises:
        ValueError: a draw is NaN.
    """
    if np.isnan(natural).any() or np.isnan(spectra).any():
        raise ValueError("a draw is NaN; expected numbers: the chain is damaged")
    chains = {p.name: np.asarray(p.from_natural(natural[..., i])) for i, p in enumerate(density.numbers)}
    free = {name: spectra[:, :, q] for q, name in enumerate(density.problem.free_names)}
    estimates, doubts = {}, list(warnings)
    for i, p in enumerate(density.numbers):
        whole = chains[p.name].reshape(-1)
        ends = np.quantile(whole, [0.025, 0.15865525, 0.5, 0.84134475, 0.975])
        agreement = r_hat(chains[p.name])
        if agreement > 1.05:
            doubts.append(f"the chains of {p.name} disagree (R-hat {agreement:.3f}, above 1.05)")
        estimates[p.name] = Marginal(
            float(ends[2]),
            float(np.mean(whole)),
            float(np.std(whole)),
            (float(ends[1]), float(ends[3])),
            (float(ends[0]), float(ends[4])),
            agreement,
            float(effective[i]),
            math.nan if time is None else float(time[i]),
            p.unit,
        )
        if getattr(result.estimates.get(p.name), "at_kink", False):
            doubts.append(_AT_KINK.format(p.name))
    return Posterior(
        method,
        chains,
        free,
        density.problem.layout.wavelengths_nm,
        log_density,
        estimates,
        acceptance,
        log_evidence,
        tuple(doubts),
        converged,
        message,
        result,
        density,
    )


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
