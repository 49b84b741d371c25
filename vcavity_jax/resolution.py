"""From a tolerance to the numerical work it takes: node counts and orders, nothing a caller must know.

The rules bound the measured error of each sum from above, with a margin; tests/vcavity_jax/test_tolerance.py
holds them to it. A parameter that JAX traces is unknown when the work is planned, so the worst case is taken.
"""

import dataclasses
import math

import jax
import numpy as np

from vcavity_jax.interfaced import InterfaceResolution
from vcavity_jax.lambertian import MeanResolution
from vcavity_jax.quadrature import Clustering
from vcavity_jax.wiener_hopf import Resolution, multiple_of_four

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
    return MeanResolution(
        step=8.0 / digits,
        reach=min(math.asinh(2 * 1.2 * digits / smallest), 12.5),
        smallest_angle=smallest,
        precision=max(tolerance / 20, 3e-14),
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


INTERFACED_NARROWEST = math.radians(2.0)
"""The smallest dihedral angle of interfaced grooves that is modeled: their images multiply as it shrinks."""

NEAREST_TO_ONE = 1e-11
"""n - 1 that stands for 0 where an index is not known to be 1."""

_CONTRASTS = (0.2, 0.05, 1e-2, 1e-3, 1e-5)
_IMAGES = (1, 2, 3, 4, 6, 8, 11, 15, 21, 30, 42, 60)


def interface_resolution(
    tolerance: float, angle: float | None, index: tuple[float, float] | None, visible: float | None
) -> InterfaceResolution:
    """Sampling of an interfaced groove for an absolute error of the reflectance factor.

    Args:
        tolerance: absolute error of the reflectance factor.
        angle: the smallest dihedral angle, radians, or None if unknown.
        index: the smallest and the largest refractive index, or None if unknown.
        visible: the smallest lit or seen part of a panel, or None if unknown.
    """
    lowest = INTERFACED_NARROWEST if angle is None else max(angle, INTERFACED_NARROWEST)
    # α ≥ π / (images + 1): a coarse ladder keeps the number of compiled programs small.
    images = next(
        (k for k in _IMAGES if lowest * (k + 1) >= math.pi * (1 - 1e-9)), math.ceil(math.pi / lowest) - 1
    )
    smallest = max(math.pi / (images + 1), lowest if images > _IMAGES[-1] else 0.0)
    least, most = (1 + NEAREST_TO_ONE, HIGHEST) if index is None else index
    contrast = next((c for c in _CONTRASTS if least - 1 >= c * (1 - 1e-9)), NEAREST_TO_ONE)
    # In still narrower grooves what is neglected would be amplified too much.
    orders = images
    if smallest >= _TRUNCATED:
        orders = min(images, _reflections(smallest, most, tolerance) + 1)
    contour_tilt, path_tilt = _interface_tilts(contrast)
    narrow, demand = math.log(1 / min(smallest, math.pi / 2)), 1.5 - math.log(tolerance)
    scale = contour_tilt / _CLEAR_TILTS[0]
    reach = demand + 2 + 2.6 * narrow
    if visible is not None:
        reach = min(reach, (reach - math.log(max(visible, 1e-30))) / 2)
    contour = Resolution(
        step=scale * 4.0 / (demand + 3 + max(narrow, 0)),
        reach=float(np.ceil(reach)),
        extent=demand + 2,
        smallest_angle=smallest,
        tilt=contour_tilt,
    )
    return InterfaceResolution(
        contour=contour,
        tilt=path_tilt,
        step=scale * 3.0 / (demand + 1),
        reach=(0.4 if scale == 1 else 0.5) * demand + 2,
        order=multiple_of_four((demand + 4) * (1 + 0.22 * narrow + 0.1 * narrow**2) / 2.25),
        images=orders,
        hits=orders + 1,
    )


_CLEAR_TILTS = 0.35, 0.75


HIGHEST = 4.0
"""The largest index that the work is planned for when it is not known; it matters below 20 degrees only."""


def _reflections(angle: float, index: float, tolerance: float) -> int:
    """After how many reflections in a groove nothing is left of a ray that begins at grazing incidence.

    A narrow groove amplifies what is neglected in an exchange, hence the margin.
    """
    cosine = np.sin(np.minimum(angle * np.arange(1, math.ceil(math.pi / 2 / angle) + 1), np.pi / 2))
    root = np.sqrt(index**2 - 1 + cosine**2)
    s, p = (cosine - root) / (cosine + root), (index**2 * cosine - root) / (index**2 * cosine + root)
    left = np.cumprod((s * s + p * p) / 2)
    few = np.flatnonzero(left < tolerance * _NEGLECTED)
    return int(few[0]) + 1 if len(few) else math.ceil(math.pi / angle)


_NEGLECTED = 1e-5
_TRUNCATED = math.radians(5.5)


def _interface_tilts(contrast: float) -> tuple[float, float]:
    """Of the contour and of the path of the symbol, which must pass below the branch points of grazing incidence.

    They lie at t = ln √(1 + sin²ψ / (n² - 1)) + iπ/2 and come closer to a tilted path as n → 1.
    """
    if contrast >= _CONTRASTS[0]:
        return _CLEAR_TILTS
    branch = math.atan(math.pi / math.log1p(1 / (contrast * (2 + contrast))))
    path = 0.75 * math.tanh(0.8 * branch / 0.75)
    return 0.467 * path, path


def panel_order(tolerance: float) -> int:
    """Gauss-Legendre nodes per smooth panel of an average over groove angles."""
    return max(5, math.ceil((-math.log10(tolerance) - 0.2) / 0.76))


def slope_cutoff(tolerance: float) -> float:
    """Where to cut the average over facet slopes: exp(-U²/2) of it is left out."""
    return math.sqrt(-2 * math.log(0.1 * tolerance))


@dataclasses.dataclass(frozen=True)
class BihemisphericalResolution:
    """Sampling of ``bihemispherical.specular``.

    Args:
        across: nodes per panel in the cross-section.
        along: nodes over the tilt along the fold.
        critical: nodes per panel where total external reflection begins abruptly (n < 1, k small); 0 if it is
            known not to occur.
    """

    across: int
    along: int
    critical: int


def clustering(tolerance: float, visible: float | None) -> Clustering:
    """Nodes of a ring or a disk of light for an absolute error.

    Args:
        tolerance: absolute error of the reflectance factor.
        visible: the smallest lit or seen part of a panel, or None if unknown; near 0 all happens in a thin layer
            of azimuths.
    """
    demand = -math.log(tolerance)
    further = max(demand - 6.9, 0)
    finer = 0.29 * further if visible is not None else 0.3 + 0.2 * further + 0.024 * further**2
    return Clustering(step=1 / (2.5 + finer), reach=math.asinh((demand + 5.5) / math.pi))


def average_clustering(tolerance: float) -> Clustering:
    """Nodes between two onsets of shadow of an average over groove angles, for an absolute error."""
    demand = -math.log(tolerance)
    step = 1 / (4.4 + 0.35 * max(demand - 6.9, 0))
    return Clustering(step, reach=math.asinh((demand + 5.5) / math.pi))


def bihemispherical_orders(tolerance: float, angle: float | None, tame: bool) -> BihemisphericalResolution:
    """Sampling of the bi-hemispherical reflectance of specular grooves for an absolute error.

    Where total external reflection begins almost abruptly (n < 1, 0 < k < 0.01), the error can be several times
    1e-6 where 1e-6 is asked for, and stays above 1e-8.

    Args:
        tolerance: absolute error of the reflectance.
        angle: the dihedral angle, radians, or None if unknown.
        tame: every index is known to be free of abrupt total external reflection, as ``bihemispherical.is_tame``.
    """
    digits = -math.log10(tolerance)
    degrees = 180.0 if angle is None else math.degrees(angle)
    if degrees > 170:
        across = 3 + 0.5 * digits + 0.3 * digits**2
    else:
        across = 3 + 0.225 * digits**2 if degrees > 60 else 2.5 + 0.195 * digits**2
    along = 3 + 0.35 * digits + 0.2 * digits**2
    if angle is None or degrees < 25:
        along += 3 + 0.08 * digits**2
    critical = 0 if tame else min(math.ceil(4 + 0.36 * digits**2), 40)
    return BihemisphericalResolution(math.ceil(across), math.ceil(along), critical)


@dataclasses.dataclass(frozen=True)
class AngleTableResolution:
    """Sampling of ``angle_table``: the bi-hemispherical reflectance as a function of the groove angle.

    Args:
        digits: of the interpolation in the angle.
        steepest: largest facet slope tan θ_h that the table covers.
        cutoff: largest facet slope in units of the roughness that an average covers.
        wide: sampling of the reflectance at 60 degrees and above.
        narrow: the same below.
    """

    digits: float
    steepest: float
    cutoff: float
    wide: BihemisphericalResolution
    narrow: BihemisphericalResolution

    @property
    def gradings(self) -> int:
        """Into how many shorter blocks the upper end is divided; for the hardest mirrors and fine tolerances."""
        return 1 if self.digits < 6.5 else 2 if self.digits < 9.5 else 3

    def nodes(self, most: int) -> tuple[int, int]:
        """Chebyshev nodes for angles between π/most and π/(most - 1), near the lower and the upper end.

        Hard mirrors change fastest at the upper end, where another reflection sets in at grazing incidence.
        """
        fewer = 2 * int(math.log2(most / 8)) + 2 if most > 8 else 0
        near = 4 * self.digits - 8 if most == 2 else 3 * self.digits - 6
        near /= 1 if self.gradings == 1 else 1.3
        return max(4, math.ceil(2.3 * self.digits - 2) - fewer), max(4, math.ceil(near) - fewer)


def angle_table_resolution(tolerance: float, roughest: float, tame: bool) -> AngleTableResolution:
    """Sampling of the bi-hemispherical reflectance of randomly grooved mirrors for an absolute error.

    Args:
        tolerance: absolute error of the reflectance.
        roughest: the largest roughness m.
        tame: as ``bihemispherical_orders``.
    """
    cutoff = slope_cutoff(tolerance)
    return AngleTableResolution(
        digits=-math.log10(tolerance),
        # A coarse ladder keeps the number of compiled programs small.
        steepest=2 ** math.ceil(math.log2(roughest)) * cutoff,
        cutoff=cutoff,
        wide=bihemispherical_orders(tolerance, None, tame),
        narrow=bihemispherical_orders(tolerance, math.radians(20), tame),
    )
