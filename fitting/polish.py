"""From a start on the grid to the bottom of its valley: Levenberg-Marquardt for all starts in one call.

At a kink the gradient does not vanish at the minimum, so the polish stops on its step or on the cost, never on
the gradient.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float

from fitting.problem import Data, Problem

LANES = {1: 5, 2: 8, 3: 8}
"""Starts per call, by the number of nonlinear parameters."""

_COST_TOLERANCE = 1e-12


class Polished(NamedTuple):
    """Where n polishes ended.

    Args:
        parameters: in the scene's units, shape (n, P).
        chi_square: shape (n,).
        linear: best gain and offset, shape (n, 2).
        variance: their variances at fixed nonlinear parameters, shape (n, 2).
        converged: stopped on step or cost, shape (n,).
        steps: steps taken, shape (n,).
        predicted: the model without gain and offset, shape (n, D, L).
        slopes: its derivatives with respect to the parameters, shape (n, P, D, L).
    """

    parameters: np.ndarray
    chi_square: np.ndarray
    linear: np.ndarray
    variance: np.ndarray
    converged: np.ndarray
    steps: np.ndarray
    predicted: np.ndarray
    slopes: np.ndarray


class _Lane(NamedTuple):
    """What a single polish holds fixed: where it starts, what may move, whether it runs at all."""

    start: Array
    movable: Array
    frozen: Array
    data: Data


class _StopOnStep(optx.AbstractGaussNewton):
    """Levenberg-Marquardt that stops on small steps, taken or refused, or on a cost that no longer falls."""

    log_scale: tuple[bool, ...] = eqx.field(static=True)
    rtol: float = 0.0
    atol: float = 1e-14
    norm: Any = optx.max_norm
    descent: Any = optx.DampedNewtonDescent(linear_solver=lx.QR())
    search: Any = optx.ClassicalTrustRegion()
    verbose: Any = eqx.field(static=True, default=lambda **_: None)

    def step(self, fn: Any, y: Any, args: Any, options: Any, state: Any, tags: Any) -> Any:
        y, new, aux = super().step(fn, y, args, options, state, tags)
        before, after = (jnp.sum(s.f_info.residual**2) for s in (state, new))
        taken = (new.num_accepted_steps > state.num_accepted_steps) & ~state.first_step
        stalled = taken & (before - after <= _COST_TOLERANCE * after)
        return y, eqx.tree_at(lambda s: s.terminate, new, new.terminate | stalled), aux

    def terminate(self, fn: Any, y: Any, args: Any, options: Any, state: Any, tags: Any) -> Any:
        now, trial = (_natural(u, args.data) for u in (y, state.y_eval))
        short = jnp.all(jnp.abs(trial - now) < args.data.step) & ~state.first_step
        return state.terminate | short | args.frozen, state.result


def _natural(unconstrained: Array, data: Data) -> Array:
    return data.bounds[0] + (data.bounds[1] - data.bounds[0]) * jax.nn.sigmoid(unconstrained)


def _compile(problem: Problem, max_steps: int) -> Any:
    log_scale = tuple(p.scale == "log" for p in problem.nonlinear)
    solver = _StopOnStep(log_scale)
    residuals, model = problem.residuals, problem.model

    def values(coordinates: Array) -> Array:
        return jnp.stack([jnp.exp(c) if log else c for c, log in zip(coordinates, log_scale, strict=True)])

    def cost(u: Array, lane: _Lane) -> Array:
        moved = jnp.where(lane.movable, u, lane.start)
        return residuals(values(_natural(moved, lane.data)), lane.data)[0]

    def one(point: Array, start: Array, movable: Array, frozen: Array, data: Data) -> tuple[Array, ...]:
        lane = _Lane(start, movable, frozen, data)
        solution = optx.least_squares(cost, solver, start, lane, max_steps=max_steps, throw=False)
        ended = values(_natural(jnp.where(movable, solution.value, start), data))
        # A frozen lane, and a held parameter, keep their exact values: the logit would round a bound.
        ended = jnp.where(movable & ~frozen, ended, point)
        predicted, push = jax.linearize(model, ended)
        slopes = jax.vmap(push)(jnp.eye(len(log_scale), dtype=ended.dtype))
        residual, linear, variance = residuals(ended, data)
        good = solution.result == optx.RESULTS.successful
        steps = solution.stats["num_steps"]
        return ended, residual @ residual, linear, variance, good, steps, predicted, slopes

    return jax.jit(jax.vmap(one, in_axes=(0, 0, 0, 0, None)))


def polish(
    problem: Problem,
    starts: Float[np.ndarray, "n p"],
    movable: Bool[np.ndarray, "n p"] | None = None,
    frozen: bool = False,
    max_steps: int = 60,
) -> Polished:
    """Minimize chi-square from each start.

    Args:
        problem: what to fit.
        starts: parameters in the scene's units.
        movable: which parameters may move; None for all.
        frozen: take no step, only evaluate the model and its derivatives there.
        max_steps: most steps of each polish.

    Returns:
        Where each ended; never worse than its start up to rounding.
    """
    starts = np.asarray(starts, dtype=np.float64)
    lanes = LANES[starts.shape[1]]
    key = f"polish {max_steps}"
    if key not in problem.cache:
        problem.cache[key] = _compile(problem, max_steps)
    dtype = problem.data.values.dtype
    movable = np.ones(starts.shape, dtype=bool) if movable is None else movable
    inner = np.stack([p.unconstrained(starts[:, i]) for i, p in enumerate(problem.nonlinear)], axis=1)
    results = []
    for first in range(0, len(starts), lanes):
        # The last call is filled up with copies that stay where they are.
        chosen = np.minimum(np.arange(first, first + lanes), len(starts) - 1)
        idle = np.arange(first, first + lanes) >= len(starts)
        results.append(
            problem.cache[key](
                jnp.asarray(starts[chosen], dtype),
                jnp.asarray(inner[chosen], dtype),
                jnp.asarray(movable[chosen]),
                jnp.asarray(idle | frozen),
                problem.data,
            )
        )
    columns = (np.concatenate([np.asarray(part) for part in column]) for column in zip(*results, strict=True))
    kept = [column[: len(starts)] for column in columns]
    return Polished(*(c.astype(np.float64) if c.dtype.kind == "f" else c for c in kept))
