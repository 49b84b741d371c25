"""Profile likelihoods of any parameter, against chi-square on grids that are computed anew, and their coverage."""

import jax
import numpy as np
import pytest

import vcavity_jax as vc
from fitting import Measurement, fit, free, profile_likelihood

BAND = np.array([450.0, 500.0, 550.0, 600.0, 650.0])
RED = np.array([0.08, 0.12, 0.3, 0.55, 0.7])
GOLD = np.array([1.46 + 1.95j, 0.97 + 1.87j, 0.4 + 2.6j, 0.25 + 2.9j, 0.17 + 3.2j])
FAN = np.radians([0.0, 40.0, 75.0])
SIGMA = 0.005
LEVEL = 3.841458820694124


def scene_of(degrees, material):
    return vc.Scene(vc.VGrooves(np.radians(degrees)), material, vc.Diffuse(), vc.View())


def model(degrees, material, polar=FAN):
    seen = vc.Scene(vc.VGrooves(np.radians(degrees)), material, vc.Diffuse(), vc.View(polar, 0 * polar))
    return np.asarray(vc.reflectance_factor(seen))


def measured(values, polar=FAN, sigma=SIGMA):
    return Measurement(BAND, polar, 0 * polar, values, np.full(values.shape, sigma))


def noisy(values, seed):
    return values + SIGMA * np.random.default_rng(seed).standard_normal(values.shape)


def tabulated(angles, material, polar=FAN):
    """Reflectance factors at some angles, from the model itself, shape (A, D, L)."""

    def factors(angle):
        seen = vc.Scene(vc.VGrooves(angle), material, vc.Diffuse(), vc.View(polar, 0 * polar))
        return vc.reflectance_factor(seen, smallest_angle=np.radians(30.0))

    return np.asarray(jax.jit(lambda a: jax.lax.map(factors, a, batch_size=32))(angles))


def crossings(places, rise):
    """Where a tabulated rise of chi-square passes the level, by straight lines."""
    beyond = np.flatnonzero((rise[:-1] < LEVEL) != (rise[1:] < LEVEL))
    share = (LEVEL - rise[beyond]) / (rise[beyond + 1] - rise[beyond])
    return places[beyond] + share * (places[beyond + 1] - places[beyond])


def assert_of_the_fit(profile, result, name):
    """Its minimum is the fit's, nothing is lower, and its interval is where it passes the level."""
    estimate = result.estimates[name]
    assert profile.minimum == result.chi_square
    assert profile.level == pytest.approx(LEVEL)
    assert (np.diff(profile.values) > 0).all()
    assert profile.chi_square.min() == pytest.approx(result.chi_square, abs=1e-9)
    assert profile.values[np.argmin(profile.chi_square)] == pytest.approx(profile.best, abs=1e-9)
    assert profile.unit == estimate.unit
    ((low, high),) = profile.interval_95
    assert low < profile.best < high
    ends = np.interp([low, high], profile.values, profile.chi_square)
    assert ends - profile.minimum == pytest.approx([LEVEL, LEVEL], abs=1e-6)
    assert profile.closed


BENCH = [free.angle(30, 170), free.gain((1.0, 0.02)), free.offset()]


@pytest.fixture(scope="module")
def bench():
    """An angle, a gain and an offset; the angle away from kinks."""
    values = noisy(1.01 * model(63, vc.Lambertian(RED)) + 0.001, 5)
    return fit(scene_of(70, vc.Lambertian(RED)), measured(values), BENCH)


ANGLES = np.radians(np.arange(52.0, 76.0, 0.02))


@pytest.fixture(scope="module")
def bench_costs(bench):
    """Chi-square of each angle and each of two numbers, minimized over the other one by the normal equations."""
    factors = tabulated(ANGLES, vc.Lambertian(RED)).reshape(len(ANGLES), -1) / SIGMA
    target = bench.measurement.reflectance_factor.ravel() / SIGMA
    ones = np.full(15, 1 / SIGMA)

    def best_offset(gains):
        rest = target - gains[:, None, None] * factors
        offset = rest @ ones / (ones @ ones + 1 / 0.002**2)
        cost = np.sum((rest - offset[..., None] * ones) ** 2, axis=-1) + (offset / 0.002) ** 2
        return cost + ((gains - 1) / 0.02)[:, None] ** 2

    def best_both():
        costs = []
        for shining in factors:
            rows = np.stack([shining, ones], axis=1)
            rows = np.vstack([rows, [1 / 0.02, 0], [0, 1 / 0.002]])
            wanted = np.append(target, [1 / 0.02, 0])
            costs.append(np.linalg.lstsq(rows, wanted)[1][0])
        return np.array(costs)

    return best_both(), best_offset


def test_of_the_angle(bench, bench_costs):
    profile = profile_likelihood(bench, "angle")
    assert_of_the_fit(profile, bench, "angle")
    assert profile.wavelength_nm is None
    cost = bench_costs[0]
    rise = cost - cost.min()
    near = (profile.values > ANGLES[0]) & (profile.values < ANGLES[-1]) & (profile.chi_square < 60)
    assert near.sum() > 41
    np.testing.assert_allclose(profile.chi_square[near], np.interp(profile.values, ANGLES, cost)[near], atol=2e-3)
    np.testing.assert_allclose(profile.interval_95[0], crossings(ANGLES, rise), atol=np.radians(2e-3))
    np.testing.assert_allclose(profile.interval_95, bench.estimates["angle"].interval_95, atol=np.radians(2e-3))
    error = bench.estimates["angle"].standard_error
    assert profile.best - profile.values[0] >= 4 * error * (1 - 1e-9)
    assert profile.values[-1] - profile.best >= 4 * error * (1 - 1e-9)
    assert profile.displayed(np.pi) == 180


def test_of_a_gain(bench, bench_costs):
    profile = bench.profile("gain", points=11)
    assert_of_the_fit(profile, bench, "gain")
    cost = bench_costs[1](profile.values).min(axis=1)
    np.testing.assert_allclose(profile.chi_square, cost, atol=2e-3)
    # What the fit says of the gain without looking again.
    width = np.diff(profile.interval_95[0])[0]
    np.testing.assert_allclose(profile.interval_95, bench.estimates["gain"].interval_95, atol=0.01 * width)


def test_of_an_offset(bench):
    profile = bench.profile("offset", points=11)
    assert_of_the_fit(profile, bench, "offset")
    width = np.diff(profile.interval_95[0])[0]
    np.testing.assert_allclose(profile.interval_95, bench.estimates["offset"].interval_95, atol=0.01 * width)


UNKNOWN = [free.angle(30, 170), free.reflectance()]


@pytest.fixture(scope="module")
def unknown():
    return fit(scene_of(60, vc.Lambertian(RED)), measured(noisy(model(63, vc.Lambertian(RED)), 6)), UNKNOWN)


def lowest(cost):
    """Minima of parabolas through the lowest entry of each last axis and its neighbors."""
    at = np.clip(np.argmin(cost, axis=-1), 1, cost.shape[-1] - 2)[..., None]
    left, middle, right = (np.take_along_axis(cost, at + k, axis=-1)[..., 0] for k in (-1, 0, 1))
    return middle - (right - left) ** 2 / (8 * (left - 2 * middle + right))


def test_beside_an_unknown_spectrum(unknown):
    """At each angle every wavelength is minimized by itself, on a grid of reflectances."""
    grid = np.linspace(0.001, 0.999, 2001)
    angles = np.radians(np.arange(48.0, 80.0, 0.2))
    factors = tabulated(angles, vc.Lambertian(grid))
    values = unknown.measurement.reflectance_factor
    costs = np.stack(
        [np.sum(((factors - values[:, k, None]) / SIGMA) ** 2, axis=1) for k in range(5)]
    )  # Wavelengths, angles, reflectances.
    best = lowest(costs)
    total = best.sum(axis=0)
    assert lowest(total) == pytest.approx(unknown.chi_square, abs=2e-3)

    profile = unknown.profile("angle")
    assert_of_the_fit(profile, unknown, "angle")
    np.testing.assert_allclose(profile.interval_95, unknown.estimates["angle"].interval_95, atol=np.radians(2e-3))
    near = (profile.values > angles[0]) & (profile.values < angles[-1]) & (profile.chi_square < 40)
    assert near.sum() > 41
    # A fifth of a degree is an eighth of the standard error: straight lines lie 0.01 too high, more near kinks.
    np.testing.assert_allclose(profile.chi_square[near], np.interp(profile.values, angles, total)[near], atol=0.05)

    for place in (0, 3):
        profile = unknown.profile("reflectance", wavelength_nm=BAND[place])
        assert_of_the_fit(profile, unknown, "reflectance")
        assert profile.wavelength_nm == BAND[place]
        assert profile.best == unknown.estimates["reflectance"].value[place]
        held = np.stack([np.interp(profile.values, grid, costs[place, a]) for a in range(len(angles))], axis=1)
        np.testing.assert_allclose(profile.chi_square, lowest(held + total - best[place]), atol=0.02)
        # The interval of the fit comes from slopes along the profile of the angle.
        low, high = (end[place] for end in unknown.estimates["reflectance"].interval_95[0])
        ((own_low, own_high),) = profile.interval_95
        assert (low, high) == pytest.approx((own_low, own_high), abs=0.03 * (own_high - own_low))
        error = unknown.estimates["reflectance"].standard_error[place]
        assert (own_high - own_low) / (2 * 1.96 * error) == pytest.approx(1, abs=0.1)


@pytest.fixture(scope="module")
def tilted():
    """Nothing is searched: two tilts of a groove that is known."""
    polar = np.radians([-60.0, 10.0, 45.0, 75.0])
    panels = vc.Lambertian(RED)
    values = noisy(model(83, panels, polar + np.radians(0.8)), 7)
    return fit(scene_of(83, panels), measured(values, polar), [free.tilt()])


def test_of_a_tilt(tilted):
    """Of the one along the grooves a fan across them knows little but the prior, 0 ± 1 degree."""
    profile = tilted.profile("tilt_across", points=21)
    assert_of_the_fit(profile, tilted, "tilt_across")
    # Against the model itself in turned directions; the other tilt is set to its best value.
    along = tilted.estimates["tilt_along"].value
    polar, values = tilted.measurement.polar, tilted.measurement.reflectance_factor

    @jax.jit
    def factors(across):
        seen = vc.View(polar + across, 0 * polar)
        return vc.reflectance_factor(
            vc.Scene(vc.VGrooves(np.radians(83.0)), vc.Lambertian(RED), vc.Diffuse(), seen)
        )

    cost = np.array([np.sum(((factors(v) - values) / SIGMA) ** 2) for v in profile.values])
    cost = cost + (np.degrees(profile.values)) ** 2 + np.degrees(along) ** 2
    np.testing.assert_allclose(profile.chi_square, cost, atol=0.02)
    other = tilted.profile("tilt_along", points=11)
    assert_of_the_fit(other, tilted, "tilt_along")
    assert np.degrees(np.diff(other.interval_95[0])) == pytest.approx(2 * 1.96, abs=0.1)


GOLD_SCENE = scene_of(90, vc.Specular(GOLD))
FRONTAL = np.zeros(1)


def test_at_a_kink():
    """Gold at 90 degrees from the front: the model changes tenfold less below. Against the model itself."""
    values = noisy(model(90, vc.Specular(GOLD), FRONTAL), 7)
    result = fit(GOLD_SCENE, measured(values, FRONTAL), [free.angle(30, 170)])
    profile = result.profile("angle", points=81)
    assert_of_the_fit(profile, result, "angle")
    angles = np.radians(np.arange(80.0, 92.0, 0.01))
    cost = np.sum(((tabulated(angles, vc.Specular(GOLD), FRONTAL) - values) / SIGMA) ** 2, axis=(1, 2))
    ends = crossings(angles, cost - cost.min())
    np.testing.assert_allclose(profile.interval_95[0], ends, atol=np.radians(0.01))
    assert result.estimates["angle"].value == pytest.approx(np.pi / 2, abs=1e-6)
    below, above = result.estimates["angle"].value - ends[0], ends[1] - result.estimates["angle"].value
    assert below > 5 * above


def test_an_open_interval_says_so(unknown):
    """A profile over the whole allowed range where there is no standard error."""
    values = noisy(model(150, vc.Lambertian(RED)), 3)
    result = fit(scene_of(60, vc.Lambertian(RED)), measured(values), UNKNOWN)
    assert np.isnan(result.estimates["angle"].standard_error)
    profile = result.profile("angle", points=21)
    assert not profile.closed
    assert profile.values[-1] == np.radians(170)
    assert profile.values[0] == np.radians(30)
    assert profile.interval_95[-1][1] == np.radians(170)
    np.testing.assert_allclose(profile.interval_95, result.estimates["angle"].interval_95, atol=np.radians(0.02))


def test_with_an_estimated_uncertainty_the_level_is_students(bench):
    m = Measurement(BAND, FAN, 0 * FAN, bench.measurement.reflectance_factor)
    result = fit(bench.scene, m, BENCH)
    profile = result.profile("angle")
    assert profile.level == pytest.approx(2.144787**2, rel=1e-5)  # Of 15 + 2 - 3 degrees of freedom.
    assert profile.minimum == pytest.approx(result.chi_square)
    np.testing.assert_allclose(profile.interval_95, result.estimates["angle"].interval_95, atol=np.radians(5e-3))


def test_pictures(unknown, tmp_path):
    for ending in ("png", "pdf", "svg"):
        path = tmp_path / f"profile.{ending}"
        unknown.profile("reflectance", wavelength_nm=600.0).plot(path)
        assert path.stat().st_size > 4000
    unknown.profile("angle").plot(path)
    text = path.read_text(encoding="utf-8")
    assert text.startswith("<?xml")
    with pytest.raises(ValueError, match=r"\.png, \.pdf or \.svg"):
        unknown.profile("angle", points=5).plot(tmp_path / "profile.txt")
    with pytest.raises(OSError, match="nowhere"):
        unknown.profile("angle", points=5).plot(tmp_path / "nowhere" / "profile.png")


def test_refusals(bench, unknown):
    cases = [
        (bench, ("tilt",), {}, "'tilt' is not a fitted parameter; expected one of angle, gain, offset"),
        (bench, ("gain",), {"wavelength_nm": 500.0}, "'gain' is one number; expected no wavelength"),
        (bench, ("gain",), {"points": 4}, "points is 4; expected at least 5"),
        (unknown, ("reflectance",), {}, "wavelength_nm is None; expected one of the 5 wavelengths"),
        (unknown, ("reflectance",), {"wavelength_nm": 510.0}, "wavelength_nm is 510.0.* 450 to 650 nm"),
    ]
    for result, names, options, message in cases:
        with pytest.raises(ValueError, match=message) as caught:
            profile_likelihood(result, *names, **options)
        assert "\n" not in str(caught.value)


def test_what_is_not_determined_and_unbounded_has_no_profile():
    """A free gain of a black sample."""
    scene = scene_of(70, vc.Lambertian(np.zeros(5)))
    result = fit(scene, measured(np.zeros((3, 5))), [free.angle(30, 170), free.gain(None), free.offset()])
    assert np.isnan(result.estimates["gain"].standard_error)
    with pytest.raises(ValueError, match="no finite range; expected a prior or bounds"):
        result.profile("gain")


def test_what_is_not_determined_but_bounded_has_a_flat_profile():
    """A reflectance at a wavelength without values: over the whole allowed range."""
    lost = measured(np.where(np.arange(5) == 2, np.nan, model(63, vc.Lambertian(RED))))
    result = fit(scene_of(60, vc.Lambertian(RED)), lost, UNKNOWN)
    assert np.isnan(result.estimates["reflectance"].value[2])
    profile = result.profile("reflectance", wavelength_nm=550.0)
    assert np.isfinite(profile.values).all()
    assert (profile.values[0], profile.values[-1]) == (0, 1)
    np.testing.assert_allclose(profile.chi_square, result.chi_square, atol=1e-6)
    assert profile.interval_95 == [(0, 1)]
    assert not profile.closed
