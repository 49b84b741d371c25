"""For which values of the unknowns a plan is made: those expected, and those to both sides of what is searched."""

import math
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from fitting.problem import Problem
from fitting.result import FitResult
from fitting.spectra import as_array

_ANGLE = math.radians(3.0)
_SHARE = 0.01
"""Half-width of what a plan allows for without a fit, as a share of the allowed range."""

_STEPS = (-1.0, -0.5, 0.5, 1.0)


def expected_values(problem: Problem, result: FitResult | None) -> Float[np.ndarray, " p"]:
    """Of the numbers: those of the scene, of the fit, or where the instrument starts."""
    values = np.array([math.nan if p.start is None else p.start for p in problem.numbers], np.float64)
    for part in problem.layout.parts:
        leaves = jax.tree.leaves(part.scene)
        for leaf, number in part.slots:
            values[number] = float(leaves[leaf])
    best = {} if result is None else result.minima[0].values
    for i, p in enumerate(problem.numbers):
        if p.role != "scene":
            values[i] = best.get(p.name, best.get(p.name.partition("[")[0], values[i]))
        if not p.lower <= values[i] <= p.upper:
            raise ValueError(
                f"scene: {p.name} is {p.displayed(values[i]):g}; expected a value in its allowed range, "
                f"{p.displayed(p.lower):g} to {p.displayed(p.upper):g}: the plan is made for it"
            )
    return values


def expected_spectra(problem: Problem) -> np.ndarray:
    """The scene's own spectra where they are free, shape (Q, U)."""
    spectra = np.zeros((problem.layout.free_spectra, problem.layout.blocks))
    for part in problem.layout.parts:
        leaves = jax.tree.leaves(part.scene)
        for slot in part.spectral:
            if slot.source is None:
                own = as_array(leaves[slot.leaf], part.shape[1])
                for row, value in zip(slot.rows, (np.real(own), np.imag(own)), strict=False):
                    spectra[row, part.places] = value
    return spectra


def half_widths(
    problem: Problem, given: Any, result: FitResult | None, values: Float[np.ndarray, " p"]
) -> dict[str, float]:
    """Half-width, in its own unit, within which each searched number may lie."""
    searched = problem.searched
    if given is not None and not isinstance(given, Mapping):
        if len(searched) != 1:
            names = ", ".join(p.name for p in searched) or "none"
            raise ValueError(f"spread is {given!r}, and what is searched is {names}; expected half-widths by name")
        given = {searched[0].name: given}
    found = {}
    for i, p in enumerate(searched):
        if given is not None:
            found[p.name] = given.get(p.name, 0.0)
        elif result is not None and p.name in result.estimates:
            estimate = result.estimates[p.name]
            ends = estimate.interval_95[0][0], estimate.interval_95[-1][1]
            error = estimate.standard_error
            found[p.name] = 2 * error if math.isfinite(error) else (ends[1] - ends[0]) / 2
        elif p.unit == "rad":
            found[p.name] = _ANGLE
        else:
            range_of = float(p.natural(p.upper) - p.natural(p.lower))
            found[p.name] = _SHARE * range_of * (values[i] if p.scale == "log" else 1.0)
    unknown = next((name for name in given or () if name not in found), None)
    if unknown is not None:
        raise ValueError(f"spread names {unknown!r}; expected what is searched: {', '.join(found) or 'nothing'}")
    for name, width in found.items():
        if not (isinstance(width, float | int | np.floating) and 0 <= width < math.inf):
            raise ValueError(
                f"spread of {name} is {width!r}; expected a number of at least 0, radians for an angle"
            )
    return {name: float(width) for name, width in found.items()}


def across(problem: Problem, at: np.ndarray, widths: dict[str, float]) -> np.ndarray:
    """The expected values, and those to both sides of each number that may differ; shape (K, P)."""
    points = [at]
    for i, p in enumerate(problem.numbers):
        if widths.get(p.name, 0.0) > 0:
            for step in _STEPS:
                moved = at.copy()
                moved[i] = np.clip(at[i] + step * widths[p.name], p.lower, p.upper)
                points.append(moved)
    return np.stack(points)
