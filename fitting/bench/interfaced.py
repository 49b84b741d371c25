"""Diffusing panels under an interface: what is measured of them. ``python -m fitting.bench.interfaced``."""

from functools import partial
from typing import Any

from jaxtyping import Array

import vcavity_jax as vc
from fitting.bench import thesis_recipe
from fitting.bench.diffusing import (
    FRONTAL,
    REFLECTANCES,
    SHADOWED,
    SLANTED,
    SMALLEST,
    Direction,
    angles,
    made,
    traced,
)
from fitting.bench.measure import Peer, Quantity, Real, Spectrum

INDEX: Any = 1.5  # A plain number, as a user would give it.


def _ours(tolerance: float, light: Direction | None, view: Direction | None) -> Spectrum:
    def spectrum(angle: Array, optical: Array) -> Array:
        material = vc.InterfacedLambertian(optical, INDEX)
        one = made(vc.VGrooves(angle), material, light, view)
        return vc.reflectance_factor(one, tolerance, smallest_angle=SMALLEST)

    return spectrum


def _facets(angle: float, facets: int) -> Real:
    return thesis_recipe.interfaced(angle, REFLECTANCES, INDEX, facets)


_RECIPE = tuple(Peer(f"thesis's recipe, {2 * n} facets", partial(_facets, facets=n)) for n in (32, 128))

QUANTITIES = (
    Quantity(
        "interfaced",
        "n = 1.5, diffuse light, frontal view",
        partial(_ours, light=None, view=FRONTAL),
        REFLECTANCES,
        angles,
        (traced(FRONTAL, INDEX),),
        finest=1e-12,
    ),
    Quantity(
        "interfaced",
        "n = 1.5, frontal light and view",
        partial(_ours, light=FRONTAL, view=FRONTAL),
        REFLECTANCES,
        angles,
        _RECIPE,
        finest=1e-12,
    ),
    Quantity(
        "interfaced",
        "n = 1.5, light from 45°, view from 30°",
        partial(_ours, light=SLANTED, view=SHADOWED),
        REFLECTANCES,
        angles,
        finest=1e-12,
        gradient=False,
    ),
    Quantity(
        "interfaced",
        "n = 1.5, bi-hemispherical",
        partial(_ours, light=None, view=None),
        REFLECTANCES,
        angles,
        (traced(None, INDEX),),
        tolerances=(1e-3, 1e-6, 1e-9),
        finest=1e-10,
        together=1,
        gradient=False,
    ),
)

if __name__ == "__main__":
    from fitting.bench.report import main

    main("interfaced")
