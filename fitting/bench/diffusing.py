"""Diffusing panels: what is measured of them. ``python -m fitting.bench.diffusing``."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Array

import vcavity_jax as vc
from fitting.bench import nystrom, path_tracer, thesis_recipe
from fitting.bench.measure import Peer, Quantity, Real, Spectrum

REFLECTANCES = np.linspace(0.05, 0.95, 36)
SMALLEST = float(np.radians(20.0))
Direction = tuple[float, float]
FRONTAL: Direction = (0.0, 0.0)
SLANTED: Direction = (float(np.radians(45.0)), 0.0)
SHADOWED: Direction = (float(np.radians(30.0)), 0.0)
PATHS = 20_000


def angles(count: int) -> Real:
    """Random dihedral angles, 20 to 170 degrees."""
    return np.radians(np.random.default_rng(2020).uniform(20, 170, count))


def made(surface: Any, material: Any, light: Direction | None, view: Direction | None) -> vc.Scene:
    """A scene; None is diffuse light, and the hemisphere as detector."""
    # Plain numbers: what is known when the work is planned is left out of it.
    known: Any = light, view
    illumination: Any = vc.Diffuse() if light is None else vc.Directional(*known[0])
    detector: Any = vc.Hemisphere() if view is None else vc.View(*known[1])
    return vc.Scene(surface, material, illumination, detector)


def scene(light: Direction | None, view: Direction | None) -> Callable[[float], Spectrum]:
    """Of the angle and 36 reflectances."""

    def ours(tolerance: float) -> Spectrum:
        def spectrum(angle: Array, optical: Array) -> Array:
            one = made(vc.VGrooves(angle), vc.Lambertian(optical), light, view)
            return vc.reflectance_factor(one, tolerance, smallest_angle=SMALLEST)

        return spectrum

    return ours


def _recipe(light: Direction | None, view: Direction | None) -> tuple[Peer, ...]:
    return tuple(
        Peer(
            f"thesis's recipe, {2 * facets} facets",
            partial(_facets, light=light, view=view, facets=facets),
        )
        for facets in (32, 128)
    )


def _facets(angle: float, light: Direction | None, view: Direction | None, facets: int) -> Real:
    return thesis_recipe.lambertian(angle, REFLECTANCES, light, view, facets)


def _nystrom(diffuse: bool) -> tuple[Peer, ...]:
    def with_nodes(nodes: int) -> Callable[[float], Real]:
        return lambda angle: nystrom.open_groove(angle, REFLECTANCES, diffuse, nodes)

    return tuple(Peer(f"dense Nyström, {n} nodes", with_nodes(n)) for n in (16, 64))


def traced(view: Direction | None, index: float = 1.0) -> Peer:
    """The path tracer, with an interface of this index."""

    def run(angle: float) -> Real:
        return path_tracer.diffusing(angle, REFLECTANCES, view, PATHS, np.random.default_rng(0), index)

    return Peer(f"path tracer, {PATHS} paths", run, random=True)


QUANTITIES = (
    Quantity(
        "diffusing",
        "diffuse light, frontal view",
        scene(None, FRONTAL),
        REFLECTANCES,
        angles,
        (*_recipe(None, FRONTAL), *_nystrom(True), traced(FRONTAL)),
    ),
    Quantity(
        "diffusing",
        "frontal light and view",
        scene(FRONTAL, FRONTAL),
        REFLECTANCES,
        angles,
        (*_recipe(FRONTAL, FRONTAL), *_nystrom(False)),
    ),
    Quantity(
        "diffusing",
        "light from 45°, view from 30°",
        scene(SLANTED, SHADOWED),
        REFLECTANCES,
        angles,
        _recipe(SLANTED, SHADOWED),
    ),
    Quantity(
        "diffusing",
        "bi-hemispherical",
        scene(None, None),
        REFLECTANCES,
        angles,
        (*_recipe(None, None), traced(None)),
    ),
)

if __name__ == "__main__":
    from fitting.bench.report import main

    main("diffusing")
