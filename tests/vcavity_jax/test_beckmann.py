"""Randomly grooved surfaces: records for mirrors, an independent average for diffusers, both limits."""

import itertools
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
from vcavity_jax.quadrature import legendre_nodes

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
def general_path(model: Any) -> Any:
    """The general path, where nothing is known when the work is planned; columns of equal length."""

    @jax.jit
    @jax.vmap
    def one(m: Any, polar: Any, azimuth: Any, index: Any) -> Any:
        return vc.reflectance_factor(rough(m, vc.Specular(index, model), polar, azimuth), 1e-8)

    return one


def traced(model: Any, m: Any, polar: Any, azimuth: Any, index: Any) -> np.ndarray:
    columns = np.broadcast_arrays(*(np.asarray(c, float) for c in (m, polar, azimuth)), np.asarray(index, complex))
    size = len(columns[0])
    assert size <= 100
    padded = (jnp.asarray(np.resize(c, 100)) for c in columns)  # one length: one program for each model
    return np.asarray(general_path(model)(*padded))[:size]


@pytest.mark.parametrize("model", [m if m == "unpol" else pytest.param(m, marks=pytest.mark.slow) for m in MODELS])
def test_records(model: Any) -> None:
    """1e-8 at a tolerance of 1e-8. Measured 4e-10."""
    records = [r for r in TRUTH if r["model"] == model]
    assert len(records) > 70
    m, polar, azimuth, n, k = (
        np.array([float(r[key]) for r in records]) for key in ("m", "theta_deg", "phi_deg", "n", "k")
    )
    value = traced(MODELS[model], m, np.radians(polar), np.radians(azimuth), n + 1j * k)
    np.testing.assert_allclose(value, [r["R"] for r in records], rtol=0, atol=1e-8)


@pytest.mark.parametrize("m", [0.05, 5.0])
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


def test_shortcuts_are_the_general_path() -> None:
    """Without one side, the coupling and the phase a frontal view of glass is the same, to 1e-13."""
    m, one, zero = jnp.asarray([0.2, 0.7]), jnp.ones(2), jnp.zeros(2)
    rest = {"order": 8, "cutoff": 5.0, "most": 16}

    @jax.jit
    def short(m: Any) -> Any:
        return roughness.specular_average(m, zero, zero, one, 1.5 * one, "separate", True, **rest)

    @jax.jit
    def general(m: Any, index: Any) -> Any:
        return roughness.specular_average(m, zero, zero, one, index, "full", False, **rest)

    np.testing.assert_allclose(short(m), general(m, one.astype(complex) * 1.5), rtol=0, atol=1e-13)


def test_planned_shortcut_keeps_the_records() -> None:
    """The public way to it: a frontal view of glass, known."""
    for r in TRUTH:
        if (
            r["material"] == "black glass"
            and r["theta_deg"] == 0
            and r["model"] == "exact"
            and r["m"] in (0.5, 0.7)
        ):
            found = float(vc.reflectance_factor(rough(r["m"], vc.Specular(1.5), 0.0, 0.0), 1e-8))
            assert found == pytest.approx(r["R"], rel=0, abs=1e-8)


@pytest.mark.parametrize("slopes", ["beckmann", "gaussian"])
def test_density_integrates_to_one(slopes: Any) -> None:
    """All but the steep tail, which is known: exp(-U²/2), erfc(U/√2)."""
    for cutoff in (3.0, 6.1, 8.5):
        ends = jnp.linspace(0, cutoff, 12)
        u, weight = legendre_nodes(ends[:-1], ends[1:], 16)
        total = float(jnp.sum(weight * roughness.density(u, slopes))) + roughness.tail_weight(cutoff, slopes)
        assert total == pytest.approx(1, abs=1e-14)


SPECTRUM = np.array([0.03, 0.3, 0.6, 0.8, 0.93, 0.99, 0.9999, 1.0])


@jax.jit
def grooves(angles: Any, polar: Any, azimuth: Any) -> Any:
    """Reflectance factor of V-grooves of many angles in one view: what an average is made of."""

    def one(angle: Any) -> Any:
        scene = vc.Scene(vc.VGrooves(angle), vc.Lambertian(SPECTRUM), vc.Diffuse(), vc.View(polar, azimuth))
        return vc.reflectance_factor(scene, 1e-12)

    return jax.lax.map(one, angles, batch_size=20)


@cache
def plain_average(m: float, polar: float, azimuth: float) -> np.ndarray:
    """R_m by a plain sum over α: ∫ u exp(-u²/2) R(α(u)) du, u = cot(α/2)/m, du = dα / (2 m sin²(α/2)).

    Panels shrink by halves towards both ends and, from both sides, towards the onset of masking, where R
    departs as a fractional power of the hidden depth. 10 nodes instead of 8 change 1e-14. Beyond u = 8.5: 2e-16.
    """
    x, weight = np.polynomial.legendre.leggauss(8)
    onset = 2 * abs(np.arctan2(np.sin(polar) * np.cos(azimuth), np.cos(polar)))
    least = 2 * np.arctan2(1, 8.5 * m)
    ends = [least, onset, np.pi] if least < onset < np.pi else [least, np.pi]
    graded = np.append(0, 2.0 ** np.arange(-17, 1)) / 2
    marks = [np.linspace(least, np.pi, 20)]
    for low, high in itertools.pairwise(ends):
        marks += [low + (high - low) * graded, high - (high - low) * graded]
    panels = np.unique(np.concatenate(marks))
    half = np.diff(panels)[:, None] / 2
    alpha = ((panels[:-1] + panels[1:])[:, None] / 2 + half * x).ravel()
    u = 1 / (np.tan(alpha / 2) * m)
    density = (half * weight).ravel() * u * np.exp(-u * u / 2) / (2 * m * np.sin(alpha / 2) ** 2)
    size = 900  # one length, one program
    assert len(alpha) <= size
    padded = jnp.asarray(np.append(alpha, np.full(size - len(alpha), 1.0)))
    return density @ np.asarray(grooves(padded, jnp.asarray(polar), jnp.asarray(azimuth)))[: len(alpha)]


QUICK = [(0.4, 1e-6), (0.4, 1e-10), (2.2, 1e-10)]
REST = [(m, t) for m in (0.01, 0.1, 0.4, 1.0, 2.2, 5.0) for t in (1e-3, 1e-6, 1e-10) if (m, t) not in QUICK]


@pytest.mark.parametrize(
    ("m", "tolerance"), [*QUICK, *(pytest.param(*pair, marks=pytest.mark.slow) for pair in REST)]
)
def test_diffusers_are_averages_of_grooves(m: float, tolerance: float) -> None:
    """Within the tolerance of a sum that shares neither nodes nor variable with the library's."""
    polar, azimuth = np.radians([0.0, 20.0, 57.0, 80.0, 60.0]), np.radians([0.0, 17.0, 17.0, 17.0, 90.0])
    found = np.asarray(vc.reflectance_factor(rough(m, vc.Lambertian(SPECTRUM), polar, azimuth), tolerance))
    wanted = [plain_average(m, *view) for view in zip(polar, azimuth, strict=True)]
    np.testing.assert_allclose(found, wanted, rtol=0, atol=tolerance)


def flat(material: Any, polar: Any, azimuth: Any) -> np.ndarray:
    scene = vc.Scene(vc.VGrooves(np.pi), material, vc.Diffuse(), vc.View(polar, azimuth))
    return np.asarray(vc.reflectance_factor(scene))


@pytest.mark.slow
def test_smooth_limit_is_the_flat_surface() -> None:
    """m = 0 to the tolerance; m = 1e-4 departs by order m, since that many facets hide or are hidden."""
    polar, azimuth = np.radians([0.0, 40.0, 70.0]), 0.5
    wanted = flat(vc.Specular(0.35 + 2.7j), polar, azimuth)
    for m, limit in ((0.0, 1e-8), (1e-4, 1e-3)):
        found = traced("full", m, polar, azimuth, np.full(3, 0.35 + 2.7j))
        np.testing.assert_allclose(found, wanted, rtol=0, atol=limit)
        diffuse = jax.jit(lambda m: vc.reflectance_factor(rough(m, vc.Lambertian(0.4), polar, azimuth)))(m)
        np.testing.assert_allclose(diffuse, 0.4, rtol=0, atol=limit)


def test_roughness_darkens() -> None:
    """Every bit of roughness lowers the reflectance of a diffuser in diffuse light."""
    m = jnp.asarray([0.0, 0.2, 0.5, 1.0, 2.0, 5.0])

    @jax.jit
    @jax.vmap
    def one(m: Any) -> Any:
        return vc.reflectance_factor(rough(m, vc.Lambertian(0.6), 0.3, 0.2), 1e-4)

    assert np.all(np.diff(np.asarray(one(m))) < -1e-3)  # ten tolerances
