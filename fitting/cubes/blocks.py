"""A block of lines: read, calibrated, fitted. It runs in workers, too, and so knows no file that is written."""

import pickle
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from fitting.assembly import build
from fitting.cubes.references import References
from fitting.many import ManyProblem
from fitting.measurement import Measurement
from fitting.readers.contents import LOOKS_LIKE_PERCENT

STATUSES = (
    *("converged", "not converged", "no number", "not identifiable", "at bound"),
    *("no value", "bad value", "saturated", "dead"),
)
"""What a pixel's number in the map of the status stands for; the last two have no band left, and why."""


@dataclass(frozen=True, eq=False)
class Job:
    """All that a block needs.

    Args:
        identity: of this job.
        scene: what the sample is.
        template: directions, wavelengths and light.
        parameters: see ``fit``.
        cube: raw values.
        references: of the cube.
        sigma: standard uncertainty, shape (L,).
        tolerance: see ``fit_many``.
        max_steps: see ``fit_many``.
    """

    identity: str
    scene: Any
    template: Measurement
    parameters: tuple[Any, ...]
    cube: xr.DataArray
    references: References
    sigma: np.ndarray
    tolerance: float
    max_steps: int

    def run(self, first: int, last: int) -> dict[str, np.ndarray]:
        """Maps of some lines by name, shape (last - first, samples) and, of spectra, (.., .., L).

        Raises:
            OSError: the cube cannot be read.
            ValueError: the values are percent.
        """
        values, saturated, dead = self.references.apply(self.cube.isel(line=slice(first, last)).values)
        shape = values.shape[:2]
        if np.isfinite(values).any() and np.nanmedian(values) > LOOKS_LIKE_PERCENT:
            raise ValueError(
                f"{self.cube.attrs.get('source', 'the cube')}: the median of lines {first} to {last} is "
                f"{np.nanmedian(values):g}; these look like percent or counts: expected a white reference or "
                "the unit"
            )
        spectra = values.reshape(-1, 1, values.shape[2])
        sigma = np.broadcast_to(self.sigma, spectra.shape)
        problem = _problem(self)
        numbers, errors, free, free_errors, chi_square, dof, gap, status, _ = problem.columns(
            spectra, sigma, self.max_steps
        )
        codes = np.array([STATUSES.index(word) for word in status], np.int8).reshape(shape)
        left = np.isfinite(values).any(axis=2)
        codes[~left & dead.any(axis=2)] = STATUSES.index("dead")
        codes[~left & saturated.any(axis=2)] = STATUSES.index("saturated")
        maps: dict[str, np.ndarray] = {}
        for i, parameter in enumerate(problem.problem.numbers):
            maps[parameter.name] = parameter.displayed(numbers[:, i]).reshape(shape)
            maps[f"{parameter.name}_standard_error"] = parameter.displayed(errors[:, i]).reshape(shape)
        for i, name in enumerate(problem.problem.free_names):
            maps[name] = free[:, i].reshape(*shape, -1)
            maps[f"{name}_standard_error"] = free_errors[:, i].reshape(*shape, -1)
        return maps | {
            "chi_square": chi_square.reshape(shape),
            "degrees_of_freedom": dof.reshape(shape).astype(np.int32),
            "next_minimum": gap.reshape(shape),
            "missing_bands": (~np.isfinite(values)).sum(axis=2).astype(np.int32),
            "status": codes,
        }


_ready: dict[str, ManyProblem] = {}


def _problem(job: Job) -> ManyProblem:
    """Compiled, and with its table, once in each process."""
    if job.identity not in _ready:
        _ready.clear()
        problem = build(job.scene, job.template, job.parameters, None, job.tolerance)
        _ready[job.identity] = ManyProblem(
            problem, job.tolerance, job.cube.sizes["line"] * job.cube.sizes["sample"]
        )
    return _ready[job.identity]


_jobs: dict[str, Job] = {}


def work(identity: str, packed: bytes, first: int, last: int, double: bool) -> tuple[int, dict[str, np.ndarray]]:
    """A block in a worker process: its first line, and its maps."""
    import jax

    jax.config.update("jax_enable_x64", double)
    if identity not in _jobs:
        _jobs.clear()
        _jobs[identity] = pickle.loads(packed)
    return first, _jobs[identity].run(first, last)
