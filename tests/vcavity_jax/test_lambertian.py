"""Diffusing grooves: collocation records, closed forms, published values, planned shortcuts."""

import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import vcavity_jax as vc
from vcavity_jax import lambertian
from vcavity_jax.resolution import mean_resolution

TRUTH = json.loads((Path(__file__).parents[1] / "data" / "lambertian.json").read_text())
REFLECTANCES = np.array([0.05, 0.2, 0.5, 0.8, 0.93, 0.99, 0.999, 1.0])
VIEWS = ("frontal", [30, 0], [45, 0], [45, 90], [75, 0])
LIGHTS = ("diffuse", "frontal", [45, 0], [75, 30])
ANGLES = (1, 5, 10, 20, 30, 45, 60, 90, 120, 150, 170, 179)
PAIRS = ((0.8, 0.2), (1.0, 0.5), (0.05, 0.93))
FINEST = 1e-13


@pytest.fixture(autouse=True, scope="module")
def _forget_programs() -> Iterator[None]:
    yield
    jax.clear_caches()


def direction(name: Any) -> tuple[float, float]:
    return (0.0, 0.0) if name == "frontal" else (np.radians(name[0]), np.radians(name[1]))


def illumination(name: Any) -> vc.Diffuse | vc.Directional:
    return vc.Diffuse() if name == "diffuse" else vc.Directional(*direction(name))


def view(names: Any = VIEWS) -> vc.View:
    polar, azimuth = np.array([direction(name) for name in names]).T
    return vc.View(polar, azimuth)


def panels(reflectance: Any) -> vc.Lambertian | vc.TwoPanels:
    if isinstance(reflectance, tuple):
        return vc.TwoPanels(vc.Lambertian(reflectance[0]), vc.Lambertian(reflectance[1]))
    return vc.Lambertian(reflectance)


@cache
def program(diffuse: bool, profile: bool, two: bool, tolerance: float) -> Any:
    """The general path, where nothing is known when the work is planned."""

    @jax.jit
    def run(angle: Any, light: Any, where: Any, reflectance: Any) -> Any:
        source = vc.Diffuse() if diffuse else vc.Directional(*light)
        scene = vc.Scene(vc.VGrooves(angle), panels(reflectance), source, vc.View() if profile else where)
        if profile:
            return vc.radiance_profile(scene, where, tolerance)
        return vc.reflectance_factor(scene, tolerance)

    return run


def traced(degrees: Any, light: Any, reflectance: Any, where: Any, tolerance: float = FINEST) -> np.ndarray:
    """Mean radiance factors at the views, or the profile at the positions, of ``where``."""
    diffuse, profile, two = light == "diffuse", not isinstance(where, vc.View), isinstance(reflectance, tuple)
    source = () if diffuse else tuple(jnp.asarray(a) for a in direction(light))
    values = jax.tree.map(jnp.asarray, reflectance)
    angle = jnp.radians(jnp.asarray(float(degrees)))
    return np.asarray(program(diffuse, profile, two, tolerance)(angle, source, where, values))


def of(section: str, degrees: float, light: Any) -> list[dict[str, Any]]:
    found = [r for r in TRUTH[section] if r["alpha_deg"] == degrees and r["light"] == light]
    assert found
    return found


def fully_met(degrees: float, name: Any) -> bool:
    polar, azimuth = direction(name)
    return abs(np.arctan2(np.sin(polar) * np.cos(azimuth), np.cos(polar))) <= np.radians(degrees) / 2 * (1 + 1e-9)


def bound(degrees: float, light: Any, seen: Any) -> float:
    """Fully lit and seen: rounding of one sum. Shadow or mask: factors of the contour's size, 1/α² at worst.

    Measured: 1e-14 fully visible; 1e-14 at 10 degrees and above, 1.4e-13 at 5, 1.7e-12 at 1.
    """
    if fully_met(degrees, seen) and (light == "diffuse" or fully_met(degrees, light)):
        return 1e-13 if degrees >= 5 else 1e-11
    return 1e-11 if degrees >= 10 else 1e-10 if degrees >= 5 else 1e-8


def worst_excess(value: np.ndarray, records: list[dict[str, Any]], views: Any = VIEWS) -> float:
    """Largest error over its bound."""
    excess = 0.0
    for r in records:
        if r["view"] in views:
            found = value[views.index(r["view"]), int(np.argmin(np.abs(REFLECTANCES - r["r"])))]
            error = abs(found - r["mean_radiance_factor"])
            excess = max(excess, error / bound(r["alpha_deg"], r["light"], r["view"]))
    return excess


def test_every_record_is_compared() -> None:
    assert {r["alpha_deg"] for r in TRUTH["data"]} == set(ANGLES)
    assert all(r["light"] in LIGHTS and r["view"] in VIEWS and r["r"] in REFLECTANCES for r in TRUTH["data"])
    assert len(TRUTH["data"]) > 900


@pytest.mark.parametrize("light", LIGHTS, ids=str)
def test_records_general_path(light: Any) -> None:
    for degrees in ANGLES:
        value = traced(degrees, light, REFLECTANCES, view())
        assert worst_excess(value, of("data", degrees, light)) < 1, degrees


@pytest.mark.parametrize("degrees", ANGLES)
def test_records_as_planned(degrees: float) -> None:
    """The same records with everything known: fewer nodes, and no shadow where there is none.

    Against the general path, too: 1e-13 where that has its digits (from 10 degrees on), else the bounds.
    """
    for light in ("diffuse", [75, 30]):
        scene = vc.Scene(
            vc.VGrooves(np.radians(degrees)), vc.Lambertian(REFLECTANCES), illumination(light), view()
        )
        value = np.asarray(vc.reflectance_factor(scene, FINEST))
        assert worst_excess(value, of("data", degrees, light)) < 1
        if degrees >= 10:
            general = traced(degrees, light, REFLECTANCES, view())
            np.testing.assert_allclose(value, general, rtol=0, atol=1e-13)


# What is known of light and views, and lets a part of the model drop out.
SHORTCUTS: dict[str, tuple[float, Any, tuple[Any, ...]]] = {
    "frontal light and views along the fold: open, balanced": (20, "frontal", ("frontal", [45, 90])),
    "the same, wide": (60, "frontal", ("frontal", [45, 90])),
    "diffuse light, views along the fold: open": (20, "diffuse", ("frontal", [45, 90])),
    "frontal light: balanced": (45, "frontal", VIEWS),
    "views along the fold: balanced": (45, [45, 0], ("frontal", [45, 90])),
    "wide groove: open, both parities": (120, [45, 0], ("frontal", [30, 0], [45, 0], [45, 90])),
    "just lit: open": (90, [45, 0], ("frontal", [30, 0])),
}


@pytest.mark.parametrize("case", SHORTCUTS)
def test_planned_shortcuts_are_the_general_path(case: str) -> None:
    """To 1e-13, and each to the records: they are different sums for the same number."""
    degrees, light, views = SHORTCUTS[case]
    scene = vc.Scene(
        vc.VGrooves(np.radians(degrees)), vc.Lambertian(REFLECTANCES), illumination(light), view(views)
    )
    planned = np.asarray(vc.reflectance_factor(scene, FINEST))
    general = traced(degrees, light, REFLECTANCES, view())[[VIEWS.index(v) for v in views]]
    np.testing.assert_allclose(planned, general, rtol=0, atol=1e-13)
    assert worst_excess(planned, of("data", degrees, light), views) < 1


@pytest.mark.parametrize("light", LIGHTS, ids=str)
def test_two_panels(light: Any) -> None:
    """1e-11, the truth's own accuracy; measured 1.4e-15."""
    first, second = np.array(PAIRS).T
    for degrees in (10, 20, 30, 45, 60, 90, 120):
        value = traced(degrees, light, (first, second), view())
        for r in of("two_colour", degrees, light):
            found = value[VIEWS.index(r["view"]), PAIRS.index((r["r1"], r["r2"]))]
            assert found == pytest.approx(r["mean_radiance_factor"], rel=0, abs=1e-11), r


def test_two_panels_planned() -> None:
    """Open and masked, eager, against the general path."""
    first, second = np.array(PAIRS).T
    for light, views in (("frontal", ("frontal", [45, 90])), ("diffuse", VIEWS), ([45, 0], VIEWS)):
        scene = vc.Scene(vc.VGrooves(np.pi / 4), panels((first, second)), illumination(light), view(views))
        planned = np.asarray(vc.reflectance_factor(scene, FINEST))
        general = traced(45, light, (first, second), view(views))
        np.testing.assert_allclose(planned, general, rtol=0, atol=1e-13)


@pytest.mark.parametrize("light", LIGHTS, ids=str)
def test_local_radiance(light: Any) -> None:
    """Bounds of shadowed light. Measured 5e-14 from 10 degrees on, 1.4e-12 at 5, 2.3e-11 at 1 (of 115)."""
    position = jnp.asarray([0.0, 0.1, 0.5, 1.0])
    for degrees in ANGLES:
        limit = 1e-11 if degrees >= 10 else 1e-10 if degrees >= 5 else 1e-8
        value = traced(degrees, light, REFLECTANCES, position)
        assert value.shape == (2, 4, len(REFLECTANCES))
        for r in of("local", degrees, light):
            assert r["y"] == position.tolist()
            found = value[r["panel"] - 1, :, int(np.argmin(np.abs(REFLECTANCES - r["r"])))]
            np.testing.assert_allclose(found, r["radiance"], rtol=0, atol=limit)


def test_profile_of_two_panels_averages_to_what_is_seen() -> None:
    """Along the fold both panels fill half the view: its mean is that of the profiles.

    Gauss-Legendre of 40 nodes in the fourth root of the position, which flattens the fold: 1e-10 (measured).
    """
    x, weight = np.polynomial.legendre.leggauss(40)
    root, weight = (x + 1) / 2, weight / 2
    scene = vc.Scene(vc.VGrooves(0.8), panels((0.9, 0.3)), vc.Directional(0.2, 0.4), vc.View(0.5, np.pi / 2))
    profile = np.asarray(vc.radiance_profile(scene, jnp.asarray(root**4), 1e-11))
    mean = np.sum(profile * weight * 4 * root**3) / 2
    assert mean == pytest.approx(float(vc.reflectance_factor(scene, 1e-11)), abs=1e-9)


# -- closed forms and published values -------------------------------------------------------------


def frontal(degrees: float, reflectance: Any) -> np.ndarray:
    scene = vc.Scene(vc.VGrooves(np.radians(degrees)), vc.Lambertian(reflectance), vc.Directional(), vc.View())
    return np.asarray(vc.reflectance_factor(scene, FINEST))


def test_single_reflection_by_hand() -> None:
    """r → 0: light and view meet their own panels only, <L>/r = Σ l v (lit and seen part) / (2 s cos cos)."""
    angle, dark = np.radians(50.0), 1e-9
    s, c = np.sin(angle / 2), np.cos(angle / 2)
    light, seen = np.radians([30.0, 25.0]), np.radians([60.0, 15.0])

    def faced(d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        across, normal = np.sin(d[0]) * np.cos(d[1]) * c, np.cos(d[0]) * s
        e = np.array([normal + across, normal - across])
        return np.maximum(e, 0), np.where(e > 0, np.maximum(0, -e[::-1] / e), 1)

    (lit, shadow), (met, masked) = faced(light), faced(seen)
    part = np.sum(lit * met * (1 - np.maximum(shadow, masked)))
    expected = part / (2 * s * np.cos(light[0]) * np.cos(seen[0]))
    scene = vc.Scene(vc.VGrooves(angle), vc.Lambertian(dark), vc.Directional(*light), vc.View(*seen))
    # Two reflections weigh 1e-9 beside one.
    assert float(vc.reflectance_factor(scene, FINEST)) / dark == pytest.approx(expected, rel=1e-4 * 1e-4)


def test_errata_of_the_thesis_at_45_degrees() -> None:
    """Mean 1.15498, fold 2.61313, rim 0.66482 for r = 1, and unity at y = 0.56904; printed to 5 decimals."""
    white = vc.Scene(vc.VGrooves(np.pi / 4), vc.Lambertian(1.0), vc.Directional(), vc.View())
    assert float(vc.reflectance_factor(white, FINEST)) == pytest.approx(1.15498, abs=5e-6)
    fold, rim, crossing = vc.radiance_profile(white, jnp.asarray([0.0, 1.0, 0.56904]), 1e-12)[0]
    assert fold == pytest.approx(2.61313, abs=5e-6)
    assert rim == pytest.approx(0.66482, abs=5e-6)
    assert crossing == pytest.approx(1, abs=3e-5)  # slope of 3 times half a unit of the printed position


def test_crossing_at_reflectance_08_is_the_same_under_any_mixture() -> None:
    """y = 0.54192, common radiance 0.60486; the errata call it exact for every mixture."""
    for fraction in (0.0, 0.4, 1.0):
        light = vc.Mixed(fraction, vc.Directional())
        scene = vc.Scene(vc.VGrooves(np.pi / 4), vc.Lambertian(0.8), light, vc.View())
        profile = vc.radiance_profile(scene, 0.54192)
        np.testing.assert_allclose(profile, 0.60486, rtol=0, atol=3e-5)


# Reflectance at which frontally lit grooves are as bright as a white flat sheet is worth, sin(α/2) G = 1.
BREAK_EVEN = {
    1: 0.993263, 5: 0.974798, 10: 0.959636, 20: 0.942144, 30: 0.934297, 40: 0.932187, 60: 0.937892,
    90: 0.957594, 120: 0.978914, 150: 0.994398, 170: 0.999367, 179: 0.9999937,
}  # fmt: skip


def test_break_even_reflectance() -> None:
    """Where mean = r (sin(α/2) G = 1); errata, printed to half a unit of the last digit, slope up to 15."""
    for degrees, published in BREAK_EVEN.items():
        step = 5e-8 if degrees == 179 else 5e-7
        low, high = frontal(degrees, np.array([published - step, published + step]))
        assert low < published - step + 1e-13, degrees
        assert high > published + step - 1e-13, degrees


def test_break_even_reflectance_at_45_degrees() -> None:
    """0.932617113340, to the 12 digits that the errata give."""
    reflectance = 0.932617113340
    assert frontal(45, reflectance) / reflectance == pytest.approx(1, abs=1e-11)


@pytest.mark.parametrize(
    ("degrees", "mean"), [(30, 1.3184), (60, 1.0795), (90, 1.0198), (120, 1.0034), (150, 1.0002)]
)
def test_white_grooves_exceed_one_in_frontal_light(degrees: float, mean: float) -> None:
    """Errata: at every angle, not only up to 45 degrees."""
    assert frontal(degrees, 1.0) == pytest.approx(mean, abs=5e-5)


def test_retroreflection_peaks_at_45_degrees() -> None:
    """Light (45, 0) on 45 degrees, r = 0.93; errata against the thesis, section 3.6."""
    views = {30: 1.139, 45: 1.476, 60: 1.439, 75: 1.404, -45: 0.566, -30: 0.546, -60: 0.518, -75: 0.451}
    light = vc.Directional(np.pi / 4, 0.0)
    polar = np.radians([float(v) for v in views])
    scene = vc.Scene(vc.VGrooves(np.pi / 4), vc.Lambertian(0.93), light, vc.View(polar, 0.0))
    np.testing.assert_allclose(vc.reflectance_factor(scene), list(views.values()), rtol=0, atol=6e-4)


def test_fold_threshold() -> None:
    """Errata: the fold outshines a flat sheet of its panels from r = 1 / (1 + sin α/2) on."""
    for degrees in (20.0, 45.0, 90.0, 179.0):
        r = 1 / (1 + np.sin(np.radians(degrees / 2)))
        scene = vc.Scene(vc.VGrooves(np.radians(degrees)), vc.Lambertian(r), vc.Directional(), vc.View())
        # Closed form of the fold: two divisions.
        np.testing.assert_allclose(vc.radiance_profile(scene, 0.0), r, rtol=0, atol=1e-13)


@pytest.mark.parametrize("degrees", [0.1, 1.0, 4.5, 14.0, 40.0])
@pytest.mark.parametrize("tolerance", [1e-3, 1e-6, 1e-10, 1e-13])
def test_the_series_of_the_symbol_is_its_integral(degrees: float, tolerance: float) -> None:
    """Down to the angle it is made for; exactly nothing is exchanged on a flat surface."""
    resolution = mean_resolution(tolerance, np.radians(degrees))
    x = np.arange(len(lambertian._mean_table(resolution).weight)) * resolution.step
    angles = np.exp(np.random.default_rng(3).uniform(np.log(np.radians(degrees)), np.log(np.pi), 50))
    exact = lambertian._symbol(angles, np.sinh(x) / 2, resolution.smallest_angle)
    series = jax.vmap(lambda angle: lambertian.log_symbol(angle, resolution)[0][:, 0])(jnp.asarray(angles))
    assert np.abs(np.exp(series) / exact - 1).max() < max(tolerance / 20, 2e-12 if degrees < 1 else 2e-13)
    assert not np.any(np.abs(lambertian.log_symbol(jnp.asarray(np.pi), resolution)[0]) > 1e-13)
