"""`vcavity plan`: which directions to measure next."""

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

import vcavity_jax as vc
from fitting import files, plan_views
from fitting.cli import messages, request, scenes, words
from fitting.cli.fit import require_writable


def run(given: argparse.Namespace) -> int:
    """Print the plan, write it if asked to; 0 if everything becomes identifiable, else 1."""
    own = words.OWN_PARAMETER[given.surface]
    names = list(dict.fromkeys(given.free)) or [own]
    sample = scenes.known_sample(given, free=frozenset(names), index_kind="constant" if "index" in names else None)
    held = {} if own in names else {own: getattr(given, own)}
    parameters = request.free_parameters(given, sample, names, held)
    spread = _spread(given, own, names)
    folder = None if given.output is None else Path(given.output)
    if folder is not None:
        require_writable(folder)
    wavelengths = np.array(given.wavelengths)
    lights = {_called(words_of): scenes.light(words_of) for words_of in given.illumination or [("diffuse",)]}
    azimuth, polar = np.meshgrid(np.deg2rad(given.azimuth), np.deg2rad(given.polar), indexing="ij")
    view = vc.View(polar.ravel(), azimuth.ravel())
    scene = vc.Scene(
        scenes.surface(sample), scenes.material(sample, wavelengths), next(iter(lights.values())), vc.View()
    )
    plan = plan_views(
        scene,
        parameters,
        {name: (light, view) for name, light in lights.items()},
        given.count,
        given.noise,
        measured=tuple(np.deg2rad(given.measured).T) if given.measured else None,
        criterion=given.criterion,
        method=given.method,
        wavelengths_nm=wavelengths,
        interest=given.interest,
        spread=spread,
        tolerance=given.tolerance,
    )
    written = []
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        written = [folder / name for name in ("plan.json", "plan.csv", "plan.png")]
        plan.to_json(written[0])
        plan.to_csv(written[1])
        plan.plot(written[2])
    if given.json:
        print(files.to_json(plan.to_dict()))
    else:
        print(plan.summary())
        if sample.material != "specular" and sample.reflectance is None:
            print("reflectance: a gray of 0.5 is assumed; expected --reflectance with what the sample is like")
        print(*(f"wrote {path}\n" for path in written), sep="", end="")
    if plan.all_identifiable:
        return 0
    sys.stdout.flush()
    print(f"vcavity: {messages.one_line(plan.message)}", file=sys.stderr)
    return 1


def _called(light: tuple[Any, ...]) -> str:
    """A light in the words of the command line."""
    kind, *angles = light
    return f"{kind}:{','.join(files.number(angle) for angle in angles)}" if angles else str(kind)


def _spread(given: argparse.Namespace, own: str, names: list[str]) -> dict[str, float] | None:
    """The half-width of the surface's own parameter, in its own unit."""
    if given.spread is None:
        return None
    if own not in names:
        raise ValueError(f"--spread has no effect: {own} is not free")
    value, unit = given.spread
    if own == "roughness" and unit:
        raise ValueError(f"--spread {value:g}{unit}: expected a number without unit, because it is a roughness")
    return {own: value if own == "roughness" or unit == "rad" else float(np.deg2rad(value))}
