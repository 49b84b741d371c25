"""Randomly grooved surfaces: records for mirrors, an independent average for diffusers, both limits."""

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
from vcavity_jax import roughness

TRUTH: list[dict[str, Any]] = json.loads((Path(__file__).parents[1] / "data" / "specular.json").read_text())[
    "beckmann_hdr"
]
MODELS = {"exact": "full", "unpol": "unpolarized", "sep": "separate"}


@pytest.fixture(autouse=True, scope="module")
def _forget_programs() -> Iterator[None]:
    yield
    jax.clear_caches()


def rough(m: Any, material: Any, polar: Any, azimuth: Any) -> vc.Scene:
    return vc.Scene(vc.BeckmannGrooves(m), material, vc.Diffuse(), vc.View(polar, azimuth))


@cache
def grooves(tolerance: float, specular: bool) -> Any:
    """Reflectance factor of V-grooves of many angles, one view: what an average is made of."""

    def one(angle: Any, parameter: Any, polar: Any, azimuth: Any) -> Any:
        material = vc.Specular(parameter) if specular else vc.Lambertian(parameter)
        view = vc.View(polar, azimuth)
        return vc.reflectance_factor(vc.Scene(vc.VGrooves(angle), material, vc.Diffuse(), view), tolerance)

    return jax.jit(jax.vmap(one, in_axes=(0, None, None, None)))


@pytest.mark.parametrize("model", MODELS)
def test_records(model: Any) -> None:
    """1e-8 at a tolerance of 1e-8. Measured 4e-10: six to eight digits of a panel of smooth angles."""
    records = [r for r in TRUTH if r["model"] == model]
    assert len(records) > 70

    @jax.jit
    @jax.vmap
    def one(m: Any, polar: Any, azimuth: Any, index: Any) -> Any:
        return vc.reflectance_factor(rough(m, vc.Specular(index, MODELS[model]), polar, azimuth), 1e-8)

    value = one(
        jnp.asarray([float(r["m"]) for r in records]),
        jnp.radians(jnp.asarray([float(r["theta_deg"]) for r in records])),
        jnp.radians(jnp.asarray([float(r["phi_deg"]) for r in records])),
        jnp.asarray([r["n"] + 1j * r["k"] for r in records]),
    )
    np.testing.assert_allclose(value, [r["R"] for r in records], rtol=0, atol=1e-8)


@pytest.mark.parametrize("m", [0.05, 0.5, 5.0])
def test_records_as_planned(m: float) -> None:
    """The same with a roughness that is known: fewer kinks are resolved, the bound is the same."""
    records = [r for r in TRUTH if r["m"] == m and r["model"] == "exact"]
    views = sorted({(r["theta_deg"], r["phi_deg"]) for r in records})
    indices = sorted({(r["n"], r["k"]) for r in records})
    polar, azimuth = np.radians(np.array(views, float)).T
    material = vc.Specular(np.array([n + 1j * k for n, k in indices]))
    value = np.asarray(vc.reflectance_factor(rough(m, material, polar, azimuth), 1e-8))
    for r in records:
        found = value[views.index((r["theta_deg"], r["phi_deg"])), indices.index((r["n"], r["k"]))]
        assert found == pytest.approx(r["R"], rel=0, abs=1e-8), r


def test_planned_shortcuts_are_the_general_path() -> None:
    """Frontal views are symmetric and separate, glass is real: all that drops out changes nothing, to 1e-10.

    Tolerance 1e-10: the panels are cut at different kinks for traced and known roughness.
    """

    @jax.jit
    def general(m: Any, index: Any, polar: Any, azimuth: Any) -> Any:
        return vc.reflectance_factor(rough(m, vc.Specular(index), polar, azimuth), 1e-10)

    polar, azimuth = jnp.radians(jnp.asarray([0.0, 50.0, 40.0])), jnp.radians(jnp.asarray([0.0, 90.0, 0.0]))
    wanted = general(jnp.asarray(0.7), jnp.asarray(1.5 + 0j), polar, azimuth)
    for i in range(3):
        planned = vc.reflectance_factor(
            rough(0.7, vc.Specular(1.5), np.asarray(polar[i]), np.asarray(azimuth[i])), 1e-10
        )
        assert float(planned) == pytest.approx(float(wanted[i]), rel=0, abs=2e-10)


def test_density_integrates_to_one() -> None:
    """The nodes carry the whole density but the steep tail, which is known: exp(-U²/2)."""
    for cutoff in (3.0, 6.1, 8.5):
        ends = jnp.linspace(0, cutoff, 12)
        _, weight = roughness.panel_nodes(ends[:-1], ends[1:], 16)
        total = float(jnp.sum(weight)) + roughness.tail_weight(cutoff)
        assert total == pytest.approx(1, abs=1e-14)


def average(m: float, parameter: Any, polar: float, azimuth: float, specular: bool, order: int) -> float:
    """R_m by a plain sum over u, fine enough to need no kinks: 400 panels of the angle, α from 0 to π.

    ∫ u exp(-u²/2) R(α(u)) du with u = cot(α/2)/m, taken in α: du = dα / (2 m sin²(α/2)).
    """
    x, weight = np.polynomial.legendre.leggauss(order)
    onset = 2 * abs(np.arctan2(np.sin(polar) * np.cos(azimuth), np.cos(polar)))
    least = 2 * np.arctan2(1, 9 * m)
    marks = np.sort(np.clip(np.concatenate([least + (np.pi - least) * np.linspace(0, 1, 200) ** 2, [onset]]), least, np.pi))
    half = np.diff(marks)[:, None] / 2
    alpha = ((marks[:-1] + marks[1:])[:, None] / 2 + half * x).ravel()
    u = 1 / (np.tan(alpha / 2) * m)
    density = (half * weight).ravel() * u * np.exp(-u * u / 2) / (2 * m * np.sin(alpha / 2) ** 2)
    values = grooves(1e-11, specular)(
        jnp.asarray(alpha), jnp.asarray(parameter), jnp.asarray(polar), jnp.asarray(azimuth)
    )
    return float(density @ np.asarray(values))


@pytest.mark.parametrize(
    ("m", "polar", "azimuth"), [(0.1, 0.0, 0.0), (0.5, 1.2, 0.0), (1.0, 0.9, 0.6), (2.0, 1.0, np.pi / 2)]
)
def test_diffusers_are_averages_of_grooves(m: float, polar: float, azimuth: float) -> None:
    """1e-9 at a tolerance of 1e-9; the plain sum ends its panels at the onset of masking and has 1e-11."""
    reflectance = 0.85
    wanted = average(m, reflectance, polar, azimuth, specular=False, order=4)
    found = vc.reflectance_factor(rough(m, vc.Lambertian(reflectance), polar, azimuth), 1e-9)
    assert float(found) == pytest.approx(wanted, rel=0, abs=1e-9)


def test_smooth_limit_is_the_flat_surface() -> None:
    """m = 0, exactly; and m = 1e-4 departs by order m, the grooves that are left."""
    polar, azimuth = np.radians([0.0, 40.0, 70.0]), 0.5
    for material in (vc.Specular(0.35 + 2.7j), vc.Lambertian(0.4)):
        flat = vc.reflectance_factor(vc.Scene(vc.VGrooves(np.pi), material, vc.Diffuse(), vc.View(polar, azimuth)))
        smooth = vc.reflectance_factor(rough(0.0, material, polar, azimuth))
        np.testing.assert_allclose(smooth, flat, rtol=0, atol=1e-8)
        almost = vc.reflectance_factor(rough(1e-4, material, polar, azimuth))
        np.testing.assert_allclose(almost, flat, rtol=0, atol=1e-3)


def test_roughness_darkens() -> None:
    """Errata: black glass, m = 0.05 is 2.1 % darker than flat; for diffusers every m lowers the reflectance."""
    m = jnp.asarray([0.0, 0.05, 0.2, 0.5, 1.0, 2.0, 5.0])

    @jax.jit
    @jax.vmap
    def one(m: Any) -> Any:
        return vc.reflectance_factor(rough(m, vc.Lambertian(jnp.asarray(0.6)), jnp.asarray(0.3), jnp.asarray(0.2)))

    assert np.all(np.diff(np.asarray(one(m))) < 0)
