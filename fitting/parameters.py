"""What may vary in a fit: a number in the scene, or the gain and offset of the instrument.

A bounded parameter is searched in its natural coordinate (the value, or its logarithm) and polished in an
unconstrained one, the logit of its place between the bounds.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

Role = Literal["scene", "gain", "offset"]
Scale = Literal["linear", "log"]
Number = float | int
Prior = tuple[Number, Number]


def displayed(value: Any, unit: str) -> Any:
    """A value, or an array of them, as it is printed: degrees for radians."""
    return np.degrees(value) if unit == "rad" else value


@dataclass(frozen=True)
class Parameter:
    """One free parameter. The functions of ``fitting.free`` make the usual ones.

    Args:
        name: under which the result lists it.
        where: picks the number out of a scene, as in ``lambda scene: scene.surface.angle``; None for gain and
            offset, which belong to the instrument.
        lower: smallest allowed value, in ``unit``.
        upper: largest allowed value, in ``unit``.
        prior: mean and standard deviation of a Gaussian prior, in ``unit``; None for none.
        unit: "rad" (shown in degrees) or "1".
        scale: "linear", or "log" for a positive number that may vary over decades.
        role: "scene", "gain" or "offset".

    Raises:
        ValueError: the bounds are not in order, a logarithm would have to take a number that is not positive,
            or the prior's standard deviation is not positive.
    """

    name: str
    where: Callable[[Any], Any] | None
    lower: Number
    upper: Number
    prior: Prior | None = None
    unit: str = "1"
    scale: Scale = "linear"
    role: Role = "scene"

    def __post_init__(self) -> None:
        if not self.name or not isinstance(self.name, str):
            raise ValueError(f"{self.name!r} is not a parameter's name: expected some text")
        if self.unit not in ("rad", "1"):
            raise ValueError(f"parameter {self.name!r}: unit {self.unit!r}; expected 'rad' or '1'")
        if not self.lower < self.upper:
            raise ValueError(
                f"parameter {self.name!r}: lower bound {self.displayed(self.lower):g}, upper bound "
                f"{self.displayed(self.upper):g}; expected lower < upper"
            )
        if self.role == "scene" and not (math.isfinite(self.lower) and math.isfinite(self.upper)):
            raise ValueError(
                f"parameter {self.name!r}: bounds {self.lower:g} to {self.upper:g}; expected finite bounds, "
                "because the whole range is searched"
            )
        if self.scale == "log" and self.lower <= 0:
            raise ValueError(
                f"parameter {self.name!r}: lower bound {self.lower:g}; expected a positive number on a "
                "logarithmic scale"
            )
        if self.prior is not None:
            self._check_prior(self.prior)

    def _check_prior(self, prior: Any) -> None:
        if not (isinstance(prior, tuple) and len(prior) == 2 and all(np.isfinite(prior)) and prior[1] > 0):
            raise ValueError(
                f"parameter {self.name!r}: prior {prior!r}; expected (mean, standard deviation) with a "
                "positive standard deviation, or None"
            )

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
        value = np.exp(coordinate) if self.scale == "log" else coordinate
        # Bounds come back exactly: a logarithm and its inverse would leave a point just beside.
        value = np.where(coordinate <= self.natural(self.lower), self.lower, value)
        value = np.where(coordinate >= self.natural(self.upper), self.upper, value)
        return np.asarray(np.clip(value, self.lower, self.upper))

    def unconstrained(self, value: Any) -> np.ndarray:
        """The logit of the place between the bounds; a bound is moved inside by 1e-6 of the range."""
        low, high = self.natural(self.lower), self.natural(self.upper)
        share = np.clip((self.natural(value) - low) / (high - low), 1e-6, 1 - 1e-6)
        return np.asarray(np.log(share / (1 - share)))

    def from_unconstrained(self, coordinate: Any) -> np.ndarray:
        """The inverse of ``unconstrained`` inside the bounds; any real number is allowed."""
        low, high = self.natural(self.lower), self.natural(self.upper)
        share = 0.5 * (1 + np.tanh(0.5 * np.asarray(coordinate, dtype=np.float64)))
        return self.from_natural(low + (high - low) * share)

    @property
    def step_tolerance(self) -> float:
        """The step in the natural coordinate below which a polish stops: 1e-7 rad, or 1e-7 of ln m."""
        if self.unit == "rad" or self.scale == "log":
            return 1e-7
        return 3e-8 * (self.upper - self.lower)
