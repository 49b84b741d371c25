"""The words of the command line: names of surfaces, materials and parameters, and what options take.

Nothing here needs more than the standard library. Angles are typed in degrees and become radians here;
wavelengths are nanometers; reflectance is a fraction.
"""

import argparse
import math
import re
from collections.abc import Callable
from typing import Any

from fitting.readers.geometry import LIGHTS, WIDEST_TRAP_DEG

OWN_PARAMETER = {"v-grooves": "angle", "beckmann": "roughness", "gaussian": "roughness"}
"""The parameter of each surface."""

MATERIALS = {
    "specular": ("index", "polarization"),
    "lambertian": ("reflectance", "reflectance_column", "resample"),
    "interfaced": (
        *("reflectance", "reflectance_column", "resample", "index", "polarization"),
        *("layer", "layer_column", "layer_model", "coverage", "specular"),
    ),
}
"""The options that each material has."""

POLARIZATIONS = ("full", "unpolarized", "separate")
LAYER_MODELS = ("williams-clapper", "berns")
SPECULAR = ("included", "excluded")
UNITS = ("fraction", "percent")

SPECTRA = ("reflectance", "transmittance")
NUISANCES = ("gain", "offset", "tilt", "stray_light", "wavelength_shift")
PARAMETERS = ("angle", "roughness", *SPECTRA, "coverage", "index", *NUISANCES)
"""What a fit may vary: of the surface, of its material, of the instrument."""

WITH_PRIOR = ("gain", "offset", "tilt", "wavelength_shift")
"""Parameters that have a prior unless told otherwise."""

PRIOR_KEY = {"tilt": "prior_deg", "wavelength_shift": "prior_nm"}
"""What `fitting.free` calls the prior, where not `prior`."""

# Narrow grooves under an interface are costly.
ANGLE_RANGE = {"specular": (5.0, 180.0), "lambertian": (5.0, 180.0), "interfaced": (10.0, 180.0)}
"""Where an angle is searched if nothing else is said, degrees."""


def finite(text: str) -> float:
    """A number."""
    try:
        value = float(text.replace("_", "?"))
    except ValueError:
        value = math.nan
    return _require(value, math.isfinite(value), text, "a number")


def positive(text: str) -> float:
    """A number above 0, at most 1: no reflectance error of interest is larger."""
    value = finite(text)
    return _require(value, 0 < value <= 1, text, "a number above 0 and at most 1")


def length(text: str) -> float:
    """A length or a limit above 0, in nm."""
    value = finite(text)
    return _require(value, value > 0, text, "a number of nanometers above 0")


def count_of_light(text: str) -> float:
    """A number above 0 that a camera counts."""
    value = finite(text)
    return _require(value, value > 0, text, "a number above 0")


def reference(text: str) -> Any:
    """A file, or a part of the cube: its lines and samples as two slices."""
    match = re.fullmatch(r"(\d+):(\d+),(\d+):(\d+)", text.strip())
    if match is None:
        return text
    top, bottom, left, right = map(int, match.groups())
    _require(
        0.0, top < bottom and left < right, text, "lines and samples, FIRST:LAST,FIRST:LAST, last not included"
    )
    return slice(top, bottom), slice(left, right)


def polar_angle(text: str) -> float:
    """One view angle in degrees."""
    value = finite(text)
    return _require(value, abs(value) < 90, text, "an angle from the normal of less than 90 degrees")


def share(text: str) -> float:
    """A share, 0 to 1."""
    value = finite(text)
    hint = " (did you pass percent?)" if 1 < value <= 100 else ""
    return _require(value, 0 <= value <= 1, text, f"a share from 0 to 1{hint}")


def pixels(text: str) -> int:
    """A number of pixels."""
    value = finite(text)
    return int(_require(value, value % 1 == 0 and 1 <= value <= 4096, text, "a whole number from 1 to 4096"))


def count(text: str) -> int:
    """A whole number of at least 1."""
    value = finite(text)
    return int(_require(value, value % 1 == 0 and value >= 1, text, "a whole number of at least 1"))


def roughness(text: str) -> float:
    """A roughness m of random grooves."""
    value = finite(text)
    return _require(value, value > 0, text, "a roughness m above 0, without unit")


def angle(text: str) -> float:
    """A dihedral angle in radians, from degrees (45, 45deg, 45°) or radians with their unit (0.785rad)."""
    expected = "a dihedral angle above 0 and at most 180 degrees, such as 45deg"
    match = re.fullmatch(r"(.+?)\s*(deg|°|rad)?", text.strip())
    if match is None:
        raise argparse.ArgumentTypeError(f"{text!r} is empty; expected {expected}")
    value = finite(match[1])
    degrees = math.degrees(value) if match[2] == "rad" else value
    _require(degrees, 0 < degrees <= 180, text, expected)
    return value if match[2] == "rad" else math.radians(value)


def fixed(text: str) -> tuple[str, float]:
    """A parameter and the value it is held at, from NAME=VALUE."""
    name, equals, value = text.partition("=")
    readers: dict[str, Callable[[str], float]] = {"angle": angle, "roughness": roughness}
    if not equals or name not in readers:
        raise argparse.ArgumentTypeError(f"{text!r}: expected angle=45deg or roughness=0.3")
    return name, readers[name](value)


def positive_range(text: str) -> tuple[float, float]:
    """Two positive numbers, LOW:HIGH."""
    expected = "LOW:HIGH with 0 < LOW < HIGH"
    parts = text.split(":")
    _require(0.0, len(parts) == 2, text, expected)
    low, high = (finite(part) for part in parts)
    _require(low, 0 < low < high, text, expected)
    return low, high


def angle_range(text: str) -> tuple[float, float]:
    """Two dihedral angles in degrees, LOW:HIGH."""
    low, high = positive_range(text)
    _require(high, high <= 180, text, "LOW:HIGH in degrees with 0 < LOW < HIGH ≤ 180")
    return low, high


def grid(text: str) -> list[float]:
    """Increasing wavelengths in nm, from START:STOP:STEP (both ends included) or a list with commas."""
    expected = "START:STOP:STEP or a list such as 450,550,650, increasing, in nm"
    parts = [finite(part) for part in re.split("[:,]", text)]
    values = parts
    if ":" in text:
        _require(0.0, len(parts) == 3 and "," not in text, text, expected)
        start, stop, step = parts
        _require(0.0, 0 < start <= stop and step > 0, text, expected)
        steps = (stop - start) / step
        count = round(steps)
        _require(0.0, count <= 1_000_000, text, "at most a million wavelengths")
        _require(0.0, abs(steps - count) < 1e-6, text, f"a step that leads from {start:g} to {stop:g}")
        values = [start + step * i for i in range(count)] + [stop]
    rising = all(low < high for low, high in zip([0.0, *values], values, strict=False))
    _require(0.0, rising, text, expected)
    return values


def polar_angles(text: str) -> list[float]:
    """View angles from the mean normal in degrees, with commas."""
    return _directions(text, 90.0, "view angles from -90 to 90 degrees such as 0,30,60, each once")


def azimuths(text: str) -> list[float]:
    """View azimuths in degrees, with commas."""
    return _directions(text, 360.0, "azimuths from -360 to 360 degrees such as 0,90, each once")


def polar_grid(text: str) -> list[float]:
    """View angles from the mean normal in degrees, with commas or as START:STOP:STEP, both ends included."""
    return _angle_grid(text, 89.0, "view angles from -89 to 89 degrees such as 0:80:5 or 0,30,60, each once")


def azimuth_grid(text: str) -> list[float]:
    """View azimuths in degrees, with commas or as START:STOP:STEP, both ends included."""
    return _angle_grid(text, 360.0, "azimuths from -360 to 360 degrees such as 0,45,90 or 0:90:15, each once")


def _angle_grid(text: str, limit: float, expected: str) -> list[float]:
    if ":" not in text:
        return _directions(text, limit, expected)
    parts = [finite(part) for part in text.split(":")]
    _require(0.0, len(parts) == 3, text, expected)
    start, stop, step = parts
    _require(0.0, -limit <= start <= stop <= limit and step > 0, text, expected)
    steps = (stop - start) / step
    _require(0.0, abs(steps - round(steps)) < 1e-6, text, f"a step that leads from {start:g} to {stop:g}")
    _require(0.0, steps < 1000, text, "at most 1000 angles")
    return [start + step * i for i in range(round(steps))] + [stop]


def direction(text: str) -> tuple[float, float]:
    """One direction in degrees, POLAR,AZIMUTH; the azimuth is 0 unless given."""
    expected = "POLAR,AZIMUTH in degrees, such as 0,0 or 60,90, less than 90 degrees from the normal"
    parts = [finite(part) + 0.0 for part in text.split(",")]
    _require(0.0, len(parts) <= 2, text, expected)
    polar, azimuth = parts[0], (parts[1] if len(parts) == 2 else 0.0)
    _require(0.0, abs(polar) < 90 and abs(azimuth) <= 360, text, expected)
    return polar, azimuth


def half_width(text: str) -> tuple[float, str]:
    """A half-width of at least 0 and its unit: "deg", "rad" or none."""
    expected = "a half-width of at least 0, such as 3deg, or 0.05 of a roughness"
    match = re.fullmatch(r"(.+?)\s*(deg|°|rad)?", text.strip())
    _require(0.0, match is not None, text, expected)
    assert match is not None
    value = finite(match[1])
    return _require(value, value >= 0, text, expected), {"°": "deg", None: ""}.get(match[2], match[2])


def _directions(text: str, limit: float, expected: str) -> list[float]:
    # Adding 0.0 turns -0.0 into 0.0.
    values = [finite(part) + 0.0 for part in text.split(",")]
    good = all(abs(value) <= limit for value in values) and len(set(values)) == len(values)
    _require(0.0, good, text, expected)
    return values


def azimuth(text: str) -> float:
    """One azimuth in degrees."""
    value = finite(text)
    return _require(value, abs(value) <= 360, text, "an azimuth from -360 to 360 degrees such as 90")


def half_angle(text: str) -> float:
    """Half-angle of a gloss trap in degrees."""
    value = finite(text)
    expected = f"a half-angle from 0 to less than {WIDEST_TRAP_DEG:g} degrees"
    return _require(value, 0 <= value < WIDEST_TRAP_DEG, text, expected)


def illumination(text: str) -> tuple[Any, ...]:
    """The kind of a light and its angles in degrees, say ("directional", 45.0, 0.0) or ("diffuse",).

    `fitting.cli.scenes.light` makes a light of it.
    """
    expected = "diffuse, directional:POLAR,AZIMUTH or annular:POLAR in degrees, such as directional:45,0"
    kind, colon, rest = text.partition(":")
    angles = [finite(part) + 0.0 for part in rest.split(",")] if colon else []
    limits = [*LIGHTS.get(kind, {}).values()]
    _require(0.0, kind in LIGHTS and len(angles) == len(limits), text, expected)
    good = all(low <= value <= high for value, (low, high) in zip(angles, limits, strict=True))
    _require(0.0, good, text, expected)
    return kind, *angles


def _require(value: float, good: bool, text: str, expected: str) -> float:
    if not good:
        raise argparse.ArgumentTypeError(f"{text!r}: expected {expected}")
    return value
