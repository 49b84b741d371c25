"""The fit: search everywhere, polish the best valleys, profile each parameter."""

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

import vcavity_jax as vc
from fitting import search
from fitting.arrow import CONVERGED, OUT_OF_STEPS
from fitting.assembly import build
from fitting.measurement import Measurement
from fitting.problem import Descent, Evaluation, Problem, joined
from fitting.programs import CHUNK
from fitting.report import Found, report
from fitting.result import FitResult

_NEAR = 9.0
_STRIDE = 6
_MEDIUM, _WIDE = 5, 8
"""Coarseness of the search of glossy and of matte scattering grooves."""
_NEAR_STEPS = 2

_warned_of_float32 = False


def fit(
    scene: Any,
    measurement: Any,
    parameters: Sequence[Any],
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
    warn_of_float32()
    if isinstance(max_steps, bool) or not isinstance(max_steps, int) or max_steps < 1:
        raise ValueError(f"max_steps is {max_steps!r}; expected a whole number of at least 1")
    problem = build(scene, measurement, parameters, standard_uncertainty, tolerance)
    if problem.tabular:
        # The search is compiled first and needed first; both are compiled at the same time.
        problem.programs.begin_table(problem.data)
    problem.programs.begin_descent(problem.data, problem.lanes, False, problem.tabular)
    measurements = (
        [measurement]
        if isinstance(measurement, Measurement)
        else list(measurement.values() if isinstance(measurement, Mapping) else measurement)
    )
    unknown = standard_uncertainty is None and measurements[0].standard_uncertainty is None
    if unknown and problem.degrees_of_freedom == 0:
        raise ValueError(
            "the measurement states no uncertainty, and no degree of freedom is left to estimate it; "
            "expected standard_uncertainty=, more values, or fewer free parameters"
        )
    return solved(problem, unknown, max_steps)


def solved(problem: Problem, unknown: bool = False, max_steps: int = 60) -> FitResult:
    """Fit what is put together.

    Args:
        problem: what is fitted.
        unknown: its standard uncertainty is a guess, to be estimated from the residuals.
        max_steps: most steps of each descent to a minimum.
    """
    found = _search(problem, max_steps)
    if unknown:
        # Priors do not scale with the uncertainty, hence the repetition; without them the second pass agrees.
        for _ in range(8):
            factor = np.sqrt(found.minima.chi_square[0] / problem.degrees_of_freedom)
            sigma = 1 / max(float(jnp.max(w)) for w in problem.data.weights)
            factor = max(factor, problem.layout.tolerance / sigma)
            problem = problem.with_uncertainty_scaled(float(factor))
            found = _search(problem, max_steps)
            if abs(factor - 1) < 1e-3 or factor * sigma <= problem.layout.tolerance:
                break
    return report(problem, found, unknown)


def warn_of_float32() -> None:
    """Warn the caller's caller, once."""
    global _warned_of_float32
    if not _warned_of_float32 and jnp.result_type(float) == jnp.float32:
        _warned_of_float32 = True
        warnings.warn(
            "JAX runs in float32, which limits a fit to about 1e-5: call "
            'jax.config.update("jax_enable_x64", True) before the first array is made',
            stacklevel=3,
        )


def _search(problem: Problem, max_steps: int) -> Found:
    searched = len(problem.searched)
    if not searched:
        return _polish_only(problem, max_steps)
    return _search_axis(problem, max_steps) if searched == 1 else _search_product(problem, max_steps)


def _finite(cost: np.ndarray) -> np.ndarray:
    return np.where(np.isfinite(cost), cost, np.inf)


def _polish_only(problem: Problem, max_steps: int) -> Found:
    """Nothing is searched: every unknown has a start, or is an index with a few of them."""
    held = np.zeros(len(problem.numbers), dtype=bool)
    table = problem.evaluate(np.empty((1, 0)), steps=max_steps)
    ends = problem.descend(table.values, table.spectra, outer=max_steps)
    if not np.isfinite(ends.chi_square).any():
        raise ValueError("the model gives no number at the start; expected a scene that can be evaluated")
    return Found(ends, problem.evaluation(ends, held), ends)


def _search_axis(problem: Problem, max_steps: int) -> Found:
    """One parameter: a grid that knows the kinks, then its best valleys."""
    parameter = problem.searched[0]
    axis = _axis(problem)
    table = problem.evaluate(axis[:, None]) if problem.tabular else _along(problem, axis)
    cost = _finite(table.chi_square)
    if not np.isfinite(cost).any():
        raise ValueError(
            f"the model gives no number anywhere between {parameter.displayed(parameter.lower):g} and "
            f"{parameter.displayed(parameter.upper):g}; expected a scene that can be evaluated"
        )
    most = problem.lanes
    valleys = search.distinct_minima(cost, most)
    starts = table.take(valleys)
    polished = problem.descend(starts.values, starts.spectra, outer=max_steps)
    place, chi = polished.values[:, 0], _finite(polished.chi_square)
    ends = np.stack([axis[np.maximum(valleys - 1, 0)], axis[np.minimum(valleys + 1, len(axis) - 1)]], axis=1)
    stayed = (place >= ends[:, 0]) & (place <= ends[:, 1]) & polished.converged
    again = ~stayed | (chi > cost[valleys])
    candidates: list[Evaluation | Descent] = [starts, polished]
    good = [np.zeros(len(valleys), bool), polished.converged]
    if again.any():
        # The valley may be a cusp, or the descent may have leapt out of it: then without derivatives.
        width = parameter.step_tolerance * (1.0 if parameter.scale == "linear" else parameter.lower)
        seen: list[Evaluation] = []

        def of(values: np.ndarray) -> np.ndarray:
            seen.append(problem.evaluate(values[:, None], near=None if problem.tabular else table))
            return seen[-1].chi_square

        places, _ = search.section_minima(of, ends[again], width, CHUNK if problem.tabular else problem.lanes)
        whole = Evaluation(*(np.concatenate(part) for part in zip(*seen, strict=True)))
        nearest = [int(np.argmin(np.abs(whole.values[:, 0] - p))) for p in places]
        candidates.append(whole.take(nearest))
        good.append(np.ones(len(places), bool))
        good[0][again] = True  # The section ended no lower than this grid point only if it is the minimum.
    values = np.concatenate([c.values for c in candidates])
    spectra = np.concatenate([c.spectra for c in candidates])
    chis = _finite(np.concatenate([c.chi_square for c in candidates]))
    converged = np.concatenate(good)
    converged[: len(valleys)] |= (np.abs(cost[valleys] - chi) <= 1e-9 * (1 + chi)) | (cost[valleys] < chi)
    separation = search.separation(parameter, axis)
    kept: list[int] = []
    for index in np.argsort(chis, kind="stable"):
        own = values[index, 0]
        basin = np.flatnonzero((ends[:, 0] <= own) & (own <= ends[:, 1]))
        apart = np.abs(parameter.natural(own) - parameter.natural(values[kept, 0])) if kept else []
        taken = any(a < 1e-3 * separation for a in apart) or any(
            ends[b, 0] <= values[k, 0] <= ends[b, 1] for b in basin for k in kept
        )
        # A descent that left its valley counts only where no valley of the table is near.
        stray = not len(basin) and any(a < separation for a in apart)
        if not taken and not stray and np.isfinite(chis[index]):
            kept.append(int(index))
    kept = [k for k in kept if chis[k] - chis[kept[0]] < _NEAR][:most]
    final = problem.descend(
        values[kept],
        spectra[kept],
        np.zeros((len(kept), values.shape[1]), bool),
        np.zeros(spectra[kept].shape, bool),
        outer=0,
    )
    final = final._replace(status=np.where(converged[kept], CONVERGED, OUT_OF_STEPS))
    return Found(final, table, polished)


def _axis(problem: Problem) -> np.ndarray:
    """The grid of the search: where each point is a fit of its own, as wide as the valleys allow."""
    parameter, parts = problem.searched[0], problem.layout.parts
    if problem.tabular:
        return search.axis(parameter, problem.kinks(0))
    materials = [part.scene.material for part in parts]
    if not any(isinstance(material, vc.Specular) for material in materials):
        # The slopes of what scatters light jump little at its kinks.
        matte = all(isinstance(material, vc.Lambertian) for material in materials)
        return search.axis(parameter, np.empty(0), _WIDE if matte else _MEDIUM)
    # A tilt moves the kinks, so that their nominal places are of no use.
    return search.axis(parameter, np.empty(0) if any(part.tilts for part in parts) else problem.kinks(0), 2)


def _along(problem: Problem, axis: np.ndarray) -> Evaluation:
    """All else minimized over along an axis: at some points from the usual starts, then from their neighbors."""
    every = np.arange(len(axis))
    first = every % _STRIDE == 0
    known = problem.evaluate(axis[first, None])
    rest = problem.evaluate(axis[~first, None], near=known, steps=_NEAR_STEPS)
    order = np.argsort(np.concatenate([every[first], every[~first]]), kind="stable")
    return Evaluation(*(np.concatenate(pair)[order] for pair in zip(known, rest, strict=True)))


def _search_product(problem: Problem, max_steps: int) -> Found:
    """Two or three parameters: a product of axes, its lowest valleys, and the kinks next to their ends."""
    axes = search.product_axes(problem.searched)
    grid = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], axis=1)
    table = problem.evaluate(grid)
    cost = _finite(table.chi_square).reshape([len(a) for a in axes])
    most = problem.lanes
    valleys = search.product_minima(cost, most)
    if not valleys:
        raise ValueError("the model gives no number anywhere in the allowed ranges; expected a usable scene")
    places = [int(np.ravel_multi_index(valley, cost.shape)) for valley in valleys]
    starts = table.take(places)
    first = problem.descend(starts.values, starts.spectra, outer=max_steps)
    ends = [first]
    for slot in problem.angles:
        on_kinks, spectra = _kink_starts(problem, first, slot)
        if len(on_kinks):
            movable = np.ones(on_kinks.shape, dtype=bool)
            movable[:, slot] = False
            ends.append(problem.descend(on_kinks, spectra, movable, outer=max_steps))
    still = np.zeros(starts.values.shape, bool)
    ends.append(
        problem.descend(starts.values, starts.spectra, still, np.zeros(starts.spectra.shape, bool), outer=0)
    )
    whole = joined(ends)
    converged = whole.converged
    converged[-len(places) :] = False  # A start that nothing improves upon is no polished minimum.
    chis = _finite(whole.chi_square)
    best = np.min(chis)
    count = len(problem.searched)
    bounds = np.asarray(problem.data.bounds, dtype=np.float64)[:, :count]
    shares = (problem.natural(whole.values)[:, :count] - bounds[0]) / (bounds[1] - bounds[0])
    kept: list[int] = []
    for index in np.argsort(chis + 1e-9 * ~converged, kind="stable"):
        if chis[index] - best >= _NEAR or not np.isfinite(chis[index]):
            break
        if all(_ridge(problem, whole, shares, int(index), k) for k in kept):
            kept.append(int(index))
    kept = kept[:most]
    final = whole.take(kept)
    return Found(final._replace(status=np.where(converged[kept], CONVERGED, OUT_OF_STEPS)), table, first)


def _kink_starts(problem: Problem, polished: Descent, slot: int) -> tuple[np.ndarray, np.ndarray]:
    """The polished minima moved to the nearest kink of an angle: a minimum in a cusp lies exactly there."""
    kinks = problem.kinks(slot)
    near = polished.take(polished.chi_square - np.nanmin(polished.chi_square) < _NEAR)
    if not len(kinks):
        return near.values[:0], near.spectra[:0]
    values, own = near.values.copy(), near.values[:, slot]
    values[:, slot] = kinks[np.argmin(np.abs(own[:, None] - kinks), axis=1)]
    close = np.abs(values[:, slot] - own) < np.radians(1.0)
    return values[close], near.spectra[close]


def _ridge(problem: Problem, points: Descent, shares: np.ndarray, first: int, second: int) -> bool:
    """Whether two minima are distinct: the straight way between them climbs over the higher one."""
    if np.max(np.abs(shares[first] - shares[second])) < 1e-4:
        return False
    count = len(problem.searched)
    share = np.linspace(0, 1, CHUNK)[:, None]
    ends = problem.natural(points.values[[first, second]])[:, :count]
    natural = ends[0] * (1 - share) + ends[1] * share
    pairs = enumerate(problem.searched)
    path = np.stack([p.from_natural(natural[:, i]) for i, p in pairs], axis=1)
    highest = np.max(_finite(problem.evaluate(path).chi_square))
    return bool(highest - points.chi_square[first] >= search.PROMINENCE)
