"""What measurements that are not made yet would tell: expected information of each candidate view.

The information of independent values adds up, and so does that of views: each candidate has its products of the
Jacobian with itself, block by block as in ``arrow``, and those of a set of views are their sum.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from fitting.arrow import derivatives
from fitting.information import SINGULAR, Normal
from fitting.layout import Data, Layout
from fitting.parameters import Parameter
from fitting.problem import Problem

_LEAK = 1e-7
"""Share of a direction of the unknowns that may lie in what the data do not determine: rounding."""

_FEW = 2_000_000
"""Numbers that are worked on at once."""


class Goal(NamedTuple):
    """What makes one set of views better than another.

    Args:
        numbers: places of the numbers that matter.
        spectra: places of the free spectra that matter.
        criterion: "A", the sum of the variances, each relative to the width of its allowed range; or "D", the
            determinant of their covariance, likewise scaled.
        mean: over the values of what is searched; False for the worst of them.
    """

    numbers: tuple[int, ...]
    spectra: tuple[int, ...]
    criterion: str
    mean: bool


@dataclass(frozen=True, eq=False)
class Expected:
    """Expected information at K values of the unknowns, of what is measured and of each of C candidates.

    Args:
        problem: holds what is measured and all candidates.
        values: of the P numbers, in the scene's units, shape (K, P).
        measured: products of what is measured, with the priors of free spectra, shape (K, B, m, m), see
            ``arrow.End``; the column of the residual is zero.
        candidates: those of each candidate, shape (K, C, B, m, m).
    """

    problem: Problem
    values: np.ndarray
    measured: np.ndarray
    candidates: np.ndarray

    def of(self, chosen: Int[np.ndarray, " n"]) -> Float[np.ndarray, "k b m m"]:
        """Products of what is measured and some candidates."""
        return self.measured + self.candidates[:, chosen].sum(axis=1)

    @property
    def widths(self) -> tuple[np.ndarray, np.ndarray]:
        """Widths of the allowed ranges, in natural coordinates: of the numbers, (P,), of the spectra, (Q,)."""
        low, high = np.asarray(self.problem.data.spectral_bounds, np.float64)
        return np.array([_width(p) for p in self.problem.numbers]), high - low

    def errors(self, matrix: Float[np.ndarray, "k b m m"]) -> tuple[np.ndarray, np.ndarray]:
        """Standard errors, infinite where something is not identifiable.

        It is not if the others, together, can stand for it: then it lies in the null space of the scaled
        Jacobian. Nor is it if its error exceeds half of its allowed range.

        Returns:
            Of the numbers, in the scene's units, shape (K, P), and of the spectra, shape (K, Q, U).
        """
        normal = self.problem.normal_of(self.values, matrix)
        _, spectral_width = self.widths
        count = len(self.problem.numbers)
        numbers = np.sqrt(
            _determined_variance(normal, np.broadcast_to(np.eye(count), (len(matrix), count, count)))
        )
        limits = np.array([_half_range(p) for p in self.problem.numbers])
        numbers = np.where(numbers / self.problem.units(self.values) > limits, np.inf, numbers)
        if not self.problem.layout.free_spectra:
            return numbers, np.zeros((len(matrix), 0, matrix.shape[1]))
        rows = normal.response
        flat = rows.reshape(len(matrix), rows.shape[1] * rows.shape[2], count)
        shared = _determined_variance(normal, flat).reshape(rows.shape[:-1])
        own = np.diagonal(normal.alone, axis1=2, axis2=3)
        spectra = np.sqrt(np.where(normal.determined[..., None], own + shared, np.inf)).transpose(0, 2, 1)
        return numbers, np.where(spectra > spectral_width[:, None] / 2, np.inf, spectra)

    def form_errors(self, matrix: Float[np.ndarray, "k b m m"]) -> dict[str, np.ndarray]:
        """Standard errors of the spectra that have a form, by name, shape (K, U) each; likewise infinite."""
        layout, found = self.problem.layout, dict[str, np.ndarray]()
        normal = self.problem.normal_of(self.values, matrix)
        span = float(layout.wavelengths_nm[0]), float(layout.wavelengths_nm[-1])
        formed = [p for p in self.problem.spectral if p.form is not None]
        for parameter, use in zip(formed, layout.forms, strict=True):
            numbers = list(use.numbers)

            def spectrum(values: Any, form: Any = use.form) -> Any:
                return form.spectrum(layout.wavelengths_nm, span, values)

            count = len(parameter.quantities) * len(layout.wavelengths_nm)
            rows = np.zeros((len(matrix), count, self.values.shape[1]))
            slope = jax.jacfwd(spectrum)
            for k, values in enumerate(self.values[:, numbers]):
                rows[k][:, numbers] = np.asarray(slope(jnp.asarray(values))).reshape(count, -1)
            errors = np.sqrt(_determined_variance(normal, rows)).reshape(
                len(matrix), len(parameter.quantities), -1
            )
            suffix = parameter.name[parameter.name.index("[") :] if "[" in parameter.name else ""
            for row, quantity in enumerate(parameter.quantities):
                found[quantity + suffix] = errors[:, row]
        return found

    def key(self, sets: Int[np.ndarray, "n s"], goal: Goal) -> Float[np.ndarray, "n 2"]:
        """What orders sets of candidates: first how much is not identifiable, then the criterion; least is best.

        The criterion is regularized, so that it exists for any set: every unknown has, beside its own prior, a
        normal one as wide as its allowed range. Whatever the views do not determine keeps that width, and so
        outweighs what they do.

        Returns:
            The count of what is not identifiable, where what matters counts a thousandfold, summed over the K
            values; and the logarithm of the criterion.
        """
        size = int(np.prod(self.measured.shape)) * max(1, sets.shape[1])
        step = max(1, _FEW // size)
        parts = [self._key(sets[i : i + step], goal) for i in range(0, len(sets), step)]
        return np.concatenate(parts)

    def _key(self, sets: np.ndarray, goal: Goal) -> np.ndarray:
        found = []
        for k in range(len(self.values)):
            one = Expected(
                self.problem, np.repeat(self.values[k : k + 1], len(sets), axis=0), self.measured, self.candidates
            )
            matrix = self.measured[k] + self.candidates[k][sets].sum(axis=1)
            numbers, spectra = one.errors(matrix)
            lost, lost_spectra = np.isinf(numbers), np.isinf(spectra).mean(axis=2)
            deficit = lost.sum(axis=1) + lost_spectra.sum(axis=1)
            matters = lost[:, goal.numbers].sum(axis=1) + lost_spectra[:, goal.spectra].sum(axis=1)
            found.append((deficit + 1000 * matters, one.criterion(matrix, goal)))
        deficits, criteria = (np.stack(column) for column in zip(*found, strict=True))
        return np.stack([deficits.sum(axis=0), over_values(criteria, goal)], axis=1)

    def criterion(self, matrix: Float[np.ndarray, "k b m m"], goal: Goal) -> Float[np.ndarray, " k"]:
        """Logarithm of the regularized criterion."""
        width, spectral_width = self.widths
        numbers = len(width)
        ridge = np.zeros(matrix.shape[1:])
        ridge[0, np.arange(numbers), np.arange(numbers)] = 1 / width**2
        for q, own in enumerate(spectral_width):
            ridge[:, numbers + q, numbers + q] = 1 / own**2
        normal = self.problem.normal_of(self.values, matrix + ridge)
        # Scaled by its own diagonal: positive by the ridge, whatever the units.
        root = np.sqrt(np.diagonal(normal.reduced, axis1=1, axis2=2))
        inverse = np.linalg.inv(normal.reduced / (root[:, :, None] * root[:, None, :]))
        covariance = inverse / (root[:, :, None] * root[:, None, :])
        scale = width * self.problem.units(self.values)
        picked = np.array(goal.numbers, int)
        own_part = covariance[:, picked[:, None], picked] / (scale[:, picked, None] * scale[:, None, picked])
        if goal.criterion == "A":
            total = np.trace(own_part, axis1=1, axis2=2)
            if goal.spectra:
                variance = normal.spectral_variance(covariance)[:, goal.spectra]
                total = total + (variance.mean(axis=2) / spectral_width[np.array(goal.spectra)] ** 2).sum(axis=1)
            return np.asarray(np.log(total))
        if goal.spectra:
            own_part = self._joint(normal, covariance, scale, spectral_width, goal)
        return np.asarray(np.linalg.slogdet(own_part)[1])

    def _joint(
        self, normal: Normal, covariance: np.ndarray, scale: np.ndarray, spectral_width: np.ndarray, goal: Goal
    ) -> np.ndarray:
        """Scaled covariance of the numbers and the spectra that matter."""
        count, blocks = normal.response.shape[:2]
        chosen = np.array(goal.spectra)
        width = spectral_width[chosen]
        response = -(normal.response[:, :, chosen] / width[:, None])
        response = response.reshape(count, blocks * len(chosen), covariance.shape[-1])
        own = normal.alone[:, :, chosen[:, None], chosen] / (width[:, None] * width)
        whole = np.zeros((count, blocks, len(chosen), blocks, len(chosen)))
        each = np.arange(blocks)
        whole[:, each, :, each, :] = own.transpose(1, 0, 2, 3)
        select = np.eye(covariance.shape[-1])[list(goal.numbers)][None] / scale[:, None, :]
        rows = np.concatenate([select, response], axis=1)
        joint = rows @ covariance @ rows.transpose(0, 2, 1)
        size = blocks * len(chosen)
        joint[:, -size:, -size:] += whole.reshape(count, size, size)
        return np.asarray(joint)


def expect(
    problem: Problem,
    values: Float[np.ndarray, "k p"],
    spectra: Float[np.ndarray, "q u"],
    candidates: Sequence[tuple[int, int]],
) -> Expected:
    """Expected information at values of the numbers and spectra.

    Args:
        problem: holds what is measured and all candidates.
        values: of the numbers, in the scene's units.
        spectra: of the free spectra.
        candidates: measurement and direction of each.

    Raises:
        ValueError: the model gives no number for a candidate.
    """
    layout, data = problem.layout, problem.data
    dtype = data.center.dtype
    width = values.shape[1] + layout.free_spectra
    own = jnp.asarray(spectra, dtype)
    point = jax.ShapeDtypeStruct((values.shape[1],), dtype)
    program = problem.programs.once("rows", functools.partial(_rows, problem.programs.layout), point, own, data)
    offered = {part for part, _ in candidates}
    measured, each = [], []
    for natural in problem.natural(values):
        parts = program(jnp.asarray(natural, dtype), own, data)
        found = [_products(layout, i, np.asarray(rows, np.float64), width) for i, rows in enumerate(parts)]
        base = np.zeros(found[0].shape[1:])
        for i, products in enumerate(found):
            if i not in offered:
                base += products.sum(axis=0)
        for q, tight in enumerate(np.asarray(data.spectral_tightness, np.float64)):
            base[:, values.shape[1] + q, values.shape[1] + q] += tight**2
        measured.append(base)
        each.append(np.stack([found[part][row] for part, row in candidates]))
    whole = np.stack(each)
    bad = ~np.isfinite(whole).all(axis=(0, 2, 3, 4))
    if bad.any():
        part, row = candidates[int(np.argmax(bad))]
        polar, azimuth = (
            np.degrees(a[row]) for a in (problem.measurements[part].polar, problem.measurements[part].azimuth)
        )
        raise ValueError(
            f"candidates: the model has no slope at polar {polar:g}, azimuth {azimuth:g} degrees; expected "
            "directions and parameters at which it is smooth"
        )
    return Expected(problem, values, np.stack(measured), whole)


def _rows(layout: Layout, natural: Array, spectra: Array, data: Data) -> tuple[Array, ...]:
    """Weighted Jacobian of each measurement, shape (D, L, P + Q)."""
    found = []
    values = layout.values(natural)
    for part, weights, mean, known in zip(layout.parts, data.weights, data.means, data.known, strict=True):
        roles = dict(part.roles)
        if "stray_light" in roles:
            # Nothing is measured yet: the mean of the recorded spectrum is the model's own.
            factor = layout.factor(part, *layout.inputs(part, natural, spectra), known)
            clean = layout.recorded(part, factor, natural, jnp.zeros_like(mean))
            mean = jnp.mean(clean, axis=1) / (1 - values[roles["stray_light"]])
        _, columns = derivatives(layout, part, natural, spectra, known, mean)
        found.append(columns * weights[..., None])
    return tuple(found)


def _products(layout: Layout, index: int, rows: np.ndarray, width: int) -> np.ndarray:
    """Products of the Jacobian with itself for each direction, shape (D, B, m, m)."""
    products = np.zeros((len(rows), layout.blocks, width + 1, width + 1))
    each = np.einsum("dwi,dwj->dwij", rows, rows)
    if layout.free_spectra:
        products[:, layout.parts[index].places, :-1, :-1] = each
    else:
        products[:, 0, :-1, :-1] = each.sum(axis=1)
    return products


def _determined_variance(normal: Normal, rows: Float[np.ndarray, "n f p"]) -> Float[np.ndarray, "n f"]:
    """Variances of linear functions of the numbers, infinite where the data do not determine them.

    No pseudo-inverse: a function with any share in the null space of the scaled Jacobian has no variance.
    """
    lengths = np.where(normal.lengths > 0, normal.lengths, 1.0)
    square = normal.reduced / (lengths[:, :, None] * lengths[:, None, :])
    values, vectors = np.linalg.eigh(square)
    parts = ((rows / lengths[:, None, :]) @ vectors) ** 2
    null = (values <= SINGULAR**2)[:, None, :]
    lost = np.where(null, parts, 0.0).sum(axis=2) > _LEAK**2 * parts.sum(axis=2)
    variance = np.where(null, 0.0, parts / np.where(null, 1.0, values[:, None, :])).sum(axis=2)
    return np.where(lost, np.inf, variance)


def over_values(logarithms: Float[np.ndarray, "k n"], goal: Goal) -> Float[np.ndarray, " n"]:
    """The worst of several criteria, or the logarithm of their mean (for "D" the mean logarithm)."""
    if not goal.mean:
        return np.asarray(logarithms.max(axis=0))
    if goal.criterion == "D":
        return np.asarray(logarithms.mean(axis=0))
    return np.asarray(np.logaddexp.reduce(logarithms, axis=0) - np.log(len(logarithms)))


def _width(parameter: Parameter) -> float:
    """Width of what is allowed in the natural coordinate; of the prior, or 1, where anything is."""
    width = float(parameter.natural(parameter.upper) - parameter.natural(parameter.lower))
    if np.isfinite(width):
        return width
    return 1.0 if parameter.gaussian is None else float(parameter.gaussian[1])


def _half_range(parameter: Parameter) -> float:
    width = float(parameter.natural(parameter.upper) - parameter.natural(parameter.lower))
    return width / 2 if np.isfinite(width) else np.inf
