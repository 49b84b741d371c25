"""`vcavity design`: the parameters that make a surface look as wished, from a file (TOML)."""

import argparse
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np

import vcavity_jax as vc
from fitting import Design, design, files, read_spectrum, target
from fitting.cli import config, config_parameters, keys, messages, scenes, words
from fitting.cli.fit import require_writable
from fitting.cli.keys import Check, Place
from vcavity_jax import colorimetry

_LOOK: dict[str, Check] = {
    "polar_deg": keys.number,
    "azimuth_deg": keys.number,
    "illumination": keys.text,
    "illuminant": keys.choice(*colorimetry.ILLUMINANTS),
    "observer": keys.choice(*colorimetry.OBSERVERS),
}


def _three(value: Any, place: Place) -> tuple[float, ...]:
    """L*, a*, b*."""
    if not isinstance(value, list) or len(value) != 3:
        raise place.error(f"{keys.shown(value)}; expected three numbers, [L*, a*, b*]")
    return tuple(keys.number(v, place) for v in value)


def _positive(value: Any, place: Place) -> float:
    """A number above 0."""
    found = keys.number(value, place)
    if found <= 0:
        raise place.error(f"{found:g}; expected a number above 0")
    return found


_TARGET: dict[str, Check] = {
    "name": keys.text,
    "lab": _three,
    "spectrum": keys.text,
    "alike": _positive,
    "different": _positive,
    "step": _positive,
    "looks": keys.many(lambda v, p: keys.table(v, p, _LOOK), "two looks, [{ polar_deg = 0 }, { polar_deg = 60 }]"),
    **_LOOK,
}
_SCENE: dict[str, Check] = {
    **config.SCENE,
    "illumination": keys.text,
    "wavelengths_nm": lambda value, place: _grid(value, place),
}
_SEARCH: dict[str, Check] = {
    "starts": keys.count,
    "seed": keys.count,
    "tolerance": _positive,
    "max_steps": keys.count,
}
_TOP: dict[str, Check] = {
    "scene": lambda value, place: keys.table(value, place, _SCENE),
    "parameters": lambda value, place: value,
    "target": lambda value, place: _tables(value, place),
    "search": lambda value, place: keys.table(value, place, _SEARCH),
}


def run(given: argparse.Namespace) -> int:
    """Print the design, write it if asked to; 0 if every target is met, else 1."""
    path = given.file
    if given.output is not None:
        require_writable(Path(given.output).parent)
    file = Place(path)
    content = keys.table(config.parsed(path), file, _TOP)
    found = _designed(content, file)
    if given.output is not None:
        found.to_json(given.output)
    if given.json:
        print(files.to_json(found.to_dict()))
    else:
        print(found.summary())
        if given.output is not None:
            print(f"wrote {given.output}")
    if found.met:
        return 0
    sys.stdout.flush()
    print(f"vcavity: {messages.one_line(found.message)}", file=sys.stderr)
    return 1


def _designed(content: dict[str, Any], file: Place) -> Design:
    scene = content.get("scene", {})
    for key, expected in (
        ("material", f"one of: {', '.join(words.MATERIALS)}"),
        ("wavelengths_nm", "[first, last, step], as [400, 700, 10]"),
    ):
        if key not in scene:
            raise file.at("scene", key).error(f"missing; expected {expected}")
    if not content.get("target"):
        raise file.at("target").error("missing; expected [[target]] with lab, spectrum, alike or different")
    grid = scene.pop("wavelengths_nm")
    light = _light(scene.pop("illumination", None), file.at("scene", "illumination"))
    lowest = words.ANGLE_RANGE[scene["material"]][0]
    freed = config_parameters.read(
        content.get("parameters", {}), file.at("parameters"), ["design"], {"angle": {"lower_deg": lowest}}
    )
    if not freed:
        raise file.at("parameters").error("missing; expected a table such as [parameters.angle]")
    try:
        sample = config.sample({}, file.at("scene"), "design", scene, freed)
        made = vc.Scene(scenes.surface(sample), scenes.material(sample, grid), light or vc.Diffuse(), vc.View())
        wishes = [_wish(table, file.at("target", i), grid) for i, table in enumerate(content["target"])]
        parameters = [p for one in freed for p in one.made]
        return design(made, parameters, wishes, wavelengths_nm=grid, **content.get("search", {}))
    except ValueError as error:
        told = str(error).startswith(f"{file.file}: ")
        raise (error if told else file.error(str(error))) from None


def _wish(table: dict[str, Any], place: Place, grid: np.ndarray) -> target.Target:
    """One [[target]]."""
    kinds = [kind for kind in ("lab", "spectrum", "alike", "different") if kind in table]
    if len(kinds) != 1:
        said = " and ".join(kinds) or "none of them"
        raise place.error(f"{said}; expected one of lab, spectrum, alike, different")
    kind, name = kinds[0], table.get("name", "")
    own = {key: table[key] for key in _LOOK if key in table}
    if kind in ("alike", "different"):
        if "step" in table:
            raise place.at("step").error(f"has no effect beside {kind}; expected it with lab or spectrum")
        if own or len(table.get("looks", ())) != 2:
            raise place.at("looks").error("expected two looks, [{ polar_deg = 0 }, { polar_deg = 60 }]")
        first, second = (_look(one, place.at("looks", i)) for i, one in enumerate(table["looks"]))
        limit = {"most" if kind == "alike" else "least": table[kind]}
        return getattr(target, kind)(first, second, name=name, **limit)
    if "looks" in table:
        raise place.at("looks").error(f"beside {kind}; expected polar_deg, azimuth_deg and so on, of one look")
    step = {"step": table["step"]} if "step" in table else {}
    look = _look(own, place)
    if kind == "lab":
        return target.color(table["lab"], look, name=name, **step)
    path = os.path.join(os.path.dirname(place.file), table["spectrum"])
    nm, values, _ = read_spectrum(path)
    at = np.searchsorted(nm, grid).clip(max=nm.size - 1)
    if not np.array_equal(nm[at], grid):
        missing = grid[nm[at] != grid][0]
        raise place.at("spectrum").error(f"{path} has no value at {missing:g} nm; expected all wavelengths_nm")
    return target.spectrum(values[at], look, name=name, **step)


def _look(table: dict[str, Any], place: Place) -> target.Look:
    light = _light(table.get("illumination"), place.at("illumination"))
    known = {key: table[key] for key in ("illuminant", "observer") if key in table}
    polar, azimuth = (table.get(key, 0.0) for key in ("polar_deg", "azimuth_deg"))
    if not abs(polar) < 90:
        raise place.at("polar_deg").error(f"{polar:g}; expected above -90 and below 90 degrees")
    return target.Look(float(np.radians(polar)), float(np.radians(azimuth)), light, **known)


def _light(text: str | None, place: Place) -> Any:
    """A light in the words of the command line; None without any."""
    if text is None:
        return None
    try:
        return scenes.light(words.illumination(text))
    except (argparse.ArgumentTypeError, ValueError) as error:
        raise place.error(str(error)) from None


def _grid(value: Any, place: Place) -> np.ndarray:
    """First, last and step."""
    if not isinstance(value, list) or len(value) != 3:
        raise place.error(f"{keys.shown(value)}; expected [first, last, step], as [400, 700, 10]")
    first, last, step = (keys.number(v, place) for v in value)
    if not (0 < first < last and 0 < step <= last - first):
        raise place.error(f"[{first:g}, {last:g}, {step:g}]; expected 0 < first < last, and a step between them")
    return first + step * np.arange(int((last - first) / step + 1e-9) + 1)


def _tables(value: Any, place: Place) -> list[dict[str, Any]]:
    if not isinstance(value, list):
        raise place.error(f"{keys.shown(value)}; expected [[target]], in double brackets")
    return [keys.table(v, place.at(i), _TARGET) for i, v in enumerate(value)]
