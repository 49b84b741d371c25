"""Diffusing panels in the geometries of instruments, against sums of parallel light that share nothing with them.

References are composite Gauss-Legendre sums of ``radiosity.directional`` and ``diffuse``, evaluated for 1e-13,
with panels that shrink by halves towards every shadow edge and every kink.
"""

import dataclasses
import itertools
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from vcavity_jax import illumination, planning, radiosity, resolution, roughness
from vcavity_jax.directions import components
from vcavity_jax.scene import Annular, Diffuse, DiffuseWithTrap, Directional, Lambertian, Scene, VGrooves, View

FIRST, SECOND = jnp.asarray([0.3, 0.9, 1.0]), jnp.asarray([0.3, 0.6, 1.0])
VIEWS = components(*jnp.radians(jnp.asarray([[0.0, -12.0, 62.0, 85.0], [0.0, 0.0, 20.0, 0.0]])))
SECTIONS = np.abs(np.arctan2(np.asarray(VIEWS[1]), np.asarray(VIEWS[2])))
TOLERANCES = (1e-3, 1e-6, 1e-8, 1e-10)


@pytest.fixture(autouse=True, scope="module")
def _forget_programs() -> Iterator[None]:
    yield
    jax.clear_caches()


def planned(tolerance: float, angle: float) -> planning.Plan:
    """For an angle, with nothing known of light and view."""
    any_scene = Scene(VGrooves(1.0), Lambertian(0.5), Diffuse(), View())
    return dataclasses.replace(
        planning.plan(any_scene, tolerance),
        lit=False,
        seen=False,
        balanced=False,
        mean=resolution.mean_resolution(tolerance, angle),
        step=resolution.step_resolution(tolerance, angle, None),
    )


def graded(marks: Any, low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights from low to high: panels shrink by halves towards every mark, to 2^-18."""
    inside = sorted({low, high, *(float(m) for m in marks if low < m < high)})
    shrinking = np.append(0, 2.0 ** np.arange(-18, 1)) / 2
    x, weight = np.polynomial.legendre.leggauss(8)
    ends = np.unique(
        np.concatenate(
            [np.append(a + (b - a) * shrinking, b - (b - a) * shrinking) for a, b in itertools.pairwise(inside)]
        )
    )
    half = np.diff(ends)[:, None] / 2
    return ((ends[:-1] + ends[1:])[:, None] / 2 + half * x).ravel(), (half * weight).ravel()


def parallel(angle: Any, plan: Any, across: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """``directional`` for many lights in the plane across the grooves."""

    @jax.jit
    def all_of(angle: Any, polar: Any) -> Any:
        def one(polar: Any) -> Any:
            light = Directional(polar, 0.0)
            return radiosity.directional(angle, (FIRST, SECOND), False, light, VIEWS, plan)

        return jax.lax.map(one, polar, batch_size=32)

    return np.asarray(all_of(angle, jnp.asarray(np.arctan2(across, normal))))


@partial(jax.jit, static_argnums=3)
def diffusely_lit(angle: Any, panels: Any, views: Any, plan: Any) -> Any:
    return radiosity.diffuse(angle, panels, False, views, plan, False)


@pytest.mark.parametrize("degrees", [2.0, 35.0, 180.0])
def test_bihemispherical(degrees: float) -> None:
    """The mean of what all views see; like panels are two panels; to 1e-12."""
    angle, plan = jnp.asarray(np.radians(degrees)), planned(1e-13, np.radians(degrees))
    first, second = jnp.asarray([0.0, 0.3, 0.5, 0.99, 1.0, 1.0]), jnp.asarray([0.0, 0.3, 0.9, 0.99, 1.0, 0.4])
    both = jax.jit(partial(radiosity.bihemispherical, plan=plan), static_argnums=2)
    t, weight = graded([angle / 2], 0.0, np.pi / 2)
    views = (jnp.zeros(len(t)), jnp.asarray(np.sin(t)), jnp.asarray(np.cos(t)))
    seen = [diffusely_lit(angle, panels, views, plan) for panels in ((first, second), (second, first))]
    wanted = (weight * np.cos(t)) @ (seen[0] + seen[1]) / 2
    np.testing.assert_allclose(both(angle, (first, second), False), wanted, rtol=0, atol=1e-12)
    alike = both(angle, (first, first), True)
    np.testing.assert_allclose(alike, both(angle, (first, first), False), rtol=0, atol=1e-12)
    assert alike[0] == pytest.approx(0, abs=1e-13)
    assert alike[4] == 1
    if degrees == 180:
        np.testing.assert_allclose(alike, first, rtol=0, atol=1e-15)


@partial(jax.jit, static_argnums=(2, 3))
def rings(angle: Any, polar: Any, plan: Any, nodes: Any) -> Any:
    panels = FIRST, SECOND
    return (
        radiosity.annular(angle, panels, False, polar, VIEWS, plan, nodes, False, False),
        radiosity.annular_hemispherical(angle, panels, False, polar, plan, nodes, False),
    )


def slow(*scenes: Any) -> list[Any]:
    return [pytest.param(*scene, TOLERANCES, marks=pytest.mark.slow) for scene in scenes]


@pytest.mark.parametrize(
    ("degrees", "polar", "tolerances"),
    [(60.0, 45.0, (1e-8,)), *slow((20.0, 80.0), (1.0, 45.0), (5.0, 89.0), (120.0, 89.0), (100.0, 45.0))],
)
def test_ring(degrees: float, polar: float, tolerances: tuple[float, ...]) -> None:
    """A ring is a mean of parallel lights, seen from one direction and by a hemisphere.

    At 1 degree the reference itself has 1e-8.
    """
    a, ring = np.radians([degrees, polar])
    angle, fine, floor = jnp.asarray(a), planned(1e-13, a), 1e-8 if degrees < 5 else 1e-11
    kinks = [np.arccos(min(np.tan(t) / np.tan(ring), 1)) for t in (a / 2, *SECTIONS)]
    phi, weight = graded([*kinks, *(np.pi - np.asarray(kinks))], 0.0, np.pi)
    across, normal = np.sin(ring) * np.cos(phi), np.full(len(phi), np.cos(ring))
    wanted = np.tensordot(weight / np.pi, parallel(angle, fine, across, normal), 1)
    lights = (jnp.zeros(len(phi)), jnp.asarray(across), jnp.asarray(normal))
    flux = weight / np.pi @ np.asarray(diffusely_lit(angle, (FIRST, SECOND), lights, fine))
    visible = 2 / (1 + np.tan(ring) / np.tan(a / 2))
    for tolerance in tolerances:
        plan = planned(tolerance, a)
        nodes = resolution.clustering(tolerance, visible if visible > 0.01 else None)
        found, reflected = rings(angle, jnp.asarray(ring), plan, nodes)
        np.testing.assert_allclose(found, wanted, rtol=0, atol=tolerance + floor)
        np.testing.assert_allclose(reflected, flux, rtol=0, atol=tolerance + floor)
        np.testing.assert_allclose(reflected[2], 1, rtol=0, atol=tolerance)  # the white furnace


@partial(jax.jit, static_argnums=(2, 3))
def trapped(angle: Any, light: Any, plan: Any, nodes: Any) -> Any:
    return radiosity.trapped(angle, (FIRST, SECOND), False, light, VIEWS, plan, nodes, False, False)


@pytest.mark.parametrize(
    ("degrees", "center", "azimuth", "size", "tolerances"),
    [
        (14.0, -8.0, 0.0, 6.0, (1e-8,)),
        *slow((60.0, 70.0, 10.0, 19.0), (20.0, 12.0, 50.0, 20.0), (5.0, -8.0, 90.0, 6.0), (3.0, 40.0, 0.0, 6.0)),
    ],
)
def test_trap(degrees: float, center: float, azimuth: float, size: float, tolerances: tuple[float, ...]) -> None:
    """Diffuse light less the parallel lights of a disk, summed in both of its coordinates."""
    a, polar, phi, h = np.radians([degrees, center, azimuth, size])
    angle, fine, floor = jnp.asarray(a), planned(1e-13, a), 1e-9 if degrees < 5 else 1e-11
    x, y, z = (float(c) for c in components(jnp.asarray(polar), jnp.asarray(phi)))
    middle, reach = np.arctan2(y, z), np.arcsin(np.sin(h) / np.hypot(y, z))
    kinks = [s * t for t in (a / 2, *SECTIONS) for s in (1, -1)]
    t, weight = graded(kinks, middle - reach, middle + reach)
    away = np.hypot(y, z) * np.cos(t - middle)
    reached = np.arccos(np.minimum(np.cos(h) / np.hypot(x, away), 1))
    nodes, eta_weight = np.polynomial.legendre.leggauss(12)
    eta = np.arctan2(x, away)[:, None] + reached[:, None] * nodes
    irradiance = weight * np.cos(t) * reached * (np.cos(eta) ** 2 @ eta_weight) / np.pi
    dark = np.tensordot(irradiance, parallel(angle, fine, np.sin(t), np.cos(t)), 1)
    whole = np.asarray(diffusely_lit(angle, (FIRST, SECOND), VIEWS, fine))
    light = DiffuseWithTrap(polar, phi, h)
    assert irradiance.sum() == pytest.approx(float(illumination.disk_irradiance(light)), abs=1e-12)
    wanted = (whole - dark) / (1 - irradiance.sum())
    np.testing.assert_allclose(wanted[0, 2], 1, atol=0.5)
    for tolerance in tolerances:
        plan, spread = planned(tolerance, a), resolution.clustering(tolerance, None)
        found = trapped(angle, light, plan, spread)
        np.testing.assert_allclose(found, wanted, rtol=0, atol=tolerance + floor)


def test_open_scenes_are_closed_forms() -> None:
    """Known to be open, a ring and a trap need no nodes; one of them open, half the work: the same, to 1e-12."""
    angle, plan, nodes = jnp.asarray(1.8), planned(1e-13, 1.8), resolution.clustering(1e-13, None)
    trap = DiffuseWithTrap(-0.14, 0.3, 0.1)

    @partial(jax.jit, static_argnums=(1, 2, 3))
    def both(polar: Any, lit: bool, seen: bool, alike: bool) -> Any:
        views: Any = tuple(c[:2] for c in VIEWS) if seen else VIEWS
        panels = (FIRST, FIRST if alike else SECOND)
        dark = radiosity.trapped(angle, panels, alike, trap, views, plan, nodes, lit, seen)
        return jnp.stack([radiosity.annular(angle, panels, alike, polar, views, plan, nodes, lit, seen), dark])[
            :, :2
        ]

    for alike in (False, True):
        general = both(0.6, False, False, alike)
        for seen in (False, True):
            np.testing.assert_allclose(both(0.6, True, seen, alike), general, rtol=0, atol=1e-12)
        np.testing.assert_allclose(
            both(1.2, False, True, alike), both(1.2, False, False, alike), rtol=0, atol=1e-12
        )
    none = DiffuseWithTrap(-0.14, 0.3, 0.0)
    wanted = diffusely_lit(angle, (FIRST, SECOND), VIEWS, plan)
    np.testing.assert_allclose(trapped(angle, none, plan, nodes), wanted, rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    "light",
    [
        pytest.param(Annular(0.8), id="ring"),
        pytest.param(DiffuseWithTrap(0.5, 0.3, 0.4), id="trap", marks=pytest.mark.slow),
    ],
)
def test_profiles(light: Any) -> None:
    """Local radiance is the sum over the same lights; its jump at every shadow edge is summed exactly."""
    a = 0.9
    angle, fine = jnp.asarray(a), planned(1e-12, a)
    position = jnp.asarray([0.0, 0.02, 0.2, 0.7, 1.0])
    edges = np.arctan(np.tan(a / 2) * (1 + np.asarray(position[:-1])) / (1 - np.asarray(position[:-1])))
    profile = partial(radiosity.local_radiance, angle=angle, reflectances=(FIRST, SECOND), position=position)
    if isinstance(light, Annular):
        kinks = np.arccos(np.minimum(np.tan(edges) / np.tan(0.8), 1))
        phi, weight = graded([*kinks, *(np.pi - kinks)], 0.0, np.pi)
        t, weight = np.arctan(np.tan(0.8) * np.cos(phi)), weight / np.pi
    else:
        low, high = (float(v) for v in illumination.shadow_sections(light))
        middle, reach = (low + high) / 2, (high - low) / 2
        t, weight = graded([*edges, *-edges], middle - reach, middle + reach)
        x, y, z = (float(c) for c in components(light.polar, light.azimuth))
        away = np.hypot(y, z) * np.cos(t - middle)
        w, eta = np.arccos(np.minimum(np.cos(0.4) / np.hypot(x, away), 1)), np.arctan2(x, away)
        weight = weight * np.cos(t) * (w + np.cos(2 * eta) * np.sin(2 * w) / 2) / np.pi

    @jax.jit
    def lit(t: Any) -> Any:
        return jax.lax.map(lambda t: profile(Directional(t, 0.0), plan=fine), t, batch_size=32)

    wanted = np.tensordot(weight, np.asarray(lit(jnp.asarray(t))), 1)
    if isinstance(light, DiffuseWithTrap):
        wanted = (np.asarray(profile(Diffuse(), plan=fine)) - wanted) / (1 - weight.sum())
    nodes = resolution.clustering(1e-8, None)
    found = jax.jit(partial(profile, plan=planned(1e-8, a), clustering=nodes))(light)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-8)


def at_angle(
    kind: str, plan: Any, nodes: Any, angle: Any, polar: Any = 0.9, shift: Any = 0.0, size: Any = 0.3
) -> Any:
    """Scenes of every kind; shift lowers the reflectances, size is a half-angle."""
    view = tuple(c[2:3] for c in VIEWS)
    panels = (FIRST - shift, SECOND - shift)
    polar = jnp.asarray(polar)
    if kind == "ring":
        return radiosity.annular(angle, panels, False, polar, view, plan, nodes, False, False)[0]
    if kind == "ring, hemisphere":
        return radiosity.annular_hemispherical(angle, panels, False, polar, plan, nodes, False)
    if kind == "trap":
        trap = DiffuseWithTrap(polar, jnp.asarray(0.3), size)
        return radiosity.trapped(angle, panels, False, trap, view, plan, nodes, False, False)[0]
    if kind == "parallel":
        light = Directional(polar, jnp.asarray(0.3))
        return radiosity.directional(angle, panels, False, light, view, plan)[0]
    return radiosity.bihemispherical(angle, panels, False, plan)


def onsets(kind: str) -> Any:
    light: Any = {"ring": Annular(0.9), "trap": DiffuseWithTrap(0.9, 0.3, 0.3), "parallel": Directional(0.9, 0.3)}
    if kind == "hemispheres":
        return jnp.zeros(0)
    found = illumination.shadow_sections(light[kind.split(",")[0]])
    return found if "," in kind else jnp.append(found, SECTIONS[2])


def averaged(kind: str, m: Any, slopes: Any, tolerance: float, roughest: float) -> Any:
    cutoff = resolution.slope_cutoff(tolerance)
    plan = planned(tolerance, 2 * np.arctan2(1, roughest * cutoff))
    function = partial(at_angle, kind, plan, resolution.clustering(tolerance, None))
    spread = resolution.average_clustering(tolerance)
    general = None if kind == "hemispheres" else function
    return roughness.lambertian_average(m, onsets(kind), function, general, spread, cutoff, slopes)


KINDS = ("hemispheres", "ring", "ring, hemisphere", "trap", "parallel")


@pytest.mark.parametrize("kind", ["hemispheres", *(pytest.param(k, marks=pytest.mark.slow) for k in KINDS[1:])])
def test_random_grooves(kind: str) -> None:
    """Within the tolerance of a graded sum over the angle."""
    roughest = 2.0
    m, cutoff = np.array([0.3, roughest]), 8.0
    least = 2 * np.arctan2(1, roughest * cutoff)
    fine, nodes = planned(1e-11, least), resolution.clustering(1e-11, None)
    alpha, weight = graded([*(2 * np.asarray(onsets(kind))), 0.3], least, np.pi)
    keep = weight > 1e-13
    alpha, weight = alpha[keep], weight[keep]
    one = partial(at_angle, kind, fine, nodes)
    values = np.asarray(jax.jit(lambda a: jax.lax.map(one, a, batch_size=16))(jnp.asarray(alpha)))
    u = 1 / (np.tan(alpha / 2) * m[:, None])
    for slopes in ("beckmann", "gaussian"):
        density = (u if slopes == "beckmann" else np.sqrt(2 / np.pi)) * np.exp(-u * u / 2)
        wanted = weight * density / (2 * m[:, None] * np.sin(alpha / 2) ** 2) @ values
        for tolerance in (1e-3, 1e-8):
            program = jax.jit(lambda m, s=slopes, t=tolerance: averaged(kind, m, s, t, roughest))
            found = np.stack([program(jnp.asarray(x)) for x in m])
            np.testing.assert_allclose(found, wanted, rtol=0, atol=tolerance)


def slopes_agree(function: Callable[..., Any], *arguments: float, step: float = 1e-4) -> None:
    """Gradients in every argument against differences of fourth order, to 1e-6 relative."""
    program = jax.jit(lambda x: function(*x))
    x = np.array(arguments)
    found = np.asarray(jax.jit(jax.jacfwd(lambda x: function(*x)))(jnp.asarray(x)))
    assert np.all(np.isfinite(found))
    for i in range(len(x)):
        moved = [np.asarray(program(jnp.asarray(x + k * step * np.eye(len(x))[i]))) for k in (-2, -1, 1, 2)]
        wanted = (moved[0] - 8 * moved[1] + 8 * moved[2] - moved[3]) / (12 * step)
        np.testing.assert_allclose(found[..., i], wanted, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize(
    "kind", [pytest.param(k, marks=pytest.mark.slow) if k != "hemispheres" else k for k in KINDS]
)
def test_gradients(kind: str) -> None:
    """In angle, polar angle, reflectances and half-angle; finite at the ends of their ranges."""
    function = partial(at_angle, kind, planned(1e-12, 0.5), resolution.clustering(1e-12, None))
    slopes_agree(function, 0.8, 0.9, 0.001, 0.25)
    gradient = jax.jit(jax.jacfwd(lambda x: function(*x)))
    ends = [(np.pi, 0.9, 0.3, 0.0), (0.8, 0.0, 0.0, 0.2), (0.8, 0.4, 0.0, 0.0), (0.8, 1.2, 0.3, 0.3)]
    ends += [(0.8, np.pi / 2, 0.0, 0.1), (np.pi, np.pi / 2, 0.0, 0.1)] if "ring" in kind else []
    for end in ends:
        assert np.all(np.isfinite(np.asarray(gradient(jnp.asarray(end))))), end


@pytest.mark.slow
def test_gradients_in_roughness() -> None:
    """Down to the flat surface, where the mean of the panels' reflectances is left."""
    for kind in ("hemispheres", "ring, hemisphere"):
        function = partial(averaged, kind, slopes="gaussian", tolerance=1e-6, roughest=1.0)
        program, gradient = jax.jit(function), jax.jit(jax.jacfwd(function))
        found = (program(jnp.asarray(0.401)) - program(jnp.asarray(0.399))) / 0.002
        np.testing.assert_allclose(gradient(jnp.asarray(0.4)), found, rtol=0, atol=2e-5)
        np.testing.assert_allclose(program(jnp.asarray(0.0)), (FIRST + SECOND) / 2, rtol=0, atol=1e-6)
        assert np.all(np.isfinite(gradient(jnp.asarray(0.0))))
