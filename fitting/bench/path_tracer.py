"""A plain Monte Carlo path tracer for grooves, in NumPy: what a renderer does, without its overhead.

Paths start at the detector and end in diffuse light. Of diffusing panels only the number of scatterings counts, so
that one run serves all wavelengths. Directions are unit vectors (along the fold, across, up).
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting.bench.thesis_recipe import amplitudes

Real = NDArray[np.float64]
MOST_SCATTERINGS = 400


class _Rays(NamedTuple):
    """Where rays are in the cross-section (across, up), and where they go."""

    place: Real
    direction: Real


def _walls(angle: Real) -> tuple[Real, Real]:
    """Unit vectors along both panels in the section, and their normals, as (n, 2, 3)."""
    s, c, zero = np.sin(angle / 2), np.cos(angle / 2), np.zeros_like(angle)
    along = np.stack([np.stack([zero, -s, c], -1), np.stack([zero, s, c], -1)], 1)
    normal = np.stack([np.stack([zero, c, s], -1), np.stack([zero, -c, s], -1)], 1)
    return along, normal


def _next(rays: _Rays, along: Real, normal: Real, last: NDArray[np.int64]) -> tuple[NDArray[np.int64], Real]:
    """Which panel each ray meets (-1 for none) and where; ``last`` is the panel it comes from, -1 for the sky."""
    panel, distance = np.full(len(last), -1), np.full(len(last), np.inf)
    for side in (0, 1):
        speed = np.einsum("ij,ij->i", rays.direction, normal[:, side])
        height = np.einsum("ij,ij->i", rays.place, normal[:, side])
        with np.errstate(divide="ignore", invalid="ignore"):
            length = -height / speed
        reached = rays.place + length[:, None] * rays.direction
        depth = np.einsum("ij,ij->i", reached, along[:, side])
        met = (last != side) & (speed < 0) & (length >= 0) & (depth >= 0) & (depth <= 1) & (length < distance)
        panel[met], distance[met] = side, length[met]
    return panel, rays.place + np.where(panel >= 0, distance, 0)[:, None] * rays.direction


def _start(angle: Real, view: tuple[float, float] | None, random: np.random.Generator) -> _Rays:
    """On the aperture, on the way into the groove; from one direction, or from all (Lambertian)."""
    count = len(angle)
    across = random.uniform(-1, 1, count) * np.sin(angle / 2)
    place = np.stack([np.zeros(count), across, np.cos(angle / 2)], -1)
    if view is None:
        sine, azimuth = np.sqrt(random.uniform(size=count)), random.uniform(0, 2 * np.pi, count)
        upward = np.stack([sine * np.sin(azimuth), sine * np.cos(azimuth), np.sqrt(1 - sine**2)], -1)
    else:
        polar, turn = view
        towards = [np.sin(polar) * np.sin(turn), np.sin(polar) * np.cos(turn), np.cos(polar)]
        upward = np.broadcast_to(np.array(towards), (count, 3))
    return _Rays(place, -upward)


def _scattered(normal: Real, along: Real, random: np.random.Generator) -> tuple[Real, Real]:
    """Lambertian directions above panels, and their cosines."""
    count = len(normal)
    sine, azimuth = np.sqrt(random.uniform(size=count)), random.uniform(0, 2 * np.pi, count)
    cosine = np.sqrt(1 - sine**2)
    fold = np.zeros((count, 3))
    fold[:, 0] = 1
    plane = (sine * np.cos(azimuth))[:, None] * fold + (sine * np.sin(azimuth))[:, None] * along
    return plane + cosine[:, None] * normal, cosine


def diffusing(
    angle: Any,
    reflectance: Real,
    view: tuple[float, float] | None,
    paths: int,
    random: np.random.Generator,
    index: float = 1.0,
) -> Real:
    """Reflectance factor (or, seen by the hemisphere, reflectance) of diffusing panels in diffuse light.

    Args:
        angle: dihedral angle, radians; one, or one for each path.
        reflectance: of the panels, below their interface if there is one, shape (L,).
        view: polar angle and azimuth; None for all directions.
        paths: how many.
        random: generator.
        index: of a smooth interface; 1 for none.

    Returns:
        Shape (L,).
    """
    angles = np.broadcast_to(np.asarray(angle, float), (paths,))
    along, normal = _walls(angles)
    rays = _start(angles, view, random)
    last, scatterings = np.full(paths, -1), np.zeros(paths, int)
    ended = np.zeros(MOST_SCATTERINGS + 1)
    alive = np.arange(paths)
    while alive.size:
        place = _Rays(rays.place[alive], rays.direction[alive])
        panel, reached = _next(place, along[alive], normal[alive], last[alive])
        gone = panel < 0
        np.add.at(ended, np.minimum(scatterings[alive[gone]], MOST_SCATTERINGS), 1)
        alive, panel, reached = alive[~gone], panel[~gone], reached[~gone]
        wall, up = along[alive, panel], normal[alive, panel]
        incoming = rays.direction[alive]
        cosine = -np.einsum("ij,ij->i", incoming, up)
        direction = incoming + 2 * cosine[:, None] * up
        enters = np.ones(alive.size, bool)
        if index != 1:
            enters = random.uniform(size=alive.size) >= _fresnel(cosine, index)
        inside = np.flatnonzero(enters)
        while inside.size:
            scatterings[alive[inside]] += 1
            outward, below = _scattered(up[inside], wall[inside], random)
            squared = 1 - index**2 * (1 - below**2)  # of the cosine above the interface
            above = np.sqrt(np.maximum(squared, 0))
            leaves = (squared > 0) & (random.uniform(size=inside.size) >= _fresnel(above, index))
            leaves |= scatterings[alive[inside]] >= MOST_SCATTERINGS
            bent = index * (outward - below[:, None] * up[inside]) + above[:, None] * up[inside]
            direction[inside[leaves]] = bent[leaves]
            inside = inside[~leaves]
        rays.place[alive], rays.direction[alive] = reached, direction
        last[alive] = panel
        alive = alive[scatterings[alive] < MOST_SCATTERINGS]
    return np.asarray(np.polynomial.polynomial.polyval(reflectance, ended / paths))


def mirrors(
    angle: Any, index: Any, view: tuple[float, float] | None, paths: int, random: np.random.Generator
) -> Real:
    """Reflectance factor (or reflectance) of mirror-like panels in diffuse light, polarization followed exactly.

    Args:
        angle: dihedral angle, radians; one, or one for each path.
        index: n + ik, shape (L,).
        view: polar angle and azimuth; None for all directions.
        paths: how many.
        random: generator.

    Returns:
        Shape (L,).
    """
    angles = np.broadcast_to(np.asarray(angle, float), (paths,))
    along, normal = _walls(angles)
    rays = _start(angles, view, random)
    last = np.full(paths, -1)
    # Jones matrices from two transverse axes at the start to two at the end, for every wavelength.
    first, second = _transverse(rays.direction)
    state = np.broadcast_to(np.eye(2, dtype=complex), (paths, len(index), 2, 2)).copy()
    total = np.zeros(len(index))
    alive = np.arange(paths)
    while alive.size:
        place = _Rays(rays.place[alive], rays.direction[alive])
        panel, reached = _next(place, along[alive], normal[alive], last[alive])
        gone = panel < 0
        total += np.sum(np.abs(state[alive[gone]]) ** 2, axis=(0, 2, 3)) / 2
        alive, panel, reached = alive[~gone], panel[~gone], reached[~gone]
        if not alive.size:
            break
        up, incoming = normal[alive, panel], rays.direction[alive]
        cosine = -np.einsum("ij,ij->i", incoming, up)
        direction = incoming + 2 * cosine[:, None] * up
        s = np.cross(incoming, up)
        size = np.linalg.norm(s, axis=-1, keepdims=True)
        s = np.where(size > 1e-12, s / np.where(size > 1e-12, size, 1), first[alive])
        p_in, p_out = np.cross(s, incoming), np.cross(s, direction)
        axes = first[alive], second[alive]
        turn = np.array([[_dot(to, axis) for axis in axes] for to in (s, p_in)])
        r_p, r_s = amplitudes(np.clip(cosine, 0, 1)[:, None], np.asarray(index, complex))
        turned = np.einsum("abn,nlbc->nlac", turn, state[alive])
        # r_p = r_s at normal incidence, where both axes are mirrored: the sign of p_out is that of p_in mirrored.
        turned[:, :, 0] *= r_s[..., None]
        turned[:, :, 1] *= -r_p[..., None]
        state[alive] = turned
        first[alive], second[alive] = s, p_out
        rays.place[alive], rays.direction[alive] = reached, direction
        last[alive] = panel
    return total / paths


def _dot(a: Real, b: Real) -> Real:
    return np.einsum("ij,ij->i", a, b)


def _transverse(direction: Real) -> tuple[Real, Real]:
    other = np.where(np.abs(direction[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = np.cross(direction, other)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    return first, np.cross(direction, first)


def _fresnel(cosine: Real, index: float) -> Real:
    """Unpolarized reflectance of a dielectric."""
    r_p, r_s = amplitudes(np.maximum(cosine, 1e-12), np.asarray(index, complex))
    return np.asarray((np.abs(r_p) ** 2 + np.abs(r_s) ** 2) / 2)
