"""One smooth interface: amplitudes, power and diffuse averages, without cancellation anywhere.

Conventions: complex index n + ik, k ≥ 0, time factor exp(-iωt), Im cos θ_t ≥ 0, and r_p = +r_s at normal
incidence, the sign that an unfolded chain of reflections needs.
"""

from functools import lru_cache

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Inexact

from vcavity_jax.quadrature import Clustering, clustered
from vcavity_jax.safe import floor_of


def permittivity_contrast(index: Inexact[Array, "..."]) -> Inexact[Array, "..."]:
    """(n + ik)² - 1 as (n + ik - 1)(n + ik + 1), exact as the index tends to 1."""
    return (index - 1) * (index + 1)


def amplitudes(
    cosine: Float[Array, "..."], contrast: Inexact[Array, "..."]
) -> tuple[Inexact[Array, "..."], Inexact[Array, "..."]]:
    """Amplitude r_s, and κ such that r_p = r_s + κ sin²θ.

    With g = √(contrast + cos²θ):  r_s = -contrast / (cos θ + g)²  and
    κ = 2 contrast / ((g + (1 + contrast) cos θ)(cos θ + g)) [SaintPierre2020, eq. 2.22 and 2.23, rearranged:
    nothing cancels for n → 1, and there is no 0/0 at grazing or normal incidence].

    Args:
        cosine: cos of the angle of incidence, 0 to 1.
        contrast: (n + ik)² - 1; real for a dielectric with n ≥ 1 (then everything is real), else complex.
    """
    cosine = jnp.maximum(cosine, floor_of(cosine)).astype(contrast.dtype)
    g = jnp.sqrt(contrast + cosine * cosine)
    total = 1 / (cosine + g)
    r_s = -contrast * total * total
    return r_s, 2 * contrast * total / (g + (1 + contrast) * cosine)


Jones = tuple[Inexact[Array, "..."], ...]
"""Entries of a matrix, 2 by 2, that acts on the two transverse amplitudes, by rows."""


def turned(
    state: Jones,
    a: Inexact[Array, "..."],
    b: Inexact[Array, "..."],
    p1: Inexact[Array, "..."],
    p2: Inexact[Array, "..."],
) -> Jones:
    """(a I + b p pᵀ) J: one more interface on a path, p being the transverse part of its normal."""
    j11, j12, j21, j22 = state
    k1, k2 = b * p1, b * p2
    t1, t2 = p1 * j11 + p2 * j21, p1 * j12 + p2 * j22
    return a * j11 + k1 * t1, a * j12 + k1 * t2, a * j21 + k2 * t1, a * j22 + k2 * t2


def power(amplitude: Inexact[Array, "..."]) -> Float[Array, "..."]:
    """|amplitude|², with a gradient at zero."""
    return amplitude.real**2 + amplitude.imag**2


# A dielectric, n ≥ 1. The cosine may be complex with a positive real part: everything is then continued
# analytically, squares of amplitudes included. Complex arithmetic is spelled out where XLA's is slow.


def reciprocal(z: Inexact[Array, "..."]) -> Inexact[Array, "..."]:
    """1 / z."""
    if not jnp.iscomplexobj(z):
        return 1 / z
    scale = 1 / (z.real * z.real + z.imag * z.imag)
    return lax.complex(z.real * scale, -z.imag * scale)


def square_root(z: Inexact[Array, "..."]) -> Inexact[Array, "..."]:
    """√z, the root with a positive real part; z does not lie on the negative axis."""
    if not jnp.iscomplexobj(z):
        return jnp.sqrt(z)
    real = jnp.sqrt((jnp.sqrt(z.real * z.real + z.imag * z.imag) + z.real) / 2)
    return lax.complex(real, z.imag / (2 * real))


def _as(value: Float[Array, "..."], like: Inexact[Array, "..."]) -> Inexact[Array, "..."]:
    return value.astype(like.dtype)


def refracted(cosine: Inexact[Array, "..."], index: Float[Array, "..."]) -> Inexact[Array, "..."]:
    """S = √(n² - 1 + cos²θ), which is n cos θ_t: the cosine below the interface, times n."""
    return square_root(_as(permittivity_contrast(index), cosine) + cosine * cosine)


def reflectance(cosine: Inexact[Array, "..."], index: Float[Array, "..."]) -> Inexact[Array, "..."]:
    """Unpolarized reflectance of a dielectric, (r_s² + r_p²) / 2."""
    contrast = _as(permittivity_contrast(index), cosine)
    s = refracted(cosine, index)
    x, z = reciprocal(cosine + s), reciprocal(s + (1 + contrast) * cosine)
    x, z = x * x, (1 - (2 + contrast) * cosine * cosine) * z * z
    return contrast * contrast / 2 * (x * x + z * z)


def transmittance(cosine: Inexact[Array, "..."], index: Float[Array, "..."]) -> Inexact[Array, "..."]:
    """Unpolarized transmittance of a dielectric, 1 - reflectance; it vanishes at grazing incidence as cos θ."""
    squared = _as(1 + permittivity_contrast(index), cosine)
    s = refracted(cosine, index)
    x, z = reciprocal(cosine + s), reciprocal(s + squared * cosine)
    return 2 * cosine * s * (x * x + squared * z * z)


def reflection_operator(
    cosine: Inexact[Array, "..."], index: Float[Array, "..."]
) -> tuple[Inexact[Array, "..."], Inexact[Array, "..."]]:
    """A and b of the amplitude operator a I + b p pᵀ, p the transverse part of the facet's normal."""
    contrast = _as(permittivity_contrast(index), cosine)
    s = refracted(cosine, index)
    x = reciprocal(cosine + s)
    return -contrast * x * x, 2 * contrast * x * reciprocal(s + (1 + contrast) * cosine)


def transmission_operator(
    cosine: Inexact[Array, "..."], index: Float[Array, "..."]
) -> tuple[Inexact[Array, "..."], Inexact[Array, "..."], Inexact[Array, "..."]]:
    """The same for transmission, and the factor 4 cos θ S on the power."""
    n = _as(index, cosine)
    contrast = _as(permittivity_contrast(index), cosine)
    s = refracted(cosine, index)
    x = reciprocal(cosine + s)
    coupling = (n - 1) * contrast * x * reciprocal(s + n * cosine) * reciprocal(s + (1 + contrast) * cosine)
    return x, coupling, 4 * cosine * s


@lru_cache
def _unit_legendre(order: int) -> tuple[np.ndarray, np.ndarray]:
    x, weight = np.polynomial.legendre.leggauss(order)
    return (x + 1) / 2, weight / 2


_ORDER = 48
_GRAZING = Clustering(step=0.06, reach=3.3)

# r₁₂ = n²(n² - 1)²/(n² + 1)³ ln((n - 1)/(n + 1)) + p(n - 1): p by its Taylor series, to 2e-19 below 0.05.
_NEAR_ONE = 0.05
_SERIES = (
    0.4849202799153971,
    -0.27704648053769148,
    -0.24326814378677378,
    0.77885396938131313,
    -0.89211365891053391,
    0.34264012896825397,
    0.60629960317460317,
    -1.2409970238095238,
    0.93601190476190476,
    0.16875,
    -1.0666666666666667,
    0.79166666666666667,
    1 / 3,
    0.0,
)


def diffuse_transmittance(index: Float[Array, "..."]) -> Float[Array, "..."]:
    """t₁₂ = ∫ T(cos θ) 2 cos θ d(cos θ), what a dielectric takes in of diffuse light.

    Equal to 1 less the reflectance of [Duntley1942, as SaintPierre2020, eq. 2.36], whose terms cancel near n = 1.
    The derivative is right at n = 1 too: -1/3.

    Args:
        index: n ≥ 1.
    """
    mu, weight = (jnp.asarray(a, index.dtype) for a in _unit_legendre(_ORDER))
    summed = jnp.sum(4 * weight * mu**3 * transmittance(mu * mu, index[..., None]), axis=-1)
    step = jnp.minimum(index - 1, _NEAR_ONE)
    safe = jnp.where(step > 0, step, jnp.ones_like(step))
    logarithm = jnp.where(step > 0, jnp.log(safe / (2 + safe)), jnp.zeros_like(step))
    squared = (1 + step) * (1 + step)
    contrast = step * (2 + step)
    reflected = squared * contrast**2 / (squared + 1) ** 3 * logarithm
    reflected += jnp.polyval(jnp.asarray(_SERIES, index.dtype), step)
    return jnp.where(index - 1 < _NEAR_ONE, 1 - reflected, summed)


def absorbing_transmittance(index: Float[Array, "..."], depth: Float[Array, "..."]) -> Float[Array, "..."]:
    """t₁₂(τ): what of diffuse light reaches the bottom of an absorbing layer below the interface.

    Args:
        index: n ≥ 1.
        depth: optical depth τ = -ln t of the layer, ≥ 0.
    """
    mu, weight = (jnp.asarray(a, index.dtype) for a in _unit_legendre(_ORDER))
    index, depth = index[..., None], depth[..., None]
    path = index / refracted(mu * mu, index)
    return jnp.sum(4 * weight * mu**3 * transmittance(mu * mu, index) * jnp.exp(-depth * path), axis=-1)


def internal_reflectance(index: Float[Array, "..."], depth: Float[Array, "..."]) -> Float[Array, "..."]:
    """r_i(τ): what of diffuse light returns through an absorbing layer from the interface above it.

    2 E₃(2τ) - ∫ 2 μ T exp(-2τ/μ) dμ, E₃(x) = ∫ μ exp(-x/μ) dμ, over directions below the interface
    [WilliamsClapper1953].

    Args:
        index: n ≥ 1.
        depth: optical depth τ = -ln t of the layer, ≥ 0.
    """
    escaped = absorbing_transmittance(index, 2 * depth) / (index * index)
    mu, weight = (jnp.asarray(a, depth.dtype) for a in clustered(_GRAZING, half=False))
    # 2 E₃, which JAX's own gives only without vmap.
    returned = jnp.sum(2 * weight * mu * jnp.exp(-2 * depth[..., None] / mu), axis=-1)
    return returned - escaped
