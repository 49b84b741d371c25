"""What directions cannot see of what is asked of them: said in words, with the direction to add.

The rules are those of a groove in diffuse light. A Lambertian one sends the same in all directions within
|θ'| < α/2, where tan θ' = tan θ cos φ: one value, and one equation for the angle and the reflectance.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

import vcavity_jax as vc
from fitting.layout import Part
from fitting.problem import Problem
from fitting.result import Estimate
from vcavity_jax.planning import interfaced_panel

# Roughness below which a matte surface, or an interfaced one seen from the front, looks flat to 0.0025, and a
# mirror seen from the front to 0.0005.
_FLAT: dict[type, tuple[float, float]] = {vc.BeckmannGrooves: (0.1, 0.2), vc.GaussianGrooves: (0.14, 0.24)}
_ALONG = 1e-6
_SAME = np.radians(0.5)
"""Directions nearer to each other than this count once."""

_GRAZING_DEG = 75.0


@dataclass(frozen=True)
class _View:
    """One measurement as the rules see it.

    Args:
        part: its share of the fit.
        known: polar angles and azimuths that the data distinguish; None if light and view are both averaged.
        section: |θ'| of these directions, radians.
        averaged: light or view averages over the hemisphere; which of them does not matter, by reciprocity.
        kind: "matte", "glossy" (scattering under an interface) or "mirror".
        angle: estimate of the dihedral angle, if it is free.
        unknown: unknown spectra, of any form.
    """

    part: Part
    known: tuple[np.ndarray, np.ndarray] | None
    section: np.ndarray
    averaged: bool
    kind: str
    angle: Estimate | None
    unknown: int


def known_directions(problem: Problem, index: int) -> tuple[np.ndarray, np.ndarray] | None:
    """Polar angles and azimuths that the data of a measurement distinguish; None if there are none.

    Where all reflected light is collected they are those of the light, by reciprocity.
    """
    measurement, light = problem.measurements[index], problem.layout.parts[index].scene.illumination
    if not measurement.hemispherical:
        used = np.asarray(problem.data.weights[index]).max(axis=1) > 0
        return measurement.polar[used], measurement.azimuth[used]
    if isinstance(light, vc.Directional):
        return np.asarray(light.polar, np.float64)[None], np.asarray(light.azimuth, np.float64)[None]
    return None


def more_to_measure(problem: Problem) -> str:
    """What measurement would say more, in words that follow "or"."""
    if not all(m.hemispherical for m in problem.measurements):
        return "add directions"
    if all(known_directions(problem, i) is None for i in range(len(problem.measurements))):
        return "measure in single directions, as in d:8"
    return "add directions of the light (as views in diffuse light, by reciprocity)"


def blind_spots(problem: Problem, estimates: Mapping[str, Any]) -> list[str]:
    """What the geometry cannot see of what is asked of it, one sentence each."""
    views = [_view(problem, i, estimates) for i in range(len(problem.measurements))]
    found: list[str] = []
    for view in views:
        rules = [_along_the_grooves, _plateau, _too_few, _blind_mirror, _one_sided_fan, _too_smooth]
        for rule in rules:
            # Several measurements make up for each other: what one cannot see, another may.
            said = rule(problem, view, views, estimates)
            if said and said not in found:
                found.append(said)
    return found


def _view(problem: Problem, index: int, estimates: Mapping[str, Any]) -> _View:
    part = problem.layout.parts[index]
    scene, known = part.scene, known_directions(problem, index)
    section = np.empty(0)
    if known is not None:
        polar, azimuth = known
        section = np.abs(np.arctan2(np.sin(polar) * np.cos(azimuth), np.cos(polar)))
    kind = "mirror" if isinstance(scene.material, vc.Specular) else "glossy"
    if kind == "glossy" and interfaced_panel(scene.material) is None:
        kind = "matte"
    angle = next(
        (estimates[problem.numbers[k].name] for k, parts in problem.angles.items() if index in parts), None
    )
    averaged = isinstance(scene.illumination, vc.Diffuse) or problem.measurements[index].hemispherical
    return _View(part, known, section, averaged, kind, angle, sum(len(s.rows) for s in part.spectral))


def _fits_surface(problem: Problem, view: _View) -> bool:
    """Whether the groove's angle or the roughness is searched."""
    return view.angle is not None or any(p.name.startswith("roughness") for p in problem.searched)


def _along_the_grooves(
    problem: Problem, view: _View, views: list[_View], estimates: Mapping[str, Any]
) -> str | None:
    across = any((v.section >= _ALONG).any() for v in views)
    if view.kind != "matte" or view.known is None or across or not _fits_surface(problem, view):
        return None
    if not (np.abs(view.known[0]) > _ALONG).any():
        return None
    return (
        "all directions lie along the grooves (tan θ' = tan θ cos φ = 0): they tell no more about "
        "the grooves than one frontal view; add directions across them"
    )


def _plateau(problem: Problem, view: _View, views: list[_View], estimates: Mapping[str, Any]) -> str | None:
    """An unknown reflectance needs a direction within |θ'| < α/2 and one beyond."""
    if view.kind != "matte" or not view.unknown or view.angle is None or view.known is None or not view.averaged:
        return None
    sections = np.concatenate([v.section for v in views if v.kind == "matte"])
    half = view.angle.value / 2
    slack = view.angle.standard_error if np.isfinite(view.angle.standard_error) else 0.0
    half_deg, far_deg = np.degrees(half), np.degrees(sections.max())
    if sections.max() <= half + slack:
        beyond = f"add one beyond {half_deg:.0f} degrees across the grooves"
        if half_deg > 85:
            beyond = "add one as grazing as you can across the grooves"
        return (
            "the angle and an unknown reflectance are not identifiable from these directions, all within half "
            f"the angle of the normal (up to {far_deg:.0f} of {half_deg:.0f} degrees, measured as tan θ' = "
            f"tan θ cos φ): {beyond}"
        )
    if sections.min() >= half:
        return (
            f"no direction lies within half the angle of the normal ({half_deg:.0f} degrees), where both panels "
            "are seen: add a frontal view"
        )
    loose = [p for p in problem.numbers if p.role in ("gain", "offset") and p.gaussian is None]
    outside = len(_distinct(sections[sections > half]))
    if loose and outside < 2:
        return (
            f"a free {' and '.join(p.role for p in loose)} needs at least 2 distinct directions beyond half the "
            f"angle ({half_deg:.0f} degrees) across the grooves, and there is {outside}: add one, or give a prior"
        )
    return None


def _distinct(angles: np.ndarray) -> np.ndarray:
    ordered = np.sort(angles)
    return ordered[np.diff(ordered, prepend=-np.inf) > _SAME] if len(ordered) else ordered


def _too_few(problem: Problem, view: _View, views: list[_View], estimates: Mapping[str, Any]) -> str | None:
    """One equation per distinct direction, against the unknowns of each wavelength and the groove."""
    free = sum(len(s.rows) for s in view.part.spectral if s.source is None)
    if not free or view.known is None or not _fits_surface(problem, view) or not view.averaged:
        return None
    if view.kind == "matte":
        count = len(_distinct(np.concatenate([v.section for v in views])))
        what = "distinct directions across the grooves"
    else:
        every = [v.known for v in views if v.known is not None]
        polar, azimuth = (np.concatenate(parts) for parts in zip(*every, strict=True))
        sine = np.abs(np.sin(polar))
        cells = {
            (round(float(a) / _SAME), round(float(b) / _SAME))
            for a, b in zip(sine * np.abs(np.cos(azimuth)), sine * np.abs(np.sin(azimuth)), strict=True)
        }
        count, what = len(cells), "distinct directions"
    needed = 1 + free
    if count >= needed:
        return None
    return (
        f"{count} {what} for {needed} unknowns (the groove's and {free} at each wavelength): add at least "
        f"{needed - count}, one of them at θ ≥ {_GRAZING_DEG:.0f} degrees across the grooves"
    )


def _blind_mirror(problem: Problem, view: _View, views: list[_View], estimates: Mapping[str, Any]) -> str | None:
    steep = view.angle is not None and view.angle.value > np.radians(120)
    near = all((v.section < np.radians(30)).all() for v in views)
    if view.kind != "mirror" or view.known is None or not (view.averaged and steep and near):
        return None
    return (
        "each ray is reflected once, near the normal, where the reflectance hardly depends on the angle: "
        f"these directions are blind; add one at θ ≥ {_GRAZING_DEG:.0f} degrees across the grooves"
    )


def _one_sided_fan(problem: Problem, view: _View, views: list[_View], estimates: Mapping[str, Any]) -> str | None:
    """A tilt moves +θ and -θ in opposite ways, the groove's angle in the same way."""
    if not view.part.tilts or view.known is None or not _fits_surface(problem, view):
        return None
    polar, azimuth = view.known
    along, across = np.sin(polar) * np.sin(azimuth), np.sin(polar) * np.cos(azimuth)
    missing = []
    for k in np.flatnonzero(np.abs(across) > np.sin(_SAME)):
        apart = np.hypot(along[k] + along, across[k] + across)
        other = np.hypot(along[k] - along, across[k] + across)
        if min(apart.min(), other.min()) > np.sin(2 * _SAME):
            missing.append(-np.degrees(polar[k]) if abs(np.cos(azimuth[k])) > 0.5 else np.degrees(polar[k]))
    if not missing:
        return None
    shown = ", ".join(f"{m:.0f}" for m in sorted(set(np.round(missing)))[:6])
    return (
        "a tilt of the sample is free and the directions are not symmetric about the normal: measure +θ and -θ "
        f"(add {shown} degrees at the same azimuth), where the tilt costs nothing"
    )


def _too_smooth(problem: Problem, view: _View, views: list[_View], estimates: Mapping[str, Any]) -> str | None:
    scene = view.part.scene
    rough = next((estimates[p.name] for p in problem.searched if p.name.startswith("roughness")), None)
    if rough is None or not view.averaged or not isinstance(scene.surface, tuple(_FLAT)):
        return None
    frontal = view.known is not None and bool((np.abs(view.known[0]) < np.radians(60)).all())
    matte_limit, mirror_limit = _FLAT[type(scene.surface)]
    # Whatever is glossy changes with its roughness if it is seen at grazing angles.
    limit = (mirror_limit if view.kind == "mirror" else matte_limit) if view.kind == "matte" or frontal else 0.0
    if rough.value >= limit:
        return None
    return (
        f"roughness {rough.value:.2g} is below {limit}, where the reflectance no longer depends on "
        "it: take the interval's upper end as a limit"
    )
