"""A fit in every pixel of a cube: block after block, resumable, and by several processes or machines."""

import hashlib
import io
import json
import re
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import jax
import numpy as np
import xarray as xr
from tqdm import tqdm

from fitting import files
from fitting.cubes.blocks import Job, work
from fitting.cubes.envi import DIMENSIONS, data_file, open_cube
from fitting.cubes.maps import CubeResult, write_maps
from fitting.cubes.references import References, references
from fitting.measurement import Measurement

_VALUES_AT_ONCE = 1_500_000
"""Of the cube, in a block: 12 MB as floating-point numbers, and ten times as much while they are fitted."""

_LINES_TOLD = 16
_OF_WORKERS = {
    # JAX hangs under several threads of dask, and workers that share cores hinder each other.
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
    # Dask's own setting gives every array back to the system at once: half of the time went into page faults.
    "MALLOC_TRIM_THRESHOLD_": "536870912",
    "MALLOC_MMAP_THRESHOLD_": "33554432",
    "MALLOC_ARENA_MAX": "1",
    "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
}
"""The environment that a worker starts in."""


def fit_cube(
    scene: Any,
    cube: str | PathLike[str] | xr.DataArray,
    parameters: Sequence[Any],
    output: str | PathLike[str],
    *,
    standard_uncertainty: Any,
    white: Any = None,
    dark: Any = None,
    white_reflectance: Any = 1.0,
    reflectance_unit: str | None = None,
    saturation: float | None = None,
    wavelengths_nm: tuple[float, float] | None = None,
    tolerance: float = 1e-6,
    max_steps: int = 300,
    workers: int = 1,
    client: Any = None,
    progress: bool = False,
) -> CubeResult:
    """Fit every pixel of a hyperspectral cube by itself and write maps of what was found.

    The cube is read, calibrated and fitted in blocks of lines; memory depends on the length of a line and not on
    their number. Each finished block is kept beside the output until all are done, so that a run that was killed
    goes on where it stopped when it is called again. The maps appear whole or not at all.

    Counts become reflectance factors by (cube - dark) / (white - dark) [SaintPierre2020, eq. 4.42]. Left out, band
    by band: what is not finite or the header's ``data ignore value``, what is saturated, elements of the detector
    for which the white reference shows nothing, and bands that the header marks as bad.

    Args:
        scene: what the sample is, seen from one direction; materials have a value for each band that is used.
        cube: an ENVI header, or an array with the dimensions (line, sample, wavelength) and the coordinate
            ``wavelength``, nm.
        parameters: see ``fit``. Angle and gain, or whatever else leaves only gains and offsets beside what is
            searched, is answered from a table: thousands of pixels in a second.
        output: NetCDF file (.nc) of the maps; angles are in degrees there.
        standard_uncertainty: of a reflectance factor, one number, or one for each band of the cube.
        white: white reference: a cube of as many samples (its lines are averaged), an array of the shape
            (lines, samples, bands), (samples, bands) or (bands,), or a region of the cube itself as two slices, of
            lines and of samples. None if the cube holds reflectances.
        dark: dark reference, likewise; None for no counts without light.
        white_reflectance: reflectance factor of the white reference, one number, or one for each band of the cube.
        reflectance_unit: "fraction" or "percent", of a cube of reflectances whose header has no scale factor.
        saturation: count from which on a value is saturated; none by default.
        wavelengths_nm: lowest and highest wavelength to use, nm; all by default.
        tolerance: bound on the model's numerical error.
        max_steps: most steps of a descent.
        workers: processes on this machine, by dask (the extra "dask"); a script that asks for more than one needs
            ``if __name__ == "__main__":``.
        client: a ``distributed.Client``, for processes on several machines, which must all see the cube's file and
            have one thread each.
        progress: show how far it is, and the time left, on standard error.

    Returns:
        The maps, which are read from the output when they are asked for.

    Raises:
        OSError: a file is missing, cannot be read or cannot be written.
        ValueError: the inputs do not fit together; a file that is not as expected; an unfinished fit of something
            else at this output.
    """
    target = Path(output)
    if target.suffix != ".nc":
        raise ValueError(f"{fspath(output)}: expected a name that ends in .nc")
    if workers < 1:
        raise ValueError(f"workers is {workers}; expected at least 1")
    array = _array(cube)
    used = used_bands(array, wavelengths_nm)
    of_cube = references(array, white, dark, white_reflectance, saturation, reflectance_unit).of_bands(used)
    sigma = _sigma(standard_uncertainty, used)
    array = array.isel(wavelength=np.flatnonzero(used)) if not used.all() else array
    job = _job(scene, array, parameters, of_cube, sigma, tolerance, max_steps)
    lines, samples, bands = (job.cube.sizes[name] for name in DIMENSIONS)
    at_once = max(1, _VALUES_AT_ONCE // (samples * bands))
    blocks = [(first, min(first + at_once, lines)) for first in range(0, lines, at_once)]
    kept = _Kept(target.with_name(f"{target.name}.part"), job.identity, blocks)
    todo = [block for block in blocks if not kept.has(block)]
    with tqdm(
        total=lines * samples,
        initial=lines * samples - samples * sum(last - first for first, last in todo),
        unit=" pixels",
        unit_scale=True,
        disable=not progress,
    ) as bar:
        try:
            for block, maps in _finished(job, todo, workers, client):
                kept.store(block, maps)
                bar.update(samples * (block[1] - block[0]))
        finally:
            kept.remove_if_empty()
    write_maps(target, job, blocks, kept.load)
    kept.remove()
    return CubeResult(target)


def _array(cube: Any) -> xr.DataArray:
    array = cube if isinstance(cube, xr.DataArray) else open_cube(cube)
    if set(array.dims) != set(DIMENSIONS) or "wavelength" not in array.coords:
        had = ", ".join(map(str, array.dims))
        raise ValueError(
            f"the cube has the dimensions {had}; expected line, sample and wavelength, the last with a coordinate"
        )
    return array.transpose(*DIMENSIONS)


def used_bands(cube: xr.DataArray, wavelengths_nm: tuple[float, float] | None = None) -> np.ndarray:
    """Which bands of a cube a fit uses: those within a range that the header does not mark as bad.

    Args:
        cube: see ``open_cube``.
        wavelengths_nm: lowest and highest wavelength, nm; all if None.

    Returns:
        Shape (bands,), at least one of them true.

    Raises:
        ValueError: no band is left.
    """
    waves = np.asarray(cube.coords["wavelength"].values, np.float64)
    low, high = wavelengths_nm or (-np.inf, np.inf)
    used = np.asarray((waves >= low) & (waves <= high) & cube.attrs.get("good_bands", True))
    if not used.any():
        raise ValueError(
            f"no good band lies within {low:g} to {high:g} nm; expected a range that overlaps {waves[0]:g} to "
            f"{waves[-1]:g} nm"
        )
    return used


def _sigma(given: Any, used: np.ndarray) -> np.ndarray:
    """The standard uncertainty of the bands that are used."""
    sigma = np.asarray(given, np.float64)
    if sigma.shape not in ((), used.shape) or not (np.isfinite(sigma) & (sigma > 0)).all():
        raise ValueError(
            f"standard_uncertainty: expected a number above 0, or {used.size} of them, one for each band"
        )
    return np.broadcast_to(sigma, used.shape)[used]


def _job(
    scene: Any,
    array: xr.DataArray,
    parameters: Sequence[Any],
    of_cube: References,
    sigma: np.ndarray,
    tolerance: float,
    max_steps: int,
) -> Job:
    waves = np.asarray(array.coords["wavelength"].values, np.float64)
    template = _template(scene, waves, sigma)
    arrays = [np.asarray(leaf) for leaf in jax.tree.leaves(scene)]
    arrays += [held for held in vars(of_cube).values() if isinstance(held, np.ndarray)] + [sigma, waves]
    content = (
        [hashlib.sha256(held.tobytes()).hexdigest() for held in arrays],
        # Where a function lies in memory is not what it does.
        re.sub(r" at 0x[0-9a-f]+", "", f"{jax.tree.structure(scene)} {parameters}"),
        [str(array.attrs.get("source")), array.shape, str(array.dtype), _stamp(array)],
        [tolerance, max_steps, of_cube.scale, of_cube.saturation, of_cube.ignore],
    )
    identity = hashlib.sha256(repr(content).encode()).hexdigest()
    return Job(identity, scene, template, tuple(parameters), array, of_cube, sigma, tolerance, max_steps)


def _stamp(array: xr.DataArray) -> Any:
    """What tells one cube from another: of a file its size and date, of other arrays some of their lines."""
    source = str(array.attrs.get("source", ""))
    with suppress(OSError, ValueError):
        stat = data_file(source, Path(source)).stat()
        return stat.st_size, stat.st_mtime_ns
    step = -(-array.sizes["line"] // _LINES_TOLD)
    return hashlib.sha256(array.isel(line=slice(None, None, step)).values.tobytes()).hexdigest()


def _template(scene: Any, waves: np.ndarray, sigma: np.ndarray) -> Measurement:
    view = scene.view
    hemispherical = not hasattr(view, "polar")
    angles = np.full((2, 1), np.nan)
    if not hemispherical:
        angles = np.stack([np.ravel(view.polar), np.ravel(view.azimuth)]).astype(np.float64)
        if angles.shape[1] != 1:
            raise ValueError(
                f"the scene is seen from {angles.shape[1]} directions; expected one, that of the camera"
            )
    return Measurement(
        waves,
        angles[0],
        angles[1],
        np.full((1, waves.size), 0.5),
        np.array(sigma)[None],
        illumination=scene.illumination,
        hemispherical=hemispherical,
    )


def _finished(
    job: Job, blocks: Sequence[tuple[int, int]], workers: int, client: Any
) -> Iterator[tuple[tuple[int, int], dict[str, np.ndarray]]]:
    """Blocks and their maps as they come."""
    if not blocks:
        return
    if client is None and workers == 1:
        for block in blocks:
            yield block, job.run(*block)
        return
    try:
        from distributed import KilledWorker, as_completed
        from distributed.protocol.pickle import dumps
    except ImportError:
        raise ValueError(
            "several workers need dask (pip install 'vcavity[dask]'); expected it, or one worker"
        ) from None
    with nullcontext(client) if client is not None else local_cluster(workers) as cluster:
        threads = set(cluster.nthreads().values())
        if threads != {1}:
            most = max(threads, default=0)
            raise ValueError(f"the workers have {most} threads; expected one each (threads_per_worker=1)")
        packed = cluster.scatter(dumps(job), broadcast=True, hash=False)
        of_first = {first: (first, last) for first, last in blocks}
        double = bool(jax.config.jax_enable_x64)  # type: ignore[attr-defined]
        futures = [cluster.submit(work, job.identity, packed, *block, double, pure=False) for block in blocks]
        for future in as_completed(futures):
            try:
                first, maps = future.result()
            except KilledWorker as error:
                raise OSError(
                    f"a worker died ({error.last_worker}); expected more memory or fewer workers; what is done is "
                    "kept"
                ) from None
            future.release()
            yield of_first[first], maps


@contextmanager
def local_cluster(workers: int) -> Iterator[Any]:
    """A ``distributed.Client`` of worker processes on this machine, with one thread each.

    Args:
        workers: how many.
    """
    import dask
    from distributed import Client, LocalCluster

    with dask.config.set({"distributed.nanny.pre-spawn-environ": _OF_WORKERS}):
        cluster = LocalCluster(n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=None)
    with cluster, Client(cluster) as client:
        yield client


class _Kept:
    """Finished blocks in a folder beside the output.

    Args:
        folder: made if it does not exist.
        identity: of the job; blocks of another one are refused.
        blocks: of the job.
    """

    def __init__(self, folder: Path, identity: str, blocks: Sequence[tuple[int, int]]) -> None:
        self.folder = folder
        if folder.exists():
            try:
                known = json.loads((folder / "job.json").read_text(encoding="utf-8"))
            except (OSError, ValueError):
                known = {}
            if not known and not any(folder.glob("lines-*.npz")):
                known = self._note(identity, len(blocks))
            if known.get("identity") != identity:
                raise ValueError(
                    f"{folder}: holds an unfinished fit of something else; expected another output, or this "
                    "folder deleted"
                )
        else:
            folder.mkdir(parents=True)
            self._note(identity, len(blocks))

    def _note(self, identity: str, count: int) -> dict[str, Any]:
        known: dict[str, Any] = {"identity": identity, "blocks": count}
        files.write_json(self.folder / "job.json", known)
        return known

    def _path(self, block: tuple[int, int]) -> Path:
        return self.folder / f"lines-{block[0]:07d}-{block[1]:07d}.npz"

    def has(self, block: tuple[int, int]) -> bool:
        """Whether a block is done."""
        return self._path(block).exists()

    def store(self, block: tuple[int, int], maps: dict[str, np.ndarray]) -> None:
        """Keep a block; what a kill leaves behind is all of it or nothing."""
        stream = io.BytesIO()
        np.savez(stream, **maps)  # type: ignore[arg-type]
        files.write(self._path(block), stream.getvalue())

    def load(self, block: tuple[int, int]) -> dict[str, np.ndarray]:
        """The maps of a block."""
        with np.load(self._path(block)) as stored:
            return dict(stored)

    def remove(self) -> None:
        """All of it."""
        shutil.rmtree(self.folder)

    def remove_if_empty(self) -> None:
        """What a fit leaves that failed before its first block was done."""
        if not any(self.folder.glob("lines-*.npz")):
            self.remove()
