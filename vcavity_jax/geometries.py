"""The geometries of instruments by their names in the standards: where the light comes from and goes to."""

from typing import Any, Literal

import numpy as np
from jaxtyping import ArrayLike

from vcavity_jax.scene import (
    Annular,
    Diffuse,
    DiffuseWithTrap,
    Directional,
    Hemisphere,
    Illumination,
    View,
    concrete,
    refuse,
)

Geometry = Literal["d:0", "d:8", "di:8", "de:8", "d:d", "0:d", "8:d", "45a:0", "45x:0"]
GEOMETRIES: tuple[Geometry, ...] = ("d:0", "d:8", "di:8", "de:8", "d:d", "0:d", "8:d", "45a:0", "45x:0")

GLOSS_TRAP = np.deg2rad(6.0)
"""Half-angle of the default gloss trap, radians. [CIE15] lets the rays of the receiver deviate by up to 5° from
its axis, and asks that no light that a mirror reflects come within 1° of what is measured."""

_NORMAL: Any = 0.0
_EIGHT: Any = np.deg2rad(8.0)
_FORTY_FIVE: Any = np.deg2rad(45.0)


def cie_geometry(
    name: Geometry, azimuth: ArrayLike = 0.0, *, trap_half_angle: ArrayLike = GLOSS_TRAP
) -> tuple[Illumination, View | Hemisphere]:
    """Illumination and view of a geometry that the CIE recommends [CIE15, section 5].

    ``vc.Scene(surface, material, *vc.cie_geometry("d:8"))`` has the reflectance factor that such an instrument
    reads. The receiver is a direction, not a cone.

    Args:
        name: illumination:view. "d:0", "d:8" and "di:8" (the same) see diffuse light from one direction; "de:8"
            excludes the specular component by a gloss trap; "d:d" collects all; "0:d" and "8:d" are lit from
            one direction and collect all; "45a:0" is lit by a ring, "45x:0" from one side, and both are seen
            from the normal.
        azimuth: of the direction that is not the normal: of the receiver at 8°, of the light at 8° or 45°;
            0 across the grooves, π/2 along them, radians. It says how the sample lies in the instrument.
        trap_half_angle: of the gloss trap of "de:8" as seen from the sample, radians, 0 (no trap) to less than
            16 degrees, where it would reach the receiver. By default 6 degrees: 5 for the receiver's rays
            and 1 for stray light and alignment [CIE15, section 5.2.1].

    Returns:
        The illumination and the view, the last two parts of a scene.

    Raises:
        ValueError: the name is not known (the message lists those that are), or the trap covers the receiver.
    """
    turned: Any = azimuth
    frontal, eight = View(_NORMAL, _NORMAL), View(_EIGHT, turned)
    if name == "d:0":
        return Diffuse(), frontal
    if name in ("d:8", "di:8"):
        return Diffuse(), eight
    if name == "de:8":
        half_angle = concrete(trap_half_angle)
        if half_angle is not None:
            refuse(
                "a half-angle of a gloss trap",
                half_angle,
                ~((half_angle >= 0) & (half_angle < 2 * _EIGHT)),
                "0 to less than 16 degrees (0.2793), where the trap covers the detector",
            )
        # Where a flat mirror sends the light of the receiver's direction: the other side of the normal.
        radius: Any = trap_half_angle
        return DiffuseWithTrap(-_EIGHT, turned, radius), eight
    if name == "d:d":
        return Diffuse(), Hemisphere()
    if name == "0:d":
        return Directional(_NORMAL, _NORMAL), Hemisphere()
    if name == "8:d":
        return Directional(_EIGHT, turned), Hemisphere()
    if name == "45a:0":
        return Annular(_FORTY_FIVE), frontal
    if name == "45x:0":
        return Directional(_FORTY_FIVE, turned), frontal
    raise ValueError(f"{name!r} is not a geometry: expected one of {', '.join(GEOMETRIES)}")
