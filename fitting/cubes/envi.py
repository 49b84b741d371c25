"""ENVI files, opened without being read: lines come from the disk when they are asked for."""

from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from xarray.backends import BackendArray
from xarray.core import indexing

from fitting.readers import quoted

DIMENSIONS = ("line", "sample", "wavelength")
_SUFFIXES = ("", ".raw", ".img", ".dat", ".bil", ".bip", ".bsq", ".bin")
_ORDERS = {"bil": (0, 2, 1), "bip": (0, 1, 2), "bsq": (2, 0, 1)}
"""The axes of DIMENSIONS as they follow each other in the file."""

_TO_NM = {"nanometers": 1.0, "nm": 1.0, "micrometers": 1e3, "um": 1e3, "microns": 1e3}
_LARGEST_HEADER = 16 * 1024 * 1024


def open_cube(path: str | PathLike[str]) -> xr.DataArray:
    """A cube of an ENVI header and its data file; lines of it are read when their values are asked for.

    Bands that the header marks as bad (``bbl``) and its ``data ignore value`` stay as they are: the attributes
    tell ``fit_cube`` to leave them out.

    Args:
        path: the header (.hdr); the data file stands beside it, under the same name without .hdr or with
            .raw, .img, .dat, .bil, .bip, .bsq or .bin.

    Returns:
        Raw values, dimensions (line, sample, wavelength), wavelengths in nm. Attributes: "source", and of the
        header, where given, "scale" (values are reflectances times this), "ignore" and "good_bands".

    Raises:
        OSError: a file is missing or cannot be read.
        ValueError: the header is not as expected, or the data file does not hold what it promises; one line.
    """
    name, header = fspath(path), Path(path)
    stated = _header(name, header)
    lines, samples, bands = (_whole(name, stated, key) for key in ("lines", "samples", "bands"))
    offset = _whole(name, stated, "header offset", 0)
    order = str(stated.get("interleave", "")).lower()
    if order not in _ORDERS:
        raise ValueError(f"{name}: interleave is {quoted(order)}; expected one of {', '.join(_ORDERS)}")
    data = data_file(name, header)
    raw = _Raw(str(data), (lines, samples, bands), _kind(name, stated), order, offset)
    _check_size(name, raw)
    attributes: dict[str, Any] = {"source": name}
    for key, ours in (("reflectance scale factor", "scale"), ("data ignore value", "ignore")):
        if key in stated:
            attributes[ours] = _number(name, stated, key)
    if attributes.get("scale", 1.0) <= 0:
        raise ValueError(
            f"{name}: reflectance scale factor is {attributes['scale']:g}; expected a positive number"
        )
    if "bbl" in stated:
        good = np.array(_list(name, stated, "bbl", bands)) != 0
        if not good.any():
            raise ValueError(f"{name}: bbl marks every band as bad; expected some good ones")
        attributes["good_bands"] = good
    return xr.DataArray(
        indexing.LazilyIndexedArray(raw),
        dims=DIMENSIONS,
        coords={"wavelength": ("wavelength", _wavelengths(name, stated, bands), {"units": "nm"})},
        attrs=attributes,
    )


@dataclass(frozen=True)
class _Raw(BackendArray):
    """Values in a file; only the lines that are asked for are read."""

    path: str
    shape: tuple[int, int, int]
    dtype: np.dtype[Any]
    order: str
    offset: int

    def __getitem__(self, key: Any) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.BASIC, self._read)

    def _read(self, key: tuple[Any, ...]) -> Any:
        rows = range(self.shape[0])[key[0]]
        if isinstance(rows, int):
            return self._lines(rows, rows + 1)[0][key[1:]]
        if not rows:
            return np.empty((0, *self.shape[1:]), self.dtype)[(slice(None), *key[1:])]
        low, high = min(rows[0], rows[-1]), max(rows[0], rows[-1]) + 1
        return self._lines(low, high)[:: rows.step][(slice(None), *key[1:])]

    def _lines(self, first: int, last: int) -> np.ndarray:
        """Some lines, shape (last - first, samples, bands)."""
        _, samples, bands = self.shape
        size = self.dtype.itemsize
        with open(self.path, "rb") as stream:
            if self.order != "bsq":
                stream.seek(self.offset + first * samples * bands * size)
                some = self._values(stream, (last - first) * samples * bands)
                if self.order == "bip":
                    return some.reshape(last - first, samples, bands)
                return some.reshape(last - first, bands, samples).transpose(0, 2, 1)
            values = np.empty((last - first, samples, bands), self.dtype)
            for band in range(bands):
                stream.seek(self.offset + (band * self.shape[0] + first) * samples * size)
                values[:, :, band] = self._values(stream, (last - first) * samples).reshape(-1, samples)
            return values

    def _values(self, stream: Any, count: int) -> np.ndarray:
        some = np.fromfile(stream, self.dtype, count)
        if some.size < count:
            raise ValueError(f"{self.path}: ends early: it was cut off while it was read; expected a whole file")
        return some


def _header(name: str, path: Path) -> dict[str, Any]:
    if not path.exists():
        raise FileNotFoundError(f"{name}: no such file")
    if path.is_dir():
        raise IsADirectoryError(f"{name}: is a directory; expected an ENVI header (.hdr)")
    with path.open("rb") as stream:
        begin = stream.read(64).lstrip(b"\xef\xbb\xbf")
    if not begin.startswith(b"ENVI") or path.stat().st_size > _LARGEST_HEADER:
        raise ValueError(
            f"{name}:1: not an ENVI header; expected a first line of 'ENVI' (give the .hdr, not the data)"
        )
    try:
        import spectral.io.envi as envi
    except ImportError:
        raise ValueError(f"{name}: ENVI files need the package spectral (pip install 'vcavity[cubes]')") from None
    try:
        return dict(envi.read_envi_header(name))
    except Exception as error:  # The package lets out whatever its parsing meets.
        what = " ".join(str(error).split())[:100]
        raise ValueError(f"{name}: not as ENVI has it ({type(error).__name__}: {what})") from None


def data_file(name: str, header: Path) -> Path:
    """The data file that belongs to a header."""
    stem = header.with_suffix("") if header.suffix.lower() == ".hdr" else header
    for suffix in _SUFFIXES:
        candidate = stem.with_name(stem.name + suffix)
        if candidate != header and candidate.is_file():
            return candidate
    raise FileNotFoundError(f"{name}: no data file beside it; expected {stem.name}.raw, say")


def _check_size(name: str, raw: _Raw) -> None:
    lines, samples, bands = raw.shape
    wanted = raw.offset + lines * samples * bands * raw.dtype.itemsize
    held = Path(raw.path).stat().st_size
    if held < wanted:
        whole = max(held - raw.offset, 0) // raw.dtype.itemsize
        holds = {"bsq": (lines * samples, "bands")}.get(raw.order, (samples * bands, "lines"))
        raise ValueError(
            f"{raw.path}: holds {held} bytes, {whole // holds[0]} whole {holds[1]}; expected {wanted}, for the "
            f"{lines} lines, {samples} samples and {bands} bands of {name}"
        )


def _kind(name: str, stated: dict[str, Any]) -> np.dtype[Any]:
    from spectral.io.envi import dtype_map

    kinds = {key: kind for key, kind in dtype_map if np.dtype(kind).kind != "c"}
    found = str(stated.get("data type", "")).strip()
    if found not in kinds:
        raise ValueError(f"{name}: data type is {quoted(found)}; expected one of {', '.join(kinds)}")
    swapped = str(stated.get("byte order", "0")).strip()
    if swapped not in ("0", "1"):
        raise ValueError(f"{name}: byte order is {quoted(swapped)}; expected 0 or 1")
    return np.dtype(kinds[found]).newbyteorder("<" if swapped == "0" else ">")


def _whole(name: str, stated: dict[str, Any], key: str, default: int | None = None) -> int:
    if key not in stated and default is not None:
        return default
    text = str(stated.get(key, "")).strip()
    if not (text.isascii() and text.isdigit()) or len(text) > 12 or (default is None and int(text) == 0):
        raise ValueError(f"{name}: {key} is {quoted(text)}; expected a whole number")
    return int(text)


def _number(name: str, stated: dict[str, Any], key: str) -> float:
    try:
        value = float(str(stated[key]))
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise ValueError(f"{name}: {key} is {quoted(str(stated[key]))}; expected a number")
    return value


def _list(name: str, stated: dict[str, Any], key: str, bands: int) -> list[float]:
    cells = stated[key] if isinstance(stated[key], list) else [stated[key]]
    if len(cells) != bands:
        raise ValueError(f"{name}: {len(cells)} values of {key}; expected {bands}, one for each band")
    return [_number(name, {key: cell}, key) for cell in cells]


def _wavelengths(name: str, stated: dict[str, Any], bands: int) -> np.ndarray:
    if "wavelength" not in stated:
        raise ValueError(f"{name}: no wavelength; expected a list of {bands} in nanometers or micrometers")
    unit = str(stated.get("wavelength units", "")).strip().lower()
    if unit not in _TO_NM:
        raise ValueError(f"{name}: wavelength units is {quoted(unit)}; expected Nanometers or Micrometers")
    values = _TO_NM[unit] * np.array(_list(name, stated, "wavelength", bands))
    falls = np.flatnonzero(np.diff(values, prepend=0.0) <= 0)
    if falls.size:
        raise ValueError(f"{name}: wavelength {falls[0] + 1} is {values[falls[0]]:g} nm; expected increasing ones")
    return values
