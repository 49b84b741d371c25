"""Options that several commands share: what is seen, what is unknown, how accurate.

Nothing here needs more than the standard library.
"""

import argparse
from typing import Any

from fitting.cli import words

TOLERANCE = 1e-8


def add_free_options(command: argparse.ArgumentParser) -> Any:
    """What is unknown; returns the group of these options."""
    what = command.add_argument_group("what is fitted")
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
    return what


def add_scene_options(command: argparse.ArgumentParser, *, defaults: bool = True) -> None:
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


def add_surface_values(
    command: argparse.ArgumentParser, angle: str = "dihedral angle", roughness: str = "roughness m"
) -> None:
    """The surface's own number, under the names that the command has for it."""
    command.add_argument("--angle", type=words.angle, metavar="DEG", help=f"{angle} of v-grooves: 45deg")
    command.add_argument("--roughness", type=words.roughness, metavar="M", help=f"{roughness} of random grooves")


def add_tolerance(command: argparse.ArgumentParser, default: float | None = TOLERANCE) -> None:
    """How accurate the model is to be."""
    command.add_argument(
        "--tolerance",
        type=words.positive,
        default=default,
        metavar="ERROR",
        help=f"absolute error of the computed reflectance factor, at most (default: {default or TOLERANCE:g})",
    )
