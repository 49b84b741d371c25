"""What was measured: reflectance factors over directions and wavelengths, and where they come from."""

import dataclasses
from dataclasses import dataclass, field
from os import PathLike, fspath
from typing import Any, Literal

import numpy as np
from jaxtyping import Float64

from fitting.readers import formats
from fitting.readers.samples import Asked

# Room for the rounding of degrees to radians, far below what any goniometer resolves.
_ANGLE_SLACK = 1e-9


@dataclass(frozen=True, eq=False)
class Measurement:
    """Reflectance factors of one sample, seen from D directions at L wavelengths.

    The arrays are copied to float64 and are read-only. NaN in `reflectance_factor` marks a missing
    value, which a fit leaves out. If the detector collected all reflected light, there is one row (D = 1)
    which has no direction: `hemispherical` is true, and `polar` and `azimuth` are NaN.

    Args:
        wavelengths_nm: nm, shape (L,), positive and strictly increasing.
        polar: view angle from the mean normal, radians, shape (D,), -π/2 to π/2.
        azimuth: view azimuth, radians, shape (D,), -2π to 2π; 0 across the grooves, π/2 along them.
        reflectance_factor: fraction (never percent), shape (D, L). Small negative noise is kept as it is.
        standard_uncertainty: one standard deviation, fraction, shape (D, L), positive wherever a value is
            present; None if it is not known.
        illumination: a light of `vcavity_jax`; None stands for the default, `vcavity_jax.Diffuse()`.
        metadata: the text that came with the file, as written ("comments" holds its free lines). It is
            for people: a `reflectance_unit: percent` in it has been applied to the arrays already.
        hemispherical: the detector collects all reflected light, as in the geometries d:d, 0:d and 8:d.

    Raises:
        ValueError: shapes disagree, a wavelength or an angle lies outside its range, a value is infinite,
            an uncertainty is not positive, or a hemispherical measurement has directions.
    """

    # Plain arrays: __post_init__ checks shapes and values together, and says what is expected.
    wavelengths_nm: np.ndarray
    polar: np.ndarray
    azimuth: np.ndarray
    reflectance_factor: np.ndarray
    standard_uncertainty: np.ndarray | None = None
    illumination: Any = None
    metadata: dict[str, str] = field(default_factory=dict)
    hemispherical: bool = False

    def __post_init__(self) -> None:
        for name in _ARRAYS:
            value = getattr(self, name)
            if value is not None:
                array = np.array(value, dtype=np.float64)
                array.setflags(write=False)
                object.__setattr__(self, name, array)
        if isinstance(self.illumination, str):
            raise ValueError(
                f"illumination is the text {self.illumination!r}; expected a light such as vcavity_jax.Diffuse()"
            )
        # JAX takes half a second to import: whoever only imports this module does not pay for it.
        import vcavity_jax

        if self.illumination is None or isinstance(self.illumination, vcavity_jax.Hemisphere):
            object.__setattr__(self, "illumination", vcavity_jax.Diffuse())
        self._check_axes()
        self._check_values()

    def _check_axes(self) -> None:
        for name in ("wavelengths_nm", "polar", "azimuth"):
            array = getattr(self, name)
            if array.ndim != 1 or array.size == 0:
                raise ValueError(f"{name} has shape {array.shape}; expected one axis with at least one value")
        wavelengths = self.wavelengths_nm
        _refuse("wavelengths_nm", wavelengths, ~np.isfinite(wavelengths), "expected finite numbers")
        _refuse("wavelengths_nm", wavelengths, wavelengths <= 0, "expected positive numbers")
        falls = np.diff(wavelengths, prepend=-np.inf) <= 0
        _refuse("wavelengths_nm", wavelengths, falls, "expected strictly increasing wavelengths")
        if self.polar.shape != self.azimuth.shape:
            raise ValueError(
                f"polar has shape {self.polar.shape}, azimuth {self.azimuth.shape}; expected the same shape"
            )
        if self.hemispherical and self.polar.size > 1:
            raise ValueError(f"polar has shape {self.polar.shape}; expected (1,), because all light is collected")
        for name, limit, words in (("polar", np.pi / 2, "-π/2 to π/2"), ("azimuth", 2 * np.pi, "-2π to 2π")):
            array = getattr(self, name)
            if self.hemispherical:
                _refuse(name, array, ~np.isnan(array), "expected NaN: what collects all light has no direction")
                continue
            hint = "expected finite numbers (NaN with hemispherical=True, if all light is collected)"
            _refuse(name, array, ~np.isfinite(array), hint)
            beyond = np.abs(array) > limit + _ANGLE_SLACK
            _refuse(name, array, beyond, f"expected {words} radians: did you pass degrees?")

    def _check_values(self) -> None:
        shape = (self.polar.size, self.wavelengths_nm.size)
        values, uncertainty = self.reflectance_factor, self.standard_uncertainty
        for name, array in (("reflectance_factor", values), ("standard_uncertainty", uncertainty)):
            if array is not None and array.shape != shape:
                raise ValueError(
                    f"{name} has shape {array.shape}; expected {shape}: one row per direction, "
                    "one column per wavelength"
                )
        _refuse("reflectance_factor", values, np.isinf(values), "expected finite numbers, or NaN if missing")
        if uncertainty is not None:
            # A missing value needs no uncertainty, but infinity is wrong anywhere.
            bad = ~(uncertainty > 0) & ~np.isnan(values) | np.isinf(uncertainty)
            _refuse("standard_uncertainty", uncertainty, bad, "expected finite numbers above zero")

    @classmethod
    def read(
        cls,
        path: str | PathLike[str],
        *,
        column: str | None = None,
        reflectance_unit: str | None = None,
        geometry: str | None = None,
        geometry_azimuth_deg: float | None = None,
        trap_half_angle_deg: float | None = None,
    ) -> "Measurement":
        """Read a measurement file; nothing in it is sorted, clipped, filled or guessed.

        The format is told from the contents. The native CSV has three forms: tidy (`wavelength_nm, polar_deg,
        azimuth_deg, reflectance_factor`, optional `standard_uncertainty`); a spectrum (`wavelength_nm,
        reflectance_factor`, or two columns of bare numbers); a table of samples (`wavelength_nm` and one column
        per sample). The last two are one frontal view in diffuse light unless `# key: value` lines say otherwise:
        `geometry` names light and view at once (`geometry: d:8`, with `geometry_azimuth_deg` and
        `trap_half_angle_deg` if need be), or `illumination`, `polar_deg` and `azimuth_deg` give them one by one;
        `standard_uncertainty` may stand there too. Wavelength and direction pairs that no row gives are NaN; so
        are empty cells.

        Of the files of instruments, CGATS (.ti3, .txt), CxF3, JCAMP-DX (the extra "jcamp") and IES TM-27 are
        read. What such a file says of light, view and specular component is used; what it does not say must be
        given, and what it says must not be contradicted.

        Args:
            path: the file, UTF-8 text of at most 256 MB; CGATS and JCAMP-DX may be Latin-1.
            column: which sample of several to take.
            reflectance_unit: "fraction" or "percent", for a file that does not declare its unit.
            geometry: light and view by their name, see ``vcavity_jax.cie_geometry``, for a file that does not
                state them.
            geometry_azimuth_deg: azimuth of the direction of the geometry that is not the normal; 0 across the
                grooves (default), 90 along them.
            trap_half_angle_deg: of the gloss trap of "de:8".

        Returns:
            The measurement, with reflectance as a fraction and angles in radians. Directions stand in the
            order in which they first appear; where all reflected light is collected they are one NaN.
            `standard_uncertainty` is None if the file gives none.

        Raises:
            OSError: the file is missing, a directory or not readable.
            ValueError: the file is not as expected. The message is one line: file, line number, what is
                wrong, what is expected.
        """
        asked = Asked(column, reflectance_unit, "reflectance", geometry, geometry_azimuth_deg, trap_half_angle_deg)
        contents = formats.read(path, asked)
        return cls(
            wavelengths_nm=contents.wavelengths_nm,
            polar=contents.polar,
            azimuth=contents.azimuth,
            reflectance_factor=contents.reflectance_factor,
            standard_uncertainty=contents.standard_uncertainty,
            illumination=contents.illumination,
            metadata=contents.metadata,
            hemispherical=contents.hemispherical,
        )

    def write(self, path: str | PathLike[str]) -> None:
        """Write it as native CSV (.csv) or CGATS (.ti3, .cgats, .txt), by the name's end; it reads back equal.

        Args:
            path: the file; a reader sees the old one or the new one, never a part.

        Raises:
            OSError: the file cannot be written.
            ValueError: the name ends otherwise, or the light has no words in a file.
        """
        from fitting import writers

        writers.write(self, path)

    @property
    def view(self) -> Any:
        """The view of a scene that is seen as this was: a `vcavity_jax.View`, or a `vcavity_jax.Hemisphere`."""
        import vcavity_jax

        angles: Any = self.polar, self.azimuth
        return vcavity_jax.Hemisphere() if self.hemispherical else vcavity_jax.View(*angles)

    def select(self, *, wavelengths_nm: tuple[float, float]) -> "Measurement":
        """The part of the measurement between two wavelengths, both included.

        Args:
            wavelengths_nm: lowest and highest wavelength to keep, nm.

        Returns:
            A measurement with the same directions and fewer wavelengths.

        Raises:
            ValueError: the limits are in the wrong order or no wavelength lies between them.
        """
        low, high = wavelengths_nm
        keep = (self.wavelengths_nm >= low) & (self.wavelengths_nm <= high)
        if not keep.any():
            raise ValueError(
                f"no wavelength lies within {low:g} to {high:g} nm; expected a range that overlaps "
                f"{self.wavelengths_nm[0]:g} to {self.wavelengths_nm[-1]:g} nm"
            )
        uncertainty = self.standard_uncertainty
        return dataclasses.replace(
            self,
            wavelengths_nm=self.wavelengths_nm[keep],
            reflectance_factor=self.reflectance_factor[:, keep],
            standard_uncertainty=None if uncertainty is None else uncertainty[:, keep],
        )


_ARRAYS = ("wavelengths_nm", "polar", "azimuth", "reflectance_factor", "standard_uncertainty")


def same_light(first: Any, second: Any) -> bool:
    """Whether two lights are of one kind and their numbers agree to 1e-6."""
    import jax  # Reading a file does not need it.

    numbers = [jax.tree.leaves(light) for light in (first, second)]
    if type(first) is not type(second) or len(numbers[0]) != len(numbers[1]):
        return False
    return all(np.allclose(a, b, rtol=0, atol=1e-6) for a, b in zip(*numbers, strict=True))


def check_light(scene_light: Any, measured_light: Any, of: str = "") -> None:
    """Refuse a scene that is lit otherwise than the measurement.

    Raises:
        ValueError: they differ; ``of`` begins the message.
    """
    if not same_light(scene_light, measured_light):
        raise ValueError(
            f"{of}the scene is lit by {_short(scene_light)}, the measurement by {_short(measured_light)}; "
            "expected the same illumination: set it in the scene, or correct the measurement's"
        )


def _short(light: Any) -> str:
    import jax

    numbers = ", ".join(f"{float(leaf):.6g}" for leaf in jax.tree.leaves(light))
    return f"{type(light).__name__}({numbers})"


def read_spectrum(
    path: str | PathLike[str],
    *,
    column: str | None = None,
    reflectance_unit: str | None = None,
    quantity: Literal["reflectance", "transmittance"] = "reflectance",
) -> tuple[Float64[np.ndarray, " wavelengths"], Float64[np.ndarray, " wavelengths"], dict[str, str]]:
    """Read a spectrum: the reflectance of a flat sample, or the transmittance of a layer.

    Its columns are `wavelength_nm, reflectance` or, for a layer, `wavelength_nm, transmittance`. The file may
    also be a bare two-column spectrum or a table of samples. An uncertainty in it is checked and not returned.

    Args:
        path: the file.
        column: which sample of a table of samples to take.
        reflectance_unit: "fraction" or "percent", for a file that does not declare its unit.
        quantity: what is wanted. The values of a layer may also stand in a column `reflectance`.

    Returns:
        Wavelengths in nm, shape (L,), strictly increasing; values as fractions, shape (L,); metadata.

    Raises:
        OSError: the file is missing, a directory or not readable.
        ValueError: the file is not as expected, has several directions, or lacks a value: a model
            has no use for a gap, and none is filled here.
    """
    contents = formats.read(path, Asked(column, reflectance_unit, quantity))
    if contents.polar.size > 1:
        raise ValueError(f"{fspath(path)}:1: {contents.polar.size} directions; expected one spectrum")
    values = contents.reflectance_factor[0]
    if np.isnan(values).any():
        gap = contents.wavelengths_nm[np.argmax(np.isnan(values))]
        raise ValueError(
            f"{fspath(path)}:1: no {quantity} at {gap:g} nm; expected a value in every row: "
            "measure it or delete the row"
        )
    return contents.wavelengths_nm, values, contents.metadata


def _refuse(name: str, array: np.ndarray, bad: np.ndarray, expected: str) -> None:
    """Report the first bad entry with its place."""
    if bad.any():
        place = tuple(int(i) for i in np.argwhere(bad)[0])
        where = ", ".join(map(str, place))
        raise ValueError(f"{name}[{where}] is {array[place]:g}; {expected}")
