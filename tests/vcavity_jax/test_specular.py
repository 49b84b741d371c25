"""Mirror grooves under diffuse light: 34-digit records, closed forms, published shares, planned shortcuts."""

import json
from functools import cache
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import vcavity_jax as vc
from vcavity_jax.specular import reflection_shares

TRUTH: list[dict[str, Any]] = json.loads((Path(__file__).parents[1] / "data" / "specular.json").read_text())["hdr"]
MODELS = {"exact": "full", "unpol": "unpolarized", "sep": "separate"}
SHARES = jax.jit(reflection_shares)
MATERIALS = (0.35 + 2.7j, 0.1249 + 3.3391j, 4.08 + 0.03j, 1.5 + 0j, 1.001 + 0j)


def scene(angle: Any, polar: Any, azimuth: Any, index: Any, model: Any = "full") -> vc.Scene:
    return vc.Scene(vc.VGrooves(angle), vc.Specular(index, model), vc.Diffuse(), vc.View(polar, azimuth))


@cache
def general_path(model: Any) -> Any:
    @jax.jit
    @jax.vmap
    def one(angle: Any, polar: Any, azimuth: Any, index: Any) -> Any:
        return vc.reflectance_factor(scene(angle, polar, azimuth, index, model))

    return one


def traced(model: Any, angle: Any, polar: Any, azimuth: Any, index: Any) -> np.ndarray:
    """The general path: nothing is known when the work is planned. Arguments are columns of equal length."""
    columns = np.broadcast_arrays(
        *(np.atleast_1d(np.asarray(c, float)) for c in (angle, polar, azimuth)),
        np.atleast_1d(np.asarray(index, complex)),
    )
    size = len(columns[0])
    # One length for all callers, so that each model is compiled once.
    padded = (jnp.asarray(np.resize(c, 300)) for c in columns)
    assert size <= 300
    return np.asarray(general_path(model)(*padded))[:size]


def columns_of(records: list[dict[str, Any]]) -> tuple[np.ndarray, ...]:
    angle, polar, azimuth = (
        np.radians([r[key] for r in records]) for key in ("alpha_deg", "theta_deg", "phi_deg")
    )
    return angle, polar, azimuth, np.array([r["n"] + 1j * r["k"] for r in records])


def flat_reflectance(cosine: Any, index: Any) -> tuple[np.ndarray, np.ndarray]:
    """Fresnel's reflectances of s and p, as printed in [SaintPierre2020, eq. 2.22 and 2.23]."""
    refracted = np.sqrt(index**2 - 1 + cosine**2 + 0j)
    s = (cosine - refracted) / (cosine + refracted)
    p = (index**2 * cosine - refracted) / (index**2 * cosine + refracted)
    return np.abs(s) ** 2, np.abs(p) ** 2


def assert_exact(value: np.ndarray, truth: np.ndarray) -> None:
    """Absolute 1e-13, relative 1e-12 above 1e-6.

    Rounded angles cost at most 4e-15 (measured). At exact kinks the rounding of the input alone moves the
    value by 1e-16 of the larger of two products, 3e-13 of the value at worst (measured).
    """
    np.testing.assert_allclose(value, truth, rtol=0, atol=1e-13)
    bright = truth > 1e-6
    np.testing.assert_allclose(value[bright], truth[bright], rtol=1e-12, atol=0)


@pytest.mark.parametrize("model", MODELS)
def test_records(model: str) -> None:
    records = [r for r in TRUTH if r["model"] == model]
    assert len(records) > 200
    value = traced(MODELS[model], *columns_of(records))
    assert_exact(value, np.array([r["hdr"] for r in records]))


def test_dark_chains_keep_their_digits() -> None:
    """Down to 1e-300 a product of reflectances is as accurate as its factors: nothing cancels, no logarithms.

    A relative 1e-10 instead of 1e-12: the rounding of an angle weighs R(M-1)/R(M), up to 1e6, times 1e-16.
    """
    records = [r for r in TRUTH if 1e-300 < r["hdr"] < 1e-6 and r["model"] == "exact"]
    records = [r for r in records if not at_kink(r)]
    assert len(records) > 30
    np.testing.assert_allclose(
        traced("full", *columns_of(records)), np.array([r["hdr"] for r in records]), rtol=1e-10, atol=0
    )


def at_kink(record: dict[str, Any]) -> bool:
    """A number of reflections changes within rounding of the record's angle."""
    angle = np.radians(record["alpha_deg"])
    view = scene(angle, np.radians(record["theta_deg"]), np.radians(record["phi_deg"]), 1.5)
    return vc.kink_angles(view, angle * (1 - 1e-9), min(angle * (1 + 1e-9), np.pi)).size > 0


# Each case lets the planning drop another part of the model; the traced path drops nothing.
PLANNED = {
    "frontal: symmetric and separate": (0.0, 0.0, "full"),
    "along the fold: symmetric": (np.radians([10.0, 60.0]), np.pi / 2, "full"),
    "across the grooves: separate": (np.radians([-70.0, 33.0]), 0.0, "full"),
    "oblique: nothing to drop": (np.radians([20.0, 80.0]), np.radians([30.0, 75.0]), "full"),
    "oblique, unpolarized": (np.radians([20.0, 80.0]), np.radians([30.0, 75.0]), "unpolarized"),
    "along the fold, unpolarized": (np.radians([10.0, 60.0]), np.pi / 2, "unpolarized"),
    "along the fold, separate": (np.radians([10.0, 60.0]), np.pi / 2, "separate"),
}


@pytest.mark.parametrize("index", [1.5, 0.35 + 2.7j], ids=["real index", "complex index"])
@pytest.mark.parametrize("case", PLANNED)
def test_planned_shortcuts_are_the_general_path(case: str, index: complex) -> None:
    """To 1e-13: the two differ by rounding alone (1e-15, measured)."""
    polar, azimuth, model = PLANNED[case]
    for degrees in (41.0, 60.0, 131.0):  # one range of angles: one program for each case
        angle = np.radians(degrees)
        planned = np.asarray(vc.reflectance_factor(scene(angle, polar, azimuth, index, model)))
        general = traced(model, angle, polar, azimuth, np.full(np.shape(polar), index))
        np.testing.assert_allclose(np.atleast_1d(planned), general, rtol=0, atol=1e-13)


def test_real_index_below_one_is_treated_as_complex() -> None:
    """n < 1 without absorption (X-rays, k = 0): total reflection beyond the critical angle, not NaN."""
    polar = np.radians([0.0, 40.0, 80.0])
    value = np.asarray(vc.reflectance_factor(scene(np.pi, polar, 0.3, 0.8)))
    s, p = flat_reflectance(np.cos(polar), 0.8)
    np.testing.assert_allclose(value, (s + p) / 2, rtol=0, atol=1e-14)
    assert value[2] == pytest.approx(1, abs=1e-14)


@pytest.mark.parametrize("model", MODELS.values())
def test_flat_limit_is_one_fresnel_reflection(model: str) -> None:
    """α = π. Fresnel's formulas as printed cancel near n = 1: 1e-13, the bound of the records."""
    polar, index = np.meshgrid(np.radians([0.0, 5.0, 45.0, 60.0, 89.0, 89.999]), MATERIALS)
    s, p = flat_reflectance(np.cos(polar), index)
    for azimuth in (0.0, 0.7, np.pi / 2):
        value = traced(model, np.pi, polar.ravel(), azimuth, index.ravel())
        np.testing.assert_allclose(value, ((s + p) / 2).ravel(), rtol=0, atol=1e-13)


def test_right_angle_by_hand() -> None:
    """90 degrees, φ = 0, light from θ = 20: incidence 45 - θ on the facing panel, 45 + θ on the other.

    By ruler: of the facing panel's light a share tan θ of the aperture passes the other panel's rim. All
    else is reflected twice, once by each panel.
    """
    theta = np.radians(20.0)
    index = 0.35 + 2.7j
    s1, p1 = flat_reflectance(np.cos(np.pi / 4 - theta), index)
    s2, p2 = flat_reflectance(np.cos(np.pi / 4 + theta), index)
    both = (s1 * s2 + p1 * p2) / 2
    once = np.tan(theta)
    expected = once * (s1 + p1) / 2 + (1 - once) * both
    assert traced("full", [np.pi / 2], [theta], [0.0], [index])[0] == pytest.approx(expected, abs=1e-14)


@pytest.mark.parametrize(
    ("degrees", "most", "published"),
    [
        (90, 1, 2 - np.sqrt(2)),
        (60, 1, 2 - np.sqrt(3)),
        (60, 2, np.sqrt(3) - 1),
        (45, 1, 0.152241),
        (45, 2, 0.433546),
        (45, 3, 0.801088),
    ],
)
def test_published_shares_over_the_hemisphere(degrees: float, most: int, published: float) -> None:
    """Share of diffuse light that leaves after at most so many reflections; errata, table 4.

    The shares do not depend on the tilt along the fold: the hemisphere is ½∫ cos θ' dθ'. With α = π/k every
    kink lies at a multiple of α/2: Gauss-Legendre between these leaves 1e-14; decimals are printed to 5e-7.
    """
    angle = jnp.radians(degrees)
    ends = np.arange(-round(180 / degrees), round(180 / degrees) + 1) * np.asarray(angle) / 2
    x, weight = np.polynomial.legendre.leggauss(20)
    section = (ends[:-1, None] + ends[1:, None]) / 2 + np.diff(ends)[:, None] / 2 * x
    measure = np.diff(ends)[:, None] / 2 * weight * np.cos(section) / 2
    total = 0.0
    for side in (1, -1):
        count, last, fewer = SHARES(angle, jnp.asarray(side * np.sin(section)), jnp.asarray(np.cos(section)))
        total += np.sum(measure * (np.where(count <= most, last, 0) + np.where(count - 1 <= most, fewer, 0)))
    exact = most <= 2 and degrees > 45
    assert total == pytest.approx(published, abs=1e-12 if exact else 5e-7)


def test_most_reflections_is_known() -> None:
    """Over all directions the largest number of reflections is ceil(π/α), and it is reached."""
    for degrees in (7.0, 33.0, 50.0, 61.0, 90.5, 179.0):
        angle = jnp.radians(degrees)
        section = jnp.linspace(-jnp.pi / 2, jnp.pi / 2, 20001)[1:-1]
        counts = []
        for side in (1, -1):
            count, last, fewer = SHARES(angle, side * jnp.sin(section), jnp.cos(section))
            counts += [jnp.where(last > 1e-12, count, 1), jnp.where(fewer > 1e-12, count - 1, 1)]
        assert int(max(jnp.max(c) for c in counts)) == int(np.ceil(180 / degrees))


def test_spectra_and_directions_are_outer() -> None:
    """Every direction meets every wavelength, none is mixed up: equal to one call for each."""
    polar, azimuth = np.radians([[10.0, 50.0, 70.0], [0.0, 30.0, 85.0]]), np.radians([[0.0], [60.0]])
    together = vc.reflectance_factor(scene(0.9, polar, azimuth, np.array(MATERIALS)))
    assert together.shape == (2, 3, len(MATERIALS))
    grid = np.broadcast_arrays(polar[..., None], azimuth[..., None], np.array(MATERIALS))
    single = traced("full", 0.9, *(g.ravel() for g in grid)).reshape(2, 3, -1)
    np.testing.assert_allclose(together, single, rtol=0, atol=1e-14)


def test_silicon_is_darkest_where_the_thesis_saw_it() -> None:
    """Silicon, 45 degrees, along the fold: a minimum of 7.5e-4 near 60.75 degrees [figure 34b; errata].

    The index of the errata is that of silicon at 550 nm; the wrong sign of r_p never goes below 0.03.
    """
    polar = np.radians(np.arange(40, 80, 0.25))
    index = vc.materials.refractive_index("Si-Green-2008", np.array([550.0]))
    value = np.asarray(vc.reflectance_factor(scene(np.pi / 4, polar, np.pi / 2, index)))[:, 0]
    assert np.degrees(polar[np.argmin(value)]) == pytest.approx(60.75, abs=0.25)
    assert np.min(value) == pytest.approx(7.5e-4, abs=0.5e-4)
