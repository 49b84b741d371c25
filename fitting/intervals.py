"""Confidence intervals by profile likelihood: where chi-square, minimized over the rest, stays low.

They hold at kinks and near the edge of identifiability, where standard errors do not, and may fall into
several pieces.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fitting.identifiability import local_information
from fitting.polish import Polished, lane_count, polish
from fitting.problem import Evaluation, Problem
from fitting.programs import CHUNK
from fitting.search import section_roots

Pieces = list[tuple[float, float]]

_PRECISION = 1e-4
_AXIS_POINTS = 41


class Profile:
    """Chi-square against one nonlinear parameter, minimized over the others, at ever more points.

    Args:
        problem: what is fitted.
        slot: which nonlinear parameter.
        known: points evaluated so far. For a single parameter these are the profile; else starts for it.
    """

    def __init__(self, problem: Problem, slot: int, known: Evaluation) -> None:
        self._problem, self._slot = problem, slot
        self.points = known
        if len(problem.nonlinear) > 1:
            self.points = Evaluation(*(part[:0] for part in known))
            self.cost(self._starting_values(known), known)

    def _starting_values(self, known: Evaluation) -> np.ndarray:
        values = np.unique(known.parameters[:, self._slot])
        stride = max(1, int(np.ceil(len(values) / _AXIS_POINTS)))
        return np.unique(np.append(values[::stride], values[-1]))

    @property
    def values(self) -> Float[np.ndarray, " n"]:
        """The parameter, ascending, in its own unit."""
        return self.points.parameters[:, self._slot]

    def cost(self, values: np.ndarray, starts: Evaluation | None = None) -> Float[np.ndarray, " n"]:
        """Profile chi-square at some values; the points are kept."""
        values = np.asarray(values, dtype=np.float64)
        if len(self._problem.nonlinear) == 1:
            found = self._problem.evaluate(values[:, None])
        else:
            found = self._minimized(values, self.points if starts is None else starts)
        self._add(found)
        return found.chi_square

    def _minimized(self, values: np.ndarray, starts: Evaluation) -> Evaluation:
        """Polish the other parameters, from the best point known at the nearest value of this one."""
        own = starts.parameters[:, self._slot]
        chosen = []
        for value in values:
            near = np.flatnonzero(np.abs(own - value) <= np.min(np.abs(own - value)) * (1 + 1e-9))
            chosen.append(near[np.argmin(starts.chi_square[near])])
        points = starts.parameters[chosen].copy()
        points[:, self._slot] = values
        movable = np.ones(points.shape, dtype=bool)
        movable[:, self._slot] = False
        return self._profiled(polish(self._problem, points, movable))

    def _profiled(self, end: Polished) -> Evaluation:
        """Points of this profile: the variances of gain and offset are those at a fixed value of it."""
        problem, variance = self._problem, end.variance.copy()
        if len(problem.nonlinear) > 1 and problem.linear:
            for k, gain in enumerate(end.linear[:, 0]):
                # The other parameters give way when the gain moves.
                jacobian = problem.jacobian(end.predicted[k], gain * end.slopes[k])
                errors = local_information(np.delete(jacobian, self._slot, axis=1)).standard_errors
                own = errors[-len(problem.linear) :] ** 2
                variance[k, problem.linear_slots] = np.where(np.isnan(own), np.inf, own)
        return Evaluation(end.parameters, end.chi_square, end.linear, variance)

    def add_minima(self, minima: Polished) -> None:
        """Put the minima that were found in."""
        self._add(self._profiled(minima))

    def _add(self, found: Evaluation) -> None:
        """Put points in, in order."""
        joined = Evaluation(*(np.concatenate(pair) for pair in zip(self.points, found, strict=True)))
        _, order = np.unique(joined.parameters[:, self._slot], return_index=True)
        if len(order) < len(joined.chi_square):
            # Of several points at one value the lowest counts.
            best = np.lexsort((joined.chi_square, joined.parameters[:, self._slot]))
            own = joined.parameters[best, self._slot]
            order = best[np.append(True, own[1:] != own[:-1])]
        self.points = Evaluation(*(part[order] for part in joined))

    def refine_around(self, place: float, left: float, right: float) -> None:
        """Add points beside a minimum, spaced by its standard errors on either side."""
        parameter = self._problem.nonlinear[self._slot]
        shares = np.arange(1, 17) / 4 if len(self._problem.nonlinear) == 1 else np.array([0.5, 1, 1.5, 2, 2.5])
        sides = [place - shares * left, place + shares * right]
        wanted = np.concatenate([side for side in sides if np.isfinite(side).all()] or [np.empty(0)])
        wanted = wanted[(wanted > parameter.lower) & (wanted < parameter.upper)]
        if len(wanted):
            self.cost(wanted)

    def region(self, minimum: float, threshold: float) -> tuple[Pieces, bool]:
        """Where chi-square exceeds its minimum by less than a threshold.

        Returns:
            The pieces, ascending, and whether all their ends lie inside the allowed range.
        """
        problem_points = CHUNK if len(self._problem.nonlinear) == 1 else lane_count(self._problem)

        def inside(values: np.ndarray) -> np.ndarray:
            return self.cost(values) - minimum < threshold

        # Twice: the first ends only say how wide the pieces are.
        for precision in (30 * _PRECISION, _PRECISION):
            values, runs = self.values, self._runs(minimum, threshold)
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
        values = self.values
        delta = self.points.chi_square - minimum
        pieces, closed = [], True
        for first, last in self._runs(minimum, threshold):
            low, high = values[first], values[last]
            if first > 0:
                low = _crossing(values[first - 1 : first + 1][::-1], delta[first - 1 : first + 1][::-1], threshold)
            if last < len(values) - 1:
                high = _crossing(values[last : last + 2], delta[last : last + 2], threshold)
            closed = closed and first > 0 and last < len(values) - 1
            pieces.append((float(low), float(high)))
        return pieces, closed

    def _runs(self, minimum: float, threshold: float) -> list[tuple[int, int]]:
        """First and last index of each stretch of points within the threshold."""
        within = np.concatenate([[False], self.points.chi_square - minimum < threshold, [False]])
        edges = np.flatnonzero(np.diff(within.astype(np.int8)))
        return [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _crossing(places: np.ndarray, delta: np.ndarray, threshold: float) -> float:
    """Where the straight line from a point within the threshold to one beyond reaches it."""
    rise = delta[1] - delta[0]
    share = (threshold - delta[0]) / rise if np.isfinite(rise) and rise > 0 else 0.0
    return float(places[0] + share * (places[1] - places[0]))


@dataclass(frozen=True)
class LinearProfile:
    """Interval and profile of gain or offset.

    Args:
        pieces: where chi-square stays within the threshold.
        values: of the parameter.
        chi_square: its profile there.
    """

    pieces: Pieces
    values: np.ndarray
    chi_square: np.ndarray


def linear_profile(points: Evaluation, column: int, minimum: float, threshold: float) -> LinearProfile:
    """Profile of gain or offset from that of a nonlinear parameter, if any, without another evaluation.

    At each value of the nonlinear parameter chi-square is a parabola in the gain; the profile is the lower
    envelope of these parabolas. They are exact for a single nonlinear parameter; with more, the others follow
    the gain by the slopes of the model.

    Args:
        points: along the profile of a nonlinear parameter, ascending; a single one if there is none.
        column: 0 for gain, 1 for offset.
        minimum: chi-square at the best fit.
        threshold: by which the interval's ends exceed it.
    """
    fine = _between(points, 16) if len(points.chi_square) > 1 else points
    delta, center = fine.chi_square - minimum, fine.linear[:, column]
    variance = fine.variance[:, column]
    within = np.isfinite(delta) & (delta < threshold) & np.isfinite(variance)
    if not within.any() or not np.isfinite(points.variance[:, column]).any():
        return LinearProfile([(-np.inf, np.inf)], np.empty(0), np.empty(0))
    reach = np.sqrt(variance * np.clip(threshold - delta, 0, None), where=within, out=np.zeros(len(delta)))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], within, [False]]).astype(np.int8)))
    pieces: Pieces = []
    # A stretch of neighbors is connected, so is the image of it.
    runs = [slice(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    spans = sorted((np.min((center - reach)[r]), np.max((center + reach)[r])) for r in runs)
    for low, high in spans:
        if pieces and low <= pieces[-1][1]:
            pieces[-1] = (pieces[-1][0], max(float(high), pieces[-1][1]))
        else:
            pieces.append((float(low), float(high)))
    margin = 0.75 * (pieces[-1][1] - pieces[0][0])
    values = np.linspace(pieces[0][0] - margin, pieces[-1][1] + margin, 101)
    near = np.isfinite(delta) & np.isfinite(variance) & (variance > 0) & (delta < 30 * threshold)
    cost = np.min(delta[near] + (values[:, None] - center[near]) ** 2 / variance[near], axis=1)
    return LinearProfile(pieces, values, minimum + cost)


def _between(points: Evaluation, times: int) -> Evaluation:
    """Points filled in linearly between neighbors."""
    share = (np.arange(times) / times)[:, None, None]

    def fill(part: np.ndarray) -> np.ndarray:
        flat = part.reshape(len(part), -1)
        with np.errstate(invalid="ignore"):
            filled = flat[:-1] + share * (flat[1:] - flat[:-1])
        joined = np.concatenate([filled.transpose(1, 0, 2).reshape(-1, flat.shape[1]), flat[-1:]])
        return joined.reshape(-1, *part.shape[1:])

    return Evaluation(*(fill(part) for part in points))
