"""What the files of instruments have in common: named spectra, and what is said of how they were measured."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fitting.readers import quoted, suggestion
from fitting.readers.contents import LOOKS_LIKE_PERCENT, UNITS, Contents
from fitting.readers.geometry import GEOMETRIES, TRAPPED, TURNED, Geometry, named

_MOST_NAMED = 12
"""Samples that an error lists."""


@dataclass(frozen=True)
class Asked:
    """What a caller says of a file, where the file does not.

    Args:
        column: the sample to take.
        reflectance_unit: "fraction" or "percent".
        quantity: "reflectance" or "transmittance".
        geometry: light and view by their name.
        geometry_azimuth_deg: see ``geometry.named``.
        trap_half_angle_deg: see ``geometry.named``.
    """

    column: str | None = None
    reflectance_unit: str | None = None
    quantity: str = "reflectance"
    geometry: str | None = None
    geometry_azimuth_deg: float | None = None
    trap_half_angle_deg: float | None = None

    def __post_init__(self) -> None:
        if self.reflectance_unit not in (None, *UNITS):
            raise ValueError(
                f"reflectance_unit {self.reflectance_unit!r} is unknown; expected fraction or percent"
            )
        name = self.geometry
        if name is not None and name not in GEOMETRIES:
            hint = suggestion(name.replace("/", ":"), GEOMETRIES)
            raise ValueError(f"geometry {name!r} is unknown{hint}; expected one of {', '.join(GEOMETRIES)}")
        for key, having in (
            ("geometry_azimuth_deg", TURNED),
            ("trap_half_angle_deg", TRAPPED),
        ):
            if getattr(self, key) is not None and name is not None and name not in having:
                raise ValueError(f"{key} has no effect in {name}; expected it with {', '.join(having)} only")

    def light_and_view(self, name: str) -> Geometry:
        """The geometry of this name, turned as was asked."""
        azimuth = self.geometry_azimuth_deg if name in TURNED else None
        trap = self.trap_half_angle_deg if name in TRAPPED else None
        return named(name, azimuth or 0.0, trap)


@dataclass(frozen=True)
class Sample:
    """One spectrum of a file, or one sample seen from several directions.

    Args:
        name: of the sample.
        wavelengths_nm: nm, shape (L,).
        values: as the file has them, shape (D, L), NaN where missing.
        where: file and line, or file and field, for messages.
        unit: "fraction" or "percent" if the file declares it.
        uncertainty: in the same unit, shape (D, L).
        geometries: names that agree with what the file says of light and view.
        said: that, in the words of the file; "" if it says nothing.
        seen: light and view themselves, if the file has them.
        polar: radians, shape (D,), if the file lists directions.
        azimuth: radians, shape (D,).
    """

    name: str
    wavelengths_nm: np.ndarray
    values: np.ndarray
    where: str
    unit: str | None = None
    uncertainty: np.ndarray | None = None
    geometries: tuple[str, ...] = ()
    said: str = ""
    seen: Geometry | None = None
    polar: np.ndarray | None = None
    azimuth: np.ndarray | None = None


@dataclass(frozen=True)
class SampleFile:
    """All samples of a file.

    Args:
        path: for messages.
        samples: at least one.
        metadata: the text that came with them.
    """

    path: str
    samples: Sequence[Sample]
    metadata: dict[str, str] = field(default_factory=dict)

    def contents(self, asked: Asked) -> Contents:
        """One sample, checked, in the units of the library.

        Raises:
            ValueError: something that neither the file nor the caller says, or that both say differently; a value
                that is no reflectance.
        """
        sample = self._chosen(asked.column)
        seen = self._seen(sample, asked)
        scale = self._scale(sample, asked.reflectance_unit)
        _check_wavelengths(sample)
        values = sample.values * scale
        uncertainty = None if sample.uncertainty is None else sample.uncertainty * scale
        _check_values(sample, values, uncertainty)
        angles = np.full((2, 1), np.nan)
        if sample.polar is not None and sample.azimuth is not None:
            angles = np.stack([sample.polar, sample.azimuth])
        elif seen.view is not None and not seen.hemispherical:
            angles = np.array([[seen.view.polar], [seen.view.azimuth]], dtype=np.float64)
        elif seen.view is None:
            angles = np.zeros((2, 1))
        told = {"sample": sample.name} if sample.name else {}
        return Contents(
            wavelengths_nm=sample.wavelengths_nm,
            polar=angles[0],
            azimuth=angles[1],
            reflectance_factor=values,
            standard_uncertainty=uncertainty,
            illumination=seen.illumination,
            hemispherical=seen.hemispherical,
            metadata=self.metadata | told,
        )

    def _chosen(self, column: str | None) -> Sample:
        names = [sample.name for sample in self.samples]
        if column is None and len(names) == 1:
            return self.samples[0]
        if column in names:
            return self.samples[names.index(column)]
        what = f"{len(names)} samples" if column is None else f"no sample {quoted(column)}"
        more = f", ... ({len(names) - _MOST_NAMED} more)" if len(names) > _MOST_NAMED else ""
        hint = "" if column is None else suggestion(column, names)
        raise ValueError(
            f"{self.path}:1: {what}{hint}; expected column= one of: {', '.join(names[:_MOST_NAMED])}{more}"
        )

    def _seen(self, sample: Sample, asked: Asked) -> Geometry:
        known, wanted = sample.geometries, asked.geometry
        if sample.seen is not None:
            if wanted is not None:
                raise ValueError(
                    f"{sample.where}: the file states light and view; expected no geometry= beside it"
                )
            return sample.seen
        if wanted is not None and known and wanted not in known:
            raise ValueError(
                f"{sample.where}: the file says {quoted(sample.said)}, which is not {wanted}; expected geometry= "
                f"one of {', '.join(known)}"
            )
        if wanted is None and len(known) != 1 and asked.quantity == "reflectance":
            said = f"{quoted(sample.said)} may be" if known else "does not say how the light came and was seen:"
            if sample.said and not known:
                said = f"{quoted(sample.said)} is none of the geometries known here:"
            raise ValueError(
                f"{sample.where}: {said} {', '.join(known or GEOMETRIES)}; expected geometry= one of them"
            )
        name = wanted or (known[0] if known else None)
        return Geometry(None) if name is None else asked.light_and_view(name)

    def _scale(self, sample: Sample, unit: str | None) -> float:
        if sample.unit is not None and unit not in (None, sample.unit):
            raise ValueError(
                f"{sample.where}: the file declares {sample.unit}; expected reflectance_unit={sample.unit!r}, "
                "or none"
            )
        chosen = sample.unit or unit
        if chosen is None:
            largest = np.nanmax(sample.values) if np.isfinite(sample.values).any() else 0.0
            raise ValueError(
                f"{sample.where}: the file does not say whether its values, up to {largest:g}, are fractions or "
                "percent; expected reflectance_unit='fraction' or 'percent'"
            )
        return UNITS[chosen]


def _check_wavelengths(sample: Sample) -> None:
    waves = sample.wavelengths_nm
    if waves.size == 0:
        raise ValueError(f"{sample.where}: no wavelength; expected at least one")
    bad = ~(np.isfinite(waves) & (waves > 0))
    if bad.any():
        raise ValueError(f"{sample.where}: wavelength {waves[bad][0]:g}; expected a positive one in nanometers")
    falls = np.flatnonzero(np.diff(waves) <= 0)
    if falls.size:
        first = int(falls[0])
        raise ValueError(
            f"{sample.where}: {waves[first + 1]:g} nm comes after {waves[first]:g} nm; expected increasing "
            "wavelengths"
        )


def _check_values(sample: Sample, values: np.ndarray, uncertainty: np.ndarray | None) -> None:
    def refuse(bad: np.ndarray, of: Any, what: str, expected: str) -> None:
        if bad.any():
            row, column = np.argwhere(bad)[0]
            place = f"{sample.wavelengths_nm[column]:g} nm"
            raise ValueError(f"{sample.where}: {what} is {of[row, column]:g} at {place}; {expected}")

    raw = sample.values
    if np.isnan(raw).all():
        raise ValueError(f"{sample.where}: no value; expected at least one")
    refuse(np.isinf(raw), raw, "the reflectance", "expected a finite number")
    refuse(
        values > LOOKS_LIKE_PERCENT,
        raw,
        "the reflectance",
        "this looks like percent; expected reflectance_unit='percent'",
    )
    noise = np.full(values.shape, 0.02)
    if uncertainty is not None:
        bad = ~np.isnan(raw) & ~(np.isfinite(uncertainty) & (uncertainty > 0))
        refuse(bad, uncertainty, "the standard uncertainty", "expected a positive number")
        noise = np.fmax(noise, 5 * uncertainty)
    refuse(values < -noise, raw, "the reflectance", "below zero by more than noise; expected a reflectance")
