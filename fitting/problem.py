"""From a scene, a measurement and free parameters to weighted residuals, compiled once per kind of scene.

Gain and offset enter linearly. They are eliminated exactly at every point of the search (variable
projection), so that only the scene's own parameters are searched. Missing values have weight zero.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

import vcavity_jax as vc
from fitting.measurement import Measurement
from fitting.parameters import Parameter
from fitting.programs import CHUNK, Data, Programs, programs_for
from vcavity_jax.planning import interfaced_panel
from vcavity_jax.resolution import INTERFACED_NARROWEST, NARROWEST

MOST_NONLINEAR = 3
_FIRST_GUESS = 0.01


class Evaluation(NamedTuple):
    """Chi-square with gain and offset eliminated, at n parameter vectors.

    Args:
        parameters: shape (n, P).
        chi_square: shape (n,).
        linear: best gain and offset, shape (n, 2); 1 and 0 where they are not free.
        variance: their variances at fixed nonlinear parameters, shape (n, 2).
    """

    parameters: np.ndarray
    chi_square: np.ndarray
    linear: np.ndarray
    variance: np.ndarray


@dataclass(frozen=True, eq=False)
class Problem:
    """A fit, ready to be evaluated.

    Args:
        scene: with the measurement's view.
        measurement: what is fitted, with the standard uncertainty that the fit uses.
        nonlinear: the free parameters of the scene.
        linear: gain, offset, both or none, in this order.
        is_angle: which nonlinear parameter is the dihedral angle, None if none is.
        data: the numbers.
        programs: the model and what is compiled of it.
        place: puts the nonlinear parameters, and ``data.known``, into the scene.
    """

    scene: Any
    measurement: Measurement
    nonlinear: tuple[Parameter, ...]
    linear: tuple[Parameter, ...]
    is_angle: int | None
    data: Data
    programs: Programs
    place: Callable[[Sequence[Any], Sequence[Any]], Any]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """All free parameters, the nonlinear ones first."""
        return self.nonlinear + self.linear

    @property
    def linear_slots(self) -> list[int]:
        """Columns of ``Evaluation.linear`` that are free."""
        return [("gain", "offset").index(p.role) for p in self.linear]

    @property
    def degrees_of_freedom(self) -> int:
        """Values and priors less free parameters."""
        used = int(np.sum(np.asarray(self.data.weights) > 0))
        return used + sum(p.prior is not None for p in self.parameters) - len(self.parameters)

    def with_uncertainty_scaled(self, factor: float) -> "Problem":
        """The same problem with all standard uncertainties multiplied by a factor; priors stay."""
        sigma = self.measurement.standard_uncertainty
        assert sigma is not None
        return dataclasses.replace(
            self,
            measurement=dataclasses.replace(self.measurement, standard_uncertainty=sigma * factor),
            data=self.data._replace(weights=self.data.weights / jnp.asarray(factor, self.data.weights.dtype)),
        )

    def evaluate(self, parameters: Float[np.ndarray, "n p"]) -> Evaluation:
        """Chi-square, gain and offset at many parameter vectors, in the scene's units."""
        points = np.asarray(parameters, dtype=np.float64).reshape(-1, len(self.nonlinear))
        if not len(points):
            return Evaluation(points, np.empty(0), np.empty((0, 2)), np.empty((0, 2)))
        # Narrow grooves need many reflections, and a chunk waits for its slowest member.
        order = np.lexsort(points.T[:: -1 if self.is_angle is None else 1])
        padded = points[np.append(order, np.repeat(order[-1:], -len(order) % CHUNK))]
        # Cut up by NumPy: each slice of a JAX array would be one more small program to compile.
        chunks = padded.astype(self.data.values.dtype).reshape(-1, CHUNK, points.shape[1])
        compiled = self.programs.chunk(self.data)
        results = [compiled(chunk, self.data) for chunk in chunks]
        columns = zip(*results, strict=True)
        parts = [np.concatenate([np.asarray(part) for part in column]) for column in columns]
        back = np.argsort(order, kind="stable")
        chi_square, linear, variance = (np.asarray(part[: len(order)][back], np.float64) for part in parts)
        return Evaluation(points, chi_square, linear, variance)

    def alone(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Chi-square, gain and offset, their variances and the model, if no parameter of the scene is free.

        Each has a first axis of length 1, as if there were one parameter vector.
        """
        self.programs.begin_alone(self.data)
        parts = self.programs.compiled["alone"].result()(self.data)
        chi_square, linear, variance, predicted = (np.asarray(part, np.float64)[None] for part in parts)
        return chi_square, linear, variance, predicted

    def fitted_scene(self, values: Float[np.ndarray, " p"]) -> Any:
        """The scene with the nonlinear parameters put in."""
        dtype = self.data.values.dtype
        return self.place([jnp.asarray(value, dtype) for value in values], self.data.known)

    def jacobian(
        self, predicted: Float[np.ndarray, "d l"], slopes: Float[np.ndarray, "p d l"]
    ) -> Float[np.ndarray, "rows parameters"]:
        """Derivative of the residuals with respect to all parameters, at unit gain; priors have a row each.

        Args:
            predicted: the model's reflectance factor without gain and offset.
            slopes: derivative of the prediction with respect to the nonlinear parameters.
        """
        weights = np.asarray(self.data.weights, np.float64)
        columns = [weights * slope for slope in slopes]
        columns += [weights * (predicted if p.role == "gain" else 1.0) for p in self.linear]
        data_rows = np.stack([column.ravel() for column in columns], axis=1)
        own = [0.0 if p.prior is None else 1 / p.prior[1] for p in self.parameters]
        return np.concatenate([data_rows, np.diag(own)])


def build(
    scene: Any,
    measurement: Measurement,
    parameters: Sequence[Parameter],
    standard_uncertainty: float | int | None,
    tolerance: float,
) -> Problem:
    """Check a fit's inputs and make it ready.

    Args:
        scene: any view; its illumination must be the measurement's.
        measurement: what is fitted.
        parameters: at most three of the scene, and gain and offset at will; at least one in all.
        standard_uncertainty: fraction; takes precedence over the measurement's own; None for that.
        tolerance: bound on the model's numerical error.

    Raises:
        ValueError: anything that does not fit together, in one line.
    """
    nonlinear, linear = _sorted_parameters(parameters)
    _check_light(scene.illumination, measurement.illumination)
    scene = vc.Scene(scene.surface, scene.material, scene.illumination, measurement.view)
    slots = [_slot(scene, parameter) for parameter in nonlinear]
    for i, slot in enumerate(slots):
        if slot in slots[:i]:
            raise ValueError(
                f"parameters {nonlinear[slots.index(slot)].name!r} and {nonlinear[i].name!r} are the same "
                "number of the scene; expected each number once"
            )
    leaves, tree = jax.tree.flatten(scene)
    known = _passed_on(scene, slots)

    def place(values: Sequence[Any], others: Sequence[Any]) -> Any:
        filled = list(leaves)
        for slot, value in zip((*slots, *known), (*values, *others), strict=True):
            filled[slot] = value
        return jax.tree.unflatten(tree, filled)

    fixed = tuple(leaves[i] for i in known)
    for index, parameter in enumerate(nonlinear):
        for bound in (parameter.lower, parameter.upper):
            inside = [np.asarray(leaves[s]) for s in slots]
            inside[index] = np.asarray(bound)
            _recheck(place(inside, fixed), f"parameter {parameter.name!r} at its bound: ")
    is_angle = None
    if isinstance(scene.surface, vc.VGrooves):
        angle = next(i for i, leaf in enumerate(leaves) if leaf is scene.surface.angle)
        is_angle = slots.index(angle) if angle in slots else None
    measurement = _with_uncertainty(measurement, standard_uncertainty)
    data = _data(measurement, nonlinear, linear, fixed)
    roles = tuple(p.role for p in linear)
    scales = tuple(p.scale for p in nonlinear)
    smallest_angle = None if is_angle is None else nonlinear[is_angle].lower
    smallest_index = _smallest_index(scene, slots, nonlinear)
    narrowest = NARROWEST if interfaced_panel(scene.material) is None else INTERFACED_NARROWEST
    if smallest_angle is not None and smallest_angle < narrowest:
        raise ValueError(
            f"dihedral angles from {math.degrees(smallest_angle):g} degrees; expected a lower bound of at least "
            f"{math.degrees(narrowest):g} degrees, the narrowest groove that is modeled"
        )
    programs = programs_for(
        scene, slots, known, scales, roles, tolerance, (smallest_angle, smallest_index), data.values.shape, place
    )
    problem = Problem(scene, measurement, nonlinear, linear, is_angle, data, programs, place)
    if problem.degrees_of_freedom < 0:
        raise ValueError(
            f"{int(np.sum(np.asarray(data.weights) > 0))} measured values for {len(parameters)} free "
            "parameters; expected at least as many values and priors as free parameters"
        )
    return problem


def _sorted_parameters(
    parameters: Sequence[Parameter],
) -> tuple[tuple[Parameter, ...], tuple[Parameter, ...]]:
    if isinstance(parameters, Parameter) or not all(isinstance(p, Parameter) for p in parameters):
        raise ValueError("parameters are not a list of Parameter; expected, say, [free.angle(), free.gain()]")
    names = [p.name for p in parameters]
    repeated = next((name for name in names if names.count(name) > 1), None)
    if repeated is not None:
        raise ValueError(f"parameter {repeated!r} is given twice; expected distinct names")
    nonlinear = tuple(p for p in parameters if p.role == "scene")
    linear = tuple(sorted((p for p in parameters if p.role != "scene"), key=lambda p: p.role))
    if len({p.role for p in linear}) < len(linear):
        raise ValueError("gain or offset is given twice; expected each at most once")
    if not parameters:
        raise ValueError("no parameter is free; expected at least one, say free.angle()")
    if len(nonlinear) > MOST_NONLINEAR:
        raise ValueError(
            f"{len(nonlinear)} parameters of the scene are free ({', '.join(p.name for p in nonlinear)}); "
            f"expected at most {MOST_NONLINEAR}, because all their range is searched "
            "(gain and offset are extra)"
        )
    return nonlinear, linear


def _check_light(scene: Any, measured: Any) -> None:
    mine, theirs = jax.tree.leaves(scene), jax.tree.leaves(measured)
    same = type(scene) is type(measured) and len(mine) == len(theirs)
    if same:
        pairs = zip(mine, theirs, strict=True)
        same = all(np.allclose(np.asarray(a), np.asarray(b), rtol=0, atol=1e-6) for a, b in pairs)
    if not same:
        raise ValueError(
            f"the scene is lit by {_short(scene)}, the measurement by {_short(measured)}; expected the same "
            "illumination: set it in the scene, or correct the measurement's"
        )


def _short(light: Any) -> str:
    numbers = ", ".join(f"{float(leaf):.6g}" for leaf in jax.tree.leaves(light))
    return f"{type(light).__name__}({numbers})"


def _slot(scene: Any, parameter: Parameter) -> int:
    """Which leaf of the scene a parameter is."""
    assert parameter.where is not None
    try:
        target = parameter.where(scene)
        marked = eqx.tree_at(parameter.where, scene, mark := _Mark())
    except (AttributeError, ValueError, TypeError, KeyError, IndexError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ValueError(
            f"parameter {parameter.name!r}: its place is not in this scene of {type(scene.surface).__name__} "
            f"and {type(scene.material).__name__} ({reason}); expected one number of the scene"
        ) from None
    if not eqx.is_array(target):
        raise ValueError(
            f"parameter {parameter.name!r}: its place holds a {type(target).__name__}; expected one number"
        )
    if target.shape != () or not jnp.issubdtype(target.dtype, jnp.floating):
        raise ValueError(
            f"parameter {parameter.name!r}: its place holds an array of shape {target.shape} and type "
            f"{target.dtype}; expected one real number"
        )
    return next(i for i, leaf in enumerate(jax.tree.leaves(marked)) if leaf is mark)


class _Mark:
    """Found again among the leaves of a scene."""


def _passed_on(scene: Any, slots: Sequence[int]) -> tuple[int, ...]:
    """Leaves of the scene that are handed to the compiled programs instead of being compiled in.

    They are the material's, so that other materials of the same kind need no new compilation. A real index
    stays in: the model must see that it is at least 1, and plans its work for it.
    """
    return tuple(
        i
        for i, (names, leaf) in enumerate(_named_leaves(scene))
        if names[0] == "material" and i not in slots and not (names[-1] == "index" and not jnp.iscomplexobj(leaf))
    )


def _named_leaves(scene: Any) -> list[tuple[tuple[str, ...], Any]]:
    """The leaves in the order of ``jax.tree.leaves``, each after the names that lead to it."""
    found = jax.tree.leaves_with_path(scene)
    return [(tuple(str(getattr(key, "name", key)) for key in path), leaf) for path, leaf in found]


def _smallest_index(scene: Any, slots: Sequence[int], nonlinear: Sequence[Parameter]) -> float | None:
    """The least index of an interface that is searched; None if none is."""
    if interfaced_panel(scene.material) is None:
        return None
    leaves = _named_leaves(scene)
    searched = [p.lower for slot, p in zip(slots, nonlinear, strict=True) if leaves[slot][0][-1] == "index"]
    return min(searched, default=None)


def _recheck(node: Any, prefix: str) -> None:
    """Let the scene's parts check a bound as they check a user's own numbers."""
    for field in dataclasses.fields(node):
        part = getattr(node, field.name)
        if isinstance(part, eqx.Module):
            _recheck(part, prefix)
    check = getattr(node, "__check_init__", None)
    if check is not None:
        try:
            check()
        except ValueError as error:
            raise ValueError(prefix + str(error)) from None


def _with_uncertainty(measurement: Measurement, standard_uncertainty: float | int | None) -> Measurement:
    """The measurement with the uncertainty that the fit uses, or a start for its estimate."""
    if standard_uncertainty is None and measurement.standard_uncertainty is not None:
        return measurement
    sigma = _FIRST_GUESS if standard_uncertainty is None else standard_uncertainty
    if not (isinstance(sigma, float | int) and 0 < sigma < math.inf):
        raise ValueError(f"standard_uncertainty is {sigma!r}; expected one positive number, as a fraction")
    full = np.full(measurement.reflectance_factor.shape, float(sigma))
    return dataclasses.replace(measurement, standard_uncertainty=full)


def _data(
    measurement: Measurement,
    nonlinear: tuple[Parameter, ...],
    linear: tuple[Parameter, ...],
    known: tuple[Any, ...],
) -> Data:
    values = measurement.reflectance_factor
    present = ~np.isnan(values)
    if not present.any():
        raise ValueError("the measurement holds no value (all are NaN); expected at least one")
    sigma = measurement.standard_uncertainty
    assert sigma is not None
    weights = np.where(present, 1 / np.where(present, sigma, 1.0), 0.0)
    own: dict[str, Parameter] = {p.role: p for p in linear}
    priors = [p.prior for p in nonlinear] + [own[r].prior if r in own else None for r in ("gain", "offset")]
    bounds = [[p.natural(p.lower) for p in nonlinear], [p.natural(p.upper) for p in nonlinear]]

    def array(numbers: Any) -> jax.Array:
        return jnp.asarray(np.asarray(numbers), jnp.result_type(float))

    return Data(
        values=array(np.where(present, values, 0.0)),
        weights=array(weights),
        prior_mean=array([0.0 if p is None else p[0] for p in priors]),
        prior_weight=array([0.0 if p is None else 1 / p[1] for p in priors]),
        bounds=array(bounds),
        step=array([p.step_tolerance for p in nonlinear]),
        known=known,
    )
