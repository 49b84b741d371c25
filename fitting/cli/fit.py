"""`vcavity fit`: from a measurement to the groove's parameters."""

import argparse
import os
import sys
from pathlib import Path
from typing import Any

import vcavity_jax as vc
from fitting import Measurement, fit, free
from fitting.cli import arguments, scenes


def run(given: argparse.Namespace) -> int:
    """Fit, print the answer, write fit.json and fit.png; 0 if the answer can be trusted, else 1."""
    measurement = Measurement.read(given.measurement, column=given.column, reflectance_unit=given.reflectance_unit)
    if given.wavelengths is not None:
        try:
            measurement = measurement.select(wavelengths_nm=given.wavelengths)
        except ValueError as error:
            raise ValueError(f"{given.measurement}: --wavelengths: {error}") from None
    held = _held(given)
    parameters = _free(given, held)
    scene = vc.Scene(
        surface=scenes.surface(given.surface, held),
        material=scenes.material(given, measurement.wavelengths_nm),
        illumination=measurement.illumination,
        view=measurement.view,
    )
    source = Path(given.measurement)
    folder = source.with_name(f"{source.stem}-fit") if given.output is None else Path(given.output)
    _require_writable(folder)

    result = fit(
        scene,
        measurement,
        parameters,
        standard_uncertainty=given.uncertainty,
        tolerance=given.tolerance,
    )

    folder.mkdir(parents=True, exist_ok=True)
    written = folder / "fit.json", folder / "fit.png"
    result.to_json(written[0])
    result.plot(written[1])
    if given.json:
        print(written[0].read_text(encoding="utf-8").rstrip("\n"))
    else:
        print(result.summary())
        print(*(f"wrote {path}" for path in written), sep="\n")
    trusted = result.status == "converged" and result.identifiable
    if not trusted or result.describes_data is False:
        sys.stdout.flush()
        print(f"vcavity: {result.status}: {arguments.one_line(result.message)}", file=sys.stderr)
    return 0 if trusted else 1


def _held(given: argparse.Namespace) -> dict[str, float]:
    """The fixed parameters and their values."""
    held: dict[str, float] = {}
    for name, value in given.fix:
        scenes.require_surface_options(given, {f"--fix {name}": value})
        if name in held:
            raise ValueError(f"--fix {name} is given twice; expected it once")
        if name in given.free:
            raise ValueError(f"{name} is in --free and in --fix; expected one of them")
        held[name] = value
    return held


def _free(given: argparse.Namespace, held: dict[str, float]) -> list[Any]:
    """The free parameters; without any named, the surface's own."""
    own = arguments.OWN_PARAMETER[given.surface]
    names = list(dict.fromkeys(given.free)) or [own]
    ranges = {"angle": given.angle_range, "roughness": given.roughness_range}
    scenes.require_surface_options(
        given,
        {f"--free {name}": name for name in names}
        | {f"--{name}-range": limits for name, limits in ranges.items()},
    )
    if own in held and not given.free:
        raise ValueError(f"--fix {own} leaves nothing to fit: expected --free gain or --free offset with it")
    if own in held and ranges[own] is not None:
        raise ValueError(f"--{own}-range has no effect: {own} is fixed")
    if own not in held and own not in names:
        raise ValueError(f"{own} is neither free nor fixed: expected --free {own} or --fix {own}=VALUE")
    if given.no_priors and not {"gain", "offset"} & set(names):
        raise ValueError("--no-priors has no effect: expected --free gain or --free offset with it")
    ranges["angle"] = given.angle_range or arguments.ANGLE_RANGE[given.material]
    return [_parameter(name, ranges.get(name), given.no_priors) for name in names]


def _parameter(name: str, limits: tuple[float, float] | None, no_priors: bool) -> Any:
    make = getattr(free, name)
    if no_priors and name in ("gain", "offset"):
        return make(prior=None)
    if limits is None:
        return make()
    low, high = limits
    return make(lower_deg=low, upper_deg=high) if name == "angle" else make(lower=low, upper=high)


def _require_writable(folder: Path) -> None:
    """Refuse a folder that cannot be written, before the fit and without leaving anything behind."""
    existing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if not existing.is_dir():
        raise NotADirectoryError(f"{existing}: is a file; expected a folder for the output")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise PermissionError(f"{existing}: no permission to write; expected a folder for the output")
