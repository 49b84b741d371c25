"""Mirror-like panels: what is measured of them. ``python -m fitting.bench.mirrors``."""

from functools import partial

import numpy as np
from jaxtyping import Array

import vcavity_jax as vc
from fitting.bench import path_tracer, thesis_recipe
from fitting.bench.diffusing import FRONTAL, PATHS, SMALLEST, Direction, angles, made
from fitting.bench.measure import Peer, Quantity, Real, Spectrum

_KNOTS = (380, 480, 550, 600, 730)
WAVELENGTHS_NM = np.linspace(380, 730, 36)
_N, _K = (1.6, 1.3, 0.34, 0.22, 0.15), (1.9, 1.8, 2.6, 3.1, 4.2)
GOLD = np.interp(WAVELENGTHS_NM, _KNOTS, _N) + 1j * np.interp(WAVELENGTHS_NM, _KNOTS, _K)
OBLIQUE: Direction = (float(np.radians(35.0)), float(np.radians(30.0)))


def _ours(tolerance: float, view: Direction | None) -> Spectrum:
    def spectrum(angle: Array, optical: Array) -> Array:
        one = made(vc.VGrooves(angle), vc.Specular(optical), None, view)
        return vc.reflectance_factor(one, tolerance, smallest_angle=SMALLEST)

    return spectrum


def _exact(angle: float, view: Direction) -> Real:
    return thesis_recipe.specular(angle, GOLD, view, thesis_recipe.exact_entries(angle, view))


def _recipe(view: Direction) -> tuple[Peer, ...]:
    named = {n: partial(_entries, view=view, entries=n) for n in (100, 1000)}
    return tuple(Peer(f"thesis's recipe, {n} entries", run) for n, run in named.items())


def _entries(angle: float, view: Direction, entries: int) -> Real:
    return thesis_recipe.specular(angle, GOLD, view, thesis_recipe.uniform_entries(angle, entries))


def _sampled_hemisphere(angle: float, step_deg: float) -> Real:
    """Directions on a grid of one quadrant, which stands for all, each by the thesis's recipe."""
    polar = np.radians(np.arange(step_deg / 2, 90, step_deg))
    azimuth = np.radians(np.arange(step_deg / 2, 90, step_deg))
    weight = np.cos(polar) * np.sin(polar)
    total = np.zeros(GOLD.size)
    for theta, w in zip(polar, weight / (weight.sum() * azimuth.size), strict=True):
        for phi in azimuth:
            total += w * thesis_recipe.specular(angle, GOLD, (float(theta), float(phi)))
    return total


def _traced(view: Direction | None) -> Peer:
    def run(angle: float) -> Real:
        return path_tracer.mirrors(angle, GOLD, view, PATHS // 4, np.random.default_rng(0))

    return Peer(f"path tracer, {PATHS // 4} paths", run, random=True)


QUANTITIES = (
    *(
        Quantity(
            "mirrors",
            f"gold, diffuse light, {name} view",
            partial(_ours, view=view),
            GOLD,
            angles,
            (*_recipe(view), _traced(view)),
            exact=partial(_exact, view=view),
            tolerances=(1e-6,),
        )
        for name, view in (("frontal", FRONTAL), ("oblique", OBLIQUE))
    ),
    Quantity(
        "mirrors",
        "gold, bi-hemispherical",
        partial(_ours, view=None),
        GOLD,
        angles,
        (Peer("thesis's recipe, steps of 10°", lambda angle: _sampled_hemisphere(angle, 10.0)), _traced(None)),
        tolerances=(1e-3, 1e-6, 1e-9),
        finest=1e-10,
        together=1,
    ),
)

if __name__ == "__main__":
    from fitting.bench.report import main

    main("mirrors")
