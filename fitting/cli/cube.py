"""`vcavity cube`: a fit in every pixel of a hyperspectral cube."""

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

import vcavity_jax as vc
from fitting.cli import request, scenes
from fitting.cli.fit import require_writable


def run(given: argparse.Namespace) -> int:
    """Fit, print how many pixels ended how, write the maps and a figure; 0 if any pixel has an answer, else 1."""
    try:
        from fitting.cubes import fit_cube, open_cube, used_bands
    except ImportError as error:
        raise ValueError(
            f"the package {error.name} is not installed; expected pip install 'vcavity[cubes]'"
        ) from None
    source = Path(given.cube)
    output = source.with_name(f"{source.stem}-fit.nc") if given.output is None else Path(given.output)
    require_writable(output.parent)
    cube = open_cube(given.cube)
    try:
        used = used_bands(cube, given.band_range)
    except ValueError as error:
        raise ValueError(f"{given.cube}: --band-range: {error}") from None
    wavelengths = np.asarray(cube.coords["wavelength"].values, np.float64)[used]
    sample, parameters = request.sample_and_parameters(given)
    angles: Any = np.deg2rad([given.polar, given.azimuth])
    scene = vc.Scene(
        scenes.surface(sample),
        scenes.material(sample, wavelengths),
        scenes.light(given.illumination) if given.illumination else vc.Diffuse(),
        vc.View(*angles),
    )
    result = fit_cube(
        scene,
        cube,
        parameters,
        output,
        standard_uncertainty=given.uncertainty,
        white=given.white,
        dark=given.dark,
        white_reflectance=given.white_reflectance,
        reflectance_unit=given.reflectance_unit,
        saturation=given.saturation,
        wavelengths_nm=given.band_range,
        tolerance=given.tolerance,
        workers=given.workers,
        progress=sys.stderr.isatty(),
    )
    figure = output.with_suffix(".png")
    result.plot(figure)
    print(result.summary())
    print(f"wrote {output}\nwrote {figure}")
    return 0 if result.counts().get("converged") else 1
