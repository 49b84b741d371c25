"""Uniform bands on the panels: what lights and views of an interfaced groove are made of.

A ray enters a panel where it meets it first, or after reflections; the rays of one direction so light, or see,
bands of both panels. Lengths are in -ln(distance from the fold). A band is divided by its length, so that a mean
over a vanishing part stays accurate.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Complex, Float

from vcavity_jax.wiener_hopf import (
    Resolution,
    complex_expm1,
    constant,
    contour,
    decay,
    nonzero,
    step_transform,
)


class Bands(NamedTuple):
    """Bands of both panels.

    Args:
        outer: where a band begins, seen from the rim, shape (bands,).
        length: how far it reaches towards the fold; ``wiener_hopf.FULL`` for all the way.
        width: 1 - ratio of its two distances from the fold.
        mass: of the band.
        sign: 1 on the first panel, -1 on the second.
    """

    outer: Float[Array, " bands"]
    length: Float[Array, " bands"]
    width: Float[Array, " bands"]
    mass: Float[Array, " bands"]
    sign: Float[Array, " bands"]

    @property
    def by_panel(self) -> Float[Array, "2 bands"]:
        """Masses on the first and on the second panel."""
        return self.mass * jnp.stack([1 + self.sign, 1 - self.sign]) / 2


class Footprint(NamedTuple):
    """What a light or a view meets: its bands, and their transform and mass summed over each panel."""

    bands: Bands
    transform: Complex[Array, "2 nodes"]
    mass: Float[Array, "2"]


def footprint(bands: Bands, resolution: Resolution) -> Footprint:
    """Sum bands up on the contour: Σ mass (y₁^(1/2 + iτ) - y₀^(1/2 + iτ)) / (y₁ - y₀)."""
    tau = constant(contour(resolution).tau, lax.complex(bands.outer, bands.outer))
    outer = bands.outer[:, None]
    growth = jnp.exp(lax.complex((0.5 + tau.imag) * outer, -tau.real * outer))
    each = growth * step_transform(tau, bands.length[:, None], bands.width[:, None])
    masses = bands.by_panel
    return Footprint(bands, masses.astype(each.dtype) @ each, jnp.sum(masses, axis=1))


def overlap(first: Bands, second: Bands) -> Float[Array, "2"]:
    """∫ of the product of two sums of bands, over each panel; both may contain points (length 0)."""
    a, b = first.outer[:, None], second.outer
    near = jnp.maximum(a, b)
    ends = a + first.length[:, None], b + second.length
    shared = -jnp.expm1(-jnp.maximum(jnp.minimum(*ends) - near, 0)) * jnp.exp(a + b - near)
    each = shared / (nonzero(first.width)[:, None] * nonzero(second.width))
    # A point sees the density of the band that it lies in. It stands for a narrow band that reaches on towards the
    # fold, so where another one begins or ends, it lies on that side.
    nudge = float(jnp.finfo(a.dtype).eps) ** 0.7
    for band, (begin, end, width), (point, length) in (
        (b, (b, ends[1], second.width), (a, first.length[:, None])),
        (a, (a, ends[0], first.width[:, None]), (b, second.length + jnp.zeros_like(a))),
    ):
        inside = (point + nudge >= begin) & (point + nudge < end)
        density = jnp.where(inside, jnp.exp(band), jnp.zeros_like(each)) / nonzero(width)
        each = jnp.where(length == 0, density, each)
    return jnp.einsum("pa,ab,pb->p", first.by_panel, each, second.by_panel)


def line_between(
    first: Bands, second: Bands, angle: Float[Array, ""], resolution: Resolution, whole: bool
) -> Complex[Array, "2 2 inner"]:
    """What two sums of bands have in common on the whole line, beside their overlap, by their panels.

    Args:
        first: bands.
        second: bands.
        angle: dihedral angle, radians.
        resolution: of the contour.
        whole: all bands are known to reach the fold.
    """
    each = _line(first, second, angle, resolution, whole)
    return jnp.einsum(
        "pa,abm,qb->pqm", first.by_panel.astype(each.dtype), each, second.by_panel.astype(each.dtype)
    )


def _line(
    first: Bands, second: Bands, angle: Float[Array, ""], resolution: Resolution, whole: bool
) -> Complex[Array, "first second inner"]:
    grid = contour(resolution)
    tau = constant(grid.tau[: grid.inner], lax.complex(first.outer, first.outer))
    a, b = first.outer[:, None, None], second.outer[None, :, None]
    if whole:
        gap = jnp.abs(a - b)
        return jnp.exp(lax.complex((a + b) / 2 + tau.imag * gap, -tau.real * gap))
    one = tuple(part[:, None, None] for part in (first.outer, first.length, first.width))
    two = tuple(part[None, :, None] for part in (second.outer, second.length, second.width))
    # The shorter band is treated in closed form, the longer one by its two ends.
    swap = two[1] > one[1]
    a, a_length, a_width = (jnp.where(swap, q, p) for p, q in zip(one, two, strict=True))
    b, b_length, b_width = (jnp.where(swap, p, q) for p, q in zip(one, two, strict=True))
    # Ends along a new first axis: one piece of code to compile for both.
    gap = a + jnp.stack([jnp.zeros_like(a_length), a_length]) - b
    before = jnp.clip(gap, 0, b_length)  # the part of b between an end and the rim
    lead, start = jnp.maximum(gap, 0), jnp.maximum(-gap, 0)
    passed = complex_expm1(tau.imag * before, -tau.real * before) - jnp.expm1(-before / 2).astype(tau.dtype)
    entered = -decay(tau, b_length - before)
    # A point is the limit of a narrow band.
    point, width = b_length == 0, nonzero(b_width).astype(tau.dtype)
    limits = (
        jnp.where(gap > 0, 0.5 - 1j * tau, jnp.zeros_like(tau)),
        jnp.where(gap > 0, jnp.zeros_like(tau), 0.5 + 1j * tau),
    )
    passed, entered = (
        jnp.where(point, limit, part / width) for limit, part in zip(limits, (passed, entered), strict=True)
    )
    ends = _wave(tau, lead - before, lead / 2) * passed + _wave(tau, start, lead - start / 2) * entered
    by_ends = jnp.exp(a).astype(tau.dtype) * (ends[0] - ends[1]) / nonzero(a_width).astype(tau.dtype)
    # Both narrow and close: k̂ being even, only the even part counts, and it does not grow as 1 / width.
    even = jnp.maximum(a + a_length, b + b_length) - jnp.minimum(a, b) < 0.2 * angle
    gap, a_length, b_length = (jnp.where(even, part, jnp.zeros_like(part)) for part in (a - b, a_length, b_length))
    ways = jnp.stack([tau, -tau])[:, None, None]
    there = jnp.exp(lax.complex(ways.imag * gap, -ways.real * gap))
    products = there * step_transform(ways, a_length, a_width) * step_transform(-ways, b_length, b_width)
    both_ways = jnp.exp((a + b) / 2).astype(tau.dtype) * jnp.sum(products, axis=0) / 2
    return jnp.where(even, both_ways, by_ends)


def _wave(tau: Array, distance: Array, damping: Array) -> Array:
    """exp(-iτ distance - damping)."""
    return jnp.exp(lax.complex(tau.imag * distance - damping, -tau.real * distance))
