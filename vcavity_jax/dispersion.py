"""Refractive index as a function of wavelength: Cauchy, Sellmeier, Drude and Lorentz, differentiable.

The formulas take vacuum wavelengths in nanometers. Their coefficients may be traced: give them to a fit, or
differentiate a whole scene with respect to them. For tables and files see ``vcavity_jax.materials``.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Complex, Float

from vcavity_jax.scene import concrete, refuse

Numbers = ArrayLike | Sequence[float | int]

HC_EV_NM = 1239.8419843320026
"""Planck's constant times the speed of light, eV nm: exact in the SI. A photon has the energy E = hc/λ."""


def cauchy(
    wavelengths_nm: Numbers, a: Numbers, b_um2: Numbers = 0.0, c_um4: Numbers = 0.0
) -> Float[Array, "*wavelengths"]:
    """Index of a clear material far from its absorption bands, n = A + B/λ² + C/λ⁴ with λ in micrometers.

    Args:
        wavelengths_nm: vacuum wavelengths, nm, above 0, shape (L,) or ().
        a: A, without unit: the index at long wavelengths.
        b_um2: B, µm²; positive for normal dispersion, some 0.004 for glass.
        c_um4: C, µm⁴.

    Returns:
        n, real, in the shape of the wavelengths. It is linear in the coefficients; nothing keeps it above 1.

    Raises:
        ValueError: a known wavelength is not above 0, or a coefficient is not one number.

    References:
        [BornWolf1999, section 2.3.4].
    """
    inverse = 1 / _squared_um(_wavelengths(wavelengths_nm))
    a, b_um2, c_um4 = (_one(name, value) for name, value in (("a", a), ("b_um2", b_um2), ("c_um4", c_um4)))
    return a + inverse * (b_um2 + inverse * c_um4)


def sellmeier(wavelengths_nm: Numbers, b: Numbers, c_um2: Numbers) -> Float[Array, "*wavelengths"]:
    """Index of a clear material, n² = 1 + Σ Bᵢ λ²/(λ² - Cᵢ) with λ in micrometers.

    Args:
        wavelengths_nm: vacuum wavelengths, nm, above 0, shape (L,) or ().
        b: Bᵢ, the strengths of T resonances, shape (T,); empty is vacuum.
        c_um2: Cᵢ, µm², the squares of their wavelengths, shape (T,). The wavelengths asked for must not be among
            them, and lie where n² is positive.

    Returns:
        n, real, in the shape of the wavelengths. It is NaN, and so is its gradient, where coefficients that are
        traced make n² negative.

    Raises:
        ValueError: a known wavelength is not above 0 or lies where n² is not positive, or the coefficients are
            not two arrays of the same length.

    References:
        [Sellmeier1872]; [BornWolf1999, section 2.3.4].
    """
    wavelengths = _wavelengths(wavelengths_nm)
    strength, resonance = _terms(b=b, c_um2=c_um2)
    squared = _squared_um(wavelengths)[..., None]
    square = 1 + jnp.sum(strength * squared / (squared - resonance), axis=-1)
    known = concrete(square)
    if known is not None:
        bad = np.asarray(~((known > 0) & np.isfinite(known)))
        refuse("a square of a refractive index", known, bad, "n² > 0", _where(wavelengths, bad))
    return jnp.sqrt(square)


def drude_lorentz(
    wavelengths_nm: Numbers,
    epsilon_infinity: Numbers,
    plasma_ev: Numbers,
    damping_ev: Numbers,
    strengths: Numbers,
    energies_ev: Numbers,
    widths_ev: Numbers,
) -> Complex[Array, "*wavelengths"]:
    """Index n + ik of free electrons and bound resonances: a metal, or any absorbing material.

    It is the square root of the permittivity

        ε(E) = ε∞ - ωp²/(E² + iEΓ) + Σ fⱼEⱼ²/(Eⱼ² - E² - iEγⱼ),        E = hc/λ

    The time factor is exp(-iωt), so Im ε ≥ 0 and k ≥ 0 in what absorbs: the convention of ``Specular``, and the
    conjugate of what tables in n - ik hold. The root taken is the principal one; it has n ≥ 0 and k ≥ 0.

    The gradient is finite everywhere, also in lossless matter, Im ε = 0, where it is that towards absorption. One
    point is left out, ε = 0 exactly (lossless, at the plasma edge), where the root has no slope: there it is 0.

    Args:
        wavelengths_nm: vacuum wavelengths, nm, above 0, shape (L,) or ().
        epsilon_infinity: ε∞ > 0, without unit: what resonances beyond those listed contribute.
        plasma_ev: ωp ≥ 0, eV, of the free electrons; 0 for none.
        damping_ev: Γ ≥ 0, eV, of the free electrons. With 0 a metal has n = 0, which ``Specular`` refuses.
        strengths: fⱼ ≥ 0 of J resonances, without unit, shape (J,), what each adds to ε at E = 0; may be empty.
            Tables that give f ωp² [Rakic1998] are divided by Eⱼ².
        energies_ev: Eⱼ > 0, eV, shape (J,).
        widths_ev: γⱼ > 0, eV, shape (J,), the full width.

    Returns:
        n + ik, complex, in the shape of the wavelengths.

    Raises:
        ValueError: a known number is outside its range, a coefficient is not one number, or the resonances are not
            three arrays of the same length.

    References:
        [BornWolf1999, sections 2.3.4 and 14.3]; [Rakic1998], with the other sign of i.
    """
    wavelengths = _wavelengths(wavelengths_nm)
    constant, plasma, damping = (
        _one(name, value)
        for name, value in (
            ("epsilon_infinity", epsilon_infinity),
            ("plasma_ev", plasma_ev),
            ("damping_ev", damping_ev),
        )
    )
    strength, energy, width = _terms(strengths=strengths, energies_ev=energies_ev, widths_ev=widths_ev)
    _refuse_below("a permittivity at high energy", constant, "epsilon_infinity > 0", strict=True)
    _refuse_below("a plasma energy in eV", plasma, "plasma_ev ≥ 0")
    _refuse_below("a damping in eV", damping, "damping_ev ≥ 0")
    _refuse_below("a strength of a resonance", strength, "strengths ≥ 0")
    _refuse_below("an energy of a resonance in eV", energy, "energies_ev > 0", strict=True)
    _refuse_below("a width of a resonance in eV", width, "widths_ev > 0", strict=True)

    photon = HC_EV_NM / wavelengths
    # Real and imaginary parts are sums of their own, so that no sign of a zero picks the wrong root.
    free = plasma * plasma / (photon * photon + damping * damping)
    bound_to = energy * energy
    detuning = bound_to - photon[..., None] * photon[..., None]
    broadening = photon[..., None] * width
    bound = strength * bound_to / (detuning * detuning + broadening * broadening)
    real = constant - free + jnp.sum(bound * detuning, axis=-1)
    imaginary = free * damping / photon + jnp.sum(bound * broadening, axis=-1)
    return _root(real, imaginary)


def _root(real: Float[Array, "..."], imaginary: Float[Array, "..."]) -> Complex[Array, "..."]:
    """√(real + i imaginary) for an imaginary part that is not negative; both parts of it accurate.

    The larger part comes from the modulus, without cancellation, and the smaller one from their product.
    """
    zero = (real == 0) & (imaginary == 0)
    real = jnp.where(zero, jnp.ones_like(real), real)
    modulus = jnp.sqrt(real * real + imaginary * imaginary)
    clear = real > 0
    # Not abs, whose slope at 0 would be that of neither side.
    larger = jnp.sqrt((modulus + jnp.where(clear, real, -real)) / 2)
    smaller = imaginary / (2 * larger)
    nothing = jnp.zeros_like(larger)
    n = jnp.where(zero, nothing, jnp.where(clear, larger, smaller))
    k = jnp.where(zero, nothing, jnp.where(clear, smaller, larger))
    return jax.lax.complex(n, k)


def _squared_um(wavelengths: Float[Array, "..."]) -> Float[Array, "..."]:
    return (wavelengths / 1000) ** 2


def _wavelengths(wavelengths_nm: Numbers) -> Float[Array, "*wavelengths"]:
    wavelengths = _real(wavelengths_nm)
    if wavelengths.ndim > 1:
        raise ValueError(f"wavelengths have shape {wavelengths.shape}: expected one axis, or one number")
    known = concrete(wavelengths)
    if known is not None:
        refuse("a wavelength", known, ~((known > 0) & np.isfinite(known)), "finite nanometers above 0")
    return wavelengths


def _real(value: Numbers) -> Array:
    """An array of JAX's float type; known numbers stay known inside a traced function."""
    if isinstance(value, jax.Array) and jnp.issubdtype(value.dtype, jnp.floating):
        return value
    with jax.ensure_compile_time_eval():
        return jnp.asarray(value, jnp.result_type(float))


def _one(name: str, value: Numbers) -> Float[Array, ""]:
    number = _real(value)
    if number.ndim:
        raise ValueError(f"{name} has shape {number.shape}: expected one number")
    return number


def _terms(**named: Numbers) -> list[Float[Array, " terms"]]:
    arrays = {name: _real(value) for name, value in named.items()}
    shapes = [array.shape for array in arrays.values()]
    if any(len(shape) != 1 for shape in shapes) or len(set(shapes)) > 1:
        found = ", ".join(f"{name} {shape}" for name, shape in zip(arrays, shapes, strict=True))
        raise ValueError(f"the shapes are {found}: expected one axis each, of the same length")
    return list(arrays.values())


def _refuse_below(what: str, value: Array, expected: str, strict: bool = False) -> None:
    known = concrete(value)
    if known is not None:
        inside = known > 0 if strict else known >= 0
        refuse(what, known, ~(inside & np.isfinite(known)), expected)


def _where(wavelengths: Array, bad: np.ndarray) -> str:
    known = concrete(wavelengths)
    if known is None or not bad.any():
        return ""
    return f". It is that at {known[bad].ravel()[0]:g} nm: is there a resonance?"
