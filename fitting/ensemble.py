"""emcee on a compiled density: differential evolution and snooker moves, as long as it takes."""

import hashlib
import math
import sys
from os import PathLike
from typing import Any, NamedTuple

import emcee
import numpy as np
from tqdm import tqdm

from fitting.chain_file import ChainFile
from fitting.density import Density
from fitting.importance import mode_weights, modes
from fitting.result import FitResult

LENGTHS = 50
"""A chain is long enough when it is this many autocorrelation times long."""

MOST_NUMBERS = 6
"""With more numbers than this an ensemble does not converge in any useful time."""

_CHECK_EVERY = 200
_BURN_IN = 5


class Chain(NamedTuple):
    """What an ensemble left behind.

    Args:
        free: coordinates without bounds after burn-in, shape (steps, walkers, P).
        log_density: in these, shape (steps, walkers).
        autocorrelation_time: of each number, steps; NaN if the chain is too short to tell.
        acceptance: share of accepted proposals.
        steps: of the whole chain.
        long_enough: whether it is 50 autocorrelation times long.
        lost: proposals at which the model gave no number.
    """

    free: np.ndarray
    log_density: np.ndarray
    autocorrelation_time: np.ndarray
    acceptance: float
    steps: int
    long_enough: bool
    lost: int


def fingerprint(density: Density) -> str:
    """Identifies a density: its scenes, data, parameters, bounds, priors and noise."""
    digest = hashlib.sha256()
    layout, setting = density.problem.layout, density.setting
    for part in layout.parts:
        for piece in part.key:
            digest.update(repr(piece).encode())
    digest.update(repr((density.names, density.kind.noise, density.kind.robust, density.kind.powers)).encode())
    leaves = [*setting.data.values, *setting.data.weights, *(k for known in setting.data.known for k in known)]
    for leaf in (*leaves, setting.data.center, setting.data.tightness, setting.tail, density.bounds):
        digest.update(np.asarray(leaf).tobytes())
    return digest.hexdigest()


def run(
    result: FitResult,
    density: Density,
    *,
    walkers: int | None,
    steps: int | None,
    most_steps: int,
    seed: int,
    path: str | PathLike[str] | None,
    progress: bool,
) -> Chain:
    """Sample until the chain is long enough, or for a number of steps.

    Raises:
        OSError: the chain file cannot be written.
        ValueError: too few walkers, a chain file of another problem, or a fit without a covariance.
    """
    size = len(density.numbers)
    if walkers is None:
        walkers = max(32, 4 * size)
    if walkers < max(2 * size, 4) or walkers % 2:
        raise ValueError(
            f"walkers is {walkers}; expected an even number of at least {max(2 * size, 4)}, twice the {size} "
            "parameters"
        )
    lost = 0

    def log_density(free: np.ndarray) -> np.ndarray:
        nonlocal lost
        found = density.log_free(np.asarray(free))
        lost += int(np.isnan(found).sum())
        return np.where(np.isnan(found), -np.inf, found)

    backend: Any = emcee.backends.Backend()
    if path is not None:
        backend = ChainFile(path, fingerprint(density), walkers, density.names)
    try:
        moves = [(emcee.moves.DEMove(), 0.8), (emcee.moves.DESnookerMove(), 0.2)]
        sampler = emcee.EnsembleSampler(walkers, size, log_density, moves=moves, backend=backend, vectorize=True)
        if backend.initialized and backend.iteration:
            state = backend.get_last_sample()
        else:
            generator = np.random.default_rng(seed)
            start = _start(result, density, walkers, log_density, generator)
            state = emcee.State(start, random_state=np.random.RandomState(seed).get_state())
        done = backend.iteration if backend.initialized else 0
        wanted = most_steps if steps is None else steps
        if steps is None and done and _length(backend)[1]:
            wanted = done
        bar = tqdm(total=wanted, initial=done, unit="step", desc="sampling", disable=not progress, file=sys.stderr)
        with bar:
            while done < wanted:
                count = min(_CHECK_EVERY, wanted - done)
                steps_taken = sampler.sample(state, iterations=count, skip_initial_state_check=True)
                for state in steps_taken:  # noqa: B007 (the last one is where it goes on)
                    bar.update()
                done += count
                if steps is None:
                    time, enough = _length(backend)
                    if enough:
                        break
                    if np.isfinite(time).all():
                        # The time left is that to the length which is needed as far as is known.
                        bar.total = min(wanted, math.ceil((LENGTHS + _BURN_IN) * np.max(time)))
                        bar.refresh()
        time, enough = _length(backend)
        burnt = _burnt(time, done)
        chain, logs = backend.get_chain(discard=burnt), backend.get_log_prob(discard=burnt)
        acceptance = float(np.mean(backend.accepted) / max(done, 1))
    finally:
        if path is not None:
            backend.close()
    return Chain(np.array(chain), np.array(logs), time, acceptance, done, enough, lost)


def _length(backend: Any) -> tuple[np.ndarray, bool]:
    """Autocorrelation times after burn-in, and whether the rest is long enough."""
    count = backend.iteration
    with np.errstate(all="ignore"):
        time = emcee.autocorr.integrated_time(backend.get_chain(discard=count // 6), quiet=True, tol=0)
    if not (np.isfinite(time).all() and np.all(time > 0)):
        return np.full(len(time), np.nan), False
    left = count - _burnt(time, count)
    return time, bool(left >= LENGTHS * np.max(time))


def _burnt(time: np.ndarray, count: int) -> int:
    if not np.isfinite(time).all():
        return count // 2
    return min(math.ceil(_BURN_IN * float(np.max(time))), count // 2)


def _start(
    result: FitResult, density: Density, walkers: int, log_density: Any, generator: np.random.Generator
) -> np.ndarray:
    """Walkers around every distinct minimum by its weight, spread by its covariance."""
    centers, roots = modes(result, density)
    chosen = generator.choice(len(centers), 16 * walkers, p=mode_weights(density, centers, roots))
    noise = generator.standard_normal((16 * walkers, centers.shape[1]))
    drawn = centers[chosen] + np.einsum("nij,nj->ni", roots[chosen], noise)
    good = drawn[np.isfinite(log_density(drawn))]
    if len(good) < walkers:
        raise ValueError(
            f"the density is zero around the fit ({len(good)} of {16 * walkers} starts are usable); expected "
            "priors and bounds that allow the fit"
        )
    return np.asarray(good[:walkers])
