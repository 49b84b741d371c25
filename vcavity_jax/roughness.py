"""Averages over the dihedral angle of randomly grooved surfaces, Beckmann-distributed.

R_m = ∫ u exp(-u²/2) R(α(u)) du with α = 2 atan2(1, m u), u = tan θ_h / m [SaintPierre2020, eq. 4.45]. Panels
end at the known kinks of R, and within a panel Gauss-Legendre converges spectrally.
"""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Inexact

from vcavity_jax.kinks import reflection_kinks
from vcavity_jax.safe import elementwise_forward, floor_of
from vcavity_jax.scene import Polarization
from vcavity_jax.specular import hemispherical_directional

_PANELS_AT_ONCE = 8

_WIDE_PANELS = 16
"""How many panels, those of the widest grooves, get the full order; the many narrow ones need 0.6 of it."""


def slope_of_angle(angle: Float[Array, "..."], roughness: Float[Array, "..."]) -> Float[Array, "..."]:
    """U = cot(α/2) / m, the facet slope in units of the roughness."""
    return 1 / (jnp.tan(angle / 2) * jnp.maximum(roughness, floor_of(roughness)))


def density(u: Float[Array, "..."]) -> Float[Array, "..."]:
    """Density of the facet slopes, u exp(-u²/2)."""
    return u * jnp.exp(-u * u / 2)


def legendre_nodes(
    start: Float[Array, "..."], end: Float[Array, "..."], order: int
) -> tuple[Float[Array, "... nodes"], Float[Array, "... nodes"]]:
    """Gauss-Legendre nodes and weights of panels."""
    x, weight = np.polynomial.legendre.leggauss(order)
    half = (end - start)[..., None] / 2
    nodes = (start + end)[..., None] / 2 + half * jnp.asarray(x, start.dtype)
    return nodes, half * jnp.asarray(weight, start.dtype)


def panel_nodes(
    start: Float[Array, "..."], end: Float[Array, "..."], order: int
) -> tuple[Float[Array, "... nodes"], Float[Array, "... nodes"]]:
    """Nodes of panels in u, and their weights times the density."""
    u, weight = legendre_nodes(start, end, order)
    return u, weight * density(u)


def tail_weight(cutoff: float) -> float:
    """Share of the facets that are steeper than the cutoff, exp(-U²/2)."""
    return float(np.exp(-cutoff * cutoff / 2))


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
    """

    def average(roughness: Array, along: Array, across: Array, normal: Array, *index_parts: Array) -> Array:
        index = index_parts[0] if len(index_parts) == 1 else lax.complex(*index_parts)
        shape = jnp.broadcast_shapes(*(jnp.shape(a) for a in (roughness, along, across, normal, index)))
        # The integrand is continuous, so moving panel ends add nothing to the derivative.
        m, y, z = (lax.stop_gradient(a) for a in (roughness, across, normal))
        section = jnp.arctan2(y, jnp.where((y == 0) & (z == 0), jnp.ones_like(z), z))
        kinks = reflection_kinks(section, most, symmetric)
        inside = (kinks > 0) & (kinks < jnp.pi)
        ends = jnp.where(
            inside, slope_of_angle(jnp.where(inside, kinks, jnp.ones_like(kinks)), m[..., None]), cutoff
        )
        whole = jnp.arange(int(np.ceil(cutoff)) + 1, dtype=ends.dtype)
        regular = jnp.broadcast_to(whole, (*ends.shape[:-1], len(whole)))
        ends = jnp.sort(jnp.clip(jnp.concatenate([ends, regular], axis=-1), 0, cutoff), axis=-1)
        padding = jnp.full((*ends.shape[:-1], -(ends.shape[-1] - 1) % _PANELS_AT_ONCE), cutoff, ends.dtype)
        ends = jnp.concatenate([ends, padding], axis=-1)
        panels = ends.shape[-1] - 1

        def add_panels(first: int, last: int, nodes: int, total: Array) -> Array:
            def body(carry: tuple[Array, Array]) -> tuple[Array, Array]:
                start, total = carry
                chunk = lax.dynamic_slice_in_dim(ends, start, _PANELS_AT_ONCE + 1, axis=-1)
                u, weight = panel_nodes(chunk[..., :-1], chunk[..., 1:], nodes)
                u, weight = (jnp.reshape(a, (*a.shape[:-2], -1)) for a in (u, weight))
                value = hemispherical_directional(
                    groove_angle(roughness[..., None], u),
                    along[..., None],
                    across[..., None],
                    normal[..., None],
                    index[..., None],
                    model,
                    symmetric,
                )
                return start + _PANELS_AT_ONCE, total + jnp.sum(weight * value, axis=-1)

            def unfinished(carry: tuple[Array, Array]) -> Array:
                start = carry[0]
                end = lax.dynamic_index_in_dim(ends, jnp.minimum(start, panels), axis=-1, keepdims=False)
                return (start < last) & (jnp.min(end, initial=cutoff) < cutoff)

            return lax.while_loop(unfinished, body, (jnp.asarray(first), total))[1]

        # What the cutoff leaves out counts as its end: so the weights sum to 1.
        end = groove_angle(roughness, jnp.asarray(cutoff, roughness.dtype))
        tail = tail_weight(cutoff) * hemispherical_directional(end, along, across, normal, index, model, symmetric)
        wide = min(_WIDE_PANELS, panels)
        total = add_panels(0, wide, order, jnp.broadcast_to(tail, shape))
        return add_panels(wide, panels, max(3, int(np.ceil(0.6 * order))), total)

    parts = (index.real, index.imag) if jnp.iscomplexobj(index) else (index,)
    return elementwise_forward(average, nested=True)(roughness, along, across, normal, *parts)


def lambertian_average(
    roughness: Float[Array, ""],
    section: Float[Array, ""],
    fully_seen: Callable[[Float[Array, ""]], Float[Array, " wavelengths"]],
    masked: Callable[[Float[Array, ""]], Float[Array, " wavelengths"]] | None,
    order: int,
    cutoff: float,
) -> Float[Array, " wavelengths"]:
    """Average over groove angles of a function that is smooth but for the onset of masking at α = 2|θ'|.

    Args:
        roughness: m.
        section: θ' of the view, radians.
        fully_seen: of the angle, valid for α ≥ 2|θ'|.
        masked: of the angle, valid for all α; None where masking is known not to occur.
        order: nodes per panel.
        cutoff: largest u.
    """
    m = lax.stop_gradient(roughness)
    floor = jnp.maximum(m, floor_of(m))
    # α turns from π to 0 around u = 1/m, the density around u = 1: panels for both, whatever their order.
    marks = jnp.asarray([0.25, 1.0, 4.0, 16.0, 64.0], m.dtype) / floor
    whole = jnp.asarray([0.0, 1.0, 2.2, 3.5, 5.0, cutoff], m.dtype)
    marks = jnp.sort(jnp.clip(jnp.concatenate([marks, whole]), 0, cutoff))
    if masked is None:
        onset = jnp.asarray(cutoff, m.dtype)
    else:
        slope = jnp.tan(jnp.abs(lax.stop_gradient(section))) * floor
        onset = jnp.minimum(1 / jnp.maximum(slope, floor_of(slope)), cutoff)
    last = fully_seen if masked is None else masked
    total = tail_weight(cutoff) * last(groove_angle(roughness, jnp.asarray(cutoff, m.dtype)))

    def add(total: Array, u: Array, weight: Array, function: Callable[..., Array], batch: int) -> Array:
        values = lax.map(function, groove_angle(roughness, jnp.ravel(u)), batch_size=batch)
        return total + jnp.ravel(weight) @ values

    ends = jnp.minimum(marks, onset)
    u, weight = panel_nodes(ends[:-1], ends[1:], order)
    total = add(total, u, weight, fully_seen, u.size)
    if masked is None:
        return total
    # A mask sets in with a fractional power of its depth: in v, with u = onset + span v⁴, it is smooth.
    span = jnp.maximum(cutoff - onset, floor_of(onset))
    ends = (jnp.clip(marks - onset, 0, span) / span) ** 0.25
    v, weight = legendre_nodes(ends[:-1], ends[1:], order)
    u = onset + span * v**4
    return add(total, u, weight * 4 * span * v**3 * density(u), masked, order)
