"""Fits end to end: rendered and real samples with known answers, exact recoveries, coverage, refusals."""

import json
import warnings
from pathlib import Path

import jax
import numpy as np
import pytest

import vcavity_jax as vc
from fitting import Estimate, FitResult, Measurement, assembly, fit, free, read_spectrum, report, solve

DATA = Path(__file__).parents[2] / "examples" / "data"
BAND = np.array([450.0, 500.0, 550.0, 600.0, 650.0, 700.0])
RED = np.array([0.08, 0.12, 0.3, 0.55, 0.7, 0.75])
FAN = np.radians([0.0, 25.0, 50.0, 70.0])


def metal(name, wavelengths_nm, polarization="full"):
    return vc.Specular(vc.materials.refractive_index(name, wavelengths_nm), polarization)


def scene_of(surface, material):
    return vc.Scene(surface, material, vc.Diffuse(), vc.View())


def observe(scene, polar=FAN, sigma=0.003, gain=1.0, offset=0.0, noise=None):
    """Values of the model itself, with noise of the stated uncertainty if a generator is given."""
    seen = vc.Scene(scene.surface, scene.material, scene.illumination, vc.View(polar, np.zeros(len(polar))))
    values = np.asarray(vc.reflectance_factor(seen))
    values = gain * np.broadcast_to(values.reshape(len(polar), -1), (len(polar), len(BAND))) + offset
    if noise is not None:
        values = values + sigma * noise.standard_normal(values.shape)
    return Measurement(BAND, polar, np.zeros(len(polar)), values, np.full(values.shape, sigma))


def degrees(estimate: Estimate) -> float:
    return float(np.degrees(estimate.value))


def assert_recovered(result: FitResult, truth_deg: float) -> None:
    """Within four standard errors and 0.3 degrees, at the noise that the file states."""
    angle = result.estimates["angle"]
    assert result.status == "converged"
    assert result.identifiable
    assert abs(degrees(angle) - truth_deg) < min(0.3, 4 * np.degrees(angle.standard_error))
    assert 0.7 < result.chi_square / result.degrees_of_freedom < 1.3
    low, high = angle.interval_95[0]
    assert low < angle.value < high
    assert np.degrees(high - low) < 1


@pytest.fixture(scope="module")
def gold() -> FitResult:
    m = Measurement.read(DATA / "gold-v45.csv")
    return fit(scene_of(vc.VGrooves(2.0), metal("Au-Johnson", m.wavelengths_nm)), m, [free.angle()])


def test_rendered_gold(gold):
    assert_recovered(gold, 45)
    # 45 degrees is 180/4: the frontal view's number of reflections changes there, and below it half of what
    # the fan says about the angle is gone.
    angle = gold.estimates["angle"]
    assert angle.at_kink
    left, right = angle.one_sided_errors
    assert left / right == pytest.approx(1.96, abs=0.05)
    assert angle.standard_error == pytest.approx(right, rel=0.01)
    assert np.degrees(gold.scene.surface.angle) == pytest.approx(degrees(gold.estimates["angle"]))
    assert gold.rms_misfit == pytest.approx(np.sqrt(np.mean(gold.residuals**2)))
    measured = gold.measurement.reflectance_factor
    assert np.allclose(gold.predicted + gold.residuals, measured, rtol=0, atol=1e-15)
    assert gold.chi_square == pytest.approx(np.sum((gold.residuals / 0.003) ** 2), rel=1e-9)


def test_unpolarized_products_describe_gold_visibly_worse(gold):
    m = gold.measurement
    scene = scene_of(vc.VGrooves(2.0), metal("Au-Johnson", m.wavelengths_nm, "unpolarized"))
    result = fit(scene, m, [free.angle()])
    assert result.chi_square > 3 * gold.chi_square
    assert "does not describe this spectrum" in " ".join(result.warnings)
    assert "standard errors are not to be trusted" in result.summary()
    assert "do not trust it: the model does not describe the data" in result.message
    assert (result.describes_data, gold.describes_data) == (False, True)


def test_rendered_copper():
    m = Measurement.read(DATA / "copper-v70.csv")
    assert_recovered(
        fit(scene_of(vc.VGrooves(1.0), metal("Cu-Johnson", m.wavelengths_nm)), m, [free.angle(20, 175)]), 70
    )


def test_rendered_matte_orange():
    m = Measurement.read(DATA / "orange-v60.csv")
    wavelengths, reflectance, _ = read_spectrum(DATA / "flat-orange.csv")
    assert np.array_equal(wavelengths, m.wavelengths_nm)
    assert_recovered(fit(scene_of(vc.VGrooves(1.0), vc.Lambertian(reflectance)), m, [free.angle()]), 60)


def test_varnished_cyan_taken_for_a_matte_one_is_flagged():
    """Compiled for the orange already: it has the same directions and wavelengths."""
    m = Measurement.read(DATA / "cyan-varnished-v75.csv")
    _, reflectance, _ = read_spectrum(DATA / "flat-cyan.csv")
    scene = scene_of(vc.VGrooves(1.0), vc.Lambertian(reflectance))
    result = fit(scene, m, [free.angle()])
    assert abs(degrees(result.estimates["angle"]) - 75) > 40  # A wrong answer that looks precise.
    assert result.estimates["angle"].standard_error < np.radians(0.2)
    answer = result.to_dict()
    assert (answer["status"], answer["describes_data"]) == ("converged", False)
    assert answer["message"] in result.summary()
    assert "do not trust it: the model does not describe the data" in answer["message"]
    poor, structured = answer["warnings"]
    assert "does not describe this spectrum" in poor
    assert "--material interfaced" in poor
    assert "neighboring wavelengths go together" in structured
    assert "--material interfaced" not in structured  # Once is enough.

    # Without an uncertainty chi-square says nothing, but the residuals do not look like noise.
    silent = Measurement(m.wavelengths_nm, m.polar, m.azimuth, m.reflectance_factor)
    result = fit(scene, silent, [free.angle()])
    assert result.describes_data is None
    (unknown, structured) = result.warnings
    assert "states no uncertainty" in unknown
    assert "neighboring wavelengths go together" in structured
    assert "InterfacedLambertian" in structured


def test_real_metals():
    """Three metals, one compilation: the index is handed to the compiled model."""
    path = DATA / "metals-nasa-tn-d-5353.csv"
    programs = set()
    for sample, index, roughness, rms, good in (
        ("nickel", "Ni-Johnson", 0.50, 0.008, True),
        ("titanium", "Ti-Johnson", 1.66, 0.02, True),
        ("copper", "Cu-Johnson", 0.81, 0.045, False),
    ):
        m = Measurement.read(path, column=sample).select(wavelengths_nm=(390.0, 800.0))
        scene = scene_of(vc.BeckmannGrooves(0.3), metal(index, m.wavelengths_nm))
        result = fit(scene, m, [free.roughness()], standard_uncertainty=0.02, tolerance=1e-6)
        assert result.status == "converged"
        assert result.estimates["roughness"].value == pytest.approx(roughness, abs=0.02)
        assert result.rms_misfit == pytest.approx(rms, rel=0.15)
        assert ("does not describe" in " ".join(result.warnings)) != good
        programs.add(id(assembly.build(scene, m, [free.roughness()], 0.02, 1e-6).programs))
    assert len(programs) == 1


def test_a_smooth_metal_gives_a_limit_only():
    """At the wavelengths of the real metals: compiled already."""
    path = DATA / "metals-nasa-tn-d-5353.csv"
    real = Measurement.read(path, column="nickel").select(wavelengths_nm=(390.0, 800.0))
    nm = real.wavelengths_nm
    scene = vc.Scene(vc.BeckmannGrooves(0.03), metal("Au-Johnson", nm), vc.Diffuse(), vc.View(real.polar))
    values = np.asarray(vc.reflectance_factor(scene, tolerance=1e-6))
    m = Measurement(nm, real.polar, real.azimuth, values, np.full(values.shape, 0.005))
    result = fit(scene, m, [free.roughness(0.02, 0.3)], tolerance=1e-6)
    words = " ".join(result.warnings)
    assert "upper end as a limit" in words
    assert "at most" in words
    assert not result.identifiable


def test_gain_and_offset_are_recovered_exactly():
    scene = scene_of(vc.VGrooves(np.radians(63.0)), metal("Cu-Johnson", BAND))
    m = observe(scene, gain=1.07, offset=-0.012)
    result = fit(scene, m, [free.offset(None), free.angle(), free.gain(None)])
    assert list(result.estimates) == ["angle", "gain", "offset"]
    assert degrees(result.estimates["angle"]) == pytest.approx(63, abs=1e-6)
    assert result.estimates["gain"].value == pytest.approx(1.07, abs=1e-7)
    assert result.estimates["offset"].value == pytest.approx(-0.012, abs=1e-7)
    assert result.chi_square < 1e-9
    for name in ("gain", "offset"):
        estimate = result.estimates[name]
        ((low, high),) = estimate.interval_95
        # Away from kinks the profile is close to a parabola of the Gauss-Newton width.
        assert (high - low) / (2 * 1.96 * estimate.standard_error) == pytest.approx(1, abs=0.3)
        values, cost = result.profiles[name]
        assert np.interp(low, values, cost) == pytest.approx(3.84, abs=0.15)


def test_a_prior_pulls():
    scene = scene_of(vc.VGrooves(np.radians(63.0)), metal("Cu-Johnson", BAND))
    m = observe(scene, gain=1.07, offset=-0.012)
    free_gain = fit(scene, m, [free.angle(), free.gain(None), free.offset(None)])
    held = fit(scene, m, [free.angle(), free.gain(), free.offset()])
    assert held.degrees_of_freedom == free_gain.degrees_of_freedom + 2
    assert 1 < held.estimates["gain"].value < 1.07
    assert held.chi_square > free_gain.chi_square + 1
    assert held.estimates["gain"].standard_error < 0.01


@pytest.mark.parametrize(
    ("gain", "offset"), [((1.0, 0.01), None), (None, (0.0, 0.002)), (None, None), ((1.0, 0.01), (0.0, 0.002))]
)
def test_only_gain_and_offset(gain, offset):
    """Against the normal equations, each prior one more row."""
    scene = scene_of(vc.VGrooves(np.radians(63.0)), vc.Lambertian(RED))
    m = observe(scene, gain=1.01, offset=0.004, noise=np.random.default_rng(3))
    result = fit(scene, m, [free.gain(gain), free.offset(offset)])
    model = vc.reflectance_factor(vc.Scene(scene.surface, scene.material, scene.illumination, vc.View(m.polar)))
    rows = np.stack([np.ravel(model), np.ones(model.size)], axis=1) / 0.003
    target = np.ravel(m.reflectance_factor) / 0.003
    for column, prior in enumerate((gain, offset)):
        if prior is not None:
            rows = np.vstack([rows, np.eye(2)[column] / prior[1]])
            target = np.append(target, prior[0] / prior[1])
    wanted, chi_square, _, _ = np.linalg.lstsq(rows, target)
    errors = np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)))
    assert result.status == "converged"
    assert result.chi_square == pytest.approx(chi_square[0], rel=1e-9)
    assert result.degrees_of_freedom == len(target) - 2
    for estimate, value, error in zip(result.estimates.values(), wanted, errors, strict=True):
        assert estimate.value == pytest.approx(value, abs=1e-9)
        assert estimate.standard_error == pytest.approx(error, rel=1e-9)
        ((low, high),) = estimate.interval_95
        assert (low, high) == pytest.approx((value - 1.959964 * error, value + 1.959964 * error), rel=1e-6)
    assert list(result.profiles) == ["gain", "offset"]


def test_only_a_gain_of_a_measurement_without_uncertainty():
    scene = scene_of(vc.VGrooves(np.radians(63.0)), vc.Lambertian(RED))
    m = observe(scene, gain=1.2, noise=np.random.default_rng(4))
    silent = Measurement(BAND, m.polar, m.azimuth, m.reflectance_factor)
    result = fit(scene, silent, [free.gain(None)])
    assert result.status == "converged"
    assert abs(result.estimates["gain"].value - 1.2) < 4 * result.estimates["gain"].standard_error
    assert result.chi_square == pytest.approx(result.degrees_of_freedom, rel=1e-6)
    assert np.sqrt(np.mean(result.residuals**2)) == pytest.approx(0.003, rel=0.5)


def test_a_kink_counts_where_the_slopes_differ_or_on_it():
    """Against one-sided differences of the model: every kink of a fan between 40 and 70 degrees."""
    scene = scene_of(vc.VGrooves(1.0), metal("Cu-Johnson", BAND))
    built = assembly.build(scene, observe(scene), [free.angle(40, 70)], None, 1e-8)
    step, no_spectra = 2e-5, np.zeros((1, 0, 1))
    seen = {False: 0, True: 0}
    kinks = built.kinks(0)
    for kink in kinks:
        places = kink + step * np.array([-1.0, -0.1, 0.1, 1.0])
        values = np.stack(
            [vc.reflectance_factor(built.fitted_scenes(np.array([at]), no_spectra[0])[0]) for at in places]
        )
        left, right = np.linalg.norm(values[1] - values[0]), np.linalg.norm(values[3] - values[2])
        ratio = max(left, right) / min(left, right)
        if 1.4 < ratio < 1.6 or np.sort(np.abs(kinks - kink))[1] < 1e-4:
            continue
        beside, on = (report._still(built, np.array([[at]]), no_spectra) for at in (kink + 5e-5, kink))
        felt = report._kink_within_reach(built, beside, 0, 1e-4)
        assert (felt is not None) == (ratio > 1.5)
        assert report._kink_within_reach(built, on, 0, 0.0) is not None
        assert report._kink_within_reach(built, beside, 0, 1e-5) is None
        if felt is not None:
            assert max(felt.errors) / min(felt.errors) == pytest.approx(ratio, rel=0.02)
        seen[ratio > 1.5] += 1
    assert min(seen.values()) > 0


@pytest.mark.parametrize("material", ["metal", "matte"])
def test_noiseless_angles_are_recovered_everywhere(material):
    """Random angles, and exact kinks, of one kind of scene: compiled once."""
    panels = metal("Cu-Johnson", BAND) if material == "metal" else vc.Lambertian(RED)
    random = np.degrees(np.random.default_rng(5).uniform(np.radians(12), np.radians(170), 8))
    kinks = [45.0, 60.0, 90.0, 50.0, 100.0] if material == "metal" else [50.0, 100.0]
    random = random if material == "metal" else random[:2]
    lowest = 8 if material == "metal" else 20  # Narrow matte grooves only take time.
    for truth in [*random, *kinks]:
        scene = scene_of(vc.VGrooves(np.radians(truth)), panels)
        result = fit(scene, observe(scene), [free.angle(lowest, 178)])
        assert degrees(result.estimates["angle"]) == pytest.approx(truth, abs=2e-5), truth
        assert result.chi_square < 1e-6
        assert not any(w.startswith("the model gave no number") for w in result.warnings)


def test_two_parameters_of_the_scene_and_a_gain():
    scene = scene_of(vc.VGrooves(np.radians(70.0)), vc.Lambertian(0.4))
    reflectance = free.parameter("reflectance", lambda s: s.material.reflectance, 0.02, 0.98)
    m = observe(scene, np.radians([0.0, 60.0, 80.0]), noise=np.random.default_rng(1))
    result = fit(scene, m, [free.angle(30, 120), reflectance, free.gain((1.0, 0.02))])
    assert result.status == "converged"
    for name, truth in (("angle", np.radians(70)), ("reflectance", 0.4), ("gain", 1.0)):
        estimate = result.estimates[name]
        assert abs(estimate.value - truth) < 4 * estimate.standard_error
        # Smooth and close to linear over two standard errors: the profile agrees with the Gauss-Newton error.
        ((low, high),) = estimate.interval_95
        assert (high - low) / (2 * 1.96 * estimate.standard_error) == pytest.approx(1, abs=0.05)
    assert abs(result.correlation[1, 2]) > 0.9  # The others must follow the gain in its profile.
    assert len(result.singular_values) == 3


def test_index_and_coverage_below_an_interface():
    """Of exact values; the index is traced from its lower bound on, the coverage in the whole range."""
    material = vc.InterfacedLambertian(RED, 1.45, vc.Halftone(0.35, RED[::-1]))
    scene = scene_of(vc.VGrooves(np.radians(80.0)), material)
    m = observe(scene, FAN[::3])
    parameters = [
        free.parameter("index", lambda s: s.material.index, 1.3, 1.7),
        free.parameter("coverage", lambda s: s.material.layer.coverage, 0, 1),
    ]
    start = scene_of(scene.surface, vc.InterfacedLambertian(RED, 1.6, vc.Halftone(0.9, RED[::-1])))
    result = fit(start, m, parameters, tolerance=1e-5)
    assert result.status == "converged"
    # Ten times the tolerance over the slopes, which are about 1.
    assert result.estimates["index"].value == pytest.approx(1.45, abs=1e-4)
    assert result.estimates["coverage"].value == pytest.approx(0.35, abs=1e-4)
    assert not any(w.startswith("the model gave no number") for w in result.warnings)


def test_an_interface_is_compiled_in_and_what_lies_below_is_passed_on():
    def built(reflectance, index, layer=None, parameters=None, polar=FAN):
        scene = scene_of(vc.VGrooves(1.0), vc.InterfacedLambertian(reflectance, index, layer))
        m = Measurement(BAND, polar, 0 * polar, np.full((len(polar), 6), 0.3), np.full((len(polar), 6), 0.01))
        return assembly.build(scene, m, parameters or [free.angle(40, 120)], None, 1e-4)

    first = built(RED, 1.5)
    assert built(RED[::-1], 1.5).programs is first.programs
    assert built(RED, 1.4).programs is not first.programs
    inked = built(RED, 1.5, vc.Halftone(0.3, RED))
    assert built(RED, 1.5, vc.Halftone(0.8, RED[::-1])).programs is inked.programs
    index = free.parameter("index", lambda s: s.material.index, 1.2, 2)
    lower = free.parameter("index", lambda s: s.material.index, 1.1, 2)
    # The lower bound says how fine the interface must be resolved.
    assert built(RED, 1.5, None, [index]).programs is not built(RED, 1.5, None, [lower]).programs
    with pytest.raises(ValueError, match=r"'n' at its bound: 0.9 is not a refractive index of an interface"):
        built(RED, 1.5, None, [free.parameter("n", lambda s: s.material.index, 0.9, 2)])
    with pytest.raises(ValueError, match=r"angles from 1.5 degrees; expected a lower bound of at least 2 degrees"):
        built(RED, 1.5, None, [free.angle(1.5)])
    with pytest.raises(
        ValueError, match="'a': its place is not in this scene of VGrooves and InterfacedLambertian"
    ):
        built(RED, 1.5, None, [free.parameter("a", lambda s: s.material.layer.coverage, 0, 1)])


def test_missing_values_are_left_out():
    scene = scene_of(vc.VGrooves(np.radians(63.0)), metal("Cu-Johnson", BAND))
    m = observe(scene)
    values = m.reflectance_factor.copy()
    values[1, 2] = np.nan
    gappy = Measurement(BAND, m.polar, m.azimuth, values, m.standard_uncertainty)
    result = fit(scene, gappy, [free.angle()])
    assert result.degrees_of_freedom == values.size - 2
    assert np.isnan(result.residuals[1, 2])
    assert np.isfinite(result.predicted).all()
    assert degrees(result.estimates["angle"]) == pytest.approx(63, abs=1e-6)


def test_an_unknown_uncertainty_is_estimated():
    scene = scene_of(vc.VGrooves(np.radians(63.0)), metal("Cu-Johnson", BAND))
    m = observe(scene, noise=np.random.default_rng(2))
    silent = Measurement(BAND, m.polar, m.azimuth, m.reflectance_factor)
    result = fit(scene, silent, [free.angle(), free.gain()])
    assert result.uncertainty_estimated
    assert result.chi_square == pytest.approx(result.degrees_of_freedom, rel=1e-2)
    assert result.rms_misfit == pytest.approx(0.003, rel=0.5)
    assert "states no uncertainty" in " ".join(result.warnings)
    assert "go together" not in " ".join(result.warnings)
    prior = (result.estimates["gain"].value - 1) / 0.01
    used = result.measurement.standard_uncertainty
    assert np.sum((result.residuals / used) ** 2) + prior**2 == pytest.approx(result.chi_square, rel=1e-9)
    assert silent.standard_uncertainty is None
    given = fit(scene, silent, [free.angle(), free.gain()], standard_uncertainty=0.003)
    assert not given.uncertainty_estimated
    assert np.all(given.measurement.standard_uncertainty == 0.003)
    assert given.estimates["angle"].value == pytest.approx(result.estimates["angle"].value, abs=1e-4)


def test_several_minima_are_all_reported():
    # In one color, seen at 60 degrees, three angles of a dielectric groove give the same value exactly.
    scene = scene_of(vc.VGrooves(np.radians(75.0)), vc.Specular(np.full(6, 3.0 + 0.0j)))
    m = observe(scene, np.radians([60.0]), sigma=0.004)
    result = fit(scene, m, [free.angle(10, 175)])
    found = sorted(minimum.values["angle"] for minimum in result.minima)
    assert np.degrees(found) == pytest.approx([75.0, 123.06, 149.31], abs=0.01)
    assert max(minimum.chi_square for minimum in result.minima) < 1e-6
    for value in found:
        again = fit(scene, m, [free.angle(np.degrees(value) - 2, np.degrees(value) + 2)])
        assert again.estimates["angle"].value == pytest.approx(value, abs=1e-6)
    assert len(result.estimates["angle"].interval_95) == 2
    assert "3 distinct minima" in " ".join(result.warnings)
    assert "minima: angle" in result.summary()


def test_json_has_the_promised_form(gold, tmp_path):
    path = tmp_path / "fit.json"
    gold.to_json(path)

    def refuse(word):
        raise AssertionError(word)

    content = json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)
    assert content == json.loads(json.dumps(gold.to_dict()))
    assert content["status"] == "converged"
    assert content["identifiable"] is True
    assert content["describes_data"] is True
    assert content["version"] == vc.__version__
    angle = content["parameters"]["angle"]
    assert angle["unit"] == "deg"
    assert angle["value"] == pytest.approx(45, abs=0.3)
    assert angle["interval_95"][0][0] < angle["value"] < angle["interval_95"][0][1]
    assert set(angle) == {"value", "unit", "standard_error", "interval_95", "at_bound", "at_kink"}
    assert content["minima"][0]["parameters"]["angle"] == angle["value"]
    assert content["scene"]["surface"] == {"type": "VGrooves", "angle_deg": angle["value"]}
    assert content["scene"]["view"]["polar_deg"][0] == 0


def test_summary_reads_well(gold):
    first, second = gold.summary().splitlines()[:2]
    assert first.split() == ["parameter", "value", "std.", "error", "95", "%", "interval"]
    assert second.startswith("angle")
    assert " deg " in second
    assert "±" in second


def test_profile_closes_around_the_minimum(gold):
    values, cost = gold.profiles["angle"]
    assert np.all(np.diff(values) > 0)
    assert cost.min() == pytest.approx(gold.chi_square, abs=1e-9)
    ((low, high),) = gold.estimates["angle"].interval_95
    assert np.interp([low, high], values, cost) - gold.chi_square == pytest.approx([3.84, 3.84], abs=0.02)


def orange_like() -> tuple[vc.Scene, Measurement]:
    scene = scene_of(vc.VGrooves(1.0), vc.Lambertian(RED))
    return scene, observe(scene, np.zeros(1))


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ([], "no parameter is free"),
        ([free.roughness()], "'roughness': its place is not in this scene"),
        ([free.parameter("x", lambda s: s.nothing, 0, 1)], "'x': its place is not in this scene"),
        ([free.parameter("r", lambda s: s.material.reflectance, 0, 1)], r"shape \(6,\)"),
        ([free.parameter("m", lambda s: s.material, 0, 1)], "holds a Lambertian"),
        ([free.angle(), free.angle(20)], "given twice"),
        ([free.angle(0.05)], "angles from 0.05 degrees; expected a lower bound of at least 0.1 degrees"),
        ([free.angle(), free.parameter("a", lambda s: s.surface.angle, 1, 2)], "the same number"),
        ([free.parameter("a", lambda s: s.surface.angle, 1, 4)], "at its bound: 4 is not a dihedral angle"),
        ([free.parameter(f"p{i}", lambda s: s.surface.angle, 1, 2) for i in range(4)], "expected at most 3"),
    ],
)
def test_unusable_parameters_are_refused(parameters, message):
    scene, m = orange_like()
    with pytest.raises(ValueError, match=message) as caught:
        fit(scene, m, parameters)
    assert "\n" not in str(caught.value)


def test_unusable_measurements_are_refused():
    scene, m = orange_like()
    empty = Measurement(BAND, m.polar, m.azimuth, np.full((1, 6), np.nan))
    with pytest.raises(ValueError, match="holds no value"):
        fit(scene, empty, [free.angle()])
    lit = vc.Scene(scene.surface, scene.material, vc.Directional(0.3), vc.View())
    with pytest.raises(ValueError, match=r"lit by Directional\(0.3, 0\), the measurement by Diffuse\(\)"):
        fit(lit, m, [free.angle()])
    disk = vc.Scene(scene.surface, scene.material, vc.Directional(0.3, solid_angle=0.01), vc.View())
    parallel = Measurement(BAND, m.polar, m.azimuth, m.reflectance_factor, illumination=vc.Directional(0.3))
    with pytest.raises(
        ValueError, match=r"lit by Directional\(0.3, 0, 0.01\), the measurement by Directional\(0.3, 0\)"
    ):
        fit(disk, parallel, [free.angle()])
    short = vc.Scene(scene.surface, vc.Lambertian(RED[:4]), vc.Diffuse(), vc.View())
    with pytest.raises(ValueError, match=r"wavelength shape \(4,\), the measurement 6 wavelengths"):
        fit(short, m, [free.angle()])
    one = Measurement(BAND[:1], m.polar, m.azimuth, m.reflectance_factor[:, :1])
    gray = vc.Scene(scene.surface, vc.Lambertian(0.3), vc.Diffuse(), vc.View())
    with pytest.raises(ValueError, match="1 measured values for 3 free parameters"):
        fit(gray, one, [free.angle(), free.gain(None), free.offset(None)])
    silent = Measurement(BAND[:1], m.polar, m.azimuth, m.reflectance_factor[:, :1])
    with pytest.raises(ValueError, match="no degree of freedom is left to estimate it"):
        fit(gray, silent, [free.angle()])
    for bad in (0.0, -0.01, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="expected one positive number"):
            fit(scene, m, [free.angle()], standard_uncertainty=bad)
    with pytest.raises(ValueError, match="expected a whole number"):
        fit(scene, m, [free.angle()], max_steps=0)


def test_float32_is_said_once(monkeypatch):
    monkeypatch.setattr(solve, "_warned_of_float32", False)
    with jax.enable_x64(False):
        with pytest.warns(UserWarning, match="float32"):
            solve.warn_of_float32()
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            solve.warn_of_float32()


@pytest.mark.slow
@pytest.mark.parametrize("truth_deg", [63.0, 90.0])
def test_profile_intervals_cover_the_truth(truth_deg):
    """200 replicates, truth away from kinks and on one: 90 to 99 %, three binomial errors around 95 %."""
    scene = scene_of(vc.VGrooves(np.radians(truth_deg)), metal("Au-Johnson", BAND))
    random = np.random.default_rng(20240607)
    covered = 0
    for _ in range(200):
        result = fit(scene, observe(scene, np.zeros(1), sigma=0.005, noise=random), [free.angle(50, 125)])
        pieces = result.estimates["angle"].interval_95
        covered += any(low <= np.radians(truth_deg) <= high for low, high in pieces)
    assert 180 <= covered <= 198


def test_programs_are_kept_between_fits():
    scene, m = orange_like()
    first = assembly.build(scene, m, [free.angle()], None, 1e-8)
    moved = vc.Scene(vc.VGrooves(0.7), scene.material, vc.Diffuse(), vc.View())
    # The lower bound alone is compiled in: it says how fine the narrowest groove must be resolved.
    again = assembly.build(moved, m, [free.angle(upper_deg=90)], 0.01, 1e-8)
    narrower = assembly.build(moved, m, [free.angle(lower_deg=20)], 0.01, 1e-8)
    other = assembly.build(scene, m, [free.angle(), free.gain()], None, 1e-8)
    assert first.programs is again.programs
    assert first.programs is not other.programs
    assert first.programs is not narrower.programs
