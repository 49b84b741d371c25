"""Confidence intervals by profile likelihood: where chi-square, minimized over the rest, stays low.

They hold at kinks and near the edge of identifiability, where standard errors do not, and may fall into
several pieces.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fitting.problem import INNER_STEPS, Descent, Evaluation, Problem
from fitting.programs import CHUNK
from fitting.search import section_roots

Pieces = list[tuple[float, float]]

_PRECISION = 1e-4
_AXIS_POINTS = 41
_PROFILE_STEPS = 60
_MATTERS = 30.0
_GAP = 1e-5
"""Pieces nearer to each other than this share of their width are one: rounding at a kink parts them."""


class Profile:
    """Chi-square against one number, minimized over all other unknowns, at ever more points.

    Args:
        problem: what is fitted.
        slot: which number.
        table: of the search. If this number alone is searched it is the profile; else it has starts for it.
        minima: that were found, points of the profile.
    """

    def __init__(self, problem: Problem, slot: int, table: Evaluation, minima: Descent) -> None:
        self._problem, self._slot = problem, slot
        self._only_one = slot == 0 and len(problem.searched) == 1
        self._tabular = self._only_one and problem.tabular
        self.points = table if self._only_one else table.take(slice(0))
        if problem.numbers[slot].searched and not self._only_one:
            self._add(self._minimized(self._starting_values(table), table))
        self._add(problem.evaluation(minima, np.arange(len(problem.numbers)) == slot))

    def _starting_values(self, known: Evaluation) -> np.ndarray:
        values = np.unique(known.values[:, self._slot])
        stride = max(1, int(np.ceil(len(values) / _AXIS_POINTS)))
        return np.unique(np.append(values[::stride], values[-1]))

    @property
    def values(self) -> Float[np.ndarray, " n"]:
        """The number, ascending, in its own unit."""
        return self.points.values[:, self._slot]

    def cost(self, values: np.ndarray) -> Float[np.ndarray, " n"]:
        """Profile chi-square at some values; the points are kept."""
        values = np.asarray(values, dtype=np.float64)
        found = self._problem.evaluate(values[:, None]) if self._tabular else self._minimized(values, self.points)
        self._add(found)
        return found.chi_square

    def _minimized(self, values: np.ndarray, starts: Evaluation) -> Evaluation:
        """Minimize over all other unknowns, from the best start at the nearest value of this one."""
        own = starts.values[:, self._slot]
        usable = np.isfinite(starts.chi_square)
        chosen = []
        for value in values:
            apart = np.where(usable, np.abs(own - value), np.inf)
            near = np.flatnonzero(apart <= np.min(apart) * (1 + 1e-9))
            chosen.append(near[np.argmin(starts.chi_square[near])])
        points = starts.values[chosen].copy()
        points[:, self._slot] = values
        movable = np.ones(points.shape, dtype=bool)
        movable[:, self._slot] = False
        at = self._problem.descend(
            points, starts.spectra[chosen], movable, inner=INNER_STEPS, outer=_PROFILE_STEPS
        )
        return self._problem.evaluation(at, ~movable[0])

    def settle(self, minimum: float) -> None:
        """Minimize to the end at the points that matter: the search stops short of that where much is unknown."""
        if self._only_one and not self._tabular:
            near = self.points.chi_square - minimum < _MATTERS
            self.cost(self.values[near])

    def _add(self, found: Evaluation) -> None:
        """Put points in, in order; of several at one value the lowest counts."""
        whole = Evaluation(*(np.concatenate(pair) for pair in zip(self.points, found, strict=True)))
        best = np.lexsort((whole.chi_square, whole.values[:, self._slot]))
        own = whole.values[best, self._slot]
        self.points = whole.take(best[np.append(True, own[1:] != own[:-1])])

    def refine_around(self, place: float, left: float, right: float) -> None:
        """Add points beside a minimum, spaced by its standard errors on either side."""
        parameter = self._problem.numbers[self._slot]
        shares = np.arange(1, 17) / 4 if self._tabular else np.array([0.35, 0.7, 1, 1.4, 1.8, 2.2, 2.7])
        sides = [place - shares * left, place + shares * right]
        wanted = np.concatenate([side for side in sides if np.isfinite(side).all()] or [np.empty(0)])
        wanted = wanted[(wanted > parameter.lower) & (wanted < parameter.upper)]
        if len(wanted):
            self.cost(wanted)

    def reach_out(self, best: float, error: float, minimum: float, threshold: float) -> None:
        """Add points beside the best value, in steps of its standard error, until the threshold or a bound."""
        parameter = self._problem.numbers[self._slot]
        low, high = float(parameter.lower), float(parameter.upper)
        for sign in (-1, 1):
            for share in (0.7, 1.4, 2.1, 2.8, 4.2, 6.4, 9.6, 14.4, 21.6):
                value = float(np.clip(best + sign * share * error, low, high))
                if value == best or not self.cost(np.array([value]))[0] - minimum < threshold:
                    break
                if value in (low, high):
                    break

    def region(self, minimum: float, threshold: float) -> tuple[Pieces, bool]:
        """Where chi-square exceeds its minimum by less than a threshold.

        Returns:
            The pieces, ascending, and whether all their ends lie inside the allowed range.
        """
        problem_points = CHUNK if self._tabular else self._problem.lanes

        def inside(values: np.ndarray) -> np.ndarray:
            return self.cost(values) - minimum < threshold

        # Twice: the first ends only say how wide the pieces are.
        for precision in (30 * _PRECISION, _PRECISION):
            values, runs = self.values, _runs(self.points.chi_square - minimum < threshold)
            brackets, widths = [], []
            for first, last in runs:
                width = max(values[last] - values[first], 1e-9 * (values[-1] - values[0]))
                if first > 0:
                    brackets.append((values[first], values[first - 1]))
                    widths.append(width)
                if last < len(values) - 1:
                    brackets.append((values[last], values[last + 1]))
                    widths.append(width)
            if brackets:
                ends = np.array(brackets)
                span = np.abs(ends[:, 1] - ends[:, 0]).min()
                width = max(precision * min(widths), 1e-4 * span if precision > _PRECISION else 0.0)
                section_roots(inside, ends, width, problem_points)
        return pieces_within(self.values, self.points.chi_square - minimum, threshold)


def pieces_within(
    values: Float[np.ndarray, " n"], delta: Float[np.ndarray, " n"], threshold: float
) -> tuple[Pieces, bool]:
    """Where a table of values stays within a threshold.

    Returns:
        The pieces, ascending, and whether all their ends lie inside the table.
    """
    pieces: Pieces = []
    closed = True
    for first, last in _runs(delta < threshold):
        low, high = values[first], values[last]
        if first > 0:
            low = _crossing(values[first - 1 : first + 1][::-1], delta[first - 1 : first + 1][::-1], threshold)
        if last < len(values) - 1:
            high = _crossing(values[last : last + 2], delta[last : last + 2], threshold)
        closed = closed and first > 0 and last < len(values) - 1
        if pieces and low - pieces[-1][0] > 0 and low - pieces[-1][1] <= _GAP * (high - pieces[-1][0]):
            low = pieces.pop()[0]
        pieces.append((float(low), float(high)))
    return pieces, closed


def _runs(within: Bool[np.ndarray, " n"]) -> list[tuple[int, int]]:
    """First and last index of each stretch of points that are within."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], within, [False]]).astype(np.int8)))
    return [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _crossing(places: np.ndarray, delta: np.ndarray, threshold: float) -> float:
    """Where the straight line from a point within the threshold to one beyond reaches it."""
    rise = delta[1] - delta[0]
    share = (threshold - delta[0]) / rise if np.isfinite(rise) and rise > 0 else 0.0
    return float(places[0] + share * (places[1] - places[0]))


@dataclass(frozen=True)
class Envelope:
    """Interval and profile of a number that is not searched.

    Args:
        pieces: where chi-square stays within the threshold.
        values: of the number.
        chi_square: its profile there.
    """

    pieces: Pieces
    values: np.ndarray
    chi_square: np.ndarray


def envelope(
    points: Evaluation, number: int, minimum: float, threshold: float, bounds: tuple[float, float]
) -> Envelope:
    """Profile of a number from that of a searched one, if any, without another evaluation.

    At each value of the searched number chi-square is a parabola in this one; the profile is the lower envelope
    of these parabolas. They are exact for gain and offset if nothing else is free; the others follow by the
    slopes of the model.

    Args:
        points: along the profile of a searched number, ascending; a single one if there is none.
        number: which number.
        minimum: chi-square at the best fit.
        threshold: by which the interval's ends exceed it.
        bounds: of the number.
    """
    fine: tuple[np.ndarray, ...] = points.values[:, number], points.chi_square, points.variance[:, number]
    if len(points.chi_square) > 1:
        fine = _between(fine, 16)
    center, delta, variance = fine[0], fine[1] - minimum, fine[2]
    within = np.isfinite(delta) & (delta < threshold) & np.isfinite(variance)
    if not within.any() or not np.isfinite(points.variance[:, number]).any():
        return Envelope([bounds], np.empty(0), np.empty(0))
    room = np.where(within, threshold - delta, 0.0)
    reach = np.sqrt(np.where(within, variance, 0.0) * room)
    pieces: Pieces = []
    # A stretch of neighbors is connected, so is the image of it.
    runs = [slice(a, b + 1) for a, b in _runs(within)]
    spans = sorted((np.min((center - reach)[r]), np.max((center + reach)[r])) for r in runs)
    for low, high in spans:
        low, high = (float(np.clip(end, *bounds)) for end in (low, high))
        if pieces and low <= pieces[-1][1]:
            pieces[-1] = (pieces[-1][0], max(high, pieces[-1][1]))
        else:
            pieces.append((low, high))
    margin = 0.75 * (pieces[-1][1] - pieces[0][0])
    values = np.linspace(pieces[0][0] - margin, pieces[-1][1] + margin, 101)
    values = values[(values >= bounds[0]) & (values <= bounds[1])]
    near = np.isfinite(delta) & np.isfinite(variance) & (variance > 0) & (delta < 30 * threshold)
    if not near.any():
        return Envelope(pieces, np.empty(0), np.empty(0))
    cost = np.min(delta[near] + (values[:, None] - center[near]) ** 2 / variance[near], axis=1)
    return Envelope(pieces, values, minimum + cost)


def spectral_interval(
    points: Evaluation, minimum: float, threshold: float, bounds: Float[np.ndarray, "2 q"]
) -> tuple[Float[np.ndarray, "q u"], Float[np.ndarray, "q u"]]:
    """Lower and upper ends of the intervals of the free spectra, likewise; gaps within them are not shown."""
    delta = points.chi_square - minimum
    within = np.isfinite(delta) & (delta < threshold)
    bottom, top = (bound[:, None] for bound in bounds)
    if not within.any():
        shape = points.spectra.shape[1:]
        return np.broadcast_to(bottom, shape).copy(), np.broadcast_to(top, shape).copy()
    room = (threshold - delta[within])[:, None, None]
    with np.errstate(invalid="ignore"):
        reach = np.sqrt(points.spectral_variance[within] * room)
    reach = np.where(np.isnan(reach), np.inf, reach)
    low = np.min(points.spectra[within] - reach, axis=0)
    high = np.max(points.spectra[within] + reach, axis=0)
    return np.clip(low, bottom, top), np.clip(high, bottom, top)


def _between(parts: tuple[np.ndarray, ...], times: int) -> tuple[np.ndarray, ...]:
    """Columns filled in linearly between neighbors."""
    share = (np.arange(times) / times)[None, :]

    def fill(part: np.ndarray) -> np.ndarray:
        with np.errstate(invalid="ignore"):
            filled = part[:-1, None] + share * (part[1:] - part[:-1])[:, None]
        return np.append(filled.ravel(), part[-1])

    return tuple(fill(part) for part in parts)
