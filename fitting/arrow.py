"""Levenberg-Marquardt steps that use the structure: each free spectrum touches its own wavelength only.

The Jacobian of P numbers and Q spectra at U wavelengths is an arrow: P full columns, and U blocks of Q columns
each. Its products with itself are U small matrices, so that a step costs U (P + Q)² and not (P + QU)³, and the
derivatives cost P + Q pushes of the model and not P + QU.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from fitting.layout import Data, Layout, Part

CONVERGED, OUT_OF_STEPS, NO_NUMBER = 0, 1, 2
STATUS_WORDS = ("converged", "out of steps", "no number")

_FIRST_DAMPING = 1e-3
_LEAST_DAMPING = 1e-14
_MOST_DAMPING = 1e12
_COST_TOLERANCE = 1e-12
_SPECTRAL_STEP = 1e-10
_FEW = 4
_SETTLED = 1e-5
"""A step of a spectrum below which the numbers begin to move."""


class Lane(NamedTuple):
    """A single descent: where it starts and what may move.

    Args:
        natural: natural coordinates of the P numbers.
        spectra: shape (Q, U).
        movable: which numbers may move, shape (P,).
        spectra_movable: which values of the spectra may move, shape (Q, U).
        inner: most steps of the spectra alone, each wavelength by itself, before the numbers move.
        outer: most steps of all together.
    """

    natural: Array
    spectra: Array
    movable: Array
    spectra_movable: Array
    inner: Array
    outer: Array


class End(NamedTuple):
    """Where a descent ended.

    Args:
        natural: shape (P,).
        spectra: shape (Q, U).
        chi_square: with all priors.
        matrix: products of the columns of the Jacobian and the residual, shape (B, P + Q + 1, P + Q + 1), for
            the values at each of U wavelengths, or all values (B = 1) if no spectrum is free.
        status: ``CONVERGED``, ``OUT_OF_STEPS`` or ``NO_NUMBER``.
        steps: evaluations of the model and its derivatives.
        rejected: those that led uphill or to no number.
        predicted: recorded values of each measurement, shape (D, L).
    """

    natural: Array
    spectra: Array
    chi_square: Array
    matrix: Array
    status: Array
    steps: Array
    rejected: Array
    predicted: tuple[Array, ...]


def linearized(
    layout: Layout, natural: Float[Array, " p"], spectra: Float[Array, "q u"], data: Data
) -> tuple[Float[Array, "b m m"], tuple[Array, ...]]:
    """Products of the weighted Jacobian and residual, block by block, and the predictions.

    The model is pushed once for each number it depends on and once for each real spectrum: one tangent of ones
    serves all wavelengths. What follows the model (forms of spectra, the instrument) is cheap and is
    differentiated by itself.
    """
    width = natural.shape[0] + layout.free_spectra + 1
    total = jnp.zeros((layout.blocks, width, width), natural.dtype)
    predictions = []
    for part, values, weights, mean, known in zip(
        layout.parts, data.values, data.weights, data.means, data.known, strict=True
    ):
        predicted, columns = derivatives(layout, part, natural, spectra, known, mean)
        rows = jnp.concatenate([columns, (predicted - values)[..., None]], axis=-1) * weights[..., None]
        products = jnp.einsum("dwi,dwj->wij", rows, rows)
        total = total.at[part.places].add(products) if layout.free_spectra else total + products.sum(axis=0)
        predictions.append(predicted)
    if layout.free_spectra:
        total = total + _spectral_priors(layout, spectra, data, width)
    return total, tuple(predictions)


def derivatives(
    layout: Layout, part: Part, natural: Array, spectra: Array, known: tuple[Array, ...], mean: Array
) -> tuple[Array, Array]:
    """Recorded values of one measurement, shape (D, L), and their derivatives.

    Args:
        layout: of the fit.
        part: the measurement's share of it.
        natural: natural coordinates of the P numbers.
        spectra: free spectra, shape (Q, U).
        known: numbers of the scene that are neither free nor compiled in.
        mean: of the measured spectrum in each direction, shape (D,).

    Returns:
        The values, and their derivatives with respect to the P numbers and the Q spectra, shape (D, L, P + Q).
    """
    numbers, rows = layout.inputs(part, natural, spectra)
    count, channels = numbers.shape[0], rows.shape[0]

    def model(numbers: Array, rows: Array) -> Array:
        return layout.factor(part, numbers, rows, known)

    if count + channels:
        factor, push = jax.linearize(model, numbers, rows)
        every = jnp.eye(count + channels, dtype=natural.dtype)
        ones = jnp.ones_like(rows)
        slopes = jax.vmap(lambda e: push(e[:count], e[count:, None] * ones))(every)
    else:
        factor = model(numbers, rows)
        slopes = jnp.zeros((0, *factor.shape), factor.dtype)

    def cheap(natural: Array, spectra: Array) -> Array:
        near_numbers, near_rows = layout.inputs(part, natural, spectra)
        near = factor + jnp.tensordot(near_numbers - numbers, slopes[:count], 1)
        near = near + jnp.sum((near_rows - rows)[:, None, :] * slopes[count:], axis=0)
        return layout.recorded(part, near, natural, mean)

    predicted, push = jax.linearize(cheap, natural, spectra)
    columns = []
    if natural.shape[0]:
        still = jnp.zeros_like(spectra)
        columns.append(jax.vmap(lambda e: push(e, still))(jnp.eye(natural.shape[0], dtype=natural.dtype)))
    if layout.free_spectra:
        still, ones = jnp.zeros_like(natural), jnp.ones_like(spectra)
        rows_of_one = jnp.eye(layout.free_spectra, dtype=natural.dtype)
        columns.append(jax.vmap(lambda e: push(still, e[:, None] * ones))(rows_of_one))
    return predicted, jnp.moveaxis(jnp.concatenate(columns), 0, -1)


def _spectral_priors(layout: Layout, spectra: Array, data: Data, width: int) -> Array:
    """What the priors of free spectra add to the products."""
    first = width - 1 - layout.free_spectra
    tightness = data.spectral_tightness
    residual = tightness * (spectra - data.spectral_center)
    rows = jnp.zeros((spectra.shape[1], layout.free_spectra, width), spectra.dtype)
    each = jnp.arange(layout.free_spectra)
    rows = rows.at[:, each, first + each].set(tightness.T).at[:, :, -1].set(residual.T)
    return jnp.einsum("uqi,uqj->uij", rows, rows)


class _State(NamedTuple):
    natural: Array
    spectra: Array
    trial: Array
    trial_spectra: Array
    matrix: Array
    cost: Array
    damping: Array
    own_damping: Array
    apart: Array
    inner: Array
    outer: Array
    steps: Array
    rejected: Array
    done: Array
    status: Array
    predicted: tuple[Array, ...]


def descend(layout: Layout, lane: Lane, data: Data) -> End:
    """Minimize chi-square from a start, within bounds, by steps that no kink can trap.

    First the spectra move alone, each wavelength with its own damping, because far from the minimum one of them
    must not hold up the others. Then all move together. A bound is an active constraint, not a wall that a
    transformation puts at infinity: a minimum may lie on it. At a kink the gradient does not vanish, so that the
    descent stops on its step or on the cost, never on the gradient.
    """
    count, free = layout.logarithmic, layout.free_spectra
    numbers, dtype = len(count), lane.natural.dtype
    width = numbers + free + 1
    lower, upper = data.bounds
    bottom, top = (bound[:, None] for bound in data.spectral_bounds)
    infinite = jnp.asarray(jnp.inf, dtype)

    def prior_cost(natural: Array) -> Array:
        residuals = layout.prior_residuals(natural, data)
        return residuals @ residuals

    def body(state: _State) -> _State:
        found, predicted = linearized(layout, state.trial, state.trial_spectra, data)
        first = state.steps == 0
        cost = jnp.sum(found[:, -1, -1]) + prior_cost(state.trial)
        usable = jnp.isfinite(cost)
        each_better = found[:, -1, -1] <= state.matrix[:, -1, -1]
        better = usable & (cost < state.cost)
        taken = jnp.where(first, usable, jnp.where(state.apart, each_better, better))
        matrix = jnp.where(taken[:, None, None], found, state.matrix)
        spectra = jnp.where(taken[None], state.trial_spectra, state.spectra) if free else state.spectra
        natural = jnp.where(first | better & ~state.apart, state.trial, state.natural)
        kept = tuple(
            jnp.where(taken[part.places] if free else taken, new, old)
            for part, new, old in zip(layout.parts, predicted, state.predicted, strict=True)
        )
        new_cost = jnp.sum(matrix[:, -1, -1]) + prior_cost(natural)
        stalled = better & ~first & ~state.apart & (state.cost - cost <= _COST_TOLERANCE * cost)

        grown = jnp.where(better, state.damping / 10, state.damping * 5)
        damping = jnp.where(first | state.apart, state.damping, jnp.maximum(grown, _LEAST_DAMPING))
        own = jnp.where(each_better, state.own_damping / 10, state.own_damping * 5)
        own = jnp.where(first | ~state.apart, state.own_damping, jnp.clip(own, _LEAST_DAMPING, _MOST_DAMPING))

        # The steps from what is kept now.
        movable = _unblocked(lane.spectra_movable, spectra, bottom, top, matrix, numbers)
        alone = _own_step(matrix, own, movable, numbers) if free else spectra
        steps, together = _arrow_step(layout, matrix, natural, damping, lane.movable, movable, data)
        inner = state.inner + state.apart.astype(jnp.int32)
        outer = state.outer + (~state.apart).astype(jnp.int32)
        settled = inner >= lane.inner
        if free:
            settled = settled | (jnp.max(jnp.abs(alone)) < _SETTLED)
        apart = state.apart & ~settled
        trial = jnp.where(apart, natural, jnp.clip(natural + steps, lower, upper))
        trial_spectra = spectra
        if free:
            trial_spectra = jnp.clip(spectra + jnp.where(apart, alone, together), bottom, top)
        short = jnp.all(jnp.abs(trial - natural) < data.step)
        if free:
            short = short & jnp.all(jnp.abs(trial_spectra - spectra) < _SPECTRAL_STEP)
        stuck = damping >= _MOST_DAMPING
        converged = ~apart & (short | stalled | stuck)
        spent = ~apart & (outer >= lane.outer)
        lost = first & ~usable
        status = jnp.where(lost, NO_NUMBER, jnp.where(converged, CONVERGED, OUT_OF_STEPS))
        return _State(
            natural=natural,
            spectra=spectra,
            trial=trial,
            trial_spectra=trial_spectra,
            matrix=matrix,
            cost=jnp.where(usable | ~first, new_cost, infinite),
            damping=damping,
            own_damping=own,
            apart=apart,
            inner=inner,
            outer=outer,
            steps=state.steps + 1,
            rejected=state.rejected + (~first & ~state.apart & ~better).astype(jnp.int32),
            done=converged | spent | lost,
            status=status.astype(jnp.int32),
            predicted=kept,
        )

    integer = jnp.zeros((), jnp.int32)
    start = _State(
        natural=lane.natural,
        spectra=lane.spectra,
        trial=lane.natural,
        trial_spectra=lane.spectra,
        matrix=jnp.full((layout.blocks, width, width), jnp.inf, dtype),
        cost=infinite,
        damping=jnp.full((), _FIRST_DAMPING, dtype),
        own_damping=jnp.full((layout.blocks,), _FIRST_DAMPING, dtype),
        apart=lane.inner > 0 if free else jnp.zeros((), bool),
        inner=integer,
        outer=integer,
        steps=integer,
        rejected=integer,
        done=jnp.zeros((), bool),
        status=integer,
        predicted=tuple(jnp.full(part.shape, jnp.nan, dtype) for part in layout.parts),
    )
    end = jax.lax.while_loop(lambda state: ~state.done, body, start)
    return End(end.natural, end.spectra, end.cost, end.matrix, end.status, end.steps, end.rejected, end.predicted)


def _unblocked(
    movable: Bool[Array, "q u"],
    spectra: Float[Array, "q u"],
    bottom: Float[Array, "q 1"],
    top: Float[Array, "q 1"],
    matrix: Float[Array, "u m m"],
    numbers: int,
) -> Bool[Array, "q u"]:
    """Values of the spectra that may move, are not pressed against a bound, and that the data depend on."""
    slope = matrix[:, numbers:-1, -1].T
    sensitive = jnp.diagonal(matrix[:, numbers:-1, numbers:-1], axis1=1, axis2=2).T > 0
    pressed = (spectra <= bottom) & (slope > 0) | (spectra >= top) & (slope < 0)
    return movable & sensitive & ~pressed


def _own_step(
    matrix: Float[Array, "u m m"], damping: Float[Array, " u"], movable: Bool[Array, "q u"], numbers: int
) -> Float[Array, "q u"]:
    """The step of each wavelength by itself, the numbers held."""
    inverse_times = _solved(matrix[:, numbers:-1, numbers:-1], damping, movable, matrix[:, numbers:-1, -1:])
    return -inverse_times[..., 0].T


def _solved(
    square: Float[Array, "u q q"], damping: Float[Array, " u"], movable: Bool[Array, "q u"], right: Array
) -> Array:
    """Damped solution of small positive systems; zero for what does not move."""
    moves = movable.T
    both = moves[:, :, None] & moves[:, None, :]
    size = square.shape[-1]
    one = jnp.eye(size, dtype=square.dtype)
    damped = square * (1 + damping[:, None, None] * one)
    damped = jnp.where(both, damped, jnp.broadcast_to(one, damped.shape))
    right = jnp.where(moves[:, :, None], right, jnp.zeros_like(right))
    return _eliminated(damped, right)


def _eliminated(square: Array, right: Array) -> Array:
    """Gauss elimination without pivots: positive systems need none, and small ones no library call."""
    size = square.shape[-1]
    for k in range(size):
        for i in range(k + 1, size):
            ratio = square[:, i, k] / square[:, k, k]
            square = square.at[:, i].add(-ratio[:, None] * square[:, k])
            right = right.at[:, i].add(-ratio[:, None] * right[:, k])
    solution: list[Array] = []
    for k in reversed(range(size)):
        rest = right[:, k]
        for i, known in zip(range(size - 1, k, -1), solution, strict=True):
            rest = rest - square[:, k, i, None] * known
        solution.append(rest / square[:, k, k, None])
    return jnp.stack(solution[::-1], axis=1)


def _arrow_step(
    layout: Layout,
    matrix: Float[Array, "b m m"],
    natural: Float[Array, " p"],
    damping: Float[Array, ""],
    movable: Bool[Array, " p"],
    spectra_movable: Bool[Array, "q u"],
    data: Data,
) -> tuple[Float[Array, " p"], Float[Array, "q u"]]:
    """The step of numbers and spectra together: the spectra are eliminated, wavelength by wavelength."""
    numbers = natural.shape[0]
    blocks, free = matrix.shape[0], layout.free_spectra
    nothing = jnp.zeros((free, blocks), matrix.dtype)
    residual, push = jax.linearize(lambda n: layout.prior_residuals(n, data), natural)
    slope = push(jnp.ones_like(natural))
    whole = matrix.sum(axis=0)
    square = whole[:numbers, :numbers] + jnp.diag(slope * slope)
    right = whole[:numbers, -1] + slope * residual
    lengths = jnp.diagonal(square)
    lower, upper = data.bounds
    pressed = (natural <= lower) & (right > 0) | (natural >= upper) & (right < 0)
    moves = movable & ~pressed & (lengths > 0)
    damped = square + jnp.diag(damping * lengths)
    if free:
        columns = jnp.concatenate([matrix[:, numbers:-1, :numbers], matrix[:, numbers:-1, -1:]], axis=-1)
        each = jnp.full((blocks,), 1.0, matrix.dtype) * damping
        eliminated = _solved(matrix[:, numbers:-1, numbers:-1], each, spectra_movable, columns)
        crossed = jnp.einsum("upq,uqk->pk", matrix[:, :numbers, numbers:-1], eliminated)
        damped = damped - crossed[:, :numbers]
        right = right - crossed[:, -1]
    step = jnp.zeros_like(natural)
    if numbers:
        scale = jnp.where(
            moves, jnp.sqrt(jnp.where(moves, lengths, jnp.ones_like(lengths))), jnp.ones_like(lengths)
        )
        both = moves[:, None] & moves[None, :]
        scaled = jnp.where(both, damped / (scale[:, None] * scale), jnp.eye(numbers, dtype=matrix.dtype))
        scaled_right = jnp.where(moves, right / scale, jnp.zeros_like(right))
        if numbers <= _FEW:
            solution = _eliminated(scaled[None], scaled_right[None, :, None])[0, :, 0]
        else:
            solution = jnp.linalg.solve(scaled, scaled_right)
        # A matrix that rounding made singular gives no number: then nothing moves, and the damping grows.
        step = jnp.where(jnp.isfinite(solution), -solution / scale, jnp.zeros_like(solution))
    if not free:
        return step, nothing
    spectral = -(eliminated[..., -1] + eliminated[..., :numbers] @ step)
    return step, spectral.T
