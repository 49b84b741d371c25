"""Hyperspectral cubes: a fit in every pixel, in memory that does not grow with the cube (the extra "cubes")."""

try:
    import h5netcdf as _h5netcdf  # noqa: F401
    import xarray as _xarray  # noqa: F401
except ImportError as error:
    raise ImportError(f"{error}; expected pip install 'vcavity[cubes]'", name=error.name) from None

from fitting.cubes.envi import open_cube as open_cube
from fitting.cubes.fit import fit_cube as fit_cube
from fitting.cubes.fit import local_cluster as local_cluster
from fitting.cubes.fit import used_bands as used_bands
from fitting.cubes.maps import CubeResult as CubeResult

__all__ = ["CubeResult", "fit_cube", "local_cluster", "open_cube", "used_bands"]
