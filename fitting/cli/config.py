"""A fit from a config file (TOML), which can say more than options: several measurements, priors, formulas."""

import dataclasses
import os
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from fitting import Measurement, free
from fitting.cli import config_parameters, keys, messages, request, scenes, words
from fitting.cli.config_parameters import Freed
from fitting.cli.keys import Check, Place
from fitting.readers.geometry import GEOMETRIES

_SAMPLE: dict[str, Check] = {
    "index": keys.word_or_number,
    "polarization": keys.choice(*words.POLARIZATIONS),
    "reflectance": keys.word_or_number,
    "reflectance_column": keys.text,
    "resample": keys.flag,
    "layer": keys.word_or_number,
    "layer_column": keys.text,
    "layer_model": keys.choice(*words.LAYER_MODELS),
    "coverage": keys.of_word(words.share),
    "specular": keys.choice(*words.SPECULAR),
    "angle_deg": keys.angle,
    "roughness": keys.of_word(words.roughness),
}
"""What may also be said of one measurement, whose sample then differs in it."""

SCENE: dict[str, Check] = {
    "surface": keys.choice(*words.OWN_PARAMETER),
    "material": keys.choice(*words.MATERIALS),
    **_SAMPLE,
}
_MEASUREMENT: dict[str, Check] = {
    "file": keys.text,
    "name": keys.text,
    "column": keys.text,
    "reflectance_unit": keys.choice(*words.UNITS),
    "geometry": keys.choice(*GEOMETRIES),
    "geometry_azimuth_deg": keys.of_word(words.azimuth),
    "trap_half_angle_deg": keys.of_word(words.half_angle),
    "wavelengths_nm": keys.span,
    "masked_nm": keys.many(keys.span, "a list of ranges, such as [[400, 450]]"),
    "uncertainty": keys.of_word(words.positive),
    **_SAMPLE,
}
_FIT: dict[str, Check] = {
    "tolerance": keys.of_word(words.positive),
    "uncertainty": keys.of_word(words.positive),
    "max_steps": keys.count,
}
_TOP: dict[str, Check] = {
    "measurement": lambda value, place: _measurement_tables(value, place),
    "scene": lambda value, place: keys.table(value, place, SCENE),
    "parameters": lambda value, place: value,
    "fit": lambda value, place: keys.table(value, place, _FIT),
}


def read(path: str, measurement: str | None = None) -> request.Request:
    """The fit that a config file describes.

    Args:
        path: the file. File names in it are relative to its folder.
        measurement: the file to fit, if the config names none.

    Raises:
        OSError: a file is missing or cannot be read.
        ValueError: something in it is not as expected. The message is one line: file, key, what is wrong, what
            is expected.
    """
    file = Place(path)
    content = keys.table(parsed(path), file, _TOP)
    tables = _with_files(content.get("measurement", []), file, measurement)
    labels = _labels(tables, file)
    scene, options = content.get("scene", {}), content.get("fit", {})
    if "material" not in scene:
        raise file.at("scene", "material").error(f"missing; expected one of: {', '.join(words.MATERIALS)}")
    given = content.get("parameters", {})
    lowest = words.ANGLE_RANGE[scene["material"]][0]
    freed = config_parameters.read(given, file.at("parameters"), labels, {"angle": {"lower_deg": lowest}})
    if not freed:
        freed = [_own(scene, tables, file, labels, lowest)]
    if "uncertainty" in options:
        options["standard_uncertainty"] = options.pop("uncertainty")
        _refuse_second_uncertainty(tables, file)
    single, made = len(labels) == 1, {}
    for i, (label, table) in enumerate(zip(labels, tables, strict=True)):
        place = file.at("measurement", i)
        try:
            shifted = any(one.name == "wavelength_shift" and label in one.labels for one in freed)
            measured = _measured(table, place, shifted)
            made[label] = request.seen(sample(table, place, label, scene, freed), measured), measured
        except (OSError, ValueError) as error:
            message = messages.described(error)
            told = message.startswith(f"{path}: ")
            raise (ValueError(message) if told else (file if single else place).error(message)) from None
    parts: list[Any] = [{label: pair[i] for label, pair in made.items()} for i in (0, 1)]
    source = Path(path if measurement is None else measurement)
    return request.Request(
        scene=parts[0][labels[0]] if single else parts[0],
        measurement=parts[1][labels[0]] if single else parts[1],
        parameters=[p for one in freed for p in one.made],
        options=options,
        folder=source.with_name(f"{source.stem}-fit"),
        explained=lambda message: str(file.error(message)),
    )


def parsed(path: str) -> dict[str, Any]:
    """The content of a TOML file."""
    source = Path(path)
    if not source.exists():
        raise FileNotFoundError(f"{path}: no such file; expected a config file (TOML)")
    if source.is_dir():
        raise IsADirectoryError(f"{path}: is a directory; expected a config file (TOML)")
    try:
        return tomllib.loads(source.read_bytes().decode("utf-8-sig"))
    except UnicodeDecodeError:
        raise ValueError(f"{path}: the text is not UTF-8; expected a config file (TOML)") from None
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{path}: {error}; expected TOML") from None
    except RecursionError:
        raise ValueError(f"{path}: lists or tables are nested too deeply; expected a config file") from None


def _measurement_tables(value: Any, place: Place) -> list[dict[str, Any]]:
    if not isinstance(value, list):
        raise place.error(f"{keys.shown(value)}; expected [[measurement]], in double brackets")
    return [keys.table(v, place.at(i), _MEASUREMENT) for i, v in enumerate(value)]


def _with_files(tables: list[dict[str, Any]], file: Place, measurement: str | None) -> list[dict[str, Any]]:
    """The tables of the measurements, each with its file."""
    place = file.at("measurement")
    if measurement is not None:
        named = any("file" in table for table in tables)
        if named or len(tables) > 1:
            how = "names its own" if named else "has several [[measurement]]"
            raise file.error(f"MEASUREMENT {measurement} beside a config that {how}; expected one of them")
        return [{**(tables[0] if tables else {}), "file": measurement}]
    if not tables:
        raise place.error("missing; expected [[measurement]] with a file, or MEASUREMENT on the command line")
    for i, table in enumerate(tables):
        if "file" not in table:
            raise place.at(i, "file").error("missing; expected the name of a measurement file")
    folder = os.path.dirname(file.file)
    return [{**table, "file": os.path.join(folder, table["file"])} for table in tables]


def _labels(tables: list[dict[str, Any]], file: Place) -> list[str]:
    """The names of the measurements, each once."""
    labels = [table.get("name", Path(table["file"]).stem) for table in tables]
    for i, label in enumerate(labels):
        if label in labels[:i]:
            first = file.at("measurement", labels.index(label)).path
            raise file.at("measurement", i, "name").error(
                f"{label!r} is the name of {first} too; expected distinct names, or files whose names differ"
            )
    return labels


def _own(
    scene: dict[str, Any], tables: list[dict[str, Any]], file: Place, labels: list[str], lowest: float
) -> Freed:
    """What is free if no parameter is named: the surface's own."""
    own = words.OWN_PARAMETER[scene.get("surface", "v-grooves")]
    key = "angle_deg" if own == "angle" else own
    if any(key in table for table in (scene, *tables)):
        raise file.at("scene", key).error(
            f"leaves nothing to fit; expected a table such as [parameters.{own}] or [parameters.gain] with it"
        )
    made = free.angle(lower_deg=lowest) if own == "angle" else free.roughness()
    return Freed(own, file.at("parameters"), [made], tuple(labels))


def _refuse_second_uncertainty(tables: list[dict[str, Any]], file: Place) -> None:
    for i, table in enumerate(tables):
        if "uncertainty" in table:
            place = file.at("measurement", i, "uncertainty")
            raise place.error("beside fit.uncertainty, which replaces it; expected one of them")


def _measured(table: dict[str, Any], place: Place, shifted: bool) -> Measurement:
    """What the file of a measurement holds, as far as it is wanted.

    Where the wavelength scale is shifted, what is masked stays as missing values: the prediction is interpolated
    between neighbors.
    """
    said = ("column", "reflectance_unit", "geometry", "geometry_azimuth_deg", "trap_half_angle_deg")
    found = Measurement.read(table["file"], **{key: table[key] for key in said if key in table})
    if "wavelengths_nm" in table:
        try:
            found = found.select(wavelengths_nm=table["wavelengths_nm"])
        except ValueError as error:
            raise place.at("wavelengths_nm").error(str(error)) from None
    masked = np.zeros(found.wavelengths_nm.shape, bool)
    for i, (low, high) in enumerate(table.get("masked_nm", ())):
        inside = (found.wavelengths_nm >= low) & (found.wavelengths_nm <= high)
        if not inside.any():
            raise place.at("masked_nm", i).error(
                f"no wavelength lies within {low:g} to {high:g} nm; expected a range that has some"
            )
        masked |= inside
    if masked.all():
        raise place.at("masked_nm").error("no wavelength is left; expected ranges that leave some")
    if masked.any():
        found = _without(found, masked, shifted)
    if "uncertainty" in table:
        sigma = np.full(found.reflectance_factor.shape, table["uncertainty"])
        found = dataclasses.replace(found, standard_uncertainty=sigma)
    return found


def _without(measurement: Measurement, masked: np.ndarray, shifted: bool) -> Measurement:
    if shifted:
        values = np.where(masked, np.nan, measurement.reflectance_factor)
        return dataclasses.replace(measurement, reflectance_factor=values)
    sigma = measurement.standard_uncertainty
    return dataclasses.replace(
        measurement,
        wavelengths_nm=measurement.wavelengths_nm[~masked],
        reflectance_factor=measurement.reflectance_factor[:, ~masked],
        standard_uncertainty=None if sigma is None else sigma[:, ~masked],
    )


def sample(
    table: dict[str, Any], place: Place, label: str, scene: dict[str, Any], freed: list[Freed]
) -> scenes.Sample:
    """The sample of one measurement: what the scene says, or the measurement itself."""
    said = {name: table[name] if name in table else scene.get(name) for name in _SAMPLE}

    def spell(name: str) -> str:
        key = {"angle": "angle_deg", "wavelengths": "wavelengths_nm"}.get(name, name)
        home = place.path if key in table or key == "wavelengths_nm" else "scene"
        return f"{home}.{key}"

    mine = [one for one in freed if label in one.labels]
    degrees = said.pop("angle_deg")
    sample = scenes.Sample(
        spell=spell,
        surface=scene.get("surface", "v-grooves"),
        material=scene["material"],
        angle=None if degrees is None else float(np.radians(degrees)),
        free=frozenset(one.name for one in mine),
        index_kind=next((one.index_kind for one in mine if one.name == "index"), None),
        folder=os.path.dirname(place.file),
        **said,
    )
    for name in ("angle", "roughness"):
        if getattr(sample, name) is not None:
            scenes.require_place(sample, name, spell(name))
    for one in mine:
        scenes.require_place(sample, one.name, one.place.path)
        if one.around and getattr(sample, one.name, "") is None:
            raise one.place.at("prior").error(f"is around the scene's own; expected {spell(one.name)} with it")
    own = words.OWN_PARAMETER[sample.surface]
    if own not in sample.free and getattr(sample, own) is None:
        raise place.error(f"{own} is neither free nor said: expected [parameters.{own}] or {spell(own)}")
    return sample
