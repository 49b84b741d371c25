"""Many spectra at once: each as if it were alone."""

import dataclasses
import functools

import jax
import numpy as np
import pytest

import fitting.many
import vcavity_jax as vc
from fitting import Measurement, fit, fit_many, free

BAND = np.array([450.0, 500.0, 550.0, 600.0, 650.0])
RED = np.array([0.08, 0.12, 0.3, 0.55, 0.7])
GOLD = np.array([1.46 + 1.95j, 0.97 + 1.87j, 0.4 + 2.6j, 0.25 + 2.9j, 0.17 + 3.2j])
FAN = np.radians([0.0, 40.0, 75.0])
SIGMA = 0.005
TRUTHS_DEG = (45.0, 63.0, 80.0, 88.0, 101.0, 55.0, 70.0, 110.0)
MATTE = vc.Scene(vc.VGrooves(1.0), vc.Lambertian(RED), vc.Diffuse(), vc.View())
BENCH = [free.angle(30, 170), free.gain((1.0, 0.02)), free.offset()]
UNKNOWN = [free.angle(30, 170), free.reflectance()]


@functools.cache
def samples():
    """Eight noisy spectra of grooves from 45 to 110 degrees, one exactly on a kink."""
    random = np.random.default_rng(11)
    spectra = []
    for degrees in TRUTHS_DEG:
        scene = vc.Scene(vc.VGrooves(np.radians(degrees)), vc.Lambertian(RED), vc.Diffuse(), vc.View(FAN, 0 * FAN))
        values = np.asarray(vc.reflectance_factor(scene))
        spectra.append(1.01 * values + 0.002 + SIGMA * random.standard_normal(values.shape))
    return np.array(spectra)


def template(values=None, nm=BAND, polar=FAN, sigma=SIGMA):
    values = np.full((len(polar), len(nm)), 0.3) if values is None else values
    return Measurement(nm, polar, 0 * polar, values, np.full(values.shape, sigma))


def many(spectra, parameters, **options):
    return fit_many(MATTE, template(), parameters, spectra=spectra, tolerance=1e-8, **options)


@functools.cache
def good(kind):
    return many(samples(), BENCH if kind == "bench" else UNKNOWN)


def assert_as_alone(result, index, alone):
    """Numbers, their errors, spectra, misfit and degrees of freedom of one spectrum."""
    for name, values in result.values.items():
        estimate = alone.estimates[name]
        assert values[index] == pytest.approx(estimate.value, abs=1e-6)
        if not estimate.at_kink:
            assert result.standard_errors[name][index] == pytest.approx(estimate.standard_error, rel=1e-4)
    for name, values in result.spectra.items():
        np.testing.assert_allclose(values[index], alone.estimates[name].value, atol=1e-6)
        if not alone.estimates["angle"].at_kink:
            wanted = alone.estimates[name].standard_error
            np.testing.assert_allclose(result.spectral_errors[name][index], wanted, rtol=1e-4)
    assert result.chi_square[index] == pytest.approx(alone.chi_square, rel=1e-8, abs=1e-8)
    assert result.degrees_of_freedom[index] == alone.degrees_of_freedom
    assert result.status[index] == alone.status


@pytest.mark.parametrize("kind", ["bench", "unknown"])
def test_each_is_fitted_as_if_alone(kind):
    parameters, result = (BENCH, good("bench")) if kind == "bench" else (UNKNOWN, good("unknown"))
    assert (result.status == "converged").all()
    assert result.summary() == "8 spectra: 8 converged"
    for index, values in enumerate(samples()):
        assert_as_alone(result, index, fit(MATTE, template(values), parameters))
    truths = np.radians(TRUTHS_DEG)
    pulls = (result.values["angle"] - truths) / result.standard_errors["angle"]
    assert np.abs(pulls).max() < 4


@pytest.mark.parametrize("kind", ["bench", "unknown"])
def test_a_bad_spectrum_says_so_and_harms_no_other(kind):
    parameters, alone = (BENCH, good("bench")) if kind == "bench" else (UNKNOWN, good("unknown"))
    spectra = np.insert(samples(), [0, 3, 8], np.nan, axis=0)
    spectra[4] = 0.4
    spectra[4, 1, 2] = -np.inf
    spectra[10] = 0.4
    spectra[10, 0, 0] = np.inf
    whole = many(spectra, parameters)
    bad = np.isin(np.arange(11), [0, 4, 10])
    assert whole.status[bad].tolist() == ["no value", "bad value", "bad value"]
    assert whole.converged.tolist() == (~bad).tolist()
    assert "8 converged, 1 no value, 2 bad value" in whole.summary()
    for name in whole.values:
        assert np.isnan(whole.values[name][bad]).all()
        assert np.isnan(whole.standard_errors[name][bad]).all()
        np.testing.assert_allclose(whole.values[name][~bad], alone.values[name], rtol=1e-12)
        np.testing.assert_allclose(whole.standard_errors[name][~bad], alone.standard_errors[name], rtol=1e-10)
    for name in whole.spectra:
        assert np.isnan(whole.spectra[name][bad]).all()
        np.testing.assert_allclose(whole.spectra[name][~bad], alone.spectra[name], rtol=1e-12)
    assert np.isnan(whole.chi_square[bad]).all()
    np.testing.assert_allclose(whole.chi_square[~bad], alone.chi_square, rtol=1e-12)
    np.testing.assert_array_equal(whole.degrees_of_freedom[~bad], alone.degrees_of_freedom)
    np.testing.assert_array_equal(whole.status[~bad], alone.status)


@pytest.mark.parametrize("kind", ["bench", "unknown"])
def test_missing_values_as_in_a_single_fit(kind):
    """A few values, a whole direction, a whole wavelength: what is not determined has no number."""
    parameters = BENCH if kind == "bench" else UNKNOWN
    spectra = samples()[[1, 2, 4]].copy()
    spectra[0, 0, 1] = spectra[0, 2, 4] = np.nan
    spectra[1, 1] = np.nan
    spectra[2, :, 3] = np.nan
    result = many(spectra, parameters)
    for index, values in enumerate(spectra):
        assert_as_alone(result, index, fit(MATTE, template(values), parameters))


def test_more_spectra_than_one_batch_and_uneven_uncertainties():
    """300 copies of two spectra in memory for 256, each with an uncertainty of its own."""
    pair = samples()[[1, 5]]
    sigma = SIGMA * np.array([1.0, 2.0])[:, None, None] * np.linspace(0.5, 1.5, 15).reshape(3, 5)
    spectra, uncertainties = np.tile(pair, (150, 1, 1)), np.tile(sigma, (150, 1, 1))
    result = many(spectra, BENCH, standard_uncertainty=uncertainties)
    assert result.converged.all()
    for index in (0, 1):
        m = Measurement(BAND, FAN, 0 * FAN, pair[index], sigma[index])
        assert_as_alone(result, 298 + index, fit(MATTE, m, BENCH))
        for values in (result.values["angle"], result.standard_errors["gain"], result.chi_square):
            np.testing.assert_allclose(values[index::2], values[index], rtol=1e-12)


def test_a_list_of_measurements():
    listed = [template(values) for values in samples()[:2]]
    result = fit_many(MATTE, listed, BENCH, tolerance=1e-8)
    np.testing.assert_allclose(result.values["angle"], good("bench").values["angle"][:2], rtol=1e-12)
    silent = [Measurement(BAND, FAN, 0 * FAN, values) for values in samples()[:2]]
    again = fit_many(MATTE, silent, BENCH, standard_uncertainty=SIGMA, tolerance=1e-8)
    np.testing.assert_array_equal(again.values["angle"], result.values["angle"])


def test_a_flat_sample_ends_on_its_bound():
    """Which is no answer: only a limit."""
    parameters = [free.angle(30, 180), *BENCH[1:]]
    spectra = np.stack([samples()[3], np.broadcast_to(RED, (3, 5))])
    result = many(spectra, parameters)
    assert result.status.tolist() == ["converged", "at bound"]
    assert result.values["angle"][1] == np.pi
    with pytest.raises(ValueError, match=r"^spectrum 1: at bound \(2 spectra: 1 converged, 1 at bound\)$"):
        many(spectra, parameters, throw=True)


def test_throw():
    spectra = samples()[:3].copy()
    assert many(spectra, BENCH, throw=True).converged.all()
    spectra[1] = np.nan
    with pytest.raises(ValueError, match=r"^spectrum 1: no value \(3 spectra: 2 converged, 1 no value\)$"):
        many(spectra, BENCH, throw=True)


def test_out_of_steps_is_no_answer():
    result = many(samples()[:2], BENCH, max_steps=1)
    assert (result.status == "not converged").all()
    assert not result.converged.any()


def test_the_gap_to_the_next_minimum():
    """In one color, seen at 60 degrees, three angles of a dielectric groove give the same value."""
    index, polar = np.full(5, 3.0 + 0.0j), np.radians([60.0])
    scene = vc.Scene(vc.VGrooves(np.radians(75.0)), vc.Specular(index), vc.Diffuse(), vc.View(polar, 0 * polar))
    values = np.asarray(vc.reflectance_factor(scene))
    m = template(values, polar=polar)
    parameters = [free.angle(30, 170)]
    two = fit_many(scene, m, parameters, spectra=values[None], tolerance=1e-8)
    assert two.next_minimum[0] == pytest.approx(0, abs=1e-5)
    assert good("bench").next_minimum.min() > 4


def test_beside_a_shift_the_stray_light_is_that_of_the_whole_spectrum():
    """The mean that stray light adds includes the wavelengths at the ends that a shift leaves out."""
    nm = np.arange(400.0, 701.0, 20.0)
    flat = vc.Scene(
        vc.VGrooves(np.pi), vc.Lambertian(0.4 + 0.3 * np.sin((nm - 400) / 60)), vc.Diffuse(), vc.View()
    )
    true = 0.4 + 0.3 * np.sin((nm + 1.3 - 400) / 60)
    values = (0.9 * true + 0.1 * true.mean())[None]
    m = template(values, nm, np.zeros(1), 0.001)
    parameters = [free.wavelength_shift(3, None), free.stray_light()]
    alone = fit(flat, m, parameters)
    assert alone.estimates["wavelength_shift"].value == pytest.approx(1.3, abs=0.01)
    assert alone.estimates["stray_light"].value == pytest.approx(0.1, abs=1e-3)
    result = fit_many(flat, m, parameters, spectra=values[None], tolerance=1e-8)
    assert_as_alone(result, 0, alone)


@pytest.mark.slow
def test_random_grooves():
    polar = np.radians([0.0, 75.0])
    scenes = [vc.Scene(vc.BeckmannGrooves(m), vc.Specular(GOLD), vc.Diffuse(), vc.View(polar)) for m in (0.2, 0.6)]
    spectra = np.array([vc.reflectance_factor(s, tolerance=1e-6) for s in scenes])
    m = template(spectra[0], polar=polar)
    parameters = [free.roughness(0.05, 2.0)]
    result = fit_many(scenes[0], m, parameters, spectra=spectra)
    np.testing.assert_allclose(result.values["roughness"], [0.2, 0.6], rtol=1e-4)
    for index in (0, 1):
        alone = fit(scenes[0], template(spectra[index], polar=polar), parameters, tolerance=1e-6)
        assert result.values["roughness"][index] == pytest.approx(alone.estimates["roughness"].value, rel=1e-5)
        ratio = result.standard_errors["roughness"][index] / alone.estimates["roughness"].standard_error
        assert ratio == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize(
    ("measurements", "options", "message"),
    [
        (template(), {}, r"one measurement without spectra="),
        (template(), {"spectra": np.ones((2, 3, 4))}, r"shape \(2, 3, 4\); expected \(N, 3, 5\)"),
        (template(), {"spectra": np.ones((0, 3, 5))}, "no spectrum; expected at least one"),
        ([], {}, "no list of measurements"),
        ([template()], {"spectra": np.ones((1, 3, 5))}, "goes with one measurement"),
        ([template(), template(nm=BAND + 1)], {}, "measurement 1 has other wavelengths, directions or light"),
        ([template(), template(polar=FAN + 0.01)], {}, "measurement 1 has other wavelengths, directions or light"),
        (
            [Measurement(BAND, FAN, 0 * FAN, np.full((3, 5), 0.3))],
            {},
            "no uncertainty is stated; expected standard_uncertainty=",
        ),
        (
            template(),
            {"spectra": np.ones((2, 3, 5)), "standard_uncertainty": np.ones(4)},
            r"shape \(4,\); expected",
        ),
        (template(), {"spectra": np.ones((2, 3, 5)), "standard_uncertainty": -1.0}, "not positive everywhere"),
        (template(), {"spectra": np.ones((2, 3, 5)), "standard_uncertainty": np.nan}, "not positive everywhere"),
    ],
)
def test_refusals(measurements, options, message):
    with pytest.raises(ValueError, match=message) as caught:
        fit_many(MATTE, measurements, BENCH, **options)
    assert "\n" not in str(caught.value)


def test_other_lights_and_collected_light_are_not_mixed():
    """Directions, wavelengths, light and collector of all are those of the first."""
    lit = Measurement(BAND, FAN, 0 * FAN, np.full((3, 5), 0.3), np.full((3, 5), 0.01), vc.Directional(0.3))
    with pytest.raises(ValueError, match=r"measurement 1 has other"):
        fit_many(MATTE, [template(), lit], BENCH)


@pytest.fixture
def with_table(monkeypatch):
    monkeypatch.setattr("fitting.many._WITH_TABLE", 1)


@pytest.mark.parametrize(
    "others", [[], [free.gain((1.0, 0.02))], [free.offset()], [free.gain(None), free.offset(None)]]
)
def test_the_table_answers_as_descents_do(with_table, monkeypatch, others):
    """All of its parameters, a missing value, another uncertainty, each against the same fit without a table."""
    spectra = np.delete(samples(), TRUTHS_DEG.index(88.0), axis=0)
    spectra[2, 1, 3] = np.nan
    sigma = np.full(spectra.shape, SIGMA)
    sigma[1] *= 3
    parameters = [free.angle(30, 170), *others]
    found = many(spectra, parameters, standard_uncertainty=sigma)
    assert (found.steps == 0).all()
    monkeypatch.setattr("fitting.many._WITH_TABLE", 10**9)
    wanted = many(spectra, parameters, standard_uncertainty=sigma)
    assert (wanted.steps > 0).all()
    np.testing.assert_array_equal(found.status, wanted.status)
    np.testing.assert_array_equal(found.degrees_of_freedom, wanted.degrees_of_freedom)
    np.testing.assert_allclose(found.chi_square, wanted.chi_square, rtol=1e-7)
    for name in wanted.values:
        np.testing.assert_allclose(found.values[name], wanted.values[name], atol=1e-6)
        np.testing.assert_allclose(found.standard_errors[name], wanted.standard_errors[name], rtol=1e-3)
    near = np.isfinite(wanted.next_minimum) & (wanted.next_minimum < 20)
    np.testing.assert_allclose(found.next_minimum[near], wanted.next_minimum[near], rtol=1e-5)


def test_at_a_kink_the_table_is_as_sure_as_the_less_sure_side(with_table):
    spectra = samples()[[TRUTHS_DEG.index(88.0)]]
    found = many(spectra, BENCH)
    alone = fit(MATTE, template(spectra[0]), BENCH, tolerance=1e-8)
    assert found.values["angle"][0] == pytest.approx(alone.estimates["angle"].value, abs=1e-6)
    assert found.chi_square[0] == pytest.approx(alone.chi_square, rel=1e-7)


def test_where_the_table_is_not_good_descents_answer(with_table, monkeypatch):
    monkeypatch.setattr("fitting.many.Table.of", functools.partial(_spoiled, fitting.many.Table.of))
    found = many(samples(), BENCH)
    assert (found.steps > 0).all()
    np.testing.assert_allclose(found.values["angle"], good("bench").values["angle"], atol=1e-9)


def _spoiled(make, problem, points, factors, tolerance):
    table = make(problem, points, factors, 1e-6)
    assert table.good.mean() > 0.95
    assert not make(problem, points, factors, 1e-17).good.all()
    return dataclasses.replace(table, good=np.zeros_like(table.good))


def test_a_plateau_has_no_angle(with_table):
    """Black panels are black at any angle."""
    black = vc.Scene(vc.VGrooves(2.9), vc.Lambertian(0 * RED), vc.Diffuse(), vc.View())
    values = np.full((1, 1, len(BAND)), 1e-3)
    found = fit_many(black, template(polar=np.zeros(1)), [free.angle(30, 170)], spectra=values)
    assert found.status.tolist() == ["not identifiable"]
    assert np.isnan(found.standard_errors["angle"]).all()


def test_thousands_are_answered_from_the_table():
    """Without a descent, and with errors that are as large as they say."""
    random = np.random.default_rng(3)
    angle, gain = np.radians(random.uniform(40, 100, 5000)), random.normal(1, 0.01, (5000, 1))

    def spectrum(one):
        scene = vc.Scene(vc.VGrooves(one), vc.Lambertian(RED), vc.Diffuse(), vc.View())
        return vc.reflectance_factor(scene, 1e-9, smallest_angle=np.radians(40))

    exact = gain * np.asarray(jax.jit(jax.vmap(spectrum))(angle))
    spectra = (exact + SIGMA * random.standard_normal(exact.shape))[:, None]
    found = fit_many(MATTE, template(polar=np.zeros(1)), [free.angle(30, 170), free.gain()], spectra=spectra)
    assert (found.steps == 0).all()
    assert found.converged.mean() > 0.99
    pulls = ((found.values["angle"] - angle) / found.standard_errors["angle"])[found.converged]
    assert np.abs(pulls).max() < 6
    assert 0.95 < pulls.std() < 1.05
