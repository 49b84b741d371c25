"""Quadrature in one variable for what is smooth but for known places.

Gauss-Legendre panels end at the kinks of an integrand: as many as there are, known or not. Clustered nodes serve
intervals at whose ends the integrand is singular.
"""

import dataclasses
from collections.abc import Callable
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Inexact

_PANELS_AT_ONCE = 8


def of_one_rank(*arrays: Inexact[Array, "..."]) -> tuple[Inexact[Array, "..."], ...]:
    """Arrays that broadcast against each other, all of one rank: so an axis of nodes can stand before them."""
    rank = max(jnp.ndim(array) for array in arrays)
    return tuple(jnp.reshape(array, (*(1,) * (rank - jnp.ndim(array)), *jnp.shape(array))) for array in arrays)


def legendre_nodes(
    start: Float[Array, "..."], end: Float[Array, "..."], order: int
) -> tuple[Float[Array, "... nodes"], Float[Array, "... nodes"]]:
    """Gauss-Legendre nodes and weights of panels."""
    x, weight = np.polynomial.legendre.leggauss(order)
    half = (end - start)[..., None] / 2
    nodes = (start + end)[..., None] / 2 + half * jnp.asarray(x, start.dtype)
    return nodes, half * jnp.asarray(weight, start.dtype)


def sorted_panels(
    marks: Float[Array, "... marks"], start: float | Float[Array, ""], end: float | Float[Array, ""]
) -> Float[Array, "ends ..."]:
    """Ends of panels that cover a range: the marks within it, sorted; all others are left behind its end."""
    inside = (marks > start) & (marks < end)
    ends = jnp.sort(jnp.where(inside, marks, jnp.full_like(marks, end)), axis=-1)
    first = jnp.full_like(ends, start, shape=(*ends.shape[:-1], 1))
    padding = jnp.full_like(ends, end, shape=(*ends.shape[:-1], 1 + (-(ends.shape[-1] + 1)) % _PANELS_AT_ONCE))
    return jnp.moveaxis(jnp.concatenate([first, ends, padding], axis=-1), -1, 0)


def sum_over_panels(
    integrand: Callable[[Float[Array, "nodes ..."]], Float[Array, "nodes ..."]],
    ends: Float[Array, "ends ..."],
    order: int,
    finer: int | None = None,
    finer_panels: int = 0,
) -> Float[Array, "..."]:
    """Integral over panels, one loop that stops where all that is left is empty.

    The loop is differentiable in forward mode only (``safe.elementwise_forward`` mends that). Nodes run along the
    first axis: wavelengths, in which nothing of the geometry changes, are best left the last one.

    Args:
        integrand: of nodes.
        ends: of ``sorted_panels``.
        order: nodes per panel.
        finer: nodes of the first panels, at least ``finer_panels`` of them; None for none.
        finer_panels: how many.
    """
    last, panels = ends[-1], ends.shape[0] - 1
    shape = jax.eval_shape(integrand, ends[:1]).shape[1:]

    def add(first: int, stop: int, nodes: int, total: Array) -> Array:
        def body(carry: tuple[Array, Array]) -> tuple[Array, Array]:
            start, total = carry
            chunk = lax.dynamic_slice_in_dim(ends, start, _PANELS_AT_ONCE + 1)
            x, weight = (jnp.moveaxis(a, -1, 1) for a in legendre_nodes(chunk[:-1], chunk[1:], nodes))
            x, weight = (jnp.reshape(a, (-1, *a.shape[2:])) for a in (x, weight))
            return start + _PANELS_AT_ONCE, total + jnp.sum(weight * integrand(x), axis=0)

        def unfinished(carry: tuple[Array, Array]) -> Array:
            here = lax.dynamic_index_in_dim(ends, jnp.minimum(carry[0], panels), keepdims=False)
            return (carry[0] < stop) & jnp.any(here < last)

        return lax.while_loop(unfinished, body, (jnp.asarray(first), total))[1]

    total = jnp.zeros(shape, ends.dtype)
    split = min(-(-finer_panels // _PANELS_AT_ONCE) * _PANELS_AT_ONCE, panels) if finer else 0
    if finer and split:
        total = add(0, split, finer, total)
    return add(split, panels, order, total)


def chebyshev(x: Float[Array, "..."], count: int) -> Float[Array, "count ..."]:
    """Chebyshev polynomials, twice as many in every step: T(m+j) = 2 T(m) T(j) - T(m-j). Smooth at the ends."""
    terms = jnp.stack([jnp.ones_like(x), x])
    while len(terms) < count:
        terms = jnp.concatenate([terms, 2 * terms[-1] * terms[1:] - terms[-2::-1]])
    return terms[:count]


@dataclasses.dataclass(frozen=True)
class Clustering:
    """A quadrature whose nodes cluster at the ends of an interval, for integrands that are singular there.

    Args:
        step: spacing in x, where the distances to the ends go as exp(-π sinh |x|).
        reach: largest |x|.
    """

    step: float
    reach: float


@lru_cache(maxsize=64)
def clustered(clustering: Clustering, half: bool) -> tuple[np.ndarray, np.ndarray]:
    """Nodes from 0 to 1 and weights of sum 1; half: for even integrands, they cluster at 1 alone."""
    count = int(np.ceil(clustering.reach / clustering.step))
    x = np.arange(0 if half else -count, count + 1) * clustering.step
    weight = np.cosh(x) / np.cosh(np.pi / 2 * np.sinh(x)) ** 2
    if half:
        weight[0] /= 2
    nodes = np.tanh(np.pi / 2 * np.sinh(x)) if half else 1 / (1 + np.exp(-np.pi * np.sinh(x)))
    return nodes, weight / np.sum(weight)


def clustered_nodes(
    start: Float[Array, "..."], end: Float[Array, "..."], clustering: Clustering, half: bool = False
) -> tuple[Float[Array, "... nodes"], Float[Array, "... nodes"]]:
    """Nodes and weights of intervals, clustered at both ends.

    Args:
        start: of the intervals.
        end: of the intervals.
        clustering: how finely, see ``resolution.clustering``.
        half: the integrand is even about the start and smooth there: half the nodes, clustered at the end.
    """
    nodes, weight = (jnp.asarray(a, start.dtype) for a in clustered(clustering, half))
    length = (end - start)[..., None]
    return start[..., None] + length * nodes, length * weight
