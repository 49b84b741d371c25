"""Search over the whole allowed range: grids that know the kinks, distinct minima, brackets made small.

All refinement is by sections: a few points in every open bracket at once, so that one call of the compiled
model serves them all.
"""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from fitting.parameters import Parameter

ANGLE_STEP = np.radians(0.2)
LOG_STEP = 0.03
KINK_MARGIN = np.radians(0.02)
PROMINENCE = 0.1
"""Rounding makes false minima on plateaus; a distinct one stands out by this much in chi-square."""

_PLAIN_POINTS = 201
# In a product of two or of three axes: steps of an angle and of a logarithm, points of any other.
_PRODUCT_STEPS = {2: (np.radians(1.0), 0.1, 21), 3: (np.radians(2.0), 0.3, 9)}

Cost = Callable[[np.ndarray], np.ndarray]


def axis(parameter: Parameter, kinks: Float[np.ndarray, " k"], coarseness: int = 1) -> Float[np.ndarray, " n"]:
    """Grid over a parameter's allowed range, in its own unit; both bounds are points of it.

    Args:
        parameter: what is searched.
        kinks: values at which the model is not smooth. They and points 0.02 degrees beside them are added: a
            minimum may lie in a cusp narrower than the step.
        coarseness: so many times wider a step, and above 1 no points beside the kinks, where a point is costly
            because much else is unknown.
    """
    low, high = (float(parameter.natural(bound)) for bound in (parameter.lower, parameter.upper))
    step = ANGLE_STEP if parameter.unit == "rad" else LOG_STEP
    if parameter.unit != "rad" and parameter.scale == "linear":
        step = (high - low) / (_PLAIN_POINTS - 1)
    step = coarseness * step
    even = np.linspace(low, high, int(np.ceil((high - low) / step - 1e-9)) + 1)
    beside = kinks
    if len(kinks) and coarseness == 1:
        beside = np.concatenate([kinks - KINK_MARGIN, kinks, kinks + KINK_MARGIN])
    points = np.sort(np.concatenate([even, beside[(beside > low) & (beside < high)]]))
    distinct = np.diff(points, prepend=-np.inf) > 1e-10 * (high - low)
    return np.asarray(parameter.from_natural(points[distinct]), dtype=np.float64)


def separation(parameter: Parameter, values: Float[np.ndarray, " n"]) -> float:
    """In the natural coordinate, how far apart two minima of a table must be at least."""
    if parameter.unit == "rad":
        return float(ANGLE_STEP)
    return LOG_STEP if parameter.scale == "log" else float(values[-1] - values[0]) / (_PLAIN_POINTS - 1)


def product_axes(parameters: Sequence[Parameter]) -> list[Float[np.ndarray, " n"]]:
    """Coarser axes for two or three parameters, whose product is searched."""
    angle, logarithmic, plain = _PRODUCT_STEPS[len(parameters)]
    axes = []
    for p in parameters:
        low, high = (float(p.natural(bound)) for bound in (p.lower, p.upper))
        step = angle if p.unit == "rad" else logarithmic if p.scale == "log" else (high - low) / (plain - 1)
        count = max(int(np.ceil((high - low) / step - 1e-9)) + 1, plain)
        axes.append(np.asarray(p.from_natural(np.linspace(low, high, count)), dtype=np.float64))
    return axes


def prominences(cost: Float[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray]:
    """Local minima of a table and how deep each is.

    Args:
        cost: values along a path; the ends count as minima if they lie lower than their neighbor.

    Returns:
        Indices of the minima in ascending order, and by how much one has to climb from each to reach a lower
        point (infinite for the lowest).
    """
    # On a plateau the first point stands for all.
    before = np.concatenate([[np.inf], cost[:-1]])
    after = np.concatenate([cost[1:], [np.inf]])
    found = np.flatnonzero((cost < before) & (cost <= after))
    depth = np.empty(len(found))
    lowest = found[np.argmin(cost[found])] if len(found) else -1
    for slot, index in enumerate(found):
        climbs = []
        for side in (cost[:index][::-1], cost[index + 1 :]):
            lower = np.flatnonzero(side < cost[index])
            if len(lower):
                climbs.append(np.max(side[: lower[0] + 1]) - cost[index])
        depth[slot] = np.inf if index == lowest or not climbs else min(climbs)
    return found, depth


def distinct_minima(cost: Float[np.ndarray, " n"], most: int) -> Int[np.ndarray, " m"]:
    """Indices of the lowest distinct local minima of a table, best first."""
    found, depth = prominences(cost)
    found = found[depth >= PROMINENCE]
    return found[np.argsort(cost[found], kind="stable")][:most]


def product_minima(cost: Float[np.ndarray, "..."], most: int) -> list[tuple[int, ...]]:
    """The lowest local minima of a table with several axes, best first; diagonal neighbors count too."""
    padded = np.pad(cost, 1, constant_values=np.inf)
    lowest = np.ones(cost.shape, dtype=bool)
    for shift in np.ndindex(*(3,) * cost.ndim):
        window = tuple(slice(s, s + n) for s, n in zip(shift, cost.shape, strict=True))
        lowest &= cost <= padded[window]
    places = np.argwhere(lowest & np.isfinite(cost))
    order = np.argsort(cost[tuple(places.T)], kind="stable")[:most]
    return [tuple(int(i) for i in places[k]) for k in order]


def section_minima(
    cost: Cost, brackets: Float[np.ndarray, "b 2"], width: float, points: int
) -> tuple[np.ndarray, np.ndarray]:
    """Minimize within brackets of one minimum each, all at once, without derivatives.

    Args:
        cost: of many points.
        brackets: ends of the brackets.
        width: stop when all brackets are narrower.
        points: how many points one call of ``cost`` may take.

    Returns:
        Places and costs, shape (b,) each.
    """
    brackets = np.array(brackets, dtype=np.float64)
    each = max(points // len(brackets), 3)
    best_place = brackets.mean(axis=1)
    best_cost = np.full(len(brackets), np.inf)
    rows = np.arange(len(brackets))
    for _ in range(60):
        mesh = np.linspace(brackets[:, 0], brackets[:, 1], each + 2, axis=1)
        inner = cost(mesh[:, 1:-1].ravel()).reshape(len(brackets), each)
        index = np.argmin(np.where(np.isnan(inner), np.inf, inner), axis=1)
        better = inner[rows, index] < best_cost
        best_cost = np.where(better, inner[rows, index], best_cost)
        best_place = np.where(better, mesh[rows, index + 1], best_place)
        brackets = np.stack([mesh[rows, index], mesh[rows, index + 2]], axis=1)
        if np.all(brackets[:, 1] - brackets[:, 0] <= width):
            break
    return best_place, best_cost


def section_roots(
    inside: Callable[[np.ndarray], Bool[np.ndarray, " n"]],
    brackets: Float[np.ndarray, "b 2"],
    width: float,
    points: int,
) -> Float[np.ndarray, " b"]:
    """Where a region ends, in all brackets at once.

    Args:
        inside: whether points belong to the region.
        brackets: in each row a point of the region, then a point outside it.
        width: how precisely the ends are wanted.
        points: how many points one call of ``inside`` may take.

    Returns:
        The middle of each final bracket.
    """
    brackets = np.array(brackets, dtype=np.float64)
    if not len(brackets):
        return np.empty(0)
    each = max(points // len(brackets), 1)
    rows = np.arange(len(brackets))
    for _ in range(60):
        if np.all(np.abs(brackets[:, 1] - brackets[:, 0]) <= width):
            break
        mesh = np.linspace(brackets[:, 0], brackets[:, 1], each + 2, axis=1)
        belongs = inside(mesh[:, 1:-1].ravel()).reshape(len(brackets), each)
        # The first point outside, seen from the inner end; the outer end itself if there is none.
        first = np.argmin(np.concatenate([belongs, np.zeros((len(brackets), 1), bool)], axis=1), axis=1)
        brackets = np.stack([mesh[rows, first], mesh[rows, first + 1]], axis=1)
    return brackets.mean(axis=1)
