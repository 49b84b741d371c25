"""What may vary in a fit: a number of the scene, a whole spectrum of it, or what the instrument adds.

A number is searched and polished in its natural coordinate (the value, or its logarithm), within its bounds.
"""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from fitting.priors import Number, Prior, as_prior
from fitting.spectra import Form

Role = Literal["scene", "gain", "offset", "tilt_across", "tilt_along", "stray_light", "wavelength_shift"]
Scale = Literal["linear", "log"]
Among = Literal["shared", "separate"] | tuple[str, ...]
INSTRUMENT: tuple[Role, ...] = ("gain", "offset", "tilt_across", "tilt_along", "stray_light", "wavelength_shift")


def displayed(value: Any, unit: str) -> Any:
    """A value, or an array of them, as it is printed: degrees for radians."""
    return np.degrees(value) if unit == "rad" else value


class _Spread:
    """How a parameter is spread over the measurements of a joint fit."""

    def separate(self) -> Any:
        """The same parameter with a value of its own for each measurement."""
        return dataclasses.replace(self, among="separate")  # type: ignore[type-var]

    def only(self, *labels: str) -> Any:
        """The same parameter for some of the measurements, which share its value.

        Args:
            labels: of the measurements: the keys they have in the fit, or "0", "1", ... in a list.
        """
        return dataclasses.replace(self, among=tuple(labels))  # type: ignore[type-var]


@dataclass(frozen=True)
class Parameter(_Spread):
    """One free number. The functions of ``fitting.free`` make the usual ones.

    Args:
        name: under which the result lists it.
        where: picks the number out of a scene, as in ``lambda scene: scene.surface.angle``; None for what
            belongs to the instrument.
        lower: smallest allowed value, in ``unit``.
        upper: largest allowed value, in ``unit``.
        prior: one of ``fitting.priors``, or (mean, standard deviation) for a normal one, in ``unit``; None for
            none. Limits of the prior narrow the bounds.
        unit: "rad" (shown in degrees), "nm" or "1".
        scale: "linear", or "log" for a positive number that may vary over decades.
        role: "scene", or what of the instrument it is.
        start: where the polish starts; None to search the whole allowed range.
        among: of several measurements: "shared" by all, "separate" for each, or the labels of those concerned.

    Raises:
        ValueError: the bounds are not in order, a logarithm would have to take a number that is not positive,
            the start lies outside the bounds, or the prior is none.
    """

    name: str
    where: Callable[[Any], Any] | None
    lower: Number
    upper: Number
    prior: Any = None
    unit: str = "1"
    scale: Scale = "linear"
    role: Role = "scene"
    start: Number | None = None
    among: Among = "shared"

    def __post_init__(self) -> None:
        if not self.name or not isinstance(self.name, str):
            raise ValueError(f"{self.name!r} is not a parameter's name: expected some text")
        if self.unit not in ("rad", "nm", "1"):
            raise ValueError(f"parameter {self.name!r}: unit {self.unit!r}; expected 'rad', 'nm' or '1'")
        prior = as_prior(self.prior, self.name)
        object.__setattr__(self, "prior", prior)
        if prior is not None:
            object.__setattr__(self, "lower", max(self.lower, prior.limits[0]))
            object.__setattr__(self, "upper", min(self.upper, prior.limits[1]))
        if not self.lower < self.upper:
            raise ValueError(
                f"parameter {self.name!r}: lower bound {self.displayed(self.lower):g}, upper bound "
                f"{self.displayed(self.upper):g}; expected lower < upper"
            )
        if self.start is None and not (math.isfinite(self.lower) and math.isfinite(self.upper)):
            raise ValueError(
                f"parameter {self.name!r}: bounds {self.lower:g} to {self.upper:g}; expected finite bounds, "
                "because the whole range is searched"
            )
        if self.scale == "log" and self.lower <= 0:
            raise ValueError(
                f"parameter {self.name!r}: lower bound {self.lower:g}; expected a positive number on a "
                "logarithmic scale"
            )
        if self.start is not None:
            if not math.isfinite(self.start):
                raise ValueError(f"parameter {self.name!r}: start {self.start!r}; expected a finite number")
            object.__setattr__(self, "start", float(np.clip(self.start, self.lower, self.upper)))

    @property
    def searched(self) -> bool:
        """Whether the whole allowed range is searched."""
        return self.start is None

    @property
    def prior_of_logarithm(self) -> bool:
        """Whether the prior is one of the logarithm: then chi-square is no parabola in the value."""
        return self.gaussian is not None and self.gaussian[2]

    @property
    def unbounded(self) -> bool:
        """Whether every number is allowed."""
        return not (math.isfinite(self.lower) or math.isfinite(self.upper))

    @property
    def gaussian(self) -> tuple[float, float, bool] | None:
        """Center and width of the prior, and whether they are of the logarithm; None without any."""
        prior: Prior | None = self.prior
        return None if prior is None else prior.gaussian

    def displayed(self, value: Any) -> Any:
        """A value, or an array of them, as it is printed: degrees for an angle."""
        return displayed(value, self.unit)

    def natural(self, value: Any) -> np.ndarray:
        """Coordinate of the search: the value, or its logarithm."""
        number = np.asarray(value, dtype=np.float64)
        return np.asarray(np.log(number)) if self.scale == "log" else number

    def from_natural(self, coordinate: Any) -> np.ndarray:
        """The inverse of ``natural``, never outside the bounds by rounding."""
        coordinate = np.asarray(coordinate, dtype=np.float64)
        value = np.exp(np.minimum(coordinate, self.natural(self.upper))) if self.scale == "log" else coordinate
        # Bounds come back exactly: a logarithm and its inverse would leave a point just beside.
        value = np.where(coordinate <= self.natural(self.lower), self.lower, value)
        value = np.where(coordinate >= self.natural(self.upper), self.upper, value)
        return np.asarray(np.clip(value, self.lower, self.upper))

    @property
    def step_tolerance(self) -> float:
        """The step in the natural coordinate below which a polish stops: 1e-7 rad, or 1e-7 of ln m."""
        if self.unit == "rad" or self.scale == "log":
            return 1e-7
        width = self.upper - self.lower
        return 3e-8 * width if math.isfinite(width) else 1e-9


@dataclass(frozen=True)
class SpectralParameter(_Spread):
    """A spectrum of the scene that is free: a value for each wavelength, or a smooth or dispersive form of it.

    Args:
        name: under which a wrong place is reported; the result lists the ``quantities``.
        where: picks the spectrum out of a scene, as in ``lambda scene: scene.material.reflectance``.
        quantities: names of its real parts: ("reflectance",), or ("n", "k") for a complex index.
        lower: smallest allowed value of each quantity.
        upper: largest allowed value of each quantity.
        form: None for a free value at each wavelength; else what the wavelengths have in common.
        relative_prior: standard deviation of a normal prior around the scene's own spectrum, as a share of its
            modulus; None for none. Only without a form.
        among: see ``Parameter``.

    Raises:
        ValueError: the bounds are not in order, or a form has a prior of its own and gets another.
    """

    name: str
    where: Callable[[Any], Any]
    quantities: tuple[str, ...]
    lower: tuple[Number, ...]
    upper: tuple[Number, ...]
    form: Form | None = None
    relative_prior: Number | None = None
    among: Among = "shared"

    def __post_init__(self) -> None:
        for quantity, low, high in zip(self.quantities, self.lower, self.upper, strict=True):
            if not (math.isfinite(low) and math.isfinite(high) and low < high):
                raise ValueError(f"{quantity} from {low!r} to {high!r}; expected finite bounds with lower < upper")
        if self.relative_prior is not None and not 0 < self.relative_prior < math.inf:
            raise ValueError(
                f"parameter {self.name!r}: prior {self.relative_prior!r}; expected a positive share, as 0.03"
            )
        if self.relative_prior is not None and self.form is not None:
            raise ValueError(
                f"parameter {self.name!r}: a prior around the scene's spectrum goes with a free value per "
                "wavelength; expected one of prior and form"
            )


Free = Parameter | SpectralParameter
