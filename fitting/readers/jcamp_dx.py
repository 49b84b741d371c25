"""JCAMP-DX spectra, unpacked by the package jcamp (the extra of that name)."""

import contextlib
import io
import re
from typing import Any

import numpy as np

from fitting.readers import geometry, number, quoted
from fitting.readers.samples import Sample, SampleFile

_MOST_POINTS = 10_000_000
_TO_NM = {"NANOMETERS": 1.0, "NANOMETRES": 1.0, "NM": 1.0, "MICROMETERS": 1e3, "MICROMETRES": 1e3, "UM": 1e3}
_WAVENUMBERS = ("1/CM", "CM-1", "CM^-1")


def found_in(text: str) -> bool:
    """Whether this is JCAMP-DX."""
    return re.match(r"\s*##\s*TITLE\s*=", text, re.I) is not None


def read(path: str, text: str, quantity: str) -> SampleFile:
    """The spectra of a file, one for each of its blocks.

    Args:
        path: for messages.
        text: of the file.
        quantity: "reflectance" or "transmittance".

    Raises:
        ValueError: jcamp is not installed; the file breaks the format, or holds another quantity.
    """
    _refuse_bombs(path, text)
    try:
        import jcamp
    except ImportError:
        raise ValueError(f"{path}: JCAMP-DX needs the package jcamp (pip install 'vcavity[jcamp]')") from None
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said):
            whole = jcamp.read(io.StringIO(text))
    except Exception as error:  # The package lets out whatever its arithmetic meets.
        what = " ".join(str(error).split())[:100]
        raise ValueError(f"{path}: not as JCAMP-DX has it ({type(error).__name__}: {what})") from None
    if said.getvalue():
        raise ValueError(
            f"{path}: {' '.join(said.getvalue().split())[:150]}; expected a file that agrees with itself"
        )
    blocks = [block for block in whole.get("children") or [whole] if len(block.get("y", ()))]
    if not blocks:
        raise ValueError(f"{path}: no data; expected ##XYDATA= or ##XYPOINTS=")
    names = [str(block.get("title", "")).strip() for block in blocks]
    if len(set(names)) < len(names):
        names = [f"{i + 1} {name}".strip() for i, name in enumerate(names)]
    samples = [_sample(path, name, block, quantity) for name, block in zip(names, blocks, strict=True)]
    kept = {
        key: str(whole[key]) for key in ("title", "origin", "owner", "spectrometer/data system") if whole.get(key)
    }
    return SampleFile(path, samples, kept)


def _refuse_bombs(path: str, text: str) -> None:
    """Counts that would fill the memory."""
    for line_number, line in enumerate(text.split("\n"), start=1):
        points = re.match(r"##\s*NPOINTS\s*=\s*(\S+)", line, re.I)
        many = number(points[1]) if points else 0.0
        if many is not None and abs(many) > _MOST_POINTS:
            raise ValueError(f"{path}:{line_number}: NPOINTS is {many:g}; expected at most {_MOST_POINTS}")
        if not line.startswith("##") and re.search(r"[S-Zs]\d{5}", line):
            raise ValueError(
                f"{path}:{line_number}: a value that repeats 10 000 times or more; expected a spectrum"
            )


def _sample(path: str, name: str, block: dict[str, Any], quantity: str) -> Sample:
    where = f"{path}: block {quoted(name)}" if name else path
    along = str(block.get("xunits", "")).strip().upper()
    across = str(block.get("yunits", "")).strip().upper()
    x, y = np.asarray(block["x"], np.float64), np.asarray(block["y"], np.float64)
    if x.size != y.size:
        raise ValueError(f"{where}: {x.size} wavelengths and {y.size} values; expected as many")
    if along in _TO_NM:
        wavelengths = x * _TO_NM[along]
    elif along in _WAVENUMBERS and (x > 0).all():
        wavelengths = 1e7 / x
    else:
        raise ValueError(f"{where}: XUNITS is {quoted(along)}; expected NANOMETERS, MICROMETERS or 1/CM")
    if quantity.upper() not in across:
        raise ValueError(f"{where}: YUNITS is {quoted(across)}; expected {quantity.upper()}")
    if wavelengths.size > 1 and wavelengths[0] > wavelengths[-1]:
        wavelengths, y = wavelengths[::-1], y[::-1]
    percent = "%" in across or "PERCENT" in across
    said = str(block.get("sampling procedure", "")).strip() or str(block.get("$geometry", "")).strip()
    return Sample(
        name,
        wavelengths,
        y[None],
        where,
        # The standard defines REFLECTANCE as a ratio.
        unit="percent" if percent else "fraction",
        geometries=geometry.understood(said),
        said=said if geometry.understood(said) else "",
    )
