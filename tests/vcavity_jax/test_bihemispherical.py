"""Mirrors under diffuse light, all light collected: records, closed forms, tolerances, tables, gradients."""

import json
from functools import cache, partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import vcavity_jax as vc
from vcavity_jax import bihemispherical, resolution
from vcavity_jax.angle_table import BihemisphericalTable, average
from vcavity_jax.resolution import angle_table_resolution, bihemispherical_orders
from vcavity_jax.specular import hemispherical_directional

TRUTH: dict[str, Any] = json.loads((Path(__file__).parents[1] / "data" / "specular.json").read_text())
MODELS: dict[str, Any] = {"exact": "full", "unpol": "unpolarized", "sep": "separate"}
SILVER, SILICON, GLASS, ENZ = 0.1249 + 3.3391j, 4.08 + 0.03j, 1.5 + 0j, 0.5 + 0.01j


@cache
def program(tolerance: float, wide: float | None, model: Any = "full", tame: bool = True) -> Any:
    """Pairs of angle and index, one after the other: none waits for a narrower groove."""
    orders = bihemispherical_orders(tolerance, None if wide is None else float(np.radians(wide)), tame)

    def one(pair: tuple[Any, Any]) -> Any:
        return bihemispherical.specular(*pair, model, orders)

    return jax.jit(lambda angle, index: jax.lax.map(one, (angle, index)))


def evaluate(tolerance: float, wide: float | None, degrees: Any, index: Any, **options: Any) -> np.ndarray:
    angle, index = np.broadcast_arrays(np.radians(degrees), np.asarray(index, complex))
    return np.asarray(program(tolerance, wide, **options)(jnp.asarray(angle), jnp.asarray(index)))


@pytest.mark.parametrize("model", MODELS)
def test_records(model: str) -> None:
    """Measured: 1e-12 for an asked 1e-10."""
    records = [r for r in TRUTH["bihemi"] if r["model"] == model]
    assert len(records) > 30
    degrees, index = [r["alpha_deg"] for r in records], [r["n"] + 1j * r["k"] for r in records]
    value = evaluate(1e-10, None, degrees, index, model=MODELS[model])
    np.testing.assert_allclose(value, [r["bihemi"] for r in records], rtol=0, atol=1e-10)


def random_indices(random: np.random.Generator, size: int) -> np.ndarray:
    """Glass, weakly and strongly absorbing, metals, and hard ones."""
    near_one = 1 + 10 ** random.uniform(-4, 0.48, size)
    columns = [
        near_one + 0j,
        near_one + 1j * 10 ** random.uniform(-4, 1, size),
        random.uniform(0.05, 3, size) + 1j * random.uniform(0.5, 8, size),
        random.choice(
            [50, 1 + 20j, 0.2 + 20j, 1.0001, 1.001, 1e3, 3 + 100j, 1 + 300j, 1.00001, 1.04 + 0.05j], size
        ),
    ]
    return np.choose(random.integers(0, len(columns), size), columns)


def assert_tolerance(size: int, tolerances: tuple[float, ...], ranges: list[tuple[float, float]]) -> None:
    random = np.random.default_rng(71)
    for low, high in ranges:
        degrees, index = random.uniform(low, high, size), random_indices(random, size)
        kept = bihemispherical.is_tame(index)
        assert kept.mean() > 0.8
        degrees, index = degrees[kept], index[kept]
        # The finest sampling resolves more than any tolerance asks for.
        exact = evaluate(1e-15, None, degrees, index)
        for tolerance in tolerances:
            error = np.abs(evaluate(tolerance, (low + high) / 2, degrees, index) - exact)
            assert error.max() < tolerance, (tolerance, degrees[error.argmax()], index[error.argmax()])


def test_tolerance() -> None:
    assert_tolerance(20, (1e-3, 1e-7), [(25, 60), (170, 180)])


@pytest.mark.slow
def test_tolerance_300_cases() -> None:
    ranges: list[tuple[float, float]] = [(5, 25), (25, 60), (60, 90), (90, 170), (170, 180)]
    assert_tolerance(70, (1e-3, 1e-6, 1e-8, 1e-10, 1e-12, 1e-13), ranges)


def test_sums() -> None:
    """A white furnace, the shares of the numbers of reflections in it, the published ones of silver, Duntley."""
    shares = jax.jit(
        jax.vmap(
            lambda a, n: bihemispherical.by_reflections(a, n, 5, "full", bihemispherical_orders(1e-13, None, True))
        )
    )
    degrees = np.array([90, 60, 101.3, 47, 180, 45])
    white, silver = (np.asarray(shares(jnp.radians(degrees), jnp.full(6, n))) for n in (1e9j, SILVER))
    # κ |q|² cancels against r_s to 1e-9 for such an index.
    np.testing.assert_allclose(white.sum(axis=1), 1, rtol=0, atol=1e-8)
    assert np.all(white >= 0)
    np.testing.assert_allclose(white[0, :2], [2 - np.sqrt(2), np.sqrt(2) - 1], rtol=0, atol=1e-8)
    np.testing.assert_allclose(white[1, :2], [2 - np.sqrt(3), (4 * np.sqrt(3) - 6) / 2], rtol=0, atol=1e-8)
    published = np.array([0.146005, 0.404548, 0.727533, 0.895879])
    np.testing.assert_allclose(np.cumsum(silver[5])[:4], published, rtol=0, atol=6e-7)
    np.testing.assert_allclose(silver.sum(axis=1), evaluate(1e-13, None, degrees, SILVER), rtol=0, atol=1e-13)
    # [Duntley 1942]: the diffuse reflectance of glass.
    np.testing.assert_allclose(evaluate(1e-13, None, [180.0], GLASS), 0.0917779593423510, rtol=0, atol=1e-13)


def test_average_of_the_views() -> None:
    """Against a mean of the hemispherical-directional reflectance; its kinks leave an error of 2e-5 there."""
    points = (np.arange(500) + 0.5) / 500
    sine, azimuth = np.sqrt(points)[:, None], np.pi / 2 * points
    view = tuple(
        jnp.asarray(np.broadcast_to(c, (500, 500)).ravel())
        for c in (sine * np.sin(azimuth), sine * np.cos(azimuth), np.sqrt(1 - sine**2))
    )
    mean = jax.jit(lambda angle, index: jnp.mean(hemispherical_directional(angle, *view, index)))
    for degrees, index in ((75.0, SILICON), (38.0, 0.5 + 0j), (130.0, 0.9 + 0j), (52.0, ENZ)):
        value = evaluate(1e-6, None, [degrees], [index], tame=False)[0]
        assert abs(value - mean(jnp.radians(degrees), jnp.asarray(index))) < 1e-4, (degrees, index)


@pytest.mark.slow
def test_total_external_reflection() -> None:
    """Flat surfaces, whose one integral can be split where it begins, and finer sampling for all others."""
    indices = np.array([0.5, 0.9, 0.99, 0.3, ENZ, 0.5 + 0.1j, 0.1 + 0.1j, 0.26 + 0.24j])
    assert not np.any(bihemispherical.is_tame(indices))
    np.testing.assert_array_equal(
        bihemispherical.is_tame(indices),
        ~np.asarray(bihemispherical.critical_cosine(jnp.asarray(indices**2 - 1))[0]),
    )
    t, weight = np.polynomial.legendre.leggauss(400)
    t, weight = (1 + t) / 2, weight / 2
    for index, value in zip(indices, evaluate(1e-8, None, 180.0, indices, tame=False), strict=True):
        begin = np.sqrt(1 - index**2 + 0j).real
        total = 0.0
        for start, sign, length in ((begin, -1, begin), (begin, 1, 1 - begin)):
            c = start + sign * length * t**4
            g = np.sqrt(index**2 - 1 + c**2 + 0j)
            r_s, r_p = (c - g) / (c + g), (index**2 * c - g) / (index**2 * c + g)
            total += np.sum(weight * 4 * length * t**3 * c * (np.abs(r_s) ** 2 + np.abs(r_p) ** 2))
        assert abs(value - total) < 1e-8, index
    degrees = np.resize([30.0, 47.0, 77.0, 90.0, 125.0], len(indices))
    rough, fine = (evaluate(tolerance, None, degrees, indices, tame=False) for tolerance in (1e-6, 1e-8))
    np.testing.assert_allclose(rough, fine, rtol=0, atol=2e-6)


@pytest.mark.slow
@pytest.mark.parametrize("tame", [True, False])
def test_gradients(tame: bool) -> None:
    """Both modes, jitted with everything known, against differences of the value."""
    index = jnp.asarray([SILVER, SILICON, GLASS] if tame else [SILVER, ENZ, 0.6 + 0.2j])
    orders = bihemispherical_orders(1e-8, None, tame)
    model: Any = "full" if tame else "separate"  # whose programs are compiled in half the time
    weights = jnp.asarray([1.0, 0.7, -2.0])

    def value(angle: Any, n: Any, k: Any) -> Any:
        return weights @ bihemispherical.specular(angle, jax.lax.complex(n, k), model, orders)

    arguments = (jnp.asarray(0.83), index.real, index.imag)
    reverse = jax.jit(lambda: jax.grad(value, (0, 1, 2))(*arguments))()
    direction = (jnp.asarray(0.4), jnp.asarray([1.0, -0.5, 0.3]), jnp.asarray([0.2, 0.7, -1.0]))
    forward = jax.jit(lambda: jax.jvp(value, arguments, direction)[1])()
    contracted = sum(jnp.sum(g * d) for g, d in zip(reverse, direction, strict=True))
    np.testing.assert_allclose(forward, contracted, rtol=1e-10)
    compiled = jax.jit(value)
    for position in range(3):
        for i in range(arguments[position].size):
            unit = jnp.zeros(arguments[position].size).at[i].set(1.0).reshape(arguments[position].shape)

            def moved(h: float, position: int = position, unit: Any = unit) -> Any:
                return compiled(*(a + h * unit if j == position else a for j, a in enumerate(arguments)))

            h = 1e-3 if tame else 2e-4
            # k may not change its sign.
            if position == 2 and arguments[2][i] == 0:
                difference = (-11 * moved(0) + 18 * moved(h) - 9 * moved(2 * h) + 2 * moved(3 * h)) / (6 * h)
                rtol = 1e-4
            else:
                near, far = (moved(s * h) - moved(-s * h) for s in (1, 2))
                difference, rtol = (8 * near - far) / (12 * h), 1e-7
            np.testing.assert_allclose(jnp.ravel(reverse[position])[i], difference, rtol=rtol, atol=1e-9)


def test_where_reflections_set_in() -> None:
    """At π/k both numbers of reflections give one value and one slope; all is finite, there and at 0.1 degrees."""
    orders = bihemispherical_orders(1e-8, None, True)

    def value(angle: Any, count: Any) -> Any:
        return bihemispherical.specular(angle, jnp.asarray([SILVER, GLASS]), "full", orders, count)

    with_slope = jax.jit(lambda a, m: (value(a, m), jax.jacfwd(value)(a, m)))
    for k in (1, 2, 3, 7):
        angle = jnp.asarray(np.pi / k)
        one, other = (with_slope(angle, jnp.asarray(float(m))) for m in (k, k + 1))
        for a, b in zip(one, other, strict=True):
            np.testing.assert_allclose(a, b, rtol=0, atol=1e-7)
    narrow = with_slope(jnp.radians(0.1), jnp.asarray(1800.0))
    assert np.all(np.isfinite(narrow))
    assert np.all(np.asarray(narrow[0]) > 0)


@pytest.mark.parametrize("model", [pytest.param("exact", marks=pytest.mark.slow), "unpol", "sep"])
def test_random_grooves(model: str) -> None:
    """Records at 1e-10 for full polarization, at 1e-6 for the others; one call and table are the same."""
    tolerance = 1e-10 if model == "exact" else 1e-6
    records = [r for r in TRUTH["beckmann_bihemi"] if r["model"] == model]
    assert len(records) > 10
    materials = sorted({(r["n"], r["k"]) for r in records})
    index = jnp.asarray([complex(*m) for m in materials])
    points = angle_table_resolution(tolerance, 2.0, True)
    table = jax.jit(lambda: BihemisphericalTable.build(index, MODELS[model], points))()
    averages = jax.jit(jax.vmap(table.average))(jnp.asarray([r["m"] for r in records]))
    value = [row[materials.index((r["n"], r["k"]))] for row, r in zip(np.asarray(averages), records, strict=True)]
    np.testing.assert_allclose(value, [r["R"] for r in records], rtol=0, atol=tolerance)
    if model != "exact":
        return
    once = jax.jit(partial(average, model=MODELS[model], resolution=points))(jnp.asarray(0.5), index)
    np.testing.assert_allclose(once, table.average(jnp.asarray(0.5)), rtol=0, atol=0.2 * tolerance)
    degrees = np.array([180.0, 179.0, 161.0, 120.0, 90.0, 80.0, 60.0, 41.0, 18.0])
    at = jax.jit(jax.vmap(table.at))(jnp.radians(degrees))
    exact = [evaluate(1e-12, None, degrees, n, model=MODELS[model]) for n in index]
    np.testing.assert_allclose(at.T, exact, rtol=0, atol=tolerance)
    assert np.all(np.isnan(table.at(jnp.radians(0.2))))


def test_the_public_table_is_the_model_and_takes_plain_numbers() -> None:
    gold = vc.Specular(np.array([0.43 + 2.455j]), polarization="unpolarized")
    table = vc.bihemispherical_table(gold, 1e-6, roughest=1.0)
    for surface, found in (
        (vc.BeckmannGrooves(0.4), table.average(0.4)),
        (vc.GaussianGrooves(0.4), table.average(0.4, "gaussian")),
        (vc.VGrooves(1.2), table.at(1.2)),
    ):
        scene = vc.Scene(surface, gold, vc.Diffuse(), vc.Hemisphere())
        np.testing.assert_allclose(found, vc.reflectance_factor(scene, 1e-6), rtol=0, atol=2e-6)


@cache
def hard_table(tolerance: float) -> BihemisphericalTable:
    index = jnp.asarray([SILVER, GLASS, 1.001 + 0j, 50 + 0j, 1 + 20j])
    points = angle_table_resolution(tolerance, 1.0, True)
    return jax.jit(lambda: BihemisphericalTable.build(index, "full", points))()


@pytest.mark.slow
@pytest.mark.parametrize("slopes", ["beckmann", "gaussian"])
def test_table_keeps_its_tolerance(slopes: Any) -> None:
    """Against a direct integral in u: no interpolation, all its own sampling. Then down to flat surfaces."""
    table, flat = hard_table(1e-7), evaluate(1e-12, None, 180.0, [SILVER, GLASS, 1.001 + 0j, 50 + 0j, 1 + 20j])
    for m in (0.2, 0.9):
        slopes_at_kinks = [0.0, *(1 / np.tan(np.pi / 2 / np.arange(2, 40)) / m)]
        ends = np.array([u for u in slopes_at_kinks if u < 7] + [7.0])
        ends = np.sort(np.concatenate([ends, ends[:-1] + 0.15 * np.diff(ends)]))
        t, weight = np.polynomial.legendre.leggauss(24)
        u = (ends[:-1, None] + np.diff(ends)[:, None] * (1 + t) / 2).ravel()
        weight = (np.diff(ends)[:, None] * weight / 2).ravel() * np.exp(-u * u / 2)
        weight *= u if slopes == "beckmann" else np.sqrt(2 / np.pi)
        for i, n in enumerate([SILVER, GLASS, 1.001 + 0j, 50 + 0j, 1 + 20j]):
            direct = weight @ evaluate(1e-10, None, np.degrees(2 * np.arctan2(1, m * u)), n)
            assert abs(direct - table.average(jnp.asarray(m), slopes)[i]) < 1e-7, (m, n)
    with_slope = jax.jit(lambda m: (table.average(m, slopes), jax.jacfwd(lambda m: table.average(m, slopes))(m)))
    value, slope = with_slope(jnp.asarray(0.0))
    np.testing.assert_allclose(value, flat, rtol=0, atol=1e-7)
    near, slope_near = with_slope(jnp.asarray(1e-4))
    # R̄ has no slope at α = π.
    np.testing.assert_allclose(near, flat, rtol=0, atol=1e-6)
    np.testing.assert_allclose(np.stack([slope, slope_near]), 0, rtol=0, atol=2e-3)


def test_gradients_of_averages() -> None:
    """By roughness and index, both modes, jitted with everything known."""
    points = angle_table_resolution(1e-5, 0.5, True)
    weights = jnp.asarray([1.0, -0.4])

    def value(m: Any, n: Any, k: Any) -> Any:
        return weights @ average(m, jax.lax.complex(n, k), "full", points, "gaussian")

    arguments = (jnp.asarray(0.31), jnp.asarray([0.35, 4.08]), jnp.asarray([2.7, 0.5]))
    reverse = jax.jit(lambda: jax.grad(value, (0, 1, 2))(*arguments))()
    compiled = jax.jit(value)
    direction = (jnp.asarray(0.5), jnp.asarray([1.0, -0.6]), jnp.asarray([0.3, 0.8]))
    forward = jax.jit(lambda: jax.jvp(value, arguments, direction)[1])()
    contracted = sum(jnp.sum(g * d) for g, d in zip(reverse, direction, strict=True))
    np.testing.assert_allclose(forward, contracted, rtol=1e-11)
    for moving in ((1, 0, 0), (0, 1, 0), (0, 0, 1)):
        unit = [jnp.asarray(float(s)) * d for s, d in zip(moving, direction, strict=True)]

        def moved(h: float, unit: Any = unit) -> Any:
            return compiled(*(a + h * d for a, d in zip(arguments, unit, strict=True)))

        h = 2e-3
        difference = (8 * (moved(h) - moved(-h)) - (moved(2 * h) - moved(-2 * h))) / (12 * h)
        slope = sum(jnp.sum(g * d) for g, d in zip(reverse, unit, strict=True))
        np.testing.assert_allclose(slope, difference, rtol=1e-6)


@pytest.mark.slow
def test_single_precision() -> None:
    """Nothing is promoted, and five digits are right."""
    index = np.array([SILVER, SILICON, GLASS, ENZ])
    exact = evaluate(1e-8, None, 57.0, index, tame=False, model="separate")
    orders, points = bihemispherical_orders(1e-5, None, False), angle_table_resolution(1e-5, 0.5, True)
    single, angle = jnp.asarray(index, jnp.complex64), jnp.asarray(np.radians(57.0), jnp.float32)
    value = jax.jit(lambda: bihemispherical.specular(angle, single, "separate", orders))()
    real = jax.jit(lambda: bihemispherical.specular(angle, single[2].real, "separate", orders))()
    table = jax.jit(lambda: BihemisphericalTable.build(single[:3], "separate", points))()
    others = table.at(angle), table.average(jnp.asarray(0.3, jnp.float32))
    assert all(a.dtype == jnp.float32 for a in (value, real, *others))
    np.testing.assert_allclose(value, exact, rtol=0, atol=2e-5)
    np.testing.assert_allclose(real, exact[2], rtol=0, atol=2e-5)
    np.testing.assert_allclose(others[0], exact[:3], rtol=0, atol=3e-5)


def test_orders_are_static() -> None:
    assert bihemispherical_orders(1e-6, 1.0, True) == bihemispherical_orders(1e-6, 1.0, True)
    assert hash(angle_table_resolution(1e-6, 0.7, True)) == hash(angle_table_resolution(1e-6, 0.9, True))
    assert bihemispherical_orders(1e-6, 1.0, True).critical == 0
    assert isinstance(bihemispherical_orders(1e-6, None, False), resolution.BihemisphericalResolution)
