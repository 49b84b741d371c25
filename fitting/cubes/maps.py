"""Maps of what was found in a cube: a NetCDF file, and its summary."""

import secrets
from collections.abc import Callable, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from fitting.cubes.blocks import STATUSES, Job

_MISFIT = 2.0
_UNITS = {"rad": "degree", "nm": "nm", "1": "1"}


class CubeResult:
    """Maps of a fitted cube, in a NetCDF file.

    Args:
        path: the file.
    """

    def __init__(self, path: str | PathLike[str]) -> None:
        self.path = Path(path)

    def open(self) -> xr.Dataset:
        """All maps with their units, read when they are asked for; close it, or use it in a ``with``."""
        return xr.open_dataset(self.path, engine="h5netcdf")

    def counts(self) -> dict[str, int]:
        """How many pixels ended how."""
        with self.open() as maps:
            found = np.bincount(maps["status"].values.ravel(), minlength=len(STATUSES))
        return {word: int(count) for word, count in zip(STATUSES, found, strict=True) if count}

    def summary(self) -> str:
        """Medians of what was found, and how many pixels ended how."""
        counts = self.counts()
        lines = [
            f"{sum(counts.values())} pixels: " + ", ".join(f"{count} {word}" for word, count in counts.items())
        ]
        with self.open() as maps:
            good = maps["status"].values == 0
            freedom = maps["degrees_of_freedom"].values[good]
            if (freedom > 0).any():
                misfit = float(np.median(maps["chi_square"].values[good][freedom > 0] / freedom[freedom > 0]))
                hint = ": the model or the uncertainty does not fit the data" if misfit > _MISFIT else ""
                lines.append(f"chi-square per degree of freedom: median {misfit:.3g}{hint}")
            for name in maps.attrs["free"].split():
                if maps[name].ndim > 2 or not good.any():
                    continue
                values, errors = (maps[key].values[good] for key in (name, f"{name}_standard_error"))
                low, middle, high = np.percentile(values, [2.5, 50, 97.5])
                unit = {"degree": "°", "1": ""}.get(maps[name].attrs["units"], " " + maps[name].attrs["units"])
                lines.append(
                    f"{name}: median {middle:.5g}{unit}, 95 % of the pixels {low:.5g} to {high:.5g}{unit}; "
                    f"median standard error {np.nanmedian(errors):.2g}{unit}"
                )
        return "\n".join(lines)

    def plot(self, path: str | PathLike[str]) -> None:
        """The first free parameter and its standard error as maps, its histogram, and the failures.

        Args:
            path: the file; its ending, .png, .pdf or .svg, decides the format.
        """
        # Workers need no matplotlib.
        from fitting.cubes.figure import draw
        from fitting.plots import write_figure

        with self.open() as maps:
            write_figure(lambda: draw(maps), path, dpi=150)


def write_maps(
    path: Path,
    job: Job,
    blocks: Sequence[tuple[int, int]],
    load: Callable[[tuple[int, int]], dict[str, np.ndarray]],
) -> None:
    """Write the maps block by block; the file appears when it is whole.

    Raises:
        OSError: the file cannot be written.
    """
    import h5netcdf

    part = path.with_name(f".{path.name[:100]}.{secrets.token_hex(4)}")
    lines, samples = job.cube.sizes["line"], job.cube.sizes["sample"]
    named = {parameter.name: getattr(parameter, "unit", "1") for parameter in job.parameters}
    try:
        with h5netcdf.File(part, "w") as file:
            file.dimensions = {"line": lines, "sample": samples, "wavelength": job.sigma.size}
            waves = file.create_variable("wavelength", ("wavelength",), data=job.template.wavelengths_nm)
            waves.attrs["units"] = "nm"
            file.attrs["Conventions"] = "CF-1.10"
            file.attrs["source"] = str(job.cube.attrs.get("source", "an array"))
            for block in blocks:
                maps = load(block)
                for name, values in maps.items():
                    if name not in file.variables:
                        dims = ("line", "sample", "wavelength")[: values.ndim]
                        chunks = (block[1] - block[0], *values.shape[1:])
                        made = file.create_variable(
                            name, dims, values.dtype, chunks=chunks, compression="gzip", compression_opts=1
                        )
                        made.attrs.update(_attributes(name, named))
                    file.variables[name][block[0] : block[1]] = values
            file.attrs["free"] = " ".join(
                name for name in file.variables if f"{name}_standard_error" in file.variables
            )
        part.replace(path)
    except OSError as error:
        raise type(error)(
            f"{path}: cannot write ({error.strerror or error}); expected a place for a file"
        ) from None
    finally:
        part.unlink(missing_ok=True)


def _attributes(name: str, units: dict[str, str]) -> dict[str, Any]:
    if name == "status":
        flags = np.arange(len(STATUSES), dtype=np.int8)
        return {"flag_values": flags, "flag_meanings": " ".join(word.replace(" ", "_") for word in STATUSES)}
    if name in ("missing_bands", "degrees_of_freedom", "chi_square", "next_minimum"):
        return {"units": "1"}
    return {"units": _UNITS[units.get(name.removesuffix("_standard_error"), "1")]}
