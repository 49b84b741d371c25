"""What may be typed after `vcavity`: commands, options and the words they take.

Nothing here needs more than the standard library, so that `vcavity --help` is immediate. Angles are typed
in degrees and become radians here; wavelengths are nanometers; reflectance is a fraction.
"""

import argparse
import functools
import math
import re
from collections.abc import Callable
from typing import Any, NoReturn

from fitting.readers.geometry import GEOMETRIES, LIGHTS, WIDEST_TRAP_DEG

PARAMETERS = ("angle", "roughness", "gain", "offset")
# As in `vcavity_jax.colorimetry`, which a test compares; importing that takes half a second.
ILLUMINANTS = ("A", "C", "D50", "D55", "D65", "D75", "E", "FL2", "FL7", "FL11")
OWN_PARAMETER = {"v-grooves": "angle", "beckmann": "roughness", "gaussian": "roughness"}
MATERIALS = {
    "specular": ("index", "polarization"),
    "lambertian": ("reflectance", "reflectance_column", "resample"),
    "interfaced": (
        *("reflectance", "reflectance_column", "resample", "index", "polarization"),
        *("layer", "layer_column", "layer_model", "coverage", "specular"),
    ),
}
"""The options that each material has."""

# Narrow grooves under an interface are costly.
ANGLE_RANGE = {"specular": (5.0, 180.0), "lambertian": (5.0, 180.0), "interfaced": (10.0, 180.0)}
"""Where an angle is searched if nothing else is said, degrees."""

_DESCRIPTION = """\
Appearance of V-grooved surfaces: from a measured spectrum to the groove's angle or the roughness, and back.
Angles are in degrees, wavelengths in nanometers, reflectance factors are fractions."""

_FIT_EPILOG = """\
exit status: 0 converged and identifiable; 1 no trustworthy answer; 2 bad input

examples:
  vcavity fit gold.csv --material specular --index Au-Johnson
  vcavity fit orange.csv --material lambertian --reflectance flat.csv --free angle --free gain
  vcavity fit glossy.csv --material interfaced --reflectance below.csv --index 1.5
  vcavity fit blasted.csv --surface beckmann --material specular --index Al-Rakic"""

_PREDICT_EPILOG = """\
example:
  vcavity predict --angle 45deg --material specular --index Au-Johnson --wavelengths 400:700:10 \\
                  --polar=-60,-30,0,30,60 --output gold.csv"""


_MAP_EPILOG = """\
example:
  vcavity map --angle 45deg --material specular --index Au-Johnson --output gold"""


class _Parser(argparse.ArgumentParser):
    """A parser that reports bad usage as any other bad input, and takes "-30,0,30" for a value."""

    def __init__(self, **options: Any) -> None:
        wide = functools.partial(argparse.RawDescriptionHelpFormatter, max_help_position=30)
        super().__init__(allow_abbrev=False, formatter_class=wide, **options)
        # No option begins like a number, so nothing that does is an option.
        self._negative_number_matcher = re.compile(r"-\.?\d")

    def error(self, message: str) -> NoReturn:
        raise ValueError(f"{message} (see {self.prog} --help)")


class _Version(argparse.Action):
    """Looks the version up only when it is asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        from importlib.metadata import version

        print(f"vcavity {version('vcavity')}")
        parser.exit()


def parser() -> argparse.ArgumentParser:
    """The parser of the whole command line; what it returns has the command's name as `command`."""
    whole = _Parser(prog="vcavity", description=_DESCRIPTION)
    whole.add_argument("--version", action=_Version, nargs=0, help="show the version and leave")
    commands = whole.add_subparsers(dest="command", metavar="COMMAND", required=True)

    fit = commands.add_parser(
        "fit",
        help="from a measurement to the groove's parameters",
        description="Estimate the dihedral angle or the roughness from a measured reflectance factor.",
        epilog=_FIT_EPILOG,
    )
    _add_fit_options(fit)

    predict = commands.add_parser(
        "predict",
        help="from the groove's parameters to a spectrum",
        description="Print the reflectance factor of a surface as a measurement file (CSV).",
        epilog=_PREDICT_EPILOG,
    )
    _add_predict_options(predict)

    chart = commands.add_parser(
        "map",
        help="the color of a surface in every direction of view",
        description="Compute the reflectance factor in all directions of view (Lambert azimuthal equal-area map), "
        "draw it and write the data.",
        epilog=_MAP_EPILOG,
    )
    _add_map_options(chart)

    materials = commands.add_parser(
        "materials",
        help="list the bundled tables of refractive indices",
        description="List the bundled tables, or print one of them as CSV.",
    )
    materials.add_argument("name", nargs="?", metavar="NAME", help="show only this table")
    materials.add_argument(
        "--wavelengths", type=grid, metavar="NM", help="print n and k of NAME there: 400:700:50 or 450,550"
    )
    return whole


def _add_fit_options(fit: argparse.ArgumentParser) -> None:
    fit.add_argument("measurement", metavar="MEASUREMENT", help="the measurement file (CSV)")
    _add_scene_options(fit)
    what = fit.add_argument_group("what is fitted")
    what.add_argument(
        "--free",
        action="append",
        choices=PARAMETERS,
        default=[],
        help="a parameter to fit, may be repeated (default: the surface's own, angle or roughness)",
    )
    what.add_argument(
        "--fix",
        action="append",
        type=fixed,
        default=[],
        metavar="NAME=VALUE",
        help="hold a parameter: angle=45deg or roughness=0.3",
    )
    what.add_argument(
        "--angle-range",
        type=angle_range,
        metavar="LOW:HIGH",
        help="degrees to search (default: 5:180, or 10:180 for interfaced, whose narrow grooves are slow)",
    )
    what.add_argument(
        "--roughness-range", type=positive_range, metavar="LOW:HIGH", help="to search (default: 0.01:3)"
    )
    what.add_argument(
        "--no-priors",
        action="store_true",
        help="let gain and offset take any value (default: 1 ± 0.01 and 0 ± 0.002, Gaussian)",
    )
    data = fit.add_argument_group("the measurement")
    data.add_argument("--column", metavar="NAME", help="the sample to take from a table of samples")
    data.add_argument(
        "--wavelengths", type=positive_range, metavar="LOW:HIGH", help="use only these, nm, e.g. 390:800"
    )
    data.add_argument(
        "--uncertainty",
        type=positive,
        metavar="SIGMA",
        help="standard uncertainty of every value, as a fraction, instead of the file's",
    )
    data.add_argument(
        "--reflectance-unit",
        choices=("fraction", "percent"),
        help="unit of a MEASUREMENT that does not declare it",
    )
    output = fit.add_argument_group("output")
    output.add_argument(
        "--output",
        metavar="DIR",
        help="folder for fit.json and fit.png (default: beside the measurement, <name>-fit/)",
    )
    output.add_argument("--json", action="store_true", help="print the JSON alone")
    _add_tolerance(fit)


def _add_predict_options(predict: argparse.ArgumentParser) -> None:
    _add_scene_options(predict)
    predict.add_argument("--angle", type=angle, metavar="DEG", help="dihedral angle of v-grooves: 45deg")
    predict.add_argument("--roughness", type=roughness, metavar="M", help="roughness m of random grooves")
    predict.add_argument("--wavelengths", type=grid, required=True, metavar="NM", help="400:700:10 or 450,550,650")
    seen = predict.add_argument_group("light and view")
    seen.add_argument("--polar", type=polar_angles, metavar="DEG", help="view angles: 0,30,60 (default: 0)")
    seen.add_argument(
        "--azimuth",
        type=azimuths,
        metavar="DEG",
        help="view azimuths, each with each view angle: 0 across the grooves, 90 along them (default: 0)",
    )
    seen.add_argument(
        "--illumination",
        type=illumination,
        metavar="LIGHT",
        help="diffuse (default), directional:POLAR,AZIMUTH or annular:POLAR in degrees",
    )
    seen.add_argument(
        "--geometry",
        choices=GEOMETRIES,
        help="light and view of an instrument by their name, instead of the options above",
    )
    seen.add_argument(
        "--geometry-azimuth",
        type=azimuth,
        metavar="DEG",
        help="of the direction of a geometry that is not the normal: 0 across the grooves (default), 90 along",
    )
    seen.add_argument(
        "--trap", type=half_angle, metavar="DEG", help="half-angle of the gloss trap of de:8 (default: 6)"
    )
    predict.add_argument("--output", metavar="FILE", help="write here instead of to standard output")
    _add_tolerance(predict)


def _add_map_options(chart: argparse.ArgumentParser) -> None:
    _add_scene_options(chart)
    chart.add_argument("--angle", type=angle, metavar="DEG", help="dihedral angle of v-grooves: 45deg")
    chart.add_argument("--roughness", type=roughness, metavar="M", help="roughness m of random grooves")
    chart.add_argument(
        "--wavelengths",
        type=grid,
        default="380:730:10",
        metavar="NM",
        help="equally spaced (default: %(default)s)",
    )
    chart.add_argument(
        "--illumination",
        type=illumination,
        metavar="LIGHT",
        help="diffuse (default), directional:POLAR,AZIMUTH or annular:POLAR in degrees",
    )
    chart.add_argument(
        "--size",
        type=pixels,
        default=256,
        metavar="PIXELS",
        help="along the edge of the map (default: %(default)s)",
    )
    color = chart.add_argument_group("the color")
    color.add_argument(
        "--illuminant",
        choices=ILLUMINANTS,
        default="D65",
        metavar="NAME",
        help=f"the CIE's: {', '.join(ILLUMINANTS)} (default: %(default)s)",
    )
    color.add_argument(
        "--observer",
        choices=("1931", "1964"),
        default="1931",
        help="the CIE's of 1931 (2°, default) or 1964 (10°)",
    )
    color.add_argument("--partial", action="store_true", help="accept wavelengths that do not cover 400 to 700 nm")
    output = chart.add_argument_group("output")
    output.add_argument(
        "--output",
        default="map",
        metavar="BASE",
        help="write BASE.png and the data, BASE.npz or BASE.nc (default: %(default)s)",
    )
    output.add_argument(
        "--format", choices=("npz", "netcdf"), default="npz", help="of the data: NumPy (default) or NetCDF 3"
    )
    _add_tolerance(chart, 1e-6)


def _add_scene_options(command: argparse.ArgumentParser) -> None:
    scene = command.add_argument_group("the surface")
    scene.add_argument(
        "--surface",
        choices=tuple(OWN_PARAMETER),
        default="v-grooves",
        help="grooves of one angle (default), or of random angles with Beckmann or Gaussian slopes",
    )
    scene.add_argument("--material", choices=tuple(MATERIALS), required=True)
    scene.add_argument(
        "--index",
        metavar="INDEX",
        help="specular: a table's name (see vcavity materials), a number (1.5, 0.35+2.7j) or a file; "
        "interfaced: the same of a clear material, without k",
    )
    scene.add_argument(
        "--polarization",
        choices=("full", "unpolarized", "separate"),
        help="follow the polarization exactly (full, the default of specular), or approximate it (unpolarized, "
        "the default of interfaced; separate, specular only)",
    )
    scene.add_argument(
        "--reflectance",
        metavar="R",
        help="lambertian: a number from 0 to 1, or the file of a flat sample's spectrum; interfaced: that of the "
        "material below its interface (the intrinsic one), not what a glossy flat sample shows",
    )
    scene.add_argument(
        "--reflectance-column", metavar="NAME", help="the sample to take from a --reflectance table"
    )
    scene.add_argument(
        "--resample",
        action="store_true",
        default=None,
        help="interpolate the spectra of --reflectance and --layer linearly where their wavelengths differ",
    )
    clear = command.add_argument_group("the interface (--material interfaced)")
    clear.add_argument(
        "--layer",
        metavar="T",
        help="transmittance of a colored layer below the interface for one passage: a number from 0 to 1, or a "
        "file (default: no layer)",
    )
    clear.add_argument("--layer-column", metavar="NAME", help="the sample to take from a --layer table")
    clear.add_argument(
        "--layer-model",
        choices=("williams-clapper", "berns"),
        help="follow the length of each passage through the layer (default), or take all for normal ones",
    )
    clear.add_argument(
        "--coverage",
        type=share,
        metavar="A",
        help="share of the area that the layer covers, in halftone dots: 0 to 1",
    )
    clear.add_argument(
        "--specular",
        choices=("included", "excluded"),
        help="whether the light that never enters the material counts (default: included)",
    )


def _add_tolerance(command: argparse.ArgumentParser, default: float = 1e-8) -> None:
    command.add_argument(
        "--tolerance",
        type=positive,
        default=default,
        metavar="ERROR",
        help="absolute error of the computed reflectance factor, at most (default: %(default)g)",
    )


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


def share(text: str) -> float:
    """A share, 0 to 1."""
    value = finite(text)
    hint = " (did you pass percent?)" if 1 < value <= 100 else ""
    return _require(value, 0 <= value <= 1, text, f"a share from 0 to 1{hint}")


def pixels(text: str) -> int:
    """A number of pixels."""
    value = finite(text)
    return int(_require(value, value % 1 == 0 and 1 <= value <= 4096, text, "a whole number from 1 to 4096"))


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


def one_line(message: str) -> str:
    """A message on one line, whatever a file name or a library put into it."""
    return " ".join(message.split())


def in_options(message: str) -> str:
    """A message of the library in the words of the command line."""
    message = message.replace("expected column= one of", "expected --column with one of")
    message = message.replace("expected standard_uncertainty=", "expected --uncertainty")
    message = message.replace("or partial=True for", "or --partial for")
    message = message.replace("say free.angle()", "say --free angle")
    message = message.replace("vcavity_jax.materials.names() lists", "'vcavity materials' lists")
    return re.sub(r"expected reflectance_unit='(\w+)'", r"expected --reflectance-unit \1", message)
