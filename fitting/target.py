"""What a designed surface should look like: spectra, colors, and how alike or different two looks are."""

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

import vcavity_jax as vc
from vcavity_jax import colorimetry


@dataclass(frozen=True, eq=False)
class Look:
    """From where, in which light and by whom a surface is seen.

    Args:
        polar: of the view, radians.
        azimuth: of the view, radians, 0 across the grooves.
        illumination: where the light comes from; None for the scene's.
        illuminant: its spectrum, one of ``colorimetry.ILLUMINANTS``.
        observer: one of ``colorimetry.OBSERVERS``.
    """

    polar: float | int = 0.0
    azimuth: float | int = 0.0
    illumination: Any = None
    illuminant: str = "D65"
    observer: str = "CIE 1931"

    def __post_init__(self) -> None:
        if not abs(self.polar) < np.pi / 2:
            raise ValueError(
                f"polar is {self.polar:g}; expected between -π/2 and π/2 radians: did you pass degrees?"
            )
        for name, known in (("illuminant", colorimetry.ILLUMINANTS), ("observer", colorimetry.OBSERVERS)):
            if getattr(self, name) not in known:
                raise ValueError(f"{name} is {getattr(self, name)!r}; expected one of {', '.join(known)}")
        if self.illumination is not None and not isinstance(self.illumination, vc.scene.Illumination):
            raise ValueError(
                f"illumination is a {type(self.illumination).__name__}; expected a light, as vcavity_jax.Diffuse()"
            )

    @property
    def description(self) -> str:
        """In a few words."""
        return f"{_direction(self)} deg, {self.illuminant}{_lit(self.illumination)}"


def _direction(one: Any) -> str:
    azimuth = f", {np.degrees(one.azimuth):g}" if one.azimuth else ""
    return f"{np.degrees(one.polar):g}{azimuth}"


def _lit(light: Any) -> str:
    if light is None:
        return ""
    if isinstance(light, vc.Directional):
        return f", light from {_direction(light)} deg"
    return f", {type(light).__name__} light"


Kind = Literal["color", "spectrum", "alike", "different"]


@dataclass(frozen=True, eq=False)
class Target:
    """One wish. The functions of this module make them.

    Args:
        kind: "color", "spectrum", "alike" or "different".
        looks: at the surface: one, or the two that are compared.
        value: L*, a*, b*, shape (3,); reflectance factors, shape (L,); empty for a comparison.
        limit: ΔE₀₀ that counts as one step off the color, difference of reflectance factors that does, or the
            ΔE₀₀ that two looks may differ at most, or must at least.
        name: under which the result lists it.
    """

    kind: Kind
    looks: tuple[Look, ...]
    value: np.ndarray
    limit: float
    name: str = field(default="")

    @property
    def description(self) -> str:
        """In a few words."""
        said = {
            "color": f"Lab {', '.join(f'{v:.4g}' for v in self.value)}",
            "spectrum": "spectrum",
            "alike": f"within {self.limit:g} of",
            "different": f"at least {self.limit:g} from",
        }[self.kind]
        seen = [look.description for look in self.looks]
        if len(seen) == 2:
            return self.name or f"{seen[0]}: {said} {seen[1]}"
        return self.name or f"{said} at {seen[0]}"


def color(lab: Any, look: Look | None = None, *, step: float | int = 1.0, name: str = "") -> Target:
    """A color.

    Args:
        lab: L*, a*, b* in the look's illuminant and observer, shape (3,).
        look: from where it is to be seen; None for the front, in D65.
        step: ΔE₀₀ that counts as one step off; a smaller one weighs more.
        name: under which the result lists it.

    Raises:
        ValueError: not three finite numbers, L* outside 0 to 100, or a step that is not positive.
    """
    value = np.asarray(lab, np.float64)
    if value.shape != (3,) or not np.isfinite(value).all() or not 0 <= value[0] <= 100:
        raise ValueError(f"lab is {lab!r}; expected L* from 0 to 100, a* and b*")
    return Target("color", (look or Look(),), value, _positive("step", step), name)


def spectrum(
    reflectance_factor: Any, look: Look | None = None, *, step: float | int = 0.01, name: str = ""
) -> Target:
    """Reflectance factors.

    Args:
        reflectance_factor: as fractions, shape (L,), at the wavelengths of the design.
        look: from where they are to be seen; None for the front.
        step: difference (root mean square) that counts as one step off.
        name: under which the result lists it.

    Raises:
        ValueError: not one axis of finite numbers, percent instead of fractions, or a step that is not positive.
    """
    value = np.asarray(reflectance_factor, np.float64)
    if value.ndim != 1 or not value.size or not np.isfinite(value).all():
        raise ValueError(f"reflectance_factor has shape {value.shape}; expected finite numbers in one axis")
    if np.max(value) > 2:
        raise ValueError(f"reflectance_factor reaches {np.max(value):g}; expected fractions: are these percent?")
    return Target("spectrum", (look or Look(),), value, _positive("step", step), name)


def alike(first: Look, second: Look, *, most: float | int = 1.0, name: str = "") -> Target:
    """Two looks may differ by so much ΔE₀₀ at most.

    Raises:
        ValueError: ``most`` is not positive.
    """
    return Target("alike", (first, second), np.zeros(0), _positive("most", most), name)


def different(first: Look, second: Look, *, least: float | int = 10.0, name: str = "") -> Target:
    """Two looks must differ by so much ΔE₀₀ at least.

    Raises:
        ValueError: ``least`` is not positive.
    """
    return Target("different", (first, second), np.zeros(0), _positive("least", least), name)


def _positive(name: str, value: float | int) -> float:
    if isinstance(value, bool) or not 0 < value < np.inf:
        raise ValueError(f"{name} is {value!r}; expected a positive number")
    return float(value)
