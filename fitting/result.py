"""What came out of a fit, in Python and as text."""

import dataclasses
import json
import math
from dataclasses import dataclass
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
        unit: "rad" or "1".
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
        """The unit of printed values: "deg" for an angle, else "1"."""
        return "deg" if self.unit == "rad" else self.unit

    def displayed(self, number: Any) -> Any:
        """A number, or an array of them, in ``display_unit``."""
        return displayed(number, self.unit)


@dataclass(frozen=True)
class Minimum:
    """One distinct minimum of chi-square.

    Args:
        values: the free parameters there; radians for angles.
        chi_square: of the data and the priors.
    """

    values: dict[str, float]
    chi_square: float


@dataclass(frozen=True, eq=False)
class FitResult:
    """A fit and how far it can be trusted.

    Args:
        scene: with the fitted parameters and the measurement's view.
        measurement: what was fitted; its ``standard_uncertainty`` is the one that the fit used, also if that
            was given to ``fit`` or estimated.
        estimates: by name.
        covariance: of the parameters in the order of ``estimates``, in Python units; NaN where singular.
        correlation: likewise, 1 on the diagonal.
        chi_square: of the data and the priors at the best fit.
        degrees_of_freedom: values and priors less parameters.
        residuals: measured less predicted, shape (D, L), NaN where missing.
        predicted: reflectance factors with gain and offset applied, shape (D, L).
        singular_values: of the Jacobian with columns scaled to unit length, descending.
        identifiable: the data determine every parameter within its allowed range.
        minima: all distinct ones within 9 of the best in chi-square, best first.
        profiles: by name, the parameter's values and the chi-square minimized over all others.
        rms_misfit: root mean square of the residuals.
        uncertainty_estimated: the standard uncertainty was not known, and is estimated from the residuals.
        describes_data: whether the misfit is what the standard uncertainty lets expect, to one in a thousand. If
            not, the model is wrong, or the uncertainty too small, and no value can be trusted; None if the fit
            cannot be tested, because the uncertainty is estimated or no degree of freedom is left.
        warnings: each one sentence.
        status: "converged", "not converged", "at bound" or "not identifiable".
        message: what the status means and what to do.
    """

    scene: Any
    measurement: Measurement
    estimates: dict[str, Estimate]
    covariance: np.ndarray
    correlation: np.ndarray
    chi_square: float
    degrees_of_freedom: int
    residuals: np.ndarray
    predicted: np.ndarray
    singular_values: np.ndarray
    identifiable: bool
    minima: list[Minimum]
    profiles: dict[str, tuple[np.ndarray, np.ndarray]]
    rms_misfit: float
    uncertainty_estimated: bool
    describes_data: bool | None
    warnings: tuple[str, ...]
    status: str
    message: str

    def summary(self) -> str:
        """A table to read: value ± standard error, 95 % interval, flags, fit quality and warnings."""
        rows = [("parameter", "value", "std. error", "95 % interval", "")]
        for name, estimate in self.estimates.items():
            unit = " deg" if estimate.unit == "rad" else ""
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

        names = list(self.estimates)
        parameters = {
            name: {
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
                "parameters": {name: self.estimates[name].displayed(m.values[name]) for name in names},
                "chi_square": m.chi_square,
            }
            for m in self.minima
        ]
        content = {
            "status": self.status,
            "message": self.message,
            "identifiable": self.identifiable,
            "describes_data": self.describes_data,
            "warnings": list(self.warnings),
            "parameters": parameters,
            "correlation": self.correlation,
            "chi_square": self.chi_square,
            "degrees_of_freedom": self.degrees_of_freedom,
            "rms_misfit": self.rms_misfit,
            "uncertainty_estimated": self.uncertainty_estimated,
            "singular_values": self.singular_values,
            "minima": minima,
            "scene": _scene_part(self.scene),
            "version": __version__,
        }
        plain: dict[str, Any] = _plain(content)
        return plain

    def to_json(self, path: str | PathLike[str]) -> None:
        """Write ``to_dict()`` to a file as strict JSON (what is not finite becomes null).

        The file is replaced as a whole or not at all.

        Raises:
            OSError: the file cannot be written.
        """
        text = json.dumps(self.to_dict(), indent=2, ensure_ascii=False, allow_nan=False)
        files.write(path, text + "\n")

    def plot(self, path: str | PathLike[str]) -> None:
        """Draw the fit and its profiles to a picture file.

        Raises:
            OSError: the file cannot be written.
            ValueError: its ending is not .png, .pdf or .svg.
        """
        from fitting.plots import plot_fit

        plot_fit(self, path)


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
    for field in dataclasses.fields(part):
        value = getattr(part, field.name)
        if dataclasses.is_dataclass(value):
            described[field.name] = _scene_part(value)
        elif field.name in ("angle", "polar", "azimuth", "half_angle"):
            described[f"{field.name}_deg"] = np.degrees(np.asarray(value))
        elif isinstance(value, str | bool | None):
            described[field.name] = value
        else:
            array = np.asarray(value)
            complex_valued = array.dtype.kind == "c"
            described[field.name] = np.stack([array.real, array.imag], -1) if complex_valued else array
    return described


def _plain(value: Any) -> Any:
    """Only what JSON knows: arrays become lists, numbers that are not finite None."""
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
