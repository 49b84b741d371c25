"""Surfaces by design: the parameters that bring a scene closest to what it should look like.

From many starts, SciPy's trust region within bounds descends on residuals that are smooth where colors agree; it
says which bounds are active. The model is compiled once, with its derivatives by all unknowns.
"""

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from os import PathLike
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.optimize import least_squares  # type: ignore[import-untyped]
from scipy.stats import qmc  # type: ignore[import-untyped]

from fitting import files
from fitting.layout import Data, Layout
from fitting.looks import color_weights, factors_of, finite_bounds, seen_from
from fitting.problem import Problem
from fitting.programs import Kept
from fitting.result import plain
from fitting.solve import warn_of_float32
from fitting.target import Look, Target
from vcavity_jax import colorimetry

_LIMIT_WEIGHTS = (1.0, 10.0, 100.0)
"""A limit exceeded by ΔE 1 costs as much as a color that is off by so many steps: more in each round of a descent.

With the last weight from the beginning, a descent creeps along the edge of what the limits allow.
"""

_PULL = 0.01
"""A standard deviation of a smooth spectrum's coefficient costs so many steps: of all that serve, the plainest."""

_SAME = 1e-3
_MOST_SOLUTIONS = 8
_WITHIN = 1.0
_MET = 1e-3


@dataclass(frozen=True, eq=False)
class Solution:
    """One local optimum.

    Args:
        values: by name; radians for angles.
        spectra: free ones by name, shape (L,).
        cost: sum of the squared residuals, in steps of the targets.
        reached: for each target: ΔE₀₀ from the color, root mean square from the spectrum, or ΔE₀₀ between both
            looks.
        met: for each target: within its step, or its limit.
        at_bound: names of what ends on a bound of its range.
        scene: with all of it put in, in the light of the first target.
    """

    values: dict[str, float]
    spectra: dict[str, np.ndarray]
    cost: float
    reached: tuple[float, ...]
    met: tuple[bool, ...]
    at_bound: tuple[str, ...]
    scene: Any


@dataclass(frozen=True, eq=False)
class Design:
    """What comes closest to the targets.

    Args:
        solutions: distinct ones, best first.
        targets: what was wished for.
        tolerances: by name of each number: how far it may be off until some color of the best solution has
            changed by ΔE₀₀ 1; radians for angles; infinite if it changes nothing.
        wavelengths_nm: shape (L,).
        starts: how many points were tried.
        units: "rad", "nm" or "1" by name.
    """

    solutions: tuple[Solution, ...]
    targets: tuple[Target, ...]
    tolerances: dict[str, float]
    wavelengths_nm: np.ndarray
    starts: int
    units: dict[str, str] = field(repr=False)

    @property
    def best(self) -> Solution:
        """The solution with the least cost."""
        return self.solutions[0]

    @property
    def met(self) -> bool:
        """Whether the best solution meets every target."""
        return all(self.best.met)

    @property
    def message(self) -> str:
        """Whether it does; if not, how close it comes and what binds."""
        if self.met:
            return "every target is met"
        missed = [
            f"{t.description} ({_reached(t, r)})"
            for t, r, met in zip(self.targets, self.best.reached, self.best.met, strict=True)
            if not met
        ]
        bound = self.best.at_bound
        binds = f"; {', '.join(bound)} at a bound of its range" if bound else "; no bound binds"
        return f"not met: {'; '.join(missed)}{binds}"

    def summary(self) -> str:
        """A table to read: what was reached, the solutions and how precisely they must be made."""
        lines = ["target and what is reached"]
        for target, reached, met in zip(self.targets, self.best.reached, self.best.met, strict=True):
            lines.append(f"  {target.description}: {_reached(target, reached)}{'' if met else '  MISSED'}")
        lines.append(f"solutions of {self.starts} starts")
        for one in self.solutions:
            numbers = [f"{name} {self._shown(name, value)}" for name, value in one.values.items()]
            spectra = [f"{name} {s.min():.3f} to {s.max():.3f}" for name, s in one.spectra.items()]
            bound = f"  at a bound: {', '.join(one.at_bound)}" if one.at_bound else ""
            lines.append(f"  {', '.join(numbers + spectra)}  (cost {one.cost:.3g}){bound}")
        if self.tolerances:
            kept = [f"{name} ± {self._shown(name, t)}" for name, t in self.tolerances.items()]
            lines.append(f"for a color change below 1: {', '.join(kept)}")
        return "\n".join([*lines, f"{self.message}."])

    def _shown(self, name: str, value: float) -> str:
        unit = self.units[name]
        shown = math.degrees(value) if unit == "rad" else value
        return f"{shown:.4g}{ {'rad': ' deg', 'nm': ' nm'}.get(unit, '') }"

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, angles in degrees, None for what is infinite."""

        def scaled(values: dict[str, float]) -> dict[str, float]:
            return {k: math.degrees(v) if self.units[k] == "rad" else v for k, v in values.items()}

        content: dict[str, Any] = plain(
            {
                "met": self.met,
                "message": self.message,
                "targets": [
                    {
                        "target": t.description,
                        "kind": t.kind,
                        "limit": t.limit,
                        "reached": r,
                        "met": m,
                    }
                    for t, r, m in zip(self.targets, self.best.reached, self.best.met, strict=True)
                ],
                "solutions": [
                    {
                        "parameters": scaled(s.values),
                        "spectra": s.spectra,
                        "cost": s.cost,
                        "reached": s.reached,
                        "at_bound": s.at_bound,
                    }
                    for s in self.solutions
                ],
                "tolerances": scaled(self.tolerances),
                "units": {k: "deg" if u == "rad" else u for k, u in self.units.items()},
                "wavelength_nm": self.wavelengths_nm,
                "starts": self.starts,
            }
        )
        return content

    def to_json(self, path: str | PathLike[str]) -> None:
        """Write ``to_dict()`` to a file.

        Raises:
            OSError: the file cannot be written.
        """
        files.write_json(path, self.to_dict())


def _reached(target: Target, reached: float) -> str:
    if target.kind == "spectrum":
        return f"off by {reached:.4f} (root mean square)"
    return f"ΔE00 {reached:.3g}" + ("" if target.kind == "color" else " between them")


class _Setting(NamedTuple):
    """All that may change without a new compilation.

    Args:
        data: of the layout.
        weights: from a spectrum to tristimulus values, for each look, shape (K, L, 3).
        whites: of each look, shape (K, 3).
        values: of the targets: L*a*b*, or spectra.
        limits: of the targets.
        weight: of what exceeds a limit.
    """

    data: Data
    weights: Array
    whites: Array
    values: tuple[Array, ...]
    limits: tuple[Array, ...]
    weight: Array


class _Evaluation(NamedTuple):
    """The targets at one point of the unknowns.

    Args:
        residuals: in steps of the targets, shape (R,).
        jacobian: of these, shape (R, N).
        reached: what each target reports, shape (T,).
        slopes: ΔE₀₀ of each look for a unit step of each unknown, shape (K, N).
    """

    residuals: Any
    jacobian: Any
    reached: Any
    slopes: Any


@dataclass(frozen=True)
class _Program:
    """What is compiled: where each look stands in the layout, and what the targets make of it."""

    layout: Layout
    looks: tuple[tuple[int, int], ...]
    targets: tuple[tuple[str, tuple[int, ...]], ...]

    def evaluated(self, x: Float[Array, " n"], setting: _Setting) -> _Evaluation:
        """Of numbers in natural coordinates, then free spectra."""

        def everything(x: Array) -> tuple[tuple[Array, Array], tuple[Array, Array, Array]]:
            factors = factors_of(self.layout, self.looks, x, setting.data)
            tristimulus = jnp.einsum("kl,klc->kc", factors, setting.weights, precision="highest")
            colors = colorimetry.lab(tristimulus, setting.whites)
            residuals, reached = self.judged(factors, colors, setting)
            hidden = np.array(sorted(self.layout.hidden), int)
            if hidden.size:
                numbers = x[: x.shape[0] - self.layout.free_spectra * self.layout.blocks]
                pull = self.layout.prior_residuals(numbers, setting.data)[hidden]
                residuals = jnp.concatenate([residuals, _PULL * pull])
            return (residuals, colors), (residuals, colors, reached)

        (jacobian, by_unknown), (residuals, colors, reached) = jax.jacfwd(everything, has_aux=True)(x)
        by_color = jax.vmap(jax.jacfwd(lambda moved, color: colorimetry.components_2000(color, moved)))(
            colors, colors
        )
        slopes = jnp.linalg.norm(jnp.einsum("kij,kjn->kin", by_color, by_unknown), axis=1)
        return _Evaluation(residuals, jacobian, reached, slopes)

    def judged(
        self, factors: Float[Array, "k l"], colors: Float[Array, "k 3"], setting: _Setting
    ) -> tuple[Array, Array]:
        """Residuals, and what each target reports."""
        parts, reached = [], []
        for (kind, looks), value, limit in zip(self.targets, setting.values, setting.limits, strict=True):
            if kind == "spectrum":
                off = factors[looks[0]] - value
                parts.append(off / (limit * math.sqrt(off.shape[0])))
                reached.append(jnp.sqrt(jnp.mean(off**2)))
            elif kind == "color":
                parts.append(colorimetry.components_2000(value, colors[looks[0]]) / limit)
                reached.append(colorimetry.delta_e_2000(value, colors[looks[0]]))
            else:
                between = colorimetry.delta_e_2000(colors[looks[0]], colors[looks[1]])
                excess = between - limit if kind == "alike" else limit - between
                parts.append(setting.weight * jnp.maximum(excess, jnp.zeros_like(excess))[None])
                reached.append(between)
        return jnp.concatenate(parts), jnp.stack(reached)


_KEPT = Kept(16)


def design(
    scene: Any,
    free: Sequence[Any],
    targets: Sequence[Target] | Target,
    *,
    wavelengths_nm: Any,
    starts: int = 16,
    seed: int = 0,
    tolerance: float = 1e-6,
    max_steps: int = 100,
) -> Design:
    """Find the parameters of a scene that come closest to targets.

    Args:
        scene: with a place for everything; the values of what is free do not matter, its view neither.
        free: from ``fitting.free``, of the scene (no gain or other matter of an instrument): numbers, or spectra
            with a value at each wavelength or a form. Bounds are used; priors are not, but a smooth spectrum is
            as plain as the targets allow.
        targets: from ``fitting.target``.
        wavelengths_nm: of the scene's spectra, nm, shape (L,): the visible range if there is a color in it.
        starts: how many points, spread evenly over the allowed ranges, are tried; the better half is descended
            from.
        seed: of these points.
        tolerance: bound on the model's numerical error.
        max_steps: most steps of a descent.

    Returns:
        The distinct solutions, best first, what they reach and how precisely they must be made.

    Raises:
        ValueError: the inputs do not fit together; the message says what is expected.
    """
    warn_of_float32()
    wishes = (targets,) if isinstance(targets, Target) else tuple(targets)
    if not wishes or not all(isinstance(one, Target) for one in wishes):
        raise ValueError("targets: expected one or more of fitting.target, as target.color((50, 60, 40))")
    for name, value in (("starts", starts), ("max_steps", max_steps)):
        if isinstance(value, bool) or not isinstance(value, int) or value < 1:
            raise ValueError(f"{name} is {value!r}; expected a whole number of at least 1")
    grid = np.asarray(wavelengths_nm, np.float64)
    looks = list(dict.fromkeys(look for wish in wishes for look in wish.looks))
    problem, places = seen_from(scene, free, looks, grid, tolerance)
    kinds = tuple((wish.kind, tuple(looks.index(look) for look in wish.looks)) for wish in wishes)
    low, high = _bounds(problem)
    setting = _setting(problem, wishes, looks, grid)
    program = _Program(problem.layout, places, kinds)
    compiled = _KEPT.get((problem.layout.key, places, kinds), lambda: jax.jit(program.evaluated))

    def evaluated(x: np.ndarray, weight: float = _LIMIT_WEIGHTS[-1]) -> _Evaluation:
        weighted = setting._replace(weight=jnp.asarray(weight, dtype))
        return _Evaluation(*(np.asarray(a, np.float64) for a in compiled(jnp.asarray(x, dtype), weighted)))

    dtype = problem.data.center.dtype
    limited = any(kind in ("alike", "different") for kind, _ in kinds)
    rounds = _LIMIT_WEIGHTS if limited else _LIMIT_WEIGHTS[-1:]
    ends = _descents(evaluated, rounds, low, high, starts, seed, max_steps)
    if not ends:
        raise ValueError("the model gives no number from any start; expected narrower ranges, or another material")
    found = [(end, evaluated(end.place)) for end in _distinct(ends, high - low)]
    solutions = tuple(_solution(problem, wishes, end, at) for end, at in found)
    return Design(
        solutions,
        wishes,
        _tolerances(problem, solutions[0], found[0][1].slopes),
        grid,
        starts,
        {p.name: p.unit for p in problem.numbers},
    )


class _End(NamedTuple):
    """Where a descent ended: the unknowns, which lie on a bound, and the cost."""

    place: np.ndarray
    bound: np.ndarray
    cost: float


def _descents(
    evaluated: Callable[[np.ndarray, float], _Evaluation],
    rounds: Sequence[float],
    low: np.ndarray,
    high: np.ndarray,
    starts: int,
    seed: int,
    max_steps: int,
) -> list[_End]:
    """From the better half of points spread evenly; best first, without those where the model gives no number."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # a number of starts that is no power of two
        shares = qmc.Sobol(len(low), rng=np.random.default_rng(seed)).random(starts)
    kept: tuple[tuple[bytes, float], _Evaluation] = (b"", 0.0), _Evaluation(*(np.zeros(0) for _ in range(4)))

    def at(x: np.ndarray, weight: float) -> _Evaluation:
        nonlocal kept
        key = x.tobytes(), weight
        if kept[0] != key:
            kept = key, evaluated(x, weight)
        return kept[1]

    tried = low + (high - low) * np.clip(shares, 0.01, 0.99)
    begun = [at(x, rounds[0]) for x in tried]
    costs = np.array([np.sum(one.residuals**2) + 0 * np.sum(one.jacobian) for one in begun])
    better = np.argsort(costs)[: max((starts + 1) // 2, 1)]
    found = []
    for place in tried[better[np.isfinite(costs[better])]]:
        try:
            for weight in rounds:
                end = least_squares(
                    lambda x, weight=weight: at(x, weight).residuals,
                    place,
                    lambda x, weight=weight: at(x, weight).jacobian,
                    bounds=(low, high),
                    x_scale=high - low,
                    ftol=1e-10,
                    xtol=1e-10,
                    gtol=1e-12,
                    max_nfev=max_steps,
                )
                place = end.x
        except ValueError:  # No number on the way.
            continue
        found.append(_End(end.x, end.active_mask != 0, 2 * float(end.cost)))
    return sorted(found, key=lambda one: one.cost)


def _setting(problem: Problem, wishes: tuple[Target, ...], looks: list[Look], grid: np.ndarray) -> _Setting:
    dtype = problem.data.center.dtype
    if any(wish.kind != "spectrum" for wish in wishes):
        weights, whites = color_weights(looks, grid)
    else:
        weights, whites = np.zeros((len(looks), len(grid), 3)), np.ones((len(looks), 3))
    for wish in wishes:
        if wish.kind == "spectrum" and wish.value.shape != grid.shape:
            raise ValueError(
                f"target {wish.description!r} has {wish.value.size} values; expected one for each of "
                f"{grid.size} wavelengths"
            )
    return _Setting(
        problem.data,
        jnp.asarray(weights, dtype),
        jnp.asarray(whites, dtype),
        tuple(jnp.asarray(wish.value, dtype) for wish in wishes),
        tuple(jnp.asarray(wish.limit, dtype) for wish in wishes),
        jnp.asarray(_LIMIT_WEIGHTS[-1], dtype),
    )


def _bounds(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Of all unknowns: numbers in natural coordinates, then free spectra."""
    low, high = finite_bounds(problem)
    spectral = np.asarray(problem.data.spectral_bounds, np.float64)
    blocks = problem.layout.blocks
    bottom, top = (
        np.concatenate([end, np.repeat(s, blocks)]) for end, s in zip((low, high), spectral, strict=True)
    )
    return bottom, top


def _distinct(ends: list[_End], room: np.ndarray) -> list[_End]:
    """The best of all descents that ended in the same place; none that is much worse than the best."""
    kept: list[_End] = []
    for one in ends:
        if one.cost > ends[0].cost + _WITHIN or len(kept) == _MOST_SOLUTIONS:
            break
        if all(np.max(np.abs(one.place - known.place) / room) > _SAME for known in kept):
            kept.append(one)
    return kept


def _solution(problem: Problem, wishes: tuple[Target, ...], end: _End, at: _Evaluation) -> Solution:
    layout = problem.layout
    count = len(problem.numbers)
    values = np.array([float(p.from_natural(x)) for p, x in zip(problem.numbers, end.place, strict=False)])
    shape = layout.free_spectra, layout.blocks
    free = end.place[count:].reshape(shape)
    spectra = dict(zip(problem.free_names, free, strict=True))
    rows = [bool(row.any()) for row in end.bound[count:].reshape(shape)]
    at_bound = [problem.numbers[i].name for i in _listed(problem) if end.bound[i]]
    at_bound += [name for name, bound in zip(problem.free_names, rows, strict=True) if bound]
    span = float(layout.wavelengths_nm[0]), float(layout.wavelengths_nm[-1])
    for use, names in problem.formed:
        whole = use.form.spectrum(layout.wavelengths_nm, span, jnp.asarray(values[list(use.numbers)]))
        spectra |= dict(zip(names, np.asarray(whole), strict=True))
    met = tuple(
        bool(r >= w.limit - _MET if w.kind == "different" else r <= w.limit + _MET)
        for w, r in zip(wishes, at.reached, strict=True)
    )
    return Solution(
        {problem.numbers[i].name: float(values[i]) for i in _listed(problem)},
        spectra,
        end.cost,
        tuple(float(r) for r in at.reached),
        met,
        tuple(at_bound),
        problem.fitted_scenes(values, free)[0],
    )


def _listed(problem: Problem) -> list[int]:
    """Numbers that mean something by themselves."""
    return [i for i in range(len(problem.numbers)) if i not in problem.layout.hidden]


def _tolerances(problem: Problem, best: Solution, slopes: np.ndarray) -> dict[str, float]:
    """From slopes in natural coordinates."""
    found = {}
    for i in _listed(problem):
        p = problem.numbers[i]
        steepest = float(np.max(slopes[:, i]))
        scale = best.values[p.name] if p.scale == "log" else 1.0
        found[p.name] = scale / steepest if steepest > 0 else math.inf
    return found
