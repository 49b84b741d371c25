"""What a fit is asked to do, from the options of `vcavity fit`."""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import vcavity_jax as vc
from fitting import Measurement, free
from fitting.cli import messages, scenes, words
from fitting.readers.geometry import TRAPPED, TURNED


@dataclass(frozen=True)
class Request:
    """A fit to make.

    Args:
        scene: one, or one per measurement by its label.
        measurement: one, or several by their labels.
        parameters: what is free.
        options: further arguments of `fitting.fit`.
        folder: where the answer goes unless told otherwise.
        explained: a message of the library in the words of those who asked.
    """

    scene: Any
    measurement: Any
    parameters: list[Any]
    options: dict[str, Any]
    folder: Path
    explained: Callable[[str], str] = messages.in_options


def of_options(given: argparse.Namespace) -> Request:
    """The fit that the options describe.

    Raises:
        OSError: a file is missing or cannot be read.
        ValueError: an option is missing, has no effect or contradicts another.
    """
    missing = [name for name in ("measurement", "material") if getattr(given, name) is None]
    if missing:
        called = {"measurement": "MEASUREMENT", "material": "--material"}
        raise ValueError(
            f"the following arguments are required: {', '.join(called[name] for name in missing)}, or --config "
            "(see vcavity fit --help)"
        )
    given = argparse.Namespace(**vars(given) | {"surface": given.surface or "v-grooves"})
    for name, of in (("geometry_azimuth", TURNED), ("trap", TRAPPED)):
        if getattr(given, name) is not None and given.geometry not in of:
            raise ValueError(
                f"--{name.replace('_', '-')} has no effect: expected --geometry {' or '.join(of)} with it"
            )
    measurement = Measurement.read(
        given.measurement,
        column=given.column,
        reflectance_unit=given.reflectance_unit,
        geometry=given.geometry,
        geometry_azimuth_deg=given.geometry_azimuth,
        trap_half_angle_deg=given.trap,
    )
    if given.wavelengths is not None:
        try:
            measurement = measurement.select(wavelengths_nm=given.wavelengths)
        except ValueError as error:
            raise ValueError(f"{given.measurement}: --wavelengths: {error}") from None
    sample, parameters = sample_and_parameters(given)
    source = Path(given.measurement)
    return Request(
        scene=seen(sample, measurement),
        measurement=measurement,
        parameters=parameters,
        options={"standard_uncertainty": given.uncertainty}
        | ({} if given.max_steps is None else {"max_steps": given.max_steps}),
        folder=source.with_name(f"{source.stem}-fit"),
    )


def seen(sample: scenes.Sample, measurement: Measurement) -> Any:
    """The scene that was measured."""
    return vc.Scene(
        surface=scenes.surface(sample),
        material=scenes.material(sample, measurement.wavelengths_nm),
        illumination=measurement.illumination,
        view=measurement.view,
    )


def flat(made: Any) -> list[Any]:
    """What `fitting.free` made, which is a pair for a tilt."""
    return list(made) if isinstance(made, tuple) else [made]


def sample_and_parameters(given: argparse.Namespace) -> tuple[scenes.Sample, list[Any]]:
    """What is fitted, with what --fix holds, and what is free."""
    fixed = _held(given)
    names = list(dict.fromkeys(given.free)) or [words.OWN_PARAMETER[given.surface]]
    sample = scenes.of_options(
        given, **fixed, free=frozenset(names), index_kind="constant" if "index" in names else None
    )
    return sample, free_parameters(given, sample, names, fixed)


def _held(given: argparse.Namespace) -> dict[str, float]:
    """The fixed parameters and their values."""
    sample = scenes.of_options(given)
    fixed: dict[str, float] = {}
    for name, value in given.fix:
        scenes.require_place(sample, name, f"--fix {name}")
        if name in fixed:
            raise ValueError(f"--fix {name} is given twice; expected it once")
        if name in given.free:
            raise ValueError(f"{name} is in --free and in --fix; expected one of them")
        fixed[name] = value
    return fixed


def free_parameters(
    given: argparse.Namespace, sample: scenes.Sample, names: list[str], held: dict[str, float]
) -> list[Any]:
    """The free parameters; without any named, the surface's own.

    Args:
        given: the options.
        sample: what is fitted.
        names: of the free parameters.
        held: what is fixed, and its value.

    Raises:
        ValueError: an option has no effect or contradicts another.
    """
    own = words.OWN_PARAMETER[given.surface]
    ranges = {name: getattr(given, f"{name}_range") for name in ("angle", "roughness", "index")}
    for name in names:
        scenes.require_place(sample, name, f"--free {name}")
    for name, limits in ranges.items():
        if limits is not None:
            scenes.require_place(sample, name, f"--{name}-range")
    if own in held and not given.free:
        raise ValueError(f"--fix {own} leaves nothing to fit: expected --free gain, say, with it")
    for name, limits in ranges.items():
        if limits is not None and name not in names:
            why = "is fixed" if name in held else "is not free"
            raise ValueError(f"--{name}-range has no effect: {name} {why}")
    if own not in held and own not in names:
        raise ValueError(f"{own} is neither free nor fixed: expected --free {own} or --fix {own}=VALUE")
    if given.no_priors and not set(words.WITH_PRIOR) & set(names):
        raise ValueError(f"--no-priors has no effect: expected --free {' or '.join(words.WITH_PRIOR)} with it")
    if given.smooth is not None and not set(words.SPECTRA) & set(names):
        raise ValueError(f"--smooth has no effect: expected --free {' or '.join(words.SPECTRA)} with it")
    ranges["angle"] = given.angle_range or words.ANGLE_RANGE[given.material]
    made = [_parameter(name, ranges.get(name), given.smooth, given.no_priors) for name in names]
    return [one for each in made for one in flat(each)]


def _parameter(name: str, limits: tuple[float, float] | None, smooth_nm: float | None, no_priors: bool) -> Any:
    make = getattr(free, name)
    if no_priors and name in words.WITH_PRIOR:
        return make(**{words.PRIOR_KEY.get(name, "prior"): None})
    if name in words.SPECTRA:
        return make(smooth_nm=smooth_nm)
    if limits is None:
        return make()
    low, high = limits
    return make(lower_deg=low, upper_deg=high) if name == "angle" else make(lower=low, upper=high)
