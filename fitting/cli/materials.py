"""`vcavity materials`: which refractive indices come with the package, and their values."""

import argparse

import numpy as np

from fitting import files
from vcavity_jax import materials


def run(given: argparse.Namespace) -> int:
    """List the tables, or print one at the wavelengths asked for."""
    if given.wavelengths is None:
        listed = materials.names() if given.name is None else (given.name,)
        width = max(len(name) for name in listed)
        for name in listed:
            low, high = materials.wavelength_range_nm(name)
            print(f"{name:<{width}}  {low:>8g} to {high:>7g} nm  {materials.reference(name)}")
        return 0
    if given.name is None:
        raise ValueError("--wavelengths needs the NAME of a table: vcavity materials NAME --wavelengths ...")
    index = materials.refractive_index(given.name, np.array(given.wavelengths))
    print(f"# {given.name}: refractive index n + ik, {materials.reference(given.name)}")
    print("wavelength_nm,n,k")
    for wavelength, value in zip(given.wavelengths, index.tolist(), strict=True):
        print(",".join(map(files.number, (wavelength, value.real, value.imag))))
    return 0
