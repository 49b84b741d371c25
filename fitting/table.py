"""A model along one axis as a verified table: cubics between grid points, for fits by the hundred thousand.

Chi-square of a spectrum within a cell, with gain and offset eliminated, is a rational function of one number: no
evaluation of the model is left. Every cell is checked against the model where a cubic errs most; in those that
miss the tolerance nothing is answered from the table.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from fitting.problem import Problem

_NODES = np.array([0.0, 0.25, 0.75, 1.0])
_WORST = 0.5
"""Between the nodes the error of a cubic is largest in the middle."""

_STEPS = 12
"""Eight found every minimum to 1e-12 of its standard error."""

_FLAT = 1e-12
"""What changes less within a cell does not change: rounding shall not tell where on a plateau a minimum lies."""


class Found(NamedTuple):
    """Minima within cells.

    Args:
        place: in the natural coordinate of the axis, shape (K,).
        linear: gain and offset as the problem orders them, shape (K, P - 1).
        chi_square: of data and priors, shape (K,).
        matrix: see ``arrow.End``, shape (K, B, P + 1, P + 1).
    """

    place: np.ndarray
    linear: np.ndarray
    chi_square: np.ndarray
    matrix: np.ndarray


@dataclass(frozen=True, eq=False)
class Table:
    """Cubics in every cell of an axis.

    Args:
        problem: whose model it is.
        edges: natural coordinates, increasing, shape (G,).
        cubics: coefficients of 1, t, t², t³ for t from 0 to 1 in a cell, shape (G - 1, 4, M).
        good: which cells keep the tolerance, shape (G - 1,).
    """

    problem: Problem
    edges: np.ndarray
    cubics: np.ndarray
    good: np.ndarray

    @classmethod
    def of(cls, problem: Problem, points: np.ndarray, factors: np.ndarray, tolerance: float) -> "Table":
        """From the model at the grid points, and at three more places in every cell.

        Args:
            problem: with one searched number and no prior of it.
            points: all numbers at the grid points, shape (G, P).
            factors: true reflectance factors there, shape (G, D, L).
            tolerance: of the reflectance factor between the grid points.
        """
        parameter = problem.searched[0]
        edges = np.asarray(parameter.natural(points[:, 0]), np.float64)
        widths = np.diff(edges)
        inside = []
        for t in (_NODES[1], _NODES[2], _WORST):
            between = points[:-1].copy()
            between[:, 0] = parameter.from_natural(edges[:-1] + t * widths)
            inside.append(between)
        found = problem.factors(np.concatenate(inside))[0].reshape(3, len(widths), -1)
        flat = factors.reshape(len(points), -1)
        values = np.stack([flat[:-1], found[0], found[1], flat[1:]], axis=1)
        cubics = np.einsum("ij,cjm->cim", np.linalg.inv(np.vander(_NODES, increasing=True)), values)
        cubics[np.abs(cubics[:, 1:]).max(axis=(1, 2)) < _FLAT, 1:] = 0.0
        middle = np.einsum("i,cim->cm", _WORST ** np.arange(4), cubics)
        error = np.abs(middle - found[2]).max(axis=1)
        return cls(problem, edges, cubics, np.isfinite(error) & (error <= tolerance))

    def minimize(self, cell: np.ndarray, values: np.ndarray, weights: np.ndarray) -> Found:
        """The least chi-square in some cells.

        Args:
            cell: shape (K,).
            values: measured, shape (K, M); 0 where missing.
            weights: one over the standard uncertainty, 0 where missing, shape (K, M).
        """
        sums = _Sums.of(self, cell, values, weights)
        ends = np.linspace(0.0, 1.0, 5)
        best = np.argmin(np.stack([sums.chi_square(np.full(len(cell), t))[0] for t in ends]), axis=0)
        t = sums.stationary(ends[np.maximum(best - 1, 0)], ends[np.minimum(best + 1, 4)])
        chi_square, gain, offset = sums.chi_square(t)
        step = self.edges[cell + 1] - self.edges[cell]
        linear = np.empty((len(cell), len(sums.roles)))
        for k, role in enumerate(sums.roles):
            linear[:, k] = {"gain": gain, "offset": offset}[role]
        matrix = np.zeros((len(cell), self.problem.layout.blocks, len(sums.roles) + 2, len(sums.roles) + 2))
        matrix[:, 0] = sums.matrix(t, step, gain, offset)
        return Found(self.edges[cell] + t * step, linear, chi_square, matrix)


class _Sums(NamedTuple):
    """Weighted sums of a cell as polynomials: all that chi-square needs."""

    products: np.ndarray
    square: np.ndarray
    plain: np.ndarray
    crossed: np.ndarray
    constants: tuple[np.ndarray, np.ndarray, np.ndarray]
    roles: tuple[str, ...]
    priors: dict[str, tuple[float, float]]

    @classmethod
    def of(cls, table: Table, cell: np.ndarray, values: np.ndarray, weights: np.ndarray) -> "_Sums":
        problem, w2 = table.problem, weights**2
        weighted = w2 * values
        cubics = table.cubics[cell]
        crossed = np.matmul(cubics, weighted[:, :, None])[:, :, 0]
        # What does not depend on the values is alike for all spectra of a cell that lack nothing.
        fullest = w2[np.argmax((w2 > 0).sum(axis=1))] if len(w2) else np.zeros(cubics.shape[2])
        plain, products = (a[cell] for a in _moments(table.cubics, fullest))
        other = np.flatnonzero((w2 != fullest).any(axis=1))
        plain[other], products[other] = _moments(cubics[other], w2[other])
        square = np.stack([np.trace(products[:, ::-1], n - 3, 1, 2) for n in range(7)], axis=1)
        constants = (weighted * values).sum(axis=1), weighted.sum(axis=1), w2.sum(axis=1)
        tight, center = (np.asarray(a, np.float64) for a in (problem.data.tightness, problem.data.center))
        roles: dict[str, int] = {problem.numbers[i].role: i for i in problem.linear}
        priors = {role: (float(tight[i] ** 2), float(center[i])) for role, i in roles.items()}
        return cls(products, square, plain, crossed, constants, tuple(roles), priors)

    def stationary(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Where chi-square ceases to fall; an end of the cell if it does not."""
        below, above = self.slope(low), self.slope(high)
        first, last = (low == 0) & (below > 0), (high == 1) & (above <= 0)
        t, rose = 0.5 * (low + high), np.zeros(len(low), int)
        for _ in range(_STEPS):
            change = above - below
            secant = low - below * (high - low) / np.where(change > 0, change, 1.0)
            inside = (change > 0) & (secant >= low) & (secant <= high)
            t = np.where(inside, secant, 0.5 * (low + high))
            slope = self.slope(t)
            rises = slope > 0
            # An end that stays twice counts half [Dowell1971].
            below = np.where(rises, np.where(rose > 0, 0.5 * below, below), slope)
            above = np.where(rises, slope, np.where(rose < 0, 0.5 * above, above))
            low, high = np.where(rises, low, t), np.where(rises, t, high)
            rose = np.where(rises, 1, -1)
        return np.where(first, 0.0, np.where(last, 1.0, t))

    def matrix(self, t: np.ndarray, step: np.ndarray, gain: np.ndarray, offset: np.ndarray) -> np.ndarray:
        """Products of the columns of the Jacobian and of the residual."""
        power = np.arange(4)
        factor = t[:, None] ** power
        slope = power * t[:, None] ** np.maximum(power - 1, 0) / step[:, None]
        hh, h1, one = self.constants
        rr, rs, ss = (
            np.einsum("ki,kij,kj->k", a, self.products, b)
            for a, b in ((factor, factor), (factor, slope), (slope, slope))
        )
        r1, rh = ((sums * factor).sum(axis=1) for sums in (self.plain, self.crossed))
        s1, sh = ((sums * slope).sum(axis=1) for sums in (self.plain, self.crossed))
        rows = [(rr, rs, r1, rh), (rs, ss, s1, sh), (r1, s1, one, h1), (rh, sh, h1, hh)]
        products = np.stack([np.stack(row, axis=1) for row in rows], axis=1)
        # All columns are sums of the model, its slope, one and the measured values.
        none, unit = np.zeros_like(t), np.ones_like(t)
        parts = {
            "searched": (none, gain, none, none),
            "gain": (unit, none, none, none),
            "offset": (none, none, unit, none),
            "residual": (gain, none, offset, -unit),
        }
        columns = np.stack(
            [np.stack(parts[name], axis=1) for name in ("searched", *self.roles, "residual")], axis=1
        )
        return np.asarray(columns @ products @ np.swapaxes(columns, 1, 2))

    def chi_square(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """With gain and offset at their best, and these."""
        rr, r1, rh = (_value(p, t) for p in (self.square, self.plain, self.crossed))
        hh, h1, one = self.constants
        gain, offset = self._best(rr, r1, rh)
        cost = hh + gain**2 * rr + offset**2 * one + 2 * (gain * offset * r1 - gain * rh - offset * h1)
        for role, best in (("gain", gain), ("offset", offset)):
            if role in self.priors:
                tight, center = self.priors[role]
                cost = cost + tight * (best - center) ** 2
        return cost, gain, offset

    def slope(self, t: np.ndarray) -> np.ndarray:
        """Half the derivative of that: gain and offset are at their best, so that theirs vanish."""
        rr, r1, rh = (_value(p, t) for p in (self.square, self.plain, self.crossed))
        gain, offset = self._best(rr, r1, rh)
        drr, dr1, drh = (_slope(p, t) for p in (self.square, self.plain, self.crossed))
        return np.asarray(gain * (0.5 * gain * drr + offset * dr1 - drh))

    def _best(self, rr: np.ndarray, r1: np.ndarray, rh: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        _, h1, one = self.constants
        tg, cg = self.priors.get("gain", (0.0, 0.0))
        to, co = self.priors.get("offset", (0.0, 0.0))
        a, c, p, q = rr + tg, one + to, rh + tg * cg, h1 + to * co
        if "offset" not in self.roles:
            gain = p / np.where(a > 0, a, 1.0) if "gain" in self.roles else np.ones_like(rr)
            return gain, np.zeros_like(rr)
        if "gain" not in self.roles:
            return np.ones_like(rr), (q - r1) / c
        determinant = a * c - r1 * r1
        flat = determinant <= 1e-12 * a * c
        safe = np.where(flat, 1.0, determinant)
        usable = np.where(a > 0, a, 1.0)
        return np.where(flat, p / usable, (p * c - q * r1) / safe), np.where(flat, 0.0, (q * a - p * r1) / safe)


def _moments(cubics: np.ndarray, w2: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weighted sums of the coefficients over all values, and of their products."""
    weighted = cubics * w2[..., None, :]
    return weighted.sum(axis=-1), np.matmul(weighted, np.swapaxes(cubics, -1, -2))


def _value(polynomial: np.ndarray, t: np.ndarray) -> np.ndarray:
    total: Any = polynomial[:, -1]
    for k in range(polynomial.shape[1] - 2, -1, -1):
        total = total * t + polynomial[:, k]
    return np.asarray(total)


def _slope(polynomial: np.ndarray, t: np.ndarray) -> np.ndarray:
    return _value(polynomial[:, 1:] * np.arange(1, polynomial.shape[1]), t)
