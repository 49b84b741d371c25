"""`vcavity predict`: the reflectance factor of a surface, as a measurement file."""

import argparse

import numpy as np

import vcavity_jax as vc
from fitting import files
from fitting.cli import arguments, scenes


def run(given: argparse.Namespace) -> int:
    """Print the measurement file, or write it."""
    values = {"angle": given.angle, "roughness": given.roughness}
    own = arguments.OWN_PARAMETER[given.surface]
    scenes.require_surface_options(given, {f"--{name}": value for name, value in values.items()})
    if values[own] is None:
        example = {"angle": "45deg", "roughness": "0.5"}[own]
        raise ValueError(f"--surface {given.surface} needs --{own}: expected e.g. --{own} {example}")
    wavelengths = np.array(given.wavelengths)
    directions = [(polar, azimuth) for azimuth in given.azimuth for polar in given.polar]
    polar, azimuth = np.deg2rad(np.array(directions)).T
    light = vc.Diffuse() if given.illumination is None else vc.Directional(*np.deg2rad(given.illumination))
    scene = vc.Scene(
        surface=scenes.surface(given.surface, {own: values[own]}),
        material=scenes.material(given, wavelengths),
        illumination=light,
        view=vc.View(polar, azimuth),
    )
    factor = np.asarray(vc.reflectance_factor(scene, tolerance=given.tolerance))
    text = "\n".join([*_head(given), *_rows(directions, given.wavelengths, factor)]) + "\n"
    if given.output is None:
        print(text, end="")
    else:
        files.write(given.output, text)
    return 0


def _head(given: argparse.Namespace) -> list[str]:
    """The metadata: what was computed, in the words of the command line."""
    own = arguments.OWN_PARAMETER[given.surface]
    value = f"{np.rad2deg(given.angle):.10g} deg" if own == "angle" else files.number(given.roughness)
    choice = "index" if given.material == "specular" else "reflectance"
    light = "diffuse"
    if given.illumination is not None:
        light = "directional, polar_deg={}, azimuth_deg={}".format(*map(files.number, given.illumination))
    what = f"{given.surface}, {own} {value}, {given.material}, {choice} {getattr(given, choice)}"
    return [
        f"# title: {arguments.one_line(what)}",
        "# instrument: computed by vcavity predict, not measured",
        f"# illumination: {light}",
        "# reflectance_unit: fraction",
        "wavelength_nm,polar_deg,azimuth_deg,reflectance_factor",
    ]


def _rows(directions: list[tuple[float, float]], wavelengths: list[float], factor: np.ndarray) -> list[str]:
    return [
        ",".join(map(files.number, (wavelength, polar, azimuth, value)))
        for (polar, azimuth), row in zip(directions, factor.tolist(), strict=True)
        for wavelength, value in zip(wavelengths, row, strict=True)
    ]
