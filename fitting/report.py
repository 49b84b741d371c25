"""From the minima that were found to a result: errors, intervals, flags, warnings and a status."""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from fitting import identifiability
from fitting.arrow import STATUS_WORDS
from fitting.blind_spots import more_to_measure
from fitting.information import LocalInformation, local_information
from fitting.intervals import Envelope, Pieces, Profile, envelope, spectral_interval
from fitting.parameters import Parameter
from fitting.problem import INNER_STEPS, Descent, Evaluation, Problem
from fitting.result import Estimate, FitResult, Minimum, SpectralEstimate, Start

_SIDE = 1e-6
"""Distance from a value, as a share of the range, at which one-sided slopes are taken."""

_UNEVEN = 1.5
_GOOD = "The best fit of the whole allowed range is found; every parameter is determined."
_POOR = "The best fit of the whole allowed range is found, but do not trust it:"
_ELSEWHERE = 0.05
"""Values of n or k that differ by this much belong to different branches."""

_MOST_KINKS = 20
"""A standard error as wide as so many kinks says little about any of them."""


@dataclass(frozen=True)
class Found:
    """Minima, best first, all that was evaluated on the way, and every descent from a start."""

    minima: Descent
    table: Evaluation
    descents: Descent


@dataclass(frozen=True)
class _Sides:
    """What the slopes on the left and on the right of a value of one number say.

    Args:
        errors: the number's standard error from either.
        uneven: the lengths of the slopes differ by more than half.
    """

    errors: tuple[float, float]
    uneven: bool


@dataclass
class _Searched:
    """What is known of a searched number."""

    error: float
    interval: Pieces
    closed: bool
    at_kink: bool
    one_sided: tuple[float, float]
    profile: Profile


def _still(problem: Problem, values: np.ndarray, spectra: np.ndarray) -> Descent:
    """The model and its derivatives at some points."""
    return problem.descend(values, spectra, np.zeros(values.shape, bool), np.zeros(spectra.shape, bool), outer=0)


def _sides(problem: Problem, best: Descent, slot: int, values: Any) -> list[_Sides]:
    """Slopes beside values of one number, the others at the best fit."""
    parameter = problem.numbers[slot]
    low, high = np.asarray(problem.data.bounds, dtype=np.float64)[:, slot]
    points = np.repeat(best.values[:1], 2 * len(values), axis=0)
    shifted = parameter.natural(values)[:, None] + np.array([-1, 1]) * _SIDE * (high - low)
    points[:, slot] = parameter.from_natural(np.clip(shifted.ravel(), low, high))
    normal = problem.normal(_still(problem, points, np.repeat(best.spectra[:1], len(points), axis=0)))
    sizes = np.sqrt(np.clip(normal.reduced[:, slot, slot], 0, None))
    errors = [float(local_information(normal, k).standard_errors[slot]) for k in range(len(points))]
    return [
        _Sides((errors[k], errors[k + 1]), bool(max(sizes[k : k + 2]) > _UNEVEN * min(sizes[k : k + 2])))
        for k in range(0, len(points), 2)
    ]


def _kink_within_reach(problem: Problem, best: Descent, slot: int, reach: float) -> _Sides | None:
    """The kink that a fit feels most, None if it feels none.

    A kink within reach counts if the slopes on its sides differ; if the value lies on it, in any case.
    """
    kinks = problem.kinks(slot)
    low, high = np.asarray(problem.data.bounds, dtype=np.float64)[:, slot]
    far = np.abs(kinks - best.values[0, slot])
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
    minima = found.minima
    chi_square = float(minima.chi_square[0])
    threshold = identifiability.threshold_95(problem.degrees_of_freedom, unknown)
    normal = problem.normal(minima)
    information = local_information(normal)
    searched: list[_Searched] = []
    for i in range(len(problem.searched)):
        error = float(information.standard_errors[i])
        (beside,) = _sides(problem, minima, i, minima.values[:1, i])
        if beside.uneven and i in problem.angles:
            error = float(np.fmax(*beside.errors))
        kink = _kink_within_reach(problem, minima, i, 3 * error)
        left, right = beside.errors if kink is None else kink.errors
        profile = Profile(problem, i, found.table, minima)
        profile.settle(chi_square)
        for k in np.flatnonzero(minima.chi_square - chi_square < threshold):
            own = error if k == 0 else float(local_information(normal, int(k)).standard_errors[i])
            steps = (np.fmin(left, own), np.fmin(right, own)) if k == 0 else (own, own)
            profile.refine_around(float(minima.values[k, i]), *(float(step) for step in steps))
        pieces, inside = profile.region(chi_square, threshold)
        searched.append(_Searched(error, pieces, inside, kink is not None, (left, right), profile))
    along = searched[0].profile.points if searched else found.table
    hidden = problem.layout.hidden
    others = {
        i: _beside(problem, minima, i, along, information, threshold)
        for i, p in enumerate(problem.numbers)
        if not p.searched and i not in hidden
    }
    return _assemble(problem, found, unknown, information, searched, others, along, threshold)


def _beside(
    problem: Problem,
    minima: Descent,
    slot: int,
    along: Evaluation,
    information: LocalInformation,
    threshold: float,
) -> Envelope:
    """Profile of a number that is not searched: from what is known, if nothing bends it."""
    parameter, best = problem.numbers[slot], minima.values[0]
    bounds = float(parameter.lower), float(parameter.upper)
    quick = envelope(along, slot, float(minima.chi_square[0]), threshold, bounds)
    error = float(information.standard_errors[slot])
    reached = quick.pieces[0][0] <= bounds[0] or quick.pieces[-1][1] >= bounds[1]
    # A neighbor that is held by its bound may come off it.
    held = any(best[i] in (p.lower, p.upper) for i, p in enumerate(problem.numbers) if not p.searched)
    if not (reached or held or parameter.prior_of_logarithm) or not np.isfinite(error):
        return quick
    profile = Profile(problem, slot, along, minima)
    profile.reach_out(float(best[slot]), error, float(minima.chi_square[0]), threshold)
    pieces, _ = profile.region(float(minima.chi_square[0]), threshold)
    return Envelope(pieces, profile.values, profile.points.chi_square)


def _assemble(
    problem: Problem,
    found: Found,
    unknown: bool,
    information: LocalInformation,
    searched: list[_Searched],
    others: dict[int, Envelope],
    along: Evaluation,
    threshold: float,
) -> FitResult:
    minima, chi_square = found.minima, float(found.minima.chi_square[0])
    hidden = problem.layout.hidden
    estimates: dict[str, Estimate | SpectralEstimate] = {}
    open_names = []
    for i, p in enumerate(problem.numbers):
        value, error = float(minima.values[0, i]), float(information.standard_errors[i])
        margins = [p.natural(value) - p.natural(p.lower), p.natural(p.upper) - p.natural(value)]
        at_bound = bool(np.isfinite(sum(margins)) and min(margins) <= 1e-6 * sum(margins))
        if i < len(searched):
            own = searched[i]
            kink = own.at_kink and not at_bound
            error = own.error if own.closed else np.nan
            estimates[p.name] = Estimate(value, error, own.interval, p.unit, at_bound, kink, own.one_sided)
            open_names += [] if own.closed else [p.name]
        elif i not in hidden:
            if p.prior is None and error > p.upper - p.lower:
                error = np.nan
                open_names.append(p.name)
            estimates[p.name] = Estimate(value, error, others[i].pieces, p.unit, at_bound)
    estimates |= _spectral_estimates(problem, minima, information, along, threshold)
    names = [p.name for p in problem.numbers]
    listed = [_minimum(problem, minima, k, hidden) for k in range(len(minima.chi_square))]
    drawn = {names[i]: (s.profile.values, s.profile.points.chi_square) for i, s in enumerate(searched)}
    drawn |= {names[i]: (e.values, e.chi_square) for i, e in others.items()}
    describes = identifiability.describes_data(chi_square, problem.degrees_of_freedom, unknown)
    status, message = _status(problem, estimates, open_names, information, bool(minima.converged[0]))
    if describes is False:
        message = (
            f"{_POOR if status == 'converged' else message + '; besides,'} the model does not describe the data"
        )
    predicted = _predicted(problem, minima, information)
    residuals = tuple(m.reflectance_factor - p for m, p in zip(problem.measurements, predicted, strict=True))
    squares = np.concatenate([r[~np.isnan(r)] ** 2 for r in residuals])
    lost = int(np.sum(~np.isfinite(found.table.chi_square)))
    doubts = identifiability.find_warnings(
        problem,
        estimates,
        listed,
        information,
        open_names,
        chi_square,
        residuals,
        unknown,
        _branches(problem, minima),
    )
    if lost:
        doubts += (f"the model gave no number at {lost} of {len(found.table.chi_square)} trial points",)
    return FitResult(
        scenes=problem.fitted_scenes(minima.values[0], minima.spectra[0]),
        measurements=problem.measurements,
        labels=problem.labels,
        estimates=estimates,
        numbers=tuple(names),
        covariance=information.covariance,
        correlation=information.correlation,
        chi_square=chi_square,
        degrees_of_freedom=problem.degrees_of_freedom,
        misfits=residuals,
        predictions=predicted,
        singular_values=information.singular_values,
        identifiable=not open_names and not information.singular,
        minima=listed,
        starts=_starts(problem, found.descents, hidden),
        profiles=drawn,
        rms_misfit=float(np.sqrt(np.mean(squares))),
        uncertainty_estimated=unknown,
        describes_data=describes,
        warnings=doubts,
        status=status,
        message=message,
        problem=problem,
        found=found,
    )


def _branches(problem: Problem, minima: Descent) -> int:
    """At how many wavelengths another start of the free spectra ends elsewhere and fits as well."""
    starts = problem.starts
    if len(starts) < 2:
        return 0
    values = np.repeat(minima.values[:1], len(starts), axis=0)
    held = np.zeros(values.shape, dtype=bool)
    ends = problem.descend(values, starts, held, inner=4 * INNER_STEPS, outer=0)
    costs, best = ends.matrix[:, :, -1, -1], minima.matrix[0, :, -1, -1]
    far = np.max(np.abs(ends.spectra - minima.spectra[0]), axis=1) > _ELSEWHERE
    return int(np.sum((far & (costs - best < 9.0)).any(axis=0)))


def _predicted(problem: Problem, minima: Descent, information: LocalInformation) -> tuple[np.ndarray, ...]:
    """Recorded values at the best fit; none where a free spectrum is not determined, or beyond a shift's reach."""
    found = []
    for part, whole in zip(problem.layout.parts, minima.predicted, strict=True):
        known = part.reached(problem.numbers)
        if any(slot.source is None for slot in part.spectral):
            known = known & information.determined[part.places]
        found.append(np.where(known, whole[0], np.nan))
    return tuple(found)


def _named(problem: Problem, values: np.ndarray, hidden: frozenset[int]) -> dict[str, float]:
    return {p.name: float(values[i]) for i, p in enumerate(problem.numbers) if i not in hidden}


def _minimum(problem: Problem, minima: Descent, index: int, hidden: frozenset[int]) -> Minimum:
    spectra = dict(zip(problem.free_names, minima.spectra[index], strict=True))
    values = _named(problem, minima.values[index], hidden)
    return Minimum(values, float(minima.chi_square[index]), spectra)


def _starts(problem: Problem, descents: Descent, hidden: frozenset[int]) -> tuple[Start, ...]:
    return tuple(
        Start(
            _named(problem, descents.values[k], hidden),
            float(descents.chi_square[k]),
            STATUS_WORDS[int(descents.status[k])],
            int(descents.steps[k]),
            int(descents.rejected[k]),
        )
        for k in range(len(descents.chi_square))
    )


def _spectral_estimates(
    problem: Problem, minima: Descent, information: LocalInformation, along: Evaluation, threshold: float
) -> dict[str, SpectralEstimate]:
    """The free spectra, and those of a form with the errors of its coefficients."""
    found: dict[str, SpectralEstimate] = {}
    layout, data = problem.layout, problem.data
    if layout.free_spectra:
        bounds = np.asarray(data.spectral_bounds, np.float64)
        chi_square = float(minima.chi_square[0])
        low, high = spectral_interval(along, chi_square, threshold, bounds)
        for row, name in enumerate(problem.free_names):
            values = minima.spectra[0, row]
            at_bound = (values <= bounds[0, row]) | (values >= bounds[1, row])
            missing = ~information.determined
            found[name] = SpectralEstimate(
                layout.wavelengths_nm,
                np.where(missing, np.nan, values),
                information.spectral_errors[row],
                [(np.where(missing, bounds[0, row], low[row]), np.where(missing, bounds[1, row], high[row]))],
                at_bound & ~missing,
            )
    span = float(layout.wavelengths_nm[0]), float(layout.wavelengths_nm[-1])
    for use, names in problem.formed:
        numbers = list(use.numbers)

        def spectrum(values: Any, form: Any = use.form) -> Any:
            return form.spectrum(layout.wavelengths_nm, span, values)

        best = jnp.asarray(minima.values[0, numbers], data.center.dtype)
        whole, slopes = np.asarray(spectrum(best)), np.asarray(jax.jacfwd(spectrum)(best))
        covariance = information.covariance[np.ix_(numbers, numbers)]
        errors = np.sqrt(np.einsum("qwi,ij,qwj->qw", slopes, covariance, slopes))
        for row, name in enumerate(names):
            low, high = (whole[row] + sign * np.sqrt(threshold) * errors[row] for sign in (-1, 1))
            found[name] = SpectralEstimate(
                layout.wavelengths_nm, whole[row], errors[row], [(low, high)], np.zeros(len(low), bool)
            )
    return found


def _anything_goes(parameter: Parameter, estimate: Estimate) -> bool:
    """Whether the interval is the whole allowed range: then a best value on a bound is an accident."""
    return estimate.interval_95 == [(parameter.lower, parameter.upper)]


def _status(
    problem: Problem,
    estimates: dict[str, Estimate | SpectralEstimate],
    open_names: list[str],
    information: LocalInformation,
    converged: bool,
) -> tuple[str, str]:
    for p in problem.numbers:
        estimate = estimates.get(p.name)
        # No stray light at all is an answer, not a limit of the search.
        if not isinstance(estimate, Estimate) or not estimate.at_bound or p.role == "stray_light":
            continue
        if _anything_goes(p, estimate):
            continue
        which = "lower" if estimate.value - p.lower < p.upper - estimate.value else "upper"
        edge = p.displayed(p.lower if which == "lower" else p.upper)
        return "at bound", (
            f"{p.name} ended on its {which} bound, {edge:g} {'degrees' if p.unit == 'rad' else ''}".rstrip()
            + ": only a one-sided limit holds; widen the range, or check material, gain and illumination"
        )
    if open_names or information.singular:
        names = ", ".join(open_names) or "the combination of the free parameters"
        return "not identifiable", (
            f"the data do not determine {names} within the allowed range: "
            f"{more_to_measure(problem)}, fix another parameter, or give a prior"
        )
    if not converged:
        return "not converged", (
            "the polish ran out of steps: raise max_steps, narrow the ranges, or free fewer parameters"
        )
    return "converged", _GOOD
