"""Hard cases, each against a reference that shares no code with the models."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import vcavity_jax as vc
from fitting.bench import nystrom, thesis_recipe

GRAZING = np.pi / 2
R = np.array([0.0, 1e-12, 0.5, 1 - 1e-12, 1.0])
GOLD = np.array([0.35 + 2.7j, 4.0 + 0.03j, 1.0 + 20j, 50.0 + 0j])


def beside(value: float) -> list[float]:
    return [float(np.nextafter(value, 0)), value, float(np.nextafter(value, 9))]


def mirrors(angle: float, index: Any, polar: float, azimuth: float = 0.0) -> np.ndarray:
    view = vc.View(polar, azimuth)
    return np.asarray(vc.reflectance_factor(vc.Scene(vc.VGrooves(angle), vc.Specular(index), vc.Diffuse(), view)))


@pytest.mark.parametrize("k", [1, 2, 3, 4, 5, 8, 17])
def test_mirrors_where_the_number_of_reflections_changes(k: int) -> None:
    """π/k and one unit in the last place beside; views at ±α/2 and beside; grazing."""
    for angle in beside(np.pi / k)[: 2 if k == 1 else 3]:
        for polar in (0.0, *(beside(angle / 2) if k > 1 else [0.3]), -angle / 2 * (k > 1), 1.2, 1.5707):
            # Nearer to grazing the reference itself loses its digits.
            for azimuth in (0.0, 0.7):
                view = (polar, azimuth)
                exact = thesis_recipe.specular(angle, GOLD, view, thesis_recipe.exact_entries(angle, view))
                np.testing.assert_allclose(mirrors(angle, GOLD, *view), exact, rtol=0, atol=1e-11)


def test_an_index_of_one_reflects_nothing_and_one_beside_nearly_nothing() -> None:
    assert np.all(mirrors(0.8, np.array([1.0 + 0j]), 0.3, 0.2) == 0)
    # One reflection on a flat surface: ((n - 1) / (n + 1))².
    small = mirrors(np.pi, np.array([1 + 1e-6]), 0.0)
    np.testing.assert_allclose(small, (1e-6 / (2 + 1e-6)) ** 2, rtol=1e-9)


def test_no_absorption_in_real_and_in_complex_arithmetic() -> None:
    n = np.array([1.2, 1.5, 4.0])
    for polar in (0.0, 0.6, 1.5):
        np.testing.assert_allclose(mirrors(0.7, n, polar, 0.4), mirrors(0.7, n + 0j, polar, 0.4), atol=1e-15)


@pytest.mark.parametrize("degrees", [20.0, 45.0, 90.0, 120.0, 179.0, 180.0])
def test_diffusers_against_a_dense_solve(degrees: float) -> None:
    """Reflectances 0 and 1 and beside; the dense solve is good to 2e-9 here."""
    angle = np.radians(degrees)
    for diffuse, light in ((True, vc.Diffuse()), (False, vc.Directional())):
        scene = vc.Scene(vc.VGrooves(angle), vc.Lambertian(R), light, vc.View())
        dense = nystrom.open_groove(angle, R, diffuse, 200)
        np.testing.assert_allclose(vc.reflectance_factor(scene, 1e-12), dense, rtol=0, atol=2e-9)


@pytest.mark.parametrize("material", ["matte", "varnished"])
@pytest.mark.parametrize("light_deg", [0.0, 30.0, 67.5, 85.0])
def test_grazing_is_the_limit_of_nearly_grazing(material: str, light_deg: float) -> None:
    """View or light at 90 degrees and 1e-12, 1e-9 beside; 67.5 degrees is along a panel's normal."""
    below: Any = vc.Lambertian(0.6) if material == "matte" else vc.InterfacedLambertian(0.6, 1.5)
    other = np.radians(light_deg), 0.3

    def factor(light: Any, view: Any) -> float:
        scene = vc.Scene(vc.VGrooves(np.radians(45)), below, vc.Directional(*light), vc.View(*view))
        return float(vc.reflectance_factor(scene, 1e-10))

    near = factor(other, (GRAZING - 1e-7, 0.0))
    for polar in (GRAZING, GRAZING - 1e-13, GRAZING - 1e-12, GRAZING - 1e-10, GRAZING - 1e-8):
        assert factor(other, (polar, 0.0)) == pytest.approx(near, rel=1e-5)
        assert factor((polar, 0.0), other) == pytest.approx(near, rel=1e-5)


def test_the_edge_of_the_light_crosses_that_of_the_view() -> None:
    """Light and view from the same direction: continuous, with a kink, and a finite one-sided slope."""

    @jax.jit
    def factor(light: Any, view: Any) -> Any:
        scene = vc.Scene(
            vc.VGrooves(np.radians(50)), vc.Lambertian(0.8), vc.Directional(light, 0.0), vc.View(view, 0.0)
        )
        return vc.reflectance_factor(scene, 1e-11)

    for polar in (0.5, 0.9, 1.3):
        at = float(factor(polar, polar))
        sides = [(float(factor(polar + s * 1e-5, polar)) - at) / (s * 1e-5) for s in (-1, 1)]
        assert max(abs(float(factor(polar + s * 1e-9, polar)) - at) for s in (-1, 1)) < 1e-7
        slope = float(jax.grad(factor)(polar, polar))
        assert min(abs(slope - side) for side in sides) < 2e-3


def test_the_slope_at_a_kink_is_that_of_one_side_or_the_mean() -> None:
    @jax.jit
    def factor(angle: Any) -> Any:
        scene = vc.Scene(vc.VGrooves(angle), vc.Specular(GOLD[:1]), vc.Diffuse(), vc.View())
        return vc.reflectance_factor(scene)[0]

    for k in (2, 3, 4):
        at, h = np.pi / k, 1e-6
        sides = [(float(factor(at + s * h)) - float(factor(at))) / (s * h) for s in (-1, 1)]
        slope = float(jax.grad(factor)(at))
        assert min(abs(slope - known) for known in (*sides, sum(sides) / 2)) < 1e-4
        assert abs(sides[0] - sides[1]) > 1e-2


@pytest.mark.parametrize("roughness", [1e-3, 0.5, 10.0])
def test_the_smoothest_and_the_roughest_grooves(roughness: float) -> None:
    """The average over the distribution of angles, by brute force."""
    u, weight = np.polynomial.legendre.leggauss(60)
    ends = np.array([0.0, 0.5, 1.0, 2.0, 3.0, 5.0, 7.0])
    nodes = ((ends[1:] + ends[:-1]) / 2)[:, None] + np.diff(ends)[:, None] / 2 * u
    weight = (np.diff(ends)[:, None] / 2 * weight * nodes * np.exp(-(nodes**2) / 2)).ravel()
    angles = 2 * np.arctan2(1.0, roughness * nodes.ravel())

    @jax.jit
    def one(angle: Any) -> Any:
        scene = vc.Scene(vc.VGrooves(angle), vc.Lambertian(R), vc.Diffuse(), vc.View())
        return vc.reflectance_factor(scene, 1e-9)

    brute = weight @ np.asarray(jax.lax.map(one, jnp.asarray(angles)))
    scene = vc.Scene(vc.BeckmannGrooves(roughness), vc.Lambertian(R), vc.Diffuse(), vc.View())
    np.testing.assert_allclose(vc.reflectance_factor(scene, 1e-8), brute, rtol=0, atol=1e-6)


def test_coverages_of_nothing_and_of_all() -> None:
    """No ink is no layer; all ink is a layer whose every passage counts as a normal one."""
    ink = np.array([0.1, 0.7])

    def seen(layer: Any) -> np.ndarray:
        material = vc.InterfacedLambertian(np.array([0.8, 0.8]), 1.5, layer)
        scene = vc.Scene(vc.VGrooves(1.1), material, vc.Diffuse(), vc.View(0.4, 0.0))
        return np.asarray(vc.reflectance_factor(scene, 1e-9))

    np.testing.assert_allclose(seen(vc.Halftone(0.0, ink)), seen(None), atol=1e-8)
    np.testing.assert_allclose(seen(vc.Halftone(1.0, ink)), seen(vc.ColoredLayer(ink, "berns")), atol=1e-8)


def test_an_interface_that_is_hardly_there() -> None:
    view = vc.View(0.4, 0.0)
    bare = vc.reflectance_factor(vc.Scene(vc.VGrooves(0.9), vc.Lambertian(R), vc.Diffuse(), view), 1e-10)
    for n in (1.0, 1 + 1e-12):
        scene = vc.Scene(vc.VGrooves(0.9), vc.InterfacedLambertian(R, n), vc.Diffuse(), view)
        np.testing.assert_allclose(vc.reflectance_factor(scene, 1e-9), bare, rtol=0, atol=1e-8)
