"""Directions as seen by a groove: components, and the shares of the two panels.

The cross-section of the groove is all that matters for where a ray goes; the component along the fold only
tilts the angles of incidence.
"""

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from vcavity_jax.safe import safe_divide


def components(
    polar: Float[Array, "*directions"], azimuth: Float[Array, "*directions"]
) -> tuple[Float[Array, "*directions"], Float[Array, "*directions"], Float[Array, "*directions"]]:
    """Cartesian components of directions in radians: e_x along the fold, e_y across the grooves, e_z normal.

    cos(π/2) is 0 here, not 6e-17: a direction along the fold is then seen alike by both panels, and one at
    grazing angle is not below the surface.
    """
    sine = jnp.sin(polar)
    return sine * jnp.sin(azimuth), sine * _cosine(azimuth), _cosine(polar)


def _cosine(angle: Float[Array, "..."]) -> Float[Array, "..."]:
    cosine = jnp.cos(angle)
    rounding = jnp.where(jnp.abs(cosine) < 4 * jnp.finfo(cosine.dtype).eps, cosine, jnp.zeros_like(cosine))
    return cosine - lax.stop_gradient(rounding)


def panel_share(
    angle: Float[Array, "..."], across: Float[Array, "..."], normal: Float[Array, "..."]
) -> Float[Array, "..."]:
    """Share of the aperture that the first panel (y < 0) fills, seen along (e_y, e_z).

    F = (1 + tan θ' / tan(α/2)) / 2, clipped to [0, 1]; the second panel has the rest, exactly. It is 0 or 1
    where one panel hides the other. Seen along the fold itself (e_y = e_z = 0) both panels count alike.

    Args:
        angle: dihedral angle, radians.
        across: e_y.
        normal: e_z, ≥ 0.
    """
    along_panel, into_groove = across * jnp.cos(angle / 2), normal * jnp.sin(angle / 2)
    one_hidden = jnp.abs(along_panel) > into_groove
    return jnp.where(
        one_hidden,
        (1 + jnp.sign(along_panel)) / 2,
        (1 + safe_divide(along_panel, into_groove)) / 2,
    )


def hidden_depth(
    angle: Float[Array, "..."], across: Float[Array, "..."], normal: Float[Array, "..."]
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Hidden part [0, y] of the only panel that a direction meets, and 1 - y without cancellation.

    y = max(0, sin(|θ'| - α/2) / sin(|θ'| + α/2)): for a light it is in shadow, for a view it is masked. y = 0
    where both panels are met.

    Args:
        angle: dihedral angle, radians.
        across: e_y.
        normal: e_z, ≥ 0.
    """
    sine, cosine = jnp.sin(angle / 2), jnp.cos(angle / 2)
    facing = jnp.abs(across) * cosine + normal * sine
    behind = jnp.abs(across) * cosine - normal * sine
    # Strict inequalities, the same as for the shares: at the kink all take the side where nothing is hidden.
    depth = safe_divide(jnp.where(behind > 0, behind, jnp.zeros_like(behind)), facing)
    visible = jnp.where(behind > 0, safe_divide(2 * normal * sine, facing), jnp.ones_like(facing))
    return depth, visible


def within_range(angle: Float[Array, ""]) -> Float[Array, ""]:
    """A dihedral angle, where rounding (180 degrees in single precision) exceeds π."""
    return jnp.where(angle > np.pi, jnp.full_like(angle, np.pi), angle)
