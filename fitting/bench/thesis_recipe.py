"""The thesis's own recipe for V-grooves, plainly in NumPy: what vcavity replaces, for comparison only.

Diffusing panels: 32 facets per panel and one linear system of 64 unknowns
per wavelength [SaintPierre2020, chapter 3]. Mirror-like panels: 100 entry positions across the aperture, each
followed through all its reflections [chapter 4]. Diffusing panels under an interface: 32 facets per panel, and at
most one mirror reflection on the way in, between the panels and on the way out [chapter 5]. Errors of print are
corrected, so that what remains is the error of the method; docs/errata.md lists them. Angles in radians,
fractions out.
"""

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Direction = tuple[float, float]

FACETS = 32
ENTRIES = 100


def unit(direction: Direction) -> Real:
    """Direction (polar, azimuth) as a vector (eq. 3.30); azimuth 0 is across the grooves."""
    polar, azimuth = direction
    return np.array([np.sin(polar) * np.sin(azimuth), np.sin(polar) * np.cos(azimuth), np.cos(polar)])


def facet_matrix(angle: float, y: Real) -> Real:
    """K of both panels, from the center of each facet to the strips of the other panel (eq. 3.27, 3.28)."""
    half = 0.5 / len(y)

    def antiderivative(u: Real) -> Real:
        center = y[:, None]
        distance = np.sqrt(center**2 + u**2 - 2 * center * u * np.cos(angle))
        return np.pi / 2 * (u * np.cos(angle) - center) / distance

    block = antiderivative(y + half) - antiderivative(y - half)
    zero = np.zeros_like(block)
    return np.block([[zero, block], [block, zero]])


def projections(angle: float, y: Real, direction: Direction) -> Real:
    """Cosine between each facet and a direction, 0 where it is hidden (eq. 3.31, 3.37, 3.39).

    The Boolean holds for the center of a facet, and so for the whole of it.
    """
    _, across, normal = unit(direction)
    sine, cosine = np.sin(angle / 2), np.cos(angle / 2)
    cosines = []
    for side in (1, -1):
        crossing = (1 - y) * across / normal * cosine - side * y * sine
        cosines.append((np.abs(crossing) < sine) * max(side * across * cosine + normal * sine, 0))
    return np.concatenate(cosines)


def lambertian(
    angle: float, reflectance: Real, light: Direction | None, view: Direction | None, facets: int = FACETS
) -> Real:
    """Radiance factor of a groove with diffusing panels.

    Args:
        angle: dihedral angle.
        reflectance: one per wavelength, shape (L,).
        light: direction of a parallel light; None for diffuse light.
        view: direction of observation; None for all of the hemisphere.
        facets: on each panel.

    Returns:
        Mean over the visible facets, weighted with their projected area, shape (L,).
    """
    y = (np.arange(facets) + 0.5) / facets
    matrix = facet_matrix(angle, y)
    # What the other panel leaves of the hemisphere; eq. 3.41 with the panel's own normal.
    received = np.tile((1 - (np.cos(angle) - y) / np.sqrt(1 + y**2 - 2 * y * np.cos(angle))) / 2, 2)
    irradiance = received if light is None else projections(angle, y, light) / np.cos(light[0])
    system = np.eye(2 * facets) - (reflectance / np.pi)[:, None, None] * matrix
    radiance = reflectance[:, None] * np.linalg.solve(system, irradiance[:, None])[..., 0]
    if view is None:
        return radiance @ received / (facets * 2 * np.sin(angle / 2))
    seen = projections(angle, y, view)
    return radiance @ seen / seen.sum()


def amplitudes(cosine: Real, index: Complex) -> tuple[Complex, Complex]:
    """r_p and r_s of one reflection (eq. 2.22, 2.23), equal at normal incidence."""
    root = np.sqrt(index**2 - 1 + cosine**2)
    r_p, r_s = (root - index**2 * cosine) / (root + index**2 * cosine), (cosine - root) / (cosine + root)
    return np.asarray(r_p, complex), np.asarray(r_s, complex)


def uniform_entries(angle: float, count: int = ENTRIES) -> tuple[Real, Real]:
    """Evenly spaced positions across the aperture, and equal weights."""
    entry = ((np.arange(count) + 0.5) / count * 2 - 1) * np.sin(angle / 2)
    return entry, np.full(count, 1 / count)


def exact_entries(angle: float, view: Direction) -> tuple[Real, Real]:
    """One position in each piece of the aperture over which nothing changes, and the share of the piece.

    The thesis does not do this: with it the recipe is exact, and an independent check of vcavity.
    """
    e = unit(view)
    section = np.arctan2(e[1], e[2])
    gamma = angle * (np.arange(np.ceil(2 * np.pi / angle)) + 0.5)  # where eq. 4.12 jumps, and more
    offsets = np.concatenate([[0], np.sin(gamma - np.pi + section), np.sin(section + np.pi - gamma)])
    rim = np.sin(angle / 2)
    steps = np.clip((offsets + np.cos(angle / 2) * np.sin(section)) / np.cos(section), -rim, rim)
    edges = np.unique(np.concatenate([[-rim, rim], steps]))
    return (edges[1:] + edges[:-1]) / 2, np.diff(edges) / (2 * rim)


def specular(angle: float, index: Complex, view: Direction, entries: tuple[Real, Real] | None = None) -> Real:
    """Hemispherical-directional reflectance of a groove with mirror-like panels under diffuse light.

    All entry positions and wavelengths go through one reflection together.

    Args:
        angle: dihedral angle.
        index: n + ik, one per wavelength, shape (L,).
        view: direction of observation.
        entries: positions across the aperture and their weights; the thesis's by default.

    Returns:
        Mean over the entry positions, shape (L,).
    """
    e = unit(view)
    section = np.arctan2(e[1], e[2])
    entry, weight = uniform_entries(angle) if entries is None else entries
    offset = entry * np.cos(section) - np.cos(angle / 2) * np.sin(section)
    beta = section + np.pi - np.arcsin(offset)  # eq. 4.10
    side = np.where(offset < 0, 1, -1)  # the panel met first, eq. 4.4
    gamma = np.where(offset < 0, 2 * np.pi - beta, beta)  # eq. 4.11
    count = np.floor(gamma / angle - 0.5).astype(int) + 1  # eq. 4.12
    jones = np.broadcast_to(np.eye(2, dtype=complex), (len(entry), len(index), 2, 2)).copy()
    previous = np.zeros((len(entry), 3))
    for j in range(1, count.max() + 1):
        live = count >= j
        image = (j - 0.5) * angle
        normal = np.stack(  # eq. 4.37, 4.38
            [np.zeros(live.sum()), side[live] * np.cos(image), np.full(live.sum(), np.sin(image))], axis=-1
        )
        plane = np.cross(e, normal)  # eq. 4.24
        size = np.linalg.norm(plane, axis=-1, keepdims=True)
        plane = np.where(
            size > 0, plane / np.where(size > 0, size, 1), [1.0, 0.0, 0.0]
        )  # At normal incidence any.
        state = jones[live]
        if j > 1:  # eq. 4.17 with the sign of the angle, which eq. 4.25 loses
            cosine = np.sum(previous[live] * plane, axis=-1)[:, None, None]
            sine = (np.cross(previous[live], plane) @ e)[:, None, None]
            p, s = state[..., 0, :], state[..., 1, :]
            state = np.stack([cosine * p + sine * s, cosine * s - sine * p], axis=-2)
        r_p, r_s = amplitudes((normal @ e)[:, None], index)
        jones[live] = np.stack([r_p, r_s], axis=-1)[..., None] * state
        previous[live] = plane
    return weight @ np.sum(np.abs(jones) ** 2, axis=(-2, -1)) / 2  # eq. 4.23 and 4.28


def interface(cosine: Real, index: float) -> tuple[Real, Real]:
    """Unpolarized reflectance and transmittance of an interface for light from the air (eq. 2.22 to 2.26)."""
    r_p, r_s = amplitudes(np.maximum(cosine, 1e-12), np.asarray(index, complex))
    reflected = (np.abs(r_p) ** 2 + np.abs(r_s) ** 2) / 2
    return reflected, 1 - reflected


def internal_reflectance(index: float) -> float:
    """r_i = 1 - t₁₂ / n² of diffuse light (eq. 2.39), which chapter 5 refers to by another number."""
    node, weight = np.polynomial.legendre.leggauss(48)
    s = (node + 1) / 2  # the cosine is s², so that grazing incidence is smooth
    return float(1 - weight @ (2 * s**3 * interface(s**2, index)[1]) / index**2)


def interfaced_matrix(angle: float, index: float, y: Real) -> Real:
    """K' of both panels: from one to the other, and by one reflection from each to itself (eq. 5.10, 5.12).

    From the center of each facet to the strips, each integrated with 4 nodes, and 12 over the tilt of the rays
    along the fold: more would change the result by a 400th of the error of the facets and of one reflection.
    """
    strip, strip_weight = np.polynomial.legendre.leggauss(4)
    tilt, tilt_weight = np.polynomial.legendre.leggauss(12)
    tilt, tilt_weight = np.pi / 2 * tilt, np.pi / 2 * tilt_weight
    center, u = y[:, None, None], y[:, None] + strip / (2 * len(y))
    blocks = []
    for k in (0, 1):  # reflections
        psi = (k + 1) * angle
        distance = np.sqrt(center**2 + u**2 - 2 * center * u * np.cos(psi))
        passed = np.cos(tilt) ** 2 * (psi < np.pi)
        for j in range(k + 2):  # eq. 5.13
            cosine = (center * np.sin(j * angle) + u * np.sin((k + 1 - j) * angle)) / distance
            reflected, entered = interface(cosine[..., None] * np.cos(tilt), index)
            passed = passed * (reflected if 0 < j <= k else entered)
        kernel = center * u * np.sin(psi) ** 2 / distance**3 * (passed @ tilt_weight)
        blocks.append(kernel @ strip_weight / (2 * len(y) * index**2))
    across, same = blocks
    return np.block([[same, across], [across, same]])


def interfaced(angle: float, reflectance: Real, index: float, facets: int = FACETS) -> Real:
    """Radiance factor of a groove of diffusing panels under an interface, frontal light and view, no glint.

    Args:
        angle: dihedral angle.
        reflectance: intrinsic reflectance ρ, one per wavelength, shape (L,).
        index: refractive index n of the interface.
        facets: on each panel.

    Returns:
        Mean over the facets, shape (L,).
    """
    y = (np.arange(facets) + 0.5) / facets
    (reflected, entered), (_, second) = (interface(np.sin(np.asarray(a)), index) for a in (angle / 2, 1.5 * angle))
    irradiance = np.full(2 * facets, np.sin(angle / 2) * entered)  # eq. 5.4
    leaving = entered * np.eye(2 * facets)  # eq. 5.18
    if 1.5 * angle < np.pi:
        limit = min(np.sin(angle / 2) / np.sin(1.5 * angle), 1)  # eq. 5.7
        lit = np.sin(1.5 * angle) * reflected * second * (y < limit)  # eq. 5.6, with the angles in the other order
        irradiance += np.concatenate([lit, lit])
        facet = np.arange(facets)
        behind = (limit * y * facets).astype(int)  # eq. 5.20, by the facet that is seen
        for seen, source in ((facet, facets + behind), (facets + facet, behind)):
            leaving[seen, source] += reflected * second  # eq. 5.19
    ratio = (reflectance / (1 - internal_reflectance(index) * reflectance))[:, None]  # eq. 5.1
    system = np.eye(2 * facets) - ratio[..., None] / np.pi * interfaced_matrix(angle, index, y)
    exitance = ratio * np.linalg.solve(system, irradiance[:, None])[..., 0]  # eq. 5.16
    return exitance @ leaving.mean(axis=0) / index**2  # eq. 5.21 and 5.23
