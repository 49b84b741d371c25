"""What is compiled of a scene: the model, and its chi-square with gain and offset eliminated.

The known directions and surface of a scene are compiled in, because the model picks cheaper paths for them;
the material is passed on. Programs are kept, so that the next fit of the same kind of scene, with the same
directions, starts at once, whatever its material.
"""

from collections import OrderedDict
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import vcavity_jax as vc

CHUNK = 32
"""Parameter vectors per call of the compiled model: few, lest wide grooves wait for narrow ones."""


class Data(NamedTuple):
    """All numbers that may change without a new compilation.

    Args:
        values: measured reflectance factors, 0 where missing, shape (D, L).
        weights: inverse standard uncertainties, 0 where missing, shape (D, L).
        prior_mean: of the P nonlinear parameters, then gain and offset, shape (P + 2,).
        prior_weight: inverse standard deviations of the priors, 0 for none, shape (P + 2,).
        bounds: natural coordinates of the P lower, then the P upper bounds, shape (2, P).
        step: steps in the natural coordinates at which a polish stops, shape (P,).
        known: numbers of the scene that are neither free nor compiled in.
    """

    values: Array
    weights: Array
    prior_mean: Array
    prior_weight: Array
    bounds: Array
    step: Array
    known: tuple[Array, ...]


def eliminate(
    target: Float[Array, " rows"], columns: Sequence[Float[Array, " rows"]]
) -> tuple[Float[Array, " rows"], list[Array], list[Array]]:
    """Least squares of a target on at most two columns by Gram-Schmidt, differentiable.

    Returns:
        The residual, the coefficients and their variances. A column that adds nothing to the one before it
        has the coefficient 0 and an infinite variance.
    """
    if not columns:
        return target, [], []
    infinite = jnp.asarray(jnp.inf, target.dtype)
    first = columns[0]
    norm = first @ first
    zero = norm == 0
    inverse = jnp.where(zero, jnp.zeros_like(norm), 1 / jnp.where(zero, jnp.ones_like(norm), norm))
    projection = inverse * (first @ target)
    if len(columns) == 1:
        return target - first * projection, [projection], [jnp.where(zero, infinite, inverse)]
    shadow = inverse * (first @ columns[1])
    second = columns[1] - first * shadow
    rest = second @ second
    flat = rest <= 1e-13 * (columns[1] @ columns[1])
    inverse_rest = jnp.where(flat, jnp.zeros_like(rest), 1 / jnp.where(flat, jnp.ones_like(rest), rest))
    other = inverse_rest * (second @ target)
    residual = target - first * projection - second * other
    variances = [
        jnp.where(zero | (flat & (shadow != 0)), infinite, inverse + shadow * shadow * inverse_rest),
        jnp.where(flat, infinite, inverse_rest),
    ]
    return residual, [projection - shadow * other, other], variances


def project(
    predicted: Array, prior_residuals: Array, data: Data, roles: tuple[str, ...]
) -> tuple[Array, Array, Array]:
    """Weighted residuals after the best gain and offset, these two, and their conditional variances.

    Args:
        predicted: the model without gain and offset, shape (D, L).
        prior_residuals: of the nonlinear parameters, shape (P,).
        data: the numbers.
        roles: which of "gain" and "offset" are free, in this order.
    """
    zero, one = jnp.zeros((), predicted.dtype), jnp.ones((), predicted.dtype)
    gain_prior, offset_prior = data.prior_weight[-2], data.prior_weight[-1]
    target = (data.weights * data.values).ravel()
    shining = (data.weights * predicted).ravel()
    tail = jnp.stack([data.prior_mean[-2] * gain_prior, data.prior_mean[-1] * offset_prior])
    columns = []
    if "gain" in roles:
        columns.append(jnp.concatenate([shining, jnp.stack([gain_prior, zero])]))
    else:
        target = target - shining
    if "offset" in roles:
        columns.append(jnp.concatenate([data.weights.ravel(), jnp.stack([zero, offset_prior])]))
    residual, found, spread = eliminate(jnp.concatenate([target, tail]), columns)
    values = dict(zip(roles, found, strict=True))
    variances = dict(zip(roles, spread, strict=True))
    return (
        jnp.concatenate([residual, prior_residuals]),
        jnp.stack([values.get("gain", one), values.get("offset", zero)]),
        jnp.stack([variances.get("gain", zero), variances.get("offset", zero)]),
    )


@dataclass(frozen=True, eq=False)
class Programs:
    """The model of one kind of scene and what is compiled of it.

    Args:
        model: parameters in the scene's units, shape (P,), and ``Data.known`` to reflectance factors, shape
            (D, L).
        logarithmic: which of the P parameters are searched by their logarithm.
        roles: which of "gain" and "offset" are free.
        quick: so few values are predicted that compiling a polish takes longer than running it.
        compiled: by name; each is ready, or becomes so in the background.
    """

    model: Callable[[Array, tuple[Array, ...]], Array]
    logarithmic: tuple[bool, ...]
    roles: tuple[str, ...]
    quick: bool
    compiled: dict[str, Future[Any]] = field(default_factory=dict)

    def residuals(self, predicted: Array, values: Array, data: Data) -> tuple[Array, Array, Array]:
        """``project`` with the priors of the nonlinear parameters put in."""
        count = len(self.logarithmic)
        free = data.prior_weight[:count] * (data.prior_mean[:count] - values)
        return project(predicted, free, data, self.roles)

    def begin(self, name: str, lower: Callable[[], Any], options: dict[str, Any] | None = None) -> None:
        """Compile a program in the background, unless that has been done.

        It is traced here, because JAX's settings belong to a thread; only XLA's work moves to another one.
        """
        if name not in self.compiled:
            self.compiled[name] = _WORKERS.submit(_compile, lower(), options)

    def begin_chunk(self, data: Data) -> None:
        """Compile chi-square, gain and offset, and their variances, of ``CHUNK`` parameter vectors."""

        def one(values: Array, data: Data) -> tuple[Array, Array, Array]:
            residual, linear, variance = self.residuals(self.model(values, data.known), values, data)
            return residual @ residual, linear, variance

        shape = jax.ShapeDtypeStruct((CHUNK, len(self.logarithmic)), data.values.dtype)
        self.begin("chunk", lambda: jax.jit(jax.vmap(one, in_axes=(0, None))).lower(shape, data))

    def begin_alone(self, data: Data) -> None:
        """Compile chi-square, gain and offset, their variances, and the model, if nothing else is free."""

        def alone(data: Data) -> tuple[Array, ...]:
            nothing = jnp.zeros(0, data.values.dtype)
            predicted = self.model(nothing, data.known)
            residual, linear, variance = self.residuals(predicted, nothing, data)
            return residual @ residual, linear, variance, predicted

        self.begin("alone", lambda: jax.jit(alone).lower(data))

    def chunk(self, data: Data) -> Any:
        """The program of ``begin_chunk``."""
        self.begin_chunk(data)
        return self.compiled["chunk"].result()


_WORKERS = ThreadPoolExecutor(max_workers=2, thread_name_prefix="compile")
_KEPT: OrderedDict[Any, Programs] = OrderedDict()
_MOST_KEPT = 8
_QUICK_VALUES = 2000


def _compile(lowered: Any, options: dict[str, Any] | None) -> Any:
    if options and jax.default_backend() == "cpu":
        try:
            return lowered.compile(compiler_options=options)
        except (RuntimeError, ValueError):
            pass  # Another version of XLA may not know them: they only save time.
    return lowered.compile()


def programs_for(
    scene: Any,
    slots: Sequence[int],
    passed: Sequence[int],
    scales: tuple[str, ...],
    roles: tuple[str, ...],
    tolerance: float,
    smallest: tuple[float | None, float | None],
    shape: tuple[int, ...],
    place: Callable[[Sequence[Any], Sequence[Any]], Any],
) -> Programs:
    """The programs of a kind of scene, new or kept from an earlier fit.

    Args:
        scene: with the measurement's view.
        slots: which leaves of the scene are free.
        passed: which leaves are neither free nor compiled in.
        scales: "linear" or "log" for each of them.
        roles: which of "gain" and "offset" are free.
        tolerance: bound on the model's numerical error.
        smallest: dihedral angle, radians, and index of an interface, for each that is free.
        shape: (D, L) of the measurement.
        place: puts free values and those passed on into the scene.

    Raises:
        ValueError: the scene cannot be evaluated, or its wavelengths are not the measurement's.
    """
    leaves, tree = jax.tree.flatten(scene)
    known = tuple(
        (
            None if i in slots or i in passed else np.asarray(leaf).tobytes(),
            np.shape(leaf),
            str(np.asarray(leaf).dtype),
        )
        for i, leaf in enumerate(leaves)
    )
    dtype = jnp.result_type(float)
    key = (
        tree,
        known,
        tuple(slots),
        tuple(passed),
        scales,
        roles,
        tolerance,
        smallest,
        shape,
        str(dtype),
    )
    if key in _KEPT:
        _KEPT.move_to_end(key)
        return _KEPT[key]

    angle, index = smallest
    evaluate = partial(vc.reflectance_factor, tolerance=tolerance, smallest_angle=angle, smallest_index=index)

    def model(values: Array, others: tuple[Array, ...]) -> Array:
        factor = evaluate(place([values[i] for i in range(len(slots))], others))
        # A hemispherical view has no axis of directions, a gray material none of wavelengths.
        return jnp.broadcast_to(jnp.reshape(factor, (shape[0], -1)), shape)

    numbers = [jax.ShapeDtypeStruct((), dtype) for _ in slots]
    others = [leaves[i] for i in passed]
    full = jax.eval_shape(lambda v, k: evaluate(place(v, k)), numbers, others)
    found = full.shape[len(scene.view.shape) :]
    if found not in ((), (shape[1],)):
        raise ValueError(
            f"the material has wavelength shape {found}, the measurement {shape[1]} wavelengths; expected () "
            f"or ({shape[1]},): tabulate the material at the measurement's wavelengths"
        )
    quick = int(np.prod(shape)) <= _QUICK_VALUES
    _KEPT[key] = Programs(model, tuple(scale == "log" for scale in scales), roles, quick)
    while len(_KEPT) > _MOST_KEPT:
        _KEPT.popitem(last=False)
    return _KEPT[key]
