"""Comparison of models: the criteria by hand, the evidence by brute force, and what the verdict says."""

import json

import jax
import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import norm

import vcavity_jax as vc
from fitting import Measurement, compare_models, compare_results, fit, free, rivals, sample_posterior

BAND = np.array([450.0, 500.0, 550.0, 600.0, 650.0])
GOLD = np.array([1.46 + 1.95j, 0.97 + 1.87j, 0.4 + 2.6j, 0.25 + 2.9j, 0.17 + 3.2j])
RED = np.array([0.08, 0.12, 0.3, 0.55, 0.7])
FAN = np.radians([0.0, 20.0, 40.0, 60.0, 75.0])
TURN = np.radians(40.0)  # Across the grooves the treatments of polarization "full" and "separate" agree.
SIGMA = 0.005
BENCH = [free.angle(30, 170), free.gain((1.0, 0.02))]
MIRROR = vc.Specular(GOLD)


def grooves(degrees, material=MIRROR, polar=FAN):
    return vc.Scene(vc.VGrooves(np.radians(degrees)), material, vc.Diffuse(), vc.View(polar, 0 * polar + TURN))


def noisy(scene, seed=1, sigma=SIGMA, stated=SIGMA):
    values = np.asarray(vc.reflectance_factor(scene))
    values = values + sigma * np.random.default_rng(seed).standard_normal(values.shape)
    polar = np.asarray(scene.view.polar)
    sigma = None if stated is None else np.full(values.shape, stated)
    return Measurement(BAND, polar, np.asarray(scene.view.azimuth), values, sigma)


@pytest.fixture(scope="module")
def mirrors():
    """A mirror that polarizes, taken for itself and for its approximations."""
    scene = grooves(45)
    return compare_models(rivals(scene), noisy(scene), BENCH)


def test_the_criteria_are_those_of_the_literature(mirrors):
    model = mirrors.best
    assert model.name == "specular, full"
    (misfit,) = model.result.misfits
    log_likelihood = np.sum(norm.logpdf(misfit, scale=SIGMA))
    k, n = 2, misfit.size
    np.testing.assert_allclose(model.log_likelihood, log_likelihood, rtol=1e-12)
    np.testing.assert_allclose(model.aic, 2 * k - 2 * log_likelihood, rtol=1e-12)
    np.testing.assert_allclose(model.bic, k * np.log(n) - 2 * log_likelihood, rtol=1e-12)
    assert (model.unknowns, model.values, model.aicc, mirrors.criterion) == (k, n, None, "AIC")
    deltas = np.array([m.aic for m in mirrors.models]) - mirrors.best.aic
    np.testing.assert_allclose([m.delta for m in mirrors.models], deltas, atol=1e-9)
    weights = np.exp(-deltas / 2)
    np.testing.assert_allclose([m.weight for m in mirrors.models], weights / weights.sum(), rtol=1e-9)
    assert sorted(deltas) == list(deltas)


def test_an_estimated_uncertainty_is_one_more_unknown():
    scene = grooves(63)
    found = compare_models({"mirror": scene}, noisy(scene, stated=None), [free.angle(30, 170)])
    model = found.best
    (misfit,) = model.result.misfits
    n, k = misfit.size, 2
    log_likelihood = np.sum(norm.logpdf(misfit, scale=np.sqrt(np.mean(misfit**2))))
    np.testing.assert_allclose(model.log_likelihood, log_likelihood, rtol=1e-9)
    np.testing.assert_allclose(model.aicc, 2 * k - 2 * log_likelihood + 2 * k * (k + 1) / (n - k - 1), rtol=1e-9)
    assert (model.unknowns, found.criterion) == (k, "AICc")
    assert "no model can be tested" in " ".join(found.verdict())


def test_the_verdict_names_the_true_treatment_of_polarization(mirrors):
    (only,) = mirrors.verdict()
    assert only.startswith("the data speak for specular, full (AIC of specular, separate, the next, +")
    assert mirrors["specular, unpolarized"].p_value < mirrors.best.p_value
    with pytest.raises(KeyError):
        mirrors["glass"]


def test_an_undecided_comparison_says_so():
    """Polarization plays no part in grooves so open that no light that leaves frontally was reflected twice."""
    scene = grooves(150, polar=np.zeros(1))
    found = compare_models(rivals(scene), noisy(scene), [free.angle(130, 175)])
    assert found.verdict()[0].startswith("the data do not choose between specular, full")


def test_the_least_wrong_model_is_not_praised():
    """Narrow grooves of a wrong metal: nothing describes them."""
    scene = grooves(50)
    measured = noisy(grooves(50, vc.Specular(GOLD[::-1])))
    verdict = " ".join(compare_models(rivals(scene), measured, BENCH).verdict())
    assert "no model describes the data" in verdict
    assert "only the least wrong" in verdict


def test_interfaces_against_bare_samples():
    truth = grooves(80, vc.InterfacedLambertian(RED, 1.5))
    found = compare_models(rivals(truth), noisy(truth), [free.angle(40, 170)], tolerance=1e-5)
    assert [m.name for m in found.models][-1] == "Lambertian"
    assert found["Lambertian"].delta > 10
    assert found["interfaced, unpolarized"].delta < 20  # The treatments differ by less than this noise shows.


def by_brute_force(result, angles, gains):
    """Logarithm of the likelihood times normalized priors, on a grid of angle and gain."""
    scene, measured = result.scene, result.measurement
    one = jax.jit(
        lambda a: vc.reflectance_factor(vc.Scene(vc.VGrooves(a), scene.material, vc.Diffuse(), scene.view))
    )
    models = np.stack([np.asarray(one(a)) for a in angles])
    logs = norm.logpdf(
        measured.reflectance_factor, gains[:, None, None, None] * models, measured.standard_uncertainty
    ).sum(axis=(2, 3))
    logs += norm.logpdf(gains, 1.0, 0.02)[:, None] - np.log(np.radians(140.0))
    return logsumexp(logs) + np.log((angles[1] - angles[0]) * (gains[1] - gains[0]))


def test_the_evidence_is_the_integral_over_the_priors(mirrors):
    result = mirrors["specular, full"].result
    angle = result.estimates["angle"]
    angles = angle.value + angle.standard_error * np.linspace(-8, 8, 241)
    expected = by_brute_force(result, angles, np.linspace(0.9, 1.1, 401))
    for method, allowed in (("nested", 2e-3), ("importance", 0.05)):
        assert abs(sample_posterior(result, method).log_evidence - expected) < allowed
    found = compare_results({m.name: m.result for m in mirrors.models}, evidence=True)
    assert abs(found.best.log_evidence - expected) < 2e-3
    assert "the evidence prefers specular, full to specular, separate" in found.verdict()[0]
    assert "ln evidence" in found.summary()


def test_text_and_json(mirrors):
    lines = mirrors.summary().splitlines()
    assert lines[0].split()[:3] == ["model", "chi-square", "dof"]
    assert len({len(line) for line in lines[:1]}) == 1
    assert lines[-1].startswith("verdict: ")
    told = json.loads(json.dumps(mirrors.to_dict(), allow_nan=False))
    assert told["best"] == "specular, full"
    assert [m["name"] for m in told["models"]] == [m.name for m in mirrors.models]
    assert told["models"][0]["parameters"]["angle"]["unit"] == "deg"


def test_bad_input():
    scene, other = grooves(63), grooves(63, vc.Lambertian(RED))
    measured = noisy(scene)
    with pytest.raises(ValueError, match="no model to compare"):
        compare_models({}, measured, BENCH)
    with pytest.raises(ValueError, match="no model to compare"):
        compare_results({})
    with pytest.raises(ValueError, match="parameters are for the models mirror; expected them for mirror, matte"):
        compare_models({"mirror": scene, "matte": other}, measured, {"mirror": BENCH})
    with pytest.raises(ValueError, match="parameter 'reflectance' has a place in none of the models mirror"):
        compare_models({"mirror": scene}, measured, [*BENCH, free.reflectance()])
    with pytest.raises(ValueError, match=r"^mirror: "):
        compare_models({"mirror": scene}, measured, [free.angle(), free.angle()])
    a, b = (fit(scene, noisy(scene, seed), BENCH) for seed in (1, 2))
    with pytest.raises(ValueError, match="one and two are not fitted to the same values"):
        compare_results({"one": a, "two": b})
    with pytest.raises(ValueError, match="estimated in one of one and two"):
        compare_results({"one": a, "two": fit(scene, noisy(scene, stated=None), BENCH)})
    two = vc.Scene(vc.VGrooves(1.0), (vc.Lambertian(RED), vc.Lambertian(0.5)), vc.Diffuse(), vc.View())
    with pytest.raises(ValueError, match="has no rival model; expected one material"):
        rivals(two)
