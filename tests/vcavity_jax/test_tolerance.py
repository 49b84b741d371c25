"""The promise of ``tolerance``: an upper bound on the error, for random scenes of every kind.

Every scene is evaluated as a user would, with all its numbers known, so that the work is planned for it. The
reference is the same scene, evaluated for 1e-13 with nothing known: other plans, other sums.
"""

import itertools
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import vcavity_jax as vc

TOLERANCES = (1e-3, 1e-6, 1e-10)
REFLECTANCES = np.array([0.03, 0.3, 0.6, 0.8, 0.93, 0.99, 0.9999, 1.0])


@pytest.fixture(autouse=True)
def _forget_programs() -> Iterator[None]:
    yield
    jax.clear_caches()
    reference.cache_clear()


def random_directions(random: np.random.Generator, size: int, steepest: float = 88.0) -> np.ndarray:
    """Polar (both signs) and azimuth; a quarter each near the plane along and near the plane across."""
    azimuth = random.choice([0.0, 90.0, -1.0, -1.0], size)
    azimuth = np.where(azimuth < 0, random.uniform(0, 180, size), azimuth)
    return np.radians([random.uniform(-steepest, steepest, size), azimuth])


@cache
def reference(kind: str, tolerance: float) -> Callable[..., Any]:
    def value(surface: Any, material: Any, illumination: Any, view: Any) -> Any:
        return vc.reflectance_factor(vc.Scene(surface, material, illumination, view), tolerance)

    return jax.jit(value)


def worst_excess(scenes: list[vc.Scene], kind: str, finest: float) -> dict[float, float]:
    """Largest error over tolerance.

    Errors grow where the value does: light and view both grazing. The promise is absolute all the same.
    """
    excess = dict.fromkeys(TOLERANCES, 0.0)
    for scene in scenes:
        exact = np.asarray(reference(kind, finest)(scene.surface, scene.material, scene.illumination, scene.view))
        for tolerance in TOLERANCES:
            error = float(np.max(np.abs(np.asarray(vc.reflectance_factor(scene, tolerance)) - exact)))
            excess[tolerance] = max(excess[tolerance], error / tolerance)
    return excess


def diffusing(random: np.random.Generator, angle: float, kind: str) -> vc.Scene:
    """One of the kinds of diffusing scenes, at an angle in degrees."""
    material: Any = vc.Lambertian(random.permutation(REFLECTANCES))
    if "two" in kind:
        material = vc.TwoPanels(material, vc.Lambertian(random.permutation(REFLECTANCES)))
    polar, azimuth = random_directions(random, 6)
    light: Any = vc.Diffuse()
    if "open" in kind:  # seen and lit within the groove's opening
        polar = polar * (angle / 2 / 90)
    if "parallel" in kind:
        source = np.radians([random.uniform(-88, 88), random.choice([0.0, 20.0, 60.0, 130.0])])
        light = vc.Directional(source[0] * (angle / 2 / 90 if "open" in kind else 1), source[1])
    return vc.Scene(vc.VGrooves(np.radians(angle)), material, light, vc.View(polar, azimuth))


KINDS = ("diffuse", "diffuse open", "parallel", "parallel open", "two diffuse", "two parallel")


NARROW_ENDS = (1.0, 4.5, 14.0, 40.0)


def held(kind: str, ranges: list[tuple[float, float]], each: int) -> None:
    """Angles within every range that is planned alike, and at its narrow end."""
    random = np.random.default_rng(KINDS.index(kind))
    drawn = [random.uniform(low, high) if i else low for low, high in ranges for i in range(each)]
    excess = worst_excess([diffusing(random, angle, kind) for angle in drawn], kind, 1e-13)
    assert max(excess.values()) < 1, excess


SAMPLED = {
    "diffuse": [(4.5, 14.0), (40.0, 179.0)],
    "diffuse open": [(1.0, 4.5), (40.0, 179.0)],
    "parallel": [(1.0, 4.5), (14.0, 40.0)],
    "parallel open": [(4.5, 14.0), (40.0, 179.0)],
    "two diffuse": [(14.0, 40.0)],
    "two parallel": [(40.0, 179.0)],
}


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(k, marks=pytest.mark.slow) if k in ("diffuse open", "two parallel", "parallel") else k
        for k in KINDS
    ],
)
def test_diffusers(kind: str) -> None:
    held(kind, SAMPLED[kind], 4)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_diffusers_150_scenes(kind: str) -> None:
    held(kind, list(itertools.pairwise((*NARROW_ENDS, 179.0))), 38)


@pytest.mark.parametrize(
    "size", [pytest.param(10, id="sample"), pytest.param(150, id="150 scenes", marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("kind", ["diffuse", "parallel"])
def test_profiles(kind: str, size: int) -> None:
    """Local radiance keeps the tolerance above 1e-6 of the panel, as it says."""
    random = np.random.default_rng(50)
    position = jnp.asarray([1e-6, 1e-3, 0.05, 0.3, 0.7, 0.95, 1.0])

    def profile(scene: vc.Scene, tolerance: float) -> Any:
        return vc.radiance_profile(scene, position, tolerance)

    programs = {t: jax.jit(lambda s, t=t: profile(s, t)) for t in (*TOLERANCES, 1e-13)}
    for angle in random.uniform(5, 179, size):
        scene = diffusing(random, angle, kind)
        exact = np.asarray(programs[1e-13](scene))
        for tolerance in TOLERANCES:
            error = np.max(np.abs(np.asarray(programs[tolerance](scene)) - exact))
            assert error < tolerance, (angle, tolerance)


@pytest.mark.parametrize(
    "size", [pytest.param(40, id="sample"), pytest.param(150, id="150 scenes", marks=pytest.mark.slow)]
)
def test_mirrors(size: int) -> None:
    """An exact sum: every tolerance is kept by the same work; to 1e-12."""
    random = np.random.default_rng(60)
    for angle in np.radians(random.uniform(1, 180, size)):
        index = random.uniform(0.05, 4, 3) + 1j * random.uniform(0, 6, 3)
        view = vc.View(*random_directions(random, 5))
        scene = vc.Scene(vc.VGrooves(angle), vc.Specular(index), vc.Diffuse(), view)
        exact = reference("mirror", 1e-13)(scene.surface, scene.material, scene.illumination, view)
        np.testing.assert_allclose(vc.reflectance_factor(scene, 1e-3), exact, rtol=0, atol=1e-12)


@pytest.mark.parametrize("tolerance", TOLERANCES)
def test_grazing_from_opposite_sides(tolerance: float) -> None:
    """Light and view graze the groove from opposite sides: no panel is both lit and seen, nothing diverges.

    The value tends to a limit with a slope of 0.3 or less: at 1e-8 radians from grazing and at 90 degrees it
    is that at 1e-4, to 1e-4. There the finest tolerance has 1e-16 / 1e-4 of rounding.
    """

    def value(distance: float, tolerance: float) -> np.ndarray:
        grazing = np.pi / 2 - distance
        light, view = vc.Directional(grazing, 0.4), vc.View(-grazing, 0.0)
        scene = vc.Scene(vc.VGrooves(0.9), vc.Lambertian(REFLECTANCES), light, view)
        return np.asarray(vc.reflectance_factor(scene, tolerance))

    finest = value(1e-4, 1e-13)
    np.testing.assert_allclose(finest, value(2e-4, 1e-13), rtol=0, atol=1e-4)
    np.testing.assert_allclose(value(1e-4, tolerance), finest, rtol=0, atol=tolerance)
    for distance in (1e-8, 0.0):
        np.testing.assert_allclose(value(distance, tolerance), finest, rtol=0, atol=tolerance + 1e-4)


MIRRORS = vc.Specular(np.array([0.35 + 2.7j, 1.5, 4.08 + 0.03j, 0.1249 + 3.3391j]))


@pytest.mark.parametrize(
    "m", [*(pytest.param(m, marks=pytest.mark.slow) for m in (0.01, 0.1, 1.0, 2.2, 5.0)), 0.4]
)
def test_random_grooves(m: float) -> None:
    """Mirrors, 12 views of 4 indices, against the finest; that keeps the records to 1e-13 itself.

    Diffusers are held to an independent average in test_beckmann.
    """
    view = vc.View(*random_directions(np.random.default_rng(70), 12))
    scene = vc.Scene(vc.BeckmannGrooves(m), MIRRORS, vc.Diffuse(), view)
    exact = np.asarray(vc.reflectance_factor(scene, 1e-13))
    for tolerance in TOLERANCES:
        error = np.max(np.abs(np.asarray(vc.reflectance_factor(scene, tolerance)) - exact))
        assert error < tolerance, tolerance


# -- many scenes at once ---------------------------------------------------------------------------

MATTE, GLOSSY = vc.Lambertian(REFLECTANCES), vc.InterfacedLambertian(REFLECTANCES, 1.5)

BATCH = {
    "open, diffuse light": (vc.VGrooves, MATTE, vc.Diffuse(), vc.View()),
    "open, frontal light": (vc.VGrooves, MATTE, vc.Directional(), vc.View()),
    "light and view anywhere": (vc.VGrooves, MATTE, None, None),
    "bi-hemispherical": (vc.VGrooves, MATTE, vc.Diffuse(), vc.Hemisphere()),
    "interfaced, diffuse light": (vc.VGrooves, GLOSSY, vc.Diffuse(), vc.View()),
    "interfaced, frontal light": (vc.VGrooves, GLOSSY, vc.Directional(), vc.View()),
    "mirrors, bi-hemispherical": (vc.VGrooves, MIRRORS, vc.Diffuse(), vc.Hemisphere()),
    "random grooves, matte": (vc.BeckmannGrooves, MATTE, vc.Diffuse(), vc.View()),
    "random grooves, mirrors": (vc.BeckmannGrooves, MIRRORS, vc.Diffuse(), None),
    "random grooves, bi-hemispherical": (vc.BeckmannGrooves, MIRRORS, vc.Diffuse(), vc.Hemisphere()),
}
"""Surface, material, light and view; None: from a random direction."""

QUICK = 20_000
"""As many in every run of the tests as in the long one."""

SAMPLE = {
    "open, diffuse light": QUICK,
    "open, frontal light": QUICK,
    "bi-hemispherical": QUICK,
    "mirrors, bi-hemispherical": 64,
    "random grooves, matte": 48,
    "random grooves, mirrors": 16,
    "random grooves, bi-hemispherical": 3,
}

LONG = {
    "mirrors, bi-hemispherical": 5_000,
    "random grooves, mirrors": 2_000,
    "random grooves, bi-hemispherical": 200,
}
"""Of averages over many directions or grooves, in a quarter of an hour each; of all others 20 000."""


@pytest.mark.parametrize(
    ("kind", "size"),
    [
        *(pytest.param(kind, SAMPLE.get(kind, 256), id=f"{kind}, sample") for kind in BATCH),
        *(
            pytest.param(kind, LONG.get(kind, 20_000), id=f"{kind}, many", marks=pytest.mark.slow)
            for kind in BATCH
            if SAMPLE.get(kind) != QUICK
        ),
    ],
)
def test_the_promise_over_many_scenes(kind: str, size: int) -> None:
    """Angles of 14° and more, planned as unknown; half of them the narrowest, or π/k. Roughnesses of 0.01 to 1."""
    surface, material, light, view = BATCH[kind]
    smallest = float(np.radians(14))
    random = np.random.default_rng(20)
    if surface is vc.VGrooves:
        shape = np.where(
            random.uniform(size=size) < 0.5,
            random.uniform(smallest, np.pi, size),
            random.choice([smallest, *(np.pi / k for k in range(1, 13))], size),
        )
        known, finest = {"smallest_angle": smallest}, 1e-12
    else:
        shape, known, finest = np.exp(random.uniform(np.log(0.01), 0, size)), {}, 1e-11
    directions = random_directions(random, size), random_directions(random, size)
    together = 1 if isinstance(view, vc.Hemisphere) or surface is vc.BeckmannGrooves else 64

    def factor(tolerance: float) -> Any:
        def one(row: Any) -> Any:
            value, theta, phi, polar, azimuth = row
            source = vc.Directional(theta, phi) if light is None else light
            detector = vc.View(polar, azimuth) if view is None else view
            return vc.reflectance_factor(vc.Scene(surface(value), material, source, detector), tolerance, **known)

        rows = np.stack([shape, *directions[0], *directions[1]], axis=1)
        return np.asarray(jax.jit(lambda rows: jax.lax.map(one, rows, batch_size=together))(jnp.asarray(rows)))

    exact = factor(finest)
    for tolerance in TOLERANCES:
        worst = np.abs(factor(tolerance) - exact).max(axis=1)
        assert worst.max() < tolerance, (tolerance, float(worst.max()), float(shape[worst.argmax()]))
