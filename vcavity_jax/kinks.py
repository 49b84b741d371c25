"""Where a reflectance factor is not smooth in the dihedral angle: all such angles are known in advance.

A search that knows them never steps over a kink; a quadrature that ends its panels there converges fast.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from vcavity_jax.directions import components
from vcavity_jax.illumination import shadow_sections
from vcavity_jax.safe import safe_divide, safe_hypot
from vcavity_jax.scene import (
    DiffuseWithTrap,
    Directional,
    InterfacedLambertian,
    Mixed,
    Scene,
    Specular,
    TwoPanels,
    VGrooves,
    View,
)
from vcavity_jax.specular import Trap

_INTERFACE_ORDERS = 4
"""Orders k of kinks of interfaced panels to list; at the next one the slope jumps by less than a thousandth."""


def reflection_kinks(
    section: Float[Array, "..."], most: int, symmetric: bool = False
) -> Float[Array, "... kinks"]:
    """Dihedral angles at which a number of reflections or a visible panel changes.

    {2|θ'|}, {(π ± 2θ')/k} and {(π ± θ')/(k - 1/2)} for k = 1 ... most; some may lie outside (0, π].

    Args:
        section: θ', the direction's angle from the normal in the cross-section, radians.
        most: how many orders k to list.
        symmetric: θ' is known to be 0, so that the pairs coincide: list each once.
    """
    section = section[..., None]
    order = jnp.arange(1, most + 1, dtype=section.dtype)
    families = [2 * jnp.abs(section)]
    for sign in (1,) if symmetric else (1, -1):
        families += [(jnp.pi + sign * 2 * section) / order, (jnp.pi + sign * section) / (order - 0.5)]
    return jnp.concatenate(families, axis=-1)


def trap_kinks(
    along: Float[Array, "..."],
    across: Float[Array, "..."],
    normal: Float[Array, "..."],
    trap: Trap,
    most: int,
) -> Float[Array, "... kinks"]:
    """Dihedral angles at which paths seen from a direction turn into a gloss trap or out of it.

    Args:
        along: e_x of the direction (along the fold).
        across: e_y (across the grooves).
        normal: e_z, ≥ 0.
        trap: see ``specular.Trap``.
        most: largest number of reflections to list.

    Returns:
        Radians; π where there is none.
    """
    cosine = safe_divide(
        jnp.cos(trap.half_angle) + along * trap.along,
        safe_hypot(across, normal) * safe_hypot(trap.across, trap.normal),
    )
    crossed = jnp.abs(cosine) < 1
    reach = jnp.arccos(jnp.where(crossed, cosine, jnp.zeros_like(cosine)))
    vertical = (across == 0) & (normal == 0)
    section = jnp.arctan2(across, jnp.where(vertical, jnp.ones_like(normal), normal))
    center = jnp.arctan2(trap.across, trap.normal)
    order = jnp.arange(1, most + 1, dtype=section.dtype)
    odd = jnp.mod(order, 2)
    found = []
    for side in (1, -1):
        for edge in (center + reach, center - reach):
            # Unfolded, a path leaves at the section angle d: θ' + mα = d - π for even m, π - d for odd m.
            left = side * edge[..., None]
            turn = odd * (jnp.pi - left) + (1 - odd) * (left - jnp.pi) - side * section[..., None]
            found.append(jnp.mod(turn, 2 * jnp.pi) / order)
    kinks = jnp.concatenate(found, axis=-1)
    return jnp.where(crossed[..., None] & (kinks > 0), kinks, jnp.full_like(kinks, jnp.pi))


def kink_angles(scene: Scene, lower: float, upper: float) -> np.ndarray:
    """Sorted dihedral angles between two limits at which the scene's reflectance factor has a kink, radians.

    Its slope jumps there, or, for a mirror groove behind a gloss trap, it jumps itself. Averages over a ring, a
    disk or the hemisphere of directions keep their slope and add none; randomly grooved surfaces have none.

    Args:
        scene: its view and illumination must be known (not traced).
        lower: radians, > 0.
        upper: radians.

    Returns:
        Radians, shape (K,).

    Raises:
        ValueError: the limits are not such a range.
    """
    if not 0 < lower <= upper <= 2 * np.pi:
        raise ValueError(
            f"{lower} to {upper} is not a range of dihedral angles: expected 0 < lower ≤ upper, radians"
        )
    if not isinstance(scene.surface, VGrooves):
        return np.empty(0)
    material = scene.material.first if isinstance(scene.material, TwoPanels) else scene.material
    if isinstance(material, Specular):
        found = _of_mirrors(scene, lower)
    elif isinstance(material, InterfacedLambertian):
        found = _of_interfaces(scene, lower)
    else:
        found = _of_diffusers(scene)
    return np.unique(found[(found >= lower) & (found <= upper)])


def _of_diffusers(scene: Scene) -> np.ndarray:
    sections = [np.empty(0)]
    if isinstance(scene.illumination, Directional | Mixed):
        sections.append(np.asarray(shadow_sections(scene.illumination)))
    if isinstance(scene.view, View):
        _, across, normal = _view_components(scene.view)
        sections.append(np.abs(np.arctan2(across, normal)))
    return 2 * np.concatenate(sections)


def _of_interfaces(scene: Scene, lower: float) -> np.ndarray:
    """2|θ'|, and (π ± 2θ')/k where the rim begins to cut off a hit; the slope's jump fades with the order k."""
    doubled = _of_diffusers(scene)[:, None]
    order = np.arange(1, min(int(np.ceil(2 * np.pi / lower)), _INTERFACE_ORDERS) + 1)
    found = [doubled, (np.pi + doubled) / order, (np.pi - doubled) / order]
    return np.concatenate([part.ravel() for part in found])


def _of_mirrors(scene: Scene, lower: float) -> np.ndarray:
    light, most = scene.illumination, int(np.ceil(2 * np.pi / lower)) + 1
    if isinstance(scene.view, View):
        along, across, normal = _view_components(scene.view)
    elif isinstance(light, Directional | Mixed):
        light = light.directional if isinstance(light, Mixed) else light
        along, across, normal = (np.asarray(part) for part in components(light.polar, light.azimuth))
    else:
        return np.empty(0)
    section = jnp.asarray(np.arctan2(across, normal).ravel())
    found = [np.asarray(reflection_kinks(section, most)).ravel()]
    if isinstance(light, DiffuseWithTrap):
        trap = Trap(*components(light.polar, light.azimuth), light.half_angle)
        view = jnp.asarray(along), jnp.asarray(across), jnp.asarray(normal)
        found.append(np.asarray(trap_kinks(*view, trap, most)).ravel())
    return np.concatenate(found)


def _view_components(view: View) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    polar, azimuth = jnp.broadcast_arrays(view.polar, view.azimuth)
    along, across, normal = (np.asarray(part).ravel() for part in components(polar, azimuth))
    return along, across, normal
