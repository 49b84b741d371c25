"""Measurements as files that read back equal: native CSV and CGATS."""

import math
import re
from collections.abc import Sequence
from os import PathLike, fspath
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

import numpy as np

from fitting import files
from fitting.readers import RESERVED_KEYS, geometry

if TYPE_CHECKING:
    from fitting.measurement import Measurement

SUFFIXES = {".csv": "csv", ".ti3": "cgats", ".cgats": "cgats", ".txt": "cgats"}
"""Formats by the end of a file's name."""


def write(measurement: "Measurement", path: str | PathLike[str]) -> None:
    """Write a measurement in the format that the file's name ends in, see ``SUFFIXES``.

    Raises:
        OSError: the file cannot be written.
        ValueError: the name ends otherwise, or the light cannot be put in the words of a file.
    """
    suffix = PurePath(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise ValueError(f"{fspath(path)}: unknown format {suffix!r}; expected a name that ends in .csv or .ti3")
    files.write(path, {"csv": to_csv, "cgats": to_cgats}[SUFFIXES[suffix]](measurement))


def to_csv(measurement: "Measurement") -> str:
    """The native CSV: one row for each direction and wavelength; missing values are empty."""
    seen, listed = _stated(measurement)
    head = [f"# {key}: {line}" for key, line in _told(measurement)]
    head += [f"# {key}: {value}" for key, value in seen.items()] + ["# reflectance_unit: fraction"]
    columns = ["wavelength_nm", *(["polar_deg", "azimuth_deg"] if listed else []), "reflectance_factor"]
    sigma = measurement.standard_uncertainty
    rows = [",".join(columns + ["standard_uncertainty"] * (sigma is not None))]
    for d, direction in enumerate(_directions(measurement)):
        for k, wavelength in enumerate(measurement.wavelengths_nm):
            cells = [wavelength, *(direction if listed else ()), measurement.reflectance_factor[d, k]]
            rows.append(",".join(map(_cell, cells + ([] if sigma is None else [sigma[d, k]]))))
    return "\n".join([*head, *rows]) + "\n"


def to_cgats(measurement: "Measurement") -> str:
    """CGATS: one row for each direction; missing values are NaN."""
    seen, listed = _stated(measurement)
    waves = [files.number(float(wavelength)) for wavelength in measurement.wavelengths_nm]
    if any(re.fullmatch(r"\d{3,4}(\.\d+)?", wavelength) is None for wavelength in waves):
        raise ValueError("wavelengths below 100 nm or above 9999 nm have no field in CGATS; expected a .csv")
    own = ["REFLECTANCE_UNIT", *(key.upper() for key in seen), *(["POLAR_DEG", "AZIMUTH_DEG"] if listed else [])]
    fields = ["SAMPLE_ID", *(["POLAR_DEG", "AZIMUTH_DEG"] if listed else []), *(f"SPEC_{w}" for w in waves)]
    sigma = measurement.standard_uncertainty
    if sigma is not None:
        fields += [f"STDEV_{w}" for w in waves]
    told: dict[str, str] = {}
    for key, line in _told(measurement):
        name = re.sub(r"\W+", "_", key).upper()
        told[name] = f"{told[name]}; {line}" if name in told else line
    lines = ["CGATS.17", 'ORIGINATOR "vcavity"']
    lines += [f'KEYWORD "{key}"' for key in dict.fromkeys([*told, *own])]
    lines += [f'{key} "{line.replace(chr(34), chr(39))}"' for key, line in told.items()]
    lines += [f'{key.upper()} "{value}"' for key, value in seen.items()] + ['REFLECTANCE_UNIT "fraction"']
    lines += ["", f"NUMBER_OF_FIELDS {len(fields)}", "BEGIN_DATA_FORMAT", " ".join(fields), "END_DATA_FORMAT"]
    lines += ["", f"NUMBER_OF_SETS {measurement.polar.size}", "BEGIN_DATA"]
    for d, direction in enumerate(_directions(measurement)):
        numbers = [*(direction if listed else ()), *measurement.reflectance_factor[d]]
        numbers += [] if sigma is None else [*sigma[d]]
        lines.append(" ".join([str(d + 1), *(_cell(value) or "nan" for value in numbers)]))
    return "\n".join([*lines, "END_DATA"]) + "\n"


def _cell(value: float) -> str:
    return "" if math.isnan(value) else files.number(float(value))


def _told(measurement: "Measurement") -> list[tuple[str, str]]:
    """The metadata without what the arrays hold, line by line."""
    return [
        (key, line.strip())
        for key, value in measurement.metadata.items()
        if key not in RESERVED_KEYS
        for line in value.split("\n")
        if line.strip()
    ]


def _stated(measurement: "Measurement") -> tuple[dict[str, str], bool]:
    """Light and view in the words of a file, and whether it must list the directions."""
    name = measurement.metadata.get("geometry", "")
    named = _geometry(measurement, (name,)) if name in geometry.GEOMETRIES else None
    if named is not None:
        return named, False
    stated = _illumination(measurement.illumination)
    if stated is not None and not measurement.hemispherical:
        return {"illumination": stated}, True
    named = _geometry(measurement, geometry.GEOMETRIES)
    if named is None:
        kind = type(measurement.illumination).__name__
        collected = " collected over the hemisphere" if measurement.hemispherical else ""
        raise ValueError(
            f"light of the kind {kind}{collected} has no words in a file; expected Diffuse, Directional or "
            f"Annular, or one of the geometries {', '.join(geometry.GEOMETRIES)}"
        )
    return named, False


def _illumination(light: Any) -> str | None:
    kind = type(light).__name__.lower()
    if kind not in geometry.LIGHTS or not all(
        hasattr(light, key.removesuffix("_deg")) for key in geometry.LIGHTS[kind]
    ):
        return None
    angles = {key: degrees(float(getattr(light, key.removesuffix("_deg")))) for key in geometry.LIGHTS[kind]}
    if getattr(light, "solid_angle", None) is not None:
        return None
    return ", ".join([kind, *(f"{key}={files.number(value)}" for key, value in angles.items())])


def _geometry(measurement: "Measurement", names: Sequence[str]) -> dict[str, str] | None:
    """The first of the named geometries that this is."""
    from fitting.measurement import same_light

    for name in names:
        plain = geometry.named(name)
        if plain.hemispherical != measurement.hemispherical or (
            not plain.hemispherical and measurement.polar.size > 1
        ):
            continue
        stated = {"geometry": name}
        light = measurement.illumination
        if name in ("8:d", "45x:0") and not hasattr(light, "azimuth"):
            continue
        if name in geometry.TURNED:
            azimuth = light.azimuth if name in ("8:d", "45x:0") else measurement.azimuth[0]
            stated["geometry_azimuth_deg"] = files.number(degrees(float(azimuth)))
        trap = None
        if name in geometry.TRAPPED:
            if not hasattr(light, "half_angle"):
                continue
            trap = degrees(float(light.half_angle))
            stated["trap_half_angle_deg"] = files.number(trap)
        turned = geometry.named(name, float(stated.get("geometry_azimuth_deg", 0.0)), trap)
        alike = same_light(turned.illumination or _diffuse(), light)
        if alike and (
            plain.hemispherical or np.isclose(turned.view.polar, measurement.polar[0], rtol=0, atol=1e-9)
        ):
            return stated
    return None


def _diffuse() -> Any:
    import vcavity_jax

    return vcavity_jax.Diffuse()


def _directions(measurement: "Measurement") -> list[tuple[float, float]]:
    """In degrees."""
    if measurement.hemispherical:
        return [(math.nan, math.nan)]
    return [
        (degrees(float(polar)), degrees(float(azimuth)))
        for polar, azimuth in zip(measurement.polar, measurement.azimuth, strict=True)
    ]


def degrees(radians: float) -> float:
    """Degrees that read back as these radians, or one unit in the last place beside; few digits if they do."""
    exact = float(np.rad2deg(radians))
    near = [round(exact, 9), exact, np.nextafter(exact, -np.inf), np.nextafter(exact, np.inf)]
    return float(next((value for value in near if np.deg2rad(value) == radians), exact)) + 0.0
