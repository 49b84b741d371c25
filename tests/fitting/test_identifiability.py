"""What the data determine, and the words for what they do not."""

import numpy as np
import pytest

import vcavity_jax as vc
from fitting import Estimate, Measurement, assembly, fit, free
from fitting.blind_spots import blind_spots
from fitting.identifiability import describes_data, p_value, threshold_95
from fitting.information import local_information, normal_equations

GOLD = np.array([1.46 + 1.95j, 0.97 + 1.87j, 0.4 + 2.6j, 0.17 + 3.2j])
BAND = np.array([450.0, 500.0, 550.0, 650.0])
RED = np.array([0.1, 0.2, 0.5, 0.7])


def synthetic(scene, polar_deg=(0.0,), azimuth_deg=0.0, sigma=0.005, noise=0.0, seed=0):
    polar = np.radians(np.atleast_1d(polar_deg))
    azimuth = np.broadcast_to(np.radians(azimuth_deg), polar.shape)
    seen = vc.Scene(scene.surface, scene.material, scene.illumination, vc.View(polar, azimuth))
    values = np.asarray(vc.reflectance_factor(seen))
    values = values + noise * np.random.default_rng(seed).standard_normal(values.shape)
    return Measurement(BAND, polar, azimuth, values, np.full(values.shape, sigma))


def grooves(degrees, material):
    return vc.Scene(vc.VGrooves(np.radians(degrees)), material, vc.Diffuse(), vc.View())


def information_of(jacobian):
    """From a Jacobian without residuals, priors and free spectra."""
    square = np.zeros((1, 1, jacobian.shape[1] + 1, jacobian.shape[1] + 1))
    square[0, 0, :-1, :-1] = jacobian.T @ jacobian
    none = np.zeros((1, jacobian.shape[1]))
    return local_information(normal_equations(square, none, none + 1, 0))


def test_covariance_of_a_known_jacobian():
    jacobian = np.array([[2.0, 0.0], [0.0, 0.5], [0.0, 0.0]])
    known = information_of(jacobian)
    assert known.standard_errors == pytest.approx([0.5, 2.0])
    assert known.singular_values == pytest.approx([1.0, 1.0])
    assert not known.singular


@pytest.mark.parametrize("jacobian", [np.ones((4, 2)), np.eye(3)[:, :2] * [1, 0], np.full((3, 1), np.nan)])
def test_a_singular_jacobian_has_no_standard_error(jacobian):
    said = information_of(jacobian)
    assert said.singular
    assert np.isnan(said.standard_errors).all()


def test_thresholds():
    assert threshold_95(10, False) == pytest.approx(1.959964**2, rel=1e-6)
    assert threshold_95(4, True) == pytest.approx(2.776445**2, rel=1e-6)
    assert p_value(3.841459, 1) == pytest.approx(0.05, rel=1e-5)
    assert np.isnan(p_value(1.0, 0))


def test_a_fit_is_poor_at_one_in_a_thousand():
    # The point of chi-square with 10 degrees of freedom that 1 in 1000 exceeds is 29.588.
    assert describes_data(29.58, 10, False) is True
    assert describes_data(29.60, 10, False) is False
    assert describes_data(1e6, 10, True) is None
    assert describes_data(0.0, 0, False) is None


def test_a_frontal_mirror_is_blind_beyond_120_degrees():
    scene = grooves(150, vc.Specular(GOLD))
    result = fit(scene, synthetic(scene), [free.angle(100, 180)])
    assert not result.identifiable
    assert result.status == "not identifiable"
    assert np.isnan(result.estimates["angle"].standard_error)
    assert result.estimates["angle"].interval_95[-1][1] == np.pi
    words = " ".join(result.warnings)
    assert "blind" in words
    assert "not determined" in words
    assert "add directions" in result.message


def test_a_flat_surface_ends_on_its_bound():
    scene = grooves(180, vc.Lambertian(RED))
    result = fit(scene, synthetic(scene), [free.angle(60, 180)])
    assert result.status == "at bound"
    assert result.estimates["angle"].at_bound
    assert result.estimates["angle"].value == np.pi
    assert np.isnan(result.estimates["angle"].standard_error)
    low = result.estimates["angle"].interval_95[0][0]
    assert np.radians(100) < low < np.pi
    assert "upper bound" in result.message
    assert "at least" in " ".join(result.warnings)


def test_where_anything_fits_a_value_on_a_bound_is_no_limit():
    scene = grooves(60, vc.Lambertian(np.zeros(4)))
    result = fit(scene, synthetic(scene), [free.angle(20, 160)])
    assert result.status == "not identifiable"
    assert result.estimates["angle"].interval_95 == [(np.radians(20), np.radians(160))]
    assert "any allowed value fits" in " ".join(result.warnings)


def test_a_free_gain_without_prior_hides_a_single_constant():
    scene = grooves(60, vc.Lambertian(np.full(4, 0.5)))
    result = fit(scene, synthetic(scene), [free.angle(), free.gain(None), free.offset(None)])
    assert not result.identifiable
    assert result.status == "not identifiable"
    assert "singular" in " ".join(result.warnings)
    assert np.isnan([e.standard_error for e in result.estimates.values()]).all()


def test_all_directions_along_the_grooves():
    scene = grooves(60, vc.Lambertian(RED))
    result = fit(scene, synthetic(scene, (20.0, 40.0), 90.0), [free.angle()])
    assert "along the grooves" in " ".join(result.warnings)
    assert result.identifiable


@pytest.mark.parametrize("material", [vc.Specular(GOLD), vc.InterfacedLambertian(RED, 1.5)])
def test_along_the_grooves_a_gloss_still_changes(material):
    """At 103 degrees these views say up to three times more about an interfaced groove than the frontal one."""
    scene, polar = grooves(103, material), np.radians([40.0, 75.0])
    m = Measurement(BAND, polar, np.full(2, np.pi / 2), np.full((2, 4), 0.2), np.full((2, 4), 0.01))
    built = assembly.build(scene, m, [free.angle(60, 120)], None, 1e-4)
    estimate = Estimate(np.radians(103), 0.01, [(1.7, 1.9)], "rad")
    assert blind_spots(built, {"angle": estimate}) == []


@pytest.mark.parametrize(
    ("material", "polar_deg", "flat"),
    [
        (vc.Lambertian(RED), 75, True),
        (vc.InterfacedLambertian(RED, 1.5), 0, True),
        (vc.InterfacedLambertian(RED, 1.5), 75, False),
        (vc.Specular(GOLD), 75, False),
    ],
)
def test_a_slight_roughness_shows_in_gloss_at_grazing_angles_only(material, polar_deg, flat):
    polar = np.radians([float(polar_deg)])
    m = Measurement(BAND, polar, np.zeros(1), np.full((1, 4), 0.2))
    scene = vc.Scene(vc.BeckmannGrooves(0.09), material, vc.Diffuse(), m.view)
    built = assembly.build(scene, m, [free.roughness()], 0.01, 1e-3)
    said = blind_spots(built, {"roughness": Estimate(0.09, 0.01, [(0.08, 0.1)])})
    assert len(said) == flat


def test_values_that_no_surface_gives():
    scene = grooves(60, vc.Lambertian(RED))
    good = synthetic(scene)
    values = good.reflectance_factor.copy()
    values[0, 3] = 1.2
    bad = Measurement(BAND, good.polar, good.azimuth, values, good.standard_uncertainty)
    words = " ".join(fit(scene, bad, [free.angle()]).warnings)
    assert "outside 0 to 1" in words
    assert "does not describe" in words


def test_nothing_left_to_test():
    scene = grooves(60, vc.Lambertian(RED))
    full = synthetic(scene)
    values = np.full((1, 4), np.nan)
    values[0, 2] = full.reflectance_factor[0, 2]
    one = Measurement(BAND, full.polar, full.azimuth, values, full.standard_uncertainty)
    result = fit(scene, one, [free.angle()])
    assert result.degrees_of_freedom == 0
    assert "cannot be tested" in " ".join(result.warnings)
    assert result.describes_data is None
    assert np.degrees(result.estimates["angle"].value) == pytest.approx(60, abs=1e-4)
