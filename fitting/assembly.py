"""From scenes, measurements and free parameters to a fit that can be evaluated; all that is wrong is said here."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import vcavity_jax as vc
from fitting import instrument
from fitting.layout import Data, FormUse, Layout, Part, SpectralSlot
from fitting.measurement import Measurement, check_light
from fitting.parameters import Parameter, SpectralParameter
from fitting.problem import Problem, fraction_start
from fitting.programs import programs_for
from fitting.spectra import as_array
from vcavity_jax.planning import interfaced_panel
from vcavity_jax.resolution import INTERFACED_NARROWEST, NARROWEST

MOST_SEARCHED = 3
_FIRST_GUESS = 0.01


class _Use(NamedTuple):
    """A parameter with its own name and the measurements that it belongs to."""

    parameter: Any
    name: str
    members: tuple[int, ...]


def build(
    scene: Any,
    measurement: Any,
    parameters: Sequence[Any],
    standard_uncertainty: float | int | None,
    tolerance: float,
    *,
    enough: bool = True,
) -> Problem:
    """Check a fit's inputs and make it ready.

    Args:
        scene: one, or a list or dictionary of them; any view; the illumination must be the measurement's.
        measurement: one, or as many, in the same form.
        parameters: free ones; at most three are searched.
        standard_uncertainty: fraction; takes precedence over the measurements' own; None for that.
        tolerance: bound on the model's numerical error.
        enough: refuse fewer values than unknowns, which no fit can do with.

    Raises:
        ValueError: anything that does not fit together, in one line.
    """
    labels, scenes, measurements = _paired(scene, measurement)
    uses = _spread(flattened(parameters), labels)
    scenes = tuple(_seen(s, m, _of(labels, i)) for i, (s, m) in enumerate(zip(scenes, measurements, strict=True)))
    measurements = _with_uncertainty(measurements, standard_uncertainty)
    _check_instrument(uses, scenes, labels)
    grid = np.unique(np.concatenate([m.wavelengths_nm for m in measurements]))

    spectral = [u for u in uses if isinstance(u.parameter, SpectralParameter)]
    forms: list[FormUse] = []
    numbers = [(u.parameter, u.name) for u in uses if isinstance(u.parameter, Parameter)]
    numbers.sort(key=lambda pair: (not pair[0].searched, pair[0].role in ("gain", "offset")))
    linear = [pair for pair in numbers if pair[0].role in ("gain", "offset")]
    numbers = [pair for pair in numbers if pair not in linear]
    sources: dict[str, int] = {}
    for use in spectral:
        if use.parameter.form is not None:
            found = _coefficients(use, scenes, measurements, grid)
            taken = range(len(numbers), len(numbers) + len(found))
            sources[use.name] = len(forms)
            forms.append(FormUse(use.parameter.form, tuple(taken)))
            numbers += [(p, p.name) for p in found]
    numbers += sorted(linear, key=lambda pair: pair[0].role)
    place = {name: i for i, (_, name) in enumerate(numbers)}
    rows: dict[str, tuple[int, ...]] = {}
    free_names: list[str] = []
    for use in spectral:
        if use.parameter.form is None:
            suffix = use.name.removeprefix(use.parameter.name)
            rows[use.name] = tuple(range(len(free_names), len(free_names) + len(use.parameter.quantities)))
            free_names += [quantity + suffix for quantity in use.parameter.quantities]

    parts = tuple(
        _part(index, s, m, uses, place, sources, rows, grid)
        for index, (s, m) in enumerate(zip(scenes, measurements, strict=True))
    )
    for part in parts:
        if free_names and any(role == "wavelength_shift" for role, _ in part.roles):
            raise ValueError(
                "a wavelength shift and a spectrum that is free at each wavelength stand for each other; "
                "expected one of them, or a smooth spectrum"
            )
    named = tuple(dataclasses.replace(p, name=name) for p, name in numbers)
    _check_numbers(named, uses, scenes, parts)
    layout = Layout(
        parts,
        tuple(p.scale == "log" for p in named),
        tuple(p.prior_of_logarithm for p in named),
        tuple(forms),
        len(free_names),
        grid,
        tolerance,
    )
    owners = [(u, q) for u in spectral if u.parameter.form is None for q in range(len(u.parameter.quantities))]
    data = _data(layout, measurements, named, owners)
    problem = Problem(
        given=tuple(flattened(parameters)),
        labels=labels,
        measurements=measurements,
        numbers=named,
        spectral=tuple(dataclasses.replace(u.parameter, name=u.name) for u in spectral),
        free_names=tuple(free_names),
        layout=layout,
        data=data,
        programs=programs_for(layout, data),
        starts=_spectral_starts(layout, data, owners),
        angles=_angles(named, parts),
    )
    if enough and problem.degrees_of_freedom < 0:
        weights = [np.asarray(w) for w in data.weights]
        raise ValueError(
            f"{sum(int(np.sum(w > 0)) for w in weights)} measured values for {problem.unknowns(weights)} free "
            "parameters; expected at least as many values "
            "and priors as free parameters"
        )
    return problem


def _paired(scene: Any, measurement: Any) -> tuple[tuple[str, ...], tuple[Any, ...], tuple[Measurement, ...]]:
    """Labels, scenes and measurements of a fit."""
    if isinstance(measurement, Measurement):
        if not isinstance(scene, vc.Scene):
            raise ValueError(f"one measurement and a {type(scene).__name__} of scenes; expected one Scene")
        return ("0",), (scene,), (measurement,)
    if isinstance(measurement, Mapping):
        labels = tuple(map(str, measurement))
        measurements = tuple(measurement.values())
        if isinstance(scene, Mapping):
            if set(map(str, scene)) != set(labels):
                raise ValueError(
                    f"scenes {sorted(map(str, scene))}, measurements {sorted(labels)}; expected the same"
                )
            scene = [scene[key] for key in measurement]
    elif isinstance(measurement, Sequence):
        measurements = tuple(measurement)
        labels = tuple(str(i) for i in range(len(measurements)))
    else:
        raise ValueError(
            f"{type(measurement).__name__} is not a Measurement: expected one, or a list or dict of them"
        )
    # Seldom do the samples differ: one scene then stands for all.
    scenes = tuple(scene) if isinstance(scene, Sequence) else (scene,) * len(measurements)
    if not measurements or len(scenes) != len(measurements):
        raise ValueError(f"{len(scenes)} scenes and {len(measurements)} measurements; expected one scene for each")
    if not all(isinstance(m, Measurement) for m in measurements) or not all(
        isinstance(s, vc.Scene) for s in scenes
    ):
        raise ValueError("expected a Scene for every Measurement")
    if len(measurements) > 1:
        scenes = tuple(
            vc.Scene(s.surface, s.material, m.illumination, m.view) if isinstance(scene, vc.Scene) else s
            for s, m in zip(scenes, measurements, strict=True)
        )
    return labels, scenes, measurements


def _of(labels: tuple[str, ...], index: int) -> str:
    """Which of several measurements a message is about."""
    return "" if len(labels) == 1 else f"measurement {labels[index]!r}: "


def flattened(parameters: Any) -> list[Any]:
    """The parameters, with those that come in pairs put one after the other."""
    single = isinstance(parameters, Parameter | SpectralParameter)
    if single or not isinstance(parameters, Sequence):
        raise ValueError("parameters are not a list of Parameter; expected, say, [free.angle(), free.gain()]")
    flat: list[Any] = []
    for p in parameters:
        flat += list(p) if isinstance(p, tuple | list) else [p]
    if not all(isinstance(p, Parameter | SpectralParameter) for p in flat):
        raise ValueError("parameters are not a list of Parameter; expected, say, [free.angle(), free.gain()]")
    if not flat:
        raise ValueError("no parameter is free; expected at least one, say free.angle()")
    return flat


def _spread(parameters: Sequence[Any], labels: tuple[str, ...]) -> list[_Use]:
    """Each parameter once for every group of measurements that share its value."""
    uses: list[_Use] = []
    everyone = tuple(range(len(labels)))
    for p in parameters:
        if p.among == "shared":
            uses.append(_Use(p, p.name, everyone))
        elif p.among == "separate":
            many = len(labels) > 1
            uses += [_Use(p, f"{p.name}[{label}]" if many else p.name, (i,)) for i, label in enumerate(labels)]
        else:
            unknown = [label for label in p.among if label not in labels]
            if unknown or not p.among:
                raise ValueError(
                    f"parameter {p.name!r} is for measurement {', '.join(unknown) or 'none'}; expected some of "
                    + ", ".join(labels)
                )
            uses.append(_Use(p, f"{p.name}[{','.join(p.among)}]", tuple(labels.index(a) for a in p.among)))
    names = [use.name for use in uses]
    repeated = next((name for name in names if names.count(name) > 1), None)
    if repeated is not None:
        raise ValueError(f"parameter {repeated!r} is given twice; expected distinct names")
    searched = [u.name for u in uses if isinstance(u.parameter, Parameter) and u.parameter.searched]
    if len(searched) > MOST_SEARCHED:
        raise ValueError(
            f"{len(searched)} parameters are searched ({', '.join(searched)}); expected at most {MOST_SEARCHED}, "
            "because all their range is searched: give others a start"
        )
    return uses


def _seen(scene: Any, measurement: Measurement, of: str) -> Any:
    check_light(scene.illumination, measurement.illumination, of)
    return vc.Scene(scene.surface, scene.material, scene.illumination, measurement.view)


def _with_uncertainty(
    measurements: tuple[Measurement, ...], standard_uncertainty: float | int | None
) -> tuple[Measurement, ...]:
    """The measurements with the uncertainty that the fit uses, or a start for its estimate."""
    stated = [m.standard_uncertainty is not None for m in measurements]
    if standard_uncertainty is None and all(stated):
        return measurements
    if standard_uncertainty is None and any(stated):
        raise ValueError(
            "some measurements state an uncertainty and some do not; expected all or none, or "
            "standard_uncertainty="
        )
    sigma = _FIRST_GUESS if standard_uncertainty is None else standard_uncertainty
    if not (isinstance(sigma, float | int) and 0 < sigma < math.inf):
        raise ValueError(f"standard_uncertainty is {sigma!r}; expected one positive number, as a fraction")
    return tuple(
        dataclasses.replace(m, standard_uncertainty=np.full(m.reflectance_factor.shape, float(sigma)))
        for m in measurements
    )


def _check_instrument(uses: Sequence[_Use], scenes: tuple[Any, ...], labels: tuple[str, ...]) -> None:
    """Roles are given at most once for each measurement; a tilt needs directions."""
    for index, scene in enumerate(scenes):
        own = [u for u in uses if index in u.members and isinstance(u.parameter, Parameter)]
        roles = [u.parameter.role for u in own if u.parameter.role != "scene"]
        repeated = next((role for role in roles if roles.count(role) > 1), None)
        if repeated is not None:
            raise ValueError(f"{_of(labels, index)}{repeated} is given twice; expected it at most once")
        if any(role.startswith("tilt") for role in roles) and not instrument.can_tilt(scene):
            raise ValueError(
                f"{_of(labels, index)}a tilt is not modeled in {type(scene.illumination).__name__} light with a "
                f"{type(scene.view).__name__}; expected Diffuse or Directional light and directions of view"
            )


def _coefficients(
    use: _Use, scenes: tuple[Any, ...], measurements: tuple[Measurement, ...], grid: np.ndarray
) -> list[Parameter]:
    """The coefficients of a spectrum's form, as numbers that start somewhere."""
    first, parameter = use.members[0], use.parameter
    own = np.asarray(_leaf(scenes[first], parameter, use.name)[1])
    wavelengths = measurements[first].wavelengths_nm
    if own.shape not in ((), (len(wavelengths),)):
        own = own.ravel()[:1].reshape(())
    interpolated = np.interp(grid, wavelengths, as_array(own, len(wavelengths)))
    return [
        Parameter(f"{use.name}.{c.name}", None, c.lower, c.upper, c.prior, start=c.start)
        for c in parameter.form.coefficients(grid, interpolated)
    ]


def _leaf(scene: Any, parameter: Any, name: str) -> tuple[int, Any]:
    """Which leaf of the scene a parameter is, and what stands there."""
    try:
        target = parameter.where(scene)
        marked = eqx.tree_at(parameter.where, scene, mark := _Mark())
    except (AttributeError, ValueError, TypeError, KeyError, IndexError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ValueError(
            f"parameter {name!r}: its place is not in this scene of {type(scene.surface).__name__} "
            f"and {type(scene.material).__name__} ({reason}); expected one number of the scene"
        ) from None
    if not eqx.is_array(target):
        raise ValueError(
            f"parameter {name!r}: its place holds a {type(target).__name__}; expected one number of the scene"
        )
    return next(i for i, leaf in enumerate(jax.tree.leaves(marked)) if leaf is mark), target


class _Mark:
    """Found again among the leaves of a scene."""


def _part(
    index: int,
    scene: Any,
    measurement: Measurement,
    uses: Sequence[_Use],
    place: dict[str, int],
    sources: dict[str, int],
    rows: dict[str, tuple[int, ...]],
    grid: np.ndarray,
) -> Part:
    """One measurement's share."""
    slots: list[tuple[int, int]] = []
    spectral: list[SpectralSlot] = []
    roles: list[tuple[str, int]] = []
    owners: dict[int, str] = {}
    leaves = jax.tree.leaves(scene)
    for use in uses:
        if index not in use.members:
            continue
        parameter = use.parameter
        if isinstance(parameter, Parameter) and parameter.role != "scene":
            roles.append((parameter.role, place[use.name]))
            continue
        leaf, target = _leaf(scene, parameter, use.name)
        if leaf in owners:
            raise ValueError(
                f"parameters {owners[leaf]!r} and {use.name!r} are the same number of the scene; expected each "
                "number once"
            )
        owners[leaf] = use.name
        if isinstance(parameter, Parameter):
            if target.ndim != 0 or not jnp.issubdtype(target.dtype, jnp.floating):
                raise ValueError(
                    f"parameter {use.name!r}: its place holds an array of shape {target.shape} and type "
                    f"{target.dtype}; expected one real number"
                )
            slots.append((leaf, place[use.name]))
        else:
            _check_spectrum(parameter, use.name, target, scene, len(measurement.wavelengths_nm))
            source = sources.get(use.name)
            own = rows[use.name] if source is None else tuple(range(len(parameter.quantities)))
            spectral.append(SpectralSlot(leaf, source, own))
    taken = {leaf for leaf, _ in slots} | {s.leaf for s in spectral}
    return Part(
        scene,
        measurement.wavelengths_nm,
        (len(measurement.polar), len(measurement.wavelengths_nm)),
        tuple(slots),
        tuple(spectral),
        tuple(roles),
        tuple(i for i in _passed_on(scene) if i not in taken),
        np.searchsorted(grid, measurement.wavelengths_nm),
        _smallest(scene, leaves, slots, spectral, [u for u in uses if index in u.members], owners),
    )


def _check_spectrum(parameter: SpectralParameter, name: str, target: Any, scene: Any, count: int) -> None:
    if target.shape not in ((), (count,)):
        raise ValueError(
            f"parameter {name!r}: its place holds an array of shape {target.shape}; expected one number or one "
            f"value for each of the {count} wavelengths"
        )
    two = len(parameter.quantities) == 2
    if not two and jnp.issubdtype(target.dtype, jnp.complexfloating):
        raise ValueError(
            f"parameter {name!r}: its place holds complex numbers; expected n and k to be free: "
            "complex_valued=True, or a formula that has both"
        )
    if two and interfaced_panel(scene.material) is not None:
        raise ValueError(f"parameter {name!r}: an interface is clear; expected a real index, not n and k")


def _named_leaves(scene: Any) -> list[tuple[tuple[str, ...], Any]]:
    """The leaves in the order of ``jax.tree.leaves``, each after the names that lead to it."""
    found = jax.tree.leaves_with_path(scene)
    return [(tuple(str(getattr(key, "name", key)) for key in path), leaf) for path, leaf in found]


def _passed_on(scene: Any) -> tuple[int, ...]:
    """Leaves of the scene that are handed to the compiled programs instead of being compiled in.

    They are the material's, so that other materials of the same kind need no new compilation. A real index
    stays in: the model must see that it is at least 1, and plans its work for it.
    """
    return tuple(
        i
        for i, (names, leaf) in enumerate(_named_leaves(scene))
        if names[0] == "material" and not (names[-1] == "index" and not jnp.iscomplexobj(leaf))
    )


def _smallest(
    scene: Any,
    leaves: list[Any],
    slots: Sequence[tuple[int, int]],
    spectral: Sequence[SpectralSlot],
    uses: Sequence[_Use],
    owners: dict[int, str],
) -> tuple[float | None, float | None]:
    """The least dihedral angle and the least index of an interface that are searched; None if none is."""
    by_name = {u.name: u.parameter for u in uses}
    angle = index = None
    if isinstance(scene.surface, vc.VGrooves):
        where = next(i for i, leaf in enumerate(leaves) if leaf is scene.surface.angle)
        if where in owners:
            angle = float(by_name[owners[where]].lower)
            narrowest = NARROWEST if interfaced_panel(scene.material) is None else INTERFACED_NARROWEST
            if angle < narrowest:
                raise ValueError(
                    f"dihedral angles from {math.degrees(angle):g} degrees; expected a lower bound of at least "
                    f"{math.degrees(narrowest):g} degrees, the narrowest groove that is modeled"
                )
    if interfaced_panel(scene.material) is not None:
        names = _named_leaves(scene)
        free = [*(leaf for leaf, _ in slots), *(s.leaf for s in spectral)]
        lower = [by_name[owners[leaf]].lower for leaf in free if names[leaf][0][-1] == "index"]
        index = min((float(np.min(v)) for v in lower), default=None)
    return angle, index


def _check_numbers(
    named: tuple[Parameter, ...], uses: Sequence[_Use], scenes: tuple[Any, ...], parts: tuple[Part, ...]
) -> None:
    """Let the scene's parts check the bounds as they check a user's own numbers."""
    for part in parts:
        leaves, tree = jax.tree.flatten(part.scene)
        for leaf, number in part.slots:
            for bound in (named[number].lower, named[number].upper):
                trial = list(leaves)
                trial[leaf] = np.asarray(bound)
                _recheck(jax.tree.unflatten(tree, trial), f"parameter {named[number].name!r} at its bound: ")


def _recheck(node: Any, prefix: str) -> None:
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


def _angles(named: tuple[Parameter, ...], parts: tuple[Part, ...]) -> dict[int, tuple[int, ...]]:
    """Which numbers are dihedral angles, and of which measurements."""
    found: dict[int, tuple[int, ...]] = {}
    for index, part in enumerate(parts):
        if isinstance(part.scene.surface, vc.VGrooves):
            where = next(
                i for i, leaf in enumerate(jax.tree.leaves(part.scene)) if leaf is part.scene.surface.angle
            )
            for leaf, number in part.slots:
                if leaf == where:
                    found[number] = (*found.get(number, ()), index)
    return found


def _data(
    layout: Layout,
    measurements: tuple[Measurement, ...],
    named: tuple[Parameter, ...],
    owners: Sequence[tuple[_Use, int]],
) -> Data:
    def array(numbers: Any) -> jax.Array:
        return jnp.asarray(np.asarray(numbers, dtype=np.float64), jnp.result_type(float))

    values, weights, means, known = [], [], [], []
    for part, m in zip(layout.parts, measurements, strict=True):
        present = ~np.isnan(m.reflectance_factor)
        present = present & part.reached(named)
        if not present.any():
            raise ValueError("the measurement holds no value (all are NaN); expected at least one")
        assert m.standard_uncertainty is not None
        values.append(array(np.where(present, m.reflectance_factor, 0.0)))
        weights.append(array(np.where(present, 1 / np.where(present, m.standard_uncertainty, 1.0), 0.0)))
        counts = np.sum(~np.isnan(m.reflectance_factor), axis=1)
        means.append(array(np.nansum(m.reflectance_factor, axis=1) / np.maximum(counts, 1)))
        leaves = jax.tree.leaves(part.scene)
        known.append(tuple(leaves[i] for i in part.passed))
    gaussian = [p.gaussian or (0.0, math.inf, False) for p in named]
    count, blocks = len(owners), layout.blocks
    center, tight = np.zeros((count, blocks)), np.zeros((count, blocks))
    for row, (use, quantity) in enumerate(owners):
        if use.parameter.relative_prior is not None:
            part = layout.parts[use.members[0]]
            own = as_array(_leaf(part.scene, use.parameter, use.name)[1], part.shape[1])
            center[row, part.places] = own.imag if quantity else own.real
            tight[row, part.places] = 1 / (use.parameter.relative_prior * np.abs(own))
    return Data(
        values=tuple(values),
        weights=tuple(weights),
        means=tuple(means),
        known=tuple(known),
        center=array([g[0] for g in gaussian]),
        tightness=array([1 / g[1] for g in gaussian]),
        bounds=array([[p.natural(p.lower) for p in named], [p.natural(p.upper) for p in named]]),
        step=array([p.step_tolerance for p in named]),
        spectral_bounds=array(
            [[u.parameter.lower[q] for u, q in owners], [u.parameter.upper[q] for u, q in owners]]
        ).reshape(2, count),
        spectral_center=array(center),
        spectral_tightness=array(tight),
    )


def _spectral_starts(layout: Layout, data: Data, owners: Sequence[tuple[_Use, int]]) -> np.ndarray:
    """Starts of the free spectra: one for a fraction, several for an index, whose solutions are many."""
    total, weight = np.zeros(layout.blocks), np.zeros(layout.blocks)
    if layout.free_spectra:
        for part, values, weights in zip(layout.parts, data.values, data.weights, strict=True):
            w = np.asarray(weights, np.float64) ** 2
            total[part.places] += (w * np.asarray(values, np.float64)).sum(axis=0)
            weight[part.places] += w.sum(axis=0)
    rows = []
    for use, quantity in owners:
        parameter, part = use.parameter, layout.parts[use.members[0]]
        low, high = float(parameter.lower[quantity]), float(parameter.upper[quantity])
        kind = parameter.quantities[quantity]
        if kind in ("n", "k"):
            own = (
                np.interp(
                    layout.wavelengths_nm,
                    part.wavelengths_nm,
                    np.asarray(as_array(_leaf(part.scene, parameter, use.name)[1], part.shape[1])),
                )
                if layout.free_spectra
                else np.zeros(1)
            )
            own = own.imag if kind == "k" else own.real
            others = {("n", 2): (0.3, 3.0), ("k", 2): (3.0, 0.3), ("n", 1): (1.5, 2.5)}
            fixed = others[kind, len(parameter.quantities)]
            three = [own, *(np.full(layout.blocks, value) for value in fixed)]
        else:
            three = [fraction_start(total, weight, low, high)] * 3
        rows.append([np.clip(start, low, high) for start in three])
    if not rows:
        return np.zeros((1, 0, layout.blocks))
    starts = np.array(rows).transpose(1, 0, 2)
    return starts if any(u.parameter.quantities[q] in ("n", "k") for u, q in owners) else starts[:1]
