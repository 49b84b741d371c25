"""The nested grid posterior: a grid over the searched number, everything else integrated at each of its points.

It is exact where the rest is Gaussian (gain and offset) or falls apart into wavelengths (free spectra), cannot
miss a mode of the searched number, and takes a fraction of a second. Whatever else is unknown is integrated by
Laplace's method, and the draws are corrected by importance weights.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import gammaln, logsumexp  # type: ignore[import-untyped]

from fitting.density import Density
from fitting.intervals import Profile
from fitting.problem import Evaluation
from fitting.result import FitResult

MOST_OTHERS = 40
"""More numbers than this beside the searched one and importance weights would fall apart."""

_CURVED = 0.005
_DEEP = 35.0
_ROUNDS = 14
_MOST_POINTS = 4000
_TAIL = 7.0
_ROUNDS_OF_PROPOSALS = 3
_ENOUGH = 0.7
_LEVELS = 81


class Draws(NamedTuple):
    """Draws of the numbers.

    Args:
        natural: natural coordinates, shape (n, P), in random order.
        spectra: free ones, shape (n, Q, U).
        log_density: of the posterior there, up to the density's constant.
        effective: how many independent draws they are worth.
        log_integral: of the density.
        evaluations: of the density or of a profile.
    """

    natural: np.ndarray
    spectra: np.ndarray
    log_density: np.ndarray
    effective: float
    log_integral: float
    evaluations: int


def reason_against(result: FitResult, density: Density) -> str | None:
    """Why the nested grid does not apply; None if it does."""
    problem = density.problem
    if len(problem.searched) != 1:
        return f"{len(problem.searched)} numbers are searched; the nested grid needs exactly one"
    if density.kind.robust:
        return "Student's t has no closed integrals"
    if len(density.numbers) - 1 > MOST_OTHERS:
        return f"{len(density.numbers) - 1} other numbers are more than {MOST_OTHERS}"
    held = np.arange(len(problem.numbers)) == 0
    if problem.tabular and not np.isfinite(problem.normal(result.found.minima).covariance(held)).all():
        return "gain and offset are not determined"
    return None


def nested_draws(result: FitResult, density: Density, count: int, generator: np.random.Generator) -> Draws:
    """Draws from the nested grid posterior."""
    if density.problem.tabular:
        return _closed(density, count, generator, result)
    if len(density.numbers) == 1:
        return _only(result, density, count, generator)
    return _weighted(result, density, count, generator)


@dataclass
class _Grid:
    """A density on a grid, whose logarithm is linear between its points."""

    places: np.ndarray
    logs: np.ndarray

    @property
    def masses(self) -> np.ndarray:
        """Logarithms of the integrals between neighbors."""
        left, right = self.logs[:-1], self.logs[1:]
        rise = np.abs(right - left)
        small = rise < 1e-8
        share = np.where(small, 0.0, np.log(-np.expm1(-np.where(small, 1.0, rise)) / np.where(small, 1.0, rise)))
        return np.log(np.diff(self.places)) + np.maximum(left, right) + share

    @property
    def log_integral(self) -> float:
        """Of the density."""
        return float(logsumexp(self.masses))

    def draw(self, count: int, generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Stratified draws: left neighbors, shares of the way to the right ones, and log densities."""
        masses = np.exp(self.masses - self.log_integral)
        rising = np.append(0.0, np.cumsum(masses))
        uniform = (np.arange(count) + generator.random(count)) / count * rising[-1]
        left = np.clip(np.searchsorted(rising, uniform, side="right") - 1, 0, len(masses) - 1)
        inside = np.clip((uniform - rising[left]) / np.maximum(masses[left], 1e-300), 0.0, 1.0)
        rise = self.logs[left + 1] - self.logs[left]
        flat = np.abs(rise) < 1e-8
        safe = np.where(flat, 1.0, rise)
        # The inverse of the integral of an exponential, written for either sign.
        grown = np.log1p(inside * np.expm1(-np.abs(safe)))
        falling = -grown / np.abs(safe)
        grown = np.log1p((1 - inside) * np.expm1(-np.abs(safe)))
        share = np.where(flat, inside, np.where(rise < 0, falling, 1 + grown / np.abs(safe)))
        share = np.clip(share, 0.0, 1.0)
        return left, share, self.logs[left] + share * rise


def _refined(places: np.ndarray, log_density: Callable[[np.ndarray], np.ndarray]) -> _Grid:
    """A grid that is fine where the density is: until a straight line through its logarithm will do."""
    places = np.unique(places)
    logs = log_density(places)
    done = np.zeros(len(places) - 1, bool)
    for _ in range(_ROUNDS):
        logs = np.where(np.isnan(logs), -np.inf, logs)
        top = np.max(logs)
        deep = np.maximum(logs[:-1], logs[1:]) < top - _DEEP
        wide = np.diff(places) > 1e-9 * (places[-1] - places[0])
        wanted = np.flatnonzero(~done & ~deep & wide)
        if not len(wanted) or len(places) > _MOST_POINTS:
            break
        middle = (places[wanted] + places[wanted + 1]) / 2
        found = log_density(middle)
        found = np.where(np.isnan(found), -np.inf, found)
        line = (logs[wanted] + logs[wanted + 1]) / 2
        with np.errstate(invalid="ignore"):
            matters = np.minimum(1.0, np.exp(np.maximum(found, line) - top) * 100)
            good = np.abs(found - line) * matters < _CURVED
        done[wanted] = good
        new_places = np.insert(places, wanted + 1, middle)
        logs = np.insert(logs, wanted + 1, found)
        done = np.repeat(done, 1 + np.isin(np.arange(len(done)), wanted))
        places = new_places
    low = np.where(np.isfinite(logs), logs, np.max(logs) - 700)
    return _Grid(places, low)


def _at(places: np.ndarray, seen: list[tuple[np.ndarray, ...]]) -> list[np.ndarray]:
    """What was computed at some places, from parts that each begin with their own places."""
    every, *columns = (np.concatenate(column) for column in zip(*seen, strict=True))
    order = np.argsort(every)
    known = order[np.searchsorted(every, places, sorter=order)]
    return [column[known] for column in columns]


def _evaluations(seen: list[tuple[np.ndarray, ...]]) -> int:
    return sum(len(part[0]) for part in seen)


def _axis(result: FitResult, density: Density) -> np.ndarray:
    """Natural coordinates of what the fit has seen, as far as chi-square says that it may matter."""
    parameter = density.numbers[0]
    known = [(p.values[:, 0], p.chi_square) for p in (result.found.table, result.found.minima)]
    if density.names[0] in result.profiles:
        known.append(result.profiles[density.names[0]])
    places, costs = (np.concatenate(column) for column in zip(*known, strict=True))
    low, high = float(parameter.lower), float(parameter.upper)
    inside = (places >= low) & (places <= high)
    places, first = np.unique(places[inside], return_index=True)
    costs = np.where(np.isnan(costs), np.inf, costs)[inside][first]
    lowest = max(float(np.min(costs)), 1e-12)
    if density.kind.noise:
        near = density.used / 2 * np.log(np.maximum(costs, lowest) / lowest) < _DEEP
    else:
        near = (costs - lowest) / 2 < _DEEP
    # With the neighbors of what matters.
    near = near | np.append(near[1:], False) | np.append(False, near[:-1])
    kept = np.union1d(places[near], [low, high])
    return np.asarray(parameter.natural(kept))


class _Linear(NamedTuple):
    """Gains and offsets at n angles: products of their columns and of the data, by the stated uncertainty."""

    square: np.ndarray
    right: np.ndarray
    total: np.ndarray


def _closed(density: Density, count: int, generator: np.random.Generator, result: FitResult) -> Draws:
    """Beside the searched number only gains and offsets, which are Gaussian, and the noise level."""
    problem, noise = density.problem, density.kind.noise
    searched, numbers = density.numbers[0], len(problem.numbers)
    tight, center = (np.asarray(a, np.float64)[1:] for a in (problem.data.tightness, problem.data.center))
    used = density.used
    levels = np.zeros(1)
    if noise:
        free = max(used - problem.unknowns([np.asarray(w) for w in problem.data.weights]), 1)
        own = math.log(max(result.chi_square, 1e-12) / used) / 2
        low, high = density.bounds[:, -1]
        reach = 8 / math.sqrt(2 * free) * np.linspace(-1, 1, _LEVELS)
        levels = np.unique(np.clip(own + reach, low, high))
    prior = np.diag(tight**2)
    seen: list[tuple[np.ndarray, ...]] = []

    def solved(places: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Means, roots of the covariance and log densities at each place and noise level."""
        linear = _products(density, searched.from_natural(places))
        shrunk = np.exp(-2 * levels)[:, None, None]
        square = linear.square[:, None] * shrunk + prior
        right = linear.right[:, None] * shrunk[..., 0] + tight**2 * center
        best = linear.total[:, None] * shrunk[:, 0, 0] + np.sum((tight * center) ** 2)
        if numbers > 1:
            root = np.linalg.cholesky(np.linalg.inv(square))
            mean = np.einsum("nsij,nskj,nsk->nsi", root, root, right)
            best = best - np.einsum("nsi,nsi->ns", mean, right)
            volume = np.sum(np.log(np.diagonal(root, axis1=2, axis2=3)), axis=2)
        else:
            shape = *best.shape, 0
            mean, root, volume = np.zeros(shape), np.zeros((*shape, 0)), np.zeros(best.shape)
        volume = volume + (numbers - 1) / 2 * math.log(2 * math.pi)
        logs = -best / 2 + volume - used * levels
        return mean, root, logs + _searched_prior(density, places)[:, None]

    def marginal(places: np.ndarray) -> np.ndarray:
        seen.append((places, *solved(places)))
        logs = seen[-1][-1]
        return logs[:, 0] if len(levels) == 1 else np.logaddexp.reduce(logs + _log_trapezoid(levels), axis=1)

    grid = _refined(_axis(result, density), marginal)
    mean, root, logs = _at(grid.places, seen)
    left, share, log_marginal = grid.draw(count, generator)
    place = grid.places[left] + share * np.diff(grid.places)[left]
    level = np.zeros(count)
    chosen = np.zeros(count, int)
    if len(levels) > 1:
        nearest = np.where(share < 0.5, left, left + 1)
        within = np.exp(logs - logs.max(axis=1, keepdims=True))
        between = (within[:, 1:] + within[:, :-1]) / 2 * np.diff(levels)
        rising = np.concatenate([np.zeros((len(within), 1)), np.cumsum(between, axis=1)], axis=1)
        rising /= rising[:, -1:]
        uniform = generator.random(count)
        for k in range(count):
            level[k] = np.interp(uniform[k], rising[nearest[k]], levels)
        chosen = np.argmin(np.abs(level[:, None] - levels), axis=1)
    t = share[:, None]
    middle = (1 - t) * mean[left, chosen] + t * mean[left + 1, chosen]
    spread = (1 - t[..., None]) * root[left, chosen] + t[..., None] * root[left + 1, chosen]
    other = middle + np.einsum("nij,nj->ni", spread, generator.standard_normal(middle.shape))
    columns = [place[:, None], other] + ([level[:, None]] if noise else [])
    natural = np.concatenate(columns, axis=1)
    order = generator.permutation(count)
    spectra = np.zeros((count, *density.setting.spectra.shape))
    return Draws(natural[order], spectra, log_marginal[order], float(count), grid.log_integral, _evaluations(seen))


def _log_trapezoid(levels: np.ndarray) -> np.ndarray:
    steps = np.diff(levels)
    weights = np.concatenate([steps[:1] / 2, (steps[1:] + steps[:-1]) / 2, steps[-1:] / 2])
    return np.asarray(np.log(weights))


def _searched_prior(density: Density, places: np.ndarray) -> np.ndarray:
    """Logarithm of the prior density of the searched number in its natural coordinate."""
    problem, parameter = density.problem, density.numbers[0]
    tight, center = float(problem.data.tightness[0]), float(problem.data.center[0])
    values = parameter.from_natural(places)
    own = np.log(values) if parameter.prior_of_logarithm else values
    of_logarithm, of_value = density.kind.powers[0]
    return np.asarray(-((tight * (own - center)) ** 2) / 2 + of_logarithm * places + of_value * np.log(values))


def _products(density: Density, values: np.ndarray) -> _Linear:
    """Products of gain and offset columns and of the data, each divided by its stated uncertainty."""
    problem = density.problem
    whole = np.repeat(problem.start_values[None], len(values), axis=0)
    whole[:, 0] = values
    count, size = len(values), len(problem.numbers) - 1
    square, right, total = np.zeros((count, size, size)), np.zeros((count, size)), np.zeros(count)
    for part, factor, measured, weights in zip(
        problem.layout.parts, problem.factors(whole), problem.data.values, problem.data.weights, strict=True
    ):
        w = np.asarray(weights, np.float64)
        shining = (w * factor).reshape(count, -1)
        target = np.broadcast_to((w * np.asarray(measured, np.float64)).ravel(), shining.shape)
        roles = dict(part.roles)
        if "gain" not in roles:
            target = target - shining
        columns = [(roles[role] - 1, role) for role in ("gain", "offset") if role in roles]
        rows = [shining if role == "gain" else np.broadcast_to(w.ravel(), shining.shape) for _, role in columns]
        for (i, _), one in zip(columns, rows, strict=True):
            right[:, i] += np.einsum("nr,nr->n", one, target)
            for (j, _), other in zip(columns, rows, strict=True):
                square[:, i, j] += np.einsum("nr,nr->n", one, other)
        total += np.einsum("nr,nr->n", target, target)
    return _Linear(square, right, total)


class _Rest(NamedTuple):
    """All other numbers at n values of the searched one: where they rest, and roots of their covariance."""

    middle: np.ndarray
    root: np.ndarray


def _only(result: FitResult, density: Density, count: int, generator: np.random.Generator) -> Draws:
    """Nothing but the searched number and free spectra: their quantiles change slowly along the grid."""
    seen: list[tuple[np.ndarray, ...]] = []

    def log_density(places: np.ndarray) -> np.ndarray:
        seen.append((places, *density.quadrature(places[:, None])))
        return seen[-1][1]

    grid = _refined(_axis(result, density), log_density)
    _, *quadrature = _at(grid.places, seen)
    left, share, logs = grid.draw(count, generator)
    shuffled = generator.permutation(count)
    left, share, logs = left[shuffled], share[shuffled], logs[shuffled]
    natural = (grid.places[left] + share * np.diff(grid.places)[left])[:, None]
    uniform = generator.random((count, *density.setting.spectra.shape))
    below, above = (density.placed(tuple(q[side] for q in quadrature), uniform) for side in (left, left + 1))
    spectra = below + share[:, None, None] * (above - below)
    return Draws(natural, spectra, logs, float(count), grid.log_integral, _evaluations(seen))


def _weighted(result: FitResult, density: Density, count: int, generator: np.random.Generator) -> Draws:
    """Whatever else is unknown: Laplace's method for the rest of the numbers, corrected by weights."""
    others = len(density.numbers) - 1
    seen: list[tuple[np.ndarray, ...]] = []
    near = _settled(result, density)

    def log_density(places: np.ndarray) -> np.ndarray:
        nonlocal near
        rest, near = _rest(density, places, near, result)
        seen.append((places, *rest))
        logs = density.log_density(np.concatenate([places[:, None], rest.middle], axis=1))
        volume = np.sum(np.log(np.diagonal(rest.root, axis1=1, axis2=2)), axis=1)
        return logs + volume + others / 2 * math.log(2 * math.pi)

    grid = _refined(_axis(result, density), log_density)
    middles, roots = _at(grid.places, seen)

    def proposed(total: int) -> tuple[np.ndarray, ...]:
        left, share, logs = grid.draw(total, generator)
        place = grid.places[left] + share * np.diff(grid.places)[left]
        t = share[:, None]
        middle = (1 - t) * middles[left] + t * middles[left + 1]
        root = (1 - t[..., None]) * roots[left] + t[..., None] * roots[left + 1]
        other, log_other = student_draws(middle, root, generator)
        natural = np.concatenate([place[:, None], other], axis=1)
        found, spectra = density.draw(natural, generator)
        return natural, spectra, found, found - (logs - grid.log_integral) - log_other

    return resampled(proposed, count, generator, _evaluations(seen))


def student_draws(
    middle: Float[np.ndarray, "n k"], root: Float[np.ndarray, "n k k"], generator: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Draws of a multivariate Student's t around each row, and the logarithms of their densities."""
    stretch = np.sqrt(_TAIL / generator.chisquare(_TAIL, len(middle)))
    scaled = generator.standard_normal(middle.shape) * stretch[:, None]
    drawn = middle + np.einsum("nij,nj->ni", root, scaled)
    return drawn, _student(scaled, root)


def student_log_density(
    places: Float[np.ndarray, "n k"], middle: Float[np.ndarray, " k"], root: Float[np.ndarray, "k k"]
) -> Float[np.ndarray, " n"]:
    """Logarithm of the density of one of them at many places."""
    return _student(np.linalg.solve(root, (places - middle).T).T, root[None])


def _student(scaled: np.ndarray, root: np.ndarray) -> np.ndarray:
    size = scaled.shape[1]
    constant = gammaln((_TAIL + size) / 2) - gammaln(_TAIL / 2) - size / 2 * math.log(_TAIL * math.pi)
    volume = np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)), axis=1)
    return np.asarray(constant - volume - (_TAIL + size) / 2 * np.log1p(np.sum(scaled**2, axis=1) / _TAIL))


def resampled(
    proposed: Callable[[int], tuple[np.ndarray, ...]],
    count: int,
    generator: np.random.Generator,
    evaluations: int = 0,
) -> Draws:
    """Draws of equal weight from weighted ones, by systematic resampling.

    Args:
        proposed: makes so many draws: numbers, spectra, log densities and logarithms of the weights.
        count: of draws.
        generator: of random numbers.
        evaluations: that were made before.

    Raises:
        ValueError: no draw has a weight.
    """
    parts: list[tuple[np.ndarray, ...]] = []
    whole, effective, weights = -np.inf, 0.0, np.zeros(0)
    while len(parts) < _ROUNDS_OF_PROPOSALS and effective < _ENOUGH * count:
        parts.append(proposed(count))
        log_weights = np.concatenate([part[3] for part in parts])
        log_weights = np.where(np.isfinite(log_weights), log_weights, -np.inf)
        if np.isfinite(log_weights).any():
            whole = float(logsumexp(log_weights))
            weights = np.exp(log_weights - whole)
            effective = float(1 / np.sum(weights**2))
    if not effective:
        raise ValueError("the density is zero at every draw; expected a fit that the priors and bounds allow")
    rising = np.cumsum(weights)
    uniform = (np.arange(count) + generator.random()) / count * rising[-1]
    chosen = generator.permutation(np.minimum(np.searchsorted(rising, uniform), len(weights) - 1))
    natural, spectra, log_density = (np.concatenate([part[i] for part in parts])[chosen] for i in range(3))
    return Draws(
        natural,
        spectra,
        log_density,
        min(effective, float(count)),
        whole - math.log(len(weights)),
        evaluations + len(weights),
    )


def _settled(result: FitResult, density: Density) -> Evaluation:
    """Points of the profile to start from."""
    profile = Profile(density.problem, 0, result.found.table, result.found.minima)
    return profile.points


def _rest(density: Density, places: np.ndarray, near: Any, result: FitResult) -> tuple[_Rest, Any]:
    """Where the other numbers rest at some places, from the nearest points known, which grow."""
    problem = density.problem
    searched, size = density.numbers[0], len(problem.numbers)
    at = problem.relaxed(searched.from_natural(places)[:, None], near, 20)
    held = np.arange(size) == 0
    covariance = problem.normal(at).covariance(held)[:, 1:, 1:]
    # A density is wanted: along what the data do not determine the bounds are the scale.
    low, high = density.bounds[:, 1:size]
    room = np.where(np.isfinite(high - low), high - low, 1e3)
    bad = ~np.isfinite(covariance).all(axis=(1, 2))
    covariance = np.where(bad[:, None, None], np.diag(room**2), covariance)
    natural = problem.natural(at.values)
    units = np.where(np.asarray(problem.layout.logarithmic, bool)[1:], at.values[:, 1:], 1.0)
    covariance = covariance / (units[:, :, None] * units[:, None, :])
    middle = natural[:, 1:]
    if density.kind.noise:
        used = density.used
        level = density.noise_at(at.chi_square)
        middle = np.concatenate([middle, level[:, None]], axis=1)
        grown = np.zeros((len(places), size, size))
        # The other errors grow with the noise.
        grown[:, :-1, :-1] = covariance * np.exp(2 * level)[:, None, None]
        grown[:, -1, -1] = 1 / (2 * max(used - size + 1, 1))
        covariance = grown
    scale = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    scaled = covariance / (scale[:, :, None] * scale[:, None, :]) + 1e-12 * np.eye(middle.shape[1])
    root = scale[:, :, None] * np.linalg.cholesky(scaled)
    found = problem.evaluation(at, held)
    joined = Evaluation(*(np.concatenate(pair) for pair in zip(near, found, strict=True)))
    return _Rest(middle, root), joined
