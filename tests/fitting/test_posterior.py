"""Posterior draws against densities that are computed anew on grids, and all ways to draw against each other."""

import csv
import signal
import subprocess
import sys
import time
from pathlib import Path

import emcee
import h5py
import jax
import numpy as np
import pytest
from scipy.stats import kstest

import vcavity_jax as vc
from fitting import Measurement, fit, free, priors, sample_posterior
from fitting.marginal import r_hat
from fitting.sampling import METHODS

BAND = np.array([450.0, 500.0, 550.0, 600.0, 650.0])
GOLD = np.array([1.46 + 1.95j, 0.97 + 1.87j, 0.4 + 2.6j, 0.25 + 2.9j, 0.17 + 3.2j])
RED = np.array([0.08, 0.12, 0.3, 0.55, 0.7])
FAN = np.radians([0.0, 40.0, 75.0])
SIGMA = 0.005
BENCH = [free.angle(30, 170), free.gain((1.0, 0.02)), free.offset()]


def scene_of(degrees, material):
    return vc.Scene(vc.VGrooves(np.radians(degrees)), material, vc.Diffuse(), vc.View())


def model(degrees, material, polar=FAN):
    seen = vc.Scene(vc.VGrooves(np.radians(degrees)), material, vc.Diffuse(), vc.View(polar, 0 * polar))
    return np.asarray(vc.reflectance_factor(seen))


def tabulated(angles, material):
    """Reflectance factors at many angles, by one compiled program."""
    seen = vc.View(FAN, 0 * FAN)
    one = jax.jit(lambda a: vc.reflectance_factor(vc.Scene(vc.VGrooves(a), material, vc.Diffuse(), seen)))
    return np.stack([np.asarray(one(a)) for a in angles])


def noisy(values, seed, polar=FAN):
    noise = np.random.default_rng(seed).standard_normal(values.shape)
    return Measurement(BAND, polar, 0 * polar, values + SIGMA * noise, np.full(values.shape, SIGMA))


@pytest.fixture(scope="module")
def bench():
    """An angle, a gain and an offset of gold."""
    truth = 1.01 * model(63, vc.Specular(GOLD)) + 0.001
    return fit(scene_of(70, vc.Specular(GOLD)), noisy(truth, 5), BENCH)


@pytest.fixture(scope="module")
def nested(bench):
    return sample_posterior(bench)


def test_the_nested_grid_is_exact(bench, nested):
    """Mean and spread against brute force: gain and offset eliminated by the normal equations at each angle."""
    angles = np.radians(np.arange(59.0, 67.0, 0.01))
    logs, means = [], []
    target = np.append(bench.measurement.reflectance_factor.ravel() / SIGMA, [1 / 0.02, 0])
    for factors in tabulated(angles, vc.Specular(GOLD)):
        shining = factors.ravel() / SIGMA
        rows = np.stack([np.append(shining, [1 / 0.02, 0]), np.append(0 * shining + 1 / SIGMA, [0, 1 / 0.002])], 1)
        best = np.linalg.lstsq(rows, target)[0]
        logs.append(-np.sum((target - rows @ best) ** 2) / 2 - np.linalg.slogdet(rows.T @ rows)[1] / 2)
        means.append(best)
    weights = np.exp(np.array(logs) - np.max(logs))
    weights /= weights.sum()
    mean = np.sum(weights * angles)
    spread = np.sqrt(np.sum(weights * (angles - mean) ** 2))
    own = nested.estimates["angle"]
    # The draws of the angle are stratified: far better than 1/sqrt(2000).
    assert own.mean == pytest.approx(mean, abs=0.01 * spread)
    assert own.standard_deviation == pytest.approx(spread, rel=0.01)
    gain = np.sum(weights * np.array(means)[:, 0])
    assert nested.estimates["gain"].mean == pytest.approx(
        gain, abs=0.1 * nested.estimates["gain"].standard_deviation
    )
    assert nested.method == "nested"
    assert nested.converged


def test_importance_and_ensemble_agree_with_it(bench, nested):
    for method, extra in (("importance", {}), ("emcee", {"most_steps": 4000})):
        other = sample_posterior(bench, method, seed=3, **extra)
        assert other.converged, other.message
        for name, own in nested.estimates.items():
            found = other.estimates[name]
            error = own.standard_deviation / np.sqrt(found.effective_samples)
            assert found.mean == pytest.approx(own.mean, abs=4.5 * error + 1e-12)
            assert found.standard_deviation == pytest.approx(own.standard_deviation, rel=0.12)
        if method == "importance":
            assert other.log_evidence == pytest.approx(nested.log_evidence, abs=0.1)
        else:
            assert 0.2 < other.acceptance < 0.8
            assert all(e.r_hat < 1.05 for e in other.estimates.values())
            assert not any("nested grid" in w for w in other.warnings)


def test_an_unknown_spectrum_is_integrated_out():
    """One angle and a reflectance at each wavelength, against sums over a grid of both."""
    result = fit(
        scene_of(60, vc.Lambertian(RED)),
        noisy(model(63, vc.Lambertian(RED)), 6),
        [free.angle(30, 140), free.reflectance()],
    )
    found = sample_posterior(result, draws=400)
    angles, grid = np.radians(np.arange(48.0, 80.0, 0.4)), np.linspace(0.001, 0.999, 600)
    measured = result.measurement.reflectance_factor
    logs, places = np.zeros(len(angles)), np.zeros((len(angles), 5))
    for i, factors in enumerate(tabulated(angles, vc.Lambertian(grid))):
        for k in range(5):
            cost = np.sum(((factors - measured[:, k, None]) / SIGMA) ** 2, axis=0)
            weight = np.exp(-(cost - cost.min()) / 2)
            logs[i] += np.log(weight.sum()) - cost.min() / 2
            places[i, k] = np.sum(weight * grid) / weight.sum()
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    mean = np.sum(weights * angles)
    spread = np.sqrt(np.sum(weights * (angles - mean) ** 2))
    assert found.estimates["angle"].mean == pytest.approx(mean, abs=0.02 * spread)
    assert found.estimates["angle"].standard_deviation == pytest.approx(spread, rel=0.02)
    spectra = found.samples["reflectance"]
    assert spectra.shape == (400, 5)
    # Four standard errors of 400 draws.
    np.testing.assert_allclose(spectra.mean(axis=0), weights @ places, atol=0.2 * spectra.std(axis=0).max())


def test_ranks_of_the_truth_are_uniform():
    """Simulation-based calibration: truths drawn from the prior, 60 seeded replicates."""
    generator = np.random.default_rng(11)
    scene, frontal = scene_of(70, vc.Specular(GOLD)), np.radians([0.0, 50.0])
    ranks = []
    for k in range(60):
        degrees = generator.uniform(50, 110)
        measured = noisy(model(degrees, vc.Specular(GOLD), frontal), 100 + k, frontal)
        found = sample_posterior(fit(scene, measured, [free.angle(50, 110)]), draws=500, seed=k)
        ranks.append(np.mean(found.samples["angle"] < np.radians(degrees)))
    assert kstest(ranks, "uniform").pvalue > 1e-3


def test_a_kink_is_flagged():
    frontal = np.zeros(1)
    result = fit(
        scene_of(70, vc.Specular(GOLD)), noisy(model(90, vc.Specular(GOLD), frontal), 7, frontal), BENCH[:1]
    )
    assert any("kink" in w for w in sample_posterior(result).warnings)


def test_noise_and_outliers(bench):
    level = sample_posterior(bench, noise="free").estimates["noise"]
    assert level.interval_95[0] < 1 < level.interval_95[1]
    assert level.standard_deviation == pytest.approx(1 / np.sqrt(2 * 12), rel=0.4)


def test_outliers_hardly_pull_student_t():
    clean = noisy(model(63, vc.Specular(GOLD)), 5)
    spoiled = clean.reflectance_factor.copy()
    spoiled[0, 1] -= 0.15
    measured = Measurement(BAND, FAN, 0 * FAN, spoiled, np.full(spoiled.shape, SIGMA))
    scene = scene_of(70, vc.Specular(GOLD))
    results = [fit(scene, one, BENCH[:1]) for one in (clean, measured)]
    robust = sample_posterior(results[1], "emcee", student_t=2.5, steps=800, seed=1).estimates["angle"]
    apart = [
        abs(value - results[0].estimates["angle"].value)
        for value in (results[1].estimates["angle"].value, robust.median)
    ]
    assert apart[0] > 3 * robust.standard_deviation
    assert apart[1] < 1.5 * robust.standard_deviation


KILLED = """
import jax; jax.config.update("jax_enable_x64", True)
import sys; sys.path.insert(0, sys.argv[1])
from test_posterior import *
truth = 1.01 * model(63, vc.Specular(GOLD)) + 0.001
result = fit(scene_of(70, vc.Specular(GOLD)), noisy(truth, 5), BENCH)
sample_posterior(result, "emcee", steps=100000, chain=sys.argv[2])
"""


@pytest.mark.slow
def test_kills_lose_no_stored_step(bench, tmp_path):
    """Ten kills at random moments: the file opens each time, and holds the steps of an undisturbed chain."""
    path, generator, before = tmp_path / "chain.h5", np.random.default_rng(0), 0
    for _ in range(10):
        process = subprocess.Popen([sys.executable, "-c", KILLED, str(Path(__file__).parent), str(path)])
        while process.poll() is None:
            time.sleep(0.2)
            if path.exists():
                with h5py.File(path, "r", locking=False) as file:
                    if int(file["mcmc"]["stored"][0]) > before:
                        break
        time.sleep(generator.uniform(0, 0.5))
        process.send_signal(signal.SIGKILL)
        assert process.wait() == -signal.SIGKILL
        with h5py.File(path, "r") as file:
            stored = int(file["mcmc"]["stored"][0])
            chain = file["mcmc"]["chain"][:stored]
        assert stored > before
        assert np.isfinite(chain).all()
        before = stored
    sample_posterior(bench, "emcee", steps=before, chain=tmp_path / "undisturbed.h5")
    np.testing.assert_array_equal(emcee.backends.HDFBackend(tmp_path / "undisturbed.h5").get_chain(), chain)


def test_a_chain_file_goes_on_where_it_stopped(bench, tmp_path):
    """The interrupted chain is the same as one in a single run, bit by bit, and emcee reads the file."""
    whole = sample_posterior(bench, "emcee", steps=60, chain=tmp_path / "whole.h5")
    sample_posterior(bench, "emcee", steps=25, chain=tmp_path / "parts.h5")
    sample_posterior(bench, "emcee", steps=60, chain=tmp_path / "parts.h5")
    chains = [emcee.backends.HDFBackend(tmp_path / name).get_chain() for name in ("whole.h5", "parts.h5")]
    assert chains[0].shape == (60, 32, 3)
    np.testing.assert_array_equal(*chains)
    assert not whole.converged
    assert "needed" in whole.message or "too short" in whole.message

    with pytest.raises(ValueError, match=r"whole.h5: holds the chain of another problem .*expected the same"):
        sample_posterior(bench, "emcee", steps=60, chain=tmp_path / "whole.h5", noise="free")
    with pytest.raises(ValueError, match=r"holds a chain of 32 walkers, not 40"):
        sample_posterior(bench, "emcee", steps=60, chain=tmp_path / "whole.h5", walkers=40)
    with h5py.File(tmp_path / "whole.h5", "r+") as file:
        file["mcmc"]["chain"][7, 3, 1] = np.nan
    with pytest.raises(ValueError, match=r"whole.h5: step 7 of the chain is NaN"):
        sample_posterior(bench, "emcee", steps=80, chain=tmp_path / "whole.h5")
    (tmp_path / "text.h5").write_text("no chain")
    with pytest.raises(ValueError, match=r"text.h5: is no chain"):
        sample_posterior(bench, "emcee", steps=60, chain=tmp_path / "text.h5")
    with pytest.raises(OSError, match=r"nowhere.*cannot write"):
        sample_posterior(bench, "emcee", steps=60, chain=tmp_path / "nowhere" / "chain.h5")


def test_what_is_written(nested, tmp_path):
    nested.to_csv(tmp_path / "draws.csv")
    with open(tmp_path / "draws.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2000
    drawn = np.array([float(row["angle_deg"]) for row in rows])
    np.testing.assert_allclose(drawn, np.degrees(nested.samples["angle"]), rtol=1e-14)
    from scipy.io import netcdf_file

    nested.to_netcdf(tmp_path / "draws.nc")
    with netcdf_file(tmp_path / "draws.nc", mmap=False) as file:
        np.testing.assert_array_equal(file.variables["angle_deg"][:].ravel(), drawn)
        assert file.variables["angle_deg"].units == b"degree"
    for name in ("corner", "trace", "predictive"):
        getattr(nested, name)(tmp_path / f"{name}.png")
        assert (tmp_path / f"{name}.png").stat().st_size > 5000
    assert "angle" in nested.summary()
    assert nested.to_dict()["parameters"]["angle"]["unit"] == "deg"
    (predicted,) = nested.predicted(50)
    assert predicted.shape == (50, 3, 5)
    np.testing.assert_allclose(predicted.mean(axis=0), nested.result.predicted, atol=SIGMA)


def test_r_hat():
    generator = np.random.default_rng(0)
    chains = generator.standard_normal((4, 1000))
    assert r_hat(chains) == pytest.approx(1, abs=0.01)
    assert r_hat(chains + np.array([[0], [0], [0], [1.0]])) > 1.05
    assert np.isnan(r_hat(chains[:1]))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"method": "guess"}, r"method is 'guess'; expected one of auto"),
        ({"walkers": 4}, r"walkers is 4; expected an even number of at least 6"),
        ({"method": "nested", "walkers": 40}, r"expected method='emcee', not 'nested'"),
        ({"draws": 3}, r"draws is 3; expected a whole number of at least 100"),
        ({"noise": "loud"}, r"noise is 'loud'; expected 'known', 'free'"),
        ({"student_t": 0.5}, r"student_t is 0.5; expected at least 1"),
        ({"method": "nested", "student_t": 4}, r"does not apply: Student's t"),
        ({"priors": {"angle": (45, 0.5)}}, r"the prior of angle, .* excludes the fit, 62"),
        ({"priors": {"angle": priors.Uniform(80, 100)}}, r"the prior of angle, .* excludes the fit, 62"),
        ({"priors": {"angel": (45, 0.5)}}, r"'angel', which is not a number of the fit; expected one of angle"),
    ],
)
def test_bad_input(bench, options, said):
    with pytest.raises(ValueError, match=said):
        sample_posterior(bench, **options)


def test_another_prior_pulls(bench, nested):
    value = float(np.degrees(nested.estimates["angle"].median))
    spread = float(np.degrees(nested.estimates["angle"].standard_deviation))
    pulled = sample_posterior(bench, priors={"angle": (value + 2 * spread, spread)}).estimates["angle"]
    # Two Gaussians of equal width meet halfway; the density is not quite one.
    assert np.degrees(pulled.median) == pytest.approx(value + spread, abs=0.35 * spread)
    assert np.degrees(pulled.standard_deviation) == pytest.approx(spread / np.sqrt(2), rel=0.25)


def test_names_of_the_methods():
    from fitting.cli.arguments import SAMPLERS

    assert SAMPLERS == METHODS


# Spectra, several measurements, other tools.


@pytest.fixture(scope="module")
def unknown():
    """An angle and five reflectances."""
    measured = noisy(model(63, vc.Lambertian(RED)), 11)
    return fit(scene_of(70, vc.Lambertian(RED)), measured, [free.angle(30, 170), free.reflectance()])


def test_spectra_have_intervals_at_each_wavelength(unknown):
    posterior = sample_posterior(unknown)
    one, drawn = posterior.estimates["reflectance"], posterior.samples["reflectance"]
    assert list(posterior.estimates) == ["angle", "reflectance"]
    np.testing.assert_allclose(one.interval_95[0], np.quantile(drawn, 0.025, axis=0))
    np.testing.assert_allclose(one.mean, unknown.estimates["reflectance"].value, atol=0.02)
    told = posterior.to_dict()["parameters"]["reflectance"]
    assert told["wavelength_nm"] == BAND.tolist()
    assert np.shape(told["interval_68"]) == (2, 5)
    assert "5 wavelengths" in posterior.summary()


def test_thinning(unknown, nested):
    posterior = sample_posterior(unknown, draws=500)
    thin = posterior.thin(4)
    assert thin.log_density.shape == (1, 125)
    np.testing.assert_array_equal(thin.chains["angle"], posterior.chains["angle"][:, 3::4])
    np.testing.assert_array_equal(thin.samples["reflectance"], posterior.samples["reflectance"][3::4])
    assert thin.estimates["angle"].effective_samples == 125
    assert thin.estimates["angle"].median == np.median(thin.samples["angle"])
    with pytest.raises(ValueError, match="every is 0; expected a whole number from 1 to 200"):
        nested.thin(0)
    with pytest.raises(ValueError, match="chains of 500 draws"):
        posterior.thin(100)


@pytest.mark.filterwarnings("ignore::FutureWarning")
def test_arviz_reads_the_draws(unknown):
    arviz = pytest.importorskip("arviz")
    posterior = sample_posterior(unknown, draws=300)
    data = posterior.to_arviz()
    np.testing.assert_allclose(data.posterior["angle_deg"].values, np.degrees(posterior.chains["angle"]))
    assert data.posterior["reflectance"].dims == ("chain", "draw", "wavelength_nm")
    assert data.posterior["wavelength_nm"].values.tolist() == BAND.tolist()
    low, high = arviz.hdi(data, hdi_prob=0.95)["angle_deg"].values
    assert low < np.degrees(posterior.estimates["angle"].median) < high


def test_nuts_agrees_with_the_grid(unknown):
    pytest.importorskip("blackjax")
    exact, found = sample_posterior(unknown), sample_posterior(unknown, "nuts", draws=1200)
    assert found.converged
    assert found.divergent.shape == found.log_density.shape == (4, 300)
    a, b = exact.estimates["angle"], found.estimates["angle"]
    assert abs(a.mean - b.mean) < 4 * a.standard_deviation / np.sqrt(b.effective_samples)
    assert b.standard_deviation == pytest.approx(a.standard_deviation, rel=0.12)
    spectra = exact.estimates["reflectance"], found.estimates["reflectance"]
    np.testing.assert_allclose(spectra[0].mean, spectra[1].mean, atol=0.25 * spectra[0].standard_deviation.min())
    np.testing.assert_allclose(spectra[0].standard_deviation, spectra[1].standard_deviation, rtol=0.15)
    assert b.r_hat < 1.05


@pytest.mark.slow
def test_nuts_takes_outliers_and_a_free_spectrum_together():
    """Five outliers of 20 standard deviations in 30 values: Student's t leaves them alone."""
    pytest.importorskip("blackjax")
    polar = np.radians([0.0, 20.0, 40.0, 55.0, 65.0, 75.0])
    values = noisy(model(63, vc.Lambertian(RED), polar), 11, polar).reflectance_factor.copy()
    values[[0, 1, 3, 4, 5], np.arange(5)] += 0.1
    measured = Measurement(BAND, polar, 0 * polar, values, np.full(values.shape, SIGMA))
    result = fit(scene_of(70, vc.Lambertian(RED)), measured, [free.angle(30, 170), free.reflectance()])
    with pytest.raises(ValueError, match="expected method='nuts', or a smooth spectrum"):
        sample_posterior(result, student_t=4)
    low, high = sample_posterior(result, "nuts", student_t=2, draws=800).estimates["angle"].interval_95
    assert low < np.radians(63) < high
    assert high - low < np.radians(12)
    gaussian = sample_posterior(result).estimates["angle"].interval_95
    assert not gaussian[0] < np.radians(63) < gaussian[1]


def test_a_problem_is_fitted_first(bench, nested):
    again = sample_posterior(bench.problem)
    np.testing.assert_allclose(again.samples["angle"], nested.samples["angle"], atol=1e-9)


def test_the_noise_level_has_bounds(bench):
    one = sample_posterior(bench, noise=(0.5, 0.9))
    assert 0.5 <= one.samples["noise"].min() < one.samples["noise"].max() <= 0.9
    for wrong in ((0.0, 1.0), (2.0, 1.0), "loud"):
        with pytest.raises(ValueError, match="noise is"):
            sample_posterior(bench, noise=wrong)


def test_several_measurements_are_predicted_together(tmp_path):
    matte = vc.Lambertian(RED)
    measured = {name: noisy(model(63, matte), seed) for name, seed in (("left", 1), ("right", 2))}
    result = fit(scene_of(70, matte), measured, [free.angle(30, 170)])
    posterior = sample_posterior(result, draws=300)
    assert [p.shape[1:] for p in posterior.predicted()] == [(3, 5), (3, 5)]
    posterior.predictive(tmp_path / "both.svg")
    text = (tmp_path / "both.svg").read_text()
    assert "left" in text
