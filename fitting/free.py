"""The parameters a fit may vary, ready made: ``fit(scene, measurement, [free.angle(), free.gain()])``."""

import math
from collections.abc import Callable
from typing import Any

from fitting.parameters import Number, Parameter, Prior


def angle(lower_deg: Number = 5.0, upper_deg: Number = 180.0, prior: Prior | None = None) -> Parameter:
    """The dihedral angle of ``VGrooves``.

    Args:
        lower_deg: smallest allowed angle, degrees, > 0. Below 5 degrees the search becomes slow.
        upper_deg: largest allowed angle, degrees, at most 180 (flat).
        prior: mean and standard deviation, degrees; None for none.

    Raises:
        ValueError: the bounds are not in order or outside 0 to 180 degrees.
    """
    if not 0 < lower_deg < upper_deg <= 180:
        raise ValueError(
            f"dihedral angles from {lower_deg:g} to {upper_deg:g} degrees; expected 0 < lower < upper ≤ 180"
        )
    radians = None if prior is None else (math.radians(prior[0]), math.radians(prior[1]))
    return Parameter("angle", _angle, math.radians(lower_deg), math.radians(upper_deg), prior=radians, unit="rad")


def roughness(lower: Number = 0.01, upper: Number = 3.0, prior: Prior | None = None) -> Parameter:
    """The roughness m of ``BeckmannGrooves`` or ``GaussianGrooves``, on a logarithmic scale.

    Args:
        lower: smallest allowed m, without unit, > 0.
        upper: largest allowed m.
        prior: mean and standard deviation of m; None for none.

    Raises:
        ValueError: the bounds are not in order or not positive.
    """
    return Parameter("roughness", _roughness, lower, upper, prior=prior, scale="log")


def gain(prior: Prior | None = (1.0, 0.01)) -> Parameter:
    """The gain of the instrument: predicted = gain × model + offset.

    Args:
        prior: mean and standard deviation; 1 ± 0.01 unless said otherwise, None for an unknown gain.

    Raises:
        ValueError: the prior's standard deviation is not positive.
    """
    return Parameter("gain", None, -math.inf, math.inf, prior=prior, role="gain")


def offset(prior: Prior | None = (0.0, 0.002)) -> Parameter:
    """The offset of the instrument, as a reflectance factor: predicted = gain × model + offset.

    Args:
        prior: mean and standard deviation; 0 ± 0.002 unless said otherwise, None for an unknown offset.

    Raises:
        ValueError: the prior's standard deviation is not positive.
    """
    return Parameter("offset", None, -math.inf, math.inf, prior=prior, role="offset")


def parameter(
    name: str,
    where: Callable[[Any], Any],
    lower: Number,
    upper: Number,
    prior: Prior | None = None,
) -> Parameter:
    """Any other single real number in the scene.

    Args:
        name: under which the result lists it.
        where: picks the number, as in ``lambda scene: scene.material.reflectance``.
        lower: smallest allowed value, in the scene's own unit (radians for angles).
        upper: largest allowed value.
        prior: mean and standard deviation of a Gaussian prior; None for none.

    Raises:
        ValueError: the bounds are not in order or not finite.
    """
    return Parameter(name, where, lower, upper, prior=prior)


def _angle(scene: Any) -> Any:
    return scene.surface.angle


def _roughness(scene: Any) -> Any:
    return scene.surface.roughness
