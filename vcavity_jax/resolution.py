"""From a tolerance to the numerical work it takes: node counts and orders, nothing a caller must know.

The rules bound the measured error of each sum from above, with a margin; tests/vcavity_jax/test_tolerance.py
holds them to it. A parameter that JAX traces is unknown when the work is planned, so the worst case is taken.
"""

import math

import jax
import numpy as np

from vcavity_jax.lambertian import MeanResolution
from vcavity_jax.wiener_hopf import Resolution

NARROWEST = math.radians(0.1)
"""The smallest dihedral angle that the work is planned for when it is not known."""

_PLANNED = tuple(math.radians(degrees) for degrees in (0.1, 1.0, 4.5, 14.0, 40.0))
_FINEST = 1e-18
_ROUNDING = 1e-13


def planned_angle(angle: float | None) -> float:
    """A lower bound on the angle, of a small set of values so that few programs are compiled; radians."""
    if angle is None:
        return NARROWEST
    return max((step for step in _PLANNED if step <= angle), default=NARROWEST)


def check_tolerance(tolerance: float) -> float:
    """The tolerance that can be kept: not below the rounding of the numbers in use.

    Raises:
        ValueError: it is not a positive number below 1, or is traced.
    """
    if isinstance(tolerance, jax.core.Tracer) or not 0 < tolerance < 1:
        raise ValueError(
            f"{tolerance} is not a tolerance: expected a plain number between 0 and 1, such as 1e-8"
        )
    single = not jax.config.read("jax_enable_x64")
    return max(float(tolerance), 1e-6 if single else _ROUNDING)


def mean_resolution(tolerance: float, angle: float | None) -> MeanResolution:
    """Sampling of ``lambertian.mean_response`` for an absolute error of the mean radiance.

    Args:
        tolerance: absolute error of the reflectance factor.
        angle: the smallest dihedral angle, radians, or None if unknown.
    """
    smallest = planned_angle(angle)
    digits = -math.log(max(0.1 * tolerance * min(1.0, smallest) ** 2.3, _FINEST))
    return MeanResolution(
        step=8.0 / digits,
        reach=min(math.asinh(2 * 1.2 * digits / smallest), 12.5),
        symbol_step=4.4 / digits,
        symbol_reach=0.62 * digits,
    )


def step_resolution(tolerance: float, angle: float | None, visible: float | None) -> Resolution:
    """Sampling of the Wiener-Hopf contour for an absolute error of the reflectance factor.

    Args:
        tolerance: absolute error of the reflectance factor.
        angle: the smallest dihedral angle, radians, or None if unknown.
        visible: the smallest lit or seen part of a panel, or None if unknown; near 0 the rim layer matters.
    """
    smallest = planned_angle(angle)
    scale = 0.1 * tolerance
    difficulty = 0.7 * (math.pi / 4 / smallest) ** 2
    digits = -math.log(scale / difficulty)
    narrow = math.log1p(0.1 / smallest)
    reach = -math.log(scale) + 2 * narrow
    if visible is not None:
        reach = min(reach, (-math.log(scale) - math.log(max(visible, 1e-30))) / 2 + 1 + 2 * narrow)
    return Resolution(
        step=3.0 / digits,
        reach=float(np.ceil(reach)),
        extent=-math.log(scale) + 4,
        smallest_angle=smallest,
    )


def panel_order(tolerance: float) -> int:
    """Gauss-Legendre nodes per smooth panel of an average over specular groove angles."""
    return max(3, math.ceil((-math.log10(tolerance) - 0.2) / 0.76))


def slope_cutoff(tolerance: float) -> float:
    """Where to cut the average over facet slopes: exp(-U²/2) of it is left out."""
    return math.sqrt(-2 * math.log(0.1 * tolerance))
