"""The native formats: tidy CSV, a two-column spectrum, and a table of named samples."""

from os import PathLike

import numpy as np
from jaxtyping import Float64

from fitting.readers import MAX_NUMBER, TextTable, geometry, number, quoted, read_table, suggestion
from fitting.readers.contents import LOOKS_LIKE_PERCENT, UNITS, Contents
from fitting.readers.samples import Asked

# A union grid of directions and wavelengths may be far larger than the file it comes from.
MAX_GRID_VALUES = 50_000_000

_TIDY = ("wavelength_nm", "polar_deg", "azimuth_deg", "reflectance_factor")
_UNCERTAINTY = "standard_uncertainty"
_KNOWN = (*_TIDY, "reflectance", _UNCERTAINTY)

_Vector = Float64[np.ndarray, " rows"]


def read(path: str | PathLike[str], asked: Asked) -> Contents:
    """Read a measurement in one of the native formats; nothing is sorted, clipped, filled or guessed.

    Args:
        path: the file.
        asked: the sample to take from a table of named samples; the unit and the geometry, for a file that
            does not declare them; what a spectrum without directions may call its values, besides reflectance.

    Returns:
        The checked contents; reflectance as a fraction, angles in radians.

    Raises:
        OSError: the file is missing, a directory or not readable.
        ValueError: the file breaks the format; the message names file and line.
    """
    table = read_table(path)
    seen = _seen(table, asked)
    names, value_name = _columns(table, asked.column, asked.quantity)
    wavelengths = _wavelengths(table, names)
    polar_deg = _angles(table, names, "polar_deg", 90.0)
    azimuth_deg = _angles(table, names, "azimuth_deg", 360.0)
    values, uncertainty = _reflectance(table, names, value_name, asked.reflectance_unit)

    # Dictionaries keep the order in which the directions first appear.
    first_seen: dict[tuple[float, float], int] = {}
    pairs = zip(polar_deg.tolist(), azimuth_deg.tolist(), strict=True)
    direction = np.array([first_seen.setdefault(pair, len(first_seen)) for pair in pairs])
    _check_order(table, wavelengths, direction)
    grid, place = np.unique(wavelengths, return_inverse=True)
    shape = (len(first_seen), len(grid))
    if shape[0] * shape[1] > MAX_GRID_VALUES:
        raise table.error(
            table.header_line,
            f"{shape[0]} directions by {shape[1]} wavelengths is too large a grid; "
            "expected directions that share their wavelengths",
        )

    def scatter(column_values: _Vector) -> Float64[np.ndarray, "directions wavelengths"]:
        full = np.full(shape, np.nan)
        full[direction, place] = column_values
        return full

    angles = np.deg2rad(np.array(list(first_seen)))
    if seen.hemispherical:
        angles = np.full((1, 2), np.nan)
    elif seen.view is not None:
        angles = np.array([[seen.view.polar, seen.view.azimuth]], dtype=np.float64)
    return Contents(
        wavelengths_nm=grid,
        polar=angles[:, 0],
        azimuth=angles[:, 1],
        reflectance_factor=scatter(values),
        standard_uncertainty=None if uncertainty is None else scatter(uncertainty),
        illumination=seen.illumination,
        hemispherical=seen.hemispherical,
        metadata=table.metadata(),
    )


def _seen(table: TextTable, asked: Asked) -> geometry.Geometry:
    """Light and view that the file states, or else those that were asked for."""
    if asked.geometry is None:
        return geometry.of_table(table)
    for key in ("geometry", "illumination", "polar_deg", "azimuth_deg"):
        line = table.entries[key].line if key in table.entries else None
        if line is None and table.header is not None and key in table.header:
            line = table.header_line
        if line is not None:
            raise table.error(line, f"the file states {key}; expected no geometry= beside it")
    return asked.light_and_view(asked.geometry)


def _columns(table: TextTable, column: str | None, quantity: str) -> tuple[dict[str, int], str]:
    """Position of each column in use, and which of them holds the values."""
    line, header = table.header_line, table.header
    if header is None:
        if len(table.rows[0]) != 2:
            raise table.error(
                line, f"{len(table.rows[0])} columns of bare numbers; expected two, or a header line"
            )
        header = ["wavelength_nm", "reflectance_factor"]
    names = {name: position for position, name in enumerate(header)}
    if "" in names:
        raise table.error(line, f"column {names[''] + 1} has no name; expected one name for each column")
    if len(names) < len(header):
        twice = next(name for name in header if header.count(name) > 1)
        raise table.error(line, f"column {quoted(twice)} stands twice; expected each name once")
    if "wavelength_nm" not in names:
        close = suggestion("wavelength_nm", header)
        raise table.error(line, f"missing column 'wavelength_nm'{close}; expected it in the header")
    if len(names) == 1:
        raise table.error(line, "missing column 'reflectance_factor'; the header has only 'wavelength_nm'")
    if not set(names) & {*_KNOWN[1:], quantity}:
        samples = [name for name in header if name != "wavelength_nm"]
        if column in samples:
            return {"wavelength_nm": names["wavelength_nm"], column: names[column]}, column
        what = "a table of samples" if column is None else f"no column {quoted(column)}"
        raise table.error(line, f"{what}; expected column= one of: {', '.join(samples)}")

    spectrum = "polar_deg" not in names and "azimuth_deg" not in names
    value_name = "reflectance_factor"
    if spectrum and value_name not in names:
        value_name = "reflectance" if "reflectance" in names and quantity not in names else quantity
    expected = ("wavelength_nm", value_name) if spectrum else _TIDY
    for name in header:
        if name not in (*expected, _UNCERTAINTY):
            hint = suggestion(name, [*_TIDY, _UNCERTAINTY])
            raise table.error(
                line, f"unknown column {quoted(name)}{hint}; expected {', '.join(expected)}[, {_UNCERTAINTY}]"
            )
    for name in expected:
        if name not in names:
            raise table.error(line, f"missing column {name!r}; expected {', '.join(expected)}")
    if column is not None and column != value_name:
        raise table.error(line, f"no column {quoted(column)} to choose; the values are {value_name!r}")
    return names, value_name


def _numbers(table: TextTable, names: dict[str, int], name: str) -> _Vector:
    """A column as numbers, NaN for empty cells."""
    cells = [row[names[name]] for row in table.rows]
    try:
        # All plain numbers, as nearly always; number() refuses underscores too.
        values = np.array([float("?" if "_" in cell or len(cell) > MAX_NUMBER else cell) for cell in cells])
    except ValueError:
        values = np.array([_one_number(table, row, name, cell.strip()) for row, cell in enumerate(cells)])
    _refuse(table, names, name, np.isinf(values), "expected a finite number")
    return values


def _one_number(table: TextTable, row: int, name: str, cell: str) -> float:
    value = number(cell)
    if value is not None:
        return value
    comma = " (write decimals with a point)" if number(cell.replace(",", ".", 1)) is not None else ""
    raise table.error(table.lines[row], f"{name} is {quoted(cell)}, not a number{comma}; expected a number")


def _refuse(table: TextTable, names: dict[str, int], name: str, bad: np.ndarray, expected: str) -> None:
    """Report the first row marked as bad, with its cell as written."""
    if bad.any():
        row = int(np.argmax(bad))
        if name in names:
            cell = table.rows[row][names[name]].strip()
            line = table.lines[row]
        else:
            cell, line = table.entries[name].value, table.entries[name].line
        raise table.error(line, f"{name} is {cell[:40] or 'empty'}; {expected}")


def _metadata_number(table: TextTable, name: str) -> float:
    entry = table.entries[name]
    value = number(entry.value)
    if value is None or not np.isfinite(value):
        raise table.error(entry.line, f"{name} is {quoted(entry.value)}; expected a finite number")
    return value


def _wavelengths(table: TextTable, names: dict[str, int]) -> _Vector:
    values = _numbers(table, names, "wavelength_nm")
    _refuse(table, names, "wavelength_nm", ~(values > 0), "expected a positive wavelength in nanometers")
    largest = values.max()
    if largest < 100:
        unit = "meters" if largest < 1e-4 else "micrometers"
        _refuse(table, names, "wavelength_nm", values > 0, f"these look like {unit}; expected nanometers")
    return values


def _angles(table: TextTable, names: dict[str, int], name: str, limit: float) -> _Vector:
    """A view angle in degrees for each row, from its column or from the metadata; frontal by default."""
    if name in names and name in table.entries:
        raise table.error(table.entries[name].line, f"{name} is metadata and a column too; expected one of them")
    if name in names:
        values = _numbers(table, names, name)
    else:
        value = _metadata_number(table, name) if name in table.entries else 0.0
        values = np.full(len(table.rows), value)
    _refuse(table, names, name, ~(np.abs(values) <= limit), f"expected -{limit:g} to {limit:g} degrees")
    return values


def _scale(table: TextTable, reflectance_unit: str | None) -> float | None:
    """The factor from the file's unit to a fraction, None if the unit is not declared."""
    entry = table.entries.get("reflectance_unit")
    if entry is None:
        return None if reflectance_unit is None else UNITS[reflectance_unit]
    declared = entry.value.lower()
    if declared not in UNITS:
        raise table.error(
            entry.line, f"reflectance_unit {quoted(entry.value)} is unknown; expected fraction or percent"
        )
    if reflectance_unit not in (None, declared):
        raise table.error(
            entry.line, f"the file declares {declared}; expected reflectance_unit={declared!r}, or none"
        )
    return UNITS[declared]


def _reflectance(
    table: TextTable, names: dict[str, int], value_name: str, reflectance_unit: str | None
) -> tuple[_Vector, _Vector | None]:
    """Reflectance and standard uncertainty as fractions; the uncertainty is None if the file has none."""
    scale = _scale(table, reflectance_unit)
    raw = _numbers(table, names, value_name)
    present = ~np.isnan(raw)
    if not present.any():
        raise table.error(table.lines[0], f"{value_name} is missing in every row; expected at least one value")
    if scale is None:
        hint = "this looks like percent; expected '# reflectance_unit: percent' (or fraction) to be declared"
        _refuse(table, names, value_name, raw > LOOKS_LIKE_PERCENT, hint)
        scale = 1.0
    uncertainty = None
    if _UNCERTAINTY in table.entries:
        entry = table.entries[_UNCERTAINTY]
        if _UNCERTAINTY in names:
            raise table.error(entry.line, f"{_UNCERTAINTY} is metadata and a column too; expected one of them")
        uncertainty = np.where(present, _metadata_number(table, _UNCERTAINTY), np.nan)
    elif _UNCERTAINTY in names:
        uncertainty = _numbers(table, names, _UNCERTAINTY)
    noise = np.full(len(raw), 0.02)
    if uncertainty is not None:
        expected = "expected a positive standard uncertainty wherever a value is present"
        _refuse(table, names, _UNCERTAINTY, present & ~(uncertainty > 0), expected)
        uncertainty = uncertainty * scale
        noise = np.fmax(noise, 5 * uncertainty)
    values = raw * scale
    _refuse(table, names, value_name, values < -noise, "below zero by more than noise; expected a reflectance")
    return values, uncertainty


def _check_order(table: TextTable, wavelengths: _Vector, direction: np.ndarray) -> None:
    """Within each direction the wavelengths must increase; a repeated one is named with both its lines."""
    last: dict[int, float] = {}
    for row, (group, wavelength) in enumerate(zip(direction.tolist(), wavelengths.tolist(), strict=True)):
        if wavelength <= last.get(group, 0.0):
            same = (direction[:row] == group) & (wavelengths[:row] == wavelength)
            if same.any():
                raise table.error(
                    table.lines[row],
                    f"duplicate of line {table.lines[int(np.argmax(same))]}: same direction and wavelength "
                    f"({wavelength:g} nm); expected one row",
                )
            raise table.error(
                table.lines[row],
                f"{wavelength:g} nm comes after {last[group]:g} nm; expected increasing wavelengths within "
                "a direction: sort the file",
            )
        last[group] = wavelength
