"""From a start on the grid to the bottom of its valley: Levenberg-Marquardt for all starts in one call.

At a kink the gradient does not vanish at the minimum, so the polish stops on its step or on the cost, never
on the gradient.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx  # type: ignore[import-untyped]
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float

import vcavity_jax as vc
from fitting.problem import Problem
from fitting.programs import Data

_COST_TOLERANCE = 1e-12
# XLA would take five times as long to compile this than to run it.
_CHEAP_TO_COMPILE = {"xla_backend_optimization_level": 0, "xla_cpu_use_fusion_emitters": False}


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


def _quiet(**_: Any) -> None:
    """Print nothing while solving."""


class _Lane(NamedTuple):
    """What a single polish holds fixed: where it starts, what may move, whether it runs at all."""

    point: Array
    start: Array
    movable: Array
    frozen: Array
    data: Data


class _StopOnStep(optx.AbstractGaussNewton):
    """Levenberg-Marquardt that stops on small steps, taken or refused, or on a cost that no longer falls."""

    rtol: float = 0.0
    atol: float = 1e-14
    norm: Any = eqx.field(static=True, default=optx.max_norm)
    descent: Any = optx.DampedNewtonDescent(linear_solver=lx.QR())
    search: Any = optx.ClassicalTrustRegion()
    verbose: Any = eqx.field(static=True, default=_quiet)

    def step(self, fn: Any, y: Any, args: Any, options: Any, state: Any, tags: Any) -> Any:
        y, new, aux = super().step(fn, y, args, options, state, tags)
        before, after = (jnp.sum(s.f_info.residual**2) for s in (state, new))
        taken = (new.num_accepted_steps > state.num_accepted_steps) & ~state.first_step
        stalled = taken & (before - after <= _COST_TOLERANCE * after)
        return y, eqx.tree_at(lambda s: s.terminate, new, new.terminate | stalled), aux

    def terminate(self, fn: Any, y: Any, args: Any, options: Any, state: Any, tags: Any) -> Any:
        now, trial = (_natural(u, args.data) for u in (y, state.y_eval))
        short = jnp.all((jnp.abs(trial - now) < args.data.step) | ~args.movable) | args.frozen
        # The first step only evaluates the start; it is taken even by a frozen lane, for its derivatives.
        return state.terminate | (short & ~state.first_step), state.result


def _natural(unconstrained: Array, data: Data) -> Array:
    return data.bounds[0] + (data.bounds[1] - data.bounds[0]) * jax.nn.sigmoid(unconstrained)


def _lower(problem: Problem, max_steps: int) -> Any:
    programs = problem.programs
    log_scale = programs.logarithmic

    def values(u: Array, lane: _Lane) -> Array:
        natural = _natural(u, lane.data)
        free = jnp.stack([jnp.exp(c) if log else c for c, log in zip(natural, log_scale, strict=True)])
        # What is held keeps its exact value: the logit would round a bound.
        return jnp.where(lane.movable & ~lane.frozen, free, lane.point)

    def cost(u: Array, lane: _Lane) -> tuple[Any, Any]:
        point = values(u, lane)
        fixed = jax.lax.stop_gradient(point)
        # Value and slopes at once, and a prediction linear in the step: the model is compiled a single time.
        predicted, push = jax.linearize(lambda v: programs.model(v, lane.data.known), fixed)
        slopes = jax.vmap(push)(jnp.eye(len(log_scale), dtype=point.dtype))
        residual, linear, variance = programs.residuals(
            predicted + jnp.tensordot(point - fixed, slopes, 1), point, lane.data
        )
        return residual, (fixed, linear, variance, predicted, slopes)

    solver = _StopOnStep()

    def one(point: Array, start: Array, movable: Array, frozen: Array, data: Data) -> tuple[Array, ...]:
        lane = _Lane(point, start, movable, frozen, data)
        solution: Any = optx.least_squares(
            cost, solver, start, lane, has_aux=True, max_steps=max_steps, throw=False
        )
        # The state's own record, because the solution's lags one step behind.
        residual = solution.state.f_info.residual
        ended, linear, variance, predicted, slopes = solution.state.aux
        good = (solution.result == optx.RESULTS.successful) & jnp.isfinite(residual @ residual)
        steps = solution.stats["num_steps"]
        return ended, residual @ residual, linear, variance, good, steps, predicted, slopes

    lanes, count = lane_count(problem), len(log_scale)
    number = problem.data.values.dtype
    kinds = [((lanes, count), number), ((lanes, count), number), ((lanes, count), bool), ((lanes,), bool)]
    shapes = [jax.ShapeDtypeStruct(shape, kind) for shape, kind in kinds]
    return jax.jit(jax.vmap(one, in_axes=(0, 0, 0, 0, None))).lower(*shapes, problem.data)


def lane_count(problem: Problem) -> int:
    """Starts per call: idle ones cost as much as busy ones, so a smooth average over angles has few."""
    if len(problem.nonlinear) > 1:
        return 8
    return 2 if isinstance(problem.scene.surface, vc.BeckmannGrooves) else 5


def prepare(problem: Problem, max_steps: int) -> None:
    """Begin to compile the polish in the background, while the grid is compiled and evaluated."""
    options = _CHEAP_TO_COMPILE if problem.programs.quick else None
    problem.programs.begin(f"polish {max_steps}", lambda: _lower(problem, max_steps), options)


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
    lanes = lane_count(problem)
    prepare(problem, max_steps)
    compiled = problem.programs.compiled[f"polish {max_steps}"].result()
    dtype = problem.data.values.dtype
    movable = np.ones(starts.shape, dtype=bool) if movable is None else movable
    inner = np.stack([p.unconstrained(starts[:, i]) for i, p in enumerate(problem.nonlinear)], axis=1)
    results = []
    for first in range(0, len(starts), lanes):
        # The last call is filled up with copies that stay where they are.
        chosen = np.minimum(np.arange(first, first + lanes), len(starts) - 1)
        idle = np.arange(first, first + lanes) >= len(starts)
        results.append(
            compiled(
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
