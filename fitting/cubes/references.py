"""From what a camera counts to reflectance factors: a white and a dark reference [SaintPierre2020, eq. 4.42]."""

from dataclasses import dataclass, replace
from os import PathLike, fspath
from typing import Any

import numpy as np
import xarray as xr

from fitting.cubes.envi import open_cube
from fitting.readers.contents import LOOKS_LIKE_PERCENT

Region = tuple[slice, slice]
"""Lines and samples of the cube itself."""

_LINES_AT_ONCE = 64


@dataclass(frozen=True)
class References:
    """What turns counts into reflectance factors.

    Args:
        white: counts of the white reference less the dark ones, shape (samples, bands) or (bands,); None if the
            values are reflectances times ``scale``.
        dark: counts without light, of such a shape; None if the values are reflectances.
        whiteness: reflectance factor of the white reference, a number or shape (bands,).
        scale: by which reflectances are multiplied in the file.
        saturation: counts from which on a value is saturated.
        ignore: a value that marks what is missing.
    """

    white: np.ndarray | None
    dark: np.ndarray | None
    whiteness: np.ndarray
    scale: float
    saturation: float | None
    ignore: float | None

    def of_bands(self, used: np.ndarray) -> "References":
        """For some of the bands."""

        def part(array: np.ndarray | None) -> Any:
            return array if array is None or array.ndim == 0 else array[..., used]

        return replace(self, white=part(self.white), dark=part(self.dark), whiteness=part(self.whiteness))

    def apply(self, raw: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Reflectance factors, NaN where there is none, shape of raw; where saturated; where dead."""
        saturated = np.zeros(raw.shape, bool) if self.saturation is None else raw >= self.saturation
        values = raw.astype(np.float64)
        dead = ~np.isfinite(values)
        if self.ignore is not None:
            dead |= values == self.ignore
        if self.white is None or self.dark is None:
            values = values / self.scale
        else:
            alive = np.isfinite(self.white) & (self.white > 0)
            dead = dead | ~alive
            values = (values - self.dark) / np.where(alive, self.white, 1.0) * self.whiteness
        return np.where(dead | saturated, np.nan, values), saturated, dead


def references(
    cube: xr.DataArray,
    white: Any,
    dark: Any,
    white_reflectance: Any,
    saturation: float | None,
    reflectance_unit: str | None,
) -> References:
    """Read what ``fit_cube`` is given.

    Raises:
        OSError: a file is missing or cannot be read.
        ValueError: something is missing, or does not fit to the cube.
    """
    bands = cube.sizes["wavelength"]
    whiteness = np.asarray(white_reflectance, np.float64)
    if whiteness.shape not in ((), (bands,)) or not ((whiteness > 0) & (whiteness < LOOKS_LIKE_PERCENT)).all():
        raise ValueError(
            f"white_reflectance: expected one fraction above 0, or {bands} of them, one for each band"
        )
    common = (whiteness, saturation, cube.attrs.get("ignore"))
    if white is None:
        if dark is not None:
            raise ValueError("a dark reference without a white one; expected white= as well, or neither")
        return _of_reflectances(cube, reflectance_unit, *common)
    if reflectance_unit is not None:
        raise ValueError("reflectance_unit beside a white reference, which sets the scale; expected one of them")
    bright = _reference(cube, white, "white", saturation)
    nothing = np.zeros(bands) if dark is None else _reference(cube, dark, "dark", None)
    difference = bright - nothing
    if not (difference > 0).any():
        raise ValueError(
            "the white reference is nowhere brighter than the dark one; expected another, or the other way"
        )
    return References(difference, nothing, whiteness, 1.0, *common[1:])


def _of_reflectances(
    cube: xr.DataArray, unit: str | None, whiteness: np.ndarray, saturation: float | None, ignore: Any
) -> References:
    scale = cube.attrs.get("scale")
    source = cube.attrs.get("source", "the cube")
    if scale is not None and unit is not None:
        raise ValueError(
            f"{source}: the header has a reflectance scale factor; expected no reflectance_unit beside it"
        )
    if scale is None and unit is None:
        raise ValueError(
            f"{source}: counts or reflectances? expected white= (and dark=), a reflectance scale factor in the "
            "header, or reflectance_unit='fraction' or 'percent'"
        )
    if unit not in (None, "fraction", "percent"):
        raise ValueError(f"reflectance_unit {unit!r} is unknown; expected fraction or percent")
    scale = scale or {"fraction": 1.0, "percent": 100.0}[str(unit)]
    return References(None, None, whiteness, scale, saturation, ignore)


def _reference(cube: xr.DataArray, given: Any, what: str, saturation: float | None) -> np.ndarray:
    """Mean counts, shape (samples, bands) or (bands,)."""
    samples, bands = cube.sizes["sample"], cube.sizes["wavelength"]
    if isinstance(given, tuple):
        lines, columns = given
        part = cube.isel(line=lines, sample=columns)
        if not part.sizes["line"] or not part.sizes["sample"]:
            raise ValueError(
                f"the region of the {what} reference is empty; expected lines within 0 to {cube.sizes['line']} "
                f"and samples within 0 to {samples}"
            )
        return _mean(part, what, saturation).mean(axis=0)
    called = f"the {what} reference"
    if isinstance(given, str | PathLike):
        called = fspath(given)
        given = open_cube(given)
    if isinstance(given, xr.DataArray):
        if given.sizes.get("sample") != samples or given.sizes.get("wavelength") != bands:
            raise ValueError(
                f"{called}: {given.sizes.get('sample')} samples and {given.sizes.get('wavelength')} bands; "
                f"expected {samples} and {bands} as in the cube"
            )
        return _mean(given, what, saturation)
    array = np.asarray(given, np.float64)
    if array.ndim == 3 and array.shape[1:] == (samples, bands):
        array = array.mean(axis=0)
    if array.shape not in ((samples, bands), (bands,)):
        raise ValueError(
            f"{called}: has the shape {array.shape}; expected (lines, {samples}, {bands}), ({samples}, {bands}) "
            f"or ({bands},)"
        )
    if not np.isfinite(array).any():
        raise ValueError(f"{called}: no finite value; expected counts")
    return array


def _mean(part: xr.DataArray, what: str, saturation: float | None) -> np.ndarray:
    """Over lines, a few at a time."""
    total, lines = np.zeros((part.sizes["sample"], part.sizes["wavelength"])), part.sizes["line"]
    for first in range(0, lines, _LINES_AT_ONCE):
        some = part.isel(line=slice(first, first + _LINES_AT_ONCE)).values.astype(np.float64)
        if saturation is not None and (some >= saturation).all():
            raise ValueError(f"the {what} reference is saturated; expected one below {saturation:g}")
        if saturation is not None:
            some = np.where(some >= saturation, np.nan, some)
        total += some.sum(axis=0)
    return total / lines
