"""Mirror grooves lit by a ring and seen by a hemisphere: averages of the reflectance over the azimuth.

By reciprocity this is the mean of the hemispherical-directional reflectance over the directions of the ring. It
does not depend on the signs of e_x and e_y, so a quarter of the ring stands for all of it.
"""

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Inexact

from vcavity_jax.directions import components
from vcavity_jax.quadrature import legendre_nodes, of_one_rank, sorted_panels, sum_over_panels
from vcavity_jax.roughness import Slopes, specular_average
from vcavity_jax.safe import elementwise_forward, floor_of, safe_divide
from vcavity_jax.scene import Polarization
from vcavity_jax.specular import hemispherical_directional

_QUARTER = np.pi / 2


def _azimuth(tangent: Float[Array, "..."], polar: Float[Array, "..."]) -> Float[Array, "..."]:
    """Azimuth at which the ring has the section angle θ', given tan θ'; π/2 where it does not reach it."""
    cosine = safe_divide(tangent * jnp.cos(polar), jnp.sin(polar))
    inside = (cosine > 0) & (cosine < 1)
    found = jnp.arccos(jnp.where(inside, cosine, jnp.full_like(cosine, 0.5)))
    return jnp.where(inside, found, jnp.full_like(found, _QUARTER))


def specular_average_over_ring(
    angle: Float[Array, "..."],
    polar: Float[Array, "..."],
    index: Inexact[Array, "..."],
    model: Polarization,
    order: int,
    most: int,
) -> Float[Array, "..."]:
    """Directional-hemispherical reflectance of a mirror groove, averaged over a ring; arguments broadcast.

    Args:
        angle: dihedral angle, radians.
        polar: of the ring, radians.
        index: n + ik; real only if n ≥ 1.
        model: treatment of polarization.
        order: nodes per panel.
        most: orders of kinks to resolve; at least 2π/angle.
    """

    def average(*arguments: Array) -> Array:
        angle, polar, *parts = of_one_rank(*arguments)
        index = parts[0] if len(parts) == 1 else lax.complex(*parts)
        # The kinks of ``kinks.reflection_kinks``, solved for θ'.
        turns = jnp.arange(1, most + 1, dtype=angle.dtype)
        a = angle[..., None]
        families = a / 2, jnp.abs(turns * a - jnp.pi) / 2, jnp.abs((turns - 0.5) * a - jnp.pi)
        section = jnp.concatenate(families, axis=-1)
        below = section < _QUARTER
        tangent = jnp.tan(jnp.where(below, section, jnp.ones_like(section)))
        kinks = _azimuth(jnp.where(below, tangent, jnp.zeros_like(tangent)), polar[..., None])
        regular = jnp.broadcast_to(jnp.asarray([0.4, 0.8, 1.2], kinks.dtype), (*kinks.shape[:-1], 3))
        ends = sorted_panels(jnp.concatenate([kinks, regular], axis=-1), 0.0, _QUARTER)

        def integrand(azimuth: Array) -> Array:
            along, across, normal = components(jnp.broadcast_to(polar, azimuth.shape), azimuth)
            return hemispherical_directional(angle, along, across, normal, index, model)

        return sum_over_panels(integrand, ends, order) / _QUARTER

    parts = (index.real, index.imag) if jnp.iscomplexobj(index) else (index,)
    return elementwise_forward(average, nested=True)(angle, polar, *parts)


def random_average_over_ring(
    roughness: Float[Array, ""],
    polar: Float[Array, ""],
    index: Inexact[Array, " wavelengths"],
    model: Polarization,
    order: int,
    cutoff: float,
    most: int,
    slopes: Slopes,
) -> Float[Array, " wavelengths"]:
    """The same for a randomly grooved mirror; its reflectance is smooth, on the scale of the roughness.

    Args:
        roughness: m.
        polar: of the ring, radians.
        index: n + ik; real only if n ≥ 1.
        model: treatment of polarization.
        order: nodes per panel, in azimuth and in slope.
        cutoff: largest slope.
        most: orders of kinks to resolve.
        slopes: which distribution.
    """
    m = jnp.maximum(lax.stop_gradient(roughness), floor_of(roughness))
    scales = jnp.asarray([0.5, 1.0, 2.0, 4.0, 8.0], m.dtype)
    # Mirrors of slope m turn a path by 2m: features at θ' ~ m and, by shadows, at π/2 - θ' ~ m.
    tangents = jnp.concatenate([m * scales, 1 / (m * scales)])
    marks = jnp.concatenate([_azimuth(tangents, lax.stop_gradient(polar)), jnp.asarray([0.4, 0.8, 1.2], m.dtype)])
    ends = jnp.sort(jnp.concatenate([jnp.zeros(1, m.dtype), marks, jnp.full(1, _QUARTER, m.dtype)]))
    azimuth, weight = legendre_nodes(ends[:-1], ends[1:], order)

    def at(azimuth: Array) -> Array:
        directions = components(jnp.broadcast_to(polar, azimuth.shape), azimuth)
        along, across, normal = (component[:, None] for component in directions)
        return specular_average(roughness, along, across, normal, index, model, False, order, cutoff, most, slopes)

    values = lax.map(lambda node: at(node[None])[0], azimuth.ravel())
    return weight.ravel() @ values / _QUARTER
