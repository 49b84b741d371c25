"""What is known of a parameter before it is measured: four kinds of priors, each with a stated density.

Chi-square gets the square of a prior's residual; a bound that a prior brings narrows the allowed range.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

Number = float | int


@dataclass(frozen=True)
class Normal:
    """Gaussian: ((value - mean) / standard deviation)² is added to chi-square.

    Args:
        mean: in the parameter's unit.
        standard_deviation: in the parameter's unit, > 0.

    Raises:
        ValueError: a number is not finite or the standard deviation is not positive.
    """

    mean: Number
    standard_deviation: Number

    def __post_init__(self) -> None:
        _check(self, math.isfinite(self.mean), "a finite mean")
        _check(self, 0 < self.standard_deviation < math.inf, "a positive standard deviation")

    @property
    def limits(self) -> tuple[float, float]:
        """What the prior allows."""
        return -math.inf, math.inf

    @property
    def gaussian(self) -> tuple[float, float, bool] | None:
        """Center, width, and whether both are of the logarithm; None if the prior only has limits."""
        return float(self.mean), float(self.standard_deviation), False

    def scaled(self, factor: float) -> Any:
        """The prior in a unit that is 1/factor times as large."""
        return replace(self, mean=self.mean * factor, standard_deviation=self.standard_deviation * factor)


@dataclass(frozen=True)
class TruncatedNormal:
    """Gaussian within limits, nothing beyond them.

    Args:
        mean: in the parameter's unit; it may lie outside the limits.
        standard_deviation: in the parameter's unit, > 0.
        lower: smallest allowed value.
        upper: largest allowed value.

    Raises:
        ValueError: as for ``Normal``, or the limits are not in order.
    """

    mean: Number
    standard_deviation: Number
    lower: Number = -math.inf
    upper: Number = math.inf

    def __post_init__(self) -> None:
        _check(self, math.isfinite(self.mean), "a finite mean")
        _check(self, 0 < self.standard_deviation < math.inf, "a positive standard deviation")
        _check(self, self.lower < self.upper, "lower < upper")

    @property
    def limits(self) -> tuple[float, float]:
        """What the prior allows."""
        return float(self.lower), float(self.upper)

    @property
    def gaussian(self) -> tuple[float, float, bool] | None:
        """Center, width, and whether both are of the logarithm."""
        return float(self.mean), float(self.standard_deviation), False

    def scaled(self, factor: float) -> Any:
        """The prior in a unit that is 1/factor times as large."""
        return replace(
            self,
            mean=self.mean * factor,
            standard_deviation=self.standard_deviation * factor,
            lower=self.lower * factor,
            upper=self.upper * factor,
        )


@dataclass(frozen=True)
class LogNormal:
    """The logarithm is Gaussian: (ln(value / median) / spread)² is added to chi-square.

    This is minus twice the logarithm of the density of ln(value), up to a constant.

    Args:
        median: in the parameter's unit, > 0.
        spread: standard deviation of the natural logarithm, > 0: 0.1 is about 10 %.

    Raises:
        ValueError: a number is not positive.
    """

    median: Number
    spread: Number

    def __post_init__(self) -> None:
        _check(self, 0 < self.median < math.inf, "a positive median")
        _check(self, 0 < self.spread < math.inf, "a positive spread")

    @property
    def limits(self) -> tuple[float, float]:
        """What the prior allows."""
        return 0.0, math.inf

    @property
    def gaussian(self) -> tuple[float, float, bool] | None:
        """Center, width, and whether both are of the logarithm."""
        return math.log(self.median), float(self.spread), True

    def scaled(self, factor: float) -> Any:
        """The prior in a unit that is 1/factor times as large."""
        return replace(self, median=self.median * factor)


@dataclass(frozen=True)
class Uniform:
    """All values between two limits alike, nothing beyond them.

    Args:
        lower: smallest allowed value.
        upper: largest allowed value.

    Raises:
        ValueError: the limits are not in order.
    """

    lower: Number
    upper: Number

    def __post_init__(self) -> None:
        _check(self, self.lower < self.upper, "lower < upper")

    @property
    def limits(self) -> tuple[float, float]:
        """What the prior allows."""
        return float(self.lower), float(self.upper)

    @property
    def gaussian(self) -> tuple[float, float, bool] | None:
        """Nothing: all allowed values are alike."""
        return None

    def scaled(self, factor: float) -> Any:
        """The prior in a unit that is 1/factor times as large."""
        return replace(self, lower=self.lower * factor, upper=self.upper * factor)


Prior = Normal | TruncatedNormal | LogNormal | Uniform


def as_prior(given: Any, name: str) -> Prior | None:
    """A prior from what a user may write: one of the four, or (mean, standard deviation) for a normal one.

    Raises:
        ValueError: it is neither.
    """
    if given is None or isinstance(given, Prior):
        return given
    numbers = isinstance(given, tuple) and len(given) == 2 and all(isinstance(g, float | int) for g in given)
    if not (numbers and math.isfinite(given[0]) and 0 < given[1] < math.inf):
        raise ValueError(
            f"parameter {name!r}: prior {given!r}; expected (mean, standard deviation) with a positive "
            "standard deviation, a prior of fitting.priors, or None"
        )
    return Normal(*given)


def _check(prior: Any, good: bool, expected: str) -> None:
    if not good:
        raise ValueError(f"{prior!r} is not a prior: expected {expected}")
