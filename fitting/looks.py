"""One scene with something free in it, as several looks see it: the model once for each light."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import vcavity_jax as vc
from fitting.assembly import build
from fitting.layout import Data, Layout
from fitting.measurement import Measurement
from fitting.problem import Problem
from fitting.target import Look
from vcavity_jax import colorimetry

Places = tuple[tuple[int, int], ...]
"""Of each look: which light, and which view in it."""


def seen_from(
    scene: Any, free: Sequence[Any], looks: Sequence[Look], wavelengths_nm: np.ndarray, tolerance: float
) -> tuple[Problem, Places]:
    """The scene in each light, with all views of the looks in it.

    Raises:
        ValueError: no scene, a parameter of an instrument, or what ``fit`` refuses.
    """
    if not isinstance(scene, vc.Scene):
        raise ValueError(f"scene is a {type(scene).__name__}; expected a Scene")
    for one in free:
        role = getattr(one, "role", "scene")
        if role != "scene":
            raise ValueError(f"parameter {one.name!r} belongs to an instrument; expected parameters of the scene")
    lights: list[Any] = []
    members: list[list[Look]] = []
    places = []
    for look in looks:
        light = scene.illumination if look.illumination is None else look.illumination
        at = next((i for i, known in enumerate(lights) if bool(eqx.tree_equal(known, light))), None)
        if at is None:
            lights.append(light)
            members.append([])
            at = len(lights) - 1
        members[at].append(look)
        places.append((at, len(members[at]) - 1))
    measurements, scenes = {}, {}
    for i, (light, group) in enumerate(zip(lights, members, strict=True)):
        polar, azimuth = (np.array([getattr(look, n) for look in group]) for n in ("polar", "azimuth"))
        flat = np.full((len(group), len(wavelengths_nm)), 0.5)
        measurements[str(i)] = Measurement(wavelengths_nm, polar, azimuth, flat, np.full(flat.shape, 0.01), light)
        scenes[str(i)] = vc.Scene(scene.surface, scene.material, light, measurements[str(i)].view)
    if len(lights) == 1:
        return build(scenes["0"], measurements["0"], free, None, tolerance, enough=False), tuple(places)
    return build(scenes, measurements, free, None, tolerance, enough=False), tuple(places)


def finite_bounds(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Of the numbers, in natural coordinates.

    Raises:
        ValueError: a number has none.
    """
    low, high = np.asarray(problem.data.bounds, np.float64)
    finite = np.isfinite(low) & np.isfinite(high)
    if not finite.all():
        name = problem.numbers[int(np.argmin(finite))].name
        raise ValueError(f"parameter {name!r} has no finite range; expected bounds")
    return low, high


def factors_of(layout: Layout, places: Places, x: Float[Array, " n"], data: Data) -> Float[Array, "k l"]:
    """Reflectance factors of each look, of numbers in natural coordinates and then free spectra."""
    count = x.shape[0] - layout.free_spectra * layout.blocks
    spectra = x[count:].reshape(layout.free_spectra, layout.blocks)
    found = [
        layout.factor(part, *layout.inputs(part, x[:count], spectra), known)
        for part, known in zip(layout.parts, data.known, strict=True)
    ]
    return jnp.stack([found[part][row] for part, row in places])


def color_weights(looks: Sequence[Look], wavelengths_nm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """From a spectrum to the tristimulus values of each look, shape (K, L, 3), and of its white, (K, 3)."""
    weights = np.zeros((len(looks), len(wavelengths_nm), 3))
    for k, look in enumerate(looks):
        light: Any = look.illuminant, look.observer
        weights[k] = np.asarray(colorimetry.xyz(np.eye(len(wavelengths_nm)), wavelengths_nm, *light))
    return weights, weights.sum(axis=1)
