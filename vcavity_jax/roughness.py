"""Averages over the dihedral angle of randomly grooved surfaces.

R_m = ∫ p(u) R(α(u)) du with α = 2 atan2(1, m u), u = tan θ_h / m, and p(u) = u exp(-u²/2) for Beckmann's slopes
[SaintPierre2020, eq. 4.45] or √(2/π) exp(-u²/2) for those of a Gaussian profile. Panels end at the known kinks
of R, and within a panel Gauss-Legendre converges spectrally.
"""

import math
from collections.abc import Callable
from typing import Literal

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Inexact

from vcavity_jax.kinks import reflection_kinks, trap_kinks
from vcavity_jax.quadrature import Clustering, clustered_nodes, of_one_rank, sorted_panels, sum_over_panels
from vcavity_jax.safe import elementwise_forward, floor_of
from vcavity_jax.scene import Polarization
from vcavity_jax.specular import Trap, hemispherical_directional

Slopes = Literal["beckmann", "gaussian"]

_WIDE_PANELS = 16
"""How many panels, those of the widest grooves, get the full order; the many narrow ones need 0.6 of it."""


def slope_of_angle(angle: Float[Array, "..."], roughness: Float[Array, "..."]) -> Float[Array, "..."]:
    """U = cot(α/2) / m, the facet slope in units of the roughness."""
    return 1 / (jnp.tan(angle / 2) * jnp.maximum(roughness, floor_of(roughness)))


def density(u: Float[Array, "..."], slopes: Slopes = "beckmann") -> Float[Array, "..."]:
    """Density of the facet slopes: u exp(-u²/2), or √(2/π) exp(-u²/2) for those of a Gaussian profile."""
    return (u if slopes == "beckmann" else math.sqrt(2 / math.pi)) * jnp.exp(-u * u / 2)


def tail_weight(cutoff: float, slopes: Slopes = "beckmann") -> float:
    """Share of the facets that are steeper than the cutoff: exp(-U²/2), or erfc(U/√2) for a Gaussian profile."""
    return math.exp(-cutoff * cutoff / 2) if slopes == "beckmann" else math.erfc(cutoff / math.sqrt(2))


def groove_angle(roughness: Float[Array, "..."], u: Float[Array, "..."]) -> Float[Array, "..."]:
    """α = 2 atan2(1, m u), the dihedral angle of a groove whose facets have slope m u."""
    return 2 * jnp.arctan2(jnp.ones_like(u), roughness * u)


def specular_average(
    roughness: Float[Array, "..."],
    along: Float[Array, "..."],
    across: Float[Array, "..."],
    normal: Float[Array, "..."],
    index: Inexact[Array, "..."],
    model: Polarization,
    symmetric: bool,
    order: int,
    cutoff: float,
    most: int,
    slopes: Slopes = "beckmann",
    trap: Trap | None = None,
) -> Float[Array, "..."]:
    """Hemispherical-directional reflectance of randomly grooved mirrors; arguments broadcast.

    Args:
        roughness: m.
        along: e_x of the direction (along the fold).
        across: e_y (across the grooves).
        normal: e_z, ≥ 0.
        index: n + ik; real only if n ≥ 1.
        model: treatment of polarization.
        symmetric: e_y is known to be 0 everywhere.
        order: nodes per panel.
        cutoff: largest u.
        most: orders of kinks to resolve; π/most should be below the narrowest groove at the cutoff.
        slopes: which distribution.
        trap: a part of the hemisphere from which no light comes.
    """

    def average(*arguments: Array) -> Array:
        roughness, along, across, normal, *others = of_one_rank(*arguments)
        dark = None if trap is None else Trap(*others[-4:])
        index_parts = others if trap is None else others[:-4]
        index = index_parts[0] if len(index_parts) == 1 else lax.complex(*index_parts)
        shape = jnp.broadcast_shapes(*(jnp.shape(a) for a in (roughness, along, across, normal, *others)))
        m, x, y, z = roughness, along, across, normal
        if dark is None:
            # The integrand is continuous, so moving panel ends add nothing to the derivative.
            m, y, z = (lax.stop_gradient(a) for a in (roughness, across, normal))
        section = jnp.arctan2(y, jnp.where((y == 0) & (z == 0), jnp.ones_like(z), z))
        kinks = reflection_kinks(section, most, symmetric)
        if dark is not None:
            edges = trap_kinks(x, y, z, dark, most)
            both = jnp.broadcast_shapes(kinks.shape[:-1], edges.shape[:-1])
            kinks = jnp.concatenate([jnp.broadcast_to(k, (*both, k.shape[-1])) for k in (kinks, edges)], axis=-1)
        inside = (kinks > 0) & (kinks < jnp.pi)
        # A flat groove (α = π) stands for no kink.
        slope = slope_of_angle(jnp.where(inside, kinks, jnp.ones_like(kinks)), m[..., None])
        slope = jnp.where(inside, slope, jnp.full_like(slope, cutoff))
        whole = jnp.arange(1, int(np.ceil(cutoff)), dtype=slope.dtype)
        regular = jnp.broadcast_to(whole, (*slope.shape[:-1], len(whole)))
        ends = sorted_panels(jnp.concatenate([slope, regular], axis=-1), 0.0, cutoff)

        def integrand(u: Array) -> Array:
            value = hemispherical_directional(
                groove_angle(roughness, u), along, across, normal, index, model, symmetric, dark
            )
            return density(u, slopes) * value

        # What the cutoff leaves out counts as its end: so the weights sum to 1.
        end = groove_angle(roughness, jnp.asarray(cutoff, roughness.dtype))
        tail = tail_weight(cutoff, slopes) * hemispherical_directional(
            end, along, across, normal, index, model, symmetric, dark
        )
        wide = _WIDE_PANELS if dark is None else 3 * _WIDE_PANELS
        coarse = max(3, int(np.ceil(0.6 * order)))
        return jnp.broadcast_to(tail, shape) + sum_over_panels(integrand, ends, coarse, order, wide)

    parts = (index.real, index.imag) if jnp.iscomplexobj(index) else (index,)
    return elementwise_forward(average, nested=True)(roughness, along, across, normal, *parts, *(trap or ()))


def lambertian_average(
    roughness: Float[Array, ""],
    sections: Float[Array, " onsets"],
    fully_open: Callable[[Float[Array, ""]], Float[Array, " wavelengths"]],
    general: Callable[[Float[Array, ""]], Float[Array, " wavelengths"]] | None,
    clustering: Clustering,
    cutoff: float,
    slopes: Slopes = "beckmann",
    batch: int = 16,
) -> Float[Array, " wavelengths"]:
    """Average over groove angles of a function that is smooth but for shadows and masks that set in.

    Args:
        roughness: m.
        sections: |θ'| at which a shadow or a mask sets in or is complete, at α = 2|θ'|, radians; any order. See
            ``illumination.shadow_sections``.
        fully_open: of the angle, valid for α ≥ 2|θ'| of all of them.
        general: of the angle, valid for all α; None where shadows and masks are known not to occur.
        clustering: see ``resolution.average_clustering``.
        cutoff: largest u.
        slopes: whose density.
        batch: angles at which ``general`` is evaluated together.
    """
    m = lax.stop_gradient(roughness)
    last = jnp.asarray(cutoff, m.dtype)
    tail = groove_angle(roughness, last)
    total = tail_weight(cutoff, slopes) * (fully_open if general is None else general)(tail)

    def add(total: Array, start: Array, end: Array, function: Callable[..., Array], batch: int | None) -> Array:
        u, weight = clustered_nodes(start, end, clustering)
        u, weight = jnp.ravel(u), jnp.ravel(weight * density(u, slopes))
        values = lax.map(function, groove_angle(roughness, u), batch_size=batch or u.size)
        return total + weight @ values

    if general is None:
        return add(total, jnp.zeros_like(last), last, fully_open, None)
    # The integrand is continuous, so moving its ends adds nothing to the derivative.
    slope = jnp.abs(jnp.tan(lax.stop_gradient(sections))) * jnp.maximum(m, floor_of(m))
    onsets = jnp.sort(jnp.minimum(1 / jnp.maximum(slope, floor_of(slope)), last))
    total = add(total, jnp.zeros_like(last), onsets[0], fully_open, None)
    # Both sides of an onset are singular, with fractional powers: nodes cluster at both ends.
    return add(total, onsets, jnp.append(onsets[1:], last), general, batch)
