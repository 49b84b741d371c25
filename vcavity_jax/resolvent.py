"""(1 - K)⁻¹ of a groove whose panels may exchange light with each other and with themselves.

What is alike on both panels and what is opposite are two problems of one panel, if the panels are alike. If they
differ, those two are coupled: the symbol is a 2 × 2 matrix, which an iteration factors on the contour, starting
from the mean panel [docs/interfaced.md].

Matrices are 2 × 2 tuples by parity (alike, opposite); None stands for zero.
"""

import itertools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Complex, Float, Inexact

from vcavity_jax import wiener_hopf
from vcavity_jax.bands import Footprint, line_between, overlap
from vcavity_jax.interfaced import Exchange
from vcavity_jax.wiener_hopf import Resolution, constant, contour, over_both_halves

Entries = tuple[tuple[Array | None, Array | None], tuple[Array | None, Array | None]]
Vector = tuple[Array | None, Array | None]

_STEPS = 12
"""Of the iteration; each wins a digit or more."""


def _plus(terms: Sequence[Array | None]) -> Array | None:
    present = [term for term in terms if term is not None]
    return sum(present[1:], start=present[0]) if present else None


def _times(a: Array | None, b: Array | None) -> Array | None:
    return None if a is None or b is None else a * b


def _product(a: Entries, b: Entries) -> Entries:
    rows = [[_plus([_times(a[i][k], b[k][j]) for k in (0, 1)]) for j in (0, 1)] for i in (0, 1)]
    return (rows[0][0], rows[0][1]), (rows[1][0], rows[1][1])


def _apply(a: Entries, v: Vector) -> Vector:
    first, second = (_plus([_times(row[k], v[k]) for k in (0, 1)]) for row in a)
    return first, second


def _transposed(a: Entries) -> Entries:
    return (a[0][0], a[1][0]), (a[0][1], a[1][1])


def _each(function, *a: Entries) -> Entries:  # type: ignore[no-untyped-def]
    """A function of all entries that are there."""
    rows = [
        [None if a[0][i][j] is None else function(*(m[i][j] for m in a), float(i == j)) for j in (0, 1)]
        for i in (0, 1)
    ]
    return (rows[0][0], rows[0][1]), (rows[1][0], rows[1][1])


def _inverse(a: Entries) -> Entries:
    (p, q), (r, s) = a
    if q is None or r is None or p is None or s is None:
        return _each(lambda entry, _: 1 / entry, a)
    determinant = 1 / (p * s - q * r)
    return (s * determinant, -q * determinant), (-r * determinant, p * determinant)


class Resolvent(NamedTuple):
    """(1 - K)⁻¹ of a groove.

    Args:
        edge: weights of the edge correction, as ``wiener_hopf.Factorization.edge``: of X₊ on the contour.
        whole: the same of the whole line.
        rim: X₊(i/2).
        root: √κ of the two panels, which weights what is lit and seen, shape (2, W); ones for alike panels,
            whose κ is a common factor.
        angle: dihedral angle, radians.
    """

    edge: Entries
    whole: Entries
    rim: Entries
    root: Float[Array, "2 w"]
    angle: Float[Array, ""]


def of_alike_panels(
    exchange: Exchange, kappa: Float[Array, " w"], angle: Float[Array, ""], resolution: Resolution, balanced: bool
) -> Resolvent:
    """Panels of the same κ; balanced: nothing opposite is ever lit or seen."""
    signs = (-1,) if balanced else (-1, 1)
    parts = [
        wiener_hopf.factorize(1 + sign * exchange.cross - exchange.same, kappa, angle, resolution)
        for sign in signs
    ]

    def diagonal(name: str) -> Entries:
        return (getattr(parts[0], name), None), (None, None if balanced else getattr(parts[1], name))

    return Resolvent(diagonal("edge"), diagonal("whole"), diagonal("rim"), jnp.ones((2, 1), kappa.dtype), angle)


def of_unlike_panels(
    exchange: Exchange, kappa: Float[Array, "2 w"], angle: Float[Array, ""], resolution: Resolution
) -> Resolvent:
    """Panels of two κ, both above 0: a 2 × 2 symbol, factored by iteration.

    With X the factor of the mean panel and D what couples the alike to the opposite, the factor F satisfies
    F₊ = X₊ (1 + [X₋ D F₊]₊). The plus part follows on the contour from values on its mirror image, and there from
    values on the contour: two Cauchy sums over the few nodes where D has not decayed.
    """
    grid = contour(resolution)
    tau, weight = constant(grid.tau, exchange.cross), constant(grid.weight, exchange.cross)
    inner = grid.inner
    root = jnp.sqrt(kappa)
    mean, half, coupled = ((kappa[0] + kappa[1]) / 2, (kappa[0] - kappa[1]) / 2, root[0] * root[1])
    same, cross = exchange.same[:, None], exchange.cross[:, None]

    def typed(value: Array) -> Array:
        return value.astype(same.dtype)

    diagonal = [typed(mean) * same + sign * typed(coupled) * cross for sign in (1, -1)]
    symbol: Entries = ((1 - diagonal[0], -typed(half) * same), (-typed(half) * same, 1 - diagonal[1]))
    start = [wiener_hopf.factorize_symbol(1 - entry, angle, resolution) for entry in diagonal]
    scaled = (weight / (2 * jnp.pi * (0.5 + 1j * tau)))[:, None]
    first = [1 + part.edge / scaled for part in start]
    near = [part[:inner] for part in first]
    far = [1 / ((1 - entry) * part) for entry, part in zip(diagonal, near, strict=True)]
    measure = weight[:inner, None] / (2 * jnp.pi)
    coupling = typed(half) * same

    def spread(values: Array) -> Array:
        """Cauchy integral over both halves of the contour, at the inner nodes."""
        return over_both_halves(grid, measure * values)[:inner]

    def swapped(left: Sequence[Array], values: Array) -> Array:
        return jnp.stack([left[p] * coupling * values[1 - p] for p in (0, 1)])

    def further(factor: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], None]:
        on, mirrored = factor  # by row and column, on the contour and on its mirror image
        ahead = jnp.stack([swapped(far, on[:, q]) for q in (0, 1)], axis=1)
        behind = jnp.stack([swapped(near, mirrored[:, q]) for q in (0, 1)], axis=1)
        corrected = one + ahead - jax.vmap(jax.vmap(spread))(behind)
        reflected = one + jax.vmap(jax.vmap(spread))(ahead)
        rows = jnp.stack(near)[:, None], jnp.stack(far)[:, None]
        return (rows[0] * corrected, rows[1] * reflected), None

    one = jnp.eye(2, dtype=same.dtype)[:, :, None, None] * jnp.ones_like(coupling)
    begin = jnp.stack(near)[:, None] * one, jnp.stack(far)[:, None] * one
    (on, mirrored), _ = lax.scan(further, begin, None, length=_STEPS)
    ahead = jnp.stack([swapped(far, on[:, q]) for q in (0, 1)], axis=1)
    behind = jnp.stack([swapped(near, mirrored[:, q]) for q in (0, 1)], axis=1)
    at_rim = (weight[:inner] / (2 * jnp.pi * 1j * (tau[:inner] - 0.5j)))[:, None]

    def plus(p: int, q: int) -> Array:
        outside = -over_both_halves(grid, measure * behind[p, q])
        return first[p] * (float(p == q) + outside.at[:inner].add(ahead[p, q]))

    def rim(p: int, q: int) -> Array:
        return start[p].rim * (float(p == q) + 2 * jnp.sum(at_rim * ahead[p, q], axis=0).real)

    line = (weight[:inner] / (2 * jnp.pi * (0.25 + tau[:inner] ** 2)))[:, None]
    return Resolvent(
        edge=_each(lambda entry, on_diagonal: scaled * (entry - on_diagonal), _entries(plus)),
        whole=_each(
            lambda entry, one: wiener_hopf.within_extent(line * (entry - one), angle, resolution), _inverse(symbol)
        ),
        rim=_entries(rim),
        root=root,
        angle=angle,
    )


def _entries(of: Callable[[int, int], Array]) -> Entries:
    return (of(0, 0), of(0, 1)), (of(1, 0), of(1, 1))


def by_parity(of: Resolvent, values: Inexact[Array, "2 ..."]) -> Vector:
    """What is alike and what is opposite of values on the two panels, weighted by √κ; last axis: wavelengths."""
    first, second = (of.root[i].astype(values.dtype) * values[i][..., None] for i in (0, 1))
    return first + second, None if of.edge[1][1] is None else first - second


def mean_over(of: Resolvent, seen: Footprint, source: Vector, resolution: Resolution) -> Float[Array, " w"]:
    """⟨seen, (1 - K)⁻¹ source⟩ for a source that is uniform on each panel; one single sum.

    Args:
        of: the groove.
        seen: a view.
        source: by parity, each of shape (W,), weighted by √κ as ``by_parity`` does, twice what a panel emits.
        resolution: of the contour.
    """
    tau = constant(contour(resolution).tau, seen.transform)
    ratio = (seen.transform - seen.mass.astype(tau.dtype)[:, None]) / (0.5 - 1j * tau)
    at_rim = _apply(_transposed(of.rim), source)
    uniform = _apply(of.rim, at_rim)
    total = []
    for p, (mass, deviation) in enumerate(zip(by_parity(of, seen.mass), by_parity(of, ratio), strict=True)):
        total.append(_times(mass, uniform[p]))
        for q in (0, 1):
            weights = of.edge[p][q]
            if weights is not None and deviation is not None:
                total.append(_times(2 * jnp.sum((deviation * weights).real, axis=0), at_rim[q]))
    found = _plus(total)
    assert found is not None
    return found / 2


def edge_field(of: Resolvent, what: Footprint) -> Vector:
    """A light or a view as the edge correction needs it, by parity, shape (nodes, W)."""
    return _apply(_transposed(of.edge), by_parity(of, what.transform))


def between(
    of: Resolvent,
    seen: Footprint,
    lit: Footprint,
    field: Vector,
    resolution: Resolution,
    whole: bool,
    direct: Float[Array, "2"] | None = None,
) -> Float[Array, " w"]:
    """⟨seen, (1 - K)⁻¹ lit⟩.

    Args:
        of: the groove.
        seen: a view.
        lit: a light.
        field: its ``edge_field``.
        resolution: of the contour.
        whole: all bands are known to reach the fold.
        direct: overlap of view and light on each panel, if it is known better than from the bands.
    """
    met = overlap(seen.bands, lit.bands) if direct is None else direct
    total = of.root[0] ** 2 * met[0] + of.root[1] ** 2 * met[1]
    line = line_between(seen.bands, lit.bands, of.angle, resolution, whole)
    sides = (1.0, 1.0), (1.0, -1.0)
    for p, q in itertools.product((0, 1), repeat=2):
        weights = of.whole[p][q]
        if weights is not None:
            for i, j in itertools.product((0, 1), repeat=2):
                both = sides[p][i] * sides[q][j] * of.root[i] * of.root[j]
                total += both * (line[i, j] @ weights).real
    for own, other in zip(edge_field(of, seen), field, strict=True):
        if own is not None and other is not None:
            total -= wiener_hopf.edge_between(own, other, resolution) / 2
    return total


def shaded(
    of: Resolvent,
    entering: tuple[Complex[Array, " inner"], Complex[Array, " inner"]],
    source: Vector,
    resolution: Resolution,
) -> tuple[Vector, Vector]:
    """(1 - K)⁻¹ K' source for another exchange K', which need not be symmetric: light that is no sum of bands.

    Args:
        of: the groove.
        entering: symbol of K' at τ and at -τ; what it sends to both panels is the same.
        source: uniform on each panel, by parity, shape (W,).
        resolution: of the contour.

    Returns:
        Φ, with ⟨seen, (1 - K)⁻¹ K' source⟩ = Σ Re Σ transform Φ over the parities; and d, of which the
        quadratic form of K' source is Σ Re Σ d C d.
    """
    grid = contour(resolution)
    tau, weight = constant(grid.tau, entering[0]), constant(grid.weight, entering[0])
    scaled = (weight / (2 * jnp.pi * (0.5 + 1j * tau)))[:, None]
    inner, measure = tau[: grid.inner, None], weight[: grid.inner, None] / (2 * jnp.pi)
    plus = _each(lambda entry, on_diagonal: on_diagonal + entry / scaled, of.edge)
    near = _each(lambda entry, _: entry[: grid.inner], plus)
    resolvent = _each(lambda entry, one: one + entry * (0.25 + inner * inner) / measure, of.whole)
    typed = tuple(None if s is None else s.astype(inner.dtype) for s in source)
    ahead = tuple(_times(entering[0][:, None] / (0.5 - 1j * inner), s) for s in typed)
    behind = tuple(_times(measure * entering[1][:, None] / (0.5 + 1j * inner), s) for s in typed)
    answered = _apply(resolvent, (ahead[0], ahead[1]))
    returned = _apply(_transposed(near), (behind[0], behind[1]))
    # Of X₊ = 1 + (X₊ - 1) the first part adds nothing: the contour can be closed where it is analytic.
    turned = [None if part is None else over_both_halves(grid, part) for part in returned]
    edge = _apply(of.edge, (turned[0], turned[1]))
    phi = [
        None if a is None or e is None else (-e).at[: grid.inner].add(scaled[: grid.inner] * a)
        for a, e in zip(answered, edge, strict=True)
    ]
    forward = _apply(_inverse(near), answered)
    square = [None if f is None else measure * f for f in forward]
    return (phi[0], phi[1]), (square[0], square[1])


def with_shaded(seen: Vector, phi: Vector) -> Float[Array, " w"]:
    """⟨seen, (1 - K)⁻¹ K' source⟩ from a view's transforms by parity and ``shaded``'s Φ."""
    found = _plus(
        [None if s is None or p is None else jnp.sum((s * p).real, axis=0) for s, p in zip(seen, phi, strict=True)]
    )
    assert found is not None
    return found


def square_of_shaded(d: Vector, resolution: Resolution) -> Float[Array, " w"]:
    """⟨K' source, (1 - K)⁻¹ K' source⟩ from ``shaded``'s d."""
    found = _plus([None if part is None else wiener_hopf.edge_between(part, part, resolution) / 2 for part in d])
    assert found is not None
    return found
