"""Whatever may be free beside the groove: found again in exact data, pulled by priors, shared or not, refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import vcavity_jax as vc
from fitting import Measurement, assembly, fit, free, instrument, priors
from fitting.spectra import Smooth

BAND = np.array([450.0, 500.0, 550.0, 600.0, 650.0])
RED = np.array([0.08, 0.12, 0.3, 0.55, 0.7])
FAN = np.radians([0.0, 40.0, 75.0])
LIKELIHOOD_95 = 3.841458820694124


def grooves(degrees, material, light=None):
    return vc.Scene(vc.VGrooves(np.radians(degrees)), material, light or vc.Diffuse(), vc.View())


def seen(scene, polar=FAN, azimuth=None):
    azimuth = 0 * polar if azimuth is None else azimuth
    return vc.Scene(scene.surface, scene.material, scene.illumination, vc.View(polar, azimuth))


def measured(values, scene=None, nm=BAND, polar=FAN, azimuth=None, sigma=0.005):
    light = vc.Diffuse() if scene is None else scene.illumination
    azimuth = 0 * polar if azimuth is None else azimuth
    return Measurement(nm, polar, azimuth, values, np.full(values.shape, sigma), illumination=light)


def exact(scene, nm=BAND, polar=FAN, sigma=0.005):
    values = np.asarray(vc.reflectance_factor(seen(scene, polar))).reshape(len(polar), -1)
    return measured(np.broadcast_to(values, (len(polar), len(nm))).copy(), scene, nm, polar, None, sigma)


def smooth_red(nm):
    """Twice as steep as most pigments."""
    return 0.1 + 0.6 / (1 + np.exp(-(nm - 560) / 25))


# The instrument.

NM = np.arange(400.0, 701.0, 10.0)
TILT_DEG = (1.3, -0.8)


def turn(across, along):
    """The rotation of free.tilt: across lifts azimuth 0 away from the normal, then along does azimuth π/2."""
    return Rotation.from_rotvec([0, along, 0]) * Rotation.from_rotvec([-across, 0, 0])


def unit_vectors(polar, azimuth):
    return np.stack([np.sin(polar) * np.sin(azimuth), np.sin(polar) * np.cos(azimuth), np.cos(polar)], axis=-1)


def turned(polar, azimuth, across, along):
    x, y, z = np.moveaxis(turn(across, along).apply(unit_vectors(polar, azimuth)), -1, 0)
    return np.arccos(z), np.arctan2(x, y)


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.03, 0.0), (0.0, -0.05), (0.04, 0.02), (-0.3, 0.2)])
def test_a_tilt_is_a_rotation(tilt):
    polar, azimuth = (
        np.radians([0.0, 10.0, 45.0, -45.0, 60.0, 30.0]),
        np.radians([0.0, 0.0, 0.0, 0.0, 90.0, -130.0]),
    )
    light = vc.Directional(np.radians(35.0), np.radians(20.0))
    scene = vc.Scene(vc.VGrooves(1.0), vc.Lambertian(RED), light, vc.View(polar, azimuth))
    found, factor = instrument.tilted(scene, *(jnp.asarray(t) for t in tilt))
    wanted = turn(*tilt).apply(unit_vectors(polar, azimuth))
    # The frontal direction is moved off the normal by √2 nanoradians where it would lie on it.
    np.testing.assert_allclose(unit_vectors(found.view.polar, found.view.azimuth), wanted, rtol=0, atol=2e-9)
    there = turn(*tilt).apply(unit_vectors(light.polar, light.azimuth))
    lit = unit_vectors(found.illumination.polar, found.illumination.azimuth)
    np.testing.assert_allclose(lit, there, rtol=0, atol=1e-14)
    assert float(factor) == pytest.approx(there[2] / np.cos(np.radians(35)), rel=1e-14)
    if tilt[1] == 0:
        assert np.arccos(wanted[1, 2]) == pytest.approx(np.radians(10) + tilt[0])


@pytest.mark.parametrize(
    "light",
    [
        None,
        pytest.param(vc.Directional(0.0), marks=pytest.mark.slow),
        pytest.param(vc.Directional(np.radians(25.0), np.radians(10.0)), marks=pytest.mark.slow),
    ],
)
def test_the_slope_of_a_tilt_at_the_normal(light):
    """Polar angle and azimuth have no derivative there, the reflectance factor has one; unlike panels show it.

    Against central differences, whose error is (5e-4)² times a third derivative of order 1.
    """
    panels = vc.TwoPanels(vc.Lambertian(np.array([0.2, 0.1])), vc.Lambertian(np.array([0.8, 0.5])))
    scene = seen(grooves(70, panels, light), np.zeros(1))

    def factor(tilt):
        placed, share = instrument.tilted(scene, tilt[0], tilt[1])
        return share * vc.reflectance_factor(placed, smallest_angle=1.0)[0]

    @jax.jit
    def program(tilts):
        return jax.vmap(lambda t: (factor(t), jax.jacfwd(factor)(t)))(tilts)

    step = 5e-4
    values, slopes = (np.asarray(a) for a in program(step * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])))
    differences = np.stack([values[1] - values[2], values[3] - values[4]], axis=-1) / (2 * step)
    np.testing.assert_allclose(slopes[0], differences, rtol=1e-5, atol=1e-6)
    assert np.abs(slopes[0, :, 0]).min() > 0.05
    np.testing.assert_allclose(values[0], vc.reflectance_factor(scene, smallest_angle=1.0)[0], rtol=1e-8)


def test_all_that_an_instrument_adds_is_found_again():
    """Written anew: rotated directions, the shifted spectrum itself, gain and offset, then stray light."""
    polar = np.radians([-60.0, -20.0, 10.0, 35.0, 70.0])
    azimuth = np.radians([0.0, 30.0, -50.0, 80.0, 10.0])
    shift, gain, offset, share = 1.7, 1.03, 0.006, 0.08
    across, along = np.radians(TILT_DEG)
    view = vc.View(*turned(polar, azimuth, across, along))
    moved = vc.Scene(vc.VGrooves(np.radians(70)), vc.Lambertian(smooth_red(NM + shift)), vc.Diffuse(), view)
    recorded = gain * np.asarray(vc.reflectance_factor(moved)) + offset
    recorded = (1 - share) * recorded + share * recorded.mean(axis=1, keepdims=True)
    start = grooves(70, vc.Lambertian(smooth_red(NM)))
    m = measured(recorded, start, NM, polar, azimuth, 0.001)
    everything = [
        free.gain(None),
        free.offset(None),
        free.tilt(None),
        free.stray_light(),
        free.wavelength_shift(3, None),
    ]
    result = fit(start, m, everything)
    assert result.status == "converged"
    found = {name: e.value for name, e in result.estimates.items()}
    # The interpolated spectrum is wrong by some 1e-5, see below.
    assert np.degrees([found["tilt_across"], found["tilt_along"]]) == pytest.approx(TILT_DEG, abs=2e-3)
    assert found["wavelength_shift"] == pytest.approx(shift, abs=2e-3)
    assert found["gain"] == pytest.approx(gain, abs=1e-4)
    assert found["offset"] == pytest.approx(offset, abs=1e-4)
    assert found["stray_light"] == pytest.approx(share, abs=1e-4)
    assert result.rms_misfit < 1e-5
    assert result.identifiable


@pytest.mark.slow
def test_a_tilt_in_parallel_light():
    """The white standard was not tilted: the sample's irradiance changes by cos θ'/cos θ, here by 2 %."""
    across, along = np.radians(TILT_DEG)
    light = vc.Directional(np.radians(55.0), np.radians(30.0))
    polar, azimuth = np.radians([-50.0, 0.0, 30.0]), np.zeros(3)
    view = vc.View(*turned(polar, azimuth, across, along))
    normal = turn(across, along).apply(unit_vectors(light.polar, light.azimuth))[2]
    there = vc.Directional(np.arccos(normal), turned(light.polar, light.azimuth, across, along)[1])
    share = normal / np.cos(np.radians(55))
    assert abs(share - 1) > 0.01
    recorded = share * np.asarray(
        vc.reflectance_factor(vc.Scene(vc.VGrooves(np.radians(100)), vc.Lambertian(RED), there, view))
    )
    scene = grooves(100, vc.Lambertian(RED), light)
    result = fit(scene, measured(recorded, scene, BAND, polar, azimuth), [free.tilt(None)])
    found = np.degrees([result.estimates[f"tilt_{w}"].value for w in ("across", "along")])
    assert found == pytest.approx(TILT_DEG, abs=1e-5)
    assert result.chi_square < 1e-9


SYMMETRIC = np.radians([-70.0, -35.0, 0.0, 35.0, 70.0])


def test_a_tilt_of_a_symmetric_fan_and_the_angle():
    """A fan across the grooves tells both; of a tilt along them it knows next to nothing but the prior."""
    view = vc.View(*turned(SYMMETRIC, 0 * SYMMETRIC, np.radians(1.3), 0.0))
    truth = vc.Scene(vc.VGrooves(np.radians(83.0)), vc.Lambertian(RED), vc.Diffuse(), view)
    m = measured(np.asarray(vc.reflectance_factor(truth)), None, BAND, SYMMETRIC)
    across, along = free.tilt(None)[0], free.tilt((0.0, 1.0))[1]
    result = fit(grooves(70, vc.Lambertian(RED)), m, [free.angle(30, 170), across, along])
    assert result.status == "converged"
    assert np.degrees(result.estimates["angle"].value) == pytest.approx(83, abs=1e-4)
    assert np.degrees(result.estimates["tilt_across"].value) == pytest.approx(1.3, abs=1e-4)
    assert np.degrees(result.estimates["tilt_along"].standard_error) == pytest.approx(1, abs=0.1)
    assert not any("symmetric" in w for w in result.warnings)
    # Without that prior nothing is known of it, and the fit says so.
    lost = fit(grooves(70, vc.Lambertian(RED)), m, [free.angle(30, 170), free.tilt(None)])
    assert lost.status == "not identifiable"
    assert np.isnan(lost.estimates["tilt_along"].standard_error)


# The wavelength scale.


def test_shifted_spectra_are_of_fourth_order():
    """Halving the step divides the error by 16."""
    shares, errors = np.array([-0.6, 0.4]), []
    for step in (10.0, 5.0, 2.5, 1.25):
        nm = np.arange(400.0, 700.0 + step / 2, step)
        spectrum = jnp.asarray(smooth_red(nm))[None]
        program = jax.jit(
            jax.vmap(lambda shift, spectrum=spectrum, nm=nm: instrument.shifted(spectrum, nm, shift))
        )
        wanted = smooth_red(nm + step * shares[:, None])
        kept = instrument.within_shift(nm, -0.6 * step, 0.6 * step)
        assert kept.sum() == len(nm) - 2
        errors.append(np.abs(np.asarray(program(step * shares))[:, 0] - wanted)[:, kept].max(axis=1))
    ratios = np.array(errors[:-1]) / errors[1:]
    assert (np.abs(ratios[-1] - 16) < 1.5).all()
    assert (errors[0] < 1e-3).all()
    assert (errors[1] < 1e-4).all()


def test_a_shift_is_smooth_through_zero_and_through_the_grid():
    """Value and slope, on an uneven grid too; and by nothing it changes nothing."""
    nm = np.array([400.0, 410, 418, 430, 445, 450, 462, 470, 480, 495, 510, 520])
    factor = jnp.asarray(smooth_red(nm))[None]

    @jax.jit
    def both(shift):
        return jax.jvp(lambda s: instrument.shifted(factor, nm, s), (shift,), (jnp.ones(()),))

    np.testing.assert_array_equal(both(jnp.zeros(()))[0], factor)
    for place in (0.0, 8.0, -12.0, 20.0):  # Where some wavelength reaches a neighbor.
        kept = instrument.within_shift(nm, -abs(place) - 1, abs(place) + 1)
        (below, slope_below), (above, slope_above) = (both(jnp.asarray(place + d)) for d in (-1e-7, 1e-7))
        np.testing.assert_allclose(above[:, kept], below[:, kept], rtol=0, atol=1e-8)
        np.testing.assert_allclose(slope_above[:, kept], slope_below[:, kept], rtol=0, atol=1e-8)
        middle = np.asarray(both(jnp.asarray(place))[1])[:, kept]
        differences = np.asarray(above - below)[:, kept] / 2e-7
        np.testing.assert_allclose(middle, differences, rtol=0, atol=1e-8)
        assert np.abs(middle).max() > 1e-3


def cubic(nm):
    t = (nm - 550) / 150
    return 0.4 + 0.1 * t - 0.05 * t**2 + 0.1 * t**3


def test_a_shift_of_a_cubic_spectrum_is_exact():
    """Wavelengths nearer to an end than the limit have no neighbor, and no say."""
    nm = np.arange(400.0, 701.0, 2.0)
    flat = grooves(180, vc.Lambertian(cubic(nm)))
    values = cubic(nm - 1.234)[None].copy()
    m = measured(values, None, nm, np.zeros(1), None, 0.001)
    result = fit(flat, m, [free.wavelength_shift(3, None)])
    assert result.estimates["wavelength_shift"].value == pytest.approx(-1.234, abs=1e-6)
    assert result.estimates["wavelength_shift"].unit == "nm"
    assert result.degrees_of_freedom == len(nm) - 4 - 1
    values[0, [0, 1, -2, -1]] = 0.9
    polluted = measured(values, None, nm, np.zeros(1), None, 0.001)
    again = fit(flat, polluted, [free.wavelength_shift(3, None)])
    assert again.estimates["wavelength_shift"].value == result.estimates["wavelength_shift"].value
    assert again.chi_square == result.chi_square
    # Nothing is extrapolated, silently or not: where there is no neighbor there is no prediction.
    left_out = np.isnan(again.predicted[0])
    assert left_out.tolist() == [k in (0, 1, len(nm) - 2, len(nm) - 1) for k in range(len(nm))]
    assert again.rms_misfit < 1e-8


@pytest.mark.parametrize(("low", "high"), [(-3.0, 0.5), (-0.5, 3.0)])
def test_one_sided_limits_of_a_shift_leave_out_what_they_must(low, high):
    nm = np.arange(400.0, 701.0, 2.0)
    m = measured(cubic(nm)[None], None, nm, np.zeros(1), None, 0.001)
    shift = free.wavelength_shift(3, priors.Uniform(low, high))
    problem = assembly.build(grooves(180, vc.Lambertian(cubic(nm))), m, [shift], None, 1e-8)
    used = nm[np.asarray(problem.data.weights[0])[0] > 0]
    assert used[0] + low >= nm[0]
    assert used[-1] + high <= nm[-1]


# What the material adds.


def unmatched(result, **truth):
    """Names of numbers that differ from the truth by more than 1e-6 of it."""
    found = {name: result.estimates[name].value for name in truth}
    return {k: v for k, v in found.items() if not np.isclose(v, truth[k], rtol=1e-6, atol=1e-9)}


def test_one_index_for_all_wavelengths():
    result = fit(grooves(70, vc.Specular(2.0)), exact(grooves(70, vc.Specular(1.4321))), [free.index()])
    assert not unmatched(result, index=1.4321)
    assert result.status == "converged"


@pytest.mark.slow
def test_cauchy():
    nm = BAND
    truth = 1.48 + 0.011 / (nm / 1000) ** 2
    m = exact(grooves(70, vc.Specular(truth)))
    formula = free.Cauchy((1.2, 2.6), (-0.01, 0.05))
    result = fit(grooves(70, vc.Specular(np.full(5, 1.8))), m, [free.index_spectrum(formula)])
    assert not unmatched(result, **{"index.a": 1.48, "index.b_um2": 0.011})
    np.testing.assert_allclose(result.estimates["n"].value, truth, rtol=1e-7)
    # Errors of the spectrum are those of n = A + B/λ².
    covariance = result.covariance
    rows = np.stack([np.ones(5), 1 / (nm / 1000) ** 2], axis=1)
    errors = np.sqrt(np.einsum("wi,ij,wj->w", rows, covariance, rows))
    np.testing.assert_allclose(result.estimates["n"].standard_error, errors, rtol=1e-10)


@pytest.mark.slow
def test_sellmeier():
    square = 1 + 1.03 * (BAND / 1000) ** 2 / ((BAND / 1000) ** 2 - 0.0098)
    m = exact(grooves(70, vc.Specular(np.sqrt(square))))
    formula = free.Sellmeier([(0.5, 2.0)], [(0.001, 0.04)])
    result = fit(grooves(70, vc.Specular(np.full(5, 1.7))), m, [free.index_spectrum(formula)])
    assert not unmatched(result, **{"index.b1": 1.03, "index.c1_um2": 0.0098})
    np.testing.assert_allclose(result.estimates["n"].value, np.sqrt(square), rtol=1e-7)


def drude_lorentz(infinity, plasma, damping, strength=0.0, energy=1.0, width=1.0):
    photon = 1239.8419843320026 / BAND
    epsilon = infinity - plasma**2 / (photon**2 + 1j * photon * damping)
    return np.sqrt(epsilon + strength * energy**2 / (energy**2 - photon**2 - 1j * photon * width))


@pytest.mark.parametrize("bound", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_drude_lorentz(bound):
    """A metal without or with a resonance: three or six coefficients, from another metal."""
    count = 3 * (1 + bound)
    truth = (3.0, 8.0, 0.3, 1.2, 2.6, 0.7)[:count]
    polar = np.radians([0.0, 20.0, 50.0, 75.0])
    m = exact(grooves(80, vc.Specular(drude_lorentz(*truth))), polar=polar)
    ranges = [(1.0, 10.0), (4.0, 12.0), (0.05, 1.0), (0.2, 3.0), (2.0, 3.5), (0.2, 2.0)]
    formula = free.DrudeLorentz(*ranges[:3], oscillators=[tuple(ranges[3:])] * bound)
    start = grooves(80, vc.Specular(drude_lorentz(*(4.0, 7.0, 0.4, 1.0, 2.8, 0.9)[:count])))
    result = fit(start, m, [free.index_spectrum(formula)])
    names = ("epsilon_infinity", "plasma_ev", "damping_ev", "strength1", "energy1_ev", "width1_ev")[:count]
    np.testing.assert_allclose(result.estimates["n"].value, drude_lorentz(*truth).real, rtol=1e-6)
    np.testing.assert_allclose(result.estimates["k"].value, drude_lorentz(*truth).imag, rtol=1e-6)
    found = [result.estimates[f"index.{name}"].value for name in names]
    np.testing.assert_allclose(found, truth, rtol=1e-4 if bound else 1e-6)  # Six are correlated to 0.999.
    # Errors of n and k follow from those of the coefficients.
    steps = 1e-6 * np.diag(truth)
    slopes = np.stack(
        [(drude_lorentz(*(truth + s)) - drude_lorentz(*(truth - s))) / (2 * s.sum()) for s in steps], axis=-1
    )
    for name, rows in (("n", slopes.real), ("k", slopes.imag)):
        errors = np.sqrt(np.einsum("wi,ij,wj->w", rows, result.covariance, rows))
        np.testing.assert_allclose(result.estimates[name].standard_error, errors, rtol=1e-3)


def first_side(scene):
    return scene.material.first.reflectance


def test_any_spectrum_of_the_scene():
    """That of the first panel alone."""

    def panels(reflectance):
        return grooves(70, vc.TwoPanels(vc.Lambertian(reflectance), vc.Lambertian(RED[::-1])))

    result = fit(panels(np.full(5, 0.5)), exact(panels(RED)), [free.spectrum("bright side", first_side)])
    np.testing.assert_allclose(result.estimates["bright side"].value, RED, rtol=1e-7)
    np.testing.assert_allclose(result.scene.material.first.reflectance, RED, rtol=1e-7)
    np.testing.assert_array_equal(result.scene.material.second.reflectance, RED[::-1])


@pytest.mark.slow
def test_any_number_of_the_scene():
    def panels(reflectance):
        return grooves(70, vc.TwoPanels(vc.Lambertian(reflectance), vc.Lambertian(RED[::-1])))

    parameter = free.parameter("gray side", first_side, 0.05, 0.95)
    assert not unmatched(fit(panels(0.6), exact(panels(0.3)), [parameter]), **{"gray side": 0.3})


@pytest.mark.slow
def test_what_lies_below_an_interface():
    """Transmittance of a layer, coverage of a halftone: to ten times the model's tolerance over slopes near 1."""
    clear = np.array([0.5, 0.6, 0.7, 0.8, 0.9])

    def coated(layer):
        return grooves(80, vc.InterfacedLambertian(RED, 1.5, layer))

    m = exact(coated(vc.ColoredLayer(clear)))
    start = coated(vc.ColoredLayer(np.full(5, 0.4)))
    result = fit(start, m, [free.transmittance()], tolerance=1e-6)
    np.testing.assert_allclose(result.estimates["transmittance"].value, clear, atol=1e-5)
    m = exact(coated(vc.Halftone(0.35, RED)))
    result = fit(coated(vc.Halftone(0.9, RED)), m, [free.coverage()], tolerance=1e-6)
    assert result.estimates["coverage"].value == pytest.approx(0.35, abs=1e-5)


def test_a_smooth_reflectance_is_the_most_probable_spectrum():
    """A flat sample: against the Gaussian process itself, its covariance at the measured wavelengths."""
    nm = np.arange(400.0, 701.0, 10.0)
    random = np.random.default_rng(8)
    noisy = smooth_red(nm) + 0.02 * random.standard_normal(len(nm))
    noisy[12:15] = np.nan
    flat = grooves(180, vc.Lambertian(np.full(len(nm), 0.5)))
    m = measured(noisy[None], None, nm, np.zeros(1), None, 0.02)
    result = fit(flat, m, [free.reflectance(smooth_nm=40)])
    covariance = 1.5**2 * (1 + np.exp(-(((nm[:, None] - nm) / 40) ** 2) / 2))
    root = np.linalg.cholesky(covariance + 1e-10 * np.eye(len(nm)))
    present = ~np.isnan(noisy)

    def residual(u):
        return np.append((1 / (1 + np.exp(-(root @ u))) - noisy)[present] / 0.02, u)

    best = least_squares(residual, np.zeros(len(nm)), xtol=1e-12, ftol=1e-12, gtol=1e-12)
    spectrum = 1 / (1 + np.exp(-(root @ best.x)))
    # Of the variance 4.5 of the logit a millionth per mode is left out: 0.002 or so, a quarter in reflectance.
    np.testing.assert_allclose(result.estimates["reflectance"].value, spectrum, atol=5e-4)
    assert result.chi_square == pytest.approx(2 * best.cost, rel=1e-3)
    # Laplace's errors, where there are values and where there are none.
    slopes = (spectrum * (1 - spectrum))[:, None] * root
    errors = np.sqrt(np.diag(slopes @ np.linalg.inv(best.jac.T @ best.jac) @ slopes.T))
    np.testing.assert_allclose(result.estimates["reflectance"].standard_error, errors, rtol=1e-2)
    assert np.abs(spectrum - smooth_red(nm)).max() < 0.03
    assert list(result.estimates) == ["reflectance"]

    # A spectrum that the form describes, in data so certain that the priors pull by less than a millionth.
    form = Smooth("reflectance", 40)
    weights = np.zeros(len(form.coefficients(nm, noisy)))
    weights[:4] = 0.8, -0.9, 0.5, 0.3
    truth = np.asarray(form.spectrum(nm, (400.0, 700.0), jnp.asarray(weights)))[0]
    result = fit(flat, measured(truth[None], None, nm, np.zeros(1), None, 1e-6), [free.reflectance(smooth_nm=40)])
    np.testing.assert_allclose(result.estimates["reflectance"].value, truth, atol=1e-6)


# Priors.

ALL_PRIORS = {
    "normal": ((1.0, 0.01), lambda x: ((x - 1) / 0.01) ** 2),
    "truncated": (
        priors.TruncatedNormal(1.0, 0.01, 0.98, 1.015),
        lambda x: np.where((x >= 0.98) & (x <= 1.015), ((x - 1) / 0.01) ** 2, np.inf),
    ),
    "beyond": (
        priors.TruncatedNormal(0.9, 0.05, 0.99, 1.2),
        lambda x: np.where((x >= 0.99) & (x <= 1.2), ((x - 0.9) / 0.05) ** 2, np.inf),
    ),
    "logarithm": (priors.LogNormal(1.05, 0.01), lambda x: (np.log(x / 1.05) / 0.01) ** 2),
    "uniform": (priors.Uniform(0.99, 1.005), lambda x: np.where((x >= 0.99) & (x <= 1.005), 0.0, np.inf)),
    "none": (None, lambda x: 0 * x),
}
GAINS = np.linspace(0.95, 1.1, 6001)


def brute(cost):
    """Place of the minimum, its value, and the ends of the 95 % interval of a tabulated cost."""

    def summary(places):
        lowest = np.argmin(cost)
        within = places[cost < cost[lowest] + LIKELIHOOD_95]
        return places[lowest], cost[lowest], within[0], within[-1]

    return summary


@pytest.mark.parametrize("kind", ALL_PRIORS)
def test_a_prior_of_a_gain_alone(kind):
    """Nothing is searched: against chi-square on a grid, its step 2.5e-5."""
    prior, penalty = ALL_PRIORS[kind]
    scene = grooves(70, vc.Lambertian(RED))
    model = exact(scene, sigma=0.01).reflectance_factor
    m = measured(1.02 * model, sigma=0.01)
    result = fit(scene, m, [free.gain(prior)])
    table = np.sum(((1.02 - GAINS[:, None, None]) * model / 0.01) ** 2, axis=(1, 2)) + penalty(GAINS)
    place, cost, low, high = brute(table)(GAINS)
    estimate = result.estimates["gain"]
    assert estimate.value == pytest.approx(place, abs=2e-5)
    assert result.chi_square == pytest.approx(cost, abs=1e-2)
    ((found_low, found_high),) = estimate.interval_95
    # Gauss-Newton's interval of a prior of the logarithm is bent by a share of the spread.
    assert (found_low, found_high) == pytest.approx((low, high), abs=1e-4)
    assert estimate.at_bound == (kind == "uniform")


ANGLES = np.radians(np.arange(50.0, 78.0, 0.01))


@pytest.fixture(scope="module")
def table():
    """Lambertian reflectance factors on a grid of angles, from the model directly, shape (A, 15)."""
    view = vc.View(FAN, 0 * FAN)

    def factors(angle):
        scene = vc.Scene(vc.VGrooves(angle), vc.Lambertian(RED), vc.Diffuse(), view)
        return vc.reflectance_factor(scene, smallest_angle=np.radians(30.0)).ravel()

    return np.asarray(jax.jit(lambda a: jax.lax.map(factors, a, batch_size=32))(ANGLES))


@pytest.mark.parametrize("kind", ALL_PRIORS)
def test_a_prior_of_a_gain_beside_an_angle(kind, table):
    """The gain is eliminated in the search and in the profile of the angle, and must obey its prior there."""
    prior, penalty = ALL_PRIORS[kind]
    scene = grooves(63, vc.Lambertian(RED))
    m = measured(1.01 * exact(scene).reflectance_factor)
    result = fit(scene, m, [free.angle(30, 170), free.gain(prior)])
    scaled, wanted = table / 0.005, m.reflectance_factor.ravel() / 0.005
    squares, products = np.sum(scaled**2, axis=1), scaled @ wanted
    cost = squares[:, None] * GAINS**2 - 2 * products[:, None] * GAINS + wanted @ wanted + penalty(GAINS)
    for name, places, profile in (("angle", ANGLES, cost.min(axis=1)), ("gain", GAINS, cost.min(axis=0))):
        place, lowest, low, high = brute(profile)(places)
        step = places[1] - places[0]
        estimate = result.estimates[name]
        assert result.chi_square == pytest.approx(lowest, abs=2e-3)
        assert estimate.value == pytest.approx(place, abs=2 * step)
        ((found_low, found_high),) = estimate.interval_95
        assert (found_low, found_high) == pytest.approx((low, high), abs=2 * step + 1e-4)


@pytest.mark.parametrize(
    ("prior", "penalty"),
    [
        ((66, 0.5), lambda d: ((d - 66) / 0.5) ** 2),
        (priors.LogNormal(60, 0.01), lambda d: (np.log(d / 60) / 0.01) ** 2),
        (
            priors.TruncatedNormal(70, 2, 60, 62),
            lambda d: np.where((d >= 60) & (d <= 62), ((d - 70) / 2) ** 2, 1e9),
        ),
        (priors.Uniform(64, 70), lambda d: np.where((d >= 64) & (d <= 70), 0, 1e9)),
    ],
)
def test_a_prior_of_the_angle(prior, penalty, table):
    scene = grooves(63, vc.Lambertian(RED))
    m = exact(scene, sigma=0.01)
    result = fit(scene, m, [free.angle(30, 170, prior)])
    residuals = (table - m.reflectance_factor.ravel()) / 0.01
    place, lowest, low, high = brute(np.sum(residuals**2, axis=1) + penalty(np.degrees(ANGLES)))(ANGLES)
    estimate = result.estimates["angle"]
    step = np.radians(0.01)
    assert estimate.value == pytest.approx(place, abs=1.1 * step)
    assert result.chi_square == pytest.approx(lowest, abs=2e-2)
    ((found_low, found_high),) = estimate.interval_95
    assert (found_low, found_high) == pytest.approx((low, high), abs=1.1 * step)
    assert abs(place - np.radians(63)) > 5 * step


def test_a_prior_of_a_spectrum():
    """A share of the scene's own: each wavelength by itself, on a grid of reflectances."""
    grid = np.linspace(0, 1, 2001)
    model = np.asarray(vc.reflectance_factor(seen(grooves(70, vc.Lambertian(grid)))))
    m = exact(grooves(70, vc.Lambertian(RED)), sigma=0.02)
    values = m.reflectance_factor.copy()
    values[:, 1] = np.nan
    gappy = measured(values, sigma=0.02)
    own = np.array([0.12, 0.2, 0.2, 0.5, 0.9])
    result = fit(grooves(70, vc.Lambertian(own)), gappy, [free.reflectance(prior=0.15)])
    cost = np.nansum(((model[:, None, :] - values[:, :, None]) / 0.02) ** 2, axis=0)
    cost = cost + ((grid - own[:, None]) / (0.15 * own[:, None])) ** 2
    np.testing.assert_allclose(result.estimates["reflectance"].value, grid[cost.argmin(axis=1)], atol=3e-4)
    assert result.chi_square == pytest.approx(cost.min(axis=1).sum(), abs=0.02)
    assert result.estimates["reflectance"].value[1] == pytest.approx(0.2)  # Nothing but the prior,
    assert result.estimates["reflectance"].standard_error[1] == pytest.approx(0.03)  # and as wide.
    assert result.degrees_of_freedom == 12


@pytest.mark.slow
def test_a_prior_around_a_complex_index():
    """A share of its modulus, of n and of k alike; where nothing is measured both keep the prior."""
    index = np.array([1.46 + 1.95j, 0.97 + 1.87j, 0.4 + 2.6j, 0.25 + 2.9j, 0.17 + 3.2j])
    m = exact(grooves(70, vc.Specular(index)))
    values = m.reflectance_factor.copy()
    values[:, 3] = np.nan
    result = fit(
        grooves(70, vc.Specular(index)), measured(values), [free.index_spectrum(complex_valued=True, prior=0.03)]
    )
    n, k = result.estimates["n"], result.estimates["k"]
    assert (n.value[3], k.value[3]) == pytest.approx((0.25, 2.9))
    assert (n.standard_error[3], k.standard_error[3]) == pytest.approx((0.03 * abs(index[3]),) * 2)
    assert (n.standard_error[[0, 1, 2, 4]] < 0.03 * np.abs(index)[[0, 1, 2, 4]]).all()


# Several measurements in one fit.


@pytest.mark.parametrize("known_angle", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_two_lights_share_the_sample_but_not_the_gain(known_angle):
    white, lamp = (
        grooves(83, vc.Lambertian(RED)),
        grooves(83, vc.Lambertian(RED), vc.Directional(np.radians(60.0))),
    )
    polar = np.radians([-70.0, 0.0, 30.0])
    values = [gain * exact(s, polar=polar).reflectance_factor for gain, s in ((1.03, white), (0.96, lamp))]
    both = {"diffuse": measured(values[0], white, polar=polar), "lamp": measured(values[1], lamp, polar=polar)}
    start = grooves(83 if known_angle else 70, vc.Lambertian(np.full(5, 0.4)))
    angle = [] if known_angle else [free.angle(30, 170)]
    result = fit(start, both, [*angle, free.reflectance(), free.gain(None).separate()])
    assert result.labels == ("diffuse", "lamp")
    names = ["gain[diffuse]", "gain[lamp]", "reflectance"]
    assert list(result.estimates) == names if known_angle else ["angle", *names]
    for name, truth in zip(
        result.estimates, [*([] if known_angle else [np.radians(83)]), 1.03, 0.96, RED], strict=True
    ):
        np.testing.assert_allclose(result.estimates[name].value, truth, rtol=1e-5)
    assert result.degrees_of_freedom == 30 - 7 - len(angle)
    assert [type(s.illumination).__name__ for s in result.scenes] == ["Diffuse", "Directional"]
    assert np.abs(result.misfits[1]).max() < 1e-6


def test_different_wavelengths_share_a_spectrum_on_all_of_them():
    """Two instruments, the second one with an offset of its own; each wavelength counts where it was measured."""
    first, second = BAND[:3], BAND[1:]
    scenes = [grooves(70, vc.Lambertian(r)) for r in (RED[:3], RED[1:])]
    measurements = [exact(s, nm) for s, nm in zip(scenes, (first, second), strict=True)]
    second_values = measurements[1].reflectance_factor + 0.01
    measurements[1] = measured(second_values, None, second)
    starts = [grooves(70, vc.Lambertian(np.full(n, 0.5))) for n in (3, 4)]
    result = fit(starts, measurements, [free.reflectance(), free.offset(None).only("1")])
    assert list(result.estimates) == ["offset[1]", "reflectance"]
    spectrum = result.estimates["reflectance"]
    np.testing.assert_array_equal(spectrum.wavelengths_nm, BAND)
    np.testing.assert_allclose(spectrum.value, RED, rtol=1e-6)
    assert result.estimates["offset[1]"].value == pytest.approx(0.01, abs=1e-8)
    assert result.degrees_of_freedom == 9 + 12 - 5 - 1
    np.testing.assert_allclose(result.scenes[0].material.reflectance, RED[:3], rtol=1e-6)
    np.testing.assert_allclose(result.scenes[1].material.reflectance, RED[1:], rtol=1e-6)
    # For a known offset two instruments halve the variance, exactly.
    known = [free.reflectance(), free.offset((0.01, 1e-9)).only("1")]
    errors = fit(starts, measurements, known).estimates["reflectance"].standard_error
    gap = measurements[0].reflectance_factor.copy()
    gap[:, 1:] = np.nan
    once = fit(starts, [measured(gap, None, first), measurements[1]], known)
    ratio = errors / once.estimates["reflectance"].standard_error
    np.testing.assert_allclose(ratio, [1, np.sqrt(0.5), np.sqrt(0.5), 1, 1], rtol=1e-6)


def test_two_samples_share_an_angle_but_not_the_spectrum():
    spectra = {"red": RED, "blue": RED[::-1] * 0.9}
    both = {name: exact(grooves(77, vc.Lambertian(r))) for name, r in spectra.items()}
    start = {name: grooves(60, vc.Lambertian(np.full(5, 0.5))) for name in spectra}
    result = fit(start, both, [free.angle(30, 170), free.reflectance().separate()])
    assert list(result.estimates) == ["angle", "reflectance[red]", "reflectance[blue]"]
    assert np.degrees(result.estimates["angle"].value) == pytest.approx(77, abs=1e-5)
    for name, truth in spectra.items():
        np.testing.assert_allclose(result.estimates[f"reflectance[{name}]"].value, truth, rtol=1e-5)
    assert result.degrees_of_freedom == 30 - 11


# Refusals.

MATTE = grooves(70, vc.Lambertian(RED))
GOOD = measured(np.full((3, 5), 0.3))
SILENT = Measurement(BAND, FAN, 0 * FAN, np.full((3, 5), 0.3))
RING = vc.Scene(MATTE.surface, MATTE.material, vc.Annular(0.7), vc.View())


@pytest.mark.parametrize(
    ("scene", "measurement", "parameters", "message"),
    [
        (MATTE, GOOD, [free.reflectance(), free.wavelength_shift()], "stand for each other; expected one of them"),
        (RING, measured(np.full((3, 5), 0.3), RING), [free.tilt()], "a tilt is not modeled in Annular light"),
        (MATTE, [GOOD, GOOD], [free.gain().only("2")], "'gain' is for measurement 2; expected some of 0, 1"),
        (MATTE, [GOOD, GOOD], [free.gain().only()], "'gain' is for measurement none; expected some of 0, 1"),
        (MATTE, [GOOD, SILENT], [free.angle()], "some measurements state an uncertainty and some do not"),
        (
            MATTE,
            GOOD,
            [free.angle(), free.index(), free.roughness(), free.coverage()],
            "4 parameters are searched .angle, index, roughness, coverage.; expected at most 3",
        ),
        (MATTE, {"a": GOOD, "b": GOOD}, [free.angle(), free.angle().only("a")], "angle.* the same number"),
        ([MATTE] * 2, [GOOD] * 2, [p.separate() for p in [free.angle()] * 1] * 2, "'angle.0.' is given twice"),
        ([MATTE], [GOOD, GOOD], [free.angle()], "1 scenes and 2 measurements; expected one scene for each"),
        ([MATTE, MATTE], GOOD, [free.angle()], "one measurement and a list of scenes; expected one Scene"),
        ({"a": MATTE}, {"b": GOOD}, [free.angle()], "scenes .'a'., measurements .'b'.; expected the same"),
        (MATTE, [], [free.angle()], "0 measurements; expected one scene for each"),
        (MATTE, 3, [free.angle()], "int is not a Measurement"),
        (MATTE, [GOOD, 3], [free.angle()], "expected a Scene for every Measurement"),
        (MATTE, GOOD, [free.angle(), free.tilt(), free.tilt()[0]], "'tilt_across' is given twice"),
        (MATTE, GOOD, ["angle"], "parameters are not a list"),
        (MATTE, GOOD, [free.transmittance()], "its place is not in this scene of VGrooves and Lambertian"),
        (
            grooves(70, vc.Specular(1.5 + 2j)),
            GOOD,
            [free.index_spectrum()],
            "holds complex numbers; expected n and k to be free",
        ),
        (
            grooves(70, vc.InterfacedLambertian(RED, 1.5)),
            GOOD,
            [free.index_spectrum(complex_valued=True)],
            "an interface is clear",
        ),
        (
            MATTE,
            measured(np.full((3, 5), 0.3), sigma=0.01),
            [free.reflectance(), *(free.parameter(f"p{i}", first_side, 0, 1, start=0.5) for i in range(2))],
            "its place is not in this scene",
        ),
        (MATTE, GOOD, [free.wavelength_shift(120)], "the measurement holds no value"),
    ],
)
def test_refusals(scene, measurement, parameters, message):
    with pytest.raises(ValueError, match=message) as caught:
        fit(scene, measurement, parameters)
    assert "\n" not in str(caught.value)
