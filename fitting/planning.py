"""Which views to measure next: those whose expected information makes the errors least.

Views that make a parameter identifiable come first; among equals the least A- or D-criterion decides, for the
worst of several values of what is searched, because the best views move with it.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

import vcavity_jax as vc
from fitting import exchange
from fitting.assembly import build
from fitting.candidates import Group, already_measured, groups_of, listed, planned_noise, planned_wavelengths
from fitting.design_points import across, expected_spectra, expected_values, half_widths
from fitting.expected import Expected, Goal, expect, over_values
from fitting.measurement import Measurement
from fitting.problem import Problem
from fitting.result import FitResult
from fitting.solve import warn_of_float32
from fitting.view_plan import PlannedView, ViewPlan

CRITERIA = ("A", "D")
METHODS = ("exchange", "greedy", "exhaustive")
_PLACEHOLDER = 0.5


def plan_views(
    scene: Any,
    free: Sequence[Any] | None = None,
    candidates: Any = None,
    count: int = 1,
    noise: Any = None,
    *,
    measured: Any = None,
    criterion: str = "A",
    method: str = "exchange",
    wavelengths_nm: Any = None,
    interest: Sequence[str] | None = None,
    spread: float | int | Mapping[str, float] | None = None,
    over_spread: str = "worst",
    tolerance: float = 1e-8,
) -> ViewPlan:
    """Choose the views to measure next.

    The Fisher information of a view is JᵀJ/σ², with the slopes J of the model at the scene's own parameters;
    that of several views, of what is measured already and of the priors adds up. Its inverse, with every nuisance
    and every spectrum in it, bounds the covariance of the estimates (Cramér-Rao). Sets of views are compared first
    by what is not identifiable, then by the criterion:

    - "A": the sum of the variances of what is of interest, each relative to the width of its allowed range;
    - "D": the determinant of their covariance, scaled in the same way.

    So that both exist also while something is not identifiable, the criterion alone (never a reported error) gives
    each unknown one more prior, normal and as wide as its allowed range.

    Args:
        scene: what is expected, with all values: the plan holds near them. Or a ``FitResult``, which stands for
            its scene, its free parameters, what it fitted (as ``measured``) and its uncertainty.
        free: as for ``fit``; None for those of a ``FitResult``.
        candidates: directions, as a ``View`` or (polar, azimuth), radians, which broadcast; or several lights, a
            dictionary of names and (illumination, directions), where the directions may be a ``Hemisphere``. Each
            one is chosen at most once: list it twice to allow that. Along the normal the azimuth means nothing:
            of several ones the first counts. None for polar angles of 0 to 80° in steps of 5° and azimuths of 0,
            45 and 90°.
        count: how many to choose.
        noise: expected standard uncertainty of a value, as a fraction: one number, or one per wavelength, shape
            (L,). None for that of what is measured (its root mean square).
        measured: a ``Measurement``, a list or dictionary of them, or directions, which were measured with the
            same noise in the scene's light. The measured values do not matter.
        criterion: "A" or "D".
        method: "greedy" takes the best view, then the best beside it, and so on; "exchange" then swaps single
            views until no swap is better; "exhaustive" tries all sets, if they are not more than 100 000.
        wavelengths_nm: of the planned views, nm, shape (L,); None for those of what is measured. Without either
            the spectra are plain lists, as long as the scene's.
        interest: names of what matters; None for the numbers whose whole range is searched (angle, roughness,
            ...), or else all that is free in the scene.
        spread: half-width within which what is searched may differ from the scene's value, in its own unit
            (radians), by name if several are searched. None for two standard errors of a ``FitResult``, or 3° of
            an angle and 1 % of the allowed range of anything else. The plan holds for five values across it.
        over_spread: "worst" minimizes the worst criterion of these values, "mean" their mean.
        tolerance: bound on the model's numerical error.

    Returns:
        The views in the order in which they help most, and the standard errors before and after each of them. What
        is not identifiable has an infinite one.

    Raises:
        ValueError: the inputs do not fit together; the message says what is expected.

    References:
        [Fedorov1972] for the criteria and the exchange of single members.
    """
    warn_of_float32()
    _check_choices(criterion, method, over_spread)
    result = scene if isinstance(scene, FitResult) else None
    if result is not None:
        free = result.problem.given if free is None else free
        known = dict(zip(result.labels, result.measurements, strict=True))
        if measured is not None:
            raise ValueError("measured is given beside a FitResult, which has measurements; expected one of them")
        scenes, scene = dict(zip(result.labels, result.scenes, strict=True)), result.scene
    else:
        if not isinstance(scene, vc.Scene):
            raise ValueError(f"scene is a {type(scene).__name__}; expected a Scene or a FitResult")
        known, scenes = already_measured(measured, scene), {}
    groups = groups_of(candidates, scene)
    total = sum(len(g.polar) for g in groups.values())
    if isinstance(count, bool) or not isinstance(count, int | np.integer) or not 1 <= count <= total:
        raise ValueError(
            f"count is {count!r}; expected a whole number from 1 to {total}, the number of candidates"
        )
    grid, numbered = planned_wavelengths(wavelengths_nm, known, scene, noise)
    sigma = planned_noise(noise, known, len(grid))
    problem, owners = _problem(scene, scenes, free, groups, known, grid, sigma, tolerance)
    if numbered and (
        problem.layout.forms or any(r == "wavelength_shift" for p in problem.layout.parts for r, _ in p.roles)
    ):
        raise ValueError("wavelengths_nm is None, and a free parameter depends on the wavelengths; expected them")
    at = expected_values(problem, result)
    widths = half_widths(problem, spread, result, at)
    expected = expect(problem, across(problem, at, widths), expected_spectra(problem), owners)
    goal = Goal(*_interest(problem, interest), criterion, over_spread == "mean")
    chosen = _chosen(expected, goal, method, len(owners), int(count))
    labels = list(groups)
    offset = len(problem.measurements) - len(groups)
    everything = tuple(
        PlannedView(
            labels[part - offset],
            float(groups[labels[part - offset]].polar[row]),
            float(groups[labels[part - offset]].azimuth[row]),
        )
        for part, row in owners
    )
    return _report(
        expected, goal, chosen, everything, known, method, widths, grid if not numbered else None, sigma
    )


def _check_choices(criterion: Any, method: Any, over_spread: Any) -> None:
    for name, value, allowed in (
        ("criterion", criterion, CRITERIA),
        ("method", method, METHODS),
        ("over_spread", over_spread, ("worst", "mean")),
    ):
        if value not in allowed:
            raise ValueError(f"{name} is {value!r}; expected one of {', '.join(allowed)}")


def _problem(
    scene: Any,
    scenes: dict[str, Any],
    free: Any,
    groups: dict[str, Group],
    known: dict[str, Any],
    grid: np.ndarray,
    sigma: np.ndarray,
    tolerance: float,
) -> tuple[Problem, list[tuple[int, int]]]:
    """A fit of all that is measured and all candidates, and where each candidate stands in it."""
    if free is None:
        raise ValueError(
            "free is None; expected a list of parameters, say [free.angle()]: only a FitResult has its own"
        )
    measurements: dict[str, Measurement] = {}
    for label, one in [*known.items(), *groups.items()]:
        if label in measurements:
            raise ValueError(f"{label!r} names a measurement and a light; expected distinct names")
        if isinstance(one, Group):
            shape = len(one.polar), len(grid)
            one = Measurement(
                grid,
                one.polar,
                one.azimuth,
                np.full(shape, _PLACEHOLDER),
                np.broadcast_to(sigma, shape),
                one.light,
                hemispherical=one.hemispherical,
            )
        elif one.standard_uncertainty is None:
            if len(one.wavelengths_nm) != len(grid):
                raise ValueError(
                    f"measured {label!r} states no uncertainty; expected one, or the planned wavelengths"
                )
            one = dataclasses.replace(
                one, standard_uncertainty=np.broadcast_to(sigma, one.reflectance_factor.shape)
            )
        measurements[label] = one
    seen = {}
    for label, m in measurements.items():
        own = scenes.get(label, scene)
        try:
            seen[label] = vc.Scene(own.surface, own.material, m.illumination, m.view)
        except ValueError as error:
            raise ValueError(f"candidates[{label!r}]: {error}" if label in groups else str(error)) from None
    offset = len(known)
    owners = [(offset + i, row) for i, g in enumerate(groups.values()) for row in range(len(g.polar))]
    if len(measurements) == 1:
        (label,) = measurements
        return build(seen[label], measurements[label], free, None, tolerance, enough=False), owners
    return build(seen, measurements, free, None, tolerance, enough=False), owners


def _interest(problem: Problem, names: Sequence[str] | None) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Places of the numbers and of the free spectra that matter."""
    numbers, spectra = problem.numbers, problem.free_names
    if names is None:
        found = tuple(range(len(problem.searched)))
        if found:
            return found, ()
        own = tuple(i for i, p in enumerate(numbers) if p.role == "scene")
        return (own, tuple(range(len(spectra)))) if own or spectra else (tuple(range(len(numbers))), ())
    if isinstance(names, str) or not len(names):
        raise ValueError(f"interest is {names!r}; expected a list of names of free parameters")
    picked: list[int] = []
    rows: list[int] = []
    for name in names:
        own = tuple(
            i for i, p in enumerate(numbers) if p.name == name or p.name.startswith((f"{name}.", f"{name}["))
        )
        free = tuple(i for i, s in enumerate(spectra) if s == name or s.startswith(f"{name}["))
        if name == "index" and not own and not free:
            free = tuple(i for i, s in enumerate(spectra) if s in ("n", "k"))
        if not own and not free:
            every = [*(p.name for p in numbers), *spectra]
            raise ValueError(f"interest names {name!r}; expected some of {', '.join(every)}")
        picked += own
        rows += free
    return tuple(dict.fromkeys(picked)), tuple(dict.fromkeys(rows))


def _chosen(expected: Expected, goal: Goal, method: str, total: int, count: int) -> list[int]:
    """The chosen candidates, the most useful first."""

    def order(sets: np.ndarray) -> np.ndarray:
        return expected.key(sets, goal)

    offered = range(total)
    if method == "exhaustive":
        found = exchange.exhaustive(order, offered, count)
    else:
        found = exchange.greedy(order, offered, count)
        if method == "exchange":
            found = exchange.exchange(order, offered, found)
    return exchange.greedy(order, sorted(found), count)


def _report(
    expected: Expected,
    goal: Goal,
    chosen: list[int],
    everything: tuple[PlannedView, ...],
    known: dict[str, Any],
    method: str,
    widths: dict[str, float],
    grid: np.ndarray | None,
    sigma: np.ndarray,
) -> ViewPlan:
    """What is expected before and after each view."""
    problem = expected.problem
    hidden = {i for use in problem.layout.forms if not use.form.listed for i in use.numbers}
    steps, criteria = [], []
    for size in range(len(chosen) + 1):
        matrix = expected.of(np.array(chosen[:size], int))
        numbers, spectra = expected.errors(matrix)
        own: dict[str, np.ndarray] = {
            p.name: numbers[:, i] for i, p in enumerate(problem.numbers) if i not in hidden
        }
        own |= {name: spectra[:, q] for q, name in enumerate(problem.free_names)}
        steps.append(own | expected.form_errors(matrix))
        logarithm = float(over_values(expected.criterion(matrix, goal)[:, None], goal)[0])
        criteria.append(math.exp(logarithm) if goal.criterion == "A" else logarithm)
    errors = {name: np.stack([step[name] for step in steps]) for name in steps[0]}
    every, _ = expected.errors(expected.of(np.arange(len(everything))))
    picked = [*(problem.numbers[i].name for i in goal.numbers), *(problem.free_names[q] for q in goal.spectra)]
    units = {p.name: p.unit for p in problem.numbers}
    return ViewPlan(
        views=tuple(everything[c] for c in chosen),
        chosen=tuple(chosen),
        candidates=everything,
        measured=listed(known),
        values={p.name: float(expected.values[0, i]) for i, p in enumerate(problem.numbers) if i not in hidden},
        units={name: units.get(name, "1") for name in errors},
        spread=widths,
        standard_errors={name: e[:, 0] for name, e in errors.items()},
        worst_standard_errors={name: e.max(axis=1) for name, e in errors.items()},
        interest=tuple(picked),
        criterion=goal.criterion,
        criterion_values=np.array(criteria),
        method=method,
        noise=sigma,
        wavelengths_nm=grid,
        attainable={
            p.name: bool(np.isfinite(every[:, i]).all()) for i, p in enumerate(problem.numbers) if i not in hidden
        },
    )
