"""The reflectance recovered from a grooved spectrum: round trips, uncertainties, derivatives, honest statuses."""

import dataclasses
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import vcavity_jax as vc
from fitting import Measurement, Recovery, read_spectrum, recover_reflectance
from fitting.recovery import ABOVE, BELOW, MISSING, RECOVERED, UNDETERMINED, reflectance_of

NM = np.linspace(400.0, 700.0, 16)
# Both ends, and the darkest and brightest that are not.
SPECTRUM = np.array([0.0, 1e-9, 1e-4, 0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.9, 0.97, 0.999, 1.0])
GRAY = np.clip(SPECTRUM, 0.05, 0.9)
FRONTAL = vc.View(np.zeros(1))
FAN = vc.View(np.radians([-70.0, 0.0, 35.0]))
# Angles within one degree share a program.
ANGLE = np.radians(60.5)
LAYER = np.linspace(0.3, 0.95, 16)


@pytest.fixture(autouse=True, scope="module")
def _forget_programs() -> Iterator[None]:
    yield
    jax.clear_caches()


def scene(material: Any, view: Any = FAN, light: Any = None, surface: Any = None) -> vc.Scene:
    return vc.Scene(vc.VGrooves(ANGLE) if surface is None else surface, material, light or vc.Diffuse(), view)


def measured(truth: vc.Scene, sigma: Any = None, noise: Any = 0.0, tolerance: float = 1e-12) -> Measurement:
    """What an instrument shows of a scene."""
    sphere = isinstance(truth.view, vc.Hemisphere)
    polar, azimuth = (np.full(1, np.nan),) * 2 if sphere else (truth.view.polar, truth.view.azimuth)
    values = np.asarray(vc.reflectance_factor(truth, tolerance)).reshape(len(polar), -1) + noise
    return Measurement(
        NM,
        np.asarray(polar),
        np.broadcast_to(azimuth, np.shape(polar)),
        values,
        None if sigma is None else np.broadcast_to(sigma, values.shape),
        truth.illumination,
        hemispherical=sphere,
    )


# One tolerance for all tests: each would be compiled for itself.
recover = partial(recover_reflectance, tolerance=1e-12)


def recovered(truth: vc.Scene, **options: Any) -> Recovery:
    """Forget the reflectance, and find it again."""
    blank = dataclasses.replace(truth.material, reflectance=jnp.asarray(0.5))
    return recover(scene(blank, FRONTAL, truth.illumination, truth.surface), measured(truth, **options))


# -- round trips -----------------------------------------------------------------------------------


ROUND_TRIPS: dict[str, vc.Scene] = {
    "several directions": scene(vc.Lambertian(SPECTRUM)),
    "hemisphere, random grooves": scene(vc.Lambertian(SPECTRUM), vc.Hemisphere(), None, vc.BeckmannGrooves(0.7)),
    "random grooves": scene(vc.Lambertian(SPECTRUM), FAN, None, vc.BeckmannGrooves(0.7)),
    "hemisphere": scene(vc.Lambertian(SPECTRUM), vc.Hemisphere()),
    "parallel light": scene(vc.Lambertian(SPECTRUM), FRONTAL, vc.Directional(0.9, 0.3)),
    "layer": scene(vc.InterfacedLambertian(SPECTRUM, 1.5, vc.ColoredLayer(LAYER)), FRONTAL),
}
COSTLY = ("random grooves", "hemisphere", "parallel light", "layer")


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow) if n in COSTLY else n for n in ROUND_TRIPS]
)
def test_round_trip(name: str) -> None:
    """1e-10, though the spectrum is computed on another path, for known angles and views. Measured 3e-13."""
    truth = ROUND_TRIPS[name]
    result = recovered(truth)
    np.testing.assert_allclose(result.reflectance, SPECTRUM, rtol=0, atol=1e-10)
    assert set(result.status) == {RECOVERED}
    assert result.standard_uncertainty is None
    assert result.scene.view.shape == truth.view.shape
    np.testing.assert_array_equal(result.scene.material.reflectance, result.reflectance)
    np.testing.assert_allclose(result.predicted, result.measurement.reflectance_factor, rtol=0, atol=1e-8)


def test_recovery_below_an_interface_and_a_layer() -> None:
    """Without a layer (t = 1), through a dark one, and where it is opaque, where there is no answer."""
    layer = np.where(np.arange(16) < 3, 0.3, 1.0)
    layer[3] = 0.0
    truth = scene(vc.InterfacedLambertian(SPECTRUM, 1.5, vc.ColoredLayer(layer, "berns")), FRONTAL)
    result = recovered(truth, sigma=0.001)
    seen = np.arange(16) != 3
    np.testing.assert_allclose(result.reflectance[seen], SPECTRUM[seen], rtol=0, atol=1e-10)
    assert result.status[3] == UNDETERMINED
    assert set(result.status[seen]) == {RECOVERED}
    assert np.isnan([result.reflectance[3], result.standard_uncertainty[3], result.angle_sensitivity[3]]).all()
    assert any("which an opaque layer hides" in warning and "460 nm" in warning for warning in result.warnings)
    # Light passes the layer twice: what it leaves is all there is to tell reflectances by.
    assert result.amplification[0] > 10
    assert any("average repeated measurements" in warning for warning in result.warnings)


SWEEP = [10.0, 20.0, 45.0, 60.0, 90.0, 120.0, 150.0, 175.0]
MATERIALS: dict[str, Callable[[], Any]] = {
    "bare": lambda: vc.Lambertian(SPECTRUM),
    "interface": lambda: vc.InterfacedLambertian(SPECTRUM, 1.5),
    "layer": lambda: vc.InterfacedLambertian(SPECTRUM, 1.5, vc.ColoredLayer(LAYER)),
}
LIGHTS = {
    "diffuse": vc.Diffuse(),
    "parallel": vc.Directional(0.6, 0.3),
    "mixed": vc.Mixed(0.3, vc.Directional(0.6)),
}
VIEWS = {"frontal": FRONTAL, "oblique": vc.View(np.full(1, np.radians(75.0))), "fan": FAN}


@pytest.mark.slow
@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("material", MATERIALS)
def test_round_trip_everywhere(material: str, light: str, view: str) -> None:
    """10 to 175 degrees, reflectances from 0 to 1, compiled once for all angles. Measured 3e-14."""
    part = MATERIALS[material]()

    @jax.jit
    def again(angle: Any) -> Any:
        truth = vc.Scene(vc.VGrooves(angle), part, LIGHTS[light], VIEWS[view])
        shown = vc.reflectance_factor(truth, 1e-12, smallest_angle=np.radians(10.0))
        return reflectance_of(truth, shown, tolerance=1e-12, smallest_angle=np.radians(10.0))

    for degrees in SWEEP:
        np.testing.assert_allclose(again(np.radians(degrees)), SPECTRUM, rtol=0, atol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("slopes", [vc.BeckmannGrooves, vc.GaussianGrooves])
def test_round_trip_of_random_grooves_with_an_interface(slopes: Any) -> None:
    """Within the tolerance, times the amplification; compiled once for all roughnesses."""
    for roughness in (0.1, 0.5, 2.0):
        truth = scene(vc.InterfacedLambertian(SPECTRUM, 1.5), FRONTAL, surface=slopes(roughness))
        result = recover_reflectance(truth, measured(truth, tolerance=1e-8))
        assert np.max(np.abs(result.reflectance - SPECTRUM) / result.amplification) < 1e-8


# -- uncertainties ---------------------------------------------------------------------------------


def test_uncertainty_against_simulated_measurements() -> None:
    """200 of them: spread and mean, averaged over wavelengths, to three of their own standard errors."""
    truth = scene(vc.Lambertian(GRAY))
    random = np.random.default_rng(20240501)
    sigma = random.uniform(0.002, 0.006, (3, 16))
    perfect = recovered(truth, sigma=sigma)
    np.testing.assert_allclose(perfect.reflectance, GRAY, rtol=0, atol=1e-10)
    blank = scene(vc.Lambertian(0.5))
    found = []
    for _ in range(200):
        values = perfect.measurement.reflectance_factor + sigma * random.standard_normal(sigma.shape)
        found.append(recover(blank, dataclasses.replace(perfect.measurement, reflectance_factor=values)))
    pulls = (np.array([one.reflectance for one in found]) - GRAY) / perfect.standard_uncertainty
    count = pulls.size
    assert np.var(pulls) == pytest.approx(1, abs=3 * np.sqrt(2 / count))
    assert np.mean(pulls) == pytest.approx(0, abs=3 / np.sqrt(count) + 0.01)  # and the bias of second order
    # The misfit of the three directions follows chi-square, so one in a thousand draws the warning.
    assert np.mean([bool(one.warnings) for one in found]) < 0.01


def test_amplification_is_the_uncertainty_of_the_reflectance() -> None:
    """Of one value: 1/slope. Of several alike: as for so many measurements."""
    result = recovered(scene(vc.Lambertian(GRAY)), sigma=0.004)
    np.testing.assert_allclose(result.amplification, result.standard_uncertainty / 0.004, rtol=1e-12)
    np.testing.assert_allclose(result.amplification, 1 / np.sqrt(np.sum(result.slope**2, axis=0)), rtol=1e-12)
    # A direction a thousand times worse than the others counts for nothing.
    worse = recovered(scene(vc.Lambertian(GRAY)), sigma=np.array([[0.004], [4.0], [0.004]]))
    np.testing.assert_allclose(
        worse.standard_uncertainty, 0.004 / np.sqrt(np.sum(result.slope[::2] ** 2, axis=0)), rtol=1e-5
    )


def test_slopes_at_both_ends() -> None:
    """sin(α/2) for black: what one panel shows of it; above 1/sin(α/2) for white."""
    result = recovered(scene(vc.Lambertian(SPECTRUM), FRONTAL, surface=vc.VGrooves(np.radians(10.0))), sigma=0.005)
    sine = np.sin(np.radians(5.0))
    assert result.slope[0, 0] == pytest.approx(sine, rel=1e-9)
    assert result.slope[0, -1] > 1 / sine
    np.testing.assert_allclose(result.reflectance, SPECTRUM, rtol=0, atol=1e-10)
    assert result.amplification[0] == pytest.approx(11.47, abs=0.01)
    warning = next(w for w in result.warnings if "amplified" in w)
    assert "at 5 of 16 wavelengths, 400 nm to 480 nm" in warning
    assert "up to 11.5 times at 400 nm: oblique views across the grooves" in warning


def test_sensitivity_to_the_angle() -> None:
    """Against recoveries with neighboring angles, with noise that the directions disagree about."""
    noise = 0.01 * np.random.default_rng(3).standard_normal((3, 16))
    truth = scene(vc.Lambertian(GRAY))
    result = recovered(truth, sigma=0.01, noise=noise)
    step = 1e-4

    def at(shift: float) -> np.ndarray:
        other = scene(vc.Lambertian(0.5), surface=vc.VGrooves(ANGLE + shift))
        return recover(other, result.measurement).reflectance

    expected = (at(-2 * step) - 8 * at(-step) + 8 * at(step) - at(2 * step)) / (12 * step)
    assert set(result.status) == {RECOVERED}
    np.testing.assert_allclose(result.angle_sensitivity, expected, rtol=0, atol=1e-6)
    assert np.max(np.abs(expected)) > 0.1


# -- derivatives of the pure function --------------------------------------------------------------


def test_derivatives_of_least_squares() -> None:
    """Every argument, backward and in a batch, against differences in the same batch: 1e-6. Measured 1e-10.

    The two directions disagree, so that second derivatives of the model count. Of the last three wavelengths one
    is clipped, one has no value, and one has a single value.
    """
    shown = jnp.asarray([[0.2, 0.6, -0.3, np.nan, 0.4], [0.26, 0.57, -0.3, np.nan, np.nan]])
    start = jnp.asarray(1.1), shown, jnp.asarray([[1.0, 2.0, 1.0, 1.0, 1.0], [0.7, 1.5, 1.0, 1.0, 1.0]])
    mix = np.array([0.7, -0.4, 5.0, 1.0, 0.5])

    def mixed(angle: Any, shown: Any, weights: Any) -> Any:
        view = vc.View(np.array([0.2, 1.2]))
        whole = vc.Scene(vc.VGrooves(angle), vc.Lambertian(0.5), vc.Diffuse(), view)
        found = reflectance_of(whole, shown, weights=weights, smallest_angle=1.0, tolerance=1e-10)
        return jnp.nansum(mix * found), found

    moved, step = [], 1e-4
    for i, number in enumerate(start):
        for place in np.ndindex(number.shape):
            for j in (-2, -1, 1, 2):
                moved.append([n.at[place].add(j * step) if k == i else n for k, n in enumerate(start)])
    narrow, flat = (jnp.asarray(0.9), *start[1:]), (jnp.asarray(np.pi), *start[1:])
    batch = [jnp.stack(column) for column in zip(start, narrow, flat, *moved, strict=True)]
    (values, found), slopes = jax.jit(jax.vmap(jax.value_and_grad(mixed, (0, 1, 2), has_aux=True)))(*batch)

    differences = np.reshape(values[3:], (-1, 4)) @ np.array([1.0, -8.0, 8.0, -1.0]) / (12 * step)
    own = np.concatenate([np.ravel(slope[0]) for slope in slopes])
    np.testing.assert_allclose(own, differences, rtol=0, atol=1e-6)
    assert abs(own[0]) > 0.02
    assert np.isnan(found[0]).tolist() == [False, False, False, True, False]
    assert found[0, 2] == 0.0
    # Below the promised angle nothing is given, as by the model itself; what is flat shows its reflectance.
    assert np.isnan(found[1]).all()
    np.testing.assert_allclose(found[2, 4], 0.4, rtol=1e-9)
    assert np.isfinite(np.concatenate([np.ravel(slope[2]) for slope in slopes])).all()


@pytest.mark.slow
@pytest.mark.parametrize("material", ["interface", "layer"])
@pytest.mark.parametrize("directions", [1, 3])
def test_derivatives_with_an_interface(material: str, directions: int) -> None:
    """Angle and index, forward and backward, against differences: 1e-6. Measured 1e-11."""
    view = vc.View(np.radians([5.0, 40.0, 70.0])[:directions])
    layer = vc.ColoredLayer(jnp.asarray([0.4, 0.7, 0.9])) if material == "layer" else None
    truth = vc.InterfacedLambertian(np.array([0.1, 0.4, 0.9]), 1.5, layer)
    shown = vc.reflectance_factor(vc.Scene(vc.VGrooves(1.1), truth, vc.Diffuse(), view), 1e-11)
    shown = shown + 0.01 * np.random.default_rng(1).standard_normal(shown.shape)

    def found(numbers: Any) -> Any:
        whole = vc.InterfacedLambertian(jnp.asarray(0.5), numbers[1], layer)
        return reflectance_of(
            vc.Scene(vc.VGrooves(numbers[0]), whole, vc.Diffuse(), view),
            shown,
            tolerance=1e-11,
            smallest_angle=1.0,
            smallest_index=1.4,
        )

    start, step = np.array([1.1, 1.5]), 1e-4
    value, slope = jax.jit(found), np.asarray(jax.jit(jax.jacrev(found))(start))
    np.testing.assert_allclose(jax.jit(jax.jacfwd(found))(start), slope, rtol=0, atol=1e-11)
    for i in range(2):
        f = [np.asarray(value(start + j * step * np.eye(2)[i])) for j in (-2, -1, 1, 2)]
        expected = (f[0] - 8 * f[1] + 8 * f[2] - f[3]) / (12 * step)
        np.testing.assert_allclose(slope[:, i], expected, rtol=0, atol=1e-6)


# -- what cannot be recovered ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def troubled() -> Recovery:
    """Too bright at the first wavelength, too dark at the second, nothing at the third, a gap at the fourth."""
    clean = measured(scene(vc.Lambertian(GRAY)), sigma=0.003)
    values = clean.reflectance_factor.copy()
    values[:, 0], values[:, 1], values[:, 2], values[1, 3] = 1.02, -0.006, np.nan, np.nan
    return recover(scene(vc.Lambertian(0.5)), dataclasses.replace(clean, reflectance_factor=values))


def test_status_says_what_became_of_each_wavelength(troubled: Recovery) -> None:
    assert troubled.status.tolist() == [ABOVE, BELOW, MISSING] + 13 * [RECOVERED]
    assert troubled.reflectance[:2].tolist() == [1.0, 0.0]
    assert np.isnan(troubled.reflectance[2])
    np.testing.assert_allclose(troubled.reflectance[3:], GRAY[3:], rtol=0, atol=1e-10)
    for array in (troubled.amplification, troubled.standard_uncertainty, troubled.angle_sensitivity):
        assert np.isnan(array).tolist() == [False, False, True] + 13 * [False]
    assert troubled.angle_sensitivity[:2].tolist() == [0.0, 0.0]
    # Two directions instead of three tell less.
    one = troubled.standard_uncertainty[3] ** -2
    both = troubled.standard_uncertainty[4] ** -2
    assert one < 0.8 * both


def test_warnings_have_numbers(troubled: Recovery) -> None:
    missing, below, above = troubled.warnings
    assert missing == "at 1 of 16 wavelengths, 440 nm, no direction has a value: no reflectance is given there"
    assert below.startswith(
        "at 1 of 16 wavelengths, 420 nm, what was measured lies below what reflectance 0 gives, by up to 0.006 or "
    )
    assert above.startswith(
        "at 1 of 16 wavelengths, 400 nm, what was measured lies above what reflectance 1 gives, by up to 0.02 or "
    )
    assert "standard uncertainties" in above
    assert "check the calibration, the angle, and whether" in above


def test_summary(troubled: Recovery) -> None:
    lines = troubled.summary().splitlines()
    assert lines[0] == "reflectance recovered at 13 of 16 wavelengths, 400 nm to 700 nm, from 3 directions"
    assert lines[1] == "reflectance            0 to 1"
    assert "change per degree of the angle" in lines[4]
    assert [line.partition(": ")[2] for line in lines[5:]] == list(troubled.warnings)
    sphere = dataclasses.replace(troubled, measurement=measured(scene(vc.Lambertian(GRAY), vc.Hemisphere())))
    assert "from all light collected" in sphere.summary()


def test_file_reads_back(troubled: Recovery, tmp_path: Path) -> None:
    path = tmp_path / "recovered.csv"
    troubled.to_csv(path)
    again = Measurement.read(path)
    np.testing.assert_array_equal(again.wavelengths_nm, NM)
    np.testing.assert_array_equal(again.reflectance_factor[0], troubled.reflectance)
    np.testing.assert_array_equal(again.standard_uncertainty[0], troubled.standard_uncertainty)
    assert again.metadata["set_to_1"] == f"400 nm, {ABOVE}"
    assert again.metadata["set_to_0"] == f"420 nm, {BELOW}"
    with pytest.raises(ValueError, match="no reflectance at 440 nm"):
        read_spectrum(path)
    with pytest.raises(FileNotFoundError, match="cannot write"):
        troubled.to_csv(tmp_path / "gone" / "recovered.csv")
    whole = dataclasses.replace(troubled, reflectance=GRAY, standard_uncertainty=None)
    whole.to_csv(path)
    nm, reflectance, _ = read_spectrum(path)
    np.testing.assert_array_equal(nm, NM)
    np.testing.assert_array_equal(reflectance, GRAY)


def test_directions_that_disagree_say_so() -> None:
    """With an angle that is 20 degrees off no reflectance explains all directions."""
    wrong = measured(scene(vc.Lambertian(GRAY), surface=vc.VGrooves(ANGLE + 0.35)), sigma=0.003)
    blank = scene(vc.Lambertian(0.5))
    warning = next(w for w in recover(blank, wrong).warnings if "no reflectance explains all directions" in w)
    assert "for 32 degrees of freedom" in warning
    # Without an uncertainty there is nothing to test it by.
    assert not recover(blank, dataclasses.replace(wrong, standard_uncertainty=None)).warnings


# -- errors ----------------------------------------------------------------------------------------


PLAIN = Measurement(NM, np.zeros(1), np.zeros(1), np.full((1, 16), 0.3))
MIRROR = vc.Specular(1.5 + 0.1j)
PAIR = vc.TwoPanels(vc.Lambertian(0.5), vc.Lambertian(0.6))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: recover_reflectance(scene(MIRROR), PLAIN), "the material is Specular; expected Lambertian or"),
        (
            lambda: recover_reflectance(scene(PAIR), PLAIN),
            "the material is TwoPanels; .* tell their two reflectances",
        ),
        (
            lambda: recover_reflectance(scene(vc.Lambertian(np.full(3, 0.5))), PLAIN),
            r"reflectance has shape \(3,\), the measurement 16 wavelengths; expected \(\) or \(16,\)",
        ),
        (
            lambda: recover_reflectance(
                scene(vc.InterfacedLambertian(0.5, 1.5, vc.ColoredLayer(np.full(3, 0.5)))), PLAIN
            ),
            r"transmittance has shape \(3,\)",
        ),
        (
            lambda: recover_reflectance(scene(vc.Lambertian(0.5), light=vc.Directional(0.5)), PLAIN),
            r"the scene is lit by Directional\(0.5, 0\), the measurement by Diffuse\(\)",
        ),
        (
            lambda: recover_reflectance(
                scene(vc.Lambertian(0.5)), dataclasses.replace(PLAIN, reflectance_factor=np.full((1, 16), np.nan))
            ),
            "holds no value",
        ),
        (
            lambda: recover_reflectance(
                scene(vc.InterfacedLambertian(0.5, 1.5), surface=vc.VGrooves(0.03)), PLAIN
            ),
            "0.03 is not an angle of interfaced grooves that is modeled",
        ),
        (
            lambda: jax.jit(
                lambda a: recover_reflectance(scene(vc.Lambertian(0.5), surface=vc.VGrooves(a)), PLAIN).reflectance
            )(1.0),
            "traced by JAX; expected known numbers: fitting.recovery.reflectance_of",
        ),
        (lambda: recover_reflectance(scene(vc.Lambertian(0.5)), PLAIN, tolerance=2.0), "2.0 is not a tolerance"),
        (lambda: reflectance_of(scene(PAIR), np.full((3, 16), 0.3)), "the material is TwoPanels"),
        (
            lambda: reflectance_of(scene(vc.Lambertian(0.5)), np.full((2, 16), 0.3)),
            r"has shape \(2, 16\); expected \(3,\), of the view's directions, and one more axis",
        ),
    ],
)
def test_errors_are_one_clear_line(call: Callable[[], Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        call()
    assert "\n" not in str(caught.value)
