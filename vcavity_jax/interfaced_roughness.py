"""Averages over the dihedral angle of randomly grooved surfaces with interfaced panels.

R_m = ∫ p(u) R(α(u)) du as in ``roughness``; panels of the quadrature end where hits appear or vanish for the light
or for the view. Narrow grooves need more images: the range of angles is divided, and each part has its own work.
"""

from collections.abc import Callable, Sequence

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from vcavity_jax.interfaced import InterfaceResolution
from vcavity_jax.kinks import reflection_kinks
from vcavity_jax.quadrature import sorted_panels, sum_over_panels
from vcavity_jax.roughness import Slopes, density, groove_angle, slope_of_angle, tail_weight
from vcavity_jax.safe import elementwise_forward

_ANGLES_AT_ONCE = 8


def average(
    at: Callable[..., Float[Array, " w"]],
    roughness: Float[Array, ""],
    sections: Sequence[Float[Array, ""]],
    arguments: Sequence[Float[Array, "..."]],
    tiers: Sequence[tuple[float, InterfaceResolution]],
    order: int,
    cutoff: float,
    most: int,
    slopes: Slopes,
) -> Float[Array, " w"]:
    """Average of a spectrum over groove angles.

    Args:
        at: of the nodes of a tier, the angle and the arguments; each wavelength on its own.
        roughness: m.
        sections: θ' of light and view, radians; those of the arguments.
        arguments: all that is traced, of shape (), (1,) or (W,).
        tiers: smallest angle, radians, and sampling of each part of the range, from wide to narrow.
        order: nodes per panel.
        cutoff: largest u.
        most: orders of kinks to resolve.
        slopes: which distribution.
    """
    count = len(sections)

    def integral(*everything: Array) -> Float[Array, " w"]:
        m = everything[0]
        fixed = lax.stop_gradient(m)
        # The integrand is continuous, so moving panel ends add nothing to the derivative.
        kinks = [reflection_kinks(lax.stop_gradient(s), most) for s in everything[1 : 1 + count]]
        marks = jnp.concatenate([k.ravel() for k in kinks] or [jnp.zeros(0, m.dtype)])
        inside = (marks > 0) & (marks < jnp.pi)
        slope = slope_of_angle(jnp.where(inside, marks, jnp.ones_like(marks)), fixed)
        slope = jnp.where(inside, slope, jnp.full_like(slope, cutoff))
        slope = jnp.concatenate([slope, jnp.arange(1, int(np.ceil(cutoff)), dtype=slope.dtype)])
        others = everything[1 + count :]
        total, start = None, jnp.zeros((), m.dtype)
        for place, (smallest, nodes) in enumerate(tiers):
            last = place == len(tiers) - 1
            end = jnp.asarray(cutoff, m.dtype)
            if not last:
                end = jnp.minimum(slope_of_angle(jnp.asarray(smallest, m.dtype), fixed)[0], end)

            def integrand(u: Array, nodes: InterfaceResolution = nodes) -> Array:
                angles = groove_angle(m, u[:, 0])
                values = lax.map(lambda angle: at(nodes, angle, *others), angles, batch_size=_ANGLES_AT_ONCE)
                return density(u, slopes) * values

            ends = sorted_panels(slope, start, end)[:, None]
            part = sum_over_panels(integrand, ends, order)
            total = part if total is None else total + part
            start = end
        tail = tail_weight(cutoff, slopes) * at(
            tiers[-1][1], groove_angle(m, jnp.asarray(cutoff, m.dtype))[0], *others
        )
        assert total is not None
        return total + tail

    return elementwise_forward(integral, nested=True)(roughness[None], *(s[None] for s in sections), *arguments)
