"""A sampled posterior: draws by name, what they say, and how far they can be trusted."""

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from typing import Any

import numpy as np
from jaxtyping import Float

from fitting import files
from fitting.density import Density
from fitting.marginal import SpectralMarginal, marginal, of_spectra
from fitting.parameters import displayed
from fitting.result import FitResult, plain

_AT_KINK = (
    "{} lies at a kink of the model: with the truth exactly there, equal-tailed intervals of a flat prior cover "
    "less than they say (76 to 89 % for 95 %); the profile likelihood's interval holds"
)


@dataclass(frozen=True, eq=False)
class Posterior:
    """Draws from the posterior of a fit.

    Args:
        method: "nested", "emcee", "importance" or "nuts".
        chains: draws of each number by name, shape (chains, draws), in Python units (radians); those of an
            ensemble without burn-in.
        spectra: likewise of each free spectrum, shape (chains, draws, L).
        wavelengths_nm: of the spectra, shape (L,).
        log_density: of the posterior at each draw, up to a constant, shape (chains, draws).
        estimates: by name; spectra last.
        divergent: draws at which a trajectory of NUTS broke down, shape (chains, draws); None for other methods.
        acceptance: share of accepted proposals of an ensemble or of NUTS, None otherwise.
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
    estimates: dict[str, Any]
    divergent: np.ndarray | None
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
            if isinstance(one, SpectralMarginal):
                rows.append(_spectral_row(name, one))
                continue
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
        content = {
            "method": self.method,
            "converged": self.converged,
            "message": self.message,
            "warnings": list(self.warnings),
            "draws": int(self.log_density.size),
            "divergent": None if self.divergent is None else int(self.divergent.sum()),
            "acceptance": self.acceptance,
            "log_evidence": self.log_evidence,
            "parameters": {
                name: _spectral_part(one)
                if isinstance(one, SpectralMarginal)
                else {
                    "unit": "deg" if one.unit == "rad" else one.unit,
                    "median": float(one.displayed(one.median)),
                    "mean": float(one.displayed(one.mean)),
                    "standard_deviation": float(one.displayed(one.standard_deviation)),
                    "interval_68": [float(one.displayed(end)) for end in one.interval_68],
                    "interval_95": [float(one.displayed(end)) for end in one.interval_95],
                    "r_hat": one.r_hat,
                    "effective_samples": one.effective_samples,
                    "autocorrelation_time": one.autocorrelation_time,
                }
                for name, one in self.estimates.items()
            },
        }
        shown: dict[str, Any] = plain(content)
        return shown

    def thin(self, every: int) -> "Posterior":
        """Every so many draws of each chain, the last one included.

        Raises:
            ValueError: fewer than 10 draws would be left.
        """
        draws = self.log_density.shape[1]
        if isinstance(every, bool) or not isinstance(every, int) or not 1 <= every <= draws // 10:
            raise ValueError(
                f"every is {every!r}; expected a whole number from 1 to {max(draws // 10, 1)}, for chains of "
                f"{draws} draws"
            )
        kept = slice((draws - 1) % every, None, every)
        chains = {name: values[:, kept] for name, values in self.chains.items()}
        spectra = {name: values[:, kept] for name, values in self.spectra.items()}
        estimates = {
            name: marginal(
                values,
                min(self.estimates[name].effective_samples, float(values.size)),
                self.estimates[name].autocorrelation_time / every,
                self.estimates[name].unit,
            )
            for name, values in chains.items()
        }
        return replace(
            self,
            chains=chains,
            spectra=spectra,
            log_density=self.log_density[:, kept],
            estimates=estimates | of_spectra(spectra, self.wavelengths_nm),
            divergent=None if self.divergent is None else self.divergent[:, kept],
        )

    def to_arviz(self) -> Any:
        """The draws as ``arviz.InferenceData``, angles in degrees, in variables named so.

        Raises:
            ImportError: ArviZ is missing; it comes with the extra ``arviz``.
        """
        try:
            import arviz
        except ImportError:
            raise ImportError("ArviZ is missing; expected: pip install 'vcavity[arviz]'") from None
        numbers = {
            _column(name, self.estimates[name].unit): self.estimates[name].displayed(values)
            for name, values in self.chains.items()
        }
        stats = {"lp": self.log_density} | ({} if self.divergent is None else {"diverging": self.divergent})
        return arviz.from_dict(
            posterior=numbers | self.spectra,
            sample_stats=stats,
            coords={"wavelength_nm": self.wavelengths_nm} if self.spectra else {},
            dims={name: ["wavelength_nm"] for name in self.spectra},
        )

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


def _spectral_row(name: str, one: SpectralMarginal) -> tuple[str, ...]:
    """A spectrum in one line of the summary."""
    low, high = one.interval_95
    return (
        name,
        f"{one.median.min():.4f} to {one.median.max():.4f}",
        f"{np.median(one.standard_deviation):.4f} (median)",
        f"± {np.median(high - low) / 2:.4f} (median)",
        f"{len(one.median)} wavelengths",
    )


def _spectral_part(one: SpectralMarginal) -> dict[str, Any]:
    return {
        "wavelength_nm": one.wavelengths_nm,
        "unit": "1",
        "median": one.median,
        "mean": one.mean,
        "standard_deviation": one.standard_deviation,
        "interval_68": one.interval_68,
        "interval_95": one.interval_95,
    }


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
    divergent: np.ndarray | None = None,
) -> Posterior:
    """A posterior from draws in natural coordinates.

    Raises:
        ValueError: a draw is NaN.
    """
    if np.isnan(natural).any() or np.isnan(spectra).any():
        raise ValueError("a draw is NaN; expected numbers: the chain is damaged")
    chains = {p.name: np.asarray(p.from_natural(natural[..., i])) for i, p in enumerate(density.numbers)}
    free = {name: spectra[:, :, q] for q, name in enumerate(density.problem.free_names)}
    estimates: dict[str, Any] = {}
    doubts = list(warnings)
    for i, p in enumerate(density.numbers):
        steps = math.nan if time is None else float(time[i])
        estimates[p.name] = marginal(chains[p.name], float(effective[i]), steps, p.unit)
        if estimates[p.name].r_hat > 1.05:
            doubts.append(f"the chains of {p.name} disagree (R-hat {estimates[p.name].r_hat:.3f}, above 1.05)")
        if getattr(result.estimates.get(p.name), "at_kink", False):
            doubts.append(_AT_KINK.format(p.name))
    return Posterior(
        method,
        chains,
        free,
        density.problem.layout.wavelengths_nm,
        log_density,
        estimates | of_spectra(free, density.problem.layout.wavelengths_nm),
        divergent,
        acceptance,
        log_evidence,
        tuple(doubts),
        converged,
        message,
        result,
        density,
    )
