"""Reachable colors: equal to the model itself, in order, drawn, written, and every refusal."""

import csv

import numpy as np
import pytest

import vcavity_jax as vc
from fitting import free, reachable_colors, target
from vcavity_jax import colorimetry

NM = np.arange(400.0, 701.0, 20.0)
ORANGE = 0.08 + 0.55 / (1 + np.exp(-(NM - 570) / 15))
LOOKS = (
    target.Look(),
    target.Look(0.8, illumination=vc.Directional(0.3, 0.0), illuminant="A", observer="CIE 1964"),
)
SCENE = vc.Scene(vc.VGrooves(1.0), vc.Lambertian(ORANGE), vc.Diffuse(), vc.View())


@pytest.fixture(scope="module")
def colors():
    return reachable_colors(SCENE, LOOKS, free.angle(30, 180), wavelengths_nm=NM, count=6, tolerance=1e-9)


def test_they_are_the_models_own(colors):
    np.testing.assert_allclose(colors.shown, np.linspace(30, 180, 6))
    for k, look in enumerate(LOOKS):
        light = vc.Diffuse() if look.illumination is None else look.illumination
        for p, angle in enumerate(colors.values):
            scene = vc.Scene(vc.VGrooves(angle), vc.Lambertian(ORANGE), light, vc.View(look.polar, 0.0))
            factor = vc.reflectance_factor(scene)
            np.testing.assert_allclose(colors.reflectance_factor[k, p], factor, atol=1e-8)
            given = look.illuminant, look.observer
            lab = colorimetry.lab(colorimetry.xyz(factor, NM, *given), colorimetry.white(NM, *given))
            np.testing.assert_allclose(colors.lab[k, p], lab, atol=1e-5)
    assert colors.srgb.shape == (2, 6, 3)
    assert (colors.srgb >= 0).all()
    assert (colors.srgb <= 1).all()


def test_the_flat_end_is_the_flat_material(colors):
    np.testing.assert_allclose(colors.reflectance_factor[0, -1], ORANGE, atol=1e-9)


def test_the_nearest_of_them(colors):
    value, off = colors.nearest(colors.lab[1, 2], look=1)
    assert value == colors.values[2]
    assert off < 1e-6


def test_a_roughness_goes_by_its_logarithm():
    scene = vc.Scene(vc.BeckmannGrooves(0.3), vc.Specular(1.5), vc.Diffuse(), vc.View())
    found = reachable_colors(scene, None, free.roughness(0.1, 1.0), wavelengths_nm=NM, count=3, tolerance=1e-4)
    np.testing.assert_allclose(found.values, [0.1, np.sqrt(0.1), 1.0])
    assert found.unit == "1"


def test_files(colors, tmp_path):
    colors.plot(tmp_path / "colors.png")
    assert (tmp_path / "colors.png").stat().st_size > 10_000
    colors.to_csv(tmp_path / "colors.csv")
    rows = list(csv.DictReader((tmp_path / "colors.csv").read_text().splitlines()))
    assert len(rows) == 12
    assert rows[6]["look"] == LOOKS[1].description == "45.8366 deg, A, light from 17.1887 deg"
    assert float(rows[8]["L*"]) == pytest.approx(colors.lab[1, 2, 0])
    assert float(rows[8]["angle_deg"]) == pytest.approx(90)
    with pytest.raises(ValueError, match=r"expected \.png, \.pdf or \.svg"):
        colors.plot(tmp_path / "colors.txt")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"scene": 1}, "scene is a int; expected a Scene"),
        ({"parameter": free.reflectance()}, "parameter is a SpectralParameter; expected one number of the scene"),
        ({"parameter": free.gain()}, "parameter 'gain' belongs to an instrument"),
        ({"parameter": free.roughness()}, "parameter 'roughness': its place is not in this scene"),
        ({"count": 1}, "count is 1; expected a whole number of at least 2"),
        ({"wavelengths_nm": np.linspace(450, 650, 16)}, "450 to 650 nm do not cover 400 to 700 nm"),
    ],
)
def test_refusals(change, said):
    with pytest.raises(ValueError, match=said) as caught:
        reachable_colors(**({"scene": SCENE, "wavelengths_nm": NM} | change))
    assert "\n" not in str(caught.value)
