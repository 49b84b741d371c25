"""Refractive indices of materials: bundled tables and a user's own files.

Indices are n + ik with k >= 0 (time factor exp(−iωt)); wavelengths are vacuum wavelengths in nanometers.
Everything here is host data in NumPy float64: wrap it in `jnp.asarray` to use it in a model.
"""

import difflib
import functools
import html
import importlib.resources
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vcavity_jax._dispersion import Curve, fail, formula_curve, tabulated_curves

Array = NDArray[np.float64]
# A checker without the numeric tower does not take int and float for the complex in ArrayLike.
Wavelengths = ArrayLike | float | int
Index = NDArray[np.float64] | NDArray[np.complex128]

# No table of a solid is meant below this: such input is in micrometers or meters.
_SHORTEST_NM = 20.0
# A wavelength that equals the end of a table in single precision is that end, not outside.
_EDGE = float(np.finfo(np.float32).eps)
_FILES = "an index table in a .yml, .yaml or .csv file"


@dataclass(frozen=True)
class _Table:
    """The index of one material over the wavelengths where both n and k are known."""

    label: str
    lower_nm: float
    upper_nm: float
    n: Curve
    k: Curve | None
    reference: str = ""

    def index(self, wavelengths_nm: Wavelengths) -> Index:
        wavelengths = _checked_wavelengths(wavelengths_nm)
        flat = wavelengths.ravel()
        outside = (flat < self.lower_nm * (1 - _EDGE)) | (flat > self.upper_nm * (1 + _EDGE))
        if outside.any():
            raise ValueError(
                f"{self.label}: wavelength {flat[outside][0]:.10g} nm is outside the table's range, "
                f"{self.lower_nm:.10g} nm to {self.upper_nm:.10g} nm"
            )
        n = self.n.evaluate(flat)
        bad = ~(np.isfinite(n) & (n > 0))
        if bad.any():
            raise ValueError(
                f"{self.label}: the dispersion formula gives no real n > 0 at {flat[bad][0]:.10g} nm: "
                "check its coefficients"
            )
        if self.k is None:
            return n.reshape(wavelengths.shape)
        return (n + 1j * self.k.evaluate(flat)).reshape(wavelengths.shape)


def refractive_index(name: str, wavelengths_nm: Wavelengths) -> Index:
    """Refractive index of a bundled material, linear in wavelength between the entries of its table.

    Args:
        name: one of `names()`, e.g. "Au-Johnson".
        wavelengths_nm: vacuum wavelengths in nanometers, any shape, within `wavelength_range_nm(name)`
            and not all below 20 nm.

    Returns:
        n + ik with k >= 0 in the shape of `wavelengths_nm`: complex128, or float64 for a material whose
        k is zero at every wavelength of its table, so that real arithmetic can be used.

    Raises:
        ValueError: unknown name, or wavelengths that are not finite and positive, that look like
            micrometers or meters, or that lie outside the table's range.
    """
    return _bundled(name).index(wavelengths_nm)


def read_index(path: str | os.PathLike[str], wavelengths_nm: Wavelengths) -> Index:
    """Refractive index from a user's file, linear in wavelength between the entries of its tables.

    Understood are records of refractiveindex.info (.yml, .yaml: "tabulated nk", "n" and "k", "formula 1"
    to "formula 9", and one entry for n with one for k) and .csv files whose blocks of rows follow a header
    `wl,n`, `wl,k` or `wl,n,k` (micrometers, the export of refractiveindex.info) or `wavelength_nm,n`,
    `wavelength_nm,k` or `wavelength_nm,n,k` (nanometers). Tables in the convention n − ik, all k <= 0, are
    converted. Where n and k cover different wavelengths, the range is what both cover.

    Args:
        path: the file.
        wavelengths_nm: vacuum wavelengths in nanometers, any shape, within the file's range and not all
            below 20 nm.

    Returns:
        n + ik with k >= 0 in the shape of `wavelengths_nm`: complex128, or float64 if the file gives no k
        or only zeros.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file does not follow its format (the message names file and line or field), or the
            wavelengths are refused as in `refractive_index`.
    """
    label = os.fspath(path)
    try:
        content = Path(path).read_bytes()
    except FileNotFoundError:
        raise FileNotFoundError(f"{label}: no such file; expected {_FILES}") from None
    except IsADirectoryError:
        raise ValueError(f"{label}: is a directory; expected {_FILES}") from None
    return _parse(content, label, Path(path).suffix.lower()).index(wavelengths_nm)


@functools.cache
def names() -> tuple[str, ...]:
    """Names of the bundled materials, sorted: chemical symbol or polymer, then first author."""
    return tuple(sorted(file.name[:-4] for file in _folder().iterdir() if file.name.endswith(".yml")))


def reference(name: str) -> str:
    """Literature reference of a bundled material as one line of plain text.

    Args:
        name: one of `names()`.

    Returns:
        Authors, title, journal and notes, as given by refractiveindex.info.

    Raises:
        ValueError: unknown name.
    """
    return _bundled(name).reference


def wavelength_range_nm(name: str) -> tuple[float, float]:
    """Shortest and longest wavelength of a bundled material's table, in nanometers.

    Args:
        name: one of `names()`.

    Returns:
        (shortest, longest), both included.

    Raises:
        ValueError: unknown name.
    """
    table = _bundled(name)
    return table.lower_nm, table.upper_nm


def _folder() -> Any:
    return importlib.resources.files("vcavity_jax") / "data" / "refractive-index"


@functools.cache
def _bundled(name: str) -> _Table:
    if name not in names():
        folded = {known.lower(): known for known in names()}
        wanted = name.lower()
        close = [known for known in folded if wanted and known.startswith(wanted)]
        close = close or difflib.get_close_matches(wanted, folded)
        hint = f"did you mean {' or '.join(folded[known] for known in close)}? " if close else ""
        raise ValueError(f"{name!r} is not a bundled material: {hint}vcavity_jax.materials.names() lists them all")
    return _parse((_folder() / f"{name}.yml").read_bytes(), name, ".yml")


def _checked_wavelengths(wavelengths_nm: Wavelengths) -> Array:
    given = np.asarray(wavelengths_nm)
    if given.size and given.dtype.kind not in "iuf":
        raise ValueError(f"wavelengths of type {given.dtype} are not real numbers: expected nanometers")
    wavelengths = given.astype(np.float64)
    bad = ~(np.isfinite(wavelengths) & (wavelengths > 0))
    if bad.any():
        raise ValueError(f"{wavelengths[bad][0]} is not a wavelength: expected finite nanometers above 0")
    if wavelengths.size and wavelengths.max() < _SHORTEST_NM:
        raise ValueError(
            f"{wavelengths.max():.10g} nm is the longest wavelength requested, and {_SHORTEST_NM:g} nm the "
            "least accepted for it: did you pass micrometers (or meters)?"
        )
    return wavelengths


def _parse(content: bytes, label: str, suffix: str) -> _Table:
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        fail(label, None, f"is not UTF-8 text (byte {error.start}); expected {_FILES}")
    if "\0" in text:
        fail(label, None, f"is a binary file; expected {_FILES}")
    if not text.strip():
        fail(label, None, f"is empty; expected {_FILES}")
    if suffix not in (".yml", ".yaml", ".csv"):
        fail(label, None, f"has the ending {suffix!r}; expected .yml, .yaml or .csv")
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    return _combined(label, _csv_curves(text, label)) if suffix == ".csv" else _parse_yaml(text, label)


def _combined(label: str, curves: Sequence[Curve], literature: str = "") -> _Table:
    found: dict[str, Curve] = {}
    for curve in curves:
        if curve.quantity in found:
            fail(label, curve.line, f"gives {curve.quantity} a second time; expected it once per file")
        found[curve.quantity] = curve
    if "n" not in found:
        fail(label, None, "gives no n; expected a table or formula for n")
    lower = max(curve.lower_nm for curve in found.values())
    upper = min(curve.upper_nm for curve in found.values())
    if lower > upper:
        fail(label, None, "n and k have no wavelength in common; expected overlapping ranges")
    k = found.get("k")
    return _Table(label, lower, upper, found["n"], None if k is None or k.zero else k, literature)


def _csv_curves(text: str, label: str) -> list[Curve]:
    units = {"wl": 3, "wavelength_nm": 0}
    blocks: list[tuple[int, int, str, list[tuple[int, list[str]]]]] = []
    for line, content in enumerate(text.split("\n"), start=1):
        cells = [cell.strip(' \t"') for cell in content.split(",")]
        if not any(cells) or content.lstrip().startswith("#"):
            continue
        header = [cell.lower() for cell in cells]
        if header[0] in units and "".join(header[1:]) in ("n", "k", "nk"):
            blocks.append((line, units[header[0]], "".join(header[1:]), []))
        elif not blocks:
            headers = "'wl,n', 'wl,k', 'wl,n,k' (micrometers) or 'wavelength_nm,n,k' (nanometers)"
            fail(label, line, f"{content.strip()[:40]!r} is no header; expected {headers}")
        else:
            blocks[-1][3].append((line, cells))
    if not blocks:
        fail(label, None, "has only comments; expected a header and rows")
    return [
        curve
        for line, shift, quantities, rows in blocks
        for curve in tabulated_curves(label, line, quantities, rows, shift)
    ]


def _parse_yaml(text: str, label: str) -> _Table:
    import yaml  # here, since importing the package should not pay for it

    # Nodes, not values: they keep line numbers and the digits as written, and never build objects.
    try:
        root = yaml.compose(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        problem = getattr(error, "problem", None) or getattr(error, "reason", None) or str(error)
        fail(label, mark.line + 1 if mark else None, f"is broken YAML ({problem}); expected an index record")
    if root is None:
        fail(label, None, "has only comments; expected a refractiveindex.info record")
    fields = _yaml_fields(label, root, "record")
    if "DATA" not in fields:
        fail(label, None, "has no field DATA; expected a refractiveindex.info record")
    if not isinstance(fields["DATA"], yaml.SequenceNode) or not fields["DATA"].value:
        fail(label, _line(fields["DATA"]), "DATA is not a list; expected a list of entries with a type")
    curves = [curve for entry in fields["DATA"].value for curve in _yaml_curves(label, entry)]
    literature = str(getattr(fields.get("REFERENCES"), "value", ""))
    plain = html.unescape(re.sub(r"<[^>]*>", "", literature))
    return _combined(label, curves, " ".join(plain.split()))


def _line(node: Any) -> int:
    return int(node.start_mark.line) + 1


def _yaml_fields(label: str, node: Any, what: str) -> dict[str, Any]:
    if getattr(node, "id", None) != "mapping":
        fail(label, _line(node), f"the {what} is not a mapping; expected 'field: value' lines")
    fields: dict[str, Any] = {}
    for key, value in node.value:
        if str(key.value) in fields:
            fail(label, _line(key), f"the field {key.value} appears twice; expected it once")
        fields[str(key.value)] = value
    return fields


def _yaml_curves(label: str, entry: Any) -> list[Curve]:
    """Curves of one entry of DATA."""
    fields = _yaml_fields(label, entry, "DATA entry")
    line = _line(entry)

    def words(field: str) -> list[str]:
        if getattr(fields.get(field), "id", None) != "scalar":
            fail(label, line, f"the DATA entry has no field {field}; expected it, as plain text")
        return str(fields[field].value).split()

    kind = " ".join(words("type"))
    if match := re.fullmatch("tabulated (nk|n|k)", kind):
        words("data")
        rows = enumerate(fields["data"].value.split("\n"), start=_line(fields["data"]) + 1)
        return tabulated_curves(label, line, match[1], [(i, row.split()) for i, row in rows if row.strip()], 3)
    if not re.fullmatch("formula [1-9]", kind):
        expected = "'tabulated nk', 'tabulated n', 'tabulated k' or 'formula 1' to 'formula 9'"
        fail(label, _line(fields["type"]), f"type {kind[:40]!r} is unknown; expected {expected}")
    field = "range" if "range" in fields else "wavelength_range"  # the former name of the field
    ends, coefficients = words(field), words("coefficients")
    try:
        return [formula_curve(int(kind[-1]), line, ends, coefficients)]
    except ValueError as error:
        fail(label, line, f"{kind}: {error}")
