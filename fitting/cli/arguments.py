"""What may be typed after `vcavity`: commands and their options.

Nothing here needs more than the standard library, so that `vcavity --help` is immediate.
"""

import argparse
import functools
import re
from typing import Any, NoReturn

from fitting.cli import words
from fitting.cli.options import TOLERANCE as TOLERANCE
from fitting.cli.options import add_free_options, add_scene_options, add_surface_values, add_tolerance
from fitting.readers.geometry import GEOMETRIES

# As in `vcavity_jax.colorimetry`, which a test compares; importing that takes half a second.
ILLUMINANTS = (
    *("A", "C", "D50", "D55", "D65", "D75", "E"),
    *(f"FL{i}" for i in range(1, 13)),
    *(f"FL3.{i}" for i in range(1, 16)),
    *("LED-B1", "LED-B2", "LED-B3", "LED-B4", "LED-B5", "LED-BH1", "LED-RGB1", "LED-V1", "LED-V2"),
)

# As in `fitting.sampling`, which a test compares.
SAMPLERS = ("auto", "nested", "emcee", "importance", "nuts")

# As in `fitting.bench.report`, which a test compares.
PARTS = ("diffusing", "mirrors", "interfaced", "random grooves")
PEERS = ("mitsuba",)

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

_DESIGN_EPILOG = """\
exit status: 0 every target is met; 1 not all of them; 2 bad input

example:
  vcavity design examples/orange_fold.toml"""

_CUBE_EPILOG = """\
exit status: 0 some pixels have an answer; 1 none has; 2 bad input

examples:
  vcavity cube gold.hdr --white white.hdr --dark dark.hdr --material specular --index Au-Johnson \\
               --free angle --free gain --uncertainty 0.004 --output gold.nc
  vcavity cube print.hdr --white 0:8,0:40 --material lambertian --reflectance flat.csv --resample \\
               --uncertainty 0.01 --workers 4"""

_BENCH_EPILOG = """\
example:
  vcavity bench --part mirrors --output bench"""

_PLAN_EPILOG = """\
exit status: 0 everything is identifiable after the planned views; 1 it is not; 2 bad input

examples:
  vcavity plan --angle 60deg --material lambertian --reflectance flat.csv --free angle --free reflectance \\
               --count 3 --noise 0.005 --wavelengths 400:700:10
  vcavity plan --angle 90deg --spread 3deg --material specular --index Au-Johnson --measured 0,0 \\
               --count 2 --noise 0.005 --wavelengths 400:700:10 --output next"""


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

    plan = commands.add_parser(
        "plan",
        help="which directions to measure next",
        description="Choose the directions of view (and the light) that tell most about the free parameters, "
        "and predict their standard errors before and after each of them.",
        epilog=_PLAN_EPILOG,
    )
    _add_plan_options(plan)

    designed = commands.add_parser(
        "design",
        help="the parameters that make a surface look as wished",
        description="Find the parameters that bring a surface closest to colors, spectra, and limits on how alike "
        "or different it looks.",
        epilog=_DESIGN_EPILOG,
    )
    designed.add_argument("file", metavar="FILE", help="what is wished (TOML, see docs/design.md)")
    designed.add_argument("--output", metavar="FILE", help="write the design as JSON")
    designed.add_argument("--json", action="store_true", help="print the JSON alone")

    cube = commands.add_parser(
        "cube",
        help="a fit in every pixel of a hyperspectral cube",
        description="Fit every pixel of an ENVI cube; write maps of values, standard errors and status (NetCDF) "
        "and a figure. A run that was killed goes on where it stopped. Needs the extra 'cubes'.",
        epilog=_CUBE_EPILOG,
    )
    _add_cube_options(cube)

    bench = commands.add_parser(
        "bench",
        help="speed against error of the models, beside what else one would run",
        description="Measure compile time, run time, memory and error of every model, and of the thesis's recipe, "
        "a dense solve and a path tracer beside it. Takes minutes.",
        epilog=_BENCH_EPILOG,
    )
    bench.add_argument("--part", action="append", choices=PARTS, help="only this; may be repeated")
    bench.add_argument("--full", action="store_true", help="more tolerances and batches, and single precision")
    bench.add_argument("--peer", action="append", choices=PEERS, default=[], help="run this, too, if installed")
    bench.add_argument("--output", metavar="DIR", help="write bench.json, bench.md and bench.png there")

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
        "of options; --output, --json, --compare, --posterior and --tolerance may stand beside it",
    )
    add_scene_options(fit, defaults=False)
    what = add_free_options(fit)
    what.add_argument(
        "--fix",
        action="append",
        type=words.fixed,
        default=[],
        metavar="NAME=VALUE",
        help="hold a parameter: angle=45deg or roughness=0.3",
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
    data.add_argument(
        "--geometry", choices=GEOMETRIES, help="light and view of a MEASUREMENT that does not state them"
    )
    _add_turned(data)
    sampled = fit.add_argument_group("the posterior")
    sampled.add_argument(
        "--posterior",
        action="store_true",
        help="sample it too: write corner.png, predictive.png and posterior.nc, and its intervals into fit.json",
    )
    sampled.add_argument(
        "--sampler",
        choices=SAMPLERS,
        help="nested grid where it applies (default), emcee (which keeps chain.h5 to resume from), "
        "importance sampling, or nuts (the extra of that name)",
    )
    sampled.add_argument("--seed", type=words.count, metavar="N", help="of the random numbers (default: 1)")
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
    add_tolerance(fit, None)
    fit.add_argument(
        "--max-steps", type=words.count, metavar="N", help="most steps of each descent to a minimum (default: 60)"
    )


def _add_cube_options(cube: argparse.ArgumentParser) -> None:
    cube.add_argument("cube", metavar="CUBE", help="the ENVI header (.hdr); its data file stands beside it")
    add_scene_options(cube)
    what = add_free_options(cube)
    what.add_argument(
        "--fix",
        action="append",
        type=words.fixed,
        default=[],
        metavar="NAME=VALUE",
        help="hold a parameter: angle=45deg",
    )
    data = cube.add_argument_group("the cube")
    data.add_argument(
        "--white",
        type=words.reference,
        metavar="REF",
        help="white reference: an ENVI header, or lines and samples of the cube itself: 0:8,0:40",
    )
    data.add_argument("--dark", type=words.reference, metavar="REF", help="dark reference, likewise")
    data.add_argument(
        "--white-reflectance",
        type=words.share,
        default=1.0,
        metavar="R",
        help="reflectance factor of the white reference (default: 1)",
    )
    data.add_argument(
        "--reflectance-unit", choices=words.UNITS, help="unit of a cube of reflectances, without a white reference"
    )
    data.add_argument(
        "--saturation", type=words.count_of_light, metavar="COUNT", help="count from which on a value is saturated"
    )
    data.add_argument(
        "--band-range", type=words.positive_range, metavar="LOW:HIGH", help="use only these, nm: 400:800"
    )
    data.add_argument(
        "--uncertainty",
        type=words.positive,
        required=True,
        metavar="SIGMA",
        help="standard uncertainty of every reflectance factor, as a fraction",
    )
    seen = cube.add_argument_group("light and view")
    seen.add_argument(
        "--polar", type=words.polar_angle, default=0.0, metavar="DEG", help="of the camera (default: 0)"
    )
    seen.add_argument(
        "--azimuth",
        type=words.azimuth,
        default=0.0,
        metavar="DEG",
        help="of the camera: 0 across the grooves (default)",
    )
    _add_illumination(seen)
    output = cube.add_argument_group("output")
    output.add_argument(
        "--output",
        metavar="FILE",
        help="NetCDF file; the figure goes beside it (default: beside CUBE, <name>-fit.nc)",
    )
    output.add_argument(
        "--workers",
        type=words.count,
        default=1,
        metavar="N",
        help="processes (default: 1; more need the extra 'dask')",
    )
    add_tolerance(cube, 1e-6)


def _add_illumination(group: Any) -> None:
    """The light."""
    group.add_argument(
        "--illumination",
        type=words.illumination,
        metavar="LIGHT",
        help="diffuse (default), directional:POLAR,AZIMUTH or annular:POLAR in degrees",
    )


def _add_turned(group: Any) -> None:
    """How the sample lies in an instrument, and its gloss trap."""
    group.add_argument(
        "--geometry-azimuth",
        type=words.azimuth,
        metavar="DEG",
        help="of the direction of a geometry that is not the normal: 0 across the grooves (default), 90 along",
    )
    group.add_argument(
        "--trap", type=words.half_angle, metavar="DEG", help="half-angle of the gloss trap of de:8 (default: 6)"
    )


def _add_predict_options(predict: argparse.ArgumentParser) -> None:
    add_scene_options(predict)
    add_surface_values(predict)
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
    _add_illumination(seen)
    seen.add_argument(
        "--geometry",
        choices=GEOMETRIES,
        help="light and view of an instrument by their name, instead of the options above",
    )
    _add_turned(seen)
    predict.add_argument("--output", metavar="FILE", help="write here instead of to standard output")
    add_tolerance(predict)


def _add_map_options(chart: argparse.ArgumentParser) -> None:
    add_scene_options(chart)
    add_surface_values(chart)
    chart.add_argument(
        "--wavelengths",
        type=words.grid,
        default="380:730:10",
        metavar="NM",
        help="equally spaced (default: %(default)s)",
    )
    _add_illumination(chart)
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
    add_tolerance(chart, 1e-6)


def _add_plan_options(plan: argparse.ArgumentParser) -> None:
    add_scene_options(plan)
    add_surface_values(plan, "expected angle", "expected roughness m")
    plan.add_argument(
        "--spread",
        type=words.half_width,
        metavar="WIDTH",
        help="half-width within which that may be wrong, 3deg or 0.05; the plan is best for the worst value in it "
        "(default: 3 degrees, or 1 %% of the range of a roughness)",
    )
    add_free_options(plan)
    choice = plan.add_argument_group("the choice")
    choice.add_argument("--count", type=words.count, required=True, metavar="N", help="how many views to choose")
    choice.add_argument(
        "--noise",
        type=words.positive,
        required=True,
        metavar="SIGMA",
        help="expected standard uncertainty of every value, as a fraction",
    )
    choice.add_argument(
        "--wavelengths", type=words.grid, required=True, metavar="NM", help="400:700:10 or 450,550,650"
    )
    choice.add_argument(
        "--polar",
        type=words.polar_grid,
        default="0:80:5",
        metavar="DEG",
        help="candidate view angles, START:STOP:STEP or a list (default: %(default)s)",
    )
    choice.add_argument(
        "--azimuth",
        type=words.azimuth_grid,
        default="0,45,90",
        metavar="DEG",
        help="candidate azimuths, each with each view angle: 0 across the grooves (default: %(default)s)",
    )
    choice.add_argument(
        "--illumination",
        type=words.illumination,
        action="append",
        default=[],
        metavar="LIGHT",
        help="diffuse (default), directional:POLAR,AZIMUTH or annular:POLAR in degrees; may be repeated to choose "
        "the light, too",
    )
    choice.add_argument(
        "--measured",
        type=words.direction,
        action="append",
        default=[],
        metavar="POLAR,AZIMUTH",
        help="a direction that is measured already, in the first light and with the same noise; may be repeated",
    )
    choice.add_argument(
        "--interest",
        action="append",
        metavar="NAME",
        help="a free parameter whose error counts, may be repeated (default: what is searched: angle, roughness, "
        "index or coverage)",
    )
    choice.add_argument(
        "--criterion",
        choices=("A", "D"),
        default="A",
        help="least sum of the variances (A, default) or least determinant of the covariance (D)",
    )
    choice.add_argument(
        "--method",
        choices=("exchange", "greedy", "exhaustive"),
        default="exchange",
        help="swap single views of a greedy choice (default), take it as it is, or try all sets",
    )
    output = plan.add_argument_group("output")
    output.add_argument(
        "--output", metavar="DIR", help="folder for plan.json, plan.csv and plan.png (default: none)"
    )
    output.add_argument("--json", action="store_true", help="print the JSON alone")
    add_tolerance(plan)
