"""`vcavity predict`: the reflectance factor of a surface, as a measurement file."""

import argparse
from pathlib import Path

import numpy as np

import vcavity_jax as vc
from fitting import Measurement, files, writers
from fitting.cli import messages, scenes
from fitting.readers import geometry


def run(given: argparse.Namespace) -> int:
    """Print the measurement file, or write it."""
    sample = scenes.known_sample(given)
    wavelengths = np.array(given.wavelengths)
    directions = _directions(given)
    if given.geometry is None:
        polar, azimuth = np.deg2rad(np.array(directions)).T
        seen = geometry.Geometry(scenes.light(given.illumination), vc.View(polar, azimuth))
    else:
        seen = geometry.named(given.geometry, given.geometry_azimuth or 0.0, given.trap)
    scene = vc.Scene(
        surface=scenes.surface(sample),
        material=scenes.material(sample, wavelengths),
        illumination=seen.illumination,
        view=seen.view,
    )
    factor = np.asarray(vc.reflectance_factor(scene, tolerance=given.tolerance))
    angles = np.full((2, 1), np.nan)
    if not seen.hemispherical:
        angles = np.stack([seen.view.polar, seen.view.azimuth]).reshape(2, -1)
    predicted = Measurement(
        wavelengths,
        angles[0],
        angles[1],
        factor.reshape(-1, wavelengths.size),
        illumination=seen.illumination,
        metadata=_told(given),
        hemispherical=seen.hemispherical,
    )
    if given.output is None:
        print(writers.to_csv(predicted), end="")
    elif Path(given.output).suffix.lower() in writers.SUFFIXES:
        predicted.write(given.output)
    else:
        files.write(given.output, writers.to_csv(predicted))
    return 0


_OF_GEOMETRIES = {"geometry_azimuth": geometry.TURNED, "trap": geometry.TRAPPED}


def _directions(given: argparse.Namespace) -> list[tuple[float, float]]:
    """Polar angle and azimuth of each view in degrees; none if a geometry names the view."""
    for name, geometries in _OF_GEOMETRIES.items():
        if getattr(given, name) is not None and given.geometry not in geometries:
            without = "without --geometry" if given.geometry is None else f"in --geometry {given.geometry}"
            raise ValueError(
                f"--{name.replace('_', '-')} has no effect {without}: expected --geometry "
                f"{' or '.join(geometries)} with it"
            )
    if given.geometry is None:
        azimuths, polars = given.azimuth or [0.0], given.polar or [0.0]
        return [(polar, azimuth) for azimuth in azimuths for polar in polars]
    for name in ("polar", "azimuth", "illumination"):
        if getattr(given, name) is not None:
            turned = name == "azimuth" and given.geometry in geometry.TURNED
            raise ValueError(
                f"--{name} beside --geometry {given.geometry}, which sets light and view: expected one of them"
                + " (did you mean --geometry-azimuth?)" * turned
            )
    return []


def _told(given: argparse.Namespace) -> dict[str, str]:
    """What was computed, in the words of the command line."""
    return {
        "title": messages.one_line(scenes.described(given)),
        "instrument": "computed by vcavity predict, not measured",
    } | ({} if given.geometry is None else {"geometry": given.geometry})
