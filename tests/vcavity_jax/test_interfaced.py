"""Interfaced diffusing grooves: collocation records, flat limits, furnace, reciprocity, planned shortcuts."""

import itertools
import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import vcavity_jax as vc

DATA = Path(__file__).parents[1] / "data"
TRUTH = json.loads((DATA / "interfaced.json").read_text())
MORE = json.loads((DATA / "interfaced-layers.json").read_text())
TRACER = json.loads((DATA / "path-tracer.json").read_text())["records"]
RHO = np.array([0.05, 0.3, 0.6, 0.9, 0.98, 1.0])
VIEWS = [[0, 0], [30, 0], [45, 90], [75, 0]]
ANGLES = (10, 20, 30, 45, 60, 90, 120, 150, 170)
FINEST = 1e-13


@pytest.fixture(autouse=True, scope="module")
def _forget_programs() -> Iterator[None]:
    yield
    program.cache_clear()
    general.cache_clear()
    slopes_of.cache_clear()
    jax.clear_caches()


def slow(*values: Any) -> list[Any]:
    return [pytest.param(value, marks=pytest.mark.slow) for value in values]


def direction(of: Any) -> tuple[Any, Any]:
    return np.radians(float(of[0])), np.radians(float(of[1]))


def traced(of: Any) -> tuple[jax.Array, ...]:
    return () if isinstance(of, str) else tuple(jnp.asarray(angle) for angle in direction(of))


def seen() -> vc.View:
    return vc.View(*np.radians(np.array(VIEWS, float).T))


@cache
def program(degrees: float, diffuse: bool, tolerance: float) -> Callable[..., Any]:
    """At one angle, with everything else unknown when the work is planned but that n ≥ 1.3."""

    @jax.jit
    def run(n: Any, light: Any) -> Any:
        source = vc.Diffuse() if diffuse else vc.Directional(*light)
        scene = vc.Scene(vc.VGrooves(np.radians(degrees)), vc.InterfacedLambertian(RHO, n), source, seen())
        return vc.reflectance_factor(scene, tolerance, smallest_index=1.3)

    return run


def worst_error(degrees: float, tolerance: float) -> float:
    """Largest error over the records of an angle, n > 1, seen in a direction."""
    worst, values = 0.0, {}
    rows = [r for r in TRUTH["rows"] if r["alpha_deg"] == degrees and r["n"] > 1 and r["view"] in VIEWS]
    assert len(rows) > 90
    for row in rows:
        diffuse, key = row["light"] == "diffuse", (row["n"], str(row["light"]))
        if key not in values:
            values[key] = program(degrees, diffuse, tolerance)(jnp.asarray(row["n"]), traced(row["light"]))
        value = values[key][VIEWS.index(row["view"]), int(np.argmin(np.abs(RHO - row["rho"])))]
        specular = row["specular"] if diffuse else 0.0
        worst = max(worst, abs(float(value) - row["reflectance_factor"] - specular))
    return worst


def test_every_record_is_compared() -> None:
    rows = TRUTH["rows"]
    assert {row["alpha_deg"] for row in rows} == set(ANGLES)
    assert all(row["view"] in VIEWS or row["view"] == "hemispherical" for row in rows)
    assert {row["rho"] for row in rows} == set(RHO)
    assert len(rows) > 1800


@pytest.mark.parametrize("degrees", [90, *slow(10, 20, 30, 45, 60, 120, 150, 170)])
def test_records_to_the_last_digits(degrees: float) -> None:
    """Measured: 2e-13 from 45 degrees, 1.3e-13 at 20, 7e-13 at 10, where 1 - κ k̂ is smallest for ρ = 1."""
    assert worst_error(degrees, FINEST) < 1e-12


@pytest.mark.parametrize(
    ("degrees", "tolerance"),
    [
        (45, 1e-10),
        *[pytest.param(a, t, marks=pytest.mark.slow) for a in (10, 20, 60, 120) for t in (1e-10, 1e-8, 1e-4)],
    ],
)
def test_records_keep_the_tolerance(degrees: float, tolerance: float) -> None:
    assert worst_error(degrees, tolerance) < tolerance


def layer_of(row: Any) -> Any:
    if row is None:
        return None
    transmittance = jnp.asarray(float(row["transmittance"]))
    if "coverage" in row:
        return vc.Halftone(jnp.asarray(float(row["coverage"])), transmittance)
    return vc.ColoredLayer(transmittance, "berns" if row["model"] == "berns" else "williams-clapper")


def material_of(row: Any) -> Any:
    n = jnp.asarray(float(row["n"]))
    if "rho_first" in row:
        sides = ("first", "second")
        return vc.TwoPanels(
            *(
                vc.InterfacedLambertian(jnp.asarray(float(row[f"rho_{k}"])), n, layer_of(row[f"layer_{k}"]))
                for k in sides
            )
        )
    treatment = row.get("polarization", "unpolarized")
    return vc.InterfacedLambertian(jnp.asarray(float(row["rho"])), n, layer_of(row.get("layer")), treatment)


@cache
def general(
    structure: Any, diffuse: bool, hemisphere: bool, smallest: float, least: float, tolerance: float
) -> Any:
    @jax.jit
    def run(angle: Any, material: Any, light: Any, view: Any) -> Any:
        source = vc.Diffuse() if diffuse else vc.Directional(*light)
        where = vc.Hemisphere() if hemisphere else vc.View(*view)
        scene = vc.Scene(vc.VGrooves(angle), material, source, where)
        return vc.reflectance_factor(scene, tolerance, smallest_angle=smallest, smallest_index=least)

    return run


def value_of(row: Any, smallest_deg: float, least: float, tolerance: float = FINEST) -> float:
    material, diffuse, hemisphere = material_of(row), row["light"] == "diffuse", row["view"] == "hemispherical"
    smallest = float(np.radians(smallest_deg)) * (1 - 1e-9)
    run = general(jax.tree.structure(material), diffuse, hemisphere, smallest, least, tolerance)
    angle = jnp.radians(jnp.asarray(float(row["alpha_deg"])))
    return float(run(angle, material, traced(row["light"]), traced(row["view"])))


def expected(row: Any) -> float:
    return float(row["total"] if "total" in row else row["reflectance_factor"])


def slanted_pair(row: Any) -> bool:
    return row.get("layer_first") is not None and row["layer_first"]["model"] == "williams-clapper"


def sampled(row: Any) -> bool:
    """Rows of few kinds, so that few programs are compiled."""
    if "rho_first" in row:
        return row["layer_first"] is None
    return row.get("layer") is None or (row["layer"]["model"] == "williams-clapper" and row["light"] == "diffuse")


@pytest.mark.parametrize("whole", [False, *slow(True)])
@pytest.mark.parametrize("group", ["layers", "two_panels", "polarized", "bihemispherical"])
def test_independent_solver(group: str, whole: bool) -> None:
    """Layers, panels that differ, exact polarization, all reflected light. Measured: 2e-13 at worst."""
    rows = [row for row in MORE[group] if not slanted_pair(row) and (whole or sampled(row))]
    assert len(rows) >= 24
    for row in rows:
        assert abs(value_of(row, 24, 1.3) - expected(row)) < 1e-12, row


@pytest.mark.parametrize("n", [2.5, *slow(1.01, 1.05, 2.0)])
def test_low_and_high_indices(n: float) -> None:
    for row in MORE["dispersed_high_n"]:
        if row["n"] == n:
            assert abs(value_of(row, 44, n) - expected(row)) < 1e-12, row


@pytest.mark.parametrize("degrees", [8, *slow(2, 3, 4, 5, 6, 10)])
def test_narrow_grooves_keep_the_default_tolerance(degrees: float) -> None:
    rows = [row for row in MORE["narrow"] if row["alpha_deg"] == degrees]
    assert rows
    for row in rows:
        assert abs(value_of(row, degrees, 1.3, 1e-8) - expected(row)) < 1e-8 + row["difference"], row


@pytest.mark.parametrize("diffuse", [True, *slow(False)])
def test_radiance_along_a_view(diffuse: bool) -> None:
    """Local radiances of the independent solver; the record leaves out the specular component."""
    rows = [row for row in MORE["local"] if "view" in row and (row["light"] == "diffuse") == diffuse]
    rows = [row for row in rows if row["alpha_deg"] >= 45]
    assert len(rows) > 4

    @jax.jit
    def run(angle: Any, light: Any, view: Any, position: Any) -> Any:
        source = vc.Diffuse() if diffuse else vc.Directional(*light)
        material = vc.InterfacedLambertian(0.8, 1.5, specular_included=False)
        return vc.radiance_profile(vc.Scene(vc.VGrooves(angle), material, source, vc.View(*view)), position, 1e-9)

    for row in rows:
        angle = jnp.radians(jnp.asarray(float(row["alpha_deg"])))
        position = np.interp(np.arange(5), np.arange(len(row["y"])), row["y"])
        value = run(angle, traced(row["light"]), traced(row["view"]), position)
        panel = value[0 if row["panel"] == "first" else 1, : len(row["y"])]
        np.testing.assert_allclose(panel, row["radiance"], rtol=0, atol=1e-9, err_msg=str(row))


def test_path_tracer() -> None:
    rows = [row for row in TRACER if row["type"] == "plastic" and row["fdr_int"] == "exact"]
    assert len(rows) >= 10

    @jax.jit
    @jax.vmap
    def run(angle: Any, n: Any, rho: Any, polar: Any, azimuth: Any) -> Any:
        scene = vc.Scene(
            vc.VGrooves(angle), vc.InterfacedLambertian(rho, n), vc.Diffuse(), vc.View(polar, azimuth)
        )
        return vc.reflectance_factor(scene, 1e-6, smallest_angle=0.34, smallest_index=1.3)

    def column(name: str) -> jax.Array:
        return jnp.asarray([float(row[name]) for row in rows])

    angles = (jnp.radians(column(name)) for name in ("alpha_deg", "theta_deg", "phi_deg"))
    angle, polar, azimuth = angles
    value = run(angle, column("ior"), column("rho"), polar, azimuth)
    excess = np.abs(value - column("mean")) - 5 * column("stderr") - 4e-4
    assert np.max(excess) < 0, rows[int(np.argmax(excess))]


def flat(material: vc.InterfacedLambertian, light: Any, view: Any) -> np.ndarray:
    return np.asarray(vc.reflectance_factor(vc.Scene(vc.VGrooves(np.pi), material, light, view), FINEST))


def interface(cosine: float, n: float) -> float:
    """Transmittance of an interface by Fresnel's formulas as they stand in a textbook."""
    inside = np.sqrt(1 - (1 - cosine**2) / n**2)
    s, p = (cosine - n * inside) / (cosine + n * inside), (n * cosine - inside) / (n * cosine + inside)
    return float(1 - (s * s + p * p) / 2)


def averages(n: float, depth: float) -> tuple[float, float]:
    """Diffuse transmittance from outside, and internal reflectance through a layer, by plain quadrature."""
    x, weight = np.polynomial.legendre.leggauss(400)
    mu, weight = (x + 1) / 2, weight / 2
    outside = sum(4 * w * m**3 * interface(m * m, n) for m, w in zip(mu, weight, strict=True))
    critical = np.sqrt(1 - 1 / n**2)
    # Grazing directions are reflected in full.
    mus = critical * mu**4
    total = np.sum(weight * critical * 4 * mu**3 * 2 * mus * np.exp(-2 * depth / mus))
    within = critical + (1 - critical) * mu**2
    back = [1 - interface(np.sqrt(max(1 - n**2 * (1 - m * m), 0.0)), n) for m in within]
    total += np.sum(weight * (1 - critical) * 2 * mu * 2 * within * np.array(back) * np.exp(-2 * depth / within))
    return float(outside), float(total)


N, T, A = 1.5, 0.4, 0.3
ALONE = np.array([0.1, 0.5, 0.95])


@pytest.mark.parametrize("layer", ["none", "berns", "williams-clapper", "halftone"])
def test_flat_limit(layer: str) -> None:
    """[Saunderson1942] and its kin [Berns1993], [WilliamsClapper1953], [ClapperYule1953], 45° : 8° and d : 8°."""
    depth = -np.log(T) if layer == "williams-clapper" else 0.0
    outside, back = averages(N, depth)
    if depth == 0:
        np.testing.assert_allclose(back, 1 - outside / N**2, rtol=1e-12)
        back = 1 - outside / N**2
    light, view = np.cos(np.radians([45.0, 8.0]))
    ways = [np.exp(-depth / np.sqrt(1 - (1 - c * c) / N**2)) for c in (light, view)]
    through = [interface(c, N) * way for c, way in zip((light, view), ways, strict=True)]
    once, twice = {"berns": (T, T * T), "halftone": (1 - A + A * T, 1 - A + A * T * T)}.get(layer, (1.0, 1.0))
    body = ALONE * once**2 / (N**2 * (1 - back * ALONE * twice))
    parts: dict[str, Any] = {
        "none": None,
        "berns": vc.ColoredLayer(T, "berns"),
        "williams-clapper": vc.ColoredLayer(T),
        "halftone": vc.Halftone(A, T),
    }
    material = vc.InterfacedLambertian(ALONE, N, parts[layer])
    where = vc.View(np.radians(8.0))
    np.testing.assert_allclose(
        flat(material, vc.Directional(np.radians(45.0)), where), through[0] * through[1] * body, rtol=0, atol=1e-12
    )
    if layer in ("none", "berns", "halftone"):
        diffuse = 1 - interface(view, N) + outside * through[1] * body
        bound = 1e-13 if layer == "none" else 1e-12
        np.testing.assert_allclose(flat(material, vc.Diffuse(), where), diffuse, rtol=0, atol=bound)


@pytest.mark.parametrize("treatment", ["unpolarized", "full"])
def test_white_furnace(treatment: Any) -> None:
    """ρ = 1 in diffuse light: 1 in every direction and in all, for every angle and index."""
    random = np.random.default_rng(3)
    view = vc.View(random.uniform(-1.57, 1.57, 20), random.uniform(0, 6.28, 20))

    @jax.jit
    def run(angle: Any, n: Any) -> Any:
        material = vc.InterfacedLambertian(1.0, n, None, treatment)
        surface = vc.VGrooves(angle)
        return [
            vc.reflectance_factor(vc.Scene(surface, material, vc.Diffuse(), v), 1e-8, smallest_angle=0.5)
            for v in (view, vc.Hemisphere())
        ]

    for degrees in (31.0, 90.0, 179.0, 180.0):
        for n in (1.0, 1.0001, 1.5, 2.5):
            for value in run(jnp.radians(jnp.asarray(degrees)), jnp.asarray(n)):
                np.testing.assert_allclose(value, 1, rtol=0, atol=1e-12)


def test_reciprocity() -> None:
    random = np.random.default_rng(4)

    @jax.jit
    def run(angle: Any, light: Any, view: Any) -> Any:
        material = vc.InterfacedLambertian(ALONE, 1.5)
        scene = vc.Scene(vc.VGrooves(angle), material, vc.Directional(*light), vc.View(*view))
        return vc.reflectance_factor(scene, 1e-6, smallest_angle=0.4)

    for angle in jnp.asarray(random.uniform(0.4, 3.14, 12)):
        light, view = (tuple(map(jnp.asarray, pair)) for pair in random.uniform(-1.5, 1.5, (2, 2)))
        np.testing.assert_allclose(run(angle, light, view), run(angle, view, light), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("source", [vc.Diffuse(), *slow(vc.Directional(0.7, 0.3))])
def test_index_one_is_the_bare_material(source: Any) -> None:
    """Known, bare panels are computed; traced, 1 is raised by 1e-11. The gradient is that of the right side."""
    view = vc.View(np.array([0.2, -0.9]), 0.1)

    def value(n: Any) -> Any:
        scene = vc.Scene(vc.VGrooves(0.9), vc.InterfacedLambertian(RHO, n), source, view)
        return vc.reflectance_factor(scene, 1e-10)

    bare = vc.reflectance_factor(vc.Scene(vc.VGrooves(0.9), vc.Lambertian(RHO), source, view), FINEST)
    np.testing.assert_allclose(value(1.0), bare, rtol=0, atol=1e-10)
    along = jax.jit(lambda n: jax.jvp(value, (n,), (jnp.ones_like(n),)))
    found, slope = along(jnp.asarray(1.0))
    np.testing.assert_allclose(found, bare, rtol=0, atol=1e-10)
    assert np.isfinite(slope).all()
    # The slope has a cusp at 1, by grazing rays: beside it, it is smooth.
    aside = 1e-3
    four = [np.asarray(along(jnp.asarray(1 + aside + k * 1e-5))[0]) for k in (-2, -1, 1, 2)]
    differences = (8 * (four[2] - four[1]) - (four[3] - four[0])) / 12e-5
    np.testing.assert_allclose(along(jnp.asarray(1 + aside))[1], differences, rtol=1e-4, atol=1e-4)


def test_dispersion_and_layers_are_those_of_each_wavelength() -> None:
    n, t = np.array([1.4, 1.5, 1.7]), np.array([0.2, 0.7, 1.0])
    light, view = vc.Directional(0.5), vc.View(np.array([0.1, 0.9]), 0.4)

    def value(material: Any) -> np.ndarray:
        return np.asarray(vc.reflectance_factor(vc.Scene(vc.VGrooves(1.1), material, light, view), 1e-10))

    together = value(vc.InterfacedLambertian(ALONE, n, vc.ColoredLayer(t)))
    assert together.shape == (2, 3)
    for i in range(3):
        single = value(vc.InterfacedLambertian(ALONE[i], n[i], vc.ColoredLayer(t[i])))
        np.testing.assert_allclose(together[:, i], single, rtol=0, atol=1e-10)


def test_specular_component() -> None:
    """A term of its own: included, excluded, or weighted by the source's solid angle [SaintPierre2020, 5.24]."""
    groove, view = vc.VGrooves(np.radians(45.0)), vc.View(np.array([0.0, 0.3]))

    def value(light: Any, **options: Any) -> np.ndarray:
        return np.asarray(
            vc.reflectance_factor(vc.Scene(groove, vc.InterfacedLambertian(ALONE, 1.5, **options), light, view))
        )

    material = vc.InterfacedLambertian(ALONE, 1.5)
    part = vc.specular_component(vc.Scene(groove, material, vc.Diffuse(), view))
    assert part.shape == (2, 3)
    excluded = value(vc.Diffuse(), specular_included=False)
    np.testing.assert_allclose(value(vc.Diffuse()) - excluded, part, rtol=0, atol=1e-14)
    small = 1e-3
    lit = vc.Directional(0.0, 0.0, solid_angle=small)
    glint = value(lit) - value(vc.Directional())
    # The thesis's r_s: four reflections at 22.5 and 67.5 degrees send all frontal light back.
    np.testing.assert_allclose(glint[0], np.pi / small * 3.33e-5, rtol=2e-3)
    np.testing.assert_allclose(glint, vc.specular_component(vc.Scene(groove, material, lit, view)), rtol=1e-12)
    assert np.all(glint[1] == 0)
    polarized = vc.InterfacedLambertian(ALONE, 1.5, polarization="full")
    exact = vc.specular_component(vc.Scene(groove, polarized, lit, view))
    np.testing.assert_allclose(exact[0], np.pi / small * 8.26e-5, rtol=2e-3)


@cache
def slopes_of(light: str) -> Callable[..., Any]:
    """Value and gradient in angle, index and reflectance, one light and one view."""

    @jax.jit
    def run(angle: Any, n: Any, rho: Any, source: Any, view: Any) -> Any:
        def value(angle: Any, n: Any, rho: Any) -> Any:
            lit = vc.Diffuse() if light == "diffuse" else vc.Directional(*source)
            material = vc.InterfacedLambertian(rho, n, specular_included=False)
            scene = vc.Scene(vc.VGrooves(angle), material, lit, vc.View(*view))
            return vc.reflectance_factor(scene, 1e-12, smallest_angle=0.6)

        return jax.value_and_grad(value, (0, 1, 2))(angle, n, rho)

    return run


@pytest.mark.parametrize("light", ["diffuse", *slow("directional")])
def test_gradients_match_the_records(light: str) -> None:
    rows = [row for row in TRUTH["gradients"] if (row["light"] == "diffuse") == (light == "diffuse")]
    assert len(rows) > 10
    for row in rows:
        angle = jnp.radians(jnp.asarray(float(row["alpha_deg"])))
        numbers = angle, jnp.asarray(row["n"]), jnp.asarray(row["rho"])
        value, slopes = slopes_of(light)(*numbers, traced(row["light"]), traced(row["view"]))
        assert abs(float(value) - row["value"]) < 1e-10
        for slope, name in zip(slopes, ("d_dalpha_per_rad", "d_dn", "d_drho"), strict=True):
            assert abs(float(slope) - row[name]) < 1e-7 * (1 + abs(row[name])), row


KINKS = np.pi / np.array([4, 3, 2, 1])


@pytest.mark.parametrize("light", ["diffuse", *slow("directional")])
def test_gradients_on_kinks_are_finite(light: str) -> None:
    """Frontal light and view, where several kinks meet; programs of the records."""
    frontal = jnp.zeros(()), jnp.zeros(())
    for numbers in itertools.product(KINKS, (1.0, 1.5), (0.0, 0.5, 1.0)):
        found = slopes_of(light)(*map(jnp.asarray, numbers), frontal if light == "directional" else (), frontal)
        assert np.isfinite(jax.tree.leaves(found)).all(), numbers


@pytest.mark.parametrize("kind", ["ink", *slow("halftone")])
def test_gradients_of_layers_match_differences(kind: str) -> None:
    """Transmittance, coverage, and both panels' reflectances, at 1e-7 relative; finite on kinks and at ends."""

    def value(x: jax.Array) -> Any:
        halftone = vc.TwoPanels(
            vc.InterfacedLambertian(x[0], x[1], vc.Halftone(x[2], x[3])), vc.InterfacedLambertian(0.7, x[1])
        )
        ink = vc.InterfacedLambertian(x[0], x[1], vc.ColoredLayer(x[3]))
        surface, view = vc.VGrooves(x[4]), vc.View(0.3, 0.2)
        material, light = (ink, vc.Directional(0.2, 0.5)) if kind == "ink" else (halftone, vc.Diffuse())
        return vc.reflectance_factor(vc.Scene(surface, material, light, view), 1e-12, smallest_angle=0.7)

    run = jax.jit(jax.value_and_grad(value))
    at = jnp.asarray([0.6, 1.45, 0.35, 0.5, 1.05])
    slopes = np.asarray(run(at)[1])
    for i in range(5):
        step = jnp.zeros(5).at[i].set(1e-4)
        near, far = (run(at + k * step)[0] - run(at - k * step)[0] for k in (1, 2))
        differences = np.asarray(8 * near - far) / 12e-4
        np.testing.assert_allclose(slopes[i], differences, rtol=1e-7, atol=1e-8)
    for angle, n, rho in itertools.product(KINKS, (1.0, 1.5), (0.0, 0.5, 1.0)):
        found = run(jnp.asarray([rho, n, rho, rho, angle]))
        assert np.isfinite(jax.tree.leaves(found)[0]).all()
        assert np.isfinite(found[1]).all(), (angle, n, rho)


@pytest.mark.slow
def test_gradients_of_layers_on_kinks_are_finite() -> None:
    @jax.jit
    def slopes(angle: Any, n: Any, rho: Any) -> Any:
        def value(angle: Any, n: Any, rho: Any) -> Any:
            material, view = vc.InterfacedLambertian(rho, n, vc.ColoredLayer(rho)), vc.View(0.0)
            lights = vc.Diffuse(), vc.Directional(0.0)
            parts = [
                vc.reflectance_factor(
                    vc.Scene(vc.VGrooves(angle), material, light, view), 1e-6, smallest_angle=0.7
                )
                for light in lights
            ]
            return sum(parts[1:], start=parts[0])

        return jax.value_and_grad(value, (0, 1, 2))(angle, n, rho)

    for numbers in itertools.product(KINKS, (1.0, 1.5), (0.0, 0.5, 1.0)):
        assert np.isfinite(jax.tree.leaves(slopes(*map(jnp.asarray, numbers)))).all(), numbers


def test_rings_and_traps_are_means_over_directions() -> None:
    """Against the midpoint rule over azimuths, and over a small disk by cubature."""
    material, surface = vc.InterfacedLambertian(np.array([0.3, 0.9]), 1.5), vc.VGrooves(np.radians(50.0))
    view = vc.View(np.array([0.0, 0.7]), 0.2)

    def value(light: Any, tolerance: float = 1e-7) -> np.ndarray:
        return np.asarray(vc.reflectance_factor(vc.Scene(surface, material, light, view), tolerance))

    @jax.jit
    @jax.vmap
    def parallel(polar: Any, azimuth: Any) -> Any:
        return vc.reflectance_factor(vc.Scene(surface, material, vc.Directional(polar, azimuth), view), 1e-7)

    azimuth = (np.arange(720) + 0.5) / 360 * np.pi
    polar, turn, half = -0.3, 0.4, np.radians(3.0)
    center = np.array([np.sin(polar) * np.sin(turn), np.sin(polar) * np.cos(turn), np.cos(polar)])
    aside = np.cross(center, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(center, [0.0, 0.0, 1.0]))
    x, weight = np.polynomial.legendre.leggauss(8)
    squared = np.repeat((x + 1) / 2 * np.sin(half) ** 2, 24)[:, None]
    around = np.tile((np.arange(24) + 0.5) / 12 * np.pi, 8)[:, None]
    across = np.cos(around) * aside + np.sin(around) * np.cross(center, aside)
    rays = center * np.sqrt(1 - squared) + np.sqrt(squared) * across
    share = np.repeat(weight / 48, 24) * rays[:, 2] / center[2] / np.sqrt(1 - squared[:, 0])
    # Ring and disk together: one program.
    polars = np.append(np.full(720, 0.8), np.arccos(rays[:, 2]))
    ring, each = np.split(
        np.asarray(parallel(polars, np.append(azimuth, np.arctan2(rays[:, 0], rays[:, 1])))), [720]
    )
    # 1e-6 is what the kinks leave to the midpoint rule.
    np.testing.assert_allclose(value(vc.Annular(0.8)), np.mean(ring, axis=0), rtol=0, atol=1e-6)
    missing = np.sin(half) ** 2 * center[2]
    dark = missing * np.einsum("i,ijk->jk", share, each)
    trap = vc.DiffuseWithTrap(polar, turn, half)
    mirrored = [
        np.asarray(vc.specular_component(vc.Scene(surface, material, light, view)))
        for light in (vc.Diffuse(), trap)
    ]
    whole = value(vc.Diffuse()) - mirrored[0] + mirrored[1] * (1 - missing)
    np.testing.assert_allclose(value(trap), (whole - dark) / (1 - missing), rtol=0, atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("surface", [vc.BeckmannGrooves, vc.GaussianGrooves])
def test_random_grooves(surface: Any) -> None:
    """Against a fine midpoint rule over the angles, whose error at the kinks is about 1e-6."""
    material, m = vc.InterfacedLambertian(np.array([0.3, 0.9]), 1.5), 0.3
    u = (np.arange(3000) + 0.5) / 500
    density = (u if surface is vc.BeckmannGrooves else 1.0) * np.exp(-u * u / 2)
    for light in (vc.Diffuse(), vc.Directional(0.5, 0.2)):
        view = vc.View(np.array([0.0, 0.7]), 0.2)

        def at(angle: Any, light: Any = light, view: Any = view) -> Any:
            scene = vc.Scene(vc.VGrooves(angle), material, light, view)
            return vc.reflectance_factor(scene, 1e-8, smallest_angle=0.9)

        values = np.asarray(
            jax.jit(lambda angles, at=at: jax.lax.map(at, angles))(2 * jnp.arctan2(1.0, m * jnp.asarray(u)))
        )
        mean = np.einsum("i,ijk->jk", density / np.sum(density), values)
        found = vc.reflectance_factor(vc.Scene(surface(m), material, light, view), 1e-6)
        np.testing.assert_allclose(found, mean, rtol=0, atol=3e-6)


@pytest.mark.slow
@pytest.mark.parametrize("polar", [0.4, 0.8])
def test_alternating_panels_and_equal_panels(polar: float) -> None:
    """Seen in full, which is quick to compile, and masked."""
    first, second = (vc.InterfacedLambertian(rho, 1.5) for rho in (0.9, 0.2))
    view, light = vc.View(np.array([0.0, polar, -polar])), vc.Directional(0.4)

    def value(material: Any) -> np.ndarray:
        return np.asarray(vc.reflectance_factor(vc.Scene(vc.VGrooves(0.9), material, light, view), 1e-10))

    mean = (value(vc.TwoPanels(first, second)) + value(vc.TwoPanels(second, first))) / 2
    np.testing.assert_allclose(value(vc.TwoPanels(first, second, alternating=True)), mean, rtol=1e-13)
    np.testing.assert_allclose(value(vc.TwoPanels(first, first)), value(first), rtol=0, atol=1e-10)


def interfaced(**changes: Any) -> Any:
    return vc.InterfacedLambertian(**({"reflectance": 0.5, "index": 1.5} | changes))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: interfaced(index=0.9), "0.9 is not a refractive index of an interface: expected n ≥ 1"),
        (lambda: interfaced(index=1.5 + 0.1j), "is not the index of a clear interface: expected a real n ≥ 1"),
        (lambda: interfaced(index=np.array([1.5, 0.5])), "0.5 is not a refractive index of an interface"),
        (lambda: interfaced(reflectance=50.0), "50.0 is not a reflectance: expected 0 to 1. Did you pass percent"),
        (lambda: vc.ColoredLayer(1.2), "1.2 is not a transmittance: expected 0 to 1"),
        (lambda: vc.Halftone(-0.1, 0.5), "-0.1 is not a coverage: expected 0 to 1"),
        (lambda: vc.Halftone(0.1, 50.0), "50.0 is not a transmittance: expected 0 to 1"),
        (lambda: interfaced(reflectance=np.ones(3), index=np.full(2, 1.5)), "expected the same wavelengths"),
        (lambda: vc.TwoPanels(interfaced(), interfaced(index=1.4)), "the panels differ in their interface"),
        (
            lambda: vc.TwoPanels(interfaced(), vc.Lambertian(0.5)),
            "one panel has an interface and the other has none",
        ),
        (
            lambda: vc.TwoPanels(interfaced(layer=vc.ColoredLayer(0.5)), interfaced()),
            "two panels with different williams-clapper layers are not modeled",
        ),
        (lambda: vc.Directional(0.1, 0.0, solid_angle=0.0), "0.0 is not a solid angle of a source"),
    ],
)
def test_bad_input_is_refused(make: Callable[[], Any], message: str) -> None:
    with pytest.raises(ValueError, match=message.replace("(", r"\(")):
        make()


@pytest.mark.parametrize(
    ("scene", "message"),
    [
        (lambda m: vc.Scene(vc.VGrooves(0.02), m, vc.Diffuse(), vc.View()), "at least 2 degrees"),
        (
            lambda m: vc.Scene(vc.VGrooves(1.0), vc.Lambertian(0.5), vc.Diffuse(), vc.View()),
            "only interfaced panels",
        ),
        (lambda m: vc.Scene(vc.VGrooves(1.0), m, vc.Directional(0.1), vc.View()), "expected Directional"),
    ],
)
def test_what_is_not_modeled_is_refused(scene: Callable[[Any], Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        vc.specular_component(scene(interfaced()))


def test_bad_parts_are_refused_without_a_type_checker() -> None:
    """What the run-time type check of these tests would see first."""
    cases = {
        "vc.InterfacedLambertian(0.5, 1.5, 0.5)": "0.5 is not a layer: expected ColoredLayer",
        "vc.InterfacedLambertian(0.5, 1.5, polarization='separate')": "is not a polarization of an interfaced",
        "vc.Specular(1.5, layer=vc.ColoredLayer(0.5))": "a layer on a specular material is not modeled",
        "vc.Specular(1.5, vc.ColoredLayer(0.5))": "a layer on a specular material is not modeled",
        "vc.ColoredLayer(0.5, 'beer')": "is not a model of a layer",
    }
    tries = [
        f"try:\n    {case}\nexcept ValueError as error:\n    print(error)\nelse:\n    print()" for case in cases
    ]
    script = "\n".join(["import vcavity_jax as vc", *tries])
    lines = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    ).stdout.splitlines()
    assert len(lines) == len(cases)
    for line, message in zip(lines, cases.values(), strict=True):
        assert message in line


def test_a_traced_value_beyond_the_plan_is_no_number() -> None:
    def value(angle: Any, n: Any) -> Any:
        scene = vc.Scene(vc.VGrooves(angle), vc.InterfacedLambertian(0.5, n), vc.Diffuse(), vc.View())
        return vc.reflectance_factor(scene, 1e-4, smallest_angle=0.8, smallest_index=1.4)

    run = jax.jit(value)
    assert np.isfinite(run(0.9, 1.5))
    assert np.isnan(run(0.7, 1.5))
    assert np.isnan(run(0.9, 1.3))
