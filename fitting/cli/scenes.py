"""From the options of a command to the parts of a scene."""

import argparse
import difflib
import re
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

import vcavity_jax as vc
from fitting import files
from fitting.cli import arguments
from fitting.measurement import read_spectrum
from fitting.readers import geometry
from vcavity_jax import materials

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_INDEX = re.compile(rf"({_NUMBER})(?:([+-](?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)[ij])?")


def surface(kind: str, values: dict[str, float]) -> Any:
    """The surface of a kind with the values given; a fit that frees its parameter may leave that out."""
    if kind == "v-grooves":
        return vc.VGrooves(jnp.asarray(values.get("angle", np.pi / 2), float))
    roughness = jnp.asarray(values.get("roughness", 0.5), float)
    return vc.BeckmannGrooves(roughness) if kind == "beckmann" else vc.GaussianGrooves(roughness)


def known_surface(given: argparse.Namespace) -> Any:
    """The surface of a command that computes: its own parameter must be given, the other's must not."""
    values = {"angle": given.angle, "roughness": given.roughness}
    own = arguments.OWN_PARAMETER[given.surface]
    require_surface_options(given, {f"--{name}": value for name, value in values.items()})
    if values[own] is None:
        example = {"angle": "45deg", "roughness": "0.5"}[own]
        raise ValueError(f"--surface {given.surface} needs --{own}: expected e.g. --{own} {example}")
    return surface(given.surface, {own: values[own]})


def described(given: argparse.Namespace) -> str:
    """What a command computes, in its own words: surface, parameter, material and its optical data."""
    own = arguments.OWN_PARAMETER[given.surface]
    value = f"{np.rad2deg(given.angle):.10g} deg" if own == "angle" else files.number(given.roughness)
    choice = "index" if given.material == "specular" else "reflectance"
    return f"{given.surface}, {own} {value}, {given.material}, {choice} {getattr(given, choice)}"


def light(given: tuple[Any, ...] | None) -> Any:
    """The light that `--illumination` asks for; diffuse light without it."""
    made = None if given is None else geometry.light(*given)
    return vc.Diffuse() if made is None else made


def material(given: argparse.Namespace, wavelengths_nm: np.ndarray) -> Any:
    """The material that the options describe, with one value per wavelength.

    Args:
        given: the options of the scene.
        wavelengths_nm: where it is needed, nm, shape (L,).

    Returns:
        A `vcavity_jax` material.

    Raises:
        OSError: a file is missing or cannot be read.
        ValueError: an option is missing, belongs to another material or has a bad value.
    """
    _refuse_foreign(given)
    if given.material == "specular":
        if given.index is None:
            raise ValueError(
                "--material specular needs --index: a table's name, a number or a file "
                "('vcavity materials' lists the tables)"
            )
        return vc.Specular(jnp.asarray(_index(given.index, wavelengths_nm)), given.polarization or "full")
    if given.reflectance is None:
        raise ValueError(
            "--material lambertian needs --reflectance: a number from 0 to 1, or a flat sample's file"
        )
    return vc.Lambertian(jnp.asarray(_reflectance(given, wavelengths_nm)))


def _refuse_foreign(given: argparse.Namespace) -> None:
    """An option that would have no effect is a mistake: say so."""
    own = {"specular": ("index", "polarization"), "lambertian": ("reflectance", "reflectance_column")}
    for owner, names in own.items():
        for name in names:
            if owner != given.material and getattr(given, name) is not None:
                option = name.replace("_", "-")
                raise ValueError(f"--{option} belongs to --material {owner}, not to {given.material}")


def _index(text: str, wavelengths_nm: np.ndarray) -> np.ndarray:
    """Refractive index from a number, a table's name or a file."""
    if match := _INDEX.fullmatch(text.strip()):
        n, k = float(match[1]), float(match[2] or 0)
        if not (n > 0 and k >= 0 and np.isfinite(n + k)):
            raise ValueError(f"--index {text}: expected n + ik with n > 0 and k ≥ 0")
        # Without k it stays real: a dielectric needs no complex arithmetic.
        return np.full(wavelengths_nm.shape, n if match[2] is None else complex(n, k))
    bundled = text in materials.names()
    if bundled or Path(text).exists() or Path(text).suffix.lower() in (".csv", ".yml", ".yaml"):
        try:
            return (materials.refractive_index if bundled else materials.read_index)(text, wavelengths_nm)
        except ValueError as error:
            hint = ": choose others with --wavelengths" if "outside the table's range" in str(error) else ""
            raise ValueError(f"{error}{hint}") from None
    folded = {name.lower(): name for name in materials.names()}
    close = [name for name in folded if text and name.startswith(text.lower())]
    close = close or difflib.get_close_matches(text.lower(), folded, n=1)
    hint = f" (did you mean {' or '.join(folded[name] for name in close)}?)" if close else ""
    raise ValueError(
        f"--index {text}: neither a number, nor a bundled table, nor a file{hint}; expected e.g. 1.5, "
        "0.35+2.7j, index.yml or a name that 'vcavity materials' lists"
    )


def _reflectance(given: argparse.Namespace, wavelengths_nm: np.ndarray) -> np.ndarray:
    """Reflectance of the flat material from a number or a spectrum's file."""
    text = given.reflectance
    if re.fullmatch(_NUMBER, text.strip()):
        value = float(text)
        if not 0 <= value <= 1:
            hint = ": did you pass percent?" if 1 < value <= 100 else ""
            raise ValueError(f"--reflectance {text}: expected a fraction from 0 to 1{hint}")
        return np.full(wavelengths_nm.shape, value)
    try:
        flat_nm, flat, _ = read_spectrum(text, column=given.reflectance_column)
    except ValueError as error:
        raise ValueError(str(error).replace("column= one of", "--reflectance-column with one of")) from None
    outside = (flat < 0) | (flat > 1)
    if outside.any():
        first = int(np.argmax(outside))
        raise ValueError(
            f"{text}: reflectance {flat[first]:g} at {flat_nm[first]:g} nm; expected 0 to 1 for a material"
        )
    place = np.searchsorted(flat_nm, wavelengths_nm).clip(max=flat_nm.size - 1)
    missing = flat_nm[place] != wavelengths_nm
    if not missing.any():
        return flat[place]
    beyond = (wavelengths_nm < flat_nm[0]) | (wavelengths_nm > flat_nm[-1])
    if beyond.any():
        raise ValueError(
            f"{text}: wavelength {wavelengths_nm[beyond][0]:g} nm is outside the spectrum's range, "
            f"{flat_nm[0]:g} nm to {flat_nm[-1]:g} nm; expected the spectrum to cover it "
            "(choose less with --wavelengths)"
        )
    if not given.resample:
        raise ValueError(
            f"{text}: no reflectance at {wavelengths_nm[missing][0]:g} nm; expected a value at every "
            "wavelength used: add --resample to interpolate linearly"
        )
    return np.interp(wavelengths_nm, flat_nm, flat)


def require_surface_options(given: argparse.Namespace, values: dict[str, Any]) -> None:
    """Refuse options that belong to another surface.

    Args:
        given: the options of the scene.
        values: what was given for an option, by the option's name; None if nothing was.

    Raises:
        ValueError: one of them does not belong to the surface.
    """
    owners: dict[str, list[str]] = {}
    for kind, parameter in arguments.OWN_PARAMETER.items():
        owners.setdefault(parameter, []).append(kind)
    for option, value in values.items():
        for parameter, kinds in owners.items():
            if value is not None and parameter in option and given.surface not in kinds:
                raise ValueError(f"{option} belongs to --surface {' or '.join(kinds)}, not to {given.surface}")
