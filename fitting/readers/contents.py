"""What a measurement file holds, whatever its format."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64

UNITS = {"fraction": 1.0, "percent": 0.01}
LOOKS_LIKE_PERCENT = 3.0
"""A fraction above this is none."""


@dataclass(frozen=True)
class Contents:
    """What a measurement file holds, checked, in the units of the library.

    Args:
        wavelengths_nm: strictly increasing, nm, shape (L,).
        polar: view polar angles, radians, shape (D,), in order of first appearance; NaN if all reflected
            light is collected.
        azimuth: view azimuths, radians, shape (D,); likewise.
        reflectance_factor: fraction, shape (D, L); NaN where nothing was measured.
        standard_uncertainty: fraction, shape (D, L), NaN where no row gives one; None if the file has none.
        illumination: a light of `vcavity_jax`; None for diffuse light.
        hemispherical: all reflected light is collected; there is one row, and it has no direction.
        metadata: the file's metadata, as written.
    """

    wavelengths_nm: Float64[np.ndarray, " wavelengths"]
    polar: Float64[np.ndarray, " directions"]
    azimuth: Float64[np.ndarray, " directions"]
    reflectance_factor: Float64[np.ndarray, "directions wavelengths"]
    standard_uncertainty: Float64[np.ndarray, "directions wavelengths"] | None
    illumination: Any
    hemispherical: bool
    metadata: dict[str, str]
