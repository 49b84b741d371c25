"""Readers of measurement files: one module per format, on the text layer kept here.

This layer knows bytes, lines, metadata and cells. What the columns mean is the format's affair.
"""

import csv
import difflib
import re
from collections.abc import Iterable
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path

MAX_FILE_BYTES = 256 * 1024 * 1024
MAX_LINE = 4_000_000
MAX_NUMBER = 400

# Metadata the readers act on. All other keys are the user's own and are only kept.
RESERVED_KEYS = (
    *("illumination", "polar_deg", "azimuth_deg"),
    *("geometry", "geometry_azimuth_deg", "trap_half_angle_deg"),
    *("reflectance_unit", "standard_uncertainty"),
)

# A URL ("https://...") is not a key; a sentence with brackets or full stops before its colon is a comment.
_KEY_LINE = re.compile(r"([^\W\d_][\w -]{0,39}?)\s*([:=])(?!//)\s*(.*)")

# Tried in this order on the first row: "400;0,5" is semicolons and decimal commas, not commas.
_DELIMITERS = (";", "\t", ",")


@dataclass(frozen=True)
class Entry:
    """One metadata value and the line it stands in (1 is the first)."""

    value: str
    line: int


@dataclass(frozen=True)
class TextTable:
    """A text file taken apart: metadata, comments, and rows of cells with their line numbers.

    Args:
        path: the file's name, for messages.
        header: the column names, or None if the first row is numbers; `header_line` is its line.
        header_line: line of the header, or of the first row.
        rows: the cells of each row; all rows have the same length.
        lines: the line number of each row.
        entries: metadata the readers act on or keep, by lower-case key.
        comments: the other lines that begin with `#`.
    """

    path: str
    header: list[str] | None
    header_line: int
    rows: list[list[str]]
    lines: list[int]
    entries: dict[str, Entry]
    comments: list[str]

    def error(self, line: int, message: str) -> ValueError:
        """The one-line error for a line of this file."""
        return ValueError(f"{self.path}:{line}: {message}")

    def metadata(self) -> dict[str, str]:
        """All metadata as text, as the file has it; comment lines stand under "comments"."""
        metadata = {key: entry.value for key, entry in self.entries.items()}
        if self.comments:
            metadata["comments"] = "\n".join(filter(None, [metadata.get("comments"), *self.comments]))
        return metadata


def number(cell: str) -> float | None:
    """The number in a cell, NaN if it is empty, None if it holds anything else."""
    try:
        # float() takes "1_0" for 10, which no instrument writes.
        return None if "_" in cell or len(cell) > MAX_NUMBER else float(cell)
    except ValueError:
        return None if cell.strip() else float("nan")


def quoted(text: str) -> str:
    """Text from the file as it goes into a message: on one line and short."""
    return repr(text if len(text) <= 40 else text[:37] + "...")


def suggestion(name: str, choices: Iterable[str]) -> str:
    """A hint such as ` (did you mean 'polar_deg'?)`, or nothing if no choice is close."""
    close = difflib.get_close_matches(name.lower(), list(choices), n=1, cutoff=0.6)
    return f" (did you mean {close[0]!r}?)" if close else ""


def read_text(path: str | PathLike[str], *, latin: bool = False) -> str:
    """The text of a UTF-8 file, with or without a byte order mark; line ends become newlines.

    Args:
        path: the file.
        latin: take a file that is not UTF-8 for Latin-1, as older instruments write it.

    Returns:
        The decoded text.

    Raises:
        FileNotFoundError: there is no such file.
        IsADirectoryError: the path is a directory.
        ValueError: the file is larger than 256 MB, binary, or not UTF-8.
    """
    name, file = fspath(path), Path(path)
    if not file.exists():
        raise FileNotFoundError(f"{name}: no such file")
    if file.is_dir():
        raise IsADirectoryError(f"{name}: is a directory; expected a measurement file")
    with file.open("rb") as stream:
        too_large = file.stat().st_size > MAX_FILE_BYTES
        data = b"" if too_large else stream.read(MAX_FILE_BYTES + 1)
    if too_large or len(data) > MAX_FILE_BYTES:
        raise ValueError(f"{name}:1: the file is larger than {MAX_FILE_BYTES >> 20} MB; expected a measurement")
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise ValueError(f"{name}:1: the text is UTF-16; expected UTF-8")
    data = data.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    nul = data.find(b"\0")
    if nul >= 0:
        line = data.count(b"\n", 0, nul) + 1
        raise ValueError(f"{name}:{line}: a NUL byte: this is a binary file; expected UTF-8 text")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        if latin:
            return data.decode("latin-1")
        line = data.count(b"\n", 0, error.start) + 1
        byte = data[error.start]
        raise ValueError(f"{name}:{line}: byte 0x{byte:02x} is not UTF-8 text; expected UTF-8") from None


def read_table(path: str | PathLike[str]) -> TextTable:
    """Take a delimited text file apart.

    The first row decides the delimiter (semicolon, tab, comma, else spaces) and the number of cells.
    Blank lines are skipped; lines that begin with `#` are metadata or comments and may stand anywhere.

    Args:
        path: the file.

    Returns:
        Metadata, header and rows, nothing interpreted yet.

    Raises:
        OSError: the file is missing, a directory or not readable.
        ValueError: the file is not text, has no data rows, has a ragged row, or has an ambiguous
            metadata line; the message names file and line.
    """
    name = fspath(path)
    entries: dict[str, Entry] = {}
    comments: list[str] = []
    rows: list[list[str]] = []
    numbers: list[int] = []
    delimiter: str | None = None
    last = 1
    for line_number, line in enumerate(read_text(path).split("\n"), start=1):
        stripped = line.strip()
        if not stripped:
            continue
        last = line_number
        if len(line) > MAX_LINE:
            raise ValueError(
                f"{name}:{line_number}: a line of {len(line)} characters; expected at most {MAX_LINE}"
            )
        if stripped.startswith("#"):
            try:
                _note(stripped.lstrip("#").strip(), line_number, entries, comments)
            except ValueError as error:
                raise ValueError(f"{name}:{line_number}: {error}") from None
            continue
        if not rows:
            delimiter = next((d for d in _DELIMITERS if d in line), None)
        cells = line.split(delimiter)
        if delimiter is not None and '"' in line:
            # One line at a time, so that an unclosed quote cannot swallow the rows after it.
            try:
                cells = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
            except csv.Error as error:
                raise ValueError(f"{name}:{line_number}: {error}; expected cells of a few characters") from None
        if rows and len(cells) != len(rows[0]):
            raise ValueError(
                f"{name}:{line_number}: {len(cells)} cells in this row; expected {len(rows[0])} "
                f"as in line {numbers[0]}"
            )
        rows.append(cells)
        numbers.append(line_number)
    while rows and len(rows[0]) > 2 and not any(row[-1].strip() for row in rows):
        rows = [row[:-1] for row in rows]  # Every line ends with a separator.
    if not rows:
        what = "no data rows, only comments" if entries or comments else "the file is empty"
        raise ValueError(f"{name}:{last}: {what}; expected a measurement")
    # An empty first cell opens a header with an unnamed column, not a row of numbers.
    if rows[0][0].strip() and number(rows[0][0]) is not None:
        return TextTable(name, None, numbers[0], rows, numbers, entries, comments)
    header = [cell.strip() for cell in rows[0]]
    if len(rows) == 1:
        raise ValueError(f"{name}:{numbers[0]}: no data rows after the header; expected at least one")
    return TextTable(name, header, numbers[0], rows[1:], numbers[1:], entries, comments)


def _note(text: str, line: int, entries: dict[str, Entry], comments: list[str]) -> None:
    """Keep one `#` line; refuse one that may have been meant for the readers but would be ignored."""
    match = _KEY_LINE.match(text)
    key = match[1].lower() if match else ""
    if match and key not in RESERVED_KEYS:
        close = difflib.get_close_matches(key, RESERVED_KEYS, n=1, cutoff=0.85)
        if close:
            raise ValueError(f"unknown metadata {quoted(match[1])}; expected {close[0]!r}")
    if match and match[2] == "=" and key in RESERVED_KEYS:
        raise ValueError(f"metadata {key!r} is written with '='; expected '# {key}: value'")
    if not match or match[2] == "=":
        comments.append(text)
        return
    value = match[3].strip()
    if key in entries and key in RESERVED_KEYS:
        raise ValueError(f"metadata {key!r} is given twice; it stands in line {entries[key].line} already")
    if key in entries:
        value = f"{entries[key].value}\n{value}"
    entries[key] = Entry(value, line)
