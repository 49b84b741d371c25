"""What a plan is made from: candidate directions and their lights, what is measured, wavelengths and noise."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

import vcavity_jax as vc
from fitting.measurement import Measurement
from fitting.view_plan import PlannedView

_POLAR, _AZIMUTHS = np.arange(0.0, 81.0, 5.0), (0.0, 45.0, 90.0)


class Group(NamedTuple):
    """Candidates in one light: (light, view), as arrays of polar angles and azimuths; NaN if all light counts."""

    light: Any
    polar: np.ndarray
    azimuth: np.ndarray
    hemispherical: bool


def _directions(given: Any, what: str) -> tuple[np.ndarray, np.ndarray]:
    """Polar angles and azimuths, one axis each."""
    if isinstance(given, vc.View):
        pair: Any = given.polar, given.azimuth
    elif isinstance(given, tuple | list) and len(given) == 2:
        pair = given
    else:
        raise ValueError(
            f"{what}: {type(given).__name__}; expected a View, or polar angles and azimuths, (polar, azimuth)"
        )
    try:
        polar, azimuth = (
            np.array(a).ravel() for a in np.broadcast_arrays(*(np.asarray(a, np.float64) for a in pair))
        )
    except (ValueError, TypeError):
        raise ValueError(
            f"{what}: polar and azimuth do not broadcast; expected numbers of matching shapes"
        ) from None
    if not polar.size:
        raise ValueError(f"{what}: no direction; expected at least one")
    for name, angles in (("polar", polar), ("azimuth", azimuth)):
        limit, words = np.pi / 2, "between -π/2 and π/2"
        if name == "azimuth":
            limit, words = 2 * np.pi + 1e-9, "-2π to 2π"
        bad = ~(np.abs(angles) < limit)
        if bad.any():
            raise ValueError(
                f"{what}: {name}[{int(np.argmax(bad))}] is {angles[bad][0]:g}; expected {words} radians: "
                "did you pass degrees?"
            )
    return polar, azimuth


def _distinct(polar: np.ndarray, azimuth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Without the frontal directions of other azimuths than the first."""
    frontal = polar == 0
    kept = ~frontal | (azimuth == azimuth[np.argmax(frontal)])
    return polar[kept], azimuth[kept]


def groups_of(candidates: Any, scene: Any) -> dict[str, Group]:
    """The candidates by the name of their light."""
    if candidates is None:
        azimuth, polar = np.meshgrid(np.radians(_AZIMUTHS), np.radians(_POLAR), indexing="ij")
        candidates = polar, azimuth
    if not isinstance(candidates, Mapping):
        polar, azimuth = _distinct(*_directions(candidates, "candidates"))
        return {type(scene.illumination).__name__.lower(): Group(scene.illumination, polar, azimuth, False)}
    found = {}
    for name, pair in candidates.items():
        if not (isinstance(pair, tuple | list) and len(pair) == 2):
            raise ValueError(
                f"candidates[{name!r}] is a {type(pair).__name__}; expected (illumination, directions)"
            )
        light, view = pair
        if isinstance(view, vc.Hemisphere):
            nowhere = np.full(1, np.nan)
            found[str(name)] = Group(light, nowhere, nowhere, True)
        else:
            found[str(name)] = Group(light, *_distinct(*_directions(view, f"candidates[{name!r}]")), False)
        if not isinstance(light, vc.scene.Illumination):
            raise ValueError(
                f"candidates[{name!r}]: {type(light).__name__} is not a light; expected (illumination, directions)"
            )
    if not found:
        raise ValueError("candidates is empty; expected at least one light with its directions")
    return found


def already_measured(measured: Any, scene: Any) -> dict[str, Any]:
    """What is measured already, by label."""
    if measured is None:
        return {}
    if isinstance(measured, Measurement):
        return {"measured": measured}
    if isinstance(measured, Mapping):
        found = {str(k): v for k, v in measured.items()}
    elif isinstance(measured, Sequence) and all(isinstance(m, Measurement) for m in measured):
        found = {str(i): m for i, m in enumerate(measured)}
    else:
        return {"measured": Group(scene.illumination, *_directions(measured, "measured"), False)}
    wrong = next((m for m in found.values() if not isinstance(m, Measurement)), None)
    if wrong is not None:
        raise ValueError(
            f"measured holds a {type(wrong).__name__}; expected a Measurement, several, or directions"
        )
    return found


def planned_wavelengths(given: Any, known: dict[str, Any], scene: Any, noise: Any) -> tuple[np.ndarray, bool]:
    """Wavelengths of the planned views, and whether they are only numbers of places."""
    if given is not None:
        return np.atleast_1d(np.asarray(given, np.float64)), False
    for m in known.values():
        if isinstance(m, Measurement):
            return m.wavelengths_nm, False
    shapes = [np.shape(leaf) for leaf in [*jax.tree.leaves(scene.material), *([] if noise is None else [noise])]]
    length = max((shape[0] for shape in shapes if len(shape) == 1), default=1)
    return np.arange(1.0, length + 1.0), True


def planned_noise(noise: Any, known: dict[str, Any], length: int) -> np.ndarray:
    """Standard uncertainty of a planned value at each wavelength."""
    if noise is None:
        stated = [m for m in known.values() if isinstance(m, Measurement) and m.standard_uncertainty is not None]
        if not stated:
            raise ValueError(
                "noise is None, and no measurement states its uncertainty; expected a number, as 0.005"
            )
        present = [np.asarray(m.standard_uncertainty)[~np.isnan(m.reflectance_factor)] for m in stated]
        noise = np.sqrt(np.mean(np.concatenate(present) ** 2))
    sigma = np.asarray(noise, np.float64)
    if sigma.shape not in ((), (length,)):
        raise ValueError(
            f"noise has shape {sigma.shape}; expected one number, or one for each of {length} wavelengths"
        )
    bad = ~((sigma > 0) & np.isfinite(sigma))
    if bad.any():
        raise ValueError(f"noise is {sigma.flat[int(np.argmax(bad))]:g}; expected positive numbers, as fractions")
    return np.broadcast_to(sigma, (length,))


def listed(known: dict[str, Any]) -> tuple[PlannedView, ...]:
    """The directions that are measured already."""
    return tuple(
        PlannedView(label, float(polar), float(azimuth))
        for label, one in known.items()
        for polar, azimuth in zip(one.polar, one.azimuth, strict=True)
    )
