"""What physics demands of every scene, whatever its numbers: random scenes, no reference values."""

from collections.abc import Iterator
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import vcavity_jax as vc
from vcavity_jax.kinks import reflection_kinks
from vcavity_jax.specular import reflection_shares

TIGHT = 1e-11
"""Tolerance of the diffusers here: the identities are held to a few times this, from 1 degree on."""

angles = st.floats(np.radians(1.0), np.pi)
all_angles = st.floats(np.radians(0.1), np.pi)
polars = st.floats(0.0, np.pi / 2)
signed_polars = st.floats(-1.55, 1.55)
azimuths = st.floats(0.0, np.pi)
reflectances = st.floats(0.0, 1.0)
models = st.sampled_from(["full", "unpolarized", "separate"])
indices = st.tuples(st.floats(0.05, 50.0), st.floats(0.0, 20.0)).map(lambda nk: complex(*nk))


@pytest.fixture(autouse=True, scope="module")
def _forget_programs() -> Iterator[None]:
    yield
    jax.clear_caches()


@cache
def _mirror(model: Any) -> Any:
    @jax.jit
    @jax.vmap
    def run(angle: Any, polar: Any, azimuth: Any, index: Any) -> Any:
        scene = vc.Scene(vc.VGrooves(angle), vc.Specular(index, model), vc.Diffuse(), vc.View(polar, azimuth))
        return vc.reflectance_factor(scene)

    return run


def mirror(model: Any, angle: Any, polar: Any, azimuth: Any, index: Any) -> np.ndarray:
    """Four directions at a time, the general path: one program for each model."""
    columns = [np.resize(np.asarray(c, float), 4) for c in (angle, polar, azimuth)]
    return np.asarray(_mirror(model)(*columns, np.resize(np.asarray(index, complex), 4)))


@jax.jit
@jax.vmap
def _lit(angle: Any, first: Any, second: Any, light: Any, view: Any) -> Any:
    material = vc.TwoPanels(vc.Lambertian(first), vc.Lambertian(second))
    return vc.reflectance_factor(
        vc.Scene(vc.VGrooves(angle), material, vc.Directional(*light), vc.View(*view)), TIGHT
    )


@jax.jit
@jax.vmap
def _shaded(angle: Any, first: Any, second: Any, view: Any) -> Any:
    material = vc.TwoPanels(vc.Lambertian(first), vc.Lambertian(second))
    return vc.reflectance_factor(vc.Scene(vc.VGrooves(angle), material, vc.Diffuse(), vc.View(*view)), TIGHT)


def columns(*values: Any) -> list[np.ndarray]:
    """Every argument four times, so that one program serves."""
    return [np.resize(np.asarray(v, float), 4) for v in values]


def lit(angle: Any, first: Any, second: Any, light: Any, view: Any) -> np.ndarray:
    """Parallel light; each argument a number or up to four of them, a direction a pair of such."""
    return np.asarray(_lit(*columns(angle, first, second), tuple(columns(*light)), tuple(columns(*view))))


def shaded(angle: Any, first: Any, second: Any, view: Any) -> np.ndarray:
    """Diffuse light."""
    return np.asarray(_shaded(*columns(angle, first, second), tuple(columns(*view))))


# -- energy ----------------------------------------------------------------------------------------


@given(all_angles, polars, azimuths)
@example(np.pi, 0.0, 0.0)
@example(np.radians(0.1), np.pi / 2, 0.0)
@example(np.pi / 4, np.pi / 8, 0.0)
def test_white_furnace(angle: float, polar: float, azimuth: float) -> None:
    """White panels in diffuse light cannot be told from a white sheet: 1 in every direction.

    The factor 1 - r of what is not white is exactly 0: to rounding.
    """
    np.testing.assert_allclose(shaded(angle, 1.0, 1.0, (polar, azimuth)), 1, rtol=0, atol=1e-12)


@given(st.floats(np.radians(1.0), np.pi), polars, azimuths, models)
@example(np.pi / 3, np.pi / 2, np.pi / 2, "full")
def test_mirror_furnace(angle: float, polar: float, azimuth: float, model: str) -> None:
    """Perfect mirrors: n = 1 + 1e10 i absorbs 4 n / |n|² / cos θ = 4e-20 / cos θ, and rounding does the rest.

    Up to 180 reflections. At grazing a p-polarized wave is absorbed after all, whatever the metal.
    """
    value = mirror(model, angle, polar, azimuth, 1 + 1e10j)
    assert np.all(value <= 1 + 1e-12)
    if away_from_grazing(angle, polar, azimuth):
        np.testing.assert_allclose(value, 1, rtol=0, atol=1e-12)


def away_from_grazing(angle: float, polar: float, azimuth: float) -> bool:
    """No reflection of the fan is within 1e-3 of grazing its panel."""
    across, normal = np.sin(polar) * np.cos(azimuth), np.cos(polar)
    image = (np.arange(1, 1 + int(np.ceil(np.pi / angle))) - 0.5) * angle
    return bool(np.all(np.abs([s * across * np.cos(image) + normal * np.sin(image) for s in (1, -1)]) > 1e-3))


@given(all_angles, polars, azimuths)
@example(np.pi / 5, 0.0, 0.0)
@example(np.pi, np.pi / 2, 0.0)
@example(np.radians(0.1), np.pi / 2, np.pi / 2)
def test_shares_fill_the_aperture(angle: float, polar: float, azimuth: float) -> None:
    """To rounding: the second panel's share is the complement of the first's."""
    across, normal = jnp.asarray(np.sin(polar) * np.cos(azimuth)), jnp.asarray(np.cos(polar))
    parts = [SHARES(jnp.asarray(angle), side * across, normal) for side in (1.0, -1.0)]
    total = sum(float(last + fewer) for _, last, fewer in parts)
    assert total == pytest.approx(1, abs=1e-14)
    for count, last, fewer in parts:
        assert float(last) >= 0
        assert float(fewer) >= 0
        assert float(count) >= 1
        if float(last) > 1e-12:
            assert float(count) <= np.ceil(np.pi / angle * (1 - 1e-12))


SHARES = jax.jit(reflection_shares)


@given(all_angles, polars, azimuths, reflectances, reflectances)
def test_diffusers_keep_energy(angle: float, polar: float, azimuth: float, first: float, second: float) -> None:
    """0 ≤ HDR ≤ max(r₁, r₂): an average over paths of what each reflects at most; sharper than 1."""
    value = shaded(angle, first, second, (polar, azimuth))
    assert np.all(value >= -TIGHT)
    assert np.all(value <= max(first, second) + TIGHT)


@given(all_angles, polars, azimuths, indices, models)
@example(np.pi / 2, np.pi / 2, np.pi / 2, 1 + 20j, "full")
def test_mirrors_keep_energy(angle: float, polar: float, azimuth: float, index: complex, model: str) -> None:
    value = mirror(model, angle, polar, azimuth, index)
    assert np.all(value >= 0)
    assert np.all(value <= 1 + 1e-12)  # up to 1800 roundings


# -- reciprocity, symmetry, order ------------------------------------------------------------------

directions = st.tuples(signed_polars, azimuths)


@given(angles, reflectances, reflectances, directions, directions)
@example(np.pi / 4, 0.9, 0.1, (np.pi / 4, 0.0), (1.4, 0.5))
def test_helmholtz_reciprocity(
    angle: float, first: float, second: float, light: tuple[float, float], view: tuple[float, float]
) -> None:
    """Swapping light and view leaves the reflectance factor: they enter through different code.

    Relative to the value, which grows as 1/cos of both: both ways keep the tolerance.
    """
    there, back = lit(angle, first, second, light, view), lit(angle, first, second, view, light)
    np.testing.assert_allclose(there, back, rtol=1e-9, atol=2 * TIGHT)


@given(angles, reflectances, reflectances, directions, directions)
def test_mirror_images(
    angle: float, first: float, second: float, light: tuple[float, float], view: tuple[float, float]
) -> None:
    """Mirrored along the fold nothing changes; mirrored across it the panels swap, and only then."""
    value = lit(angle, first, second, light, view)
    along = lit(angle, first, second, (light[0], -light[1]), (view[0], -view[1]))
    np.testing.assert_allclose(value, along, rtol=1e-9, atol=2 * TIGHT)
    swapped = lit(angle, second, first, (-light[0], light[1]), (-view[0], view[1]))
    np.testing.assert_allclose(value, swapped, rtol=1e-9, atol=2 * TIGHT)


@given(angles, signed_polars, azimuths, indices, models)
def test_mirror_grooves_look_alike_from_both_sides(
    angle: float, polar: float, azimuth: float, index: complex, model: str
) -> None:
    """±θ and ±φ. The two sides' shares round differently: 1e-13, up to some 200 reflections."""
    value = mirror(model, angle, [polar, -polar, polar, -polar], [azimuth, azimuth, -azimuth, -azimuth], index)
    np.testing.assert_allclose(value, value[0], rtol=0, atol=1e-12)


@given(all_angles, signed_polars, indices)
def test_no_coupling_across_the_grooves(angle: float, polar: float, index: complex) -> None:
    """φ = 0: s and p never mix, "separate" is exact."""
    full, separate = (mirror(model, angle, polar, 0.0, index) for model in ("full", "separate"))
    np.testing.assert_allclose(full, separate, rtol=0, atol=1e-13)


@given(st.floats(0.67 * np.pi, np.pi), st.floats(0.0, 0.999), azimuths, indices)
def test_one_reflection_needs_no_model(angle: float, part: float, azimuth: float, index: complex) -> None:
    """Where every ray is reflected once, |θ'| < 3α/2 - π, the three models are one."""
    section = part * (1.5 * angle - np.pi)
    polar = np.arctan(np.tan(section) / max(abs(np.cos(azimuth)), 1e-3))
    value = [mirror(m, angle, polar, azimuth, index) for m in ("full", "unpolarized", "separate")]
    np.testing.assert_allclose(value[1:], [value[0]] * 2, rtol=0, atol=1e-13)


@given(angles, st.lists(reflectances, min_size=4, max_size=4), directions, directions)
def test_brighter_panels_are_brighter(
    angle: float, steps: list[float], light: tuple[float, float], view: tuple[float, float]
) -> None:
    """Monotone in each panel's reflectance, in both lights."""
    ladder = np.sort(steps)
    slack = 4 * TIGHT * (1 + 1 / np.cos(light[0]) / np.cos(view[0]))
    assert np.all(np.diff(lit(angle, ladder, 0.6, light, view)) >= -slack)
    assert np.all(np.diff(lit(angle, 0.6, ladder, light, view)) >= -slack)
    assert np.all(np.diff(shaded(angle, ladder, 0.6, view)) >= -slack)


# -- one material, two panels, mixtures ------------------------------------------------------------


@cache
def uniform(kind: str) -> Any:
    @jax.jit
    def run(angle: Any, first: Any, second: Any, light: Any, view: Any, share: Any) -> Any:
        parallel = vc.Directional(*light)
        source = {"diffuse": vc.Diffuse(), "parallel": parallel, "mixed": vc.Mixed(share, parallel)}
        pair = vc.Lambertian(first), vc.Lambertian(second)

        def of(material: Any, which: str) -> Any:
            return vc.reflectance_factor(
                vc.Scene(vc.VGrooves(angle), material, source[which], vc.View(*view)), TIGHT
            )

        if kind == "uniform":
            return [(of(pair[0], w), of(vc.TwoPanels(pair[0], pair[0]), w)) for w in ("diffuse", "parallel")]
        if kind == "alternating":
            swapped = [of(vc.TwoPanels(a, b), "parallel") for a, b in (pair, pair[::-1])]
            return [(of(vc.TwoPanels(*pair, alternating=True), "parallel"), sum(swapped) / 2)]
        parts = of(pair[0], "diffuse"), of(pair[0], "parallel")
        return [(of(pair[0], "mixed"), share * parts[0] + (1 - share) * parts[1])]

    return run


@pytest.mark.parametrize("kind", ["uniform", "alternating", "mixed"])
@given(angles, reflectances, reflectances, directions, directions, reflectances)
def test_compositions(
    kind: str,
    angle: float,
    first: float,
    second: float,
    light: tuple[float, float],
    view: tuple[float, float],
    share: float,
) -> None:
    """Equal panels are one material; alternating averages both orders; mixed light is a weighted sum."""
    arguments = [jnp.asarray(a) for a in (angle, first, second)]
    pairs = uniform(kind)(
        *arguments, tuple(map(jnp.asarray, light)), tuple(map(jnp.asarray, view)), jnp.asarray(share)
    )
    for found, wanted in pairs:
        # Black panels: the odd part is divided by ρ, which is floored at 1e-7.
        np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=4 * TIGHT)


# -- flat limit, continuity ------------------------------------------------------------------------


@given(reflectances, reflectances, directions, directions)
def test_flat_diffusers(
    first: float, second: float, light: tuple[float, float], view: tuple[float, float]
) -> None:
    """α = π: the reflectance itself, of two panels the mean of what each gives with its half."""
    np.testing.assert_allclose(lit(np.pi, first, first, light, view), first, rtol=0, atol=TIGHT)
    np.testing.assert_allclose(lit(np.pi, first, second, light, view), (first + second) / 2, rtol=0, atol=TIGHT)
    np.testing.assert_allclose(shaded(np.pi, first, second, view), (first + second) / 2, rtol=0, atol=TIGHT)


@given(st.integers(0, 40), polars, azimuths, indices, models)
@example(0, 0.0, 0.0, 4.08 + 0.03j, "full")
def test_mirrors_are_continuous_in_every_angle(
    which: int, polar: float, azimuth: float, index: complex, model: str
) -> None:
    """Across each kink, on both sides of it by h = 1e-9 in α, θ and φ: a jump would be of order 1.

    The slope is at most of the order of the number of reflections times 1 / the grazing cosine; steps of 1e-9
    then move the value by less than 1e-4 anywhere (√h at grazing).
    """
    section = np.arctan2(np.sin(polar) * np.cos(azimuth), np.cos(polar))
    kinks = np.unique(np.clip(np.asarray(reflection_kinks(jnp.asarray(section), 10)), 0.05, np.pi))
    angle, h = kinks[which % len(kinks)], 1e-9
    centre = mirror(model, angle, polar, azimuth, index)
    by_angle = mirror(model, [angle - h, min(angle + h, np.pi)], polar, azimuth, index)
    by_polar = mirror(model, angle, [max(polar - h, 0), min(polar + h, np.pi / 2)], azimuth, index)
    by_azimuth = mirror(model, angle, polar, [azimuth - h, azimuth + h], index)
    for beside in (by_angle, by_polar, by_azimuth):
        np.testing.assert_allclose(beside, centre, rtol=0, atol=2e-4)


@given(st.floats(np.radians(5), np.pi - 1e-3), azimuths, directions, reflectances, reflectances)
def test_diffusers_are_continuous_where_a_shadow_begins(
    angle: float, azimuth: float, view: tuple[float, float], first: float, second: float
) -> None:
    """2|θ'| = α, from both sides, for light and view: 1e-9 of a step, slopes of the order of 1/α/cos²."""
    polar = np.arctan(np.tan(angle / 2) / max(abs(np.cos(azimuth)), 0.05))
    h = 1e-9
    light = ([polar - h, polar, polar + h, polar], azimuth)
    slack = 1e-7 * (1 + 1 / np.cos(polar) ** 2 + 1 / np.cos(view[0]) ** 2) / angle
    for value in (
        lit(angle, first, second, light, view),
        lit(angle, first, second, view, light),
        shaded(angle, first, second, light),
        lit([angle - h, angle, angle + h, angle], first, second, (polar, azimuth), view),
    ):
        np.testing.assert_allclose(value, value[1], rtol=1e-6, atol=slack)


# -- the rim and the mean --------------------------------------------------------------------------


@jax.jit
def _edge_and_mean(angle: Any, reflectance: Any) -> Any:
    scene = vc.Scene(vc.VGrooves(angle), vc.Lambertian(reflectance), vc.Directional(), vc.View())
    return vc.radiance_profile(scene, jnp.ones(()), TIGHT), vc.reflectance_factor(scene, TIGHT)


@given(angles, st.floats(1e-3, 1.0))
@example(np.pi / 4, 1.0)
def test_mean_is_the_square_of_the_edge(angle: float, reflectance: float) -> None:
    """Frontal light: <L> r sin(α/2) = L(rim)², from the profile at y = 1 and the mean, different sums."""
    edge, mean = _edge_and_mean(jnp.asarray(angle), jnp.asarray(reflectance))
    np.testing.assert_allclose(
        edge**2, mean * reflectance * np.sin(angle / 2), rtol=1e-9, atol=10 * TIGHT * reflectance
    )
