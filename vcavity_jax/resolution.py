"""From a tolerance to the numerical work it takes: node counts and orders, nothing a caller must know.

The rules bound the measured error of each sum from above, with a margin; tests/vcavity_jax/test_tolerance.py
holds them to it. A parameter that JAX traces is unknown when the work is planned, so the worst case is taken.
"""

import math

import jax
import numpy as np

from vcavity_jax.lambertian import OSCILLATING, SHIFT, MeanResolution
from vcavity_jax.wiener_hopf import Resolution

NARROWEST = math.radians(0.1)
"""The smallest dihedral angle that the work is planned for when it is not known."""

_PLANNED = tuple(math.radians(degrees) for degrees in (0.1, 1.0, 4.5, 14.0, 40.0))
_ROUNDING = 1e-13


def planned_angle(angle: float | None) -> float:
    """A lower bound on the angle, of a small set of values so that few programs are compiled; radians."""
    if angle is None:
        return NARROWEST
    return max((step for step in _PLANNED if step <= angle), default=NARROWEST)


def check_tolerance(tolerance: float) -> float:
    """The tolerance to plan for: no finer than the rounding of the numbers in use.

    Raises:
        ValueError: it is not a plain number between 0 and 1.
    """
    if isinstance(tolerance, jax.core.Tracer) or not 0 < tolerance < 1:
        raise ValueError(f"{tolerance} is not a tolerance: expected a plain number between 0 and 1, such as 1e-8")
    return max(float(tolerance), _ROUNDING if jax.config.read("jax_enable_x64") else 1e-6)


def mean_resolution(tolerance: float, angle: float | None) -> MeanResolution:
    """Sampling of ``lambertian.mean_response`` for an absolute error of the mean radiance.

    Args:
        tolerance: absolute error of the reflectance factor.
        angle: the smallest dihedral angle, radians, or None if unknown.
    """
    smallest = planned_angle(angle)
    narrow, demand = math.log(_PLANNED[-1] / smallest), -math.log(tolerance)
    digits = 12.5 + 1.1 * narrow + (0.68 + 0.045 * narrow) * max(demand - 6.9, 0)
    step, reach = 4.4 / digits, 0.62 * digits
    # Along the shifted path the symbol decays the more slowly, the narrower the groove.
    w = np.arange(0, reach, step)
    t = 2 * np.arcsinh(math.sin(smallest / 2) * np.sinh(w + 1j * SHIFT))
    left = 2 * np.logaddexp(w, -w) - 2 * math.log(2) + OSCILLATING * t.imag
    return MeanResolution(
        step=8.0 / digits,
        reach=min(math.asinh(2 * 1.2 * digits / smallest), 12.5),
        symbol_step=step,
        symbol_reach=reach,
        shifted_reach=float(w[left < digits][-1]) if np.any(left < digits) else step,
    )


def step_resolution(tolerance: float, angle: float | None, visible: float | None) -> Resolution:
    """Sampling of the Wiener-Hopf contour for an absolute error of the reflectance factor.

    Args:
        tolerance: absolute error of the reflectance factor.
        angle: the smallest dihedral angle, radians, or None if unknown.
        visible: the smallest lit or seen part of a panel, or None if unknown; near 0 the rim layer matters.
    """
    smallest = planned_angle(angle)
    narrow, demand = math.log(_PLANNED[-1] / smallest), -math.log(tolerance)
    reach = demand + 3 + 2 * math.log1p(0.1 / smallest)
    if visible is not None:
        reach = min(reach, (reach - math.log(max(visible, 1e-30))) / 2)
    return Resolution(
        step=(3.6 + 0.6 * math.exp(-1.5 * narrow)) / (demand + 7.6 + 0.6 * narrow + 0.17 * narrow**2),
        reach=float(np.ceil(reach)),
        extent=demand + 5,
        smallest_angle=smallest,
    )


def panel_order(tolerance: float) -> int:
    """Gauss-Legendre nodes per smooth panel of an average over groove angles."""
    return max(5, math.ceil((-math.log10(tolerance) - 0.2) / 0.76))


def slope_cutoff(tolerance: float) -> float:
    """Where to cut the average over facet slopes: exp(-U²/2) of it is left out."""
    return math.sqrt(-2 * math.log(0.1 * tolerance))
