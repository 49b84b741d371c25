"""Where a reflectance factor is not smooth in the dihedral angle: all such angles are known in advance.

A search that knows them never steps over a kink; a quadrature that ends its panels there converges fast.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from vcavity_jax.scene import Directional, Mixed, Scene, Specular, VGrooves


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


def kink_angles(scene: Scene, lower: float, upper: float) -> np.ndarray:
    """Sorted dihedral angles between two limits at which the scene's reflectance factor has a kink, radians.

    Empty for randomly grooved surfaces, whose average is smooth.

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
    polar, azimuth = np.broadcast_arrays(np.asarray(scene.view.polar), np.asarray(scene.view.azimuth))
    light = scene.illumination.directional if isinstance(scene.illumination, Mixed) else scene.illumination
    if isinstance(light, Directional):
        polar, azimuth = np.append(polar, light.polar), np.append(azimuth, light.azimuth)
    section = np.arctan2(np.sin(polar) * np.cos(azimuth), np.cos(polar)).ravel()
    if isinstance(scene.material, Specular):
        found = np.asarray(reflection_kinks(jnp.asarray(section), int(np.ceil(2 * np.pi / lower)) + 1)).ravel()
    else:
        found = 2 * np.abs(section)
    return np.unique(found[(found >= lower) & (found <= upper)])
