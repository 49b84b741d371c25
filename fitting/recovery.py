"""The reflectance of a material, recovered from what a grooved sample of known shape shows.

At each wavelength the reflectance factor rises with the reflectance of the panels, so the model is inverted by
one root per wavelength. Derivatives follow from the implicit function theorem, never from the iteration.
"""

import dataclasses
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from os import PathLike
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx  # type: ignore[import-untyped]
import numpy as np
import optimistix as optx
from jaxtyping import Array, ArrayLike, Float
from scipy.special import gammaincc  # type: ignore[import-untyped]

import vcavity_jax as vc
from fitting import files
from fitting.measurement import Measurement, check_light
from vcavity_jax import reflectance as forward
from vcavity_jax.planning import interfaced_panel
from vcavity_jax.resolution import INTERFACED_NARROWEST, NARROWEST

RECOVERED = "recovered"
BELOW = "below what reflectance 0 gives"
ABOVE = "above what reflectance 1 gives"
MISSING = "missing"
UNDETERMINED = "undetermined"

MOST_AMPLIFICATION = 10.0
"""Amplification of noise beyond which a warning says so."""

_MOST_STEPS = 64
_UNDETERMINED = 10
"""Range of the reflectance factor, in tolerances, below which it tells nothing about the reflectance."""

_BAD_FIT = 1e-3
_STEEP, _OBLIQUE = math.radians(32.0), math.radians(50.0)


@dataclass(frozen=True, eq=False)
class Recovery:
    """The reflectance of a material and how far it can be trusted, at L wavelengths from D directions.

    Args:
        scene: what was measured, with the recovered reflectance and the measurement's view put in.
        measurement: what it was recovered from.
        wavelengths_nm: nm, shape (L,).
        reflectance: of the panels' material, or of the material below their interface; fraction, shape (L,). NaN
            where the status is "missing" or "undetermined", the end of 0 to 1 where it lies beyond.
        standard_uncertainty: one standard deviation, from that of the measurement at the known angle, shape (L,);
            None if the measurement has none. An uncertainty of the angle comes on top: ``angle_sensitivity``.
        status: per wavelength, shape (L,), one of

            - "recovered";
            - "below what reflectance 0 gives", "above what reflectance 1 gives": the measured value lies outside
              what the model can give at any reflectance, which is set to 0 or 1;
            - "missing": no direction has a value;
            - "undetermined": the reflectance factor does not depend on the reflectance, below an opaque layer.
        predicted: the model's reflectance factors, shape (D, L).
        slope: derivative of these with respect to the reflectance at their wavelength, shape (D, L).
        amplification: standard uncertainty of the reflectance over that of one measured value, shape (L,). With
            directions of unequal uncertainty, that value's is the root of the mean of 1/σ², inverted.
        angle_sensitivity: change of the reflectance with the dihedral angle, per radian, or with the roughness of
            random grooves, per unit, shape (L,); 0 where it was set to an end of its range.
        warnings: every reason to doubt the result, one sentence each.
    """

    scene: Any
    measurement: Measurement
    wavelengths_nm: np.ndarray
    reflectance: np.ndarray
    standard_uncertainty: np.ndarray | None
    status: np.ndarray
    predicted: np.ndarray
    slope: np.ndarray
    amplification: np.ndarray
    angle_sensitivity: np.ndarray
    warnings: tuple[str, ...]

    def summary(self) -> str:
        """Where it could be recovered, how well, and every warning, as text."""
        good = np.isfinite(self.reflectance)
        views = "all light collected" if self.measurement.hemispherical else _count(len(self.slope), "direction")
        lines = [
            f"reflectance recovered at {int(np.sum(self.status == RECOVERED))} of "
            f"{_count(good.size, 'wavelength')}, {_span(self.wavelengths_nm)}, from {views}"
        ]
        if good.any():
            lines.append(f"reflectance            {_range(self.reflectance[good])}")
            if self.standard_uncertainty is not None:
                lines.append(f"standard uncertainty   {_range(self.standard_uncertainty[good])}")
            lines.append(f"amplification of noise {_range(self.amplification[good])}")
            single = isinstance(self.scene.surface, vc.VGrooves)
            unit, scale = (
                ("per degree of the angle", math.radians(1)) if single else ("per 0.01 of roughness", 0.01)
            )
            lines.append(f"change {unit}: {_range(scale * self.angle_sensitivity[good])}")
        return "\n".join(lines + [f"warning: {warning}" for warning in self.warnings])

    def to_csv(self, path: str | PathLike[str]) -> None:
        """Write the spectrum, as ``fitting.read_spectrum`` and ``vcavity fit --reflectance`` read it.

        Columns are `wavelength_nm, reflectance` and, if it is known, `standard_uncertainty`. What is missing stays
        empty, and wavelengths at which the reflectance was set to an end of its range are named in a comment. The
        file is replaced as a whole or not at all.

        Raises:
            OSError: the file cannot be written.
        """
        columns = [self.wavelengths_nm, self.reflectance]
        if self.standard_uncertainty is not None:
            columns.append(self.standard_uncertainty)
        lines = ["# title: reflectance recovered from a grooved sample", "# reflectance_unit: fraction"]
        for value, status in ((0, BELOW), (1, ABOVE)):
            at = self.wavelengths_nm[self.status == status]
            if at.size:
                lines.append(f"# set_to_{value}: {', '.join(files.number(nm) for nm in at)} nm, {status}")
        names = ["wavelength_nm", "reflectance", "standard_uncertainty"]
        lines.append(",".join(names[: len(columns)]))
        for row in zip(*columns, strict=True):
            lines.append(",".join("" if math.isnan(value) else files.number(value) for value in row))
        files.write(path, "\n".join(lines) + "\n")


def recover_reflectance(scene: Any, measurement: Measurement, *, tolerance: float = 1e-8) -> Recovery:
    """Recover the spectrum of a material from that of a grooved sample whose angle, or roughness, is known.

    At each wavelength it is the reflectance, between 0 and 1, at which the model shows what was measured: exactly
    for one direction, by least squares weighted with 1/σ² for several. A value that no reflectance explains is
    never fitted silently: ``status`` and a warning tell where the end of the range was taken.

    Args:
        scene: what the sample is, with all numbers known. Its material is ``Lambertian`` or
            ``InterfacedLambertian``, bare or under a layer. The reflectance in it does not matter: it is what is
            asked for. Its view is replaced by the measurement's.
        measurement: what the grooved sample shows; NaN is left out.
        tolerance: bound on the model's numerical error. That of the reflectance is ``amplification`` times larger.

    Returns:
        The spectrum, its uncertainty and its status, never an exception for bad values.

    Raises:
        ValueError: the scene has no reflectance to recover, a number of it is traced by JAX, or scene and
            measurement do not fit together; the message says what is expected.
    """
    _check_material(scene)
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(scene)):
        raise ValueError(
            "a number of the scene is traced by JAX; expected known numbers: fitting.recovery.reflectance_of is "
            "the function to differentiate or compile"
        )
    check_light(scene.illumination, measurement.illumination)
    count = measurement.wavelengths_nm.size
    _check_wavelengths(scene.material, count)
    scene = vc.Scene(scene.surface, scene.material, scene.illumination, measurement.view)
    forward.check(scene, None, None)
    values, sigma = measurement.reflectance_factor, measurement.standard_uncertainty
    present = ~np.isnan(values)
    if not present.any():
        raise ValueError("the measurement holds no value (all are NaN); expected at least one")
    weights = np.where(present, 1.0 if sigma is None else 1 / np.where(present, sigma, 1.0), 0.0)

    fixed, number, passed = _Fixed.of(scene, tolerance)
    dtype = jnp.result_type(float)
    numbers = jnp.asarray(np.where(present, values, 0.0), dtype), jnp.asarray(weights, dtype)
    found = jax.tree.map(np.asarray, _solve(fixed, number, passed, *numbers))
    roots = found.roots
    status = np.full(count, RECOVERED, dtype="<U32")
    for name, places in (
        (BELOW, roots.below),
        (ABOVE, roots.above),
        (UNDETERMINED, ~roots.determined),
        (MISSING, roots.missing),
    ):
        status[places] = name
    usable = np.isfinite(roots.reflectance)
    slope = np.asarray(found.slope, np.float64)
    with np.errstate(divide="ignore"):
        error = np.where(usable, 1 / np.sqrt(np.sum((weights * slope) ** 2, axis=0)), np.nan)
    one = np.sqrt(np.sum(weights**2, axis=0) / np.maximum(np.sum(present, axis=0), 1))
    result = Recovery(
        scene=_with_reflectance(scene, jnp.asarray(roots.reflectance)),
        measurement=measurement,
        wavelengths_nm=measurement.wavelengths_nm,
        reflectance=np.asarray(roots.reflectance, np.float64),
        standard_uncertainty=None if sigma is None else error,
        status=status,
        predicted=np.where(usable, found.predicted, np.nan),
        slope=np.where(usable, slope, np.nan),
        amplification=error * one,
        angle_sensitivity=np.where(usable, found.sensitivity, np.nan),
        warnings=(),
    )
    return dataclasses.replace(result, warnings=tuple(_warnings(result, weights)))


def reflectance_of(
    scene: Any,
    reflectance_factor: Float[ArrayLike, "*directions_and_wavelengths"],
    *,
    tolerance: float = 1e-8,
    weights: Float[ArrayLike, "*#directions_and_wavelengths"] | None = None,
    smallest_angle: float | None = None,
    smallest_index: float | None = None,
) -> Float[Array, " wavelengths"]:
    """The reflectance at which a scene has given reflectance factors: the inverse of ``vc.reflectance_factor``.

    It can be compiled, batched and differentiated with respect to the numbers of the scene, the reflectance
    factors and their weights. The derivative is that of the implicit function theorem,

        dr/dp = -(∂F/∂p) / (∂F/∂r),        F = R(r, p) - h for one direction, Σ w² (R - h) ∂R/∂r for several

    where F = 0 is the condition of least squares. It has one solution as long as the misfit is small against the
    range of the reflectance factor, as noise is.

    The result is clipped: it is exactly 0 or 1, with a vanishing derivative, where the reflectance factor lies
    outside what these give. ``recover_reflectance`` says where.

    Args:
        scene: its material is ``Lambertian`` or ``InterfacedLambertian``; the reflectance in it is ignored.
        reflectance_factor: h, shaped as ``vc.reflectance_factor`` returns it: the view's directions, none for a
            hemisphere, then L wavelengths. NaN is left out.
        tolerance: bound on the numerical error of the reflectance factor.
        weights: w, inverse standard uncertainties of the reflectance factors, which broadcast against them; only
            their ratios within a wavelength matter. A value of weight 0 is left out. By default all are alike.
        smallest_angle: radians. A dihedral angle that JAX traces costs several times less if it is known to stay
            above this; see ``vc.reflectance_factor``.
        smallest_index: the same for a traced index of an interface.

    Returns:
        Fraction, 0 to 1, shape (L,). NaN where no direction has a value, where the reflectance factor does not
        depend on the reflectance, and where the model is NaN.

    Raises:
        ValueError: the scene has no reflectance to recover, shapes do not fit, or ``vc.reflectance_factor``
            refuses the scene.

    Gradients that run backwards do not pass through several directions of random grooves with an interface; those
    that run forward (``jax.jvp``, ``jax.jacfwd``) pass through everything.
    """
    _check_material(scene)
    values = _real(reflectance_factor)
    view = scene.view.shape
    if values.ndim != len(view) + 1 or values.shape[:-1] != view:
        raise ValueError(
            f"the reflectance factor has shape {values.shape}; expected {view}, of the view's directions, and one "
            "more axis, of wavelengths"
        )
    _check_wavelengths(scene.material, values.shape[-1])
    weight = jnp.ones_like(values) if weights is None else jnp.broadcast_to(_real(weights), values.shape)
    weight = jnp.where(jnp.isnan(values), jnp.zeros_like(weight), weight)
    rows = (-1, values.shape[-1])
    promised = {"smallest_angle": smallest_angle, "smallest_index": smallest_index}
    return _roots(scene, values.reshape(rows), weight.reshape(rows), tolerance, promised).reflectance


class _Roots(NamedTuple):
    """Reflectances and what became of them, shape (L,) each."""

    reflectance: Array
    below: Array
    above: Array
    determined: Array
    missing: Array


def _model(scene: Any, shape: tuple[int, ...], tolerance: float, promised: dict[str, float | None]) -> Any:
    """Reflectance factors, shape (D, L), as a function of the reflectance, shape (L,)."""

    def model(reflectance: Array) -> Array:
        whole = _with_reflectance(scene, reflectance)
        return jnp.reshape(vc.reflectance_factor(whole, tolerance, **promised), shape)

    return model


def _roots(
    scene: Any, values: Array, weights: Array, tolerance: float, promised: dict[str, float | None]
) -> _Roots:
    """One root per wavelength; values and weights have the shape (D, L), and a weight of 0 leaves a value out."""
    model = _model(scene, values.shape, tolerance, promised)
    zeros = jnp.zeros_like(values)
    used = weights > 0
    square = jnp.where(used, weights * weights, zeros)
    total = jnp.sum(square, axis=0)
    missing = total == 0
    share = square / jnp.where(missing, jnp.ones_like(total), total)
    target = jnp.where(used, values, zeros)

    def misfit(r: Array, _: Any) -> Any:
        """Increases with r, in units of the reflectance factor, and vanishes at the solution."""
        if values.shape[0] == 1:
            predicted = model(r)
            off = (predicted - target)[0]
        else:
            # Each value touches its own wavelength only: ones for a tangent give all slopes at once.
            predicted, slope = jax.jvp(model, (r,), (jnp.ones_like(r),))
            pull = share * slope
            sum_of_pull = jnp.sum(pull, axis=0)
            flat = sum_of_pull == 0
            off = jnp.sum(pull * (predicted - target), axis=0) / jnp.where(flat, jnp.ones_like(r), sum_of_pull)
        return jnp.where(missing, r - 0.5, off), predicted

    eps = float(jnp.finfo(values.dtype).eps)
    solution: optx.Solution = optx.root_find(
        misfit,
        _BracketedFraction(rtol=0.0, atol=eps**0.7, rounding=4 * eps),
        jnp.zeros_like(total),
        has_aux=True,
        max_steps=_MOST_STEPS,
        adjoint=optx.ImplicitAdjoint(linear_solver=lx.Diagonal()),
        throw=False,
        tags=frozenset({lx.diagonal_tag}),
    )
    low, high = solution.state.at_zero, solution.state.at_one
    determined = missing | (high - low > _UNDETERMINED * tolerance)
    below = determined & ~missing & (low > tolerance)
    above = determined & ~missing & (high < -tolerance)
    root = jnp.where(below | above, jax.lax.stop_gradient(solution.value), solution.value)
    broken = missing | ~determined | jnp.any(jnp.isnan(solution.aux), axis=0)
    return _Roots(jnp.where(broken, jnp.full_like(root, jnp.nan), root), below, above, determined, missing)


class _State(NamedTuple):
    """Of ``_BracketedFraction``: where each root lies, and what was seen last, before that, and at both ends."""

    evaluations: Array
    lower: Array
    upper: Array
    moved: Array
    last: tuple[Array, Array]
    before: tuple[Array, Array]
    at_zero: Array
    at_one: Array
    done: Array


class _BracketedFraction(optx.AbstractRootFinder):
    """Roots of many functions of one number each, all increasing from 0 to 1, side by side, no derivatives.

    A linear fraction is laid through the last three points of each; where it vanishes is the next one
    [JarrattNudds1965]. It suits them: a flat surface under an interface is one exactly [Saunderson1942], and a
    groove is close to it. A step that leaves the bracket, or that is more than half the last one, is replaced by
    bisection. The first two points are 0 and 1, which tells whether there is a root; a function that does not
    change its sign has the end where it is nearest to zero.

    Args:
        rtol: relative step at which a root is found.
        atol: absolute one.
        rounding: values below this are zero.
    """

    rtol: float
    atol: float
    rounding: float = 0.0
    norm: Callable[..., Any] = optx.max_norm

    def init(self, fn: Any, y: Any, args: Any, options: Any, f_struct: Any, aux_struct: Any, tags: Any) -> _State:
        """All that is known before the first evaluation."""
        zero, one = jnp.zeros_like(y), jnp.ones_like(y)
        point = zero, zero
        return _State(jnp.asarray(0), zero, one, one, point, point, zero, one, jnp.zeros(y.shape, bool))

    def step(self, fn: Any, y: Any, args: Any, options: Any, state: Any, tags: Any) -> tuple[Any, Any, Any]:
        """One evaluation, and where the next one is."""
        f, aux = fn(y, args)
        (y1, f1), (y2, f2) = state.last, state.before
        first, second = state.evaluations == 0, state.evaluations == 1
        lower = jnp.where(f <= self.rounding, jnp.maximum(state.lower, y), state.lower)
        upper = jnp.where(f >= -self.rounding, jnp.minimum(state.upper, y), state.upper)
        line = -f1, f - f1
        fraction = f * (f1 - f2) * (y - y1) * (y - y2), (f2 - f) * f1 * (y - y1) + (f - f1) * f2 * (y - y2)
        top, bottom = (jnp.where(second, a, b) for a, b in zip(line, fraction, strict=True))
        usable = (bottom != 0) & (second | (f1 != f2))
        target = jnp.where(second, y1, y) + top / jnp.where(usable, bottom, jnp.ones_like(bottom))
        # Rounding may put a root that lies next to an end of the bracket on the other side of it.
        enough = self.atol + self.rtol * y
        inside = (target >= lower - enough) & (target <= upper + enough)
        sound = usable & inside & (jnp.abs(target - y) <= jnp.maximum(state.moved / 2, enough))
        following = jnp.where(sound, jnp.clip(target, lower, upper), (lower + upper) / 2)

        settled = upper <= lower
        following = jnp.where(state.done, y, following)
        following = jnp.where(settled, upper, following)
        following = jnp.where(first, jnp.ones_like(y), following)
        moved = jnp.where(state.evaluations < 2, 2 * jnp.ones_like(y), jnp.abs(following - y))
        return (
            following,
            _State(
                evaluations=state.evaluations + 1,
                lower=lower,
                upper=upper,
                moved=moved,
                last=(y, f),
                before=state.last,
                at_zero=jnp.where(first, f, state.at_zero),
                at_one=jnp.where(second, f, state.at_one),
                done=state.done | ~first & (settled | (moved <= enough)) | jnp.isnan(f),
            ),
            aux,
        )

    def terminate(self, fn: Any, y: Any, args: Any, options: Any, state: Any, tags: Any) -> tuple[Any, Any]:
        """Whether all roots are found."""
        return jnp.all(state.done) & (state.evaluations >= 2), optx.RESULTS.successful

    def postprocess(
        self, fn: Any, y: Any, aux: Any, args: Any, options: Any, state: Any, tags: Any, result: Any
    ) -> tuple[Any, Any, dict[str, Any]]:
        """Nothing is left to do."""
        return y, aux, {}


class _Found(NamedTuple):
    """Roots, their derivative with respect to the angle, and the model and its slope there, shape (D, L)."""

    roots: _Roots
    sensitivity: Array
    predicted: Array
    slope: Array


@dataclass(frozen=True)
class _Fixed:
    """What is compiled in of a scene, because the model picks cheaper paths for what is known.

    The material and the angle are passed on, so that other ones of the same kind need no new compilation. A real
    index stays in: the model must see that it is at least 1, and plans its work for it.

    Args:
        tree: of the scene.
        leaves: bytes, shape and type of what is known, None for what is passed on.
        varied: which leaf is the angle or the roughness.
        tolerance: bound on the model's numerical error.
        smallest_angle: what the work is planned for, radians; None for random grooves.
    """

    tree: Any
    leaves: tuple[tuple[bytes, tuple[int, ...], str] | None, ...]
    varied: int
    tolerance: float
    smallest_angle: float | None

    @staticmethod
    def of(scene: Any, tolerance: float) -> tuple["_Fixed", Array, tuple[Array, ...]]:
        """What is fixed of a scene, its angle or roughness, and the other numbers that are passed on."""
        # The reflectance is what is asked for: whatever stands there must not ask for a compilation of its own.
        found = jax.tree.leaves_with_path(_with_reflectance(scene, jnp.zeros(())))
        names = [[str(getattr(key, "name", key)) for key in path] for path, _ in found]
        leaves = [leaf for _, leaf in found]
        varied = next(i for i, path in enumerate(names) if path[0] == "surface")
        passed = [i for i, path in enumerate(names) if path[0] == "material" and path[-1] != "index"]
        known = tuple(
            None if i in (varied, *passed) else (np.asarray(a).tobytes(), np.shape(a), str(np.asarray(a).dtype))
            for i, a in enumerate(leaves)
        )
        smallest = None
        if isinstance(scene.surface, vc.VGrooves):
            # Whole degrees, so that neighboring angles share a program.
            degrees = math.floor(math.degrees(float(scene.surface.angle)) + 1e-6)
            narrowest = NARROWEST if interfaced_panel(scene.material) is None else INTERFACED_NARROWEST
            smallest = max(math.radians(degrees), narrowest)
        fixed = _Fixed(jax.tree.structure(scene), known, varied, tolerance, smallest)
        return fixed, _strong(leaves[varied]), tuple(_strong(leaves[i]) for i in passed)

    def scene(self, number: Array, passed: tuple[Array, ...]) -> Any:
        """The scene with an angle, or a roughness, and what else is passed on."""
        others = iter(passed)
        leaves: list[Any] = []
        for i, known in enumerate(self.leaves):
            if known is None:
                leaves.append(number if i == self.varied else next(others))
                continue
            data, shape, dtype = known
            with jax.ensure_compile_time_eval():
                leaves.append(jnp.asarray(np.frombuffer(data, dtype).reshape(shape)))
        return jax.tree.unflatten(self.tree, leaves)


@partial(jax.jit, static_argnums=0)
def _solve(fixed: _Fixed, number: Array, passed: tuple[Array, ...], values: Array, weights: Array) -> _Found:
    promised = {"smallest_angle": fixed.smallest_angle, "smallest_index": None}

    def model(r: Array, number: Array) -> Array:
        return _model(fixed.scene(number, passed), values.shape, fixed.tolerance, promised)(r)

    def with_slope(r: Array, number: Array) -> tuple[Array, Array]:
        if values.shape[0] == 1:  # No misfit is left, which is all that the slope's derivatives multiply.
            return model(r, number), jnp.zeros_like(values)
        return jax.jvp(lambda r: model(r, number), (r,), (jnp.ones_like(r),))

    roots = _roots(fixed.scene(number, passed), values, weights, fixed.tolerance, promised)
    at = jnp.where(jnp.isnan(roots.reflectance), jnp.zeros_like(roots.reflectance), roots.reflectance)
    # One after the other, so that one program serves both.
    (predicted, _), tangents = jax.lax.map(
        lambda unit: jax.jvp(with_slope, (at, number), (unit[0] * jnp.ones_like(at), unit[1])),
        jnp.eye(2, dtype=at.dtype),
    )
    (slope, by_number), (bend, slope_by_number) = tangents
    square, off = weights * weights, predicted[0] - values
    falls = jnp.sum(square * (slope * by_number + off * slope_by_number), axis=0)
    rises = jnp.sum(square * (slope * slope + off * bend), axis=0)
    held = roots.below | roots.above
    sensitivity = jnp.where(held, jnp.zeros_like(rises), -falls / rises)
    return _Found(roots, sensitivity, predicted[0], slope)


def _with_reflectance(scene: Any, reflectance: Array) -> Any:
    return eqx.tree_at(lambda s: s.material.reflectance, scene, reflectance)


def _strong(number: Array) -> Array:
    """Without JAX's weak type, which Python's numbers have, and which is compiled for itself."""
    return jnp.asarray(number, number.dtype)


def _real(value: Any) -> Array:
    if isinstance(value, jax.Array) and jnp.issubdtype(value.dtype, jnp.floating):
        return value
    return jnp.asarray(value, jnp.result_type(float))


def _check_material(scene: Any) -> None:
    material = scene.material
    if isinstance(material, vc.Lambertian | vc.InterfacedLambertian):
        return
    why = "two panels show one spectrum, which does not tell their two reflectances apart"
    if isinstance(material, vc.Specular):
        why = "a mirror has an index, which a fit with a free index finds, and no reflectance of its own"
    raise ValueError(
        f"the material is {type(material).__name__}; expected Lambertian or InterfacedLambertian: {why}"
    )


def _check_wavelengths(material: Any, count: int) -> None:
    layer = getattr(material, "layer", None)
    parts = {"index": getattr(material, "index", None), "reflectance": material.reflectance}
    parts |= {name: getattr(layer, name, None) for name in ("transmittance", "coverage")}
    for name, part in parts.items():
        if part is not None and np.shape(part) not in ((), (count,)):
            raise ValueError(
                f"the material's {name} has shape {np.shape(part)}, the measurement {count} wavelengths; expected "
                f"() or ({count},): tabulate the material at the measurement's wavelengths"
            )


def _warnings(result: Recovery, weights: np.ndarray) -> Iterator[str]:
    """Every reason to doubt a recovery, one sentence each."""
    m = result.measurement
    if jnp.result_type(float) == jnp.float32:
        yield (
            "JAX runs in float32, which limits the reflectance to about 1e-5 times the amplification: call "
            'jax.config.update("jax_enable_x64", True) before the first array is made'
        )

    def places(chosen: np.ndarray) -> str:
        return (
            f"at {np.sum(chosen)} of {_count(chosen.size, 'wavelength')}, {_span(result.wavelengths_nm[chosen])}, "
        )

    if (lost := result.status == MISSING).any():
        yield f"{places(lost)}no direction has a value: no reflectance is given there"
    if (opaque := result.status == UNDETERMINED).any():
        yield (
            f"{places(opaque)}the reflectance factor does not depend on the reflectance, which an opaque layer "
            "hides: none is given there"
        )
    off = weights * (np.nan_to_num(m.reflectance_factor) - result.predicted)
    with np.errstate(invalid="ignore", divide="ignore"):
        pull = np.sum(off * weights * result.slope, axis=0)
        excess = np.abs(pull / np.sum(weights**2 * result.slope, axis=0))
        in_sigma = np.abs(pull / np.sqrt(np.sum((weights * result.slope) ** 2, axis=0)))
    for status, end, check in ((BELOW, 0, "offset"), (ABOVE, 1, "calibration")):
        if not (beyond := result.status == status).any():
            continue
        size = f"up to {np.max(excess[beyond]):.2g}"
        if m.standard_uncertainty is not None:
            size += f" or {np.max(in_sigma[beyond]):.2g} standard uncertainties"
        yield (
            f"{places(beyond)}what was measured lies {status}, by {size}: the reflectance is set to {end} there; "
            f"if that is not noise, check the {check}, the angle, and whether the specular component is included"
        )
    loud = result.amplification > MOST_AMPLIFICATION
    if loud.any():
        most = int(np.nanargmax(result.amplification))
        yield (
            f"{places(loud)}the noise is amplified more than {MOST_AMPLIFICATION:g} times, up to "
            f"{result.amplification[most]:.3g} times at {result.wavelengths_nm[most]:g} nm: {_advice(result)}"
        )
    if m.standard_uncertainty is not None:
        inside = (weights > 0) & (result.status == RECOVERED)
        chi_square = float(np.sum(off[inside] ** 2))
        freedom = int(np.sum(inside) - np.sum(result.status == RECOVERED))
        if freedom > 0 and gammaincc(freedom / 2, chi_square / 2) < _BAD_FIT:
            yield (
                f"no reflectance explains all directions: chi-square is {chi_square:.4g} for {freedom} degrees of "
                "freedom; the angle or the material is wrong, or the uncertainty is too small"
            )


def _advice(result: Recovery) -> str:
    """What to do against amplified noise."""
    surface, material, m = result.scene.surface, result.scene.material, result.measurement
    across = np.arctan(np.abs(np.tan(m.polar) * np.cos(m.azimuth)))
    steep = isinstance(surface, vc.VGrooves) and float(surface.angle) < _STEEP
    if steep and getattr(material, "layer", None) is None and not np.any(across > _OBLIQUE):
        return "oblique views across the grooves, at 60 to 75 degrees, amplify it 2 to 5 times less"
    return "average repeated measurements, or measure a flat sample of the material"


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _span(wavelengths_nm: np.ndarray) -> str:
    first, last = f"{wavelengths_nm[0]:g} nm", f"{wavelengths_nm[-1]:g} nm"
    return first if wavelengths_nm.size == 1 else f"{first} to {last}"


def _range(values: np.ndarray) -> str:
    low, high = f"{np.min(values):.3g}", f"{np.max(values):.3g}"
    return low if low == high else f"{low} to {high}"
