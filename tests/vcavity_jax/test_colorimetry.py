"""Spectra to color: against colour-science and published pairs, exact whites, gradients, every refusal."""

import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import vcavity_jax as vc
from vcavity_jax import colorimetry

VISIBLE = np.arange(380.0, 731.0, 10.0)
RANDOM = np.random.default_rng(7)
SPECTRA = RANDOM.uniform(0, 1.2, (5, VISIBLE.size))
LABS = RANDOM.uniform([0, -120, -120], [100, 120, 120], (2, 400, 3))

# [Sharma2005, table 1], the supplementary test data of the paper: L1 a1 b1 L2 a2 b2 ΔE00.
SHARMA = np.loadtxt(
    """
    50      2.6772 -79.7751 50       0      -82.7485  2.0425
    50      3.1571 -77.2803 50       0      -82.7485  2.8615
    50      2.8361 -74.0200 50       0      -82.7485  3.4412
    50     -1.3802 -84.2814 50       0      -82.7485  1.0000
    50     -1.1848 -84.8006 50       0      -82.7485  1.0000
    50     -0.9009 -85.5211 50       0      -82.7485  1.0000
    50      0        0      50      -1        2       2.3669
    50     -1        2      50       0        0       2.3669
    50      2.4900  -0.0010 50      -2.4900   0.0009  7.1792
    50      2.4900  -0.0010 50      -2.4900   0.0010  7.1792
    50      2.4900  -0.0010 50      -2.4900   0.0011  7.2195
    50      2.4900  -0.0010 50      -2.4900   0.0012  7.2195
    50     -0.0010   2.4900 50       0.0009  -2.4900  4.8045
    50     -0.0010   2.4900 50       0.0010  -2.4900  4.8045
    50     -0.0010   2.4900 50       0.0011  -2.4900  4.7461
    50      2.5000   0      50       0       -2.5000  4.3065
    50      2.5000   0      73      25      -18      27.1492
    50      2.5000   0      61      -5       29      22.8977
    50      2.5000   0      56     -27       -3      31.9030
    50      2.5000   0      58      24       15      19.4535
    50      2.5000   0      50       3.1736   0.5854  1.0000
    50      2.5000   0      50       3.2972   0       1.0000
    50      2.5000   0      50       1.8634   0.5757  1.0000
    50      2.5000   0      50       3.2592   0.3350  1.0000
    60.2574 -34.0099 36.2677 60.4626 -34.1751 39.4387 1.2644
    63.0109 -31.0961 -5.8663 62.8187 -29.7946 -4.0864 1.2630
    61.2901  3.7196  -5.3901 61.4292  2.2480  -4.9620 1.8731
    35.0831 -44.1164  3.7933 35.0232 -40.0716  1.5901 1.8645
    22.7233 20.0904 -46.6940 23.0331 14.9730 -42.5619 2.0373
    36.4612 47.8580  18.3852 36.2715 50.5065  21.2231 1.4146
    90.8027 -2.0831   1.4410 91.1528 -1.6435   0.0447 1.4441
    90.9257 -0.5406  -0.9208 88.6381 -0.8985  -0.7239 1.5381
     6.7747 -0.2908  -2.4247  5.8714 -0.0985  -2.2286 0.6377
     2.0776  0.0795  -1.1350  0.9033 -0.0636  -0.5514 0.9082
    """.splitlines()
)


@pytest.fixture(scope="module")
def colour() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of optional packages that it misses
        return __import__("colour")


def summed(
    colour: Any, spectra: np.ndarray, wavelengths: np.ndarray, illuminant: str, observer: str
) -> np.ndarray:
    """The definition, on the tables of colour-science."""
    name = {"CIE 1931": "CIE 1931 2 Degree", "CIE 1964": "CIE 1964 10 Degree"}[observer]
    functions = colour.MSDS_CMFS[f"{name} Standard Observer"]
    power = colour.SDS_ILLUMINANTS[illuminant]
    light = np.interp(wavelengths, power.wavelengths, power.values)
    rows = [np.interp(wavelengths, functions.wavelengths, column) for column in functions.values.T]
    return np.stack([(spectra * light * row).sum(-1) for row in rows], -1) * 100 / (light * rows[1]).sum()


RANGES = {
    1: [(360, 780), (400, 700)],
    5: [(360, 780), (380, 730)],
    10: [(360, 780), (380, 730), (400, 700), (340, 800)],
    20: [(360, 780), (400, 700), (390, 730), (320, 800)],
}


@pytest.mark.filterwarnings("ignore")  # of the alignment that the standard asks for
@pytest.mark.parametrize("step", RANGES)
@pytest.mark.parametrize("illuminant", ["A", "C", "D50", "D65", "E", "FL2", "FL3.7", "LED-B3"])
def test_the_practice_of_astm_e308(colour: Any, illuminant: Any, step: int) -> None:
    for first, last in RANGES[step]:
        nm = np.arange(first, last + 1.0, step)
        spectrum = RANDOM.uniform(0, 1, nm.size)
        known = colour.SpectralDistribution(dict(zip(nm, spectrum, strict=True)))
        for observer, name in (("CIE 1931", "2 Degree"), ("CIE 1964", "10 Degree")):
            functions = colour.MSDS_CMFS[f"{observer} {name} Standard Observer"]
            truth = colour.sd_to_XYZ(known, functions, colour.SDS_ILLUMINANTS[illuminant], method="ASTM E308")
            value = colorimetry.xyz(spectrum, nm, illuminant, observer)  # type: ignore[arg-type]
            np.testing.assert_allclose(value, truth, rtol=0, atol=1e-10)
            falling = colorimetry.xyz(spectrum[::-1], nm[::-1], illuminant, observer)  # type: ignore[arg-type]
            np.testing.assert_allclose(falling, value, rtol=0, atol=1e-12)


@pytest.mark.filterwarnings("ignore")
def test_bundled_spectra_have_the_colors_of_colour(colour: Any) -> None:
    """Every patch of the ColorChecker, measured at 10 nm."""
    patches = colour.SDS_COLOURCHECKERS["BabelColor Average"]
    functions, power = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"], colour.SDS_ILLUMINANTS["D50"]
    nm = next(iter(patches.values())).wavelengths
    truth = np.stack([colour.sd_to_XYZ(p, functions, power, method="ASTM E308") for p in patches.values()])
    spectra = np.stack([p.values for p in patches.values()])
    np.testing.assert_allclose(colorimetry.xyz(spectra, nm, "D50"), truth, rtol=0, atol=1e-10)


def test_ten_nanometers_are_nearly_as_good_as_one() -> None:
    """What the practice is for: a smooth spectrum and a lamp with lines."""
    fine, coarse = np.arange(380.0, 781.0), np.arange(380.0, 781.0, 10.0)

    def smooth(nm: np.ndarray) -> np.ndarray:
        return 0.5 + 0.4 * np.sin(nm / 40)

    truth = np.asarray(colorimetry.xyz(smooth(fine), fine, "FL11"))
    by_practice = np.asarray(colorimetry.xyz(smooth(coarse), coarse, "FL11"))
    by_sum = np.asarray(colorimetry.xyz(smooth(coarse), coarse, "FL11", practice="sum"))
    assert np.abs(by_practice - truth).max() < 0.02
    assert np.abs(by_sum - truth).max() > 0.2


@pytest.mark.parametrize("observer", colorimetry.OBSERVERS)
@pytest.mark.parametrize("illuminant", colorimetry.ILLUMINANTS)
def test_sums_are_those_of_the_cie_tables(colour: Any, illuminant: Any, observer: Any) -> None:
    for wavelengths in (VISIBLE, np.linspace(780, 380, 401), np.linspace(381.5, 751.5, 38)):
        spectra = RANDOM.uniform(0, 1, (2, 3, wavelengths.size))
        value = colorimetry.xyz(spectra, wavelengths, illuminant, observer, practice="sum")
        truth = summed(colour, spectra, wavelengths, illuminant, observer)
        np.testing.assert_allclose(value, truth, rtol=0, atol=1e-10)


def test_sums_reach_the_published_white_points(colour: Any) -> None:
    # The CIE publishes chromaticities to five digits, summed over its whole tables.
    wavelengths = np.arange(360.0, 781.0)
    for observer, name in (("CIE 1931", "2"), ("CIE 1964", "10")):
        known = colour.CCS_ILLUMINANTS[f"CIE 19{'31' if name == '2' else '64'} {name} Degree Standard Observer"]
        for illuminant in ("A", "D50", "D65", "E"):
            value = np.asarray(colorimetry.white(wavelengths, illuminant, observer))  # type: ignore[arg-type]
            np.testing.assert_allclose(value[:2] / value.sum(), known[illuminant], rtol=0, atol=6e-5)


def test_tables_are_what_the_script_writes(colour: Any) -> None:
    script = Path(__file__).parents[2] / "scripts" / "cie_data.py"
    run = subprocess.run(
        [sys.executable, "-W", "ignore", script, "--check"], capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr


def test_lab_agrees_with_colour(colour: Any) -> None:
    white = colorimetry.white(VISIBLE, "D50")
    values = np.concatenate([np.asarray(colorimetry.xyz(SPECTRA, VISIBLE, "D50")), RANDOM.uniform(0, 2, (50, 3))])
    x, y, z = np.asarray(white)
    chromaticity = np.array([x, y]) / (x + y + z)
    truth = colour.XYZ_to_Lab(values / 100, chromaticity)
    np.testing.assert_allclose(colorimetry.lab(values, white), truth, rtol=0, atol=1e-10)


def test_lch_agrees_with_colour(colour: Any) -> None:
    truth = colour.models.Lab_to_LCHab(LABS[0])
    value = np.asarray(colorimetry.lch(LABS[0]))
    np.testing.assert_allclose(value * [1, 1, 180 / np.pi], truth, rtol=0, atol=1e-10)
    np.testing.assert_array_equal(colorimetry.lch(np.array([30.0, 0, 0])), [30, 0, 0])


def test_srgb_agrees_with_colour(colour: Any) -> None:
    space = colour.RGB_COLOURSPACES["sRGB"].copy()
    space.use_derived_transformation_matrices(True)  # the printed ones have four digits
    values = RANDOM.uniform(0, 100, (200, 3))
    linear = np.asarray(values / 100 @ space.matrix_XYZ_to_RGB.T)
    assert (linear < 0).any()
    truth = np.where(linear < 0, 12.92 * linear, colour.models.eotf_inverse_sRGB(np.maximum(linear, 0)))
    np.testing.assert_allclose(colorimetry.srgb(values), truth, rtol=0, atol=1e-10)
    np.testing.assert_allclose(colorimetry.srgb(values, clip=True), np.clip(truth, 0, 1), rtol=0, atol=1e-10)


def test_differences_agree_with_colour(colour: Any) -> None:
    for ours, method in (("delta_e_2000", "CIE 2000"), ("delta_e_76", "CIE 1976"), ("delta_e_94", "CIE 1994")):
        known = {"textiles": False} if method == "CIE 1994" else {}
        truth = colour.delta_E(LABS[0], LABS[1], method=method, **known)
        np.testing.assert_allclose(getattr(colorimetry, ours)(LABS[0], LABS[1]), truth, rtol=0, atol=1e-10)


def test_components_add_up_and_are_smooth_at_equal_colors() -> None:
    parts = np.asarray(colorimetry.components_2000(LABS[0], LABS[1]))
    difference = np.asarray(colorimetry.delta_e_2000(LABS[0], LABS[1]))
    np.testing.assert_allclose(np.linalg.norm(parts, axis=-1), difference, rtol=1e-12)
    jacobian = jax.jacfwd(colorimetry.components_2000)(jnp.asarray(LABS[0, 0]), jnp.asarray(LABS[0, 0]))
    step = 1e-5 * np.array([0.3, -0.5, 0.8])
    moved = colorimetry.delta_e_2000(LABS[0, 0] + step, LABS[0, 0])
    assert moved == pytest.approx(np.linalg.norm(jacobian @ step), rel=1e-4)


def test_published_differences() -> None:
    first, second, truth = SHARMA[:, :3], SHARMA[:, 3:6], SHARMA[:, 6]
    # Printed to four digits.
    np.testing.assert_allclose(colorimetry.delta_e_2000(first, second), truth, rtol=0, atol=5.1e-5)
    np.testing.assert_allclose(colorimetry.delta_e_2000(second, first), truth, rtol=0, atol=5.1e-5)


@pytest.mark.parametrize("illuminant", colorimetry.ILLUMINANTS)
def test_perfect_diffuser_is_white_and_grays_are_gray(illuminant: Any) -> None:
    white = colorimetry.white(VISIBLE, illuminant)
    assert white[1] == pytest.approx(100, rel=1e-14)
    np.testing.assert_allclose(colorimetry.lab(white, white), [100, 0, 0], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(colorimetry.srgb(white, white), [1, 1, 1])
    gray = np.asarray(colorimetry.srgb(0.18 * white, white))
    np.testing.assert_allclose(gray, gray[0], rtol=0, atol=1e-15)
    assert gray[0] == pytest.approx(0.461356, abs=1e-6)  # 1.055 · 0.18^(1/2.4) - 0.055


def test_partial_spectra_only_if_told() -> None:
    nm = np.arange(450.0, 651.0, 10.0)
    with pytest.raises(ValueError, match=r"450 to 650 nm do not cover 400 to 700 nm.*partial=True"):
        colorimetry.white(nm)
    assert colorimetry.white(nm, partial=True)[1] == pytest.approx(100)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            {"wavelengths_nm": np.arange(340.0, 741, 10), "practice": "sum"},
            "340 nm is outside the tables of D65 and CIE 1931, 360 nm",
        ),
        ({"wavelengths_nm": np.arange(400.0, 791, 10), "practice": "sum"}, "790 nm is outside.*780 nm"),
        (
            {"wavelengths_nm": [400.0, 410.0, 430.0]},
            "not equally spaced: from 400 to 410 nm the step is not 15 nm",
        ),
        ({"wavelengths_nm": [500.0, 500.0]}, "not equally spaced"),
        ({"wavelengths_nm": np.arange(400.0, 701, 25)}, "25 nm is too coarse.*at most 20 nm"),
        ({"wavelengths_nm": [550.0]}, r"shape \(1,\) give no color"),
        ({"wavelengths_nm": [400.0, np.nan]}, "give no color"),
        ({"illuminant": "D93"}, "'D93' is not an illuminant: expected one of A, C, D50"),
        ({"practice": "CIE"}, "'CIE' is not a practice: expected one of ASTM E308, sum"),
        (
            {"wavelengths_nm": np.linspace(400, 700, 26), "practice": "ASTM E308"},
            "E308 is not defined for 400 to 700 nm in steps of 12 nm: expected multiples",
        ),
        (
            {"wavelengths_nm": np.arange(395.0, 751, 10), "practice": "ASTM E308"},
            "E308 is not defined for 395 to 745 nm in steps of 10 nm",
        ),
        ({"observer": "2°"}, "'2°' is not an observer: expected one of CIE 1931, CIE 1964"),
        ({"reflectance": np.ones(5)}, r"shape \(5,\) does not fit 36 wavelengths"),
        ({"reflectance": np.float64(1)}, r"shape \(\) does not fit"),
    ],
)
def test_refusals(change: dict[str, Any], said: str) -> None:
    given = {"reflectance": np.ones(36), "wavelengths_nm": VISIBLE} | change
    with pytest.raises(ValueError, match=said):
        colorimetry.xyz.__wrapped__(**given)  # type: ignore[attr-defined]  # without the checks of the types


def test_traced_wavelengths_are_refused() -> None:
    with pytest.raises(ValueError, match="wavelengths are traced"):
        jax.jit(lambda nm: colorimetry.white(nm))(VISIBLE)


def to_color(spectrum: jax.Array) -> jax.Array:
    """Everything that a spectrum goes through."""
    white = colorimetry.white(VISIBLE)
    value = colorimetry.xyz(spectrum, VISIBLE)
    lab = colorimetry.lab(value, white)
    standard = jnp.array([50.0, 10.0, -20.0])
    return jnp.concatenate(
        [lab, colorimetry.lch(lab), colorimetry.srgb(value, white), colorimetry.delta_e_2000(lab, standard)[None]]
    )


@pytest.fixture(scope="module")
def slopes() -> Any:
    """Spectra to gradients; one program for all tests, hence five spectra at a time."""
    return jax.jit(jax.vmap(jax.jacrev(to_color)))


def test_gradients_against_finite_differences(slopes: Any) -> None:
    spectra = np.concatenate([SPECTRA[:3], SPECTRA[:1] * 1e-3, 1 - 0.01 * SPECTRA[:1]])
    step = 1e-6
    stepped = spectra[:, None] + step * np.array([1, -1])[:, None, None, None] * np.eye(VISIBLE.size)
    above, below = np.asarray(jax.jit(jax.vmap(to_color))(stepped.reshape(-1, VISIBLE.size))).reshape(
        2, 5, VISIBLE.size, -1
    )
    # Central differences: curvature of the dark spectrum, and rounding of 1e-13 / step.
    np.testing.assert_allclose(slopes(spectra), (above - below).swapaxes(1, 2) / (2 * step), rtol=2e-5, atol=1e-6)


def test_gradients_are_finite_at_black_gray_and_white(slopes: Any) -> None:
    levels = np.array([0.0, 1e-300, 1e-12, 0.18, 1.0])
    assert np.isfinite(slopes(levels[:, None] * np.ones(VISIBLE.size))).all()


def test_gradients_of_differences_are_finite_where_there_is_none() -> None:
    neutral, blue, black = np.array([50.0, 0, 0]), np.array([50.0, 10.0, -40.0]), np.zeros(3)
    pairs = [(neutral, neutral), (blue, blue), (neutral, blue), (blue, neutral), (black, black)]
    first, second = map(np.stack, zip(*pairs, strict=True))
    for difference in (colorimetry.delta_e_76, colorimetry.delta_e_94):
        assert np.isfinite(jax.jit(jax.vmap(jax.grad(difference, (0, 1))))(first, second)).all()
    gradients = jax.jit(jax.vmap(jax.grad(colorimetry.delta_e_2000, (0, 1))))(first, second)
    assert np.isfinite(gradients).all()
    # For equal colors all directions lead upward: no slope is the fair answer.
    np.testing.assert_array_equal(np.asarray(gradients)[:, [0, 1, 4]], 0)


def test_single_precision_stays_single() -> None:
    value = colorimetry.xyz(jnp.asarray(SPECTRA, jnp.float32), VISIBLE)
    white = colorimetry.white(VISIBLE).astype(jnp.float32)
    assert {value.dtype, colorimetry.srgb(value).dtype, colorimetry.lab(value, white).dtype} == {
        jnp.dtype("float32")
    }
    np.testing.assert_allclose(value, colorimetry.xyz(SPECTRA, VISIBLE), rtol=1e-6)


def test_gold_is_yellow() -> None:
    gold = vc.Specular(jnp.asarray(vc.materials.refractive_index("Au-Johnson", VISIBLE)))
    scene = vc.Scene(vc.VGrooves(np.pi), gold, vc.Diffuse(), vc.View())
    white = vc.colorimetry.white(VISIBLE)
    red, green, blue = vc.colorimetry.srgb(vc.colorimetry.xyz(vc.reflectance_factor(scene), VISIBLE), white)
    assert red > green > blue > 0


def test_colour_science_is_not_imported() -> None:
    code = (
        "import sys, numpy as np, vcavity_jax as vc; vc.colorimetry.white(np.arange(400., 701., 10.));"
        "sys.exit('colour' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
