"""A fit, ready to be evaluated: the layout of its unknowns, its numbers, and its compiled programs.

Where nothing but gain and offset is unknown beside what is searched, they are eliminated exactly; whatever else
is unknown is minimized over at each point of the search (variable projection).
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

import vcavity_jax as vc
from fitting.arrow import CONVERGED, End, Lane
from fitting.information import Normal, normal_equations
from fitting.layout import Data, FormUse, Layout
from fitting.measurement import Measurement
from fitting.parameters import Parameter, SpectralParameter
from fitting.programs import CHUNK, Programs

INNER_STEPS = 12
"""Steps of the spectra alone; a monotone one takes 3 to 6 from anywhere."""

BATCH_LANES = 32
"""Descents per call where each has measured values of its own."""

GRID_STEPS = 8
"""Steps of everything else at a point of the search."""


class Evaluation(NamedTuple):
    """Chi-square at n points, minimized over what is not held.

    Args:
        values: of the P numbers, in the scene's units, shape (n, P).
        spectra: free spectra, shape (n, Q, U).
        chi_square: shape (n,).
        variance: of the numbers for fixed held ones, shape (n, P); 0 for these, infinite where undetermined.
        spectral_variance: likewise, shape (n, Q, U).
    """

    values: np.ndarray
    spectra: np.ndarray
    chi_square: np.ndarray
    variance: np.ndarray
    spectral_variance: np.ndarray

    def take(self, index: Any) -> "Evaluation":
        """Some of the points."""
        return Evaluation(*(part[index] for part in self))


class Descent(NamedTuple):
    """Where n descents ended.

    Args:
        values: of the P numbers, in the scene's units, shape (n, P).
        spectra: shape (n, Q, U).
        chi_square: shape (n,).
        matrix: see ``arrow.End``, shape (n, B, m, m).
        status: see ``arrow.End``, shape (n,).
        steps: shape (n,).
        rejected: shape (n,).
        predicted: recorded values of each measurement, shape (n, D, L).
    """

    values: np.ndarray
    spectra: np.ndarray
    chi_square: np.ndarray
    matrix: np.ndarray
    status: np.ndarray
    steps: np.ndarray
    rejected: np.ndarray
    predicted: tuple[np.ndarray, ...]

    def take(self, index: Any) -> "Descent":
        """Some of them."""
        kept: list[Any] = [part[index] for part in self[:-1]]
        return Descent(*[*kept, tuple(p[index] for p in self.predicted)])

    @property
    def converged(self) -> np.ndarray:
        """Which ones did, shape (n,)."""
        return np.asarray((self.status == CONVERGED) & np.isfinite(self.chi_square))


def joined(descents: Sequence[Descent]) -> Descent:
    """Several lists of descents as one."""
    plain: list[Any] = [np.concatenate(parts) for parts in zip(*(d[:-1] for d in descents), strict=True)]
    predicted = zip(*(d.predicted for d in descents), strict=True)
    return Descent(*[*plain, tuple(np.concatenate(parts) for parts in predicted)])


@dataclass(frozen=True, eq=False)
class Problem:
    """A fit, ready to be evaluated.

    Args:
        given: the free parameters as they were given.
        labels: of the measurements.
        measurements: what is fitted, with the standard uncertainties that the fit uses.
        numbers: the P unknown numbers: those searched, then the others, gain and offset last.
        spectral: the unknown spectra, as given, with their names.
        free_names: names of the Q spectra that are free at each wavelength.
        layout: which unknown goes where.
        data: the numbers.
        programs: what is compiled.
        starts: of the free spectra, shape (S, Q, U).
        angles: which searched numbers are dihedral angles, and of which measurements.
    """

    given: tuple[Any, ...]
    labels: tuple[str, ...]
    measurements: tuple[Measurement, ...]
    numbers: tuple[Parameter, ...]
    spectral: tuple[SpectralParameter, ...]
    free_names: tuple[str, ...]
    layout: Layout
    data: Data
    programs: Programs
    starts: np.ndarray
    angles: dict[int, tuple[int, ...]]

    @property
    def searched(self) -> tuple[Parameter, ...]:
        """The numbers whose whole range is searched."""
        return tuple(p for p in self.numbers if p.searched)

    @property
    def formed(self) -> Iterator[tuple[FormUse, tuple[str, ...]]]:
        """The spectra with a form, and the names of their quantities."""
        uses = iter(self.layout.forms)
        for parameter in self.spectral:
            if parameter.form is not None:
                suffix = parameter.name[parameter.name.index("[") :] if "[" in parameter.name else ""
                yield next(uses), tuple(quantity + suffix for quantity in parameter.quantities)

    @property
    def linear(self) -> tuple[int, ...]:
        """Which numbers the recorded values depend on linearly: gain and offset."""
        return tuple(i for i, p in enumerate(self.numbers) if p.role in ("gain", "offset"))

    @property
    def tabular(self) -> bool:
        """Beside what is searched only gains and offsets are unknown, whose best values have a closed form."""
        others = self.numbers[len(self.searched) :]
        exact = all(p.role in ("gain", "offset") and p.unbounded and not p.prior_of_logarithm for p in others)
        return bool(self.searched) and exact and not self.layout.free_spectra

    @property
    def degrees_of_freedom(self) -> int:
        """Values and priors less unknowns."""
        return self.freedom([np.asarray(w) for w in self.data.weights])

    def freedom(self, weights: Sequence[np.ndarray]) -> int:
        """Degrees of freedom for other weights, one array of shape (D, L) for each measurement."""
        priors = [np.asarray(t) > 0 for t in (self.data.tightness, self.data.spectral_tightness)]
        return sum(int(np.sum(known)) for known in (*(w > 0 for w in weights), *priors)) - self.unknowns(weights)

    def unknowns(self, weights: Sequence[np.ndarray]) -> int:
        """Count of all unknowns that the values or a prior have a say in."""
        used: np.ndarray = np.all(np.asarray(self.data.spectral_tightness) > 0, axis=0)
        if self.layout.free_spectra:
            for part, w in zip(self.layout.parts, weights, strict=True):
                used[part.places] |= (w > 0).any(axis=0)
        return len(self.numbers) + self.layout.free_spectra * int(used.sum())

    @property
    def lanes(self) -> int:
        """Descents per call: idle ones cost as much as busy ones, so a smooth average over angles has few."""
        random = any(not isinstance(part.scene.surface, vc.VGrooves) for part in self.layout.parts)
        if self.tabular and len(self.searched) == 1:
            return 2 if random else 5
        return 4 if random else 8

    @property
    def start_values(self) -> np.ndarray:
        """The numbers' starts, the middle of the range for those searched; shape (P,)."""
        return np.array(
            [
                p.from_natural((p.natural(p.lower) + p.natural(p.upper)) / 2) if p.searched else p.start
                for p in self.numbers
            ],
            dtype=np.float64,
        ).reshape(len(self.numbers))

    def with_uncertainty_scaled(self, factor: float) -> "Problem":
        """The same problem with all standard uncertainties multiplied by a factor; priors stay."""
        scaled = []
        for m in self.measurements:
            assert m.standard_uncertainty is not None
            scaled.append(dataclasses.replace(m, standard_uncertainty=m.standard_uncertainty * factor))
        weights = tuple(w / jnp.asarray(factor, w.dtype) for w in self.data.weights)
        return dataclasses.replace(self, measurements=tuple(scaled), data=self.data._replace(weights=weights))

    def natural(self, values: Float[np.ndarray, "n p"]) -> Float[np.ndarray, "n p"]:
        """Coordinates of the search."""
        columns = [p.natural(values[:, i]) for i, p in enumerate(self.numbers)]
        return np.stack(columns, axis=1) if columns else np.empty((len(values), 0))

    def from_natural(self, natural: Float[np.ndarray, "n p"]) -> Float[np.ndarray, "n p"]:
        """The inverse of ``natural``."""
        columns = [p.from_natural(natural[:, i]) for i, p in enumerate(self.numbers)]
        return np.stack(columns, axis=1) if columns else np.empty((len(natural), 0))

    def descend(
        self,
        values: Float[np.ndarray, "n p"],
        spectra: Float[np.ndarray, "n q u"],
        movable: Bool[np.ndarray, "n p"] | None = None,
        spectra_movable: Bool[np.ndarray, "n q u"] | None = None,
        inner: int = 0,
        outer: int = 60,
        measured: Callable[[Int[np.ndarray, " k"]], Data] | None = None,
    ) -> Descent:
        """Minimize chi-square from each start; see ``arrow.descend``.

        Args:
            values: the numbers, in the scene's units.
            spectra: the free spectra.
            movable: which numbers may move; None for all.
            spectra_movable: which values of the spectra may; None for all.
            inner: most steps of the spectra alone.
            outer: most steps of all; with neither the model is only evaluated and differentiated.
            measured: the data of some starts, given by their places, if each has measured values of its own; the
                predictions, which would fill the memory, are then left out. None if all share those of the fit.
        """
        count = len(values)
        if not count:
            width = values.shape[1] + self.layout.free_spectra + 1
            matrix, none = np.zeros((0, self.layout.blocks, width, width)), np.zeros(0, int)
            return Descent(values, spectra, np.zeros(0), matrix, none, none, none, ())
        if measured is None:
            lanes = self.lanes
            compiled = self.programs.descent(self.data, lanes, False, self.tabular)
        else:
            lanes = BATCH_LANES
            compiled = self.programs.descent(measured(np.zeros(lanes, int)), lanes, True, False)
        dtype = self.data.center.dtype
        movable = np.ones(values.shape, dtype=bool) if movable is None else movable
        spectra_movable = np.ones(spectra.shape, dtype=bool) if spectra_movable is None else spectra_movable
        natural = self.natural(values)
        # Narrow grooves need many steps, and a call waits for its slowest member.
        order = np.lexsort(natural.T[::-1]) if natural.shape[1] else np.arange(count)
        ends: list[End] = []
        for first in range(0, count, lanes):
            chosen = order[np.minimum(np.arange(first, first + lanes), count - 1)]
            # The last call is filled up with copies that stay where they are.
            busy = np.arange(first, first + lanes) < count
            lane = Lane(
                natural[chosen].astype(dtype),  # type: ignore[arg-type]
                spectra[chosen].astype(dtype),  # type: ignore[arg-type]
                movable[chosen],  # type: ignore[arg-type]
                spectra_movable[chosen],  # type: ignore[arg-type]
                (inner * busy).astype(np.int32),  # type: ignore[arg-type]
                (outer * busy).astype(np.int32),  # type: ignore[arg-type]
            )
            if measured is None:
                ends.append(compiled(lane, self.data))
            else:
                ends.append(compiled(lane, measured(chosen))._replace(predicted=()))
        back = np.argsort(order, kind="stable")

        def gathered(parts: Sequence[Any]) -> np.ndarray:
            whole = np.concatenate([np.asarray(part) for part in parts])[:count][back]
            return whole.astype(np.float64) if whole.dtype.kind == "f" else whole

        columns: list[Any] = [gathered(column) for column in zip(*(end[:-1] for end in ends), strict=True)]
        predicted = tuple(gathered(p) for p in zip(*(end.predicted for end in ends), strict=True))
        ended = self.from_natural(columns[0])
        # What is held keeps its exact value: the logarithm and its inverse would round it.
        ended = np.where(movable, ended, values)
        return Descent(*[ended, *columns[1:], predicted])

    def normal(self, at: Descent) -> Normal:
        """Normal equations at the ends of descents, in the scene's units."""
        return self.normal_of(at.values, at.matrix)

    def normal_of(self, values: Float[np.ndarray, "n p"], matrix: Float[np.ndarray, "n b m m"]) -> Normal:
        """Normal equations at values of the numbers, with all priors, in the scene's units.

        Args:
            values: of the numbers, in the scene's units.
            matrix: see ``arrow.End``.
        """
        units = self.units(values)
        tight = np.asarray(self.data.tightness, np.float64)
        # The residual of a prior of the logarithm has the slope 1/(value × spread) in the value.
        of_logarithm = np.asarray(self.layout.prior_of_logarithm, bool)
        slopes = tight * units / np.where(of_logarithm, values, 1.0)
        return normal_equations(matrix, slopes, units, self.layout.free_spectra)

    def units(self, values: Float[np.ndarray, "n p"]) -> Float[np.ndarray, "n p"]:
        """Derivatives of the numbers with respect to their natural coordinates."""
        return np.where(np.asarray(self.layout.logarithmic, bool), values, 1.0)

    def evaluation(self, at: Descent, held: Bool[np.ndarray, " p"]) -> Evaluation:
        """Ends of descents as points of a profile of what was held."""
        normal = self.normal(at)
        covariance = normal.covariance(held)
        variance = np.diagonal(covariance, axis1=1, axis2=2)
        variance = np.where(np.isnan(variance), np.inf, variance)
        spectral = (
            normal.spectral_variance(np.where(np.isnan(covariance), np.inf, covariance))
            if (self.layout.free_spectra)
            else np.zeros(at.spectra.shape)
        )
        spectral = np.where(np.isnan(spectral), np.inf, spectral)
        return Evaluation(at.values, at.spectra, at.chi_square, variance, spectral)

    def evaluate(
        self, searched: Float[np.ndarray, "n s"], near: Evaluation | None = None, steps: int = GRID_STEPS
    ) -> Evaluation:
        """Chi-square at values of what is searched, minimized over all else.

        Args:
            searched: in the scene's units.
            near: points to start from; the nearest one is taken. None for the usual starts.
            steps: most steps of all else.
        """
        points = np.asarray(searched, dtype=np.float64)
        if self.tabular:
            values = np.repeat(self.start_values[None], len(points), axis=0)
            values[:, : points.shape[1]] = points
            return self._from_table(values)
        held = np.arange(len(self.numbers)) < points.shape[1]
        return self.evaluation(self.relaxed(points, near, steps), held)

    def relaxed(
        self, searched: Float[np.ndarray, "n s"], near: Evaluation | None = None, steps: int = GRID_STEPS
    ) -> Descent:
        """Where all else comes to rest at values of what is searched; see ``evaluate``."""
        points = np.asarray(searched, dtype=np.float64)
        values = np.repeat(self.start_values[None], len(points), axis=0)
        values[:, : points.shape[1]] = points
        held = np.arange(len(self.numbers)) < points.shape[1]
        spectra = np.repeat(self.starts[None, 0], len(points), axis=0)
        if near is not None:
            chosen = self._nearest(values, near, held)
            spectra = near.spectra[chosen]
            values = np.where(held, values, near.values[chosen])
        best = self._relaxed(values, spectra, held, steps)
        for other in self.starts[1:] if near is None else ():
            again = self._relaxed(values, np.repeat(other[None], len(points), axis=0), held, steps)
            best = self._better(best, again, held, steps)
        return best

    def _nearest(self, values: np.ndarray, near: Evaluation, held: np.ndarray) -> np.ndarray:
        own, there = self.natural(values)[:, held], self.natural(near.values)[:, held]
        usable = np.isfinite(near.chi_square) & np.isfinite(near.spectra).all(axis=(1, 2))
        there = np.where(usable[:, None], there, np.inf)
        with np.errstate(invalid="ignore"):
            apart = (
                np.max(np.abs(own[:, None] - there[None]), axis=2)
                if held.any()
                else np.zeros((len(own), len(there)))
            )
        # Of equally near points the lowest.
        lowest = np.argsort(near.chi_square, kind="stable")
        return np.asarray(lowest[np.argmin(apart[:, lowest], axis=1)])

    def _relaxed(self, values: np.ndarray, spectra: np.ndarray, held: np.ndarray, steps: int) -> Descent:
        movable = np.repeat(~held[None], len(values), axis=0)
        return self.descend(values, spectra, movable, inner=INNER_STEPS, outer=steps if (~held).any() else 0)

    def _better(self, first: Descent, second: Descent, held: np.ndarray, steps: int) -> Descent:
        """The better of two starts: at each wavelength, then together."""
        each = [
            np.where(np.isfinite(d.matrix[:, :, -1, -1]), d.matrix[:, :, -1, -1], np.inf) for d in (first, second)
        ]
        gained = each[1] < each[0] - 1e-9 * (1 + each[0])
        rows = np.flatnonzero(gained.any(axis=1))
        if not len(rows):
            return first
        lower = np.where(second.chi_square[rows] < first.chi_square[rows], 1, 0)
        values = np.where(lower[:, None] == 1, second.values[rows], first.values[rows])
        mixed = np.where(gained[rows][:, None], second.spectra[rows], first.spectra[rows])
        again = self._relaxed(values, mixed, held, steps)
        candidates = [first.take(rows), second.take(rows), again]
        costs = np.stack([np.where(np.isfinite(c.chi_square), c.chi_square, np.inf) for c in candidates])
        choice = np.argmin(costs, axis=0)
        parts: list[Any] = []
        for new, *olds in zip(first[:-1], *(c[:-1] for c in candidates), strict=True):
            new = new.copy()
            new[rows] = np.stack(olds)[choice, np.arange(len(rows))]
            parts.append(new)
        predicted = []
        for i, new in enumerate(first.predicted):
            new = new.copy()
            new[rows] = np.stack([c.predicted[i] for c in candidates])[choice, np.arange(len(rows))]
            predicted.append(new)
        return Descent(*[*parts, tuple(predicted)])

    def factors(self, values: Float[np.ndarray, "n p"]) -> list[np.ndarray]:
        """True reflectance factors of each measurement, shape (n, D, L) each, without free spectra."""
        count = len(values)
        natural = self.natural(values)
        order = np.lexsort(natural.T[::-1])
        padded = natural[np.append(order, np.repeat(order[-1:], -count % CHUNK))]
        # Cut up by NumPy: each slice of a JAX array would be one more small program to compile.
        chunks = padded.astype(self.data.center.dtype).reshape(-1, CHUNK, natural.shape[1])
        compiled = self.programs.table(self.data)
        results = [compiled(chunk, self.data.known) for chunk in chunks]
        back = np.argsort(order, kind="stable")
        return [
            np.concatenate([np.asarray(r, np.float64) for r in part])[back] for part in zip(*results, strict=True)
        ]

    def _from_table(self, values: np.ndarray) -> Evaluation:
        """Gain and offset eliminated exactly."""
        count = len(values)
        nothing = np.zeros((count, 0, self.layout.blocks))
        variance = np.zeros(values.shape)
        chi_square = np.empty(count)
        values = values.copy()
        for first in range(0, count, 16 * CHUNK):
            some = slice(first, first + 16 * CHUNK)
            found = self._eliminated(values[some], self.factors(values[some]))
            values[some][:, self.linear], chi_square[some], variance[some][:, self.linear] = found
        return Evaluation(values, nothing, chi_square, variance, nothing)

    def _eliminated(
        self, values: np.ndarray, factors: list[np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Best gains and offsets, chi-square and conditional variances."""
        count, linear = len(values), self.linear
        tight, center = (np.asarray(a, np.float64) for a in (self.data.tightness, self.data.center))
        # A row for each value, then one for each prior of a gain or offset.
        targets, columns = [], [[np.zeros((count, 0))] for _ in linear]
        for part, factor, measured, weights in zip(
            self.layout.parts, factors, self.data.values, self.data.weights, strict=True
        ):
            w = np.asarray(weights, np.float64).ravel()
            roles = {number: role for role, number in part.roles}
            shining = w * factor.reshape(count, -1)
            target = np.broadcast_to(w * np.asarray(measured, np.float64).ravel(), shining.shape)
            targets.append(target if "gain" in roles.values() else target - shining)
            for column, number in zip(columns, linear, strict=True):
                role = roles.get(number)
                column.append(
                    shining if role == "gain" else np.broadcast_to(w * (role == "offset"), shining.shape)
                )
        rows = [np.broadcast_to(center[i] * tight[i], (count, 1)) for i in linear]
        whole = np.concatenate([*targets, *rows], axis=1)
        for k, number in enumerate(linear):
            own = np.zeros((count, len(linear)))
            own[:, k] = tight[number]
            columns[k].append(own)
        residual, found, spread = eliminate(whole, [np.concatenate(c, axis=1) for c in columns])
        free = [i for i in range(len(self.numbers)) if i not in linear]
        logs = np.where(self.layout.prior_of_logarithm, np.log(np.where(values > 0, values, 1.0)), values)
        priors = tight[free] * (logs[:, free] - center[free])
        chi_square = np.sum(residual**2, axis=1) + np.sum(priors**2, axis=1)
        return found, chi_square, spread

    def kinks(self, slot: int) -> Float[np.ndarray, " k"]:
        """Allowed values of a number at which the model is not smooth; none unless it is a dihedral angle."""
        found = [np.empty(0)]
        parameter = self.numbers[slot]
        for index in self.angles.get(slot, ()):
            found.append(vc.kink_angles(self.layout.parts[index].scene, parameter.lower, parameter.upper))
        return np.unique(np.concatenate(found))

    def fitted_scenes(self, values: Float[np.ndarray, " p"], spectra: Float[np.ndarray, "q u"]) -> tuple[Any, ...]:
        """The scenes with all unknowns put in, as nominally seen: a tilt is the instrument's."""
        dtype = self.data.center.dtype
        natural = jnp.asarray(self.natural(values[None])[0], dtype)
        own = jnp.asarray(spectra, dtype)
        scenes = []
        for part, known in zip(self.layout.parts, self.data.known, strict=True):
            numbers, rows = self.layout.inputs(part, natural, own)
            exact = [jnp.asarray(values[i], dtype) for _, i in part.slots]
            numbers = jnp.stack([*exact, *numbers[len(exact) :]]) if exact else numbers
            scenes.append(self.layout.placed(part, numbers, rows, known))
        return tuple(scenes)


def fraction_start(total: np.ndarray, weight: np.ndarray, low: Any, high: Any) -> np.ndarray:
    """The mean measured spectrum as the start of a free fraction: within its bounds, and not on them.

    Args:
        total: weighted sum of the measured values at each wavelength, shape (U,).
        weight: sum of the weights, likewise; 0 where nothing is measured.
        low: lower bounds, which broadcast against (U,).
        high: upper bounds, likewise.
    """
    mean = np.where(weight > 0, total / np.where(weight > 0, weight, 1.0), 0.5)
    margin = 0.02 * (high - low)
    return np.asarray(np.clip(mean, low + margin, high - margin))


def eliminate(
    target: Float[np.ndarray, "n rows"], columns: Sequence[Float[np.ndarray, "n rows"]]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Least squares of targets on a few columns by Gram-Schmidt, at n points.

    Returns:
        The residuals, the coefficients and their variances, shape (n, columns). A column that adds nothing to
        those before it has the coefficient 0 and an infinite variance; so have those that it could stand for.
    """
    count, size = len(target), len(columns)
    directions: list[np.ndarray] = []
    triangle = np.zeros((count, size, size))
    dead = np.zeros((count, size), bool)
    residual = np.array(target)
    right = np.zeros((count, size))
    for k, column in enumerate(columns):
        own = np.array(column)
        norm = np.sum(own * own, axis=1)
        for i, direction in enumerate(directions):
            triangle[:, i, k] = np.sum(direction * own, axis=1)
            own -= triangle[:, i, k, None] * direction
        rest = np.sum(own * own, axis=1)
        dead[:, k] = rest <= 1e-13 * norm
        length = np.sqrt(np.where(dead[:, k], 1.0, rest))
        triangle[:, k, k] = length
        direction = np.where(dead[:, k, None], 0.0, own / length[:, None])
        directions.append(direction)
        right[:, k] = np.sum(direction * residual, axis=1)
        residual -= right[:, k, None] * direction
    inverse = np.zeros((count, size, size))
    for k in reversed(range(size)):
        inverse[:, k, k] = np.where(dead[:, k], 0.0, 1 / triangle[:, k, k])
        for j in range(k + 1, size):
            others = np.einsum("ni,ni->n", triangle[:, k, k + 1 :], inverse[:, k + 1 :, j])
            inverse[:, k, j] = -others / triangle[:, k, k]
    found = np.einsum("nij,nj->ni", inverse, right)
    variance = np.sum(inverse**2, axis=2)
    for k in range(size):
        mimicked = (dead[:, k, None] & (np.abs(triangle[:, :, k]) > 0)) | (dead & (np.arange(size) == k))
        variance = np.where(mimicked, np.inf, variance)
    return residual, found, variance
