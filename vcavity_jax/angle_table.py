"""Bi-hemispherical reflectance of randomly grooved mirrors: a table in the groove angle, and its averages.

R_m = ∫ p(u) R̄(α(u)) du with α = 2 atan2(1, m u). R̄ is analytic on each [π/(k+1), π/k]: there it is interpolated
on Chebyshev nodes, in blocks, short ones at the upper end, since hard mirrors change fast where another reflection
sets in. The average over the interpolant is a weighted sum of the values at the nodes; the weights alone depend
on the roughness, the values on the material.

Where total external reflection begins abruptly (n < 1, k small), R̄ has weak singularities elsewhere too, and the
averages are good to 1e-4 or so whatever the resolution.
"""

import dataclasses
from functools import lru_cache

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Float, Inexact

from vcavity_jax.bihemispherical import forward_specular, index_parts, unit_legendre
from vcavity_jax.quadrature import chebyshev
from vcavity_jax.resolution import AngleTableResolution, BihemisphericalResolution
from vcavity_jax.roughness import Slopes, density, groove_angle
from vcavity_jax.safe import elementwise_forward, floor_of
from vcavity_jax.scene import Polarization

_AT_ONCE = 4
"""Angles that are evaluated side by side."""

_UPPER = 0.15
"""By how much the blocks between π/(k+1) and π/k shorten towards the upper end."""


@dataclasses.dataclass(frozen=True)
class _Block:
    """A range of angles on which R̄ is smooth, with M reflections at most."""

    most: int
    lower: float
    upper: float
    nodes: int

    @property
    def angles(self) -> np.ndarray:
        x = np.cos(np.pi * (np.arange(self.nodes) + 0.5) / self.nodes)
        return (self.lower + self.upper) / 2 + (self.upper - self.lower) / 2 * x

    @property
    def slopes(self) -> tuple[float, float]:
        """Facet slopes at the upper and at the lower end; exactly 0 where the surface is flat."""
        flat = self.upper == np.pi
        return 0.0 if flat else float(1 / np.tan(self.upper / 2)), float(1 / np.tan(self.lower / 2))

    @property
    def to_nodes(self) -> np.ndarray:
        """From Chebyshev polynomials at a point to the weights of the nodes there: (degrees, nodes)."""
        order = np.arange(self.nodes)
        matrix = 2 / self.nodes * np.cos(np.pi * order[:, None] * (order + 0.5) / self.nodes)
        matrix[0] /= 2
        return matrix


@lru_cache(maxsize=32)
def _blocks(resolution: AngleTableResolution) -> tuple[_Block, ...]:
    """From the flat surface down to the narrowest grooves."""
    blocks: list[_Block] = []
    k = 1
    while k == 1 or 1 / np.tan(np.pi / (2 * k)) < resolution.steepest:
        lower, upper = np.pi / (k + 1), np.pi / k
        cuts = [upper - _UPPER**power * (upper - lower) for power in range(resolution.gradings, -1, -1)]
        few, near = resolution.nodes(k + 1)
        blocks += [
            _Block(k + 1, end, start, few if end == cuts[-1] else near)
            for start, end in zip([upper, *cuts], cuts, strict=False)
        ]
        k += 1
    return tuple(blocks)


@lru_cache(maxsize=32)
def _static_weights(resolution: AngleTableResolution) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """For the blocks below 90 degrees: slopes (blocks, q), matrices (blocks, nodes, q), positions of the nodes."""
    blocks = [b for b in _blocks(resolution) if b.most > 2]
    q = int(max((b.nodes for b in blocks), default=4) // 2 + 12 + resolution.digits)
    longest = max((b.nodes for b in blocks), default=1)
    node, weight = unit_legendre(q)
    slopes, matrices = np.zeros((len(blocks), q)), np.zeros((len(blocks), longest, q))
    positions = []
    for i, block in enumerate(blocks):
        start, end = block.slopes
        slopes[i] = start + (end - start) * node
        x = (4 * np.arctan2(1, slopes[i]) - block.lower - block.upper) / (block.upper - block.lower)
        polynomials = np.polynomial.chebyshev.chebvander(x, block.nodes - 1).T
        matrices[i, : block.nodes] = block.to_nodes.T @ polynomials * (end - start) * weight
        positions.append(i * longest + np.arange(block.nodes))
    return slopes, matrices, np.concatenate([np.zeros(0, np.int32), *positions]).astype(np.int32)


def _weights(
    roughness: Float[Array, ""], resolution: AngleTableResolution, slopes: Slopes
) -> Float[Array, " nodes"]:
    """Weights of the node values in the average; they sum to 1."""
    m = jnp.maximum(roughness, floor_of(roughness))
    parts = []
    for block in (b for b in _blocks(resolution) if b.most == 2):
        # Flat surfaces crowd within m of α = π: here the nodes follow the roughness, below they need not.
        start, end = (jnp.minimum(slope / m, resolution.cutoff) for slope in block.slopes)
        node, weight = (
            jnp.asarray(a, m.dtype) for a in unit_legendre(int(block.nodes // 2 + 24 + 2 * resolution.digits))
        )
        u = start + (end - start) * node
        x = (2 * groove_angle(roughness, u) - block.lower - block.upper) / (block.upper - block.lower)
        weight = (end - start) * weight * density(u, slopes)
        parts.append((chebyshev(x, block.nodes) @ weight) @ jnp.asarray(block.to_nodes, m.dtype))
    steep, matrices, positions = _static_weights(resolution)
    if len(positions):
        # The slopes exceed 1: a roughness as small as this leaves nothing there.
        m = jnp.maximum(roughness, 0.5 / resolution.cutoff)
        p = density(jnp.asarray(steep, m.dtype) / m, slopes) / m
        padded = jnp.einsum("bnq,bq->bn", jnp.asarray(matrices, m.dtype), p)
        parts.append(jnp.ravel(padded)[positions])
    weights = jnp.concatenate(parts)
    # What lies beyond the cutoff, a tenth of the tolerance, is spread over the rest.
    return weights / jnp.sum(weights)


def _values(
    steepest: Float[Array, ""], index: Inexact[Array, " w"], model: Polarization, resolution: AngleTableResolution
) -> Float[Array, "nodes w"]:
    """R̄ at the nodes of all blocks that begin below a facet slope, 0 elsewhere."""
    blocks = _blocks(resolution)
    wide = tuple(b for b in blocks if b.most <= 3)
    groups = [(wide, resolution.wide), (blocks[len(wide) :], resolution.narrow)]
    if blocks[-1].most <= 8:
        groups = [(blocks, resolution.wide)]  # Too few narrow grooves to be worth another program.

    def run(steepest: Array, *parts: Array) -> Array:
        limit = jnp.max(steepest)
        return jnp.concatenate([_group_values(limit, parts, model, *group) for group in groups if group[0]])

    return elementwise_forward(run, nested=True)(lax.stop_gradient(steepest), *index_parts(index))


def _group_values(
    limit: Array,
    parts: tuple[Array, ...],
    model: Polarization,
    blocks: tuple[_Block, ...],
    resolution: BihemisphericalResolution,
) -> Array:
    dtype = parts[0].dtype
    angles = np.concatenate([b.angles for b in blocks])
    counts = np.concatenate([np.full(b.nodes, b.most) for b in blocks])
    start = np.concatenate([np.full(b.nodes, b.slopes[0]) for b in blocks])
    size = len(angles)
    padding = (0, -size % _AT_ONCE)
    angle, count = (jnp.asarray(np.pad(a, padding, mode="edge"), dtype)[:, None] for a in (angles, counts))
    needed = jnp.sum(jnp.asarray(start[::_AT_ONCE], dtype) <= limit) * _AT_ONCE

    def body(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        first, values = carry
        chunk_angle, chunk_count = (lax.dynamic_slice_in_dim(a, first, _AT_ONCE) for a in (angle, count))
        new = forward_specular(chunk_count, chunk_angle, parts, model, resolution)
        return first + _AT_ONCE, lax.dynamic_update_slice_in_dim(values, new, first, 0)

    values = jnp.zeros((len(angle), *jnp.broadcast_shapes(*(p.shape for p in parts))), dtype)
    return lax.while_loop(lambda carry: carry[0] < needed, body, (jnp.zeros((), needed.dtype), values))[1][:size]


def average(
    roughness: Float[Array, ""],
    index: Inexact[Array, " w"],
    model: Polarization,
    resolution: AngleTableResolution,
    slopes: Slopes = "beckmann",
) -> Float[Array, " w"]:
    """Bi-hemispherical reflectance of a randomly grooved mirror; only the angles that occur are evaluated.

    Args:
        roughness: m ≥ 0; at 0 the value and the gradient are the limits.
        index: n + ik; real only if n ≥ 1.
        model: treatment of polarization.
        resolution: from ``resolution.angle_table_resolution``, for at least this roughness.
        slopes: distribution of the facet slopes.
    """
    values = _values(roughness * resolution.cutoff, index, model, resolution)
    return _weights(roughness, resolution, slopes) @ values


class BihemisphericalTable(eqx.Module):
    """Bi-hemispherical reflectance of one material for all groove angles down to the narrowest that matters.

    Args:
        values: at the nodes of all blocks; build it with ``BihemisphericalTable.build``.
        resolution: where the nodes are.
    """

    values: Float[Array, "nodes w"]
    resolution: AngleTableResolution = eqx.field(static=True)

    @classmethod
    def build(
        cls, index: Inexact[Array, " w"], model: Polarization, resolution: AngleTableResolution
    ) -> "BihemisphericalTable":
        """Evaluate the reflectance at all nodes.

        Args:
            index: n + ik; real only if n ≥ 1.
            model: treatment of polarization.
            resolution: from ``resolution.angle_table_resolution``.
        """
        return cls(_values(jnp.full((), jnp.inf, index.real.dtype), index, model, resolution), resolution)

    def average(self, roughness: ArrayLike, slopes: Slopes = "beckmann") -> Float[Array, " w"]:
        """The same as ``average``, up to the roughness for which the table was built.

        Args:
            roughness: m ≥ 0.
            slopes: distribution of the facet slopes.
        """
        return _weights(jnp.asarray(roughness, self.values.dtype), self.resolution, slopes) @ self.values

    def at(self, angle: ArrayLike) -> Float[Array, " w"]:
        """Reflectance of grooves of one dihedral angle, interpolated.

        Args:
            angle: radians, up to π, and at least the lower end of the table's last block; below, NaN.
        """
        angle = jnp.asarray(angle, self.values.dtype)
        blocks = _blocks(self.resolution)
        nodes = np.array([b.nodes for b in blocks])
        ends = jnp.asarray([[b.lower, b.upper] for b in blocks], angle.dtype)
        block = jnp.searchsorted(-ends[:, 0], -lax.stop_gradient(angle))
        inside = block < len(blocks)
        block = jnp.minimum(block, len(blocks) - 1)
        lower, upper = ends[block, 0], ends[block, 1]
        x = (2 * angle - lower - upper) / (upper - lower)
        longest = int(nodes.max())
        matrices = np.zeros((len(blocks), longest, longest))
        for i, b in enumerate(blocks):
            matrices[i, : b.nodes, : b.nodes] = b.to_nodes
        weights = chebyshev(x, longest) @ jnp.asarray(matrices, angle.dtype)[block]
        first = jnp.asarray(np.cumsum(nodes) - nodes)[block]
        padded = jnp.pad(self.values, ((0, longest), (0, 0)))
        value = weights @ lax.dynamic_slice_in_dim(padded, first, longest)
        return jnp.where(inside, value, jnp.full_like(value, jnp.nan))
