"""Every warning about blind directions: scenes that trigger it, with the number to act on, and near misses."""

import numpy as np
import pytest

import vcavity_jax as vc
from fitting import Estimate, Measurement, assembly, fit, free, refit_with_rival
from fitting.blind_spots import blind_spots

BAND = np.array([450.0, 550.0, 650.0])
RED = np.array([0.1, 0.4, 0.7])
GOLD = np.array([1.46 + 1.95j, 0.4 + 2.6j, 0.17 + 3.2j])
MATTE, MIRROR = vc.Lambertian(RED), vc.Specular(GOLD)
ANGLE, REFLECTANCE = free.angle(), free.reflectance()
INDEX = free.index_spectrum(complex_valued=True)


def seen(directions, values=None):
    """A measurement in directions of (polar, azimuth), degrees."""
    polar, azimuth = np.radians(np.array(directions, dtype=float)).T
    values = np.full((len(polar), len(BAND)), 0.3) if values is None else values
    return Measurement(BAND, polar, azimuth, values, np.full(values.shape, 0.005))


def across(*polar_deg):
    return [(polar, 0) for polar in polar_deg]


def said(material, directions, parameters, surface=None, value=None, error=0.001):
    """The warnings if the fit ends at an angle in radians or a roughness; nothing is fitted."""
    m = seen(directions)
    surface = surface or vc.VGrooves(np.radians(60.0))
    built = assembly.build(vc.Scene(surface, material, vc.Diffuse(), m.view), m, parameters, None, 1e-3)
    value = np.radians(60.0) if value is None else value
    name = built.numbers[0].name
    return blind_spots(built, {name: Estimate(value, error, [(value - error, value + error)])})


def only(warnings, *words):
    """There is one warning, and it has these words."""
    assert len(warnings) == 1, warnings
    assert all(word in warnings[0] for word in words), warnings


@pytest.mark.parametrize("half_deg", [22.0, 47.0, 60.0])
@pytest.mark.parametrize("azimuth_deg", [0.0, 60.0])
def test_an_unknown_reflectance_needs_a_direction_beyond_half_the_angle(half_deg, azimuth_deg):
    """The farthest direction just within half the angle, and just beyond: tan θ' = tan θ cos φ."""

    def farthest(section_deg):
        slant = np.tan(np.radians(section_deg)) / np.cos(np.radians(azimuth_deg))
        return [(0, 0), (np.degrees(np.arctan(slant)), azimuth_deg)]

    value = np.radians(2 * half_deg)
    blind = said(MATTE, farthest(half_deg - 1), [ANGLE, REFLECTANCE], value=value)
    only(blind, f"add one beyond {half_deg:.0f} degrees across the grooves", "not identifiable")
    assert said(MATTE, farthest(half_deg + 1), [ANGLE, REFLECTANCE], value=value) == []
    # The spread of the angle counts, and a known reflectance needs nothing.
    wide = said(MATTE, farthest(half_deg + 1), [ANGLE, REFLECTANCE], value=value, error=np.radians(2))
    only(wide, f"beyond {half_deg:.0f} degrees")
    assert said(MATTE, farthest(half_deg - 1), [ANGLE], value=value) == []


def test_nothing_is_beyond_a_nearly_flat_surface():
    only(said(MATTE, across(0, 80), [ANGLE, REFLECTANCE], value=np.radians(176)), "as grazing as you can")


def test_directions_along_the_grooves():
    along = [(0, 0), (40, 90), (75, 90)]
    only(said(MATTE, along, [ANGLE]), "along the grooves", "add directions across them")
    assert said(MATTE, [*along, (10, 80)], [ANGLE]) == []
    assert said(MATTE, [(0, 0)], [ANGLE]) == []  # One frontal view is just one view.
    assert said(MATTE, along, [REFLECTANCE, free.gain()]) == []  # The angle is known.


def test_no_direction_within_half_the_angle():
    only(said(MATTE, across(40, 75), [ANGLE, REFLECTANCE]), "within half the angle", "30 degrees", "frontal view")
    assert said(MATTE, across(20, 75), [ANGLE, REFLECTANCE]) == []


@pytest.mark.parametrize(
    ("material", "directions", "unknown", "missing"),
    [
        (MATTE, across(50, -50), REFLECTANCE, 1),  # The same by symmetry.
        (MATTE, across(0, 50), REFLECTANCE, 0),
        (MIRROR, across(0), free.index_spectrum(complex_valued=True, prior=0.03), 2),
        (MIRROR, across(0, 60, -60), INDEX, 1),
        (MIRROR, across(0, 30, 60), INDEX, 0),
        (MIRROR, [(0, 0), (60, 0), (60, 90)], INDEX, 0),
    ],
)
def test_directions_are_counted_against_unknowns(material, directions, unknown, missing):
    words = [w for w in said(material, directions, [ANGLE, unknown]) if "unknowns" in w]
    assert len(words) == bool(missing)
    assert all(f"add at least {missing}" in word and "75 degrees" in word for word in words)


@pytest.mark.parametrize("loose", [[free.gain(None)], [free.offset(None)], [free.gain(None), free.offset(None)]])
def test_a_free_calibration_needs_two_directions_beyond_half_the_angle(loose):
    parameters = [ANGLE, REFLECTANCE, *loose]
    only(said(MATTE, across(0, 20, 60), parameters), "at least 2", "30 degrees", "there is 1", loose[0].name)
    assert said(MATTE, across(0, 50, 70), parameters) == []
    assert said(MATTE, across(0, 20, 60), [ANGLE, REFLECTANCE, free.gain(), free.offset()]) == []


@pytest.mark.parametrize(
    ("degrees", "directions", "blind"),
    [
        (130, across(0, 25), True),
        (130, [(0, 0), (70, 85)], True),  # θ' is 13 degrees.
        (130, across(0, 35), False),
        (118, across(0, 25), False),
    ],
)
def test_a_wide_mirror_is_blind_near_the_normal(degrees, directions, blind):
    words = said(MIRROR, directions, [ANGLE], value=np.radians(degrees))
    if blind:
        only(words, "blind", "75 degrees across the grooves")
    else:
        assert words == []
    assert said(MATTE, directions, [ANGLE], value=np.radians(degrees)) == []


def test_a_tilt_wants_both_signs():
    tilted = [ANGLE, *free.tilt()]
    only(said(MIRROR, across(0, 40, 60, -60), tilted), "measure +θ and -θ", "add -40 degrees")
    assert said(MIRROR, across(0, 60, -60), tilted) == []
    assert said(MIRROR, [(0, 0), (60, 0), (60, 180)], tilted) == []
    assert said(MIRROR, across(0, 40, 60), [ANGLE]) == []


@pytest.mark.parametrize(
    ("surface", "material", "directions", "limit"),
    [
        (vc.BeckmannGrooves, MATTE, across(0, 75), 0.1),
        (vc.BeckmannGrooves, MIRROR, across(0), 0.2),
        (vc.GaussianGrooves, MATTE, across(0, 75), 0.14),
        (vc.GaussianGrooves, MIRROR, across(0), 0.24),
    ],
)
def test_a_slight_roughness_has_only_an_upper_limit(surface, material, directions, limit):
    def of(value):
        return said(material, directions, [free.roughness()], surface(0.5), value)

    only(of(limit - 0.01), f"below {limit}", "upper end as a limit")
    assert of(limit + 0.01) == []


# What the data say, not the directions: real fits, few programs.


def grooves(degrees, material):
    return vc.Scene(vc.VGrooves(np.radians(degrees)), material, vc.Diffuse(), vc.View())


def fitted(degrees, material, directions, parameters, factor=1.0):
    m = seen(directions)
    true = vc.reflectance_factor(vc.Scene(vc.VGrooves(np.radians(degrees)), material, vc.Diffuse(), m.view))
    return fit(grooves(50, material), seen(directions, factor * np.asarray(true)), parameters)


def test_several_minima_and_kinks_are_told():
    """One view of a dielectric has several minima, a matte fan one; a mirror of 90 degrees lies on a kink."""
    glass = vc.Specular(np.full(3, 3.0 + 0j))
    alone = fitted(75, glass, across(60), [free.angle(30, 170)])
    listed = [f"{np.degrees(minimum.values['angle']):.4g}" for minimum in alone.minima]
    assert len(listed) > 1
    (words,) = (w for w in alone.warnings if "distinct minima" in w)
    assert f"{len(listed)} distinct minima" in words
    assert all(number in words for number in listed)
    fan = fitted(80, MATTE, across(0, 75), [free.angle(30, 170)])
    assert len(fan.minima) == 1
    assert not any("distinct minima" in w or "kink" in w for w in fan.warnings)
    kink = fitted(90, glass, across(0, 30, 60), [free.angle(30, 170)])
    assert kink.estimates["angle"].at_kink
    assert any("angle lies at a kink" in w and "95 % interval" in w for w in kink.warnings)


def test_parameters_that_are_hardly_told_apart():
    """A single color: gain and angle do the same to it."""
    gray = vc.Lambertian(np.full(3, 0.4))
    weak = fitted(60, gray, across(0), [free.angle(30, 170), free.gain(None)])
    assert any("cannot be told apart" in w or "hardly told apart" in w for w in weak.warnings)
    strong = fitted(60, MATTE, across(0, 75), [free.angle(30, 170), free.gain(None)])
    assert not any("told apart" in w for w in strong.warnings)
    assert not any("not determined" in w for w in strong.warnings)


def test_what_energy_forbids():
    good = fitted(80, MATTE, across(0, 75), [free.angle(30, 170), free.gain(None)])
    assert not any("outside 0 to 1" in w for w in good.warnings)
    bright = fitted(80, MATTE, across(0, 75), [free.angle(30, 170), free.gain(None)], factor=1.8)
    (words,) = (w for w in bright.warnings if "outside 0 to 1" in w)
    assert "check the calibration" in words


@pytest.mark.slow
def test_a_rival_model_is_refused_by_the_data_or_not():
    """A matte fan is not varnished; a mirror can be seen without its polarization."""
    result = fitted(80, MATTE, across(0, 40, 75), [free.angle(30, 170)])
    assert not any("cannot be tested" in w for w in result.warnings)
    rival = refit_with_rival(result)
    assert isinstance(rival.result.scene.material, vc.InterfacedLambertian)
    assert rival.chi_square_rise > 20
    assert rival.shifts["angle"] == pytest.approx(
        rival.result.estimates["angle"].value - result.estimates["angle"].value
    )
    assert "the data speak for the first" in rival.summary()
    mirror = fitted(80, MIRROR, across(0), [free.angle(30, 120)])
    assert "angle" in refit_with_rival(mirror).summary()
