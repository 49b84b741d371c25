"""A dense Nyström solve of the radiosity of a groove, plainly in NumPy: what a numerical analyst would write."""

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]


def open_groove(angle: float, reflectance: Real, diffuse: bool, nodes: int) -> Real:
    """Reflectance factor seen from the front, in diffuse or in frontal light.

    Gauss nodes y = x³ crowd at the fold, where the kernel is singular; the row sums, known exactly, correct the
    diagonal: K L = F(y) L(y) + Σ w k(y, y') (L(y') - L(y)).

    Args:
        angle: dihedral angle, radians.
        reflectance: of both panels, shape (L,).
        diffuse: the light, else it is parallel and frontal.
        nodes: on a panel; both are alike.

    Returns:
        Shape (L,).
    """
    x, weight = np.polynomial.legendre.leggauss(nodes)
    x, weight = (x + 1) / 2, weight / 2
    y, weight = x**3, 3 * x**2 * weight
    squared = y[:, None] ** 2 + y**2 - 2 * y[:, None] * y * np.cos(angle)
    kernel = np.sin(angle) ** 2 / 2 * y[:, None] * y / squared**1.5 * weight
    open_sky = (1 - (np.cos(angle) - y) / np.sqrt(1 + y**2 - 2 * y * np.cos(angle))) / 2
    np.fill_diagonal(kernel, 0)
    kernel += np.diag(1 - open_sky - kernel.sum(axis=1))
    received = open_sky if diffuse else np.full(nodes, np.sin(angle / 2))
    system = np.eye(nodes) - reflectance[:, None, None] * kernel
    radiance = reflectance[:, None] * np.linalg.solve(system, received[:, None])[..., 0]
    return radiance @ weight
