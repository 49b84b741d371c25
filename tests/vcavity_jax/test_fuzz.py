"""Random scenes over the whole allowed range, special values among them: nothing but sound numbers comes out.

Values and gradients are finite; energy, reciprocity and the white furnace hold to 1e-10, under an interface to
1e-8. A seeded sample runs in CI; a million mirrors, and as many bare diffusers, are slow tests. A failure names
the seed and the scene.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import vcavity_jax as vc

EXACT, EXACT_INTERFACED = 1e-10, 1e-8


def some(random: np.random.Generator, size: int, low: float, high: float, special: list[float]) -> np.ndarray:
    """Evenly spread, and a quarter of special values and of their neighbors by a few units in the last place."""
    spread = random.uniform(low, high, size)
    chosen = random.choice(special, size)
    near = chosen * (1 + random.integers(-3, 4, size) * np.finfo(float).eps)
    return np.clip(np.where(random.uniform(size=size) < 0.25, near, spread), low, high)


def angles(random: np.random.Generator, size: int, low_deg: float, high_deg: float) -> np.ndarray:
    special = [np.pi / k for k in range(1, 200) if low_deg <= 180 / k <= high_deg] or [np.radians(low_deg)]
    return some(random, size, np.radians(low_deg), np.radians(high_deg), special)


def directions(random: np.random.Generator, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Polar angle and azimuth; many at the edge of a panel, along its normal, frontal, or grazing."""
    size = angle.size
    polar = random.uniform(-np.pi / 2, np.pi / 2, size)
    special = np.stack([angle / 2, -angle / 2, np.pi / 2 - angle / 2, 0 * angle, 0 * angle + np.pi / 2])
    chosen = np.take_along_axis(special, random.integers(0, len(special), (1, size)), 0)[0]
    polar = np.where(random.uniform(size=size) < 0.3, chosen, polar)
    azimuth = random.choice([0.0, np.pi / 2, 1e-12, -1.0], size)
    return polar, np.where(azimuth < 0, random.uniform(-np.pi, np.pi, size), azimuth)


def reflectances(random: np.random.Generator, size: int) -> np.ndarray:
    return some(random, size, 0.0, 1.0, [0.0, 1.0, 1 - 1e-12, 1e-12])


def report(bad: np.ndarray, what: str, seed: int, columns: tuple[np.ndarray, ...]) -> None:
    if bad.any():
        first = int(np.flatnonzero(bad)[0])
        scene = [c[first] for c in columns]
        raise AssertionError(f"{what}: {int(bad.sum())} of {bad.size}, seed {seed}: {scene!r}")


Values = Callable[..., Any]


def fuzz(
    seed: int,
    size: int,
    value: Values,
    draw: Callable[[np.random.Generator, int], tuple[np.ndarray, ...]],
    exact: float = EXACT,
    chunk: int = 500,
) -> None:
    """Value, gradient by everything, and what must be equal to what.

    ``value`` returns the value to differentiate, then pairs that must agree, then the upper limit.
    """

    def objective(*columns: Any) -> Any:
        first, second, limit, extra = value(*columns)
        return first, (first, second, limit, extra)

    random = np.random.default_rng(seed)
    count = -(-size // chunk)
    known = draw(random, chunk)
    every = tuple(range(len(known)))
    program = jax.jit(jax.vmap(jax.value_and_grad(objective, every, has_aux=True)))
    for part in range(count):
        columns = known if part == 0 else draw(random, chunk)
        (_, (first, second, limit, extra)), gradient = program(*(jnp.asarray(c) for c in columns))
        first, second, limit, extra = (np.asarray(x) for x in (first, second, limit, extra))
        report(~np.isfinite(first), "value not finite", seed, columns)
        for i, slope in enumerate(gradient):
            report(~np.isfinite(np.asarray(slope)), f"derivative {i} not finite", seed, columns)
        report((first < -exact) | (first > limit + exact), "energy", seed, columns)
        report(np.abs(first - second) > exact * np.maximum(1, np.abs(first)), "reciprocity", seed, columns)
        report(np.abs(extra - 1) > exact, "white furnace", seed, columns)


def mirror(angle: Any, polar: Any, azimuth: Any, n: Any, k: Any) -> tuple[Any, ...]:
    def seen(polar: Any, azimuth: Any, index: Any) -> Any:
        view = vc.View(polar, azimuth)
        return vc.reflectance_factor(vc.Scene(vc.VGrooves(angle), vc.Specular(index), vc.Diffuse(), view))

    index = jax.lax.complex(n, k)
    value = seen(polar, azimuth, index)
    # A groove looks alike from both sides.
    return value, seen(-polar, azimuth, index), jnp.ones_like(value), jnp.ones_like(value)


def mirrors(low: float, high: float) -> Any:
    def draw(random: np.random.Generator, size: int) -> tuple[np.ndarray, ...]:
        angle = angles(random, size, low, high)
        n = some(random, size, 0.05, 50.0, [1.0, 1 + 1e-12, 1.5, 50.0])
        k = some(random, size, 0.0, 20.0, [0.0, 1e-12, 20.0])
        return angle, *directions(random, angle), n, np.where(n < 1, np.maximum(k, 1e-3), k)

    return draw


def scattering(make: Callable[[Any, Any], Any], exact: float, **smallest: float) -> Values:
    """Of a material by two numbers: a reflectance first, and white where that is one."""

    def value(angle: Any, theta: Any, phi: Any, polar: Any, azimuth: Any, first: Any, second: Any) -> Any:
        def seen(light: Any, view: Any, first: Any, second: Any) -> Any:
            scene = vc.Scene(vc.VGrooves(angle), make(first, second), light, vc.View(*view))
            return vc.reflectance_factor(scene, exact / 10, **smallest)

        there = seen(vc.Directional(theta, phi), (polar, azimuth), first, second)
        back = seen(vc.Directional(polar, azimuth), (theta, phi), first, second)
        one = jnp.ones_like(first)
        white = seen(vc.Diffuse(), (polar, azimuth), one, one if make is two_panels else second)
        return there, back, jnp.full_like(there, jnp.inf), white

    return value


def two_panels(first: Any, second: Any) -> vc.TwoPanels:
    return vc.TwoPanels(vc.Lambertian(first), vc.Lambertian(second))


def frontal(angle: Any, rho: Any, n: Any) -> Any:
    """Varnished, in diffuse light and seen frontally: no panel is hidden, and the factor is an albedo."""

    def seen(rho: Any, light: Any, detector: Any) -> Any:
        scene = vc.Scene(vc.VGrooves(angle), vc.InterfacedLambertian(rho, n), light, detector)
        return vc.reflectance_factor(scene, EXACT_INTERFACED / 10, **WIDE)

    value, back = seen(rho, vc.Diffuse(), vc.View()), seen(rho, vc.Directional(), vc.Hemisphere())
    return value, back, jnp.ones_like(value), seen(jnp.ones_like(rho), vc.Diffuse(), vc.View())


WIDE = {"smallest_angle": float(np.radians(40.0)), "smallest_index": 1.2}


def scatterers(low: float, high: float, others: Callable[[np.random.Generator, int], np.ndarray]) -> Any:
    def draw(random: np.random.Generator, size: int) -> tuple[np.ndarray, ...]:
        angle = angles(random, size, low, high)
        light, view = directions(random, angle), directions(random, angle)
        # Where both graze, the reflectance factor itself has no bound.
        steep = np.clip(light[0], -1.5, 1.5)
        return angle, steep, light[1], *view, reflectances(random, size), others(random, size)

    return draw


def indices(random: np.random.Generator, size: int) -> np.ndarray:
    return some(random, size, 1.2, 4.0, [1.2, 1.5, 4.0])


def albedos(random: np.random.Generator, size: int) -> tuple[np.ndarray, ...]:
    return angles(random, size, 40.0, 180.0), reflectances(random, size), indices(random, size)


MILLION = pytest.mark.slow


@pytest.mark.parametrize(
    ("low", "high", "size"),
    [
        pytest.param(1.0, 180.0, 20_000, id="sample"),
        pytest.param(0.1, 1.0, 20_000, id="narrow", marks=MILLION),
        pytest.param(1.0, 180.0, 1_000_000, id="million", marks=MILLION),
    ],
)
def test_mirrors(low: float, high: float, size: int) -> None:
    fuzz(7, size, mirror, mirrors(low, high))


@pytest.mark.parametrize(
    ("low", "high", "size"),
    [
        pytest.param(40.0, 180.0, 16_000, id="wide"),
        pytest.param(14.0, 40.0, 3_000, id="narrow"),
        pytest.param(4.5, 14.0, 1_000, id="narrower"),
        pytest.param(40.0, 180.0, 700_000, id="million, wide", marks=MILLION),
        pytest.param(14.0, 40.0, 200_000, id="million, narrow", marks=MILLION),
        pytest.param(4.5, 14.0, 80_000, id="million, narrower", marks=MILLION),
        pytest.param(1.0, 4.5, 20_000, id="million, narrowest", marks=MILLION),
    ],
)
def test_diffusers(low: float, high: float, size: int) -> None:
    value = scattering(two_panels, EXACT, smallest_angle=float(np.radians(low)))
    fuzz(7, size, value, scatterers(low, high, reflectances))


@pytest.mark.parametrize(
    ("low", "high", "size"),
    [
        pytest.param(60.0, 180.0, 120, id="sample"),
        pytest.param(40.0, 180.0, 20_000, id="many", marks=MILLION),
        pytest.param(14.0, 40.0, 2_000, id="many narrow", marks=MILLION),
    ],
)
def test_interfaces(low: float, high: float, size: int) -> None:
    smallest = {"smallest_angle": float(np.radians(low)), "smallest_index": 1.2}
    value = scattering(vc.InterfacedLambertian, EXACT_INTERFACED, **smallest)
    fuzz(7, size, value, scatterers(low, high, indices), EXACT_INTERFACED, 20)


@pytest.mark.parametrize(
    "size", [pytest.param(20_000, id="sample"), pytest.param(1_000_000, id="million", marks=MILLION)]
)
def test_interfaces_in_diffuse_light(size: int) -> None:
    fuzz(7, size, frontal, albedos, EXACT_INTERFACED)
