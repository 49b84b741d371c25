"""`vcavity predict`: the reflectance factor of a surface, as a measurement file."""

import argparse
from typing import Any

import numpy as np

import vcavity_jax as vc
from fitting import files
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
    text = "\n".join([*_head(given, seen.illumination), *_rows(directions, given.wavelengths, factor)]) + "\n"
    if given.output is None:
        print(text, end="")
    else:
        files.write(given.output, text)
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


def _head(given: argparse.Namespace, light: Any) -> list[str]:
    """The metadata, what was computed in the words of the command line, and the names of the columns."""
    what = scenes.described(given)
    columns = "wavelength_nm,polar_deg,azimuth_deg,reflectance_factor"
    if given.geometry is None:
        kind, *angles = given.illumination or ("diffuse",)
        named = zip(geometry.LIGHTS[kind], map(files.number, angles), strict=True)
        seen = [f"illumination: {', '.join([kind, *map('='.join, named)])}"]
    else:
        columns = "wavelength_nm,reflectance_factor"
        seen = [f"geometry: {given.geometry}"]
        if given.geometry in geometry.TURNED:
            seen.append(f"geometry_azimuth_deg: {files.number(given.geometry_azimuth or 0.0)}")
        if given.geometry in geometry.TRAPPED:
            # Also the usual one, so that the file keeps its meaning; without what radians add to its digits.
            usual = round(float(np.rad2deg(light.half_angle)), 9)
            seen.append(f"trap_half_angle_deg: {files.number(usual if given.trap is None else given.trap)}")
    return [
        f"# title: {messages.one_line(what)}",
        "# instrument: computed by vcavity predict, not measured",
        *(f"# {line}" for line in seen),
        "# reflectance_unit: fraction",
        columns,
    ]


def _rows(directions: list[tuple[float, float]], wavelengths: list[float], factor: np.ndarray) -> list[str]:
    """One line for each value; without directions there is one spectrum."""
    table = factor.reshape(-1, len(wavelengths)).tolist()
    columns: list[tuple[float, ...]] = [*directions] or [()]
    return [
        ",".join(map(files.number, (wavelength, *direction, value)))
        for direction, row in zip(columns, table, strict=True)
        for wavelength, value in zip(wavelengths, row, strict=True)
    ]
