"""CGATS text (.ti3, .txt): tables of samples with one column per wavelength [CGATS.17; ISO 28178].

Read are the fields SPEC_400, NM400, SPECTRAL_NM400, R_400 and their like, SPECTRAL_NM with SPECTRAL_PCT or
SPECTRAL_DEC, and what ``fitting.writers`` adds: POLAR_DEG and AZIMUTH_DEG for one sample seen from several
directions, STDEV_400 and the keywords ILLUMINATION and GEOMETRY.
"""

import re
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fitting.readers import geometry, number, quoted
from fitting.readers.samples import Sample, SampleFile

_CELL = re.compile(r'"([^"]*)"|(\S+)')
_WAVELENGTH = re.compile(
    r"(?:(?:SPECTRAL|SPEC|STDEV|LAMBDA|REFL|R)_?)?(?P<scale>NM|PCT|DEC)?_?(?P<nm>\d{3,4}(?:[.,]\d+)?)(?:_?NM)?",
    re.I,
)
_UNITS = {"PCT": "percent", "DEC": "fraction"}
_COMMA = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?")
_GEOMETRY_KEYS = ("GEOMETRY", "MEASUREMENT_GEOMETRY", "MEASUREMENTGEOMETRY", "MEASUREMENT_SOURCE")
_USED = ("NUMBER_OF_FIELDS", "NUMBER_OF_SETS", "REFLECTANCE_UNIT")
_NAMES = ("SAMPLE_NAME", "SAMPLENAME", "SAMPLE_ID", "SAMPLEID", "SAMPLE_LOC")


@dataclass
class _Table:
    """Names of the fields, rows of cells and their lines."""

    fields: list[str]
    fields_line: int
    declared: int | None
    rows: list[list[str]] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)


def found_in(text: str) -> bool:
    """Whether this is CGATS."""
    return re.search(r"^\s*BEGIN_DATA_FORMAT\b", text, re.M) is not None


def read(path: str, text: str) -> SampleFile:
    """All samples of a file.

    Raises:
        ValueError: the file breaks the format; the message names file and line.
    """
    keywords, tables = _parts(path, text)
    spectral = [table for table in tables if any(_is_spectral(name) for name in table.fields)]
    if len(spectral) != 1:
        line = tables[-1].fields_line
        raise ValueError(
            f"{path}:{line}: {len(spectral)} tables with spectral fields such as SPEC_400; expected one"
        )
    samples = _samples(path, spectral[0], keywords)
    kept = {key.lower(): value for key, value in keywords.items() if key not in _USED and value}
    return SampleFile(path, samples, kept)


def _parts(path: str, text: str) -> tuple[dict[str, str], list[_Table]]:
    """Keywords, and tables."""
    keywords: dict[str, str] = {}
    tables: list[_Table] = []
    fields: list[str] = []
    fields_line, opened, inside = 0, 0, ""
    tabs = False
    for line_number, line in enumerate(text.split("\n"), start=1):
        words = _cells(line, tabs and inside == "data")
        word = words[0].upper() if words else ""
        if not words or (word.startswith("#") and inside != "data"):
            continue
        if word in ("BEGIN_DATA_FORMAT", "BEGIN_DATA"):
            if inside:
                raise ValueError(
                    f"{path}:{line_number}: {word} within the block of line {opened}; expected its end"
                )
            inside, opened = ("fields" if word.endswith("FORMAT") else "data"), line_number
            if inside == "fields":
                fields, fields_line, tabs = [], line_number, False
            elif not fields:
                raise ValueError(f"{path}:{line_number}: BEGIN_DATA before any field; expected BEGIN_DATA_FORMAT")
            else:
                tables.append(_Table(fields, fields_line, _declared(path, keywords)))
        elif word in ("END_DATA_FORMAT", "END_DATA"):
            _check_rows(path, line_number, tables[-1]) if word == "END_DATA" and tables else None
            inside = ""
        elif inside == "fields":
            fields = fields + [name.upper() for name in words]
            tabs = tabs or "\t" in line.strip()
        elif inside == "data":
            table = tables[-1]
            if len(words) != len(table.fields):
                others = _cells(line, not tabs)
                words = others if len(others) == len(table.fields) else words
            if len(words) != len(table.fields):
                raise ValueError(
                    f"{path}:{line_number}: {len(words)} cells in this row; expected {len(table.fields)}, one for "
                    f"each field of line {table.fields_line}"
                )
            table.rows.append(words)
            table.lines.append(line_number)
        else:
            key, value = word, " ".join(words[1:])
            keywords[key] = f"{keywords[key]}\n{value}" if key in keywords and key == "KEYWORD" else value
    if inside:
        raise ValueError(f"{path}:{opened}: this block has no end: the file is cut off; expected END_DATA")
    if not any(table.rows for table in tables):
        raise ValueError(f"{path}:{max(fields_line, 1)}: no data rows; expected BEGIN_DATA and at least one")
    keywords.pop("KEYWORD", None)
    return keywords, tables


def _cells(line: str, tabs: bool) -> list[str]:
    """Cells of a line: between tabs, where names may have spaces and cells may be empty, or between blanks."""
    if tabs:
        cells = [cell.strip().strip('"') for cell in line.rstrip("\r\n").split("\t")]
        while cells and not cells[-1]:
            cells.pop()
        return cells
    return [quote or plain for quote, plain in _CELL.findall(line)]


def _declared(path: str, keywords: dict[str, str]) -> int | None:
    stated = keywords.get("NUMBER_OF_SETS", "").strip()
    return int(stated) if re.fullmatch(r"[0-9]{1,9}", stated) else None


def _check_rows(path: str, line: int, table: _Table) -> None:
    if table.declared is not None and len(table.rows) != table.declared:
        raise ValueError(
            f"{path}:{line}: {len(table.rows)} rows of data; expected NUMBER_OF_SETS {table.declared} of them"
        )


def _is_spectral(name: str) -> bool:
    return name == "SPECTRAL_NM" or (not name.startswith("STDEV") and _WAVELENGTH.fullmatch(name) is not None)


def _samples(path: str, table: _Table, keywords: dict[str, str]) -> list[Sample]:
    where = f"{path}:{table.fields_line}"
    places, wavelengths, unit = _axis(path, table, keywords)
    values = np.array([[_value(path, table, i, k) for k in places] for i in range(len(table.rows))])
    spread = [
        k for k, name in enumerate(table.fields) if name.startswith("STDEV_") and _WAVELENGTH.fullmatch(name)
    ]
    uncertainty = None
    if len(spread) == len(places):
        uncertainty = np.array([[_value(path, table, i, k) for k in spread] for i in range(len(table.rows))])
    said = next((keywords[key] for key in _GEOMETRY_KEYS if keywords.get(key)), "")
    names = geometry.understood(said, _specular(keywords))
    shared: dict[str, Any] = {
        "unit": unit,
        "geometries": names,
        # A source names more than the geometry: "MeasurementCondition=M1".
        "said": said if names or keywords.get("MEASUREMENT_SOURCE") != said else "",
        "seen": _seen(path, keywords),
    }
    if "POLAR_DEG" in table.fields and "AZIMUTH_DEG" in table.fields:
        angles = [
            np.deg2rad([_value(path, table, i, table.fields.index(name)) for i in range(len(table.rows))])
            for name in ("POLAR_DEG", "AZIMUTH_DEG")
        ]
        limits = np.array([[np.pi / 2], [2 * np.pi]]) * (1 + 1e-12)
        if not (np.abs(angles) <= limits).all():
            raise ValueError(f"{where}: a direction beyond 90 or 360 degrees; expected POLAR_DEG within 90")
        return [
            Sample(
                "",
                wavelengths,
                values,
                where,
                uncertainty=uncertainty,
                polar=angles[0],
                azimuth=angles[1],
                **shared,
            )
        ]
    called = _sample_names(table)
    return [
        Sample(
            called[i],
            wavelengths,
            values[i : i + 1],
            f"{path}:{table.lines[i]}",
            uncertainty=None if uncertainty is None else uncertainty[i : i + 1],
            **shared,
        )
        for i in range(len(table.rows))
    ]


def _seen(path: str, keywords: dict[str, str]) -> geometry.Geometry | None:
    """Light and view where ``fitting.writers`` has put them."""
    try:
        if "ILLUMINATION" in keywords:
            return geometry.Geometry(geometry.light_of(keywords["ILLUMINATION"]))
        if "GEOMETRY_AZIMUTH_DEG" not in keywords:
            return None
        azimuth, trap = (
            float(keywords[key]) if key in keywords else None
            for key in ("GEOMETRY_AZIMUTH_DEG", "TRAP_HALF_ANGLE_DEG")
        )
        return geometry.named(keywords.get("GEOMETRY", ""), azimuth or 0.0, trap)
    except ValueError as error:
        raise ValueError(f"{path}:1: {error}") from None


def _axis(path: str, table: _Table, keywords: dict[str, str]) -> tuple[list[int], np.ndarray, str | None]:
    """Columns of the values, their wavelengths, and the unit if it is declared."""
    where = f"{path}:{table.fields_line}"
    norm = number(keywords.get("SPECTRAL_NORM", "").replace(",", "."))
    unit = {1.0: "fraction", 100.0: "percent"}.get(norm or 0.0)
    unit = keywords.get("REFLECTANCE_UNIT", unit)
    if unit not in (None, *_UNITS.values()):
        raise ValueError(f"{path}:1: REFLECTANCE_UNIT is {quoted(str(unit))}; expected fraction or percent")
    if "SPECTRAL_NM" in table.fields:
        pairs = [k for k, name in enumerate(table.fields) if name == "SPECTRAL_NM"]
        kinds = {name.removeprefix("SPECTRAL_") for k in pairs for name in table.fields[k + 1 : k + 2]}
        if len(kinds) != 1 or not kinds <= set(_UNITS):
            raise ValueError(
                f"{where}: SPECTRAL_NM without its value; expected SPECTRAL_PCT or SPECTRAL_DEC after each"
            )
        waves = [[_value(path, table, i, k) for k in pairs] for i in range(len(table.rows))]
        if any(row != waves[0] for row in waves):
            raise ValueError(f"{where}: the samples have different wavelengths; expected the same in SPECTRAL_NM")
        return [k + 1 for k in pairs], np.array(waves[0]), _UNITS[kinds.pop()]
    found = [(k, _WAVELENGTH.fullmatch(name)) for k, name in enumerate(table.fields) if _is_spectral(name)]
    matches = [match for _, match in found if match is not None]
    kinds = {(match["scale"] or "").upper() for match in matches}
    for kind in kinds & set(_UNITS):
        unit = _UNITS[kind]
    named = np.array([float(match["nm"].replace(",", ".")) for match in matches])
    return [k for k, _ in found], _exact(named, keywords), unit


def _exact(named: np.ndarray, keywords: dict[str, str]) -> np.ndarray:
    """Wavelengths of SPECTRAL_BANDS, SPECTRAL_START_NM and SPECTRAL_END_NM, where names only round them."""
    stated = [number(keywords.get(f"SPECTRAL_{key}", "")) for key in ("BANDS", "START_NM", "END_NM")]
    bands, start, end = (float("nan") if value is None else value for value in stated)
    if bands == named.size and np.isfinite(start + end):
        exact = np.linspace(start, end, named.size)
        if np.abs(exact - named).max() <= 0.51:
            return exact
    return named


def _sample_names(table: _Table) -> list[str]:
    """The first field of names that tells all rows apart; else numbers."""
    for field_name in _NAMES:
        if field_name in table.fields:
            names = [row[table.fields.index(field_name)] for row in table.rows]
            if len(set(names)) == len(names):
                return names
    return [str(i + 1) for i in range(len(table.rows))]


def _specular(keywords: dict[str, str]) -> str:
    words = " ".join(
        f"{key} {value}" for key, value in keywords.items() if "SPECULAR" in key or "SCI" in key
    ).lower()
    if re.search(r"exclu|sce", words):
        return "excluded"
    return "included" if re.search(r"inclu|sci", words) else ""


def _value(path: str, table: _Table, row: int, column: int) -> float:
    cell = table.rows[row][column]
    value = number(cell.replace(",", ".") if _COMMA.fullmatch(cell) else cell)
    if value is None:
        raise ValueError(
            f"{path}:{table.lines[row]}: {table.fields[column]} is {quoted(cell)}, not a number; expected a number"
        )
    return value
