"""From what options or a config file say of a sample to the parts of a scene."""

import argparse
import difflib
import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np

import vcavity_jax as vc
from fitting import files
from fitting.cli import words
from fitting.measurement import read_spectrum
from fitting.readers import geometry
from vcavity_jax import materials

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_INDEX = re.compile(rf"({_NUMBER})(?:([+-](?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)[ij])?")
_CLEAR = 1e-5
"""The k of an interface that is taken for 0: it changes reflectances by 1e-10."""


@dataclass(frozen=True, kw_only=True)
class Sample:
    """A surface and its material in words, whoever said them.

    Args:
        spell: how a word is called where it was given: `--layer-model`, or `scene.layer_model`.
        surface: a key of `words.OWN_PARAMETER`.
        material: a key of `words.MATERIALS`, which lists the options that belong to it.
        angle: dihedral angle, radians; None if it is free or not said.
        roughness: likewise.
        free: the parameters that a fit will put in, which need no value.
        index_kind: what the index is if it is free: one number, a real spectrum or a complex one.
        folder: where relative file names start; "" for the working directory.
    """

    spell: Callable[[str], str]
    surface: str
    material: str
    index: str | None = None
    polarization: Any = None
    reflectance: str | None = None
    reflectance_column: str | None = None
    resample: bool | None = None
    layer: str | None = None
    layer_column: str | None = None
    layer_model: Any = None
    coverage: float | None = None
    specular: str | None = None
    angle: float | None = None
    roughness: float | None = None
    free: frozenset[str] = frozenset()
    index_kind: Literal["constant", "real", "complex"] | None = None
    folder: str | os.PathLike[str] = ""


def of_options(given: argparse.Namespace, **more: Any) -> Sample:
    """The sample that the options of a command describe; angle, roughness and what is free come extra."""
    named = {name for names in words.MATERIALS.values() for name in names}
    return Sample(
        spell=lambda name: f"--{name.replace('_', '-')}",
        surface=given.surface,
        material=given.material,
        **{name: getattr(given, name) for name in named},
        **more,
    )


def known_sample(given: argparse.Namespace, **more: Any) -> Sample:
    """The sample of a command that computes: its own parameter must be given, the other's must not."""
    sample = of_options(given, angle=given.angle, roughness=given.roughness, **more)
    own = words.OWN_PARAMETER[given.surface]
    for name in ("angle", "roughness"):
        if getattr(given, name) is not None:
            require_place(sample, name, f"--{name}")
    if getattr(given, own) is None:
        example = {"angle": "45deg", "roughness": "0.5"}[own]
        raise ValueError(f"--surface {given.surface} needs --{own}: expected e.g. --{own} {example}")
    return sample


def described(given: argparse.Namespace) -> str:
    """What a command computes, in its own words: surface, parameter, material and its optical data."""
    own = words.OWN_PARAMETER[given.surface]
    value = f"{np.rad2deg(given.angle):.10g} deg" if own == "angle" else files.number(given.roughness)
    said = [given.surface, f"{own} {value}", given.material]
    said += [f"{name} {option}" for name, option in _optical_data(given).items()]
    return ", ".join(said)


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


def surface(sample: Sample) -> Any:
    """The surface; where its parameter is free, any value stands in."""
    if sample.surface == "v-grooves":
        return vc.VGrooves(jnp.asarray(np.pi / 2 if sample.angle is None else sample.angle, float))
    roughness = jnp.asarray(0.5 if sample.roughness is None else sample.roughness, float)
    return vc.BeckmannGrooves(roughness) if sample.surface == "beckmann" else vc.GaussianGrooves(roughness)


def material(sample: Sample, wavelengths_nm: np.ndarray) -> Any:
    """The material, with one value per wavelength.

    Args:
        sample: what it is.
        wavelengths_nm: where it is needed, nm, shape (L,).

    Returns:
        A `vcavity_jax` material.

    Raises:
        OSError: a file is missing or cannot be read.
        ValueError: a word is missing, belongs to another material or has a bad value.
    """
    _refuse_foreign(sample)
    called = f"{sample.spell('material')} {sample.material}"
    if sample.material == "specular":
        if sample.index is None and sample.index_kind in (None, "complex"):
            raise ValueError(
                f"{called} needs {sample.spell('index')}: a table's name, a number or a file "
                "('vcavity materials' lists the tables)"
            )
        return vc.Specular(jnp.asarray(_mirror_index(sample, wavelengths_nm)), sample.polarization or "full")
    if sample.reflectance is None and "reflectance" not in sample.free:
        raise ValueError(
            f"{called} needs {sample.spell('reflectance')}: a number from 0 to 1, or the file of a spectrum"
        )
    reflectance = jnp.asarray(_spectrum(sample, "reflectance", wavelengths_nm))
    if sample.material == "lambertian":
        return vc.Lambertian(reflectance)
    if sample.index is None and sample.index_kind is None:
        raise ValueError(f"{called} needs {sample.spell('index')}: that of a clear material, such as 1.5")
    return vc.InterfacedLambertian(
        reflectance,
        jnp.asarray(_one_if_alike(_clear_index(sample, wavelengths_nm))),
        _layer(sample, wavelengths_nm),
        sample.polarization or "unpolarized",
        sample.specular != "excluded",
    )


def require_place(sample: Sample, parameter: str, said: str) -> None:
    """Refuse what is said of a parameter that neither the surface nor the material has.

    Args:
        sample: what has parameters.
        parameter: one of `words.PARAMETERS`.
        said: what was given for it, such as "--free angle".

    Raises:
        ValueError: it does not belong to the sample.
    """
    surfaces = [kind for kind, own in words.OWN_PARAMETER.items() if own == parameter]
    if surfaces and sample.surface not in surfaces:
        raise ValueError(_belongs(sample, said, "surface", surfaces))
    kinds = [kind for kind, names in words.MATERIALS.items() if parameter in names]
    if parameter == "transmittance":
        kinds = ["interfaced"]
    if kinds and sample.material not in kinds:
        raise ValueError(_belongs(sample, said, "material", kinds))
    needed = {"transmittance": ("layer",), "coverage": ("layer", "coverage")}.get(parameter, ())
    if any(getattr(sample, name) is None for name in needed):
        names = " with ".join(map(sample.spell, needed))
        raise ValueError(f"{said} has no effect without {sample.spell(needed[-1])}: expected {names} beside it")


def _belongs(sample: Sample, said: str, part: str, owners: list[str]) -> str:
    chosen = getattr(sample, part)
    return f"{said} belongs to {sample.spell(part)} {' or '.join(owners)}, not to {chosen}"


def _refuse_foreign(sample: Sample) -> None:
    """A word that would have no effect is a mistake: say so."""
    owners: dict[str, list[str]] = {}
    for kind, names in words.MATERIALS.items():
        for name in names:
            owners.setdefault(name, []).append(kind)
    for name, kinds in owners.items():
        if getattr(sample, name) is not None and sample.material not in kinds:
            raise ValueError(_belongs(sample, sample.spell(name), "material", kinds))
    if sample.polarization == "separate" and sample.material != "specular":
        raise ValueError(_belongs(sample, f"{sample.spell('polarization')} separate", "material", ["specular"]))
    useless = {"layer_model": "layer", "layer_column": "layer", "coverage": "layer"}
    for name, of in (useless | {"reflectance_column": "reflectance"}).items():
        if getattr(sample, of) is None and getattr(sample, name) is not None:
            needed = sample.spell(of)
            raise ValueError(f"{sample.spell(name)} has no effect without {needed}: expected {needed} with it")
    if sample.coverage is not None and sample.layer_model is not None:
        raise ValueError(
            f"{sample.spell('layer_model')} beside {sample.spell('coverage')}: a halftone has no such model; "
            "expected one of the two options"
        )


def _layer(sample: Sample, wavelengths_nm: np.ndarray) -> Any:
    """The colored layer below an interface; None without one."""
    if sample.layer is None:
        return None
    transmittance = jnp.asarray(_one_if_alike(_spectrum(sample, "layer", wavelengths_nm)))
    if sample.coverage is not None:
        return vc.Halftone(jnp.asarray(sample.coverage, float), transmittance)
    return vc.ColoredLayer(transmittance, sample.layer_model or "williams-clapper")


def _mirror_index(sample: Sample, wavelengths_nm: np.ndarray) -> np.ndarray:
    """The index of a specular material, in the form in which it is free."""
    if sample.index_kind in (None, "complex"):
        index = _index(sample, wavelengths_nm)
        return index if sample.index_kind is None else index.astype(complex)
    return _clear_index(sample, wavelengths_nm)


def _clear_index(sample: Sample, wavelengths_nm: np.ndarray) -> np.ndarray:
    """The real index of a clear material: of an interface, or one that is free without k."""
    kind, said = sample.index_kind, f"{sample.spell('index')} {sample.index}"
    if kind == "constant" and sample.index is not None and not re.fullmatch(_NUMBER, sample.index.strip()):
        raise ValueError(
            f"{said}: expected a number such as 1.5, or none: one real index for all wavelengths is free"
        )
    index = np.full(wavelengths_nm.shape, 1.5) if sample.index is None else _index(sample, wavelengths_nm)
    clear = "k = 0: an interface is clear (a metal is {} specular)".format(sample.spell("material"))
    if sample.material == "specular":
        clear = "k = 0, because n alone is free: for a metal free n and k"
    for what, bad, expected in (
        ("k", index.imag > _CLEAR, clear),
        ("n", index.real < 1, "n ≥ 1 for an interface to air"),
    ):
        if bad.any():
            first = int(np.argmax(bad))
            value = (index.imag if what == "k" else index.real)[first]
            raise ValueError(f"{said}: {what} is {value:g} at {wavelengths_nm[first]:g} nm; expected {expected}")
    return np.asarray(index.real[0]) if kind == "constant" else index.real


def _one_if_alike(values: np.ndarray) -> np.ndarray:
    """One number for all wavelengths if all have the same: an interface is then computed once."""
    return np.asarray(values.flat[0]) if (values == values.flat[0]).all() else values


def _index(sample: Sample, wavelengths_nm: np.ndarray) -> np.ndarray:
    """Refractive index from a number, a table's name or a file."""
    text, said = sample.index or "", sample.spell("index")
    if match := _INDEX.fullmatch(text.strip()):
        n, k = float(match[1]), float(match[2] or 0)
        if not (n > 0 and k >= 0 and np.isfinite(n + k)):
            raise ValueError(f"{said} {text}: expected n + ik with n > 0 and k ≥ 0")
        # Without k it stays real: a dielectric needs no complex arithmetic.
        return np.full(wavelengths_nm.shape, n if match[2] is None else complex(n, k))
    bundled, path = text in materials.names(), os.path.join(sample.folder, text)
    if bundled or Path(path).exists() or Path(path).suffix.lower() in (".csv", ".yml", ".yaml"):
        try:
            if bundled:
                return materials.refractive_index(text, wavelengths_nm)
            return materials.read_index(path, wavelengths_nm)
        except ValueError as error:
            beyond = "outside the table's range" in str(error)
            hint = f": choose others with {sample.spell('wavelengths')}" if beyond else ""
            raise ValueError(f"{error}{hint}") from None
    folded = {name.lower(): name for name in materials.names()}
    close = [name for name in folded if text and name.startswith(text.lower())]
    close = close or difflib.get_close_matches(text.lower(), folded, n=1)
    hint = f" (did you mean {' or '.join(folded[name] for name in close)}?)" if close else ""
    raise ValueError(
        f"{said} {text}: neither a number, nor a bundled table, nor a file{hint}; expected e.g. 1.5, "
        "0.35+2.7j, index.yml or a name that 'vcavity materials' lists"
    )


_QUANTITIES: dict[str, Literal["reflectance", "transmittance"]] = {
    "reflectance": "reflectance",
    "layer": "transmittance",
}
"""What the spectra of the options are."""


def _spectrum(sample: Sample, option: str, wavelengths_nm: np.ndarray) -> np.ndarray:
    """Reflectance of the material, or transmittance of its layer, from a number or a spectrum's file."""
    text, said, column = getattr(sample, option), sample.spell(option), f"{option}_column"
    if text is None:  # It is free.
        return np.full(wavelengths_nm.shape, 0.5)
    if re.fullmatch(_NUMBER, text.strip()):
        value = float(text)
        if not 0 <= value <= 1:
            hint = ": did you pass percent?" if 1 < value <= 100 else ""
            raise ValueError(f"{said} {text}: expected a fraction from 0 to 1{hint}")
        if getattr(sample, column) is not None:
            raise ValueError(f"{sample.spell(column)} has no effect: {said} {text} is a number, not a file")
        return np.full(wavelengths_nm.shape, value)
    quantity, path = _QUANTITIES[option], os.path.join(sample.folder, text)
    try:
        found_nm, found, _ = read_spectrum(path, column=getattr(sample, column), quantity=quantity)
    except ValueError as error:
        wanted = f"{sample.spell(column)} with one of"
        raise ValueError(str(error).replace("column= one of", wanted)) from None
    outside = (found < 0) | (found > 1)
    if outside.any():
        first = int(np.argmax(outside))
        raise ValueError(
            f"{path}: {quantity} {found[first]:g} at {found_nm[first]:g} nm; expected 0 to 1 for a material"
        )
    place = np.searchsorted(found_nm, wavelengths_nm).clip(max=found_nm.size - 1)
    missing = found_nm[place] != wavelengths_nm
    if not missing.any():
        return found[place]
    beyond = (wavelengths_nm < found_nm[0]) | (wavelengths_nm > found_nm[-1])
    if beyond.any():
        raise ValueError(
            f"{path}: wavelength {wavelengths_nm[beyond][0]:g} nm is outside the spectrum's range, "
            f"{found_nm[0]:g} nm to {found_nm[-1]:g} nm; expected the spectrum to cover it "
            f"(choose less with {sample.spell('wavelengths')})"
        )
    if not sample.resample:
        raise ValueError(
            f"{path}: no {quantity} at {wavelengths_nm[missing][0]:g} nm; expected a value at every "
            f"wavelength used: add {sample.spell('resample')} to interpolate linearly"
        )
    return np.interp(wavelengths_nm, found_nm, found)
