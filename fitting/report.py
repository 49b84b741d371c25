"""From the minima that were found to a result: errors, intervals, flags, warnings and a status."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

import vcavity_jax as vc
from fitting import identifiability
from fitting.intervals import LinearProfile, Pieces, Profile, linear_profile
from fitting.parameters import Parameter
from fitting.polish import Polished, polish
from fitting.problem import Evaluation, Problem
from fitting.result import Estimate, FitResult, Minimum

_SIDE = 1e-6
"""Distance from a value, as a share of the range, at which one-sided slopes are taken."""

_UNEVEN = 1.5
_GOOD = "The best fit of the whole allowed range is found; every parameter is determined."
_POOR = "The best fit of the whole allowed range is found, but do not trust it:"
_MOST_KINKS = 20
"""A standard error as wide as so many kinks says little about any of them."""


@dataclass(frozen=True)
class Found:
    """Minima, best first, and all that was evaluated on the way."""

    minima: Polished
    converged: np.ndarray
    table: Evaluation


def kink_values(problem: Problem) -> Float[np.ndarray, " k"]:
    """Allowed dihedral angles at which the model is not smooth, radians; none if the angle is not free."""
    if problem.is_angle is None:
        return np.empty(0)
    angle = problem.nonlinear[problem.is_angle]
    return np.asarray(vc.kink_angles(problem.scene, angle.lower, angle.upper), dtype=np.float64)


def _information(problem: Problem, at: Polished, index: int) -> identifiability.LocalInformation:
    gain = at.linear[index, 0]
    return identifiability.local_information(problem.jacobian(at.predicted[index], gain * at.slopes[index]))


@dataclass(frozen=True)
class _Sides:
    """What the slopes on the left and on the right of a value of one parameter say.

    Args:
        errors: the parameter's standard error from either.
        uneven: the lengths of the slopes differ by more than half.
    """

    errors: tuple[float, float]
    uneven: bool


def _sides(problem: Problem, best: Float[np.ndarray, " p"], slot: int, values: Any) -> list[_Sides]:
    """Slopes beside values of one parameter, the others at the best fit."""
    parameter = problem.nonlinear[slot]
    low, high = np.asarray(problem.data.bounds, dtype=np.float64)[:, slot]
    points = np.repeat(best[None], 2 * len(values), axis=0)
    shifted = parameter.natural(values)[:, None] + np.array([-1, 1]) * _SIDE * (high - low)
    points[:, slot] = parameter.from_natural(np.clip(shifted.ravel(), low, high))
    at = polish(problem, points, frozen=True)
    weights = np.asarray(problem.data.weights, dtype=np.float64)
    sizes = np.linalg.norm((weights * at.slopes[:, slot]).reshape(len(points), -1), axis=1)
    errors = [float(_information(problem, at, k).standard_errors[slot]) for k in range(len(points))]
    return [
        _Sides((errors[k], errors[k + 1]), bool(max(sizes[k : k + 2]) > _UNEVEN * min(sizes[k : k + 2])))
        for k in range(0, len(points), 2)
    ]


def _kink_within_reach(problem: Problem, best: Float[np.ndarray, " p"], slot: int, reach: float) -> _Sides | None:
    """The kink that a fit feels most, None if it feels none.

    A kink within reach counts if the slopes on its sides differ; if the value lies on it, in any case.
    """
    if slot != problem.is_angle:
        return None
    kinks = kink_values(problem)
    low, high = np.asarray(problem.data.bounds, dtype=np.float64)[:, slot]
    far = np.abs(kinks - best[slot])
    on = far <= _SIDE * (high - low)
    near = np.flatnonzero(on | (far < reach))
    near = near[np.argsort(far[near], kind="stable")][:_MOST_KINKS]
    if not len(near):
        return None
    sides = _sides(problem, best, slot, kinks[near])
    felt = [side for place, side in zip(near, sides, strict=True) if on[place] or side.uneven]
    return felt[0] if felt else None


def report(problem: Problem, found: Found, unknown: bool) -> FitResult:
    """Turn what was found into estimates, intervals, warnings and a status.

    Args:
        problem: what was fitted.
        found: its minima and the table of the search.
        unknown: the standard uncertainty is estimated from the residuals.
    """
    minima, best = found.minima, found.minima.parameters[0]
    chi_square = float(minima.chi_square[0])
    threshold = identifiability.threshold_95(problem.degrees_of_freedom, unknown)
    information = _information(problem, minima, 0)
    errors = information.standard_errors.copy()
    profiles: list[Profile] = []
    intervals: list[Pieces] = []
    closed: list[bool] = []
    at_kink: list[bool] = []
    one_sided: list[tuple[float, float] | None] = []
    for i in range(len(problem.nonlinear)):
        (beside,) = _sides(problem, best, i, best[i : i + 1])
        if beside.uneven and i == problem.is_angle:
            errors[i] = np.fmax(*beside.errors)
        kink = _kink_within_reach(problem, best, i, 3 * errors[i])
        at_kink.append(kink is not None)
        left, right = beside.errors if kink is None else kink.errors
        one_sided.append((left, right))
        profile = Profile(problem, i, found.table)
        profile.add_minima(minima)
        for k in np.flatnonzero(minima.chi_square - chi_square < threshold):
            own = errors[i] if k == 0 else _information(problem, minima, int(k)).standard_errors[i]
            steps = (np.fmin(left, own), np.fmin(right, own)) if k == 0 else (own, own)
            profile.refine_around(float(minima.parameters[k, i]), *(float(step) for step in steps))
        pieces, inside = profile.region(chi_square, threshold)
        profiles.append(profile)
        intervals.append(pieces)
        closed.append(inside)
    along = profiles[0].points if profiles else found.table
    linear = [linear_profile(along, column, chi_square, threshold) for column in problem.linear_slots]
    return _assemble(
        problem, found, unknown, information, errors, profiles, linear, intervals, closed, at_kink, one_sided
    )


def _assemble(
    problem: Problem,
    found: Found,
    unknown: bool,
    information: identifiability.LocalInformation,
    errors: np.ndarray,
    profiles: list[Profile],
    linear: list[LinearProfile],
    intervals: list[Pieces],
    closed: list[bool],
    at_kink: list[bool],
    one_sided: list[tuple[float, float] | None],
) -> FitResult:
    minima, chi_square = found.minima, float(found.minima.chi_square[0])
    gain, offset = (float(x) for x in minima.linear[0])
    estimates: dict[str, Estimate] = {}
    for i, p in enumerate(problem.nonlinear):
        value = float(minima.parameters[0, i])
        margins = [p.natural(value) - p.natural(p.lower), p.natural(p.upper) - p.natural(value)]
        at_bound = bool(min(margins) <= 1e-6 * sum(margins))
        error = float(errors[i]) if closed[i] else np.nan
        estimates[p.name] = Estimate(
            value, error, intervals[i], p.unit, at_bound, bool(at_kink[i]) and not at_bound, one_sided[i]
        )
    for slot, p in enumerate(problem.linear, start=len(problem.nonlinear)):
        profile = linear[slot - len(problem.nonlinear)]
        value = gain if p.role == "gain" else offset
        estimates[p.name] = Estimate(value, float(errors[slot]), profile.pieces, p.unit)
    open_names = [p.name for p, inside in zip(problem.nonlinear, closed, strict=True) if not inside]
    values = problem.measurement.reflectance_factor
    predicted = gain * minima.predicted[0] + offset
    residuals = values - predicted
    rms = float(np.sqrt(np.nanmean(residuals**2)))
    names = [p.name for p in problem.parameters]
    listed = [
        Minimum(
            dict(zip(names, [*map(float, point), *map(float, extra[problem.linear_slots])], strict=True)),
            float(cost),
        )
        for point, extra, cost in zip(minima.parameters, minima.linear, minima.chi_square, strict=True)
    ]
    drawn = {name: (p.values, p.points.chi_square) for name, p in zip(names, profiles, strict=False)}
    drawn |= {p.name: (q.values, q.chi_square) for p, q in zip(problem.linear, linear, strict=True)}
    describes = identifiability.describes_data(chi_square, problem.degrees_of_freedom, unknown)
    status, message = _status(problem, estimates, open_names, information, bool(found.converged[0]))
    if describes is False:
        message = (
            f"{_POOR if status == 'converged' else message + '; besides,'} the model does not describe the data"
        )
    lost = int(np.sum(~np.isfinite(found.table.chi_square)))
    doubts = identifiability.find_warnings(
        problem, estimates, listed, information, open_names, chi_square, residuals, unknown
    )
    if lost:
        doubts += (f"the model gave no number at {lost} of {len(found.table.chi_square)} trial points",)
    return FitResult(
        scene=problem.fitted_scene(minima.parameters[0]),
        measurement=problem.measurement,
        estimates=estimates,
        covariance=information.covariance,
        correlation=information.correlation,
        chi_square=chi_square,
        degrees_of_freedom=problem.degrees_of_freedom,
        residuals=residuals,
        predicted=predicted,
        singular_values=information.singular_values,
        identifiable=not open_names and not information.singular,
        minima=listed,
        profiles=drawn,
        rms_misfit=rms,
        uncertainty_estimated=unknown,
        describes_data=describes,
        warnings=doubts,
        status=status,
        message=message,
    )


def _anything_goes(parameter: Parameter, estimates: dict[str, Estimate]) -> bool:
    """Whether the interval is the whole allowed range: then a best value on a bound is an accident."""
    return estimates[parameter.name].interval_95 == [(parameter.lower, parameter.upper)]


def _status(
    problem: Problem,
    estimates: dict[str, Estimate],
    open_names: list[str],
    information: identifiability.LocalInformation,
    converged: bool,
) -> tuple[str, str]:
    bound = [p for p in problem.nonlinear if estimates[p.name].at_bound and not _anything_goes(p, estimates)]
    if bound:
        p = bound[0]
        which = "lower" if estimates[p.name].value - p.lower < p.upper - estimates[p.name].value else "upper"
        edge = p.displayed(p.lower if which == "lower" else p.upper)
        return "at bound", (
            f"{p.name} ended on its {which} bound, {edge:g} {'degrees' if p.unit == 'rad' else ''}".rstrip()
            + ": only a one-sided limit holds; widen the range, or check material, gain and illumination"
        )
    if open_names or information.singular:
        names = ", ".join(open_names) or "the combination of the free parameters"
        return "not identifiable", (
            f"the data do not determine {names} within the allowed range: "
            f"{identifiability.more_to_measure(problem)}, fix another parameter, or give a prior"
        )
    if not converged:
        return "not converged", (
            "the polish ran out of steps: raise max_steps, narrow the ranges, or free fewer parameters"
        )
    return "converged", _GOOD
