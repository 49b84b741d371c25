"""Which views to measure next: rules that are known, all sets tried, errors computed in another way."""

import itertools
import json
import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import vcavity_jax as vc
from fitting import Measurement, exchange, fit, free, plan_views
from fitting.parameters import Parameter

BAND = np.array([450.0, 500.0, 550.0, 600.0, 650.0])
RED = np.array([0.15, 0.2, 0.35, 0.5, 0.6])
GOLD = np.array([1.38 + 1.92j, 0.86 + 1.85j, 0.33 + 2.59j, 0.2 + 3.09j, 0.16 + 3.5j])
SIGMA = 0.005
FAN = vc.View(np.radians([0.0, 10, 20, 30, 40, 50, 60, 70, 80]), 0.0)
STAR = vc.View(np.radians(np.tile([5.0, 20, 35, 50, 65, 80], 3)), np.radians(np.repeat([0.0, 45, 90], 6)))


def grooves(degrees, material, light=None):
    return vc.Scene(vc.VGrooves(np.radians(degrees)), material, light or vc.Diffuse(), vc.View())


def matte(degrees=60.0):
    return grooves(degrees, vc.Lambertian(RED))


def polar_deg(plan):
    return np.degrees(plan.polar).round().tolist()


@jax.jit
def dense_jacobian(unknown, polar):
    """Of the angle, the gain and the spectrum of a matte groove: all columns, one by one."""

    def recorded(unknown):
        view = vc.View(polar, jnp.zeros_like(polar))
        scene = vc.Scene(vc.VGrooves(unknown[0]), vc.Lambertian(unknown[2:]), vc.Diffuse(), view)
        return (unknown[1] * vc.reflectance_factor(scene)).ravel()

    return jax.jacfwd(recorded)(unknown)


def dense_covariance(angle, polar, gain_prior=None):
    """Of the angle, the gain (if it has a prior) and the spectrum."""
    every = [dense_jacobian(jnp.asarray([angle, 1.0, *RED]), jnp.asarray([one])) for one in polar]
    jacobian = np.concatenate(every) / SIGMA
    information = jacobian.T @ jacobian
    if gain_prior is None:
        information = np.delete(np.delete(information, 1, 0), 1, 1)
    else:
        information[1, 1] += 1 / gain_prior**2
    return np.linalg.inv(information)


@pytest.mark.parametrize("gain_prior", [None, 0.01])
def test_errors_are_those_of_the_dense_jacobian(gain_prior):
    parameters = [free.angle(), free.reflectance()] + [free.gain()] * (gain_prior is not None)
    plan = plan_views(matte(50), parameters, FAN, 4, SIGMA, wavelengths_nm=BAND)
    for views in (2, 3, 4):
        covariance = dense_covariance(np.radians(50), plan.polar[:views], gain_prior)
        errors = np.sqrt(np.diag(covariance))
        assert plan.standard_errors["angle"][views] == pytest.approx(errors[0], rel=1e-7)
        assert plan.standard_errors["reflectance"][views] == pytest.approx(errors[-5:], rel=1e-7)
        if gain_prior is not None:
            assert plan.standard_errors["gain"][views] == pytest.approx(errors[1], rel=1e-7)


def test_errors_of_a_roughness_are_those_of_finite_differences():
    view = vc.View(np.radians([0.0, 75.0]), np.zeros(2))

    @jax.jit
    def seen(roughness):
        return vc.reflectance_factor(
            vc.Scene(vc.BeckmannGrooves(roughness), vc.Lambertian(RED), vc.Diffuse(), view)
        )

    scene = vc.Scene(vc.BeckmannGrooves(0.4), vc.Lambertian(RED), vc.Diffuse(), vc.View())
    plan = plan_views(scene, [free.roughness()], view, 2, SIGMA)
    step = 1e-3
    slope = np.asarray(seen(jnp.asarray(0.4 + step)) - seen(jnp.asarray(0.4 - step))) / (2 * step)
    # Differences err by the square of the step.
    assert plan.standard_errors["roughness"][-1] == pytest.approx(SIGMA / np.linalg.norm(slope), rel=1e-4)
    assert plan.units["roughness"] == "1"
    # 1 % of the logarithmic range from 0.01 to 3.
    assert plan.spread["roughness"] == pytest.approx(0.4 * 0.01 * np.log(300))


def test_a_fit_reports_what_was_predicted():
    scene, parameters = matte(55), [free.angle(20, 150), free.reflectance(), free.gain(), free.offset()]
    plan = plan_views(scene, parameters, FAN, 4, SIGMA, wavelengths_nm=BAND)
    seen = vc.Scene(scene.surface, scene.material, scene.illumination, vc.View(plan.polar, plan.azimuth))
    values = np.asarray(vc.reflectance_factor(seen))
    data = Measurement(BAND, plan.polar, plan.azimuth, values, np.full(values.shape, SIGMA))
    result = fit(scene, data, parameters)
    for name in ("angle", "gain", "offset", "reflectance"):
        # The same Cramér-Rao bound; the minimum of noise-free data is the truth but for the steps of the descent.
        assert result.estimates[name].standard_error == pytest.approx(plan.standard_errors[name][-1], rel=1e-3)
    again = plan_views(result, candidates=FAN)
    assert again.standard_errors["angle"][0] == pytest.approx(result.estimates["angle"].standard_error, rel=1e-3)
    assert again.spread["angle"] == pytest.approx(2 * result.estimates["angle"].standard_error)
    assert again.noise == pytest.approx(SIGMA)
    assert len(again.measured) == 4
    assert again.standard_errors["angle"][1] < again.standard_errors["angle"][0]
    np.testing.assert_array_equal(again.wavelengths_nm, BAND)
    with pytest.raises(ValueError, match="measured is given beside a FitResult"):
        plan_views(result, None, FAN, 1, measured=FAN)


@pytest.mark.parametrize("degrees", [30.0, 90.0, 130.0])
@pytest.mark.parametrize("criterion", ["A", "D"])
def test_rule_of_an_unknown_matte_reflectance(degrees, criterion):
    """The farthest direction once, everything else within half the angle."""
    plan = plan_views(
        matte(degrees),
        [free.angle(), free.reflectance()],
        STAR,
        3,
        SIGMA,
        criterion=criterion,
        spread=np.radians(3),
    )
    section = np.degrees(np.arctan(np.tan(plan.polar) * np.cos(plan.azimuth)))
    assert section[1] == pytest.approx(80)  # The second one: only then anything is identifiable.
    assert (section[[0, 2]] < degrees / 2 - 1).all()
    assert plan.identifiable["angle"].tolist() == [False, False, True, True]
    assert np.isinf(plan.standard_errors["angle"][:2]).all()
    assert plan.all_identifiable


def test_what_is_measured_counts():
    parameters = [free.angle(), free.reflectance()]
    plan = plan_views(matte(), parameters, FAN, 1, SIGMA, measured=vc.View(0.0), wavelengths_nm=BAND)
    assert polar_deg(plan) == [80]
    assert plan.identifiable["angle"].tolist() == [False, True]
    whole = plan_views(matte(), parameters, FAN, 2, SIGMA, wavelengths_nm=BAND)
    assert plan.standard_errors["angle"][1] == pytest.approx(whole.standard_errors["angle"][2], rel=1e-9)
    data = Measurement(BAND, np.zeros(1), np.zeros(1), np.full((1, 5), 0.3), np.full((1, 5), SIGMA / 3))
    finer = plan_views(matte(), parameters, FAN, 1, SIGMA, measured=data)
    assert polar_deg(finer) == [80]
    assert finer.standard_errors["angle"][1] < plan.standard_errors["angle"][1]


def test_candidates_that_cannot_tell():
    near = vc.View(np.radians([0.0, 10, 20, 25]), 0.0)
    plan = plan_views(matte(60), [free.angle(), free.reflectance()], near, 3, SIGMA)
    assert not plan.all_identifiable
    assert np.isinf(plan.standard_errors["angle"]).all()
    assert "not even all candidates" in plan.message
    assert "not identifiable" in plan.summary()
    assert plan.to_dict()["parameters"]["angle"]["standard_error"] == [None] * 4
    known = plan_views(matte(60), [free.angle()], near, 1, SIGMA)
    assert known.all_identifiable


def test_too_few_views_ask_for_more():
    plan = plan_views(matte(60), [free.angle(), free.reflectance()], FAN, 1, SIGMA)
    assert not plan.all_identifiable
    assert "larger count" in plan.message
    # One unknown of three: what else is free and determined is not called lost.
    three = plan_views(matte(60), [free.angle(), free.gain()], vc.View(0.0), 1, SIGMA)
    assert three.identifiable["gain"][-1]


def test_an_error_beyond_half_the_range_is_none():
    blind = grooves(60, vc.Lambertian(RED))
    wide = plan_views(blind, [free.angle(20, 150)], vc.View(0.0), 1, 1.0, spread=0.0)
    assert np.isinf(wide.standard_errors["angle"][-1])
    fine = plan_views(blind, [free.angle(20, 150)], vc.View(0.0), 1, 0.01, spread=0.0)
    assert np.isfinite(fine.standard_errors["angle"][-1])


def test_exhaustive_is_the_best_of_all_sets():
    candidates = vc.View(np.radians([0.0, 15, 30, 45, 60, 70, 80]), 0.0)
    angle = np.radians(70)
    plan = plan_views(
        matte(70), [free.angle(), free.reflectance()], candidates, 3, SIGMA, method="exhaustive", spread=0.0
    )
    best = np.inf
    for chosen in itertools.combinations(np.asarray(candidates.polar), 3):
        if max(chosen) > angle / 2 > min(chosen):
            best = min(best, np.sqrt(dense_covariance(angle, chosen)[0, 0]))
    # The criterion's prior, as wide as the range, moves neither choice nor error by more.
    assert plan.standard_errors["angle"][-1] == pytest.approx(best, rel=1e-6)


@pytest.mark.parametrize("unknown", [False, True])
def test_greedy_and_exchange_come_near_the_best(unknown):
    parameters = [free.angle()] + [free.index_spectrum(complex_valued=True)] * unknown
    errors = {}
    for method in ("greedy", "exchange", "exhaustive"):
        plan = plan_views(grooves(60, vc.Specular(GOLD)), parameters, STAR, 3, SIGMA, method=method, spread=0.05)
        assert plan.all_identifiable
        errors[method] = plan.worst_standard_errors["angle"][-1]
    assert errors["exhaustive"] <= errors["exchange"] * (1 + 1e-6)
    assert errors["exchange"] <= errors["greedy"] * (1 + 1e-6)
    assert errors["greedy"] <= 1.3 * errors["exhaustive"]  # The range that a study of many sets found.
    assert errors["exchange"] <= 1.15 * errors["exhaustive"]


def test_the_worst_of_the_spread_counts():
    scene = grooves(60, vc.Specular(GOLD))
    local = plan_views(scene, [free.angle()], STAR, 2, SIGMA, spread=0.0, method="exhaustive")
    robust = plan_views(scene, [free.angle()], STAR, 2, SIGMA, spread=0.05, method="exhaustive")
    mean = plan_views(scene, [free.angle()], STAR, 2, SIGMA, spread=0.05, method="exhaustive", over_spread="mean")
    assert local.standard_errors["angle"][-1] <= robust.standard_errors["angle"][-1] * (1 + 1e-9)
    fixed = vc.View(local.polar, local.azimuth)
    judged = plan_views(scene, [free.angle()], fixed, 2, SIGMA, spread=0.05)
    assert robust.worst_standard_errors["angle"][-1] <= judged.worst_standard_errors["angle"][-1] * (1 + 1e-9)
    assert robust.worst_standard_errors["angle"][-1] <= mean.worst_standard_errors["angle"][-1] * (1 + 1e-9)
    assert (robust.worst_standard_errors["angle"][-1]) >= robust.standard_errors["angle"][-1]


def test_criteria_are_those_of_the_covariance():
    parameters = [free.angle(20, 150), free.reflectance(), free.gain()]
    interest = ["angle", "gain"]
    a = plan_views(matte(50), parameters, FAN, 3, SIGMA, spread=0.0, interest=interest)
    covariance = dense_covariance(np.radians(50), a.polar, 0.01)[:2, :2]
    scale = np.array([np.radians(130), 0.01])  # The allowed range; the prior where any value is allowed.
    scaled = covariance / np.outer(scale, scale)
    # The gain's own prior is counted twice where the criterion is regularized: 1/(1/v + 1) instead of v.
    information = np.linalg.inv(scaled) + np.eye(2)
    assert a.criterion_values[-1] == pytest.approx(np.trace(np.linalg.inv(information)), rel=1e-3)
    d = plan_views(matte(50), parameters, FAN, 3, SIGMA, spread=0.0, interest=interest, criterion="D")
    scaled = dense_covariance(np.radians(50), d.polar, 0.01)[:2, :2] / np.outer(scale, scale)
    assert d.criterion_values[-1] == pytest.approx(
        -np.linalg.slogdet(np.linalg.inv(scaled) + np.eye(2))[1], abs=1e-3
    )


def test_the_determinant_of_a_spectrum_has_its_correlations():
    parameters = [free.angle(20, 150), free.reflectance()]
    plan = plan_views(
        matte(50), parameters, FAN, 3, SIGMA, spread=0.0, interest=["angle", "reflectance"], criterion="D"
    )
    scale = np.array([np.radians(130), *np.ones(5)])
    scaled = dense_covariance(np.radians(50), plan.polar) / np.outer(scale, scale)
    information = np.linalg.inv(scaled) + np.eye(6)
    assert plan.criterion_values[-1] == pytest.approx(-np.linalg.slogdet(information)[1], abs=1e-6)


def test_spectra_of_interest():
    parameters = [free.angle(), free.reflectance()]
    plan = plan_views(matte(50), parameters, FAN, 3, SIGMA, interest=["reflectance"])
    own = plan_views(matte(50), parameters, FAN, 3, SIGMA)
    assert np.mean(plan.worst_standard_errors["reflectance"][-1] ** 2) <= np.mean(
        own.worst_standard_errors["reflectance"][-1] ** 2
    ) * (1 + 1e-9)
    held = plan_views(matte(50), [free.reflectance()], FAN, 1, SIGMA)
    assert held.interest == ("reflectance",)
    mirror = [free.angle(), free.index_spectrum(complex_valued=True)]
    n_and_k = plan_views(grooves(80, vc.Specular(GOLD)), mirror, STAR, 3, SIGMA, interest=["index"])
    assert n_and_k.interest == ("n", "k")


def test_a_smooth_spectrum_has_errors_at_each_wavelength():
    plan = plan_views(
        matte(50), [free.angle(), free.reflectance(smooth_nm=60)], FAN, 3, SIGMA, wavelengths_nm=BAND
    )
    alone = plan_views(matte(50), [free.angle(), free.reflectance()], FAN, 3, SIGMA, wavelengths_nm=BAND)
    assert plan.standard_errors["reflectance"].shape == (4, 5)
    assert set(plan.standard_errors) == {"angle", "reflectance"}
    # What is smooth has fewer unknowns.
    assert (plan.standard_errors["reflectance"][-1] < alone.standard_errors["reflectance"][-1]).all()
    with pytest.raises(ValueError, match="depends on the wavelengths; expected them"):
        plan_views(matte(50), [free.angle(), free.reflectance(smooth_nm=60)], FAN, 3, SIGMA)


def test_the_light_is_chosen_too():
    lights = {
        "sphere": (vc.Diffuse(), vc.View(np.radians([0.0, 8.0]), 0.0)),
        "lamp": (vc.Directional(np.radians(50.0)), vc.View(np.radians([-30.0, 0.0, 30.0, 60.0]), 0.0)),
    }
    plan = plan_views(matte(60), [free.angle(), free.reflectance()], lights, 3, SIGMA)
    assert plan.all_identifiable
    assert {view.light for view in plan.views} <= set(lights)
    assert len(plan.candidates) == 6
    assert "lamp" in plan.lights
    alone = plan_views(matte(60), [free.angle(), free.reflectance()], lights["sphere"][1], 2, SIGMA)
    assert not alone.all_identifiable  # d:0 and d:8 see the same.


def test_all_light_may_be_collected():
    lights = {
        "sphere": (vc.Diffuse(), vc.View(0.0)),
        "collected": (vc.Directional(np.radians(70.0)), vc.Hemisphere()),
    }
    plan = plan_views(matte(60), [free.angle(), free.gain().separate()], lights, 2, SIGMA)
    assert {"gain[sphere]", "gain[collected]"} <= set(plan.standard_errors)
    assert "all" in plan.summary()
    # By reciprocity it is a view at 70 degrees in diffuse light.
    same = plan_views(matte(60), [free.angle()], vc.View(np.radians(70.0)), 1, SIGMA)
    only = plan_views(matte(60), [free.angle()], {"collected": lights["collected"]}, 1, SIGMA)
    assert only.standard_errors["angle"][-1] == pytest.approx(same.standard_errors["angle"][-1], rel=1e-6)


def test_stray_light_is_seen_against_the_models_own_mean():
    plan = plan_views(
        matte(60), [free.angle(), free.stray_light(prior=(0.02, 0.01))], FAN, 2, SIGMA, wavelengths_nm=BAND
    )
    seen = vc.View(plan.polar, plan.azimuth)
    factor = np.asarray(vc.reflectance_factor(vc.Scene(*_parts(matte(60)), seen)))
    unknown = jnp.asarray([np.radians(60), 1.0, *RED])
    slope = np.concatenate([dense_jacobian(unknown, jnp.asarray([one]))[:, 0] for one in plan.polar])
    columns = np.stack([0.98 * slope, (factor.mean(axis=1, keepdims=True) - factor).ravel()]) / SIGMA
    information = columns @ columns.T
    information[1, 1] += 1 / 0.01**2
    assert plan.standard_errors["angle"][-1] == pytest.approx(np.sqrt(np.linalg.inv(information)[0, 0]), rel=1e-6)


def _parts(scene):
    return scene.surface, scene.material, scene.illumination


def test_noise_of_each_wavelength():
    even = plan_views(matte(60), [free.angle()], vc.View(0.0), 1, np.full(5, SIGMA))
    blind = plan_views(matte(60), [free.angle()], vc.View(0.0), 1, np.array([SIGMA, *[1e6] * 4]))
    assert blind.standard_errors["angle"][-1] > 1.5 * even.standard_errors["angle"][-1]
    half = plan_views(matte(60), [free.angle()], vc.View(0.0), 1, SIGMA / 2)
    assert half.standard_errors["angle"][-1] == pytest.approx(even.standard_errors["angle"][-1] / 2)


def test_a_tilt_costs_nothing_if_both_sides_are_seen():
    """Its response is odd in θ, that of the angle even."""
    tilt = free.tilt(prior_deg=None)
    fan = vc.View(np.radians([-70.0, -60, -50, 50, 60, 70]), 0.0)
    plan = plan_views(matte(60), [free.angle(), tilt[0]], fan, 2, SIGMA, spread=np.radians(2))
    assert np.sign(plan.polar).sum() == 0
    assert plan.all_identifiable


def test_a_plan_is_written(tmp_path):
    plan = plan_views(matte(60), [free.angle(), free.reflectance()], STAR, 3, SIGMA, measured=vc.View(0.1))
    plan.to_json(tmp_path / "plan.json")
    read = json.loads((tmp_path / "plan.json").read_text())
    assert read["views"][0]["polar_deg"] == pytest.approx(np.degrees(plan.polar[0]))
    assert read["parameters"]["angle"]["unit"] == "deg"
    assert read["parameters"]["angle"]["standard_error"][0] is None
    assert read["parameters"]["angle"]["standard_error"][-1] == pytest.approx(
        np.degrees(plan.standard_errors["angle"][-1])
    )
    assert len(read["criterion_values"]) == 4
    plan.to_csv(tmp_path / "plan.csv")
    lines = (tmp_path / "plan.csv").read_text().splitlines()
    assert len(lines) == 5
    assert lines[0].startswith("view,light,polar_deg,azimuth_deg,criterion,angle_standard_error_deg,")
    assert {line.count(",") for line in lines} == {lines[0].count(",")}
    assert lines[1].startswith("0,,,,")
    for ending in ("png", "svg"):
        plan.plot(tmp_path / f"plan.{ending}")
        assert (tmp_path / f"plan.{ending}").stat().st_size > 5000
    drawn = (tmp_path / "plan.svg").read_text()
    assert "std. error (deg)" in drawn
    assert "across the grooves" in drawn
    text = plan.summary()
    assert "1 measured" in text
    assert "noise 0.005" in text
    assert "planned for angle 60 ± 3 deg" in text


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"count": 0}, "count is 0; expected a whole number from 1 to 9"),
        ({"count": 10}, "count is 10; expected a whole number from 1 to 9"),
        ({"count": True}, "count is True; expected a whole number"),
        ({"noise": 0.0}, "noise is 0; expected positive numbers"),
        ({"noise": np.array([0.1, 0.1, np.nan, 0.1, 0.1])}, "noise is nan; expected positive"),
        ({"noise": np.ones(3)}, r"noise has shape \(3,\); expected one number"),
        ({"noise": None}, "noise is None, and no measurement states"),
        ({"criterion": "E"}, "criterion is 'E'; expected one of A, D"),
        ({"method": "guess"}, "method is 'guess'; expected one of exchange, greedy, exhaustive"),
        ({"over_spread": "best"}, "over_spread is 'best'; expected one of worst, mean"),
        ({"candidates": vc.View(np.pi / 2)}, r"candidates: polar\[0\] is 1.5708; expected between"),
        ({"candidates": ([0.0, np.nan], 0.0)}, r"candidates: polar\[1\] is nan; expected between"),
        ({"candidates": (0.0, 45.0)}, r"azimuth\[0\] is 45; expected -2π to 2π radians: did you pass degrees"),
        ({"candidates": ([], [])}, "no direction; expected at least one"),
        ({"candidates": ([0.0, 1.0, 1.1], [0.0, 1.0])}, "do not broadcast"),
        ({"candidates": 7}, "candidates: int; expected a View, or polar angles and azimuths"),
        ({"candidates": {}}, "candidates is empty"),
        ({"candidates": {"a": 3}}, r"candidates\['a'\] is a int; expected \(illumination, directions\)"),
        ({"candidates": {"a": (3, FAN)}}, r"candidates\['a'\]: int is not a light"),
        ({"free": []}, "no parameter is free"),
        ({"free": None}, "free is None; expected a list of parameters"),
        ({"scene": 3}, "scene is a int; expected a Scene or a FitResult"),
        ({"interest": ["roughness"]}, "interest names 'roughness'; expected some of angle"),
        ({"interest": []}, r"interest is \[\]; expected a list of names"),
        ({"spread": -1.0}, "spread of angle is -1.0; expected a number of at least 0"),
        ({"spread": {"gain": 1.0}}, "spread names 'gain'; expected what is searched: angle"),
        ({"free": [free.angle(80, 120)]}, "scene: angle is 60; expected a value in its allowed range, 80 to 120"),
        ({"measured": [1, 2, 3]}, "measured: list; expected a View"),
        ({"measured": {"x": 3}}, "measured holds a int; expected a Measurement"),
        ({"wavelengths_nm": BAND[:3]}, "the material has wavelength shape"),
    ],
)
def test_bad_input_is_told_in_one_line(change, said):
    given = {"scene": matte(), "free": [free.angle()], "candidates": FAN, "count": 2, "noise": SIGMA} | change
    with pytest.raises(ValueError, match=said) as caught:
        plan_views(**given)
    assert "\n" not in str(caught.value)


def test_a_light_that_the_material_cannot_take():
    lights = {"lamp": (vc.Directional(0.5), FAN)}
    with pytest.raises(ValueError, match="a specular groove under directional light, seen from one direction"):
        plan_views(grooves(60, vc.Specular(GOLD)), [free.angle()], lights, 1, SIGMA)


def test_spread_by_name_if_several_are_searched():
    more = Parameter("lightness", lambda s: s.material.reflectance, 0.05, 0.9)
    scene = grooves(60, vc.Lambertian(jnp.asarray(0.4)))
    with pytest.raises(ValueError, match="expected half-widths by name"):
        plan_views(scene, [free.angle(), more], FAN, 2, SIGMA, spread=0.1)
    plan = plan_views(scene, [free.angle(), more], FAN, 2, SIGMA, spread={"angle": 0.1}, wavelengths_nm=BAND)
    assert plan.spread == {"angle": 0.1, "lightness": 0.0}
    assert plan.interest == ("angle", "lightness")


def test_choosing_a_few_of_many():
    value = np.array([3.0, 1.0, 2.0, 1.0])

    def order(sets):
        return np.stack([np.zeros(len(sets)), value[sets].sum(axis=1)], axis=1)

    assert exchange.greedy(order, range(4), 2) == [1, 3]
    assert exchange.exhaustive(order, range(4), 2) == [1, 3]
    assert sorted(exchange.exchange(order, range(4), [0, 2])) == [1, 3]
    assert exchange.best(np.array([[1.0, -5.0], [0.0, 2.0], [0.0, 2.0 - 1e-12]])) == 1
    assert exchange.better(np.array([0.0, 9.0]), np.array([1.0, 0.0]))
    assert not exchange.better(np.array([1.0, -9.0]), np.array([0.0, 0.0]))
    assert not exchange.better(np.array([0.0, 1.0]), np.array([0.0, 1.0]))
    with pytest.raises(ValueError, match="expected at most 100000: use 'exchange'"):
        exchange.exhaustive(order, range(100), 5)


def test_exchange_leaves_what_greed_cannot():
    """The best single one is not in the best pair."""
    cost = {(0,): 1.0, (1,): 2.0, (2,): 2.0, (0, 1): 0.9, (0, 2): 0.9, (1, 2): 0.1}

    def order(sets):
        return np.array([[0.0, cost[tuple(sorted(s))]] for s in sets.tolist()])

    start = exchange.greedy(order, range(3), 2)
    assert start == [0, 1]
    assert sorted(exchange.exchange(order, range(3), start)) == [1, 2]


def test_the_example_of_the_page_runs(monkeypatch, capsys, tmp_path):
    root = Path(__file__).parents[2]
    (example,) = re.findall(
        r"^```python\n(.*?)^```$", (root / "docs" / "planning.md").read_text(), re.DOTALL | re.MULTILINE
    )
    monkeypatch.chdir(root)
    shared: dict[str, object] = {}
    exec(example.replace('"next.png"', repr(str(tmp_path / "next.png"))), shared)
    assert "every parameter is identifiable" in capsys.readouterr().out
    before, *_, after = shared["plan"].standard_errors["angle"]
    assert after < before < np.inf
    assert (tmp_path / "next.png").exists()


def test_candidates_by_default_and_along_the_normal():
    """A fan of 49 directions; along the normal the azimuth means nothing."""
    plan = plan_views(matte(60), [free.angle()], noise=SIGMA)
    assert len(plan.candidates) == 49
    assert len(plan.views) == 1
    assert plan.spread["angle"] == pytest.approx(np.radians(3))
    azimuth, polar = np.meshgrid([0.0, 0.5, 1.0], [0.0, 0.7], indexing="ij")
    plan = plan_views(matte(60), [free.angle()], (polar, azimuth), 2, SIGMA)
    assert [v.polar for v in plan.candidates].count(0.0) == 1
    twice = plan_views(matte(60), [free.angle()], ([0.0, 0.0], [0.0, 0.0]), 2, SIGMA)
    assert len(twice.candidates) == 2
