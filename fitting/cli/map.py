"""`vcavity map`: the reflectance factor and the color of a surface in every direction of view."""
# ruff: noqa: RUF001 (the labels are typeset: Greek letters)

import argparse
import io
from pathlib import Path
from typing import Any

import numpy as np

import vcavity_jax as vc
from fitting import files
from fitting.cli import messages, scenes, words
from fitting.map_plot import plot_maps
from vcavity_jax import colorimetry

_ENDINGS = {"npz": ".npz", "netcdf": ".nc"}
_ABOUT: dict[str, tuple[tuple[str, ...], str, str]] = {
    "u": (("u",), "1", "2 sin(polar/2) cos(azimuth), across the grooves, to the right"),
    "v": (("v",), "1", "2 sin(polar/2) sin(azimuth), along the grooves, up"),
    "wavelength_nm": (("wavelength_nm",), "nm", "wavelength"),
    "polar_deg": (("v", "u"), "degree", "angle of the view from the mean normal"),
    "azimuth_deg": (("v", "u"), "degree", "azimuth of the view, 0 across the grooves, 90 along them"),
    "reflectance_factor": (("v", "u", "wavelength_nm"), "1", "reflectance factor"),
    "srgb": (("v", "u", "color"), "1", "color in sRGB, nonlinear, clipped to 0 to 1"),
    "reflections": (("v", "u"), "1", "most reflections seen in the direction, 0 outside the disk"),
}
"""Dimensions, unit and meaning of what is written."""


def run(given: argparse.Namespace) -> int:
    """Compute the map, write picture and data, print what was written."""
    sample = scenes.known_sample(given)
    picture, data = _targets(given)
    wavelengths = np.array(given.wavelengths)
    light: dict[str, Any] = {
        "illuminant": given.illuminant,
        "observer": f"CIE {given.observer}",
        "partial": given.partial,
    }
    colorimetry.white(wavelengths, **light)  # What gives no color is refused before the work.
    scene = vc.Scene(
        surface=scenes.surface(sample),
        material=scenes.material(sample, wavelengths),
        illumination=scenes.light(given.illumination),
        view=vc.View(),
    )
    chart = vc.reflectance_map(scene, given.size, tolerance=given.tolerance)
    arrays = _arrays(chart, wavelengths, np.asarray(chart.srgb(wavelengths, **light)))
    facts = _facts(given)
    files.write(data, _npz(arrays, facts) if given.format == "npz" else _netcdf(arrays, facts))
    plot_maps([chart], wavelengths, picture, titles=[_title(given)], **light)
    print(f"wrote {picture}", f"wrote {data}", sep="\n")
    return 0


def _title(given: argparse.Namespace) -> str:
    """A short name of the surface."""
    own = words.OWN_PARAMETER[given.surface]
    value = f"α = {np.rad2deg(given.angle):.6g}°" if own == "angle" else f"m = {given.roughness:.6g}"
    known = {"R = ": given.reflectance, "n = ": given.index}
    named = {symbol: Path(text).name for symbol, text in known.items() if text is not None}
    choice = named["n = "] if given.material == "specular" else ", ".join(map("".join, named.items()))
    kind = {"v-grooves": "", "beckmann": "Beckmann grooves, ", "gaussian": "Gaussian grooves, "}[given.surface]
    return f"{kind}{messages.one_line(choice)[-40:]}, {value}"


def _targets(given: argparse.Namespace) -> tuple[Path, Path]:
    """The files to write; a place that cannot take them is refused before the work."""
    base = Path(given.output)
    if base.name == "" or given.output.endswith("/") or base.is_dir():
        raise ValueError(f"--output {given.output}: is a folder; expected a file name without its ending")
    if base.suffix.lower() in (".png", *_ENDINGS.values()):
        raise ValueError(
            f"--output {given.output}: expected a name without its ending; {base.stem!r} writes {base.stem}.png "
            f"and {base.stem}{_ENDINGS[given.format]}"
        )
    if not base.parent.is_dir():
        raise ValueError(f"--output {given.output}: there is no folder {base.parent}; expected one that exists")
    return base.with_name(f"{base.name}.png"), base.with_name(base.name + _ENDINGS[given.format])


def _arrays(chart: vc.ReflectanceMap, wavelengths: np.ndarray, srgb: np.ndarray) -> dict[str, np.ndarray]:
    size = len(srgb)
    centers = np.arange(1 - size, size, 2) * np.sqrt(2) / size
    arrays = {
        "u": centers,
        "v": -centers,
        "wavelength_nm": wavelengths,
        "polar_deg": np.rad2deg(chart.polar),
        "azimuth_deg": np.rad2deg(chart.azimuth),
        "reflectance_factor": np.asarray(chart.reflectance_factor),
        "srgb": srgb,
    }
    if chart.reflections is not None:
        arrays["reflections"] = np.asarray(chart.reflections, np.int32)
    return arrays


def _facts(given: argparse.Namespace) -> dict[str, str]:
    """What was computed, in the words of the command line."""
    kind, *angles = given.illumination or ("diffuse",)
    return {
        "title": messages.one_line(scenes.described(given)),
        "illumination": ":".join([kind, ",".join(map(files.number, angles))]).rstrip(":"),
        "illuminant": given.illuminant,
        "observer": f"CIE {given.observer}",
        "source": f"computed by vcavity map {vc.__version__}, not measured",
        "projection": "Lambert azimuthal equal-area; the disk has the radius sqrt(2), outside it is NaN",
    }


def _npz(arrays: dict[str, np.ndarray], facts: dict[str, str]) -> bytes:
    contents = io.BytesIO()
    named: dict[str, Any] = {**arrays, **{name: np.array(text) for name, text in facts.items()}}
    np.savez_compressed(contents, **named)
    return contents.getvalue()


def _netcdf(arrays: dict[str, np.ndarray], facts: dict[str, str]) -> bytes:
    from scipy.io import netcdf_file  # type: ignore[import-untyped]

    contents = io.BytesIO()
    file = netcdf_file(contents, "w", version=2)
    for name, text in {"Conventions": "CF-1.8", **facts}.items():
        setattr(file, name, text.encode("utf-8"))
    for name, array in arrays.items():
        dimensions, unit, meaning = _ABOUT[name]
        for dimension, length in zip(dimensions, array.shape, strict=True):
            if dimension not in file.dimensions:
                file.createDimension(dimension, length)
        variable = file.createVariable(name, array.dtype.str[1:], dimensions)
        variable[:] = array
        variable.units, variable.long_name = unit, meaning
    file.flush()
    written = contents.getvalue()
    file.close()
    return written
