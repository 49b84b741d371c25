"""What may be typed after `vcavity`: commands and their options.

Nothing here needs more than the standard library, so that `vcavity --help` is immediate.
"""

import argparse
import functools
import re
from typing import Any, NoReturn

from fitting.cli import words
from fitting.readers.geometry import GEOMETRIES

# As in `vcavity_jax.colorimetry`, which a test compares; importing that takes half a second.
ILLUMINANTS = ("A", "C", "D50", "D55", "D65", "D75", "E", "FL2", "FL7", "FL11")
TOLERANCE = 1e-8

_DESCRIPTION = """\
Appearance of V-grooved surfaces: from a measured spectrum to the groove's angle or the roughness, and back.
Angles are in degrees, wavelengths in nanometers, reflectance factors are fractions."""

_FIT_EPILOG = """\
exit status: 0 converged and identifiable; 1 no trustworthy answer; 2 bad input

examples:
  vcavity fit gold.csv --material specular --index Au-Johnson
  vcavity fit orange.csv --material lambertian --reflectance flat.csv --free angle --free gain
  vcavity fit glossy.csv --material interfaced --reflectance below.csv --index 1.5
  vcavity fit blasted.csv --surface beckmann --material specular --index Al-Rakic
  vcavity fit orange.csv --material lambertian --free angle --free reflectance --smooth 50
  vcavity fit --config fit.toml"""

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
        description="Estimate the dihedral angle or the roughness, and more, from measured reflectance factors.",
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
        "--wavelengths", type=words.grid, metavar="NM", help="print n and k of NAME there: 400:700:50 or 450,550"
    )
    return whole


def _add_fit_options(fit: argparse.ArgumentParser) -> None:
    fit.add_argument("measurement", nargs="?", metavar="MEASUREMENT", help="the measurement file (CSV)")
    fit.add_argument(
        "--config",
        metavar="FILE",
        help="take measurements, surface and parameters from this file (TOML, see docs/parameters.md) instead "
        "of options; --output, --json, --compare and --tolerance may stand beside it",
    )
    _add_scene_options(fit, defaults=False)
    what = fit.add_argument_group("what is fitted")
    what.add_argument(
        "--free",
        action="append",
        choices=words.PARAMETERS,
        default=[],
        metavar="NAME",
        help="a parameter to fit, may be repeated (default: the surface's own, angle or roughness): "
        f"{', '.join(words.PARAMETERS)}",
    )
    what.add_argument(
        "--fix",
        action="append",
        type=words.fixed,
        default=[],
        metavar="NAME=VALUE",
        help="hold a parameter: angle=45deg or roughness=0.3",
    )
    what.add_argument(
        "--smooth",
        type=words.length,
        metavar="NM",
        help="correlation length of a free reflectance or transmittance, 30 to 80 for pigments and inks "
        "(default: free at each wavelength)",
    )
    what.add_argument(
        "--angle-range",
        type=words.angle_range,
        metavar="LOW:HIGH",
        help="degrees to search (default: 5:180, or 10:180 for interfaced, whose narrow grooves are slow)",
    )
    what.add_argument(
        "--roughness-range", type=words.positive_range, metavar="LOW:HIGH", help="to search (default: 0.01:3)"
    )
    what.add_argument(
        "--index-range", type=words.positive_range, metavar="LOW:HIGH", help="of a free index (default: 1.2:2.5)"
    )
    what.add_argument(
        "--no-priors",
        action="store_true",
        help="let gain and offset take any value, a tilt any within 5 degrees, a wavelength_shift any within 3 nm "
        "(default: 1 ± 0.01, 0 ± 0.002, 0 ± 1 and 0 ± 1, Gaussian)",
    )
    data = fit.add_argument_group("the measurement")
    data.add_argument("--column", metavar="NAME", help="the sample to take from a table of samples")
    data.add_argument(
        "--wavelengths", type=words.positive_range, metavar="LOW:HIGH", help="use only these, nm, e.g. 390:800"
    )
    data.add_argument(
        "--uncertainty",
        type=words.positive,
        metavar="SIGMA",
        help="standard uncertainty of every value, as a fraction, instead of the file's",
    )
    data.add_argument(
        "--reflectance-unit",
        choices=words.UNITS,
        help="unit of a MEASUREMENT that does not declare it",
    )
    output = fit.add_argument_group("output")
    output.add_argument(
        "--output",
        metavar="DIR",
        help="folder for fit.json and fit.png (default: beside the measurement or FILE, <name>-fit/)",
    )
    output.add_argument("--json", action="store_true", help="print the JSON alone")
    output.add_argument(
        "--compare",
        action="store_true",
        help="fit the models most easily taken for this one as well, and say which one the data prefer",
    )
    _add_tolerance(fit, None)
    fit.add_argument(
        "--max-steps", type=words.count, metavar="N", help="most steps of each descent to a minimum (default: 60)"
    )


def _add_predict_options(predict: argparse.ArgumentParser) -> None:
    _add_scene_options(predict)
    predict.add_argument("--angle", type=words.angle, metavar="DEG", help="dihedral angle of v-grooves: 45deg")
    predict.add_argument("--roughness", type=words.roughness, metavar="M", help="roughness m of random grooves")
    predict.add_argument(
        "--wavelengths", type=words.grid, required=True, metavar="NM", help="400:700:10 or 450,550,650"
    )
    seen = predict.add_argument_group("light and view")
    seen.add_argument("--polar", type=words.polar_angles, metavar="DEG", help="view angles: 0,30,60 (default: 0)")
    seen.add_argument(
        "--azimuth",
        type=words.azimuths,
        metavar="DEG",
        help="view azimuths, each with each view angle: 0 across the grooves, 90 along them (default: 0)",
    )
    seen.add_argument(
        "--illumination",
        type=words.illumination,
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
        type=words.azimuth,
        metavar="DEG",
        help="of the direction of a geometry that is not the normal: 0 across the grooves (default), 90 along",
    )
    seen.add_argument(
        "--trap", type=words.half_angle, metavar="DEG", help="half-angle of the gloss trap of de:8 (default: 6)"
    )
    predict.add_argument("--output", metavar="FILE", help="write here instead of to standard output")
    _add_tolerance(predict)


def _add_map_options(chart: argparse.ArgumentParser) -> None:
    _add_scene_options(chart)
    chart.add_argument("--angle", type=words.angle, metavar="DEG", help="dihedral angle of v-grooves: 45deg")
    chart.add_argument("--roughness", type=words.roughness, metavar="M", help="roughness m of random grooves")
    chart.add_argument(
        "--wavelengths",
        type=words.grid,
        default="380:730:10",
        metavar="NM",
        help="equally spaced (default: %(default)s)",
    )
    chart.add_argument(
        "--illumination",
        type=words.illumination,
        metavar="LIGHT",
        help="diffuse (default), directional:POLAR,AZIMUTH or annular:POLAR in degrees",
    )
    chart.add_argument(
        "--size",
        type=words.pixels,
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


def _add_scene_options(command: argparse.ArgumentParser, *, defaults: bool = True) -> None:
    """What is seen; without defaults it can be told what was given."""
    scene = command.add_argument_group("the surface")
    scene.add_argument(
        "--surface",
        choices=tuple(words.OWN_PARAMETER),
        default="v-grooves" if defaults else None,
        help="grooves of one angle (default), or of random angles with Beckmann or Gaussian slopes",
    )
    scene.add_argument("--material", choices=tuple(words.MATERIALS), required=defaults)
    scene.add_argument(
        "--index",
        metavar="INDEX",
        help="specular: a table's name (see vcavity materials), a number (1.5, 0.35+2.7j) or a file; "
        "interfaced: the same of a clear material, without k",
    )
    scene.add_argument(
        "--polarization",
        choices=words.POLARIZATIONS,
        help="follow the polarization exactly (full, the default of specular), or approximate it (unpolarized, "
        "the default of interfaced; separate, specular only)",
    )
    scene.add_argument(
        "--reflectance",
        metavar="R",
        help="lambertian: a number from 0 to 1, or the file of a flat sample's spectrum; interfaced: that of the "
        "material below its interface (the intrinsic one), not what a glossy flat sample shows; none if free",
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
        choices=words.LAYER_MODELS,
        help="follow the length of each passage through the layer (default), or take all for normal ones",
    )
    clear.add_argument(
        "--coverage",
        type=words.share,
        metavar="A",
        help="share of the area that the layer covers, in halftone dots: 0 to 1",
    )
    clear.add_argument(
        "--specular",
        choices=words.SPECULAR,
        help="whether the light that never enters the material counts (default: included)",
    )


def _add_tolerance(command: argparse.ArgumentParser, default: float | None = TOLERANCE) -> None:
    command.add_argument(
        "--tolerance",
        type=words.positive,
        default=default,
        metavar="ERROR",
        help=f"absolute error of the computed reflectance factor, at most (default: {default or TOLERANCE:g})",
    )
