"""What came out of a fit, in Python and as text."""

import dataclasses
import math
from dataclasses import dataclass, field
from os import PathLike
from typing import Any

import numpy as np

from fitting import files
from fitting.measurement import Measurement
from fitting.parameters import displayed

STATUSES = ("converged", "not converged", "at bound", "not identifiable")


@dataclass(frozen=True)
class Estimate:
    """One fitted parameter.

    Args:
        value: best value; radians for an angle.
        standard_error: from the slope of the model at the minimum, NaN where the data do not determine the
            parameter. Where that lies on a kink it is that of the side where the model changes less.
        interval_95: where the profile likelihood stays within the 95 % limit; several pieces if chi-square
            has several minima. Trust it over the standard error.
        unit: "rad", "nm" or "1".
        at_bound: the value lies on a bound of the allowed range.
        at_kink: the value lies on a kink of the model; or within three standard errors of one at which the
            slopes on both sides differ by more than half.
        one_sided_errors: standard errors from the model's slope on the left and on the right: of that kink,
            or of the value if there is none.
    """

    value: float
    standard_error: float
    interval_95: list[tuple[float, float]]
    unit: str = "1"
    at_bound: bool = False
    at_kink: bool = False
    one_sided_errors: tuple[float, float] | None = None

    @property
    def display_unit(self) -> str:
        """The unit of printed values: "deg" for an angle, else "nm" or "1"."""
        return "deg" if self.unit == "rad" else self.unit

    def displayed(self, number: Any) -> Any:
        """A number, or an array of them, in ``display_unit``."""
        return displayed(number, self.unit)


@dataclass(frozen=True, eq=False)
class SpectralEstimate:
    """A fitted spectrum.

    Args:
        wavelengths_nm: nm, shape (L,).
        value: best values, shape (L,).
        standard_error: with those of all other parameters, shape (L,); NaN where the data do not determine it.
        interval_95: lower and upper ends of the 95 % interval at each wavelength, shape (L,) each: from the
            profile of a searched parameter if there is one, with its errors at every point of it.
        at_bound: where a value lies on a bound, shape (L,).
        unit: "1".
    """

    wavelengths_nm: np.ndarray
    value: np.ndarray
    standard_error: np.ndarray
    interval_95: list[tuple[np.ndarray, np.ndarray]]
    at_bound: np.ndarray
    unit: str = "1"


@dataclass(frozen=True)
class Minimum:
    """One distinct minimum of chi-square.

    Args:
        values: the free parameters there; radians for angles.
        chi_square: of the data and the priors.
        spectra: the free spectra there, by name.
    """

    values: dict[str, float]
    chi_square: float
    spectra: dict[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True)
class Start:
    """Where a descent from one start ended.

    Args:
        values: the free parameters there; radians for angles.
        chi_square: of the data and the priors; not finite if the model gave no number.
        status: "converged", "out of steps" or "no number".
        steps: evaluations of the model and its derivatives.
        rejected: those that led uphill or to no number.
    """

    values: dict[str, float]
    chi_square: float
    status: str
    steps: int
    rejected: int


@dataclass(frozen=True, eq=False)
class FitResult:
    """A fit and how far it can be trusted.

    Args:
        scenes: with the fitted parameters and the measurements' views.
        measurements: what was fitted; their ``standard_uncertainty`` is the one that the fit used, also if that
            was given to ``fit`` or estimated.
        labels: of the measurements.
        estimates: by name; spectra last.
        numbers: names of the parameters of ``covariance``, which are single numbers.
        covariance: of these numbers, in Python units; NaN where singular.
        correlation: likewise, 1 on the diagonal.
        chi_square: of the data and the priors at the best fit.
        degrees_of_freedom: values and priors less parameters.
        misfits: measured less predicted, shape (D, L), NaN where missing, for each measurement.
        predictions: reflectance factors as the instrument records them, shape (D, L), for each measurement.
        singular_values: of the Jacobian of the numbers with columns scaled to unit length, free spectra
            projected out, descending.
        identifiable: the data determine every parameter within its allowed range.
        minima: all distinct ones within 9 of the best in chi-square, best first.
        starts: where the descent from each start ended.
        profiles: by name, the parameter's values and the chi-square minimized over all others.
        rms_misfit: root mean square of the residuals.
        uncertainty_estimated: the standard uncertainty was not known, and is estimated from the residuals.
        describes_data: whether the misfit is what the standard uncertainty lets expect, to one in a thousand. If
            not, the model is wrong, or the uncertainty too small, and no value can be trusted; None if the fit
            cannot be tested, because the uncertainty is estimated or no degree of freedom is left.
        warnings: each one sentence.
        status: "converged", "not converged", "at bound" or "not identifiable".
        message: what the status means and what to do.
        problem: what was solved, for further questions to it.
        found: all that was evaluated on the way.
    """

    scenes: tuple[Any, ...]
    measurements: tuple[Measurement, ...]
    labels: tuple[str, ...]
    estimates: dict[str, Any]
    numbers: tuple[str, ...]
    covariance: np.ndarray
    correlation: np.ndarray
    chi_square: float
    degrees_of_freedom: int
    misfits: tuple[np.ndarray, ...]
    predictions: tuple[np.ndarray, ...]
    singular_values: np.ndarray
    identifiable: bool
    minima: list[Minimum]
    starts: tuple[Start, ...]
    profiles: dict[str, tuple[np.ndarray, np.ndarray]]
    rms_misfit: float
    uncertainty_estimated: bool
    describes_data: bool | None
    warnings: tuple[str, ...]
    status: str
    message: str
    problem: Any = field(repr=False, default=None)
    found: Any = field(repr=False, default=None)

    @property
    def scene(self) -> Any:
        """The fitted scene; of several measurements, that of the first."""
        return self.scenes[0]

    @property
    def measurement(self) -> Measurement:
        """What was fitted; of several measurements, the first."""
        return self.measurements[0]

    @property
    def residuals(self) -> np.ndarray:
        """Measured less predicted, shape (D, L); of several measurements, of the first."""
        return self.misfits[0]

    @property
    def predicted(self) -> np.ndarray:
        """Recorded reflectance factors, shape (D, L); of several measurements, of the first."""
        return self.predictions[0]

    def profile(self, name: str, *, wavelength_nm: float | None = None, points: int = 41) -> Any:
        """The profile likelihood of any parameter, see ``fitting.profile_likelihood``."""
        from fitting.profile import profile_likelihood

        return profile_likelihood(self, name, wavelength_nm=wavelength_nm, points=points)

    def summary(self) -> str:
        """A table to read: value ± standard error, 95 % interval, flags, fit quality and warnings."""
        rows: list[tuple[str, ...]] = [("parameter", "value", "std. error", "95 % interval", "")]
        for name, estimate in self.estimates.items():
            if isinstance(estimate, SpectralEstimate):
                rows.append(_spectral_row(name, estimate))
                continue
            unit = {"rad": " deg", "nm": " nm"}.get(estimate.unit, "")
            digits = _digits(estimate)
            error = estimate.displayed(estimate.standard_error)
            pieces = [
                f"{estimate.displayed(low):.{digits}f} to {estimate.displayed(high):.{digits}f}"
                for low, high in estimate.interval_95
            ]
            flags = [word for word in ("at_bound", "at_kink") if getattr(estimate, word)]
            rows.append(
                (
                    name,
                    f"{estimate.displayed(estimate.value):.{digits}f}{unit}",
                    f"± {error:.{digits}f}" if math.isfinite(error) else "none",
                    " or ".join(pieces),
                    ", ".join(flags).replace("_", " "),
                )
            )
        widths = [max(len(row[i]) for row in rows) for i in range(5)]
        padded = [[cell.ljust(width) for cell, width in zip(row, widths, strict=True)] for row in rows]
        lines = ["  ".join(row).rstrip() for row in padded]
        lines += ["", f"status: {self.status}. {self.message}", self._quality()]
        if len(self.minima) > 1:
            lines.append("minima: " + "; ".join(self._describe(minimum) for minimum in self.minima))
        return "\n".join(lines + [f"warning: {warning}" for warning in self.warnings])

    def _quality(self) -> str:
        dof, misfit = self.degrees_of_freedom, f"rms misfit {self.rms_misfit:.4f}"
        if self.uncertainty_estimated:
            return f"{misfit}; the standard uncertainty is estimated from it: the fit cannot be tested"
        ratio = f" = {self.chi_square / dof:.3g} per degree of freedom" if dof else ""
        return f"chi-square {self.chi_square:.4g}, degrees of freedom {dof}{ratio}; {misfit}"

    def _describe(self, minimum: Minimum) -> str:
        values = [f"{name} {self.estimates[name].displayed(value):.4g}" for name, value in minimum.values.items()]
        return f"{', '.join(values)} (chi-square {minimum.chi_square:.4g})"

    def to_dict(self) -> dict[str, Any]:
        """The content of ``fit.json``: plain numbers, angles in degrees, None for what does not exist."""
        from vcavity_jax import __version__

        parameters = {
            name: _spectral_part(e)
            if isinstance(e, SpectralEstimate)
            else {
                "value": e.displayed(e.value),
                "unit": e.display_unit,
                "standard_error": e.displayed(e.standard_error),
                "interval_95": [[e.displayed(low), e.displayed(high)] for low, high in e.interval_95],
                "at_bound": e.at_bound,
                "at_kink": e.at_kink,
            }
            for name, e in self.estimates.items()
        }
        minima = [
            {
                "parameters": self._shown(m.values),
                "chi_square": m.chi_square,
            }
            | ({"spectra": m.spectra} if m.spectra else {})
            for m in self.minima
        ]
        content = {
            "status": self.status,
            "message": self.message,
            "identifiable": self.identifiable,
            "describes_data": self.describes_data,
            "warnings": list(self.warnings),
            "parameters": parameters,
            "numbers": self.numbers,
            "correlation": self.correlation,
            "chi_square": self.chi_square,
            "degrees_of_freedom": self.degrees_of_freedom,
            "rms_misfit": self.rms_misfit,
            "uncertainty_estimated": self.uncertainty_estimated,
            "singular_values": self.singular_values,
            "minima": minima,
            "starts": [dataclasses.asdict(start) | {"values": self._shown(start.values)} for start in self.starts],
            **self._scenes(),
            "version": __version__,
        }
        shown: dict[str, Any] = plain(content)
        return shown

    def _shown(self, values: dict[str, float]) -> dict[str, Any]:
        return {name: self.estimates[name].displayed(value) for name, value in values.items()}

    def _scenes(self) -> dict[str, Any]:
        if len(self.scenes) == 1:
            return {"scene": _scene_part(self.scene)}
        return {"scenes": {k: _scene_part(s) for k, s in zip(self.labels, self.scenes, strict=True)}}

    def to_json(self, path: str | PathLike[str]) -> None:
        """Write ``to_dict()`` to a file as strict JSON (what is not finite becomes null).

        The file is replaced as a whole or not at all.

        Raises:
            OSError: the file cannot be written.
        """
        files.write_json(path, self.to_dict())

    def plot(self, path: str | PathLike[str]) -> None:
        """Draw the fit and its profiles to a picture file.

        Raises:
            OSError: the file cannot be written.
            ValueError: its ending is not .png, .pdf or .svg.
        """
        from fitting.plots import plot_fit

        plot_fit(self, path)


def _spectral_row(name: str, estimate: SpectralEstimate) -> tuple[str, ...]:
    """A spectrum in one line of the summary: its range and its typical error."""
    known = estimate.value[np.isfinite(estimate.standard_error)]
    if not len(known):
        return name, "undetermined", "none", "", ""
    error = float(np.nanmedian(estimate.standard_error))
    bound = int(estimate.at_bound.sum())
    return (
        name,
        f"{known.min():.4f} to {known.max():.4f}",
        f"± {error:.4f} (median)",
        f"{len(known)} wavelengths, {estimate.wavelengths_nm[0]:g} to {estimate.wavelengths_nm[-1]:g} nm",
        f"{bound} at a bound" if bound else "",
    )


def _spectral_part(estimate: SpectralEstimate) -> dict[str, Any]:
    return {
        "wavelength_nm": estimate.wavelengths_nm,
        "value": estimate.value,
        "unit": estimate.unit,
        "standard_error": estimate.standard_error,
        "interval_95": [[low, high] for low, high in estimate.interval_95],
        "at_bound": estimate.at_bound,
    }


def _digits(estimate: Estimate) -> int:
    """Decimals that show two digits of the error, or of the interval where there is no error."""
    scale = estimate.displayed(estimate.standard_error)
    if not (math.isfinite(scale) and scale > 0):
        low, high = estimate.interval_95[0][0], estimate.interval_95[-1][1]
        scale = estimate.displayed(high - low) / 4
    if not (math.isfinite(scale) and scale > 0):
        return 4
    return int(np.clip(1 - math.floor(math.log10(scale)), 0, 8))


def _scene_part(part: Any) -> dict[str, Any]:
    """A part of a scene as text and numbers; angles become degrees, complex numbers [n, k]."""
    described: dict[str, Any] = {"type": type(part).__name__}
    for one in dataclasses.fields(part):
        value = getattr(part, one.name)
        if dataclasses.is_dataclass(value):
            described[one.name] = _scene_part(value)
        elif one.name in ("angle", "polar", "azimuth", "half_angle"):
            described[f"{one.name}_deg"] = np.degrees(np.asarray(value))
        elif isinstance(value, str | bool | None):
            described[one.name] = value
        else:
            array = np.asarray(value)
            complex_valued = array.dtype.kind == "c"
            described[one.name] = np.stack([array.real, array.imag], -1) if complex_valued else array
    return described


def plain(value: Any) -> Any:
    """Only what JSON knows: arrays become lists, numbers that are not finite None."""
    if isinstance(value, dict):
        return {key: plain(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
