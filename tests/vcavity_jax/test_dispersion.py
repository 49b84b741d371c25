"""Dispersion formulas: published values, limits that are known exactly, derivatives, clear errors."""

from collections.abc import Callable
from typing import Any

import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given

import vcavity_jax as vc
from vcavity_jax import dispersion

NM = np.linspace(380.0, 780.0, 9)
# Compiled as a whole it costs less than its operations one by one.
COMPILED = jax.jit(dispersion.drude_lorentz)
NONE = np.zeros(0)
BK7 = (1.03961212, 0.231792344, 1.01046945), (0.00600069867, 0.0200179144, 103.560653)

# Aluminum, [Rakic1998, table 1]: plasma energy, then strength, width and energy of free and of bound electrons.
ALUMINUM_PLASMA = 14.98
ALUMINUM_FREE = 0.523, 0.047
ALUMINUM_BOUND = np.array(
    [[0.227, 0.333, 0.162], [0.050, 0.312, 1.544], [0.166, 1.351, 1.808], [0.030, 3.382, 3.473]]
)


def permittivity(
    nm: np.ndarray, constant: float, plasma: float, damping: float, f: Any, e: Any, g: Any
) -> np.ndarray:
    """ε as it is written in books, in complex arithmetic."""
    photon = dispersion.HC_EV_NM / nm
    total = constant - plasma**2 / (photon**2 + 1j * photon * damping)
    for strength, energy, width in zip(f, e, g, strict=True):
        total = total + strength * energy**2 / (energy**2 - photon**2 - 1j * photon * width)
    return total


# -- values ----------------------------------------------------------------------------------------


def test_glass_of_the_catalog() -> None:
    """N-BK7 of the Schott catalog, lines d, F, C and t: all digits printed there."""
    lines_nm = np.array([587.5618, 486.1327, 656.2725, 1014.0])
    published = [1.51680, 1.52238, 1.51432, 1.50731]
    np.testing.assert_allclose(dispersion.sellmeier(lines_nm, *BK7), published, rtol=0, atol=5.1e-6)


@pytest.mark.parametrize(
    ("name", "b", "c_um2"),
    [("PMMA-Sultanova", [1.1819], [0.011313]), ("polycarbonate-Sultanova", [1.4182], [0.021304])],
)
def test_bundled_glasses(name: str, b: list[float], c_um2: list[float]) -> None:
    """The same formula read from a file by other code."""
    nm = np.linspace(*vc.materials.wavelength_range_nm(name), 9)
    expected = vc.materials.refractive_index(name, nm)
    np.testing.assert_allclose(dispersion.sellmeier(nm, b, c_um2), expected, rtol=1e-15)


def test_cauchy() -> None:
    """The definition, and Sellmeier's formula, of which it is the expansion: B λ²/(λ² - C) ≈ B (1 + C/λ²)."""
    expected = 1.5 + 4e-3 / (NM / 1000) ** 2 + 1e-4 / (NM / 1000) ** 4
    np.testing.assert_allclose(dispersion.cauchy(NM, 1.5, 4e-3, 1e-4), expected, rtol=1e-15)
    assert float(dispersion.cauchy(500.0, 1.5)) == 1.5
    n0, b, c = np.sqrt(2.2), 1.2, 1e-4  # next: C²/λ⁴, some 1e-7
    np.testing.assert_allclose(
        dispersion.cauchy(NM, n0, b * c / (2 * n0)), dispersion.sellmeier(NM, [b], [c]), rtol=1e-6
    )


def test_aluminum_as_published() -> None:
    """The tables of Rakić's own measurements, which his model follows to some percent.

    It is checked what the parameters mean: strengths without the plasma energy, or widths taken for half widths,
    would be off by far more.
    """
    f0, damping = ALUMINUM_FREE
    f, width, energy = ALUMINUM_BOUND.T
    strength = f * ALUMINUM_PLASMA**2 / energy**2
    index = np.asarray(COMPILED(NM, 1.0, np.sqrt(f0) * ALUMINUM_PLASMA, damping, strength, energy, width))
    expected = vc.materials.refractive_index("Al-Rakic", NM)
    assert np.max(np.abs(index - expected) / np.abs(expected)) < 0.06
    vc.Specular(index)  # its convention, or this would raise


def test_perfect_metal() -> None:
    """Free electrons without damping: no light inside below the plasma edge, clear above it."""
    plasma, constant = 9.0, 3.0
    edge = dispersion.HC_EV_NM / (plasma / np.sqrt(constant))  # ε = 0 at 238.6 nm
    nm = np.array([0.3, 0.9, 1.1, 2.0, 5.0]) * edge
    index = np.asarray(COMPILED(nm, constant, plasma, 0.0, NONE, NONE, NONE))
    root = np.sqrt(np.abs(constant - (plasma * nm / dispersion.HC_EV_NM) ** 2))
    np.testing.assert_allclose(index, np.where(nm < edge, root, 1j * root), rtol=1e-13)
    assert index.imag.min() >= 0
    np.testing.assert_allclose(np.abs((index - 1) / (index + 1))[nm > edge], 1, rtol=1e-15)
    # Little damping absorbs 4n/(|n + 1|²), in first order: with the slope that the formula has there.
    damped = np.asarray(COMPILED(nm, constant, plasma, 1e-6, NONE, NONE, NONE))
    expected = (plasma / (dispersion.HC_EV_NM / nm)) ** 2 * 1e-6 / (2 * root * dispersion.HC_EV_NM / nm)
    np.testing.assert_allclose(np.where(nm > edge, damped.real, damped.imag), expected, rtol=1e-6)


def test_narrow_resonances_are_a_glass() -> None:
    """Lorentz without width is Sellmeier, Eⱼ = hc/√Cⱼ: two conventions of unit, one formula."""
    b, c_um2 = BK7
    energy = dispersion.HC_EV_NM / (1000 * np.sqrt(c_um2))
    index = np.asarray(COMPILED(NM, 1.0, 0.0, 0.0, np.array(b), energy, np.full(3, 1e-9)))
    np.testing.assert_allclose(index.real, dispersion.sellmeier(NM, b, c_um2), rtol=1e-14)
    assert np.all((index.imag > 0) & (index.imag < 1e-9))


def test_strengths_are_static_permittivities() -> None:
    index = COMPILED(1e9, 1.5, 0.0, 0.1, *np.array([[0.7, 2.3], [1.0, 4.0], [0.2, 1.0]]))
    assert complex(index) ** 2 == pytest.approx(4.5, rel=1e-6)


@given(
    nm=st.floats(20, 1e5),
    constant=st.floats(0.1, 20),
    plasma=st.floats(0, 20),
    damping=st.floats(0, 5),
    bound=st.tuples(*2 * [st.tuples(st.floats(0, 10), st.floats(0.05, 20), st.floats(1e-3, 5))]),
)
def test_absorbs_and_solves_its_square(
    nm: float, constant: float, plasma: float, damping: float, bound: tuple[tuple[float, float, float], ...]
) -> None:
    f, e, g = np.array(bound).T
    index = complex(COMPILED(nm, constant, plasma, damping, f, e, g))
    assert index.imag >= 0
    assert index.real >= 0
    expected = complex(permittivity(np.array(nm), constant, plasma, damping, f, e, g))
    scale = constant + (plasma * nm / dispersion.HC_EV_NM) ** 2 + float(np.sum(f * e / g + f))
    assert abs(index**2 - expected) <= 1e-14 * scale


# -- derivatives -----------------------------------------------------------------------------------


def differences(function: Callable[[Any], Any], at: np.ndarray, step: float = 1e-4) -> np.ndarray:
    """Central differences of fourth order, one column per entry; steps are relative."""
    columns = []
    for i in range(at.size):
        width = step * at[i]
        f = [np.asarray(function(at + j * width * np.eye(at.size)[i])) for j in (-2, -1, 1, 2)]
        columns.append((f[0] - 8 * f[1] + 8 * f[2] - f[3]) / (12 * width))
    return np.stack(columns, axis=-1)


FORMULAS: dict[str, tuple[Callable[[Any], Any], list[float]]] = {
    "cauchy": (lambda v: dispersion.cauchy(NM, v[0], v[1], v[2]), [1.5, 4e-3, 1e-4]),
    "sellmeier": (lambda v: dispersion.sellmeier(NM, v[:3], v[3:]), [*BK7[0], *BK7[1]]),
    "wavelength": (lambda v: dispersion.sellmeier(v, *BK7), [400.0, 500.0]),
    "metal": (
        lambda v: jnp.stack(
            [(i := dispersion.drude_lorentz(NM, v[0], v[1], v[2], v[3:5], v[5:7], v[7:])).real, i.imag]
        ),
        [2.0, 9.0, 0.1, 0.8, 1.5, 2.5, 4.0, 0.6, 1.1],
    ),
    "dielectric": (
        lambda v: jnp.stack(
            [(i := dispersion.drude_lorentz(NM, v[0], 0.0, 0.0, v[1:2], v[2:3], v[3:])).real, i.imag]
        ),
        [2.0, 1.0, 5.0, 0.3],
    ),
}


@pytest.mark.parametrize("name", FORMULAS)
def test_derivatives(name: str) -> None:
    """Forward and reverse, against differences whose own error is some 1e-11 of the scale."""
    function, start = FORMULAS[name]
    function, at = jax.jit(function), np.array(start)
    expected = differences(function, at)
    scale = np.max(np.abs(expected), axis=tuple(range(expected.ndim - 1)))
    for differentiate in (jax.jacfwd, jax.jacrev):
        found = np.asarray(jax.jit(differentiate(function))(jnp.asarray(at)))
        assert np.max(np.abs(found - expected) / scale) < 1e-9


@pytest.mark.parametrize("plasma", [1.0, 9.0])
def test_derivatives_without_loss(plasma: float) -> None:
    """Im ε = 0, clear and metallic: the gradient is finite and that towards absorption."""

    def index(damping: Any) -> Any:
        return dispersion.drude_lorentz(500.0, 2.0, plasma, damping, [], [], [])

    value, slope = jax.jit(lambda d: jax.jvp(index, (d,), (jnp.ones_like(d),)))(0.0)
    ahead = (jax.jit(index)(1e-6) - value) / 1e-6
    assert complex(slope) == pytest.approx(complex(ahead), rel=1e-5)
    assert abs(slope) > 0.01
    gradient = jax.jit(jax.grad(lambda d: index(d).real + index(d).imag))(0.0)
    assert float(gradient) == pytest.approx(float(slope.real + slope.imag), rel=1e-12)


def test_derivative_where_the_real_part_changes_sign() -> None:
    """Re ε = 0 exactly: both forms of the root meet, and their slopes agree."""
    nm, width, energy = dispersion.HC_EV_NM / 2.0, 0.5, 2.0  # on resonance: ε = ε∞ + i f E/γ, E = 2 eV

    def index(constant: Any) -> Any:
        free = dispersion.drude_lorentz(nm, 4.0 + constant, 4.0, 0.0, [0.5], [energy], [width])
        return jnp.stack([free.real, free.imag])

    assert jax.jit(index)(0.0).tolist() == [1.0, 1.0]  # ε = 2i
    slope = jax.jit(jax.jacfwd(index))(0.0)
    np.testing.assert_allclose(slope, [0.25, -0.25], rtol=1e-14)  # dε/2ñ = 1/(2 + 2i)


def test_finite_at_the_plasma_edge() -> None:
    """ε = 0 exactly: the root has no slope, 0 is returned."""

    def index(constant: Any) -> Any:
        return dispersion.drude_lorentz(dispersion.HC_EV_NM / 2, constant, 2.0, 0.0, [], [], [])

    value, slope = jax.jit(lambda constant: jax.jvp(index, (constant,), (jnp.ones_like(constant),)))(1.0)
    assert complex(value) == complex(slope) == 0


def test_batches_of_traced_coefficients() -> None:
    """As a search calls it: mapped over coefficients, compiled, and differentiated backwards."""

    def reflected(plasma: Any) -> Any:
        index = dispersion.drude_lorentz(NM, 4.0, plasma, 0.1, [1.0], [3.0], [0.8])
        return jnp.sum(jnp.abs((index - 1) / (index + 1)) ** 2)

    values, slopes = jax.jit(jax.vmap(jax.value_and_grad(reflected)))(jnp.asarray([0.0, 6.0, 9.0]))
    assert values[0] < values[1] < values[2]
    assert np.isfinite(slopes).all()
    assert slopes[0] == 0  # the plasma energy enters squared


# -- types and errors ------------------------------------------------------------------------------


def test_types() -> None:
    """Real formulas stay real; whole numbers are numbers; precisions are not mixed behind one's back."""
    assert dispersion.cauchy(np.array([400, 500]), 1).dtype == jnp.float64
    assert dispersion.sellmeier(jnp.asarray(NM), *BK7).dtype == jnp.float64
    assert dispersion.drude_lorentz(500, 1, 9, 0, [], [], []).dtype == jnp.complex128
    single, one = jnp.asarray(NM, jnp.float32), jnp.ones(1, jnp.float32)
    assert dispersion.sellmeier(single, one, one / 100).dtype == jnp.float32
    with pytest.raises(jax.dtypes.TypePromotionError, match="float32"):
        dispersion.sellmeier(single, *BK7)
    assert dispersion.sellmeier(NM, [], []).tolist() == [1.0] * 9


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: dispersion.cauchy([500.0, 0.0], 1.5),
            "0.0 is not a wavelength: expected finite nanometers above 0",
        ),
        (lambda: dispersion.sellmeier(-500.0, *BK7), "-500.0 is not a wavelength"),
        (lambda: dispersion.drude_lorentz(np.nan, 1, 0, 0, [], [], []), "nan is not a wavelength"),
        (lambda: dispersion.cauchy(np.ones((2, 2)), 1.5), r"wavelengths have shape \(2, 2\): expected one axis"),
        (lambda: dispersion.cauchy(NM, [1.5, 1.6]), r"a has shape \(2,\): expected one number"),
        (lambda: dispersion.sellmeier(NM, 1.0, 0.01), r"b \(\), c_um2 \(\): expected one axis each"),
        (lambda: dispersion.sellmeier(NM, [1.0], [0.01, 0.02]), "expected one axis each, of the same length"),
        (
            lambda: dispersion.sellmeier(400.0, [1.0], [0.25]),
            r"n² > 0. It is that at 400 nm: is there a resonance",
        ),
        (lambda: dispersion.sellmeier(500.0, [1.0], [0.25]), "is not a square of a refractive index"),
        (lambda: dispersion.drude_lorentz(NM, 0, 9, 0, [], [], []), "epsilon_infinity > 0"),
        (lambda: dispersion.drude_lorentz(NM, 1, -9, 0, [], [], []), "-9.0 is not a plasma energy in eV"),
        (lambda: dispersion.drude_lorentz(NM, 1, 9, -0.1, [], [], []), "damping_ev ≥ 0"),
        (lambda: dispersion.drude_lorentz(NM, 1, 9, 0, [-1.0], [1.0], [1.0]), "strengths ≥ 0"),
        (lambda: dispersion.drude_lorentz(NM, 1, 9, 0, [1.0], [0.0], [1.0]), "energies_ev > 0"),
        (lambda: dispersion.drude_lorentz(NM, 1, 9, 0, [1.0], [1.0], [0.0]), "widths_ev > 0"),
        (lambda: dispersion.drude_lorentz(NM, 1, 9, 0, [1.0], [1.0], []), "of the same length"),
    ],
)
def test_errors_are_one_clear_line(call: Callable[[], Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_traced_numbers_are_not_checked() -> None:
    """They cannot be: a Sellmeier sum that turns negative is NaN, never a wrong number."""
    assert np.isnan(jax.jit(lambda c: dispersion.sellmeier(400.0, jnp.ones(1), c))(jnp.asarray([0.25])))
