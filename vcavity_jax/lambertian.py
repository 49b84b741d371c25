"""Mean radiance of a V-groove with diffusing panels, for any light and view, in closed form.

Kernel, symbol and how panels, light and view are put together; the resolvent itself is in ``wiener_hopf``.
Scenes whose panels are fully lit and fully seen need G alone, one real sum. docs/lambertian.md derives it.
"""

import dataclasses
import math
from functools import lru_cache
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Complex, Float

from vcavity_jax import wiener_hopf
from vcavity_jax.quadrature import chebyshev
from vcavity_jax.wiener_hopf import Factorization, Resolution, complex_expm1


@dataclasses.dataclass(frozen=True)
class MeanResolution:
    """Sampling of the real sums for G.

    Args:
        step: spacing in asinh(2τ).
        reach: largest asinh(2τ).
        smallest_angle: down to which the symbol is tabulated, radians.
        precision: of the symbol, relative.
    """

    step: float
    reach: float
    smallest_angle: float
    precision: float


_OSCILLATING = 8.0
"""τ beyond which the symbol is summed on a shifted path, where it decays instead of oscillating."""

_SHIFT = np.pi / 4
"""How far that path is shifted: half way to the nearest singularity."""

_DIGITS = 38.0
"""-ln of the error of the symbol's own sum, for grooves of 40°; narrower ones need more."""

_MOST_TERMS = 160


def _symbol(angle: np.ndarray, tau: np.ndarray, smallest_angle: float) -> np.ndarray:
    """1 - k̂ of many angles and τ, without cancellation, to the last digits, shape (angles, τ)."""
    digits = _DIGITS + 3 * max(math.log(math.radians(40) / smallest_angle), 0)
    step = 4.4 / digits
    w = np.arange(int(np.ceil(0.62 * digits / step)) + 1) * step
    weight = np.full(len(w), step)
    weight[0] /= 2
    s, squared_cosine = np.sin(angle / 2)[:, None], np.cos(angle / 2)[:, None] ** 2
    sinh = s * np.sinh(w)
    root = np.sqrt(1 + sinh * sinh)
    measure = squared_cosine * weight / np.cosh(w) ** 2 / root
    smooth = s**2 + np.sum(measure * sinh * sinh / (1 + root), axis=1, keepdims=True)
    slow = tau <= _OSCILLATING
    found = np.empty((len(angle), len(tau)))
    waves = np.sin(tau[slow, None] * np.arcsinh(sinh)[:, None]) ** 2
    found[:, slow] = smooth + 2 * np.einsum("anw,aw->an", waves, measure)
    shifted = s * np.sinh(w + 1j * _SHIFT)
    root = np.sqrt(1 + shifted * shifted)
    density = weight / np.cosh(w + 1j * _SHIFT) ** 2 / root
    waves = np.exp(2j * tau[~slow, None] * np.log(shifted + root)[:, None])
    found[:, ~slow] = 1 - squared_cosine * np.einsum("anw,aw->an", waves, density).real
    return found


class _MeanTable(NamedTuple):
    """Weights 2 dτ / (π (4τ² + 1)) of the nodes, and ln(1 - k̂) there as Chebyshev series in ln α."""

    weight: np.ndarray
    series: np.ndarray


@lru_cache(maxsize=64)
def _mean_table(resolution: MeanResolution) -> _MeanTable:
    x = np.arange(int(np.ceil(resolution.reach / resolution.step)) + 1) * resolution.step
    tau, weight = np.sinh(x) / 2, 2 * resolution.step / (np.pi * np.cosh(x))
    weight[0] /= 2
    ends = np.log([resolution.smallest_angle, np.pi])
    place = np.cos(np.pi * (np.arange(_MOST_TERMS) + 0.5) / _MOST_TERMS)
    angle = np.exp(ends[0] + (ends[1] - ends[0]) * (place + 1) / 2)
    values = np.log(_symbol(angle, tau, resolution.smallest_angle))
    # Of a function at these places, the coefficients are a cosine transform.
    waves = np.cos(np.pi * np.outer(np.arange(_MOST_TERMS), np.arange(_MOST_TERMS) + 0.5) / _MOST_TERMS)
    series = 2 / _MOST_TERMS * waves @ values
    series[0] /= 2
    size = np.abs(series).max(axis=1)
    least = max(resolution.precision / 4, 10 * float(np.median(size[-20:])))  # The last ones are rounding.
    needed = max(int(np.flatnonzero(size > least)[-1]) + 1, 2)
    series = series[:needed]
    series[0] -= series.sum(axis=0)  # Nothing is exchanged on a flat surface, exactly.
    return _MeanTable(weight, series)


def log_symbol(angle: Float[Array, ""], resolution: MeanResolution) -> tuple[Array, Array]:
    """ln(1 - k̂) at the nodes of the sums for G, and their weights 2 dτ / (π (4τ² + 1)).

    The symbol depends on the angle alone and is smooth, so a polynomial takes the place of its integral.

    Args:
        angle: dihedral angle, radians.
        resolution: see ``resolution.mean_resolution``.

    Returns:
        Logarithm and weight, both of shape (nodes, 1) to go with κ.
    """
    table = _mean_table(resolution)
    first, last = math.log(resolution.smallest_angle), math.log(math.pi)
    inside = jnp.maximum(angle, jnp.full_like(angle, resolution.smallest_angle))
    x = jnp.minimum((2 * jnp.log(inside) - first - last) / (last - first), jnp.ones_like(angle))
    terms = chebyshev(x, len(table.series))
    value = jnp.matmul(terms, jnp.asarray(table.series, angle.dtype), precision="highest")
    return value[:, None], jnp.asarray(table.weight, angle.dtype)[:, None]


def mean_response(
    angle: Float[Array, ""], kappa: Float[Array, " kappa"], resolution: MeanResolution
) -> Float[Array, " kappa"]:
    """G(α, κ) = ⟨1, (1 - κK)⁻¹ 1⟩ = exp(-(1/π) ∫ ln(1 - κ k̂(τ)) / (τ² + 1/4) dτ), τ from 0 to ∞.

    All terms are positive, so the relative accuracy depends neither on 1 - κ nor on the angle.

    Args:
        angle: dihedral angle, radians.
        kappa: -1 to 1, shape (K,).
        resolution: see ``resolution.mean_resolution``.
    """
    logarithm, weight = log_symbol(angle, resolution)
    return jnp.exp(-jnp.sum(weight * jnp.log((1 - kappa) + kappa * jnp.exp(logarithm)), axis=0))


def mean_exchange(
    angle: Float[Array, ""], reflectance: Float[Array, " kappa"], resolution: MeanResolution
) -> Float[Array, " kappa"]:
    """(G - 1) / r = ⟨K 1, (1 - rK)⁻¹ 1⟩: how much light the panels exchange; smooth down to r = 0.

    Args:
        angle: dihedral angle, radians.
        reflectance: of both panels, 0 to 1, shape (K,).
        resolution: see ``resolution.mean_resolution``.
    """
    logarithm, weight = log_symbol(angle, resolution)
    complement, symbol = jnp.exp(logarithm), -jnp.expm1(logarithm)
    rest = (1 - reflectance) + reflectance * complement
    slope = jnp.sum(weight * symbol * _log_quotient(reflectance * symbol, rest), axis=0)
    return slope * _expm1_quotient(reflectance * slope)


def mean_exchanges(
    angle: Float[Array, ""], product: Float[Array, " kappa"], resolution: MeanResolution
) -> tuple[Float[Array, " kappa"], Float[Array, " kappa"]]:
    """G's parts for two panels, with ρ² = r₁ r₂: (G(ρ) + G(-ρ) - 2) / 2ρ² and (G(ρ) - G(-ρ)) / 2ρ.

    Both are smooth functions of ρ²: with ln G(±ρ) = p ± ρ q they need p / ρ², q and no square root of ρ².

    Args:
        angle: dihedral angle, radians.
        product: r₁ r₂, 0 to 1, shape (K,).
        resolution: see ``resolution.mean_resolution``.
    """
    logarithm, weight = log_symbol(angle, resolution)
    complement, symbol = jnp.exp(logarithm), -jnp.expm1(logarithm)
    squared = product * symbol * symbol
    rest = (1 - product) + product * complement * (1 + symbol)
    even = jnp.sum(weight * symbol * symbol * _log_quotient(squared, rest), axis=0) / 2
    odd = jnp.sum(weight * symbol * _atanh_quotient(squared, rest), axis=0)
    exponent = product * odd * odd
    half = odd * _sinh_quotient(exponent / 4)
    growth = even * _expm1_quotient(product * even)
    same = growth * (1 + product * half * half / 2) + half * half / 2
    return same, jnp.exp(product * even) * odd * _sinh_quotient(exponent)


_SMALL = 0.1
"""Arguments below which the quotients are summed as series, 16 terms for a double."""

_TERMS = np.arange(16)[::-1]


def _by_series(x: Array, coefficients: np.ndarray) -> Array:
    return jnp.polyval(jnp.asarray(coefficients, x.dtype), jnp.minimum(x, _SMALL))


def _log_quotient(x: Array, rest: Array) -> Array:
    """-ln(1 - x) / x for x from 0 to 1, with 1 - x given."""
    small = x < _SMALL
    divisor = jnp.where(small, jnp.ones_like(x), x)
    return jnp.where(small, _by_series(x, 1 / (1 + _TERMS)), -jnp.log(rest) / divisor)


def _atanh_quotient(squared: Array, rest: Array) -> Array:
    """atanh(y) / y from y², 0 to 1, and 1 - y²."""
    small = squared < _SMALL
    root = jnp.sqrt(jnp.where(small, jnp.ones_like(squared), squared))
    return jnp.where(
        small, _by_series(squared, 1 / (1 + 2 * _TERMS)), (jnp.log1p(root) - jnp.log(rest) / 2) / root
    )


def _sinh_quotient(squared: Array) -> Array:
    """sinh(y) / y from y² ≥ 0."""
    small = squared < _SMALL
    root = jnp.sqrt(jnp.where(small, jnp.ones_like(squared), squared))
    factorials = np.array([math.factorial(2 * n + 1) for n in _TERMS], float)
    return jnp.where(small, _by_series(squared, 1 / factorials), jnp.sinh(root) / root)


def _expm1_quotient(x: Array) -> Array:
    """(exp(x) - 1) / x."""
    return jnp.exp(x / 2) * _sinh_quotient(x * x / 4)


def symbol_complement(angle: Float[Array, ""], resolution: Resolution) -> Complex[Array, " inner"]:
    """1 - k̂(τ) on the inner part of the contour.

    k̂ is the Fourier transform of k(t) = (sin²α/2) / (2 cosh t - 2 cos α)^(3/2), taken along a path that turns
    with the contour, so that nothing oscillates.
    """
    grid = wiener_hopf.contour(resolution)
    tilt, end = wiener_hopf.SYMBOL_TILT, wiener_hopf.SYMBOL_END
    nodes = np.arcsinh(end / min(resolution.smallest_angle, 1.2) / np.cos(tilt)) / resolution.step
    x = np.arange(wiener_hopf.multiple_of_four(nodes + 1)) * resolution.step + 1j * tilt
    shape, slope = np.sinh(x), resolution.step * np.cosh(x)
    slope[0] /= 2
    # The integral does not depend on the path, so neither does its derivative: the path may stay fixed.
    width = lax.stop_gradient(jnp.minimum(angle, 1.2))
    dtype = jnp.result_type(lax.complex(width, width))
    t = width.astype(dtype) * jnp.asarray(shape, dtype)
    # A path made for much narrower grooves runs on to where the kernel is nothing but its factors overflow.
    needed = t.real < 2 * end
    t = jnp.where(needed, t, jnp.zeros_like(t))
    roots = jnp.sqrt(-complex_expm1(-t.real, angle - t.imag)) * jnp.sqrt(-complex_expm1(-t.real, -angle - t.imag))
    kernel = jnp.exp(-1.5 * t) / roots**3 * (jnp.sin(angle) ** 2 / 2).astype(dtype)
    measure = jnp.where(needed, kernel * width.astype(dtype) * jnp.asarray(slope, dtype), jnp.zeros_like(t))
    tau = jnp.asarray(grid.tau[: grid.inner], dtype)
    forward = 1j * tau[:, None] * t
    backward = -1j * tau[:, None] * t.conj()
    quarter = jnp.sinh(t / 4)
    smooth = jnp.sin(angle / 2) ** 2 + 4 * jnp.sum(measure * quarter * quarter).real
    moved = complex_expm1(forward.real, forward.imag) @ measure
    moved += complex_expm1(backward.real, backward.imag) @ measure.conj()
    return smooth.astype(dtype) - moved


def factorize(angle: Float[Array, ""], kappa: Float[Array, " kappa"], resolution: Resolution) -> Factorization:
    """(1 - κK)⁻¹ of the groove, for each κ from -1 to 1."""
    return wiener_hopf.factorize(symbol_complement(angle, resolution), kappa, angle, resolution)
