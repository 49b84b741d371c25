"""Designs of known answer, of none, and of limits; sensitivities against differences; every refusal."""

import json
import re

import numpy as np
import pytest

import vcavity_jax as vc
from fitting import design, free, target
from vcavity_jax import colorimetry

NM = np.arange(400.0, 701.0, 20.0)
ORANGE = 0.08 + 0.55 / (1 + np.exp(-(NM - 570) / 15))
MATTE = vc.Lambertian(ORANGE)
FRONT, SIDE = target.Look(), target.Look(polar=1.1)
WHITE = colorimetry.white(NM)


def grooves(degrees, material=MATTE, polar=0.0):
    return vc.Scene(vc.VGrooves(np.radians(degrees)), material, vc.Diffuse(), vc.View(polar, 0.0))


def lab_of(scene):
    return np.asarray(colorimetry.lab(colorimetry.xyz(vc.reflectance_factor(scene), NM), WHITE))


def designed(targets, parameters=None, scene=None, **options):
    parameters = [free.angle(30, 170)] if parameters is None else parameters
    return design(scene or grooves(90), parameters, targets, wavelengths_nm=NM, **options)


def test_the_angle_of_a_color_is_found():
    found = designed(target.color(lab_of(grooves(72))))
    assert found.met
    assert np.degrees(found.best.values["angle"]) == pytest.approx(72, abs=1e-5)
    np.testing.assert_allclose(lab_of(found.best.scene)[0], lab_of(grooves(72)), atol=1e-5)
    assert found.best.reached[0] < 1e-5
    assert len(found.solutions) == 1
    # How precisely it must be made.
    step = 1e-3
    off = colorimetry.delta_e_2000(lab_of(grooves(72)), lab_of(grooves(72 + step)))
    assert np.degrees(found.tolerances["angle"]) == pytest.approx(step / float(off), rel=1e-3)


def test_a_color_out_of_reach_is_told_with_what_binds():
    found = designed(target.color(lab_of(grooves(40))), [free.angle(80, 120)])
    assert not found.met
    assert found.best.at_bound == ("angle",)
    assert found.best.reached[0] == pytest.approx(
        float(colorimetry.delta_e_2000(lab_of(grooves(40)), lab_of(grooves(80)))), rel=1e-6
    )
    assert re.match(r"not met: Lab .* \(ΔE00 [\d.]+\); angle at a bound of its range", found.message)
    assert "MISSED" in found.summary()
    green = designed(target.color((60, -60, 40)))
    assert green.message.endswith("no bound binds") or "at a bound" in green.message


def test_a_spectrum_is_matched():
    truth = np.asarray(vc.reflectance_factor(grooves(65)))
    found = designed(target.spectrum(truth))
    assert np.degrees(found.best.values["angle"]) == pytest.approx(65, abs=1e-4)
    assert found.best.reached[0] < 1e-6


def test_a_roughness_and_a_gray_together():
    scene = vc.Scene(vc.BeckmannGrooves(0.5), vc.Lambertian(0.5), vc.Diffuse(), vc.View())
    parameters = [free.roughness(0.1, 1.5), free.parameter("gray", lambda s: s.material.reflectance, 0.0, 1.0)]
    known = vc.Scene(vc.BeckmannGrooves(0.8), vc.Lambertian(0.6), vc.Diffuse(), vc.View(np.array([0.0, 1.2]), 0.0))
    bright = np.asarray(vc.reflectance_factor(known))[:, None] * np.ones(len(NM))
    targets = [target.spectrum(bright[0]), target.spectrum(bright[1], target.Look(1.2))]
    found = designed(targets, parameters, scene, tolerance=1e-8)
    assert found.best.values["roughness"] == pytest.approx(0.8, abs=1e-3)
    assert found.best.values["gray"] == pytest.approx(0.6, abs=1e-3)


def test_limits_are_kept():
    """The color of a flat sheet from the front, and another one from the side, or the same."""
    between = [
        colorimetry.delta_e_2000(lab_of(grooves(a)), lab_of(grooves(a, polar=1.1))) for a in (50, 80, 110, 140)
    ]
    least = 0.8 * float(max(between))
    found = designed([target.color(lab_of(grooves(150)), step=5.0), target.different(FRONT, SIDE, least=least)])
    assert found.best.reached[1] == pytest.approx(least, abs=0.05)  # No more than it must: the color pulls back.
    assert found.best.reached[0] > 0
    alike = designed([target.color(lab_of(grooves(60)), step=5.0), target.alike(FRONT, SIDE, most=1.0)])
    assert alike.best.reached[1] <= 1.05


def test_a_limit_does_not_keep_the_colors_from_being_met():
    """Two panels, two colors, and a difference that these colors have anyhow."""
    gray = np.full(len(NM), 0.4)
    panels = vc.TwoPanels(vc.Lambertian(gray), vc.Lambertian(gray))
    left, right = target.Look(0.9), target.Look(-0.9)
    blue, orange = (52.0, -10.0, -32.0), (62.0, 25.0, 40.0)
    least = 0.9 * float(colorimetry.delta_e_2000(np.array(blue), np.array(orange)))
    parameters = [
        free.angle(60, 130),
        free.reflectance(where=lambda s: s.material.first.reflectance, name="first", smooth_nm=60),
        free.reflectance(where=lambda s: s.material.second.reflectance, name="second", smooth_nm=60),
    ]
    wishes = [target.color(blue, left), target.color(orange, right), target.different(left, right, least=least)]
    found = designed(wishes, parameters, grooves(90, panels), starts=4)
    assert found.met
    assert max(found.best.reached[:2]) < 0.01
    # Smooth spectra are shown as such; their coefficients mean nothing.
    assert set(found.best.values) == set(found.tolerances) == {"angle"}
    assert set(found.best.spectra) == {"first", "second"}
    material = found.best.scene.material
    np.testing.assert_allclose(found.best.spectra["first"], material.first.reflectance, atol=1e-12)
    assert np.abs(np.diff(found.best.spectra["second"])).max() < 0.2  # The plainest that serves.
    assert "first 0." in found.summary()


def test_a_metamer_under_another_light():
    """A free smooth reflectance has the color in D65, and not in A."""
    flat = grooves(180)
    look, lamp = target.Look(), target.Look(illuminant="A")
    wish = lab_of(grooves(180, vc.Lambertian(np.full(len(NM), 0.3))))
    gray_in_a = np.asarray(
        colorimetry.lab(colorimetry.xyz(np.full(len(NM), 0.3), NM, "A"), colorimetry.white(NM, "A"))
    )
    shifted = gray_in_a + np.array([0.0, 6.0, 0.0])
    found = designed([target.color(wish, look), target.color(shifted, lamp)], [free.reflectance()], flat, starts=4)
    assert found.met
    assert max(found.best.reached) < 0.5
    assert set(found.best.spectra) == {"reflectance"}
    assert ((found.best.spectra["reflectance"] >= 0) & (found.best.spectra["reflectance"] <= 1)).all()


def test_lights_are_told_apart():
    lamp = vc.Directional(np.radians(40.0), 0.0)
    scene = vc.Scene(vc.VGrooves(1.3), MATTE, lamp, vc.View(0.2, 0.0))
    wish = [target.color(lab_of(grooves(70))), target.color(lab_of(scene), target.Look(0.2, illumination=lamp))]
    found = designed(wish, scene=grooves(90), starts=4)
    assert isinstance(found.best.scene.illumination, vc.Diffuse)
    assert found.best.reached[0] < 5


def test_text_and_json(tmp_path):
    found = designed(target.color(lab_of(grooves(72)), name="the label"))
    text = found.summary()
    assert "the label: ΔE00" in text
    assert "for a color change below 1: angle ± " in text
    assert text.endswith("every target is met.")
    found.to_json(tmp_path / "design.json")
    told = json.loads((tmp_path / "design.json").read_text())
    assert told["solutions"][0]["parameters"]["angle"] == pytest.approx(72, abs=1e-3)
    assert told["units"]["angle"] == "deg"
    assert told["met"]


def test_the_same_seed_gives_the_same_design():
    wish = target.color(lab_of(grooves(72)))
    assert designed(wish, seed=3).best.values == designed(wish, seed=3).best.values


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: target.color((50, 60)), r"lab is \(50, 60\); expected L\* from 0 to 100, a\* and b\*"),
        (lambda: target.color((150, 0, 0)), r"expected L\* from 0 to 100"),
        (lambda: target.color((50, 0, 0), step=0), "step is 0; expected a positive number"),
        (lambda: target.spectrum(50 * ORANGE), "reaches .*; expected fractions: are these percent"),
        (lambda: target.spectrum(0.5), r"has shape \(\); expected finite numbers in one axis"),
        (lambda: target.different(FRONT, SIDE, least=-1), "least is -1; expected a positive number"),
        (
            lambda: target.Look(polar=45.0),
            "polar is 45; expected between -π/2 and π/2 radians: did you pass degrees",
        ),
        (lambda: target.Look(illuminant="D93"), "illuminant is 'D93'; expected one of A, C, D50"),
        (lambda: target.Look(illumination="sun"), "illumination is a str; expected a light"),
    ],
)
def test_bad_targets(make, said):
    with pytest.raises(ValueError, match=said):
        make()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"scene": 3}, "scene is a int; expected a Scene"),
        ({"targets": []}, "targets: expected one or more of fitting.target"),
        ({"free": []}, "no parameter is free; expected at least one"),
        ({"free": [free.angle(), free.gain()]}, "parameter 'gain' belongs to an instrument"),
        ({"starts": 0}, "starts is 0; expected a whole number of at least 1"),
        ({"targets": target.spectrum(np.ones(5))}, "has 5 values; expected one for each of 16 wavelengths"),
        ({"wavelengths_nm": np.linspace(450, 650, 16)}, "450 to 650 nm do not cover 400 to 700 nm"),
        ({"free": [free.roughness()]}, "parameter 'roughness': its place is not in this scene"),
    ],
)
def test_bad_designs(change, said):
    given = {
        "scene": grooves(90),
        "free": [free.angle()],
        "targets": target.color((50, 0, 0)),
        "wavelengths_nm": NM,
    }
    with pytest.raises(ValueError, match=said) as caught:
        design(**(given | change))
    assert "\n" not in str(caught.value)


def test_coverages_and_transmittances_are_found():
    """A halftone under an interface, and a colored layer."""
    ink = 0.1 + 0.8 / (1 + np.exp((NM - 560) / 20))

    def printed(layer):
        material = vc.InterfacedLambertian(np.full(len(NM), 0.85), 1.5, layer)
        return vc.Scene(vc.VGrooves(np.radians(80)), material, vc.Diffuse(), vc.View())

    wish = target.color(lab_of(printed(vc.Halftone(0.37, ink))))
    found = designed(wish, [free.coverage()], printed(vc.Halftone(0.5, ink)), starts=4)
    assert found.best.values["coverage"] == pytest.approx(0.37, abs=1e-4)
    layer = vc.ColoredLayer(np.full(len(NM), 0.5))
    wish = target.spectrum(np.asarray(vc.reflectance_factor(printed(vc.ColoredLayer(ink)))), step=0.001)
    found = designed(wish, [free.transmittance()], printed(layer), starts=2)
    np.testing.assert_allclose(found.best.spectra["transmittance"], ink, atol=2e-4)


def test_both_panels_are_found_from_two_sides():
    first, second = 0.2 + 0.5 * (NM > 550), 0.6 - 0.4 * (NM > 600)

    def two(r1, r2):
        return vc.Scene(vc.VGrooves(1.2), vc.TwoPanels(vc.Lambertian(r1), vc.Lambertian(r2)), vc.Diffuse(), view)

    view = vc.View(np.array([0.9, -0.9]), 0.0)
    left, right = np.asarray(vc.reflectance_factor(two(first, second)))
    parameters = [
        free.reflectance(where=lambda s: s.material.first.reflectance, name="first"),
        free.reflectance(where=lambda s: s.material.second.reflectance, name="second"),
    ]
    wish = [
        target.spectrum(left, target.Look(0.9), step=0.001),
        target.spectrum(right, target.Look(-0.9), step=0.001),
    ]
    found = designed(wish, parameters, two(np.full(len(NM), 0.5), np.full(len(NM), 0.5)), starts=2)
    np.testing.assert_allclose(found.best.spectra["first"], first, atol=1e-4)
    np.testing.assert_allclose(found.best.spectra["second"], second, atol=1e-4)
