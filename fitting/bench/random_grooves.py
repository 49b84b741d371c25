"""Random grooves, Beckmann-distributed: what is measured. ``python -m fitting.bench.random_grooves``."""

from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Array

import vcavity_jax as vc
from fitting.bench import path_tracer
from fitting.bench.diffusing import FRONTAL, PATHS, REFLECTANCES, Direction, made
from fitting.bench.measure import Peer, Quantity, Real, Spectrum
from fitting.bench.mirrors import GOLD, OBLIQUE


def roughnesses(count: int) -> Real:
    """Random, 0.05 to 1, evenly in their logarithm."""
    return np.exp(np.random.default_rng(2020).uniform(np.log(0.05), 0.0, count))


def _ours(tolerance: float, mirror: bool, view: Direction | None) -> Spectrum:
    def spectrum(roughness: Array, optical: Array) -> Array:
        material = vc.Specular(optical) if mirror else vc.Lambertian(optical)
        one = made(vc.BeckmannGrooves(roughness), material, None, view)
        return vc.reflectance_factor(one, tolerance)

    return spectrum


def _tabulated(tolerance: float) -> Spectrum:
    """The table is made once and for all; its own time is not counted."""
    gold: Any = GOLD
    table = vc.bihemispherical_table(vc.Specular(gold), tolerance, roughest=1.0)

    def spectrum(roughness: Array, optical: Array) -> Array:
        return table.average(roughness) + 0 * optical.real

    return spectrum


def _grooves(roughness: float, count: int, random: np.random.Generator) -> Real:
    """Random dihedral angles of Rayleigh-distributed slopes."""
    return np.asarray(2 * np.arctan2(1.0, roughness * np.sqrt(-2 * np.log(random.uniform(size=count)))))


def _traced(mirror: bool, view: Direction | None) -> Peer:
    count = PATHS // 4 if mirror else PATHS

    def run(roughness: float) -> Real:
        random = np.random.default_rng(0)
        angle = _grooves(roughness, count, random)
        if mirror:
            return path_tracer.mirrors(angle, GOLD, view, count, random)
        return path_tracer.diffusing(angle, REFLECTANCES, view, count, random)

    return Peer(f"path tracer, {count} paths", run, random=True)


_quantity = partial(
    Quantity, "random grooves", geometry=roughnesses, tolerances=(1e-3, 1e-6), finest=1e-8, gradient=False
)


def _averaged(name: str, mirror: bool, view: Direction | None) -> Quantity:
    """An average over angles: a scene is work enough for one call."""
    optical = GOLD if mirror else REFLECTANCES
    ours = partial(_ours, mirror=mirror, view=view)
    return _quantity(name=name, ours=ours, optical=optical, peers=(_traced(mirror, view),), together=1)


QUANTITIES = (
    _averaged("matte, diffuse light, frontal view", False, FRONTAL),
    _averaged("gold, diffuse light, oblique view", True, OBLIQUE),
    _averaged("gold, bi-hemispherical", True, None),
    _quantity(name="gold, bi-hemispherical, from a table", ours=_tabulated, optical=GOLD),
)

if __name__ == "__main__":
    from fitting.bench.report import main

    main("random grooves")
