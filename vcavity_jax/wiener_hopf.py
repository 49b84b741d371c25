"""Radiosity in a groove without a mesh: the resolvent between step functions, in closed form.

In t = -ln(distance from the fold) the radiosity equation of a groove is a convolution on a half line, whose
kernel has a known symbol k̂(τ). Wiener-Hopf factorization of 1 - κ k̂ gives every mean between two steps as a
short sum over one complex contour: no panel is divided, no system is solved, no shadow edge is resolved.
docs/lambertian.md derives the formulas; the letters follow it.

A step is the indicator of the part of a panel beyond a hidden depth y, divided by its length 1 - y, so that a
mean over a vanishing visible part stays accurate.
"""

import dataclasses
import math
from functools import lru_cache
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Complex, Float

FULL = 200.0
"""-ln of a depth that stands for zero: exp(-FULL/2) is nothing beside any double."""


@dataclasses.dataclass(frozen=True)
class Resolution:
    """How finely the contour and the path of the symbol are sampled, and how far they reach.

    Args:
        step: spacing on the contour, and on the path of the symbol.
        reach: end of the contour; what lies beyond decays as exp(-reach) relative to a rim layer.
        extent: largest Re τ times dihedral angle at which the symbol is not negligible.
        smallest_angle: the smallest dihedral angle that this resolution is made for, radians.
        tilt: of the contour, radians; the symbol must be analytic in the sector that it sweeps.
    """

    step: float
    reach: float
    extent: float
    smallest_angle: float
    tilt: float = 0.45


class Contour(NamedTuple):
    """Half of the contour; the other half is its image under τ → -conj τ, where everything conjugates.

    ``cauchy`` is the Cauchy kernel 1/(i(τ_l + τ_m)) over both halves, as a real matrix for stacked real and
    imaginary parts: half the products of complex arithmetic.
    """

    tau: np.ndarray
    weight: np.ndarray
    inner: int
    cauchy: np.ndarray


SYMBOL_TILT, SYMBOL_END = 0.9, 30.0


def multiple_of_four(count: float) -> int:
    """The next multiple of four: XLA computes others element by element, which takes several times as long."""
    return 4 * math.ceil(count / 4)


@lru_cache(maxsize=64)
def contour(resolution: Resolution) -> Contour:
    """The contour τ = sinh(x - i tilt)/2 and its Cauchy kernel."""
    nodes = multiple_of_four(resolution.reach / resolution.step + 1)
    x = np.arange(nodes) * resolution.step - 1j * resolution.tilt
    tau, weight = np.sinh(x) / 2, resolution.step * np.cosh(x) / 2
    weight[0] /= 2
    end = np.arccosh(max(resolution.extent / (np.cos(resolution.tilt) / 2 * resolution.smallest_angle), 1.1))
    inner = min(multiple_of_four(end / resolution.step), nodes)
    here, mirrored = -1j / (tau[:, None] + tau), -1j / (tau[:, None] - tau.conj())
    both, difference = here + mirrored, here - mirrored
    cauchy = np.block([[both.real, -difference.imag], [both.imag, difference.real]])
    return Contour(tau, weight, inner, cauchy)


def within_extent(values: Complex[Array, "inner kappa"], angle: Float[Array, ""], resolution: Resolution) -> Array:
    """What is proportional to the symbol at the inner nodes, and 0 where nothing is left of it but rounding.

    A contour made for narrower grooves reaches on, and what is summed with it grows along the contour.
    """
    far = angle * constant(contour(resolution).tau.real, angle)[: len(values)] > resolution.extent
    return jnp.where(far[:, None], jnp.zeros_like(values), values)


def complex_expm1(x: Float[Array, "..."], y: Float[Array, "..."]) -> Complex[Array, "..."]:
    """exp(x + iy) - 1 without cancellation."""
    growth, sine, cosine = jnp.expm1(x), jnp.sin(y / 2), jnp.cos(y / 2)
    turn = 2 * sine * sine
    return lax.complex(growth * (1 - turn) - turn, (growth + 1) * 2 * sine * cosine)


def constant(values: np.ndarray, like: Array) -> Array:
    """Known numbers as an array of the dtype of another."""
    return jnp.asarray(values, like.dtype)


class Factorization(NamedTuple):
    """What is known of (1 - κK)⁻¹ for each κ, shapes (contour, κ) or (κ,).

    ``mean`` is G, the mean of the response to uniform light; ``rim`` its value √G at the rim; ``edge`` the
    weights c of the edge correction, ``whole`` those of the whole line. ``angle`` is the dihedral angle.
    """

    mean: Float[Array, " kappa"]
    rim: Float[Array, " kappa"]
    edge: Complex[Array, "nodes kappa"]
    whole: Complex[Array, "inner kappa"]
    angle: Float[Array, ""]


def factorize(
    complement: Complex[Array, " inner"],
    kappa: Float[Array, " kappa"],
    angle: Float[Array, ""],
    resolution: Resolution,
) -> Factorization:
    """Factor 1 - κ k̂ on the contour.

    Args:
        complement: 1 - k̂(τ) at the inner nodes of the contour, free of cancellation.
        kappa: -1 to 1, shape (K,).
        angle: dihedral angle, radians; the symbol decays as exp(-angle τ).
        resolution: of the contour.
    """
    factor = (1 - kappa).astype(complement.dtype) + kappa.astype(complement.dtype) * complement[:, None]
    return factorize_symbol(factor, angle, resolution)


def factorize_symbol(
    factor: Complex[Array, "inner kappa"], angle: Float[Array, ""], resolution: Resolution
) -> Factorization:
    """The same for 1 - κ k̂ itself at the inner nodes of the contour."""
    grid = contour(resolution)
    tau, weight = constant(grid.tau, factor), constant(grid.weight, factor)
    inner_tau, inner_weight = tau[: grid.inner], weight[: grid.inner]
    logarithm = jnp.log(factor)
    weighted = logarithm * inner_weight[:, None]
    rim = jnp.exp(-jnp.sum(weighted / (inner_tau - 0.5j)[:, None], axis=0).imag / jnp.pi)
    exponent = over_both_halves(grid, weighted) / (2 * jnp.pi)
    exponent = exponent.at[: grid.inner].add(-logarithm)
    edge = (weight / (2 * jnp.pi * (0.5 + 1j * tau)))[:, None] * complex_expm1(exponent.real, exponent.imag)
    symbol = within_extent(1 - factor, angle, resolution)
    whole = (inner_weight / (2 * jnp.pi * (0.25 + inner_tau * inner_tau)))[:, None] * symbol / factor
    return Factorization(rim * rim, rim, edge, whole, angle)


def log_distance(depth: Float[Array, "..."], visible: Float[Array, "..."]) -> Float[Array, "..."]:
    """-ln y of a hidden depth, from 1 - y where that is the accurate one; FULL for y = 0."""
    hidden = depth > 0
    near_rim = visible < 0.5
    safe = jnp.where(hidden & ~near_rim, depth, jnp.ones_like(depth))
    from_rim = -jnp.log1p(-jnp.where(hidden & near_rim, visible, jnp.zeros_like(visible)))
    return jnp.where(hidden, jnp.minimum(jnp.where(near_rim, from_rim, -jnp.log(safe)), FULL), FULL)


def decay(tau: Array, distance: Float[Array, "..."]) -> Complex[Array, "... nodes"]:
    """exp(-(1/2 + iτ) a) - 1 over the contour."""
    return complex_expm1(-(0.5 - tau.imag) * distance, -tau.real * distance)


def step_transform(
    tau: Array, distance: Float[Array, "..."], visible: Float[Array, "..."]
) -> Complex[Array, "... nodes"]:
    """Transform of a step, (1 - y^(1/2 + iτ)) / (1 - y); at the rim (y = 1) its limit 1/2 + iτ."""
    rim = visible == 0
    quotient = -decay(tau, distance) / jnp.where(rim, jnp.ones_like(visible), visible).astype(tau.dtype)
    return jnp.where(rim, 0.5 + 1j * tau, quotient)


def step_mean(
    factors: Factorization, distance: Float[Array, ""], visible: Float[Array, ""], resolution: Resolution
) -> Float[Array, " kappa"]:
    """⟨step, (1 - κK)⁻¹ 1⟩: the mean response to uniform light, over the part beyond the hidden depth.

    One single sum. G where nothing is hidden, √G at the rim.

    Args:
        factors: of the groove.
        distance: -ln y, see ``log_distance``.
        visible: 1 - y.
        resolution: the one of ``factors``.
    """
    tau = constant(contour(resolution).tau, factors.edge)
    rim = visible == 0
    growth = complex_expm1((0.5 + tau.imag) * distance, -tau.real * distance)
    scale = jnp.exp(-distance) / jnp.where(rim, jnp.ones_like(visible), visible)
    ratio = jnp.where(rim, jnp.ones_like(tau), growth * scale.astype(tau.dtype) / (0.5 - 1j * tau))
    return factors.mean - 2 * factors.rim * (ratio @ factors.edge).real


def edge_field(
    factors: Factorization, distance: Float[Array, ""], visible: Float[Array, ""], resolution: Resolution
) -> Complex[Array, "nodes kappa"]:
    """The edge correction of one step as a function on the contour; pair it with another step's transform."""
    grid = contour(resolution)
    tau = constant(grid.tau, factors.edge)
    weighted = step_transform(tau, distance, visible)[:, None] * factors.edge
    return factors.edge * over_both_halves(grid, weighted)


def over_both_halves(grid: Contour, weighted: Complex[Array, "n kappa"]) -> Complex[Array, "nodes kappa"]:
    """Σ weighted_l / (i(τ_l + τ_m)) over both halves of the contour, for given values on the first nodes."""
    count, nodes = weighted.shape[0], len(grid.tau)
    kernel = np.concatenate([grid.cauchy[:, :count], grid.cauchy[:, nodes : nodes + count]], axis=1)
    stacked = jnp.concatenate([weighted.real, weighted.imag])
    real, imaginary = jnp.split(jnp.asarray(kernel, stacked.dtype) @ stacked, 2)
    return lax.complex(real, imaginary)


def step_step(
    factors: Factorization,
    field: Complex[Array, "nodes kappa"],
    first: tuple[Float[Array, ""], Float[Array, ""]],
    second: tuple[Float[Array, ""], Float[Array, ""]],
    resolution: Resolution,
) -> Float[Array, " kappa"]:
    """⟨step, (1 - κK)⁻¹ step'⟩, symmetric in the two steps.

    Args:
        factors: of the groove.
        field: ``edge_field`` of the first step.
        first: (-ln y, 1 - y) of the first step.
        second: the same of the second.
        resolution: the one of ``factors``.
    """
    grid = contour(resolution)
    tau = constant(grid.tau, factors.edge)
    inner = tau[: grid.inner]
    edge = 2 * (step_transform(tau, *second) @ field).real
    order = first[0] >= second[0]
    deep = tuple(jnp.where(order, a, b) for a, b in zip(first, second, strict=True))
    near = tuple(jnp.where(order, b, a) for a, b in zip(first, second, strict=True))
    # Both narrow, k̂ being even: only the even part of the line counts, and it does not grow as 1 / width. On the
    # contour it is safe as long as the symbol decays faster than the cosines grow.
    even = deep[0] < 0.2 * factors.angle
    a, b = (jnp.where(even, d, jnp.zeros_like(d)) for d in (deep[0], near[0]))
    both_ways = (_line(inner, a, b, near[1]) + _line(-inner, a, b, near[1])) / 2
    line = jnp.where(even, both_ways, _line(inner, deep[0], near[0], near[1]))
    touching = deep[0] < 1e-7 * factors.angle
    line = jnp.where(touching, 0.25 + inner * inner, line / nonzero(deep[1]).astype(tau.dtype))
    return 1 / nonzero(deep[1]) + 2 * (line @ factors.whole).real - edge


def _line(
    tau: Array, deep: Float[Array, ""], near: Float[Array, ""], visible: Float[Array, ""]
) -> Complex[Array, " nodes"]:
    """What two steps have in common on the whole line, times the width of the deeper one."""
    gap = deep - near
    passed = jnp.exp(lax.complex(tau.imag * gap - deep / 2, -tau.real * gap))
    difference = jnp.expm1(-near / 2).astype(tau.dtype) - complex_expm1(tau.imag * near, -tau.real * near)
    rim = visible == 0
    width = jnp.where(rim, jnp.ones_like(visible), visible).astype(tau.dtype)
    return step_transform(tau, near, visible) + passed * jnp.where(rim, -0.5 + 1j * tau, difference / width)


def step_response(
    factors: Factorization,
    field: Complex[Array, "nodes kappa"],
    step: tuple[Float[Array, ""], Float[Array, ""]],
    distance: Float[Array, ""],
    resolution: Resolution,
) -> Float[Array, " kappa"]:
    """(1 - κK)⁻¹ step at one distance from the fold; accurate to about 1e-16/√y for y → 0.

    Args:
        factors: of the groove.
        field: ``edge_field`` of the step.
        step: (-ln, 1 - ·) of its hidden depth.
        distance: -ln y of the position, y > 0.
        resolution: the one of ``factors``.
    """
    grid = contour(resolution)
    tau = constant(grid.tau, factors.edge)
    inner = tau[: grid.inner]
    shadow, visible = step
    growth = jnp.exp(distance / 2)
    # field carries c; its derivative in -ln y brings down 1/2 + iτ.
    wave = (0.5 + 1j * tau) * jnp.exp(lax.complex(tau.imag * distance, -tau.real * distance))
    edge = 2 * growth * (wave @ field).real
    dark = distance > shadow
    gap = jnp.abs(distance - shadow)
    across = jnp.exp(lax.complex(inner.imag * gap - shadow / 2, -inner.real * gap))
    outward = (0.5 + 1j * inner) * jnp.exp(lax.complex(inner.imag * distance, -inner.real * distance))
    inward = across * jnp.where(dark, 0.5 + 1j * inner, 0.5 - 1j * inner)
    line = 2 * growth * ((outward - inward) @ factors.whole).real
    return (jnp.where(dark, jnp.zeros_like(line), jnp.ones_like(line)) + line) / nonzero(visible) - edge


def nonzero(value: Float[Array, "..."]) -> Float[Array, "..."]:
    """A width below which the mean stops growing: it is infinite only where light and view both graze."""
    return jnp.maximum(value, jnp.asarray(float(jnp.finfo(value.dtype).eps) ** 0.75, value.dtype))


def mean_exchange(
    symbol: Complex[Array, " inner"], kappa: Float[Array, " kappa"], resolution: Resolution
) -> Float[Array, " kappa"]:
    """(G - 1) / κ, κ from 0 to 1; smooth down to κ = 0."""
    grid = contour(resolution)
    tau, weight = (constant(part[: grid.inner], symbol) for part in (grid.tau, grid.weight))
    kappa = jnp.maximum(kappa, float(jnp.finfo(kappa.dtype).tiny) ** 0.5)
    scaled = kappa.astype(symbol.dtype) * symbol[:, None]
    # ln(1 - κk̂), accurate for small κ too.
    excess = scaled.real * (scaled.real - 2) + scaled.imag * scaled.imag
    logarithm = lax.complex(jnp.log1p(excess) / 2, -jnp.arctan2(scaled.imag, 1 - scaled.real))
    summed = jnp.sum(logarithm * (weight / (tau - 0.5j))[:, None], axis=0).imag
    return jnp.expm1(-2 * summed / jnp.pi) / kappa


def edge_between(
    first: Complex[Array, "nodes kappa"], second: Complex[Array, "nodes kappa"], resolution: Resolution
) -> Float[Array, " kappa"]:
    """The edge correction between two lights or views, given by their transforms times ``Factorization.edge``.

    Both are given on the whole contour or on its first nodes.
    """
    field = over_both_halves(contour(resolution), second)
    return 2 * jnp.sum((first * field[: len(first)]).real, axis=0)
