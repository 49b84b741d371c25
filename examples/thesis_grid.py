"""The thesis's way to averages over directions: a grid in θ and φ, with its recipe in each direction.

It is treated kindly: the grid has the midpoints of its cells and exact weights, symmetries are used, and entries
and wavelengths are vectorized. Used by speed_of_geometries.py, as is the independent reference at the end.
"""

import numpy as np
from scipy.interpolate import CubicSpline

import vcavity_jax as vc
from fitting.bench import thesis_recipe
from fitting.bench.diffusing import REFLECTANCES, SLANTED
from fitting.bench.mirrors import GOLD
from fitting.bench.thesis_recipe import Direction, Real

EIGHT = np.deg2rad(8.0), 0.0
TRAP = -EIGHT[0], 0.0, vc.geometries.GLOSS_TRAP
TABULATED_DEG = 45, 60, 90, 120, 150, 180
"""The groove angles of the thesis, between which it interpolates."""

Weighted = tuple[list[Direction], Real]


def directions_on_grid(step_deg: float, azimuths_deg: float = 90.0) -> Weighted:
    """Directions at the midpoints of a grid in θ and φ, and their shares of the hemisphere's irradiance."""
    polar = np.deg2rad(np.arange(step_deg / 2, 90, step_deg))
    azimuth = np.deg2rad(np.arange(step_deg / 2, azimuths_deg, step_deg))
    pairs = [(float(t), float(p)) for t in polar for p in azimuth]
    weight = np.repeat(np.sin(2 * polar), len(azimuth))
    return pairs, weight / weight.sum()


def ring_on_grid(step_deg: float) -> Weighted:
    """A quarter of the ring at 45°."""
    azimuth = np.deg2rad(np.arange(step_deg / 2, 90, step_deg))
    return [(SLANTED[0], float(p)) for p in azimuth], np.full(len(azimuth), 1 / len(azimuth))


def mirrors_over(index: np.ndarray, angle: float, directions: Weighted) -> Real:
    """Mean of the hemispherical-directional reflectance over directions, with 100 entries each."""
    return sum(w * thesis_recipe.specular(angle, index, view) for view, w in zip(*directions, strict=True))


def random_mirrors_over_sphere(index: np.ndarray, roughness: float, step_deg: float) -> Real:
    """The recipe for random grooves: R̄ at six angles on the grid, a cubic between them, a sum in steps of 1°."""
    directions = directions_on_grid(step_deg)
    known = [mirrors_over(index, np.deg2rad(degrees), directions) for degrees in TABULATED_DEG]
    angles, weight = random_angles(roughness, 1.0)
    return weight @ CubicSpline(np.deg2rad(TABULATED_DEG), known)(angles)


def random_angles(roughness: float, step_deg: float) -> tuple[Real, Real]:
    """Groove angles at the midpoints of steps, and Beckmann's weights, those below 1e-16 left out."""
    angle = np.deg2rad(np.arange(step_deg / 2, 180, step_deg))
    slope = 1 / (np.tan(angle / 2) * roughness)
    weight = slope * np.exp(-(slope**2) / 2) / np.sin(angle / 2) ** 2
    weight /= weight.sum()
    return angle[weight > 1e-16], weight[weight > 1e-16]


def untrapped(angle: float, entries: tuple[Real, Real]) -> tuple[Real, Real]:
    """Entry positions seen at 8°, with the weights of those whose rays end in the gloss trap set to 0."""
    entry, weight = entries
    section = EIGHT[0]
    offset = entry * np.cos(section) - np.cos(angle / 2) * np.sin(section)
    beta = section + np.pi - np.arcsin(offset)  # as in thesis_recipe.specular
    gamma = np.where(offset < 0, 2 * np.pi - beta, beta)
    count = np.floor(gamma / angle - 0.5) + 1
    side = np.where(offset < 0, 1, -1)
    out = side * (2 * np.mod(count, 2) - 1) * np.sin(count * angle + side * section)
    up = -np.cos(count * angle + side * section)
    inside = out * np.sin(TRAP[0]) + up * np.cos(TRAP[0]) > np.cos(TRAP[2])
    return entry, np.where(inside, 0, weight) / (1 - np.sin(TRAP[2]) ** 2 * np.cos(TRAP[0]))


def trapped_mirrors(angle: float, exact: bool = False) -> Real:
    """Gold grooves in a sphere with a gloss trap."""
    entries = thesis_recipe.exact_entries(angle, EIGHT) if exact else thesis_recipe.uniform_entries(angle)
    return thesis_recipe.specular(angle, GOLD, EIGHT, untrapped(angle, entries))


def random_trapped_mirrors(roughness: float, step_deg: float) -> Real:
    """The same, summed over groove angles."""
    return sum(w * trapped_mirrors(a) for a, w in zip(*random_angles(roughness, step_deg), strict=True))


def facets_seen(angle: float, light: Weighted | None, views: Weighted) -> Real:
    """Diffusing panels in 2 x 32 facets, one linear system per wavelength, seen from each of the views.

    Views from which no facet's center is seen are left out.

    Args:
        angle: dihedral angle.
        light: directions and their shares of the irradiance; None for diffuse light.
        views: directions and their weights.
    """
    y = (np.arange(thesis_recipe.FACETS) + 0.5) / thesis_recipe.FACETS
    if light is None:
        received = (1 - (np.cos(angle) - y) / np.sqrt(1 + y**2 - 2 * y * np.cos(angle))) / 2
        irradiance = np.concatenate([received, received])
    else:
        lit = zip(*light, strict=True)
        irradiance = sum(w / np.cos(e[0]) * thesis_recipe.projections(angle, y, e) for e, w in lit)
    system = np.eye(len(y) * 2) - (REFLECTANCES / np.pi)[:, None, None] * thesis_recipe.facet_matrix(angle, y)
    radiance = REFLECTANCES[:, None] * np.linalg.solve(system, irradiance[:, None])[..., 0]
    seen = np.array([thesis_recipe.projections(angle, y, view) for view in views[0]])
    area = seen.sum(axis=1)
    weight = np.where(area > 0, views[1], 0)
    return radiance @ (weight / weight.sum() / np.maximum(area, 1e-30) @ seen)


def facets_in_trapped_sphere(angle: float, step_deg: float) -> Real:
    """The light as a grid of directions without those in the trap."""
    pairs, weight = directions_on_grid(step_deg, 360.0)
    unit = np.array([thesis_recipe.unit(pair) for pair in pairs])
    weight = np.where(unit @ thesis_recipe.unit(TRAP[:2]) > np.cos(TRAP[2]), 0, weight)
    return facets_seen(angle, (pairs, weight / weight.sum()), ([EIGHT], np.ones(1)))


def kinks_in_section(angle: float) -> Real:
    """Where R of a mirror groove has kinks: section angles θ' from 0 to π/2, both excluded."""
    k = np.arange(1, np.ceil(2 * np.pi / angle) + 2)
    marks = np.concatenate([[angle / 2], np.abs(k * angle - np.pi) / 2, np.abs((k - 0.5) * angle - np.pi)])
    return np.unique(np.round(marks[(marks > 1e-9) & (marks < np.pi / 2 - 1e-9)], 12))


def sphere_of_views(index: np.ndarray, angle: float) -> Real:
    """Bi-hemispherical reflectance by a fine quadrature of exact directional ones, independent of the direct sum.

    With e = (sin η, cos η sin t, cos η cos t) the irradiance is cos²η cos t dη dt, and kinks are at fixed t.
    """
    x, w = np.polynomial.legendre.leggauss(24)
    ends = np.concatenate([[0], kinks_in_section(angle), [np.pi / 2]])
    half = np.diff(ends)[:, None] / 2
    t, wt = (ends[:-1, None] + half * (1 + x)).ravel(), (half * w).ravel()
    v, wv = (1 + x) / 2, w / 2
    eta, weta = np.pi / 2 * (1 - v * v), np.pi * v * wv
    eta, t = np.meshgrid(eta, t)
    weight = (wt * np.cos(t[:, 0]))[:, None] * weta * np.cos(eta) ** 2 * 4 / np.pi
    polar = np.arctan2(np.hypot(np.sin(eta), np.cos(eta) * np.sin(t)), np.cos(eta) * np.cos(t))
    view = vc.View(polar.ravel(), np.arctan2(np.sin(eta), np.cos(eta) * np.sin(t)).ravel())
    seen = vc.reflectance_factor(vc.Scene(vc.VGrooves(angle), vc.Specular(index), vc.Diffuse(), view))
    return weight.ravel() @ np.asarray(seen)
