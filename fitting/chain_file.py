"""A chain kept in an HDF5 file that survives a kill: no stored step is lost, and it resumes where it stopped.

Space is allocated ahead, so that storing a step only overwrites numbers; the count of steps is written last. The
file is as emcee's own backend lays it out, and ``emcee.backends.HDFBackend`` reads it when the chain has ended.
"""

import io
import os
from pathlib import Path
from typing import Any

import emcee
import h5py
import numpy as np

from fitting import files

GROUP = "mcmc"
_FIRST_STEPS = 1000
_KEYS = 624


class ChainFile(emcee.backends.Backend):
    """An emcee backend in a file.

    Args:
        path: the file; one that exists is continued.
        problem: identifies the problem and the ensemble; a chain of another one is refused.
        walkers: how many.
        names: of the numbers.

    Raises:
        OSError: the file cannot be written.
        ValueError: it is no chain, holds NaN, or is the chain of another problem.
    """

    def __init__(self, path: str | os.PathLike[str], problem: str, walkers: int, names: tuple[str, ...]) -> None:
        super().__init__()
        self.path, self._problem, self._names = Path(path), problem, names
        self.reset(walkers, len(names))
        self._file: Any = None
        if self.path.exists():
            self._read()
        self._allocate(max(_FIRST_STEPS, 2 * self.iteration))

    def _read(self) -> None:
        try:
            with h5py.File(self.path, "r") as file:
                group = file[GROUP]
                known = {key: group.attrs[key] for key in ("problem", "nwalkers", "ndim", "names")}
                count = int(group["stored"][0])
                chain, log_prob = group["chain"][:count], group["log_prob"][:count]
                accepted, state = group["accepts"][count % 2], group["states"][count % 2]
        except (OSError, KeyError, ValueError, RuntimeError) as error:
            raise ValueError(
                f"{self.path}: is no chain of this package ({type(error).__name__}); expected another file name"
            ) from None
        if known["problem"] != self._problem or int(known["ndim"]) != self.ndim:
            raise ValueError(
                f"{self.path}: holds the chain of another problem (parameters {known['names']}); expected the "
                "same scene, measurement, parameters, priors and noise, or another file name"
            )
        if int(known["nwalkers"]) != self.nwalkers:
            raise ValueError(
                f"{self.path}: holds a chain of {known['nwalkers']} walkers, not {self.nwalkers}; expected "
                f"walkers={known['nwalkers']}, or another file name"
            )
        if np.isnan(chain).any() or np.isnan(log_prob).any():
            step = int(np.argmax(np.isnan(chain).any(axis=(1, 2)) | np.isnan(log_prob).any(axis=1)))
            raise ValueError(f"{self.path}: step {step} of the chain is NaN; expected another file name")
        self.chain, self.log_prob, self.accepted, self.iteration = chain, log_prob, accepted, count
        if count:
            keys, (place, has_gauss, gauss) = state[:_KEYS].astype(np.uint32), state[_KEYS:]
            self.random_state = "MT19937", keys, int(place), int(has_gauss), float(gauss)

    def _allocate(self, steps: int) -> None:
        """Write all that is known to a new file with room for more, and put it in the place of the old one."""
        contents = io.BytesIO()  # HDF5 itself speaks of a full disk only when a file is closed
        with h5py.File(contents, "w") as file:
            group = file.create_group(GROUP)
            group.attrs.update(
                version=emcee.__version__,
                nwalkers=self.nwalkers,
                ndim=self.ndim,
                has_blobs=False,
                iteration=self.iteration,
                problem=self._problem,
                names=", ".join(self._names),
            )
            shapes = {
                "chain": (steps, self.nwalkers, self.ndim),
                "log_prob": (steps, self.nwalkers),
                "accepts": (2, self.nwalkers),
            }
            for name, shape in shapes.items():
                group.create_dataset(name, data=np.full(shape, np.nan))
            group.create_dataset("accepted", data=self.accepted)
            group.create_dataset("states", data=np.zeros((2, _KEYS + 3)))
            group.create_dataset("stored", data=np.array([self.iteration]))
            group["chain"][: self.iteration] = self.chain[: self.iteration]
            group["log_prob"][: self.iteration] = self.log_prob[: self.iteration]
            if self.iteration:
                self._store_state(group, self.iteration)
        files.write(self.path, contents.getvalue())
        if self._file is not None:
            self._file.close()
        self._file = h5py.File(self.path, "r+")
        for name, room in (("chain", self.chain), ("log_prob", self.log_prob)):
            grown = np.full((steps, *room.shape[1:]), np.nan)
            grown[: self.iteration] = room[: self.iteration]
            setattr(self, name, grown)

    def _store_state(self, group: Any, count: int) -> None:
        group["states"][count % 2] = np.append(self.random_state[1], self.random_state[2:])
        group["accepts"][count % 2] = self.accepted

    def grow(self, ngrow: int, blobs: Any) -> None:
        """Room is made when it is needed."""

    def save_step(self, state: Any, accepted: np.ndarray) -> None:
        """Store one step: the numbers first, then how many there are."""
        if self.iteration == len(self.chain):
            self._allocate(2 * self.iteration)
        self.chain[self.iteration], self.log_prob[self.iteration] = state.coords, state.log_prob
        self.accepted = self.accepted + accepted
        self.random_state = state.random_state
        group = self._file[GROUP]
        group["chain"][self.iteration] = state.coords
        group["log_prob"][self.iteration] = state.log_prob
        self._store_state(group, self.iteration + 1)
        self._file.flush()
        self.iteration += 1
        group["stored"][0] = self.iteration
        self._file.flush()

    def close(self) -> None:
        """Leave the file as emcee reads it."""
        if self._file is not None:
            group = self._file[GROUP]
            group.attrs.modify("iteration", self.iteration)
            group["accepted"][:] = self.accepted
            self._file.close()
            self._file = None
