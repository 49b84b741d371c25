"""Maps of the hemisphere: the projection, counted reflections against traced rays, symmetry, gradients."""

from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import vcavity_jax as vc

NM = np.arange(400.0, 701.0, 20.0)
GOLD = vc.Specular(jnp.asarray(vc.materials.refractive_index("Au-Johnson", NM)))
GRAY = vc.Lambertian(jnp.array([0.2, 0.9]))
TINTED = vc.TwoPanels(vc.Lambertian(jnp.array([0.2, 0.9])), vc.Lambertian(jnp.array([0.6, 0.1])))
SWAPPED = vc.TwoPanels(TINTED.first, TINTED.second, alternating=True)


def scene(degrees: float, material: Any, light: Any = None) -> vc.Scene:
    return vc.Scene(vc.VGrooves(np.deg2rad(degrees)), material, light or vc.Diffuse(), vc.View())


@cache
def golden() -> vc.ReflectanceMap:
    return vc.reflectance_map(scene(60, GOLD), 21)


@pytest.mark.parametrize("size", [1, 9, 32])
def test_projection_inverts_the_equation_and_keeps_areas(size: int) -> None:
    chart = vc.reflectance_map(scene(180, vc.Lambertian(0.5)), size)
    inside = np.asarray(chart.inside)
    pixel = 2 * np.sqrt(2) / size
    u = (np.arange(size) + 0.5) * pixel - np.sqrt(2)
    right, up = np.meshgrid(u, -u)  # row 0 is the top
    radius = 2 * np.sin(np.asarray(chart.polar) / 2)
    np.testing.assert_allclose((radius * np.cos(chart.azimuth))[inside], right[inside], rtol=0, atol=1e-14)
    np.testing.assert_allclose((radius * np.sin(chart.azimuth))[inside], up[inside], rtol=0, atol=1e-14)
    np.testing.assert_array_equal(inside, np.hypot(right, up) < np.sqrt(2))
    assert np.isnan(np.asarray(chart.polar)[~inside]).all()
    assert np.isnan(np.asarray(chart.reflectance_factor)[~inside]).all()
    np.testing.assert_allclose(np.asarray(chart.reflectance_factor)[inside], 0.5, rtol=0, atol=1e-6)
    if size == 32:  # a pixel has the solid angle of its area: together 2π, and 3π/4 of it below 1 - cos θ = 3/8
        assert inside.sum() * pixel**2 == pytest.approx(2 * np.pi, rel=0.01)
        low = np.asarray(chart.polar)[inside] < np.arccos(5 / 8)
        assert low.sum() * pixel**2 == pytest.approx(2 * np.pi * 3 / 8, rel=0.02)


# Few directions at a time: small maps have several chunks, the last of them padded, and share their programs.
CHUNK = 16


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vcavity_jax.maps._CHUNK", CHUNK)


LIGHTS = {
    "diffuse": vc.Diffuse(),
    "directional": vc.Directional(0.5, 0.4),
    "along": vc.Directional(0.5, np.pi / 2),
    "mixed": vc.Mixed(0.3, vc.Directional(-0.9, 0.2)),
}


@pytest.mark.parametrize(
    ("material", "light"),
    [
        *((material, "diffuse") for material in (GOLD, GRAY, TINTED, SWAPPED)),
        (TINTED, "mixed"),
        pytest.param(GRAY, "directional", marks=pytest.mark.slow),
        pytest.param(GRAY, "along", marks=pytest.mark.slow),
    ],
)
def test_every_pixel_is_its_own_direction(material: Any, light: str) -> None:
    whole = scene(50, material, LIGHTS[light])
    chart = vc.reflectance_map(whole, 9, tolerance=1e-6)
    inside = np.asarray(chart.inside)
    rows = np.resize(np.arange(inside.sum()), (4, CHUNK))  # the shape of the map's own chunks
    for polar, azimuth, factor in zip(
        np.asarray(chart.polar)[inside][rows],
        np.asarray(chart.azimuth)[inside][rows],
        np.asarray(chart.reflectance_factor)[inside][rows],
        strict=True,
    ):
        seen = vc.Scene(whole.surface, whole.material, whole.illumination, vc.View(polar, azimuth))
        # Another chunk may be planned otherwise: each within the tolerance.
        np.testing.assert_allclose(factor, vc.reflectance_factor(seen, tolerance=1e-6), rtol=0, atol=2e-6)


def traced_most(degrees: float, section: float, rays: int = 1500) -> int:
    """The most reflections of rays through the aperture of one groove, followed from panel to panel."""
    half = np.deg2rad(degrees) / 2
    rims = np.array([[-np.sin(half), np.cos(half)], [np.sin(half), np.cos(half)]])
    normals = np.array([[np.cos(half), np.sin(half)], [-np.cos(half), np.sin(half)]])
    most = 0
    for y in np.linspace(-1, 1, rays + 2)[1:-1] * np.sin(half):
        at, toward, count, last = np.array([y, np.cos(half)]), -np.array([np.sin(section), np.cos(section)]), 0, -1
        while True:
            hits = []
            for panel in {0, 1} - {last}:
                slope = toward @ normals[panel]
                if slope < 0:
                    along = -(at @ normals[panel]) / slope
                    part = (at + along * toward) @ rims[panel]
                    if along > 0 and 0 <= part <= 1:
                        hits.append((along, panel))
            if not hits:
                break
            along, last = min(hits)
            at = at + along * toward
            toward = toward - 2 * (toward @ normals[last]) * normals[last]
            count += 1
        most = max(most, count)
    return most


def test_reflections_are_those_of_traced_rays() -> None:
    random = np.random.default_rng(3)
    for degrees in (17.0, 45.0, 60.0, 77.0, 90.0, 130.0, 180.0):
        polar, azimuth = random.uniform(0, 1.5, 6), random.uniform(-np.pi, np.pi, 6)
        polar[0] = 0.0
        view = vc.View(polar, azimuth)
        whole = vc.Scene(vc.VGrooves(np.deg2rad(degrees)), GOLD, vc.Diffuse(), view)
        counted = vc.reflection_count(whole)
        assert jnp.issubdtype(counted.dtype, jnp.integer)
        sections = np.arctan2(np.sin(polar) * np.cos(azimuth), np.cos(polar))
        assert counted.tolist() == [traced_most(degrees, section) for section in sections]


def test_reflections_at_exact_kinks_do_not_count_rounding() -> None:
    """Where one more reflection begins it fills nothing yet: with both panels in view, and with one hidden."""
    cases: list[tuple[float, float, int, float]] = []
    for degrees in np.arange(7.0, 180.0, 3.7).tolist():
        for k in range(1, int(180 / degrees) + 1):
            both, alone = k * degrees - 180 + degrees / 2, (180 - k * degrees) / 2
            cases += [(degrees, both, k, 1.0)] * (0 < both < degrees / 2)
            cases += [(degrees, alone, k, -1.0)] * (degrees / 2 < alone < 89)
    assert len(cases) > 100
    angle, section, expected, side = np.array(cases).T

    @jax.jit
    @jax.vmap
    def counted(angle: Any, section: Any) -> Any:
        return vc.reflection_count(vc.Scene(vc.VGrooves(angle), GOLD, vc.Diffuse(), vc.View(section)))

    angle, section = np.deg2rad(angle), np.deg2rad(section)
    for sign in (1, -1):
        np.testing.assert_array_equal(counted(angle, sign * section), expected)
        np.testing.assert_array_equal(counted(angle, sign * (section - 1e-9 * side)), expected)
        np.testing.assert_array_equal(counted(angle, sign * (section + 1e-9 * side)), expected + 1)


def test_edge_of_the_hemisphere_has_counts() -> None:
    view = vc.View(np.array([np.pi / 2] * 3), np.array([0.0, 1.0, np.pi / 2]))
    counts = vc.reflection_count(vc.Scene(vc.VGrooves(0.3), GOLD, vc.Diffuse(), view))
    assert counts.tolist()[:2] == [1, 1]
    assert counts[2] >= 1


def test_map_holds_the_counts() -> None:
    chart = golden()
    inside = np.asarray(chart.inside)
    assert chart.reflections is not None
    counts = np.asarray(chart.reflections)
    view = vc.View(chart.polar[inside], chart.azimuth[inside])
    expected = vc.reflection_count(vc.Scene(vc.VGrooves(np.deg2rad(60)), GOLD, vc.Diffuse(), view))
    np.testing.assert_array_equal(counts[inside], expected)
    assert (counts[~inside] == 0).all()
    assert set(counts[inside].tolist()) == {1, 2, 3}
    assert vc.reflectance_map(scene(60, GRAY), 4).reflections is None


def test_color_of_the_map() -> None:
    chart = golden()
    color, inside = np.asarray(chart.srgb(NM)), np.asarray(chart.inside)
    assert color.shape == (21, 21, 3)
    assert np.isnan(color[~inside]).all()
    assert (color[inside] >= 0).all()
    assert (color[inside] <= 1).all()
    white = vc.colorimetry.white(NM, "A")
    spectrum = chart.reflectance_factor[10, 10]
    expected = vc.colorimetry.srgb(vc.colorimetry.xyz(spectrum, NM, "A"), white, clip=True)
    np.testing.assert_allclose(chart.srgb(NM, "A")[10, 10], expected, rtol=0, atol=1e-12)
    with pytest.raises(ValueError, match="do not cover"):
        chart.srgb(NM + 10)
    with pytest.raises(ValueError, match="does not fit"):
        vc.reflectance_map(scene(60, vc.Specular(1.5)), 3).srgb(NM)


@pytest.mark.parametrize("material", [vc.Specular(0.4 + 2.4j), vc.Lambertian(0.6)])
def test_gradient_of_the_map(material: Any) -> None:
    @jax.jit
    def mean(angle: Any) -> Any:
        whole = vc.Scene(vc.VGrooves(angle), material, vc.Diffuse(), vc.View())
        chart = vc.reflectance_map(whole, 8, tolerance=1e-8, smallest_angle=0.7)
        return jnp.mean(chart.reflectance_factor[chart.inside])

    at, step = 1.1, 1e-4
    known = vc.reflectance_map(scene(np.rad2deg(at), material), 8)
    assert mean(at) == pytest.approx(float(np.nanmean(known.reflectance_factor)), abs=1e-6)
    slope = (mean(at + step) - mean(at - step)) / (2 * step)
    assert jax.grad(mean)(at) == pytest.approx(float(slope), rel=2e-4)


@pytest.mark.parametrize("size", [0, -3])
def test_sizes_are_whole_numbers(size: int) -> None:
    with pytest.raises(ValueError, match=f"{size} is not a size of a map"):
        vc.reflectance_map(scene(60, GOLD), size)


def test_what_has_no_map_or_count_is_refused() -> None:
    with pytest.raises(ValueError, match="delta"):
        vc.reflectance_map(scene(60, GOLD, vc.Directional(0.2, 0.0)), 4)
    random = vc.Scene(vc.BeckmannGrooves(0.3), GOLD, vc.Diffuse(), vc.View())
    with pytest.raises(ValueError, match="no largest number of reflections"):
        vc.reflection_count(random)
    with pytest.raises(ValueError, match="endlessly"):
        vc.reflection_count(scene(60, GRAY))
    with pytest.raises(ValueError, match="no direction"):
        vc.reflection_count(vc.Scene(vc.VGrooves(1.0), GOLD, vc.Diffuse(), vc.Hemisphere()))
