"""The fit: search everywhere, polish the best valleys, profile each parameter."""

import warnings
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from fitting import search
from fitting.measurement import Measurement
from fitting.parameters import Parameter
from fitting.polish import Polished, lane_count, polish, prepare
from fitting.problem import Evaluation, Problem, build
from fitting.programs import CHUNK
from fitting.report import Found, kink_values, report
from fitting.result import FitResult

_NEAR = 9.0

_warned_of_float32 = False


def fit(
    scene: Any,
    measurement: Measurement,
    parameters: Sequence[Parameter],
    *,
    standard_uncertainty: float | int | None = None,
    tolerance: float = 1e-8,
    max_steps: int = 60,
) -> FitResult:
    """Fit free parameters of a scene to a measurement.

    Chi-square, Σ ((measured - gain × model - offset) / σ)² plus the priors, is searched over the whole
    allowed range (every 0.2 degrees and at every kink for one angle; a product of coarser axes for two or
    three parameters). Its best distinct minima are polished by Levenberg-Marquardt, and each parameter is
    profiled. Gain and offset are solved for exactly.
    The values of the scene's free parameters do not matter: there is no start to choose.

    Args:
        scene: what the sample is; its view is replaced by the measurement's.
        measurement: what is fitted; NaN is left out.
        parameters: from ``fitting.free``: at most three of the scene, gain and offset at will.
        standard_uncertainty: one standard deviation for all values, as a fraction. It replaces the
            measurement's own. If neither is given it is estimated such that chi-square equals the degrees of
            freedom, intervals follow Student's t, and the fit cannot be tested. The measurement in the result
            holds the one that was used.
        tolerance: bound on the model's numerical error.
        max_steps: most steps of a polish.

    Returns:
        The best fit, its uncertainty and every reason to doubt it. A fit without a trustworthy answer says so
        in ``status`` and ``message``; it does not raise.

    Raises:
        ValueError: the inputs do not fit together; the message says what is expected.
    """
    _warn_of_float32()
    if isinstance(max_steps, bool) or not isinstance(max_steps, int) or max_steps < 1:
        raise ValueError(f"max_steps is {max_steps!r}; expected a whole number of at least 1")
    problem = build(scene, measurement, parameters, standard_uncertainty, tolerance)
    if problem.nonlinear:
        # The search is compiled first and needed first; both are compiled at the same time.
        problem.programs.begin_chunk(problem.data)
        prepare(problem, max_steps)
    unknown = standard_uncertainty is None and measurement.standard_uncertainty is None
    if unknown and problem.degrees_of_freedom == 0:
        raise ValueError(
            "the measurement states no uncertainty, and no degree of freedom is left to estimate it; "
            "expected standard_uncertainty=, more values, or fewer free parameters"
        )
    found = _search(problem, max_steps)
    if unknown:
        # Priors do not scale with the uncertainty, hence the repetition; without them the second pass agrees.
        for _ in range(8):
            factor = np.sqrt(found.minima.chi_square[0] / problem.degrees_of_freedom)
            sigma = 1 / float(jnp.max(problem.data.weights))
            factor = max(factor, tolerance / sigma)
            problem = problem.with_uncertainty_scaled(float(factor))
            found = _search(problem, max_steps)
            if abs(factor - 1) < 1e-3 or factor * sigma <= tolerance:
                break
    return report(problem, found, unknown)


def _warn_of_float32() -> None:
    global _warned_of_float32
    if not _warned_of_float32 and jnp.result_type(float) == jnp.float32:
        _warned_of_float32 = True
        warnings.warn(
            "JAX runs in float32, which limits a fit to about 1e-5: call "
            'jax.config.update("jax_enable_x64", True) before the first array is made',
            stacklevel=3,
        )


def _search(problem: Problem, max_steps: int) -> Found:
    if not problem.nonlinear:
        return _eliminate(problem)
    if len(problem.nonlinear) == 1:
        return _search_axis(problem, max_steps)
    return _search_product(problem, max_steps)


def _eliminate(problem: Problem) -> Found:
    """Only gain or offset are free: the answer is exact, and nothing is searched."""
    chi_square, linear, variance, predicted = problem.alone()
    if not np.isfinite(chi_square).all():
        raise ValueError("the model gives no number for this scene; expected a scene that can be evaluated")
    nothing = np.empty((1, 0))
    found = Polished(
        parameters=nothing,
        chi_square=chi_square,
        linear=linear,
        variance=variance,
        converged=np.ones(1, dtype=bool),
        steps=np.zeros(1, dtype=int),
        predicted=predicted,
        slopes=np.empty((1, 0, *predicted.shape[1:])),
    )
    return Found(found, found.converged, Evaluation(nothing, chi_square, linear, variance))


def _finite(cost: np.ndarray) -> np.ndarray:
    return np.where(np.isfinite(cost), cost, np.inf)


def _search_axis(problem: Problem, max_steps: int) -> Found:
    """One parameter: a grid that knows the kinks, then its best valleys."""
    parameter = problem.nonlinear[0]
    axis = search.axis(parameter, kink_values(problem))
    table = problem.evaluate(axis[:, None])
    cost = _finite(table.chi_square)
    if not np.isfinite(cost).any():
        raise ValueError(
            f"the model gives no number anywhere between {parameter.displayed(parameter.lower):g} and "
            f"{parameter.displayed(parameter.upper):g}; expected a scene that can be evaluated"
        )
    valleys = search.distinct_minima(cost, lane_count(problem))
    polished = polish(problem, axis[valleys][:, None], max_steps=max_steps)
    place, chi = polished.parameters[:, 0], _finite(polished.chi_square)
    ends = np.stack([axis[np.maximum(valleys - 1, 0)], axis[np.minimum(valleys + 1, len(axis) - 1)]], axis=1)
    stayed = (place >= ends[:, 0]) & (place <= ends[:, 1]) & polished.converged.astype(bool)
    points, costs, good = [axis[valleys], place], [cost[valleys], chi], [np.zeros(len(valleys), bool)]
    good.append(polished.converged.astype(bool))
    again = ~stayed | (chi > cost[valleys])
    if again.any():
        # The valley may be a cusp, or the polish may have leapt out of it: then without derivatives.
        width = parameter.step_tolerance * (1.0 if parameter.scale == "linear" else parameter.lower)

        def of(values: np.ndarray) -> np.ndarray:
            return problem.evaluate(values[:, None]).chi_square

        sections, section_costs = search.section_minima(of, ends[again], width, CHUNK)
        points.append(sections)
        costs.append(section_costs)
        good.append(np.ones(len(sections), bool))
        good[0][again] = True  # The section ended no lower than this grid point only if it is the minimum.
    candidates, chis, converged = np.concatenate(points), np.concatenate(costs), np.concatenate(good)
    good_grid = np.abs(chis[: len(valleys)] - chi) <= 1e-9 * (1 + chi)
    converged[: len(valleys)] |= good_grid | (cost[valleys] < chi)
    step = search.ANGLE_STEP if parameter.unit == "rad" else search.LOG_STEP
    separation = step if parameter.unit == "rad" or parameter.scale == "log" else (axis[-1] - axis[0]) / 200
    kept: list[int] = []
    for index in np.argsort(chis, kind="stable"):
        basin = np.flatnonzero((ends[:, 0] <= candidates[index]) & (candidates[index] <= ends[:, 1]))
        apart = np.abs(parameter.natural(candidates[index]) - parameter.natural(candidates[kept])) if kept else []
        taken = any(a < 1e-3 * separation for a in apart) or any(
            ends[b, 0] <= candidates[k] <= ends[b, 1] for b in basin for k in kept
        )
        # A polish that left its valley counts only where no valley of the table is near.
        stray = not len(basin) and any(a < separation for a in apart)
        if not taken and not stray and np.isfinite(chis[index]):
            kept.append(int(index))
    kept = [k for k in kept if chis[k] - chis[kept[0]] < _NEAR][: lane_count(problem)]
    final = polish(problem, candidates[kept][:, None], frozen=True, max_steps=max_steps)
    return Found(final, converged[kept], table)


def _search_product(problem: Problem, max_steps: int) -> Found:
    """Two or three parameters: a product of axes, its lowest valleys, and the kinks next to their ends."""
    axes = search.product_axes(problem.nonlinear)
    grid = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], axis=1)
    table = problem.evaluate(grid)
    cost = _finite(table.chi_square).reshape([len(a) for a in axes])
    valleys = search.product_minima(cost, lane_count(problem))
    if not valleys:
        raise ValueError("the model gives no number anywhere in the allowed ranges; expected a usable scene")
    starts = np.array([[axis[i] for axis, i in zip(axes, valley, strict=True)] for valley in valleys])
    ends = [polish(problem, starts, max_steps=max_steps)]
    on_kinks = _kink_starts(problem, ends[0])
    if len(on_kinks):
        movable = np.ones(on_kinks.shape, dtype=bool)
        movable[:, problem.is_angle] = False
        ends.append(polish(problem, on_kinks, movable, max_steps=max_steps))
    ends.append(polish(problem, starts, frozen=True, max_steps=max_steps))
    joined = Polished(*(np.concatenate(parts) for parts in zip(*ends, strict=True)))
    converged = joined.converged.astype(bool)
    converged[-len(starts) :] = False  # A start that nothing improves upon is no polished minimum.
    chis = _finite(joined.chi_square)
    best = np.min(chis)
    places = np.stack([p.natural(joined.parameters[:, i]) for i, p in enumerate(problem.nonlinear)], axis=1)
    bounds = np.asarray(problem.data.bounds, dtype=np.float64)
    places = (places - bounds[0]) / (bounds[1] - bounds[0])
    kept: list[int] = []
    for index in np.argsort(chis + 1e-9 * ~converged, kind="stable"):
        if chis[index] - best >= _NEAR or not np.isfinite(chis[index]):
            break
        if all(_ridge(problem, joined, places, int(index), k) for k in kept):
            kept.append(int(index))
    kept = kept[: lane_count(problem)]
    return Found(Polished(*(part[kept] for part in joined)), converged[kept], table)


def _kink_starts(problem: Problem, polished: Polished) -> np.ndarray:
    """The polished minima moved to the nearest kink of the angle: a minimum in a cusp lies exactly there."""
    kinks = kink_values(problem)
    if not len(kinks) or problem.is_angle is None:
        return np.empty((0, len(problem.nonlinear)))
    near = polished.parameters[polished.chi_square - np.nanmin(polished.chi_square) < _NEAR].copy()
    own = near[:, problem.is_angle]
    nearest = kinks[np.argmin(np.abs(own[:, None] - kinks), axis=1)]
    near[:, problem.is_angle] = nearest
    return near[np.abs(nearest - own) < np.radians(1.0)]


def _ridge(problem: Problem, points: Polished, places: np.ndarray, first: int, second: int) -> bool:
    """Whether two minima are distinct: the straight way between them climbs over the higher one."""
    if np.max(np.abs(places[first] - places[second])) < 1e-4:
        return False
    share = np.linspace(0, 1, CHUNK)[:, None]
    natural = [
        p.natural(points.parameters[first, i]) * (1 - share) + p.natural(points.parameters[second, i]) * share
        for i, p in enumerate(problem.nonlinear)
    ]
    pairs = zip(problem.nonlinear, natural, strict=True)
    path = np.concatenate([p.from_natural(n) for p, n in pairs], axis=1)
    highest = np.max(_finite(problem.evaluate(path).chi_square))
    return bool(highest - points.chi_square[first] >= search.PROMINENCE)
