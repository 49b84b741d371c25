"""Hemispherical-directional reflectance of a V-groove with mirror-like panels: an exact finite sum.

Unfolded at its panels the groove is a fan of images, and a ray is a straight line through it. Seen from one
direction each panel shows at most two numbers of reflections, M and M - 1, with shares known in closed form;
the polarization follows r_s I + κ q qᵀ at each reflection, q being the transverse part of the facet normal.
Nothing is sampled. docs/specular.md derives it.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Inexact

from vcavity_jax.directions import panel_share
from vcavity_jax.fresnel import Jones, amplitudes, permittivity_contrast, power, turned
from vcavity_jax.safe import elementwise_forward, safe_divide, safe_hypot
from vcavity_jax.scene import Polarization


class Trap(NamedTuple):
    """A dark disk of the hemisphere: components of its center, and its half-angle in radians."""

    along: Float[Array, "..."]
    across: Float[Array, "..."]
    normal: Float[Array, "..."]
    half_angle: Float[Array, "..."]


def reflection_shares(
    angle: Float[Array, "..."],
    across: Float[Array, "..."],
    normal: Float[Array, "..."],
    most: int | None = None,
) -> tuple[Float[Array, "..."], Float[Array, "..."], Float[Array, "..."]]:
    """How often a ray that first meets one panel is reflected: M or M - 1 times, with which shares.

    Args:
        angle: dihedral angle, radians.
        across: e_y of the direction for the panel at y < 0, -e_y for the other.
        normal: e_z of the direction, ≥ 0.
        most: reflections that the angle allows, where that is known; one more is rounding.

    Returns:
        M (whole numbers, at least 1, without gradient), the aperture's share of M reflections and that of
        M - 1. The four shares of both sides sum to 1.
    """
    section = jnp.arctan2(across, jnp.where((across == 0) & (normal == 0), jnp.ones_like(normal), normal))
    first = angle / 2 + section
    both = (jnp.pi - first) / angle
    alone = (jnp.pi - 2 * section) / angle
    count = lax.stop_gradient(jnp.maximum(jnp.floor(jnp.where(first < angle, both, alone)) + 1, 1))
    if most is not None:
        count = jnp.minimum(count, jnp.asarray(most, count.dtype))
    share = panel_share(angle, across, normal)
    steps = (count - 1) * angle / 2
    # With a single reflection cos θ' may vanish; it is not needed then.
    height = jnp.where(count > 1, normal, jnp.ones_like(normal))
    fewer = safe_divide(
        jnp.sin(steps) * jnp.sin(first + steps - jnp.pi / 2) * safe_hypot(across, height),
        jnp.sin(angle / 2) * height,
    )
    # Exactly at a kink the slope of the clip is the mean of both sides.
    fewer = jnp.where(count > 1, jnp.clip(fewer, 0, share), jnp.zeros_like(fewer))
    return count, share - fewer, fewer


def _reflect(
    model: Polarization,
    state: Jones,
    ordinal: Float[Array, "..."],
    angle: Float[Array, "..."],
    along: Float[Array, "..."],
    across: Float[Array, "..."],
    normal: Float[Array, "..."],
    contrast: Inexact[Array, "..."],
) -> Jones:
    """One more reflection, the one with the given ordinal, on the state of polarization of a path."""
    image = (ordinal - 0.5) * angle
    sine, cosine = jnp.sin(image), jnp.cos(image)
    incidence = jnp.maximum(across * cosine + normal * sine, 0)
    r_s, coupling = amplitudes(incidence, contrast)
    if model != "full":
        r_p = r_s + coupling * (1 - incidence * incidence).astype(coupling.dtype)
        if model == "separate":
            return state[0] * r_s, state[1] * r_p
        return (state[0] * (power(r_s) + power(r_p)) / 2,)
    scale = 1 / safe_hypot(across, normal)
    q1 = ((normal * cosine - across * sine) * scale).astype(coupling.dtype)
    q2 = (-along * incidence * scale).astype(coupling.dtype)
    return turned(state, r_s, coupling, q1, q2)


def _initial(model: Polarization, contrast: Inexact[Array, "..."], shape: tuple[int, ...]) -> Jones:
    one, zero = jnp.ones(shape, contrast.dtype), jnp.zeros(shape, contrast.dtype)
    if model == "full":
        return one, zero, zero, one
    return (one, one) if model == "separate" else (one.real,)


def _reflectance(model: Polarization, state: Jones) -> Float[Array, "..."]:
    if model == "unpolarized":
        return state[0]
    return sum((power(entry) for entry in state[1:]), start=power(state[0])) / 2


LONGEST_UNROLLED = 4
"""Reflections up to which a path of known length is one straight piece of arithmetic; longer ones are a loop."""


def _all_but_last(model: Polarization, most: int | None) -> Any:
    """The first M - 1 reflections of a path, differentiable in both modes; the loop is as long as needed."""

    def run(count: Array, *physical: Array) -> Jones:
        geometry, contrast = physical[:4], physical[4] if len(physical) == 5 else lax.complex(*physical[4:])
        shape = jnp.broadcast_shapes(*(jnp.shape(p) for p in physical))

        def body(carry: tuple[Array, Jones]) -> tuple[Array, Jones]:
            ordinal, state = carry
            live = ordinal < count
            # A dead path is led through a harmless reflection: its gradient must not meet a 0/0.
            angle, along, across, normal = geometry
            calm = (
                jnp.where(live, angle, jnp.ones_like(angle)),
                along,
                jnp.where(live, across, jnp.zeros_like(across)),
                jnp.where(live, normal, jnp.ones_like(normal)),
            )
            following = _reflect(model, state, ordinal, *calm, contrast)
            kept = tuple(jnp.where(live, new, old) for new, old in zip(following, state, strict=True))
            return ordinal + 1, kept

        carry = (jnp.ones((), count.dtype), _initial(model, contrast, shape))
        if most is not None:
            for _ in range(1, most):
                carry = body(carry)
            return carry[1]
        last = jnp.max(count, initial=1)
        return lax.while_loop(lambda carry: carry[0] < last, body, carry)[1]

    return run if most is not None else elementwise_forward(run)


def _lit(
    count: Array, angle: Array, along: Array, across: Array, normal: Array, trap: Trap
) -> Float[Array, "..."]:
    """1 for paths of a number of reflections that lead to the sky, 0 for those that lead into the trap.

    All of them leave along one direction: (-e_x, ±(e_y cos mα + e_z sin mα), e_y sin mα - e_z cos mα), with the
    plus sign for odd m.
    """
    sine, cosine = jnp.sin(count * angle), jnp.cos(count * angle)
    sign = 2 * jnp.mod(count, 2) - 1
    exit_across = sign * (across * cosine + normal * sine)
    exit_normal = across * sine - normal * cosine
    squared = (along + trap.along) ** 2 + (exit_across - trap.across) ** 2 + (exit_normal - trap.normal) ** 2
    inside = squared < 4 * jnp.sin(trap.half_angle / 2) ** 2
    return lax.stop_gradient(jnp.where(inside, jnp.zeros_like(squared), jnp.ones_like(squared)))


def _side(
    model: Polarization,
    angle: Array,
    along: Array,
    across: Array,
    normal: Array,
    contrast: Array,
    trap: Trap | None,
    most: int | None,
) -> Float[Array, "..."]:
    """What the paths that first meet one panel contribute; e_y counts from that panel's side."""
    count, share, share_fewer = reflection_shares(angle, across, normal, most)
    if trap is not None:
        share = share * _lit(count, angle, along, across, normal, trap)
        share_fewer = share_fewer * _lit(count - 1, angle, along, across, normal, trap)
    geometry = (angle, along, across, normal)
    # Reflectances are no holomorphic function of the index, amplitudes are: only the latter stay complex.
    split = model == "unpolarized" and jnp.iscomplexobj(contrast)
    tail = (contrast.real, contrast.imag) if split else (contrast,)
    fewer = _all_but_last(model, most)(count, *geometry, *tail)
    seen: Bool[Array, ...] = share > 0
    calm = (
        jnp.where(seen, angle, jnp.ones_like(angle)),
        along,
        jnp.where(seen, across, jnp.zeros_like(across)),
        jnp.where(seen, normal, jnp.ones_like(normal)),
    )
    final = _reflect(model, fewer, count, *calm, contrast)
    return share * _reflectance(model, final) + share_fewer * _reflectance(model, fewer)


def hemispherical_directional(
    angle: Float[Array, "..."],
    along: Float[Array, "..."],
    across: Float[Array, "..."],
    normal: Float[Array, "..."],
    index: Inexact[Array, "..."],
    model: Polarization = "full",
    symmetric: bool = False,
    trap: Trap | None = None,
    most: int | None = None,
) -> Float[Array, "..."]:
    """Hemispherical-directional reflectance, for arguments that broadcast against each other.

    Args:
        angle: dihedral angle, radians, 0 < angle ≤ π.
        along: e_x of the direction (along the fold).
        across: e_y (across the grooves).
        normal: e_z, ≥ 0.
        index: n + ik; real only if n ≥ 1.
        model: treatment of polarization, see ``Specular``.
        symmetric: e_y is known to be 0 everywhere, so that one side stands for both. Not with a trap.
        trap: a part of the hemisphere from which no light comes.
        most: reflections that are known not to be exceeded; None if they are many, or unknown.

    Returns:
        Fraction, of the broadcast shape. Without a trap it is continuous everywhere; its gradient jumps where
        a number of reflections changes, and there that of one side is returned, or the mean of both. With a trap
        it jumps itself where a path turns into the trap.
    """
    contrast = permittivity_contrast(index)
    if symmetric and trap is None:
        return 2 * _side(model, angle, along, across, normal, contrast, None, most)
    rank = max(jnp.ndim(argument) for argument in (angle, along, across, normal, contrast, *(trap or ())))
    sides = jnp.reshape(jnp.asarray([1.0, -1.0], across.dtype), (2, *(1,) * rank))
    if trap is not None:
        trap = trap._replace(across=sides * trap.across)
    return jnp.sum(_side(model, angle, along, sides * across, normal, contrast, trap, most), axis=0)


def glint(
    angle: Float[Array, "..."],
    source: Trap,
    along: Float[Array, "..."],
    across: Float[Array, "..."],
    normal: Float[Array, "..."],
    index: Inexact[Array, "..."],
    model: Polarization,
) -> Float[Array, "..."]:
    """Reflectance factor of mirrors in the light of a small disk: the paths that lead to it, over its irradiance.

    Args:
        angle: dihedral angle, radians.
        source: the disk.
        along: e_x of the view (along the fold).
        across: e_y (across the grooves).
        normal: e_z, ≥ 0.
        index: n + ik; real only if n ≥ 1.
        model: treatment of polarization.
    """
    arguments = angle, along, across, normal, index, model
    met = hemispherical_directional(*arguments) - hemispherical_directional(*arguments, trap=source)
    return met / (jnp.sin(source.half_angle) ** 2 * source.normal)


def disk_of(
    along: Float[Array, ""], across: Float[Array, ""], normal: Float[Array, ""], solid_angle: Float[Array, ""]
) -> Trap:
    """A disk around a direction, of a solid angle in steradians."""
    # ω = 4π sin²(δ/2), accurate for small disks.
    return Trap(along, across, normal, 2 * jnp.arcsin(jnp.sqrt(solid_angle / (4 * jnp.pi))))
