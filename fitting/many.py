"""Thousands of spectra of one kind of sample: one table for all, then many descents at once, in bounded memory."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from fitting import search
from fitting.arrow import CONVERGED, OUT_OF_STEPS
from fitting.assembly import build
from fitting.layout import Data
from fitting.measurement import Measurement, same_light
from fitting.problem import GRID_STEPS, INNER_STEPS, Descent, Problem, fraction_start
from fitting.table import Table

_SPECTRA_AT_ONCE = 256
_WITH_TABLE = 4096
"""So many spectra are worth the making of a verified table."""

_FROM_TABLE_AT_ONCE = 1024

_STEPS = 60
_MOST_VALLEYS = 5
_REACH = 25.0
_COARSE_POINTS = 60
_STATUSES = ("converged", "not converged", "no number", "not identifiable", "at bound", "no value", "bad value")


@dataclass(frozen=True, eq=False)
class ManyResult:
    """Fits of N spectra. A spectrum without an answer has NaN and says why; it harms no other.

    Args:
        values: by name, shape (N,); radians for angles.
        standard_errors: by name, shape (N,); from the slopes at the best fit, NaN where not determined.
        spectra: free spectra by name, shape (N, L).
        spectral_errors: their standard errors, shape (N, L).
        chi_square: of data and priors, shape (N,).
        degrees_of_freedom: shape (N,).
        next_minimum: by how much chi-square of the next distinct minimum exceeds the best, shape (N,); infinite
            if there is none. Below 4 the data hardly choose between them.
        status: of each: "converged", "not converged", "no number" (the model gives none), "not identifiable", "at
            bound", "no value" (all are missing) or "bad value" (not finite).
        steps: of the descents of each, all together, shape (N,); 0 if the table sufficed.
    """

    values: dict[str, np.ndarray]
    standard_errors: dict[str, np.ndarray]
    spectra: dict[str, np.ndarray]
    spectral_errors: dict[str, np.ndarray]
    chi_square: np.ndarray
    degrees_of_freedom: np.ndarray
    next_minimum: np.ndarray
    status: np.ndarray
    steps: np.ndarray

    @property
    def converged(self) -> np.ndarray:
        """Which fits have an answer, shape (N,)."""
        return np.asarray(self.status == "converged")

    def summary(self) -> str:
        """How many ended how."""
        counts = [(word, int(np.sum(self.status == word))) for word in _STATUSES]
        parts = ", ".join(f"{count} {word}" for word, count in counts if count)
        return f"{len(self.status)} spectra: {parts}"


@dataclass(frozen=True, eq=False)
class _Batch:
    """Measured values of some spectra, NaN taken out."""

    values: np.ndarray
    weights: np.ndarray
    means: np.ndarray


@dataclass(frozen=True, eq=False)
class _Grid:
    """Where the search looks.

    Args:
        shape: points along each searched number.
        points: the numbers, shape (G, P).
        factors: true reflectance factors there, shape (G, D, L); None where each spectrum needs its own.
        table: what lies between, if there are spectra enough.
    """

    shape: tuple[int, ...]
    points: np.ndarray
    factors: np.ndarray | None
    table: Table | None = None


def fit_many(
    scene: Any,
    measurements: Measurement | Sequence[Measurement],
    parameters: Sequence[Any],
    *,
    spectra: Float[np.ndarray, "n d w"] | None = None,
    standard_uncertainty: Any = None,
    tolerance: float = 1e-6,
    max_steps: int = 300,
    throw: bool = False,
) -> ManyResult:
    """Fit each of many spectra by itself, measured in the same directions at the same wavelengths.

    The search is that of ``fit``: a table over the whole allowed range, its best valleys, a descent from each.
    The table does not depend on the spectra if only gain and offset are free beside what is searched, and is made
    once; of 4096 spectra and more it then also holds what lies between its points, verified to
    ``tolerance``, and takes the place of the descents. There are no profiles: intervals, kinks and warnings are
    ``fit``'s.

    Args:
        scene: what the samples are.
        measurements: all of them; or one that says directions, wavelengths and light, with ``spectra``.
        parameters: see ``fit``.
        spectra: reflectance factors, shape (N, D, L), NaN where missing.
        standard_uncertainty: one number, or an array that broadcasts to (N, D, L); the measurements' own if None.
        tolerance: bound on the model's numerical error.
        max_steps: most steps of a descent.
        throw: raise an error if a fit has no answer.

    Returns:
        Values, standard errors and a status for each.

    Raises:
        ValueError: the inputs do not fit together, or ``throw`` and a fit has no answer.
    """
    template, values, sigma = _stacked(measurements, spectra, standard_uncertainty)
    problem = build(scene, template, parameters, None, tolerance)
    if len(problem.measurements) > 1:
        raise ValueError("fit_many fits single measurements; expected one Scene")
    columns = ManyProblem(problem, tolerance, len(values)).columns(values, sigma, max_steps)
    numbers, errors, free, free_errors, chi_square, dof, gap, status, steps = columns
    names = [p.name for p in problem.numbers]
    result = ManyResult(
        values={name: numbers[:, i] for i, name in enumerate(names)},
        standard_errors={name: errors[:, i] for i, name in enumerate(names)},
        spectra={name: free[:, i] for i, name in enumerate(problem.free_names)},
        spectral_errors={name: free_errors[:, i] for i, name in enumerate(problem.free_names)},
        chi_square=chi_square,
        degrees_of_freedom=dof,
        next_minimum=gap,
        status=status,
        steps=steps,
    )
    if throw and not result.converged.all():
        first = int(np.argmin(result.converged))
        raise ValueError(f"spectrum {first}: {result.status[first]} ({result.summary()})")
    return result


class ManyProblem:
    """A problem and what all its spectra share, to fit them in parts.

    Args:
        problem: of one of them.
        tolerance: bound on the model's numerical error.
        count: of all spectra that will come.
    """

    def __init__(self, problem: Problem, tolerance: float, count: int) -> None:
        self.problem = problem
        self.grid = _grid(problem)
        free_prior = problem.searched and np.asarray(problem.data.tightness)[0] == 0
        if count >= _WITH_TABLE and problem.tabular and len(self.grid.shape) == 1 and free_prior:
            assert self.grid.factors is not None
            table = Table.of(problem, self.grid.points, self.grid.factors, tolerance)
            self.grid = replace(self.grid, table=table)

    def columns(self, values: np.ndarray, sigma: np.ndarray, max_steps: int) -> list[np.ndarray]:
        """Columns of the result for some spectra, in the order of ``_fit_batch``."""
        at_once = _SPECTRA_AT_ONCE if self.grid.table is None else _FROM_TABLE_AT_ONCE
        parts = [slice(first, first + at_once) for first in range(0, len(values), at_once)]
        rows = [_fit_batch(self.problem, self.grid, values[some], sigma[some], max_steps) for some in parts]
        return [np.concatenate(column) for column in zip(*rows, strict=True)]


def _stacked(
    measurements: Any, spectra: Any, standard_uncertainty: Any
) -> tuple[Measurement, np.ndarray, np.ndarray]:
    """A template with plausible values, all values, all uncertainties."""
    if isinstance(measurements, Measurement):
        if spectra is None:
            raise ValueError("one measurement without spectra=; expected an array of shape (N, D, L), or a list")
        template = measurements
        shape = template.reflectance_factor.shape
        values = np.array(spectra, dtype=np.float64)
        if values.ndim != 3 or values.shape[1:] != shape:
            raise ValueError(f"spectra have the shape {values.shape}; expected (N, {shape[0]}, {shape[1]})")
        sigma = standard_uncertainty if standard_uncertainty is not None else template.standard_uncertainty
    else:
        if spectra is not None:
            raise ValueError("spectra= goes with one measurement; expected a list of measurements without it")
        every = list(measurements)
        if not every or not all(isinstance(m, Measurement) for m in every):
            raise ValueError("no list of measurements; expected at least one Measurement")
        template = every[0]
        for i, m in enumerate(every):
            same = all(
                np.array_equal(getattr(m, a), getattr(template, a), equal_nan=True)
                for a in ("wavelengths_nm", "polar", "azimuth", "hemispherical")
            )
            if not (same and same_light(m.illumination, template.illumination)):
                raise ValueError(
                    f"measurement {i} has other wavelengths, directions or light than the first; expected the same"
                )
        values = np.stack([m.reflectance_factor for m in every])
        sigma = standard_uncertainty
        if sigma is None and all(m.standard_uncertainty is not None for m in every):
            sigma = np.stack([m.standard_uncertainty for m in every])
    if not len(values):
        raise ValueError("no spectrum; expected at least one")
    if sigma is None:
        raise ValueError("no uncertainty is stated; expected standard_uncertainty=, one number or an array")
    try:
        sigma = np.broadcast_to(np.asarray(sigma, dtype=np.float64), values.shape)
    except ValueError:
        raise ValueError(
            f"standard_uncertainty has the shape {np.shape(sigma)}; expected one that broadcasts to {values.shape}"
        ) from None
    known = ~np.isnan(values)
    if not ((sigma > 0) & np.isfinite(sigma))[known].all():
        raise ValueError("standard_uncertainty is not positive everywhere; expected finite numbers above zero")
    typical = Measurement(
        template.wavelengths_nm,
        template.polar,
        template.azimuth,
        np.full(values.shape[1:], 0.5),
        np.full(values.shape[1:], float(np.median(sigma[known])) if known.any() else 0.01),
        illumination=template.illumination,
        hemispherical=template.hemispherical,
    )
    return typical, values, sigma


def _grid(problem: Problem) -> _Grid:
    """Where the search looks, and the table of the model there if all spectra can share one."""
    if not problem.searched:
        return _Grid((), problem.start_values[None], None)
    if len(problem.searched) == 1:
        axes = [search.axis(problem.searched[0], problem.kinks(0)) if problem.tabular else _coarse(problem)]
    else:
        axes = search.product_axes(problem.searched)
    product = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], axis=1)
    points = np.repeat(problem.start_values[None], len(product), axis=0)
    points[:, : len(axes)] = product
    factors = problem.factors(points)[0] if problem.tabular else None
    return _Grid(tuple(len(a) for a in axes), points, factors)


def _fit_batch(
    problem: Problem, grid: _Grid, values: np.ndarray, sigma: np.ndarray, max_steps: int
) -> tuple[np.ndarray, ...]:
    """Columns of the result for some spectra."""
    count = len(values)
    allowed = np.asarray(problem.data.weights[0]) > 0
    absent = np.isnan(values)
    bad = np.isinf(values).any(axis=(1, 2))
    empty = (absent | ~allowed).all(axis=(1, 2))
    absent = absent | (bad | empty)[:, None, None]
    missing = absent | ~allowed
    weights = np.where(missing, 0.0, 1 / np.where(missing, 1.0, sigma))
    means = np.where(absent, 0.0, values).sum(axis=2) / np.maximum((~absent).sum(axis=2), 1)
    batch = _Batch(np.where(missing, 0.0, values), weights, means)
    if grid.table is None:
        owner, ends = _descents(problem, grid, batch, np.arange(count), max_steps)
    else:
        owner, ends = _answers(problem, grid, grid.table, batch, max_steps)
    shape = (count, len(problem.numbers))
    free = (count, *problem.starts.shape[1:])
    numbers, errors = np.full(shape, np.nan), np.full(shape, np.nan)
    found, found_errors = np.full(free, np.nan), np.full(free, np.nan)
    chi_square, gap = np.full(count, np.nan), np.full(count, np.inf)
    status = np.full(count, "no number", dtype=object)
    steps = np.bincount(owner, ends.steps, count).astype(int)
    cost = np.where(np.isfinite(ends.chi_square), ends.chi_square, np.inf)
    # Best first within each spectrum.
    order = np.lexsort((cost, owner))
    first = order[np.append(True, owner[order][1:] != owner[order][:-1])] if len(order) else order
    some = first[np.isfinite(cost[first])]
    who = owner[some]
    numbers[who], found[who], chi_square[who] = ends.values[some], ends.spectra[some], ends.chi_square[some]
    normal = problem.normal(ends.take(some))
    covariance = normal.covariance()
    with np.errstate(invalid="ignore"):
        errors[who] = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        variance = normal.spectral_variance(covariance)
        found_errors[who] = np.sqrt(np.where(np.isfinite(variance), variance, np.nan))
    found[who] = np.where(normal.determined[:, None], found[who], np.nan)
    undetermined = np.isnan(errors[who]).any(axis=1)
    bounds = np.array([[p.lower for p in problem.numbers], [p.upper for p in problem.numbers]]).reshape(2, -1)
    hit = np.isclose(numbers[who][:, None], bounds[None], rtol=1e-9, atol=1e-12)
    free_to_end = np.array([p.role == "stray_light" for p in problem.numbers], bool)
    at_bound = (hit & ~free_to_end).any(axis=(1, 2))
    done = ends.status[some] == CONVERGED
    words = np.where(done, "converged", "not converged").astype(object)
    words[at_bound] = "at bound"
    words[undetermined] = "not identifiable"
    status[who] = words
    status[empty], status[bad] = "no value", "bad value"
    gap[who] = _gaps(problem, ends.values, cost, owner, some)
    if problem.layout.free_spectra:
        dof = np.array([problem.freedom([w]) for w in weights], dtype=int)
    else:
        dof = (weights > 0).sum(axis=(1, 2)) + problem.freedom([np.zeros(weights.shape[1:])])
    return numbers, errors, found, found_errors, chi_square, dof, gap, status, steps


def _descents(
    problem: Problem, grid: _Grid, batch: _Batch, who: np.ndarray, max_steps: int
) -> tuple[np.ndarray, Descent]:
    """Descents from the best valleys of some spectra, and the spectrum that each belongs to."""
    part = _Batch(batch.values[who], batch.weights[who], batch.means[who])
    owner, starts, spectra = _candidates(problem, grid, part)
    ends = _descend(problem, part, owner, starts, spectra, None, 0, min(_STEPS, max_steps))
    # Few need more, next to a kink; the others must not wait for them.
    if max_steps > _STEPS and len(slow := np.flatnonzero(ends.status == OUT_OF_STEPS)):
        again = _descend(
            problem, part, owner[slow], ends.values[slow], ends.spectra[slow], None, 0, max_steps - _STEPS
        )
        for whole, part_of in zip(ends[:-1], again[:-1], strict=True):
            whole[slow] = whole[slow] + part_of if whole is ends.steps or whole is ends.rejected else part_of
    return who[owner], ends


def _answers(
    problem: Problem, grid: _Grid, table: Table, batch: _Batch, max_steps: int
) -> tuple[np.ndarray, Descent]:
    """The minima in the valleys of all spectra from the table; descents where a cell of a valley is not good."""
    assert grid.factors is not None
    cost, _ = _table_costs(problem, batch, grid.points, grid.factors)
    usable = np.asarray((batch.weights > 0).any(axis=(1, 2)))
    owner, point = _all_valleys(np.where(usable[:, None] & np.isfinite(cost), cost, np.inf))
    cells = np.stack([np.maximum(point - 1, 0), np.minimum(point, len(table.good) - 1)], axis=1)
    doubtful = np.zeros(len(batch.values), bool)
    doubtful[owner[~table.good[cells].all(axis=1)]] = True
    # What has no valley has no number; the descents say so.
    doubtful |= usable & (np.bincount(owner, minlength=len(doubtful)) == 0)
    keep = ~doubtful[owner]
    owner, cells = owner[keep], cells[keep]
    flat, weights = (a.reshape(len(batch.values), -1)[owner] for a in (batch.values, batch.weights))
    sides = [table.minimize(cells[:, k], flat, weights) for k in (0, 1)]
    # At a kink both sides end at the same place: the one that knows less about it counts.
    apart = sides[0].chi_square - sides[1].chi_square
    known = [side.matrix[:, 0, 0, 0] for side in sides]
    first = np.where(np.abs(apart) <= 1e-9 * (1 + sides[0].chi_square), known[0] <= known[1], apart < 0)
    best = [np.where(first.reshape(-1, *[1] * (a.ndim - 1)), a, b) for a, b in zip(*sides, strict=True)]
    values = np.empty((len(owner), len(problem.numbers)))
    values[:, 0] = problem.searched[0].from_natural(best[0])
    values[:, list(problem.linear)] = best[1]
    none = np.zeros(len(owner), int)
    spectra = np.zeros((len(owner), *problem.starts.shape[1:]))
    ends = Descent(values, spectra, best[2], best[3], np.full(len(owner), CONVERGED), none, none, ())
    if not doubtful.any():
        return owner, ends
    others, more = _descents(problem, grid, batch, np.flatnonzero(doubtful), max_steps)
    joined: list[Any] = [np.concatenate([a, b]) for a, b in zip(ends[:-1], more[:-1], strict=True)]
    return np.concatenate([owner, others]), Descent(*joined, ())  # type: ignore[call-arg]


def _all_valleys(cost: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows, and columns of their local minima that could be the lowest, at most a few of each row."""
    outside = np.full((len(cost), 1), np.inf)
    before, after = np.hstack([outside, cost[:, :-1]]), np.hstack([cost[:, 1:], outside])
    room = np.maximum(np.where(np.isfinite(before), before, -np.inf), np.where(np.isfinite(after), after, -np.inf))
    with np.errstate(invalid="ignore"):
        room = np.maximum(room - cost, 0.0)
        low = cost - np.where(np.isfinite(room), room, 0.0) < cost.min(axis=1, keepdims=True) + _REACH
    row, column = np.nonzero((cost < before) & (cost <= after) & low)
    order = np.lexsort((cost[row, column], row))
    row, column = row[order], column[order]
    rank = np.arange(len(row)) - np.searchsorted(row, row)
    return row[rank < _MOST_VALLEYS], column[rank < _MOST_VALLEYS]


def _gaps(
    problem: Problem, values: np.ndarray, cost: np.ndarray, owner: np.ndarray, best: np.ndarray
) -> np.ndarray:
    """Rise of chi-square to the next minimum that lies elsewhere."""
    if not problem.searched:
        return np.full(len(best), np.inf)
    apart = search.separation(
        problem.searched[0], np.array([problem.searched[0].lower, problem.searched[0].upper])
    )
    place = problem.numbers[0].natural(values[:, 0])
    gaps = np.full(len(best), np.inf)
    if not len(best):
        return gaps
    position = np.full(owner.max() + 1, -1)
    position[owner[best]] = np.arange(len(best))
    mine = position[owner]
    chosen = best[mine]
    other = np.isfinite(cost) & (mine >= 0) & (np.abs(place - place[chosen]) > apart)
    np.minimum.at(gaps, mine[other], (cost - cost[chosen])[other])
    return gaps


def _candidates(problem: Problem, grid: _Grid, batch: _Batch) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Starts of the descents: the spectrum each belongs to, the numbers and the free spectra."""
    usable = np.flatnonzero((batch.weights > 0).any(axis=(1, 2)))
    if not problem.searched:
        return _relaxed(problem, batch, usable, np.repeat(grid.points, len(usable), axis=0))
    owners: list[int] = []
    values: list[np.ndarray] = []
    spectra: list[np.ndarray] = []
    if grid.factors is not None:
        cost, linear = _table_costs(problem, batch, grid.points, grid.factors)
    for who in usable:
        if grid.factors is not None:
            own_cost, own_values, own_spectra = cost[who], grid.points, np.zeros((len(grid.points), 0, 1))
        else:
            held = np.arange(len(problem.numbers)) < len(grid.shape)
            own_cost, own_values, own_spectra = _own_table(problem, batch, int(who), grid.points, held)
        for k in _valleys(own_cost, grid.shape):
            start = own_values[k].copy()
            if grid.factors is not None:
                start[list(problem.linear)] = linear[who, k]
            owners.append(int(who))
            values.append(start)
            spectra.append(own_spectra[k])
    return (
        np.array(owners, dtype=int),
        np.array(values).reshape(len(owners), len(problem.numbers)),
        np.array(spectra).reshape(len(owners), *problem.starts.shape[1:]),
    )


def _coarse(problem: Problem) -> np.ndarray:
    """A coarse axis: beside what is searched so much is free that each of its points is a fit."""
    parameter = problem.searched[0]
    low, high = (float(parameter.natural(b)) for b in (parameter.lower, parameter.upper))
    return np.asarray(parameter.from_natural(np.linspace(low, high, _COARSE_POINTS)), dtype=np.float64)


def _valleys(cost: np.ndarray, shape: tuple[int, ...]) -> list[int]:
    """Where descents begin: local minima that could be the lowest, best first."""
    cost = np.where(np.isfinite(cost), cost, np.inf)
    if len(shape) > 1:
        chosen = search.product_minima(cost.reshape(shape), _MOST_VALLEYS)
        return [int(np.ravel_multi_index(place, shape)) for place in chosen]
    before, after = np.append(np.inf, cost[:-1]), np.append(cost[1:], np.inf)
    found = np.flatnonzero((cost < before) & (cost <= after))
    if len(found) > _MOST_VALLEYS:
        found = search.distinct_minima(cost, _MOST_VALLEYS)
    if not len(found):
        return []
    # How far a valley may lie below its grid point: no further than its neighbors lie above.
    around = np.stack([np.where(np.isfinite(side), side, -np.inf)[found] for side in (before, after)])
    room = np.maximum(np.max(around, axis=0) - cost[found], 0.0)
    room = np.where(np.isfinite(room), room, 0.0)
    keep = found[cost[found] - room < cost[found].min() + _REACH]
    return [int(k) for k in keep[np.argsort(cost[keep], kind="stable")]]


def _table_costs(
    problem: Problem, batch: _Batch, points: np.ndarray, factors: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Chi-square of every spectrum at every point with gain and offset eliminated, and these."""
    flat = factors.reshape(len(points), -1)
    w2 = (batch.weights**2).reshape(len(batch.values), -1)
    h = batch.values.reshape(len(batch.values), -1)
    tight, center = (np.asarray(a, np.float64) for a in (problem.data.tightness, problem.data.center))
    roles = {problem.numbers[i].role: i for i in problem.linear}
    rr, r1 = _shared(w2, (flat**2).T), _shared(w2, flat.T)
    rh = (w2 * h) @ flat.T
    hh, h1, one = ((w2 * x).sum(axis=1)[:, None] for x in (h * h, h, np.ones_like(h)))
    others = [i for i in range(len(problem.numbers)) if i not in problem.linear]
    logs = np.where(problem.layout.prior_of_logarithm, np.log(np.where(points > 0, points, 1.0)), points)
    prior = np.sum((tight[others] * (logs[:, others] - center[others])) ** 2, axis=1)
    found = np.empty((*rh.shape, len(problem.linear)))
    if not roles:
        return hh - 2 * rh + rr + prior, found
    tg, to = (tight[roles[r]] ** 2 if r in roles else 0.0 for r in ("gain", "offset"))
    cg, co = (center[roles[r]] if r in roles else 0.0 for r in ("gain", "offset"))
    if "offset" not in roles:
        square, right = rr + tg, rh + tg * cg
        gain = right / np.where(square > 0, square, 1.0)
        found[..., 0] = gain
        return hh + tg * cg**2 - right * gain + prior, found
    if "gain" not in roles:
        square, right = one + to, h1 - r1 + to * co
        offset = right / square
        found[..., 0] = offset
        return hh - 2 * rh + rr + to * co**2 - right * offset + prior, found
    a, b, c = rr + tg, r1, one + to
    p, q = rh + tg * cg, h1 + to * co
    determinant = a * c - b * b
    flat_spectrum = determinant <= 1e-12 * a * c
    safe = np.where(flat_spectrum, 1.0, determinant)
    gain = np.where(flat_spectrum, p / a, (p * c - q * b) / safe)
    offset = np.where(flat_spectrum, 0.0, (q * a - p * b) / safe)
    found[..., 0], found[..., 1] = gain, offset
    return hh + tg * cg**2 + to * co**2 - p * gain - q * offset + prior, found


def _shared(weights: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """A product of matrices, whose rows are mostly alike where nothing is missing: each is computed once."""
    fullest = int(np.argmax((weights > 0).sum(axis=1)))
    first = weights[fullest : fullest + 1]
    if (weights == first).all():
        return np.asarray(first @ columns)
    other = (weights != first).any(axis=1)
    product = np.repeat(first @ columns, len(weights), axis=0)
    product[other] = weights[other] @ columns
    return product


def _own_table(
    problem: Problem, batch: _Batch, who: int, points: np.ndarray, held: Bool[np.ndarray, " p"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """All else minimized over at every point, for one spectrum; the best of several starts of its spectra."""
    owner = np.full(len(points), who)
    movable = np.repeat(~held[None], len(points), axis=0)
    best = None
    for start in problem.starts:
        spectra = np.repeat(start[None], len(points), axis=0)
        if len(problem.starts) == 1 and problem.layout.free_spectra:
            spectra = np.repeat(_measured(problem, batch, who)[None], len(points), axis=0)
        steps = GRID_STEPS if (~held).any() else 0
        ends = _descend(problem, batch, owner, points, spectra, movable, INNER_STEPS, steps)
        cost = np.where(np.isfinite(ends.chi_square), ends.chi_square, np.inf)
        if best is None:
            best = (cost, ends.values, ends.spectra)
        else:
            better = cost < best[0]
            best = (
                np.where(better, cost, best[0]),
                np.where(better[:, None], ends.values, best[1]),
                np.where(better[:, None, None], ends.spectra, best[2]),
            )
    assert best is not None
    return best


def _measured(problem: Problem, batch: _Batch, who: int) -> np.ndarray:
    """The mean measured spectrum, as a start of a fraction."""
    w2 = batch.weights[who] ** 2
    low, high = np.asarray(problem.data.spectral_bounds, np.float64)[:, :, None]
    return fraction_start((w2 * batch.values[who]).sum(axis=0), w2.sum(axis=0), low, high)


def _relaxed(
    problem: Problem, batch: _Batch, usable: np.ndarray, starts: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Starts where nothing is searched."""
    owner = np.repeat(usable, len(problem.starts))
    values = np.repeat(starts, len(problem.starts), axis=0)
    spectra = np.tile(problem.starts, (len(usable), 1, 1))
    held = np.zeros(values.shape, dtype=bool)
    ends = _descend(problem, batch, owner, values, spectra, held, INNER_STEPS, 0)
    return owner, ends.values, ends.spectra


def _descend(
    problem: Problem,
    batch: _Batch,
    owner: np.ndarray,
    values: np.ndarray,
    spectra: np.ndarray,
    movable: np.ndarray | None,
    inner: int,
    outer: int,
) -> Descent:
    """Descents from many starts, each with the measured values of its own spectrum."""

    def measured(starts: np.ndarray) -> Data:
        own, kind = owner[starts], problem.data.center.dtype
        values, weights, means = (part[own].astype(kind) for part in (batch.values, batch.weights, batch.means))
        return problem.data._replace(values=(values,), weights=(weights,), means=(means,))

    return problem.descend(values, spectra, movable, inner=inner, outer=outer, measured=measured)
