"""From the options of a command to the parts of a scene."""

import argparse
import difflib
import re
from pathlib import Path
from typing import Any, Literal

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
_CLEAR = 1e-5
"""The k of an interface that is taken for 0: it changes reflectances by 1e-10."""


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
    words = [given.surface, f"{own} {value}", given.material]
    words += [f"{name} {option}" for name, option in _optical_data(given).items()]
    return ", ".join(words)


def _optical_data(given: argparse.Namespace) -> dict[str, str]:
    """The options that say what the material is, by their names, as they were typed."""
    if given.material != "interfaced":
        name = "index" if given.material == "specular" else "reflectance"
        return {name: getattr(given, name)}
    names = ("reflectance", "index", "polarization", "layer", "layer_model", "coverage", "specular")
    typed = {name.replace("_", " "): getattr(given, name) for name in names}
    return {name: str(option) for name, option in typed.items() if option is not None}


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
            f"--material {given.material} needs --reflectance: a number from 0 to 1, or the file of a spectrum"
        )
    reflectance = jnp.asarray(_spectrum(given, "reflectance", wavelengths_nm))
    if given.material == "lambertian":
        return vc.Lambertian(reflectance)
    if given.index is None:
        raise ValueError("--material interfaced needs --index: that of a clear material, such as 1.5")
    return vc.InterfacedLambertian(
        reflectance,
        jnp.asarray(_clear_index(given.index, wavelengths_nm)),
        _layer(given, wavelengths_nm),
        given.polarization or "unpolarized",
        given.specular != "excluded",
    )


def _refuse_foreign(given: argparse.Namespace) -> None:
    """An option that would have no effect is a mistake: say so."""
    owners: dict[str, list[str]] = {}
    for kind, names in arguments.MATERIALS.items():
        for name in names:
            owners.setdefault(name, []).append(kind)
    for name, kinds in owners.items():
        if getattr(given, name) is not None:
            _require_owner(f"--{name.replace('_', '-')}", "material", kinds, given.material)
    if given.polarization == "separate":
        _require_owner("--polarization separate", "material", ["specular"], given.material)
    for name in ("layer_model", "layer_column", "coverage"):
        if given.layer is None and getattr(given, name) is not None:
            raise ValueError(f"--{name.replace('_', '-')} has no effect without --layer: expected --layer with it")
    if given.coverage is not None and given.layer_model is not None:
        raise ValueError(
            "--layer-model beside --coverage: a halftone has no such model; expected one of the two options"
        )


def _require_owner(option: str, kind: str, owners: list[str], chosen: str) -> None:
    """Refuse an option of another surface or material."""
    if chosen not in owners:
        raise ValueError(f"{option} belongs to --{kind} {' or '.join(owners)}, not to {chosen}")


def _layer(given: argparse.Namespace, wavelengths_nm: np.ndarray) -> Any:
    """The colored layer below an interface; None without one."""
    if given.layer is None:
        return None
    transmittance = jnp.asarray(_one_if_alike(_spectrum(given, "layer", wavelengths_nm)))
    if given.coverage is not None:
        return vc.Halftone(jnp.asarray(given.coverage, float), transmittance)
    return vc.ColoredLayer(transmittance, given.layer_model or "williams-clapper")


def _clear_index(text: str, wavelengths_nm: np.ndarray) -> np.ndarray:
    """The real index of an interface."""
    index = _index(text, wavelengths_nm)
    for what, bad, expected in (
        ("k", index.imag > _CLEAR, "k = 0: an interface is clear (a metal is --material specular)"),
        ("n", index.real < 1, "n ≥ 1 for an interface to air"),
    ):
        if bad.any():
            first = int(np.argmax(bad))
            value = (index.imag if what == "k" else index.real)[first]
            raise ValueError(
                f"--index {text}: {what} is {value:g} at {wavelengths_nm[first]:g} nm; expected {expected}"
            )
    return _one_if_alike(index.real)


def _one_if_alike(values: np.ndarray) -> np.ndarray:
    """One number for all wavelengths if all have the same: an interface is then computed once."""
    return np.asarray(values[0]) if (values == values[0]).all() else values


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


_QUANTITIES: dict[str, Literal["reflectance", "transmittance"]] = {
    "reflectance": "reflectance",
    "layer": "transmittance",
}
"""What the spectra of the options are."""


def _spectrum(given: argparse.Namespace, option: str, wavelengths_nm: np.ndarray) -> np.ndarray:
    """Reflectance of the material, or transmittance of its layer, from a number or a spectrum's file."""
    text = getattr(given, option)
    if re.fullmatch(_NUMBER, text.strip()):
        value = float(text)
        if not 0 <= value <= 1:
            hint = ": did you pass percent?" if 1 < value <= 100 else ""
            raise ValueError(f"--{option} {text}: expected a fraction from 0 to 1{hint}")
        if getattr(given, f"{option}_column") is not None:
            raise ValueError(f"--{option}-column has no effect: --{option} {text} is a number, not a file")
        return np.full(wavelengths_nm.shape, value)
    quantity = _QUANTITIES[option]
    try:
        found_nm, found, _ = read_spectrum(text, column=getattr(given, f"{option}_column"), quantity=quantity)
    except ValueError as error:
        raise ValueError(str(error).replace("column= one of", f"--{option}-column with one of")) from None
    outside = (found < 0) | (found > 1)
    if outside.any():
        first = int(np.argmax(outside))
        raise ValueError(
            f"{text}: {quantity} {found[first]:g} at {found_nm[first]:g} nm; expected 0 to 1 for a material"
        )
    place = np.searchsorted(found_nm, wavelengths_nm).clip(max=found_nm.size - 1)
    missing = found_nm[place] != wavelengths_nm
    if not missing.any():
        return found[place]
    beyond = (wavelengths_nm < found_nm[0]) | (wavelengths_nm > found_nm[-1])
    if beyond.any():
        raise ValueError(
            f"{text}: wavelength {wavelengths_nm[beyond][0]:g} nm is outside the spectrum's range, "
            f"{found_nm[0]:g} nm to {found_nm[-1]:g} nm; expected the spectrum to cover it "
            "(choose less with --wavelengths)"
        )
    if not given.resample:
        raise ValueError(
            f"{text}: no {quantity} at {wavelengths_nm[missing][0]:g} nm; expected a value at every "
            "wavelength used: add --resample to interpolate linearly"
        )
    return np.interp(wavelengths_nm, found_nm, found)


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
            if value is not None and parameter in option:
                _require_owner(option, "surface", kinds, given.surface)
