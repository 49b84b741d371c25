"""What is measured of a quantity: compile time, run time, memory, error and success, of ours and of its peers."""

import statistics
import time
import tracemalloc
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray

from fitting.bench.peak import Peak
from fitting.bench.timing import compiled, median_time

Real = NDArray[np.float64]
Spectrum = Callable[[Array, Array], Array]

ROUNDING = float(np.finfo(float).eps)
"""No reference is better than this: a smaller error counts as this one."""

_CHECKED = 40


@dataclass(frozen=True)
class Peer:
    """What a user would run instead.

    Args:
        name: for the tables.
        run: spectrum of one angle.
        random: its error is that of chance: it is one standard deviation that counts.
    """

    name: str
    run: Callable[[float], Real]
    random: bool = False


@dataclass(frozen=True)
class Quantity:
    """Something to compute: a spectrum by one geometric parameter and by optical data of each wavelength.

    Args:
        part: the model: "diffusing", "mirrors", "interfaced" or "random grooves".
        name: for the tables.
        ours: for a tolerance, spectrum by geometry and optical data.
        optical: reflectances or indices, shape (L,).
        geometry: that many random values of the angle (radians) or the roughness.
        peers: to compare with.
        exact: a reference that shares no code with ours, if there is one; else ours at its finest.
        tolerances: that it is worth asking for.
        finest: of the reference.
        gradient: whether derivatives are measured.
        together: how many scenes of a batch run side by side; the rest follows.
    """

    part: str
    name: str
    ours: Callable[[float], Spectrum]
    optical: NDArray[Any]
    geometry: Callable[[int], Real]
    peers: tuple[Peer, ...] = ()
    exact: Callable[[float], Real] | None = None
    tolerances: tuple[float, ...] = (1e-3, 1e-6, 1e-9, 1e-12)
    finest: float = 1e-13
    gradient: bool = True
    together: int = 64

    @property
    def exact_sum(self) -> bool:
        """A sum that has nothing to choose: every tolerance gives the same."""
        return len(self.tolerances) == 1

    def reference(self, values: Real) -> Real:
        """To compare with, shape (values, L)."""
        if self.exact is not None:
            return np.stack([self.exact(float(value)) for value in values])
        fine, optical = self.ours(self.finest), jnp.asarray(self.optical)
        program = jax.jit(lambda these: jax.lax.map(lambda value: fine(value, optical), these))
        return np.asarray(program(jnp.asarray(values)))


@dataclass(frozen=True)
class Row:
    """One line of the table; times per spectrum.

    Args:
        part: see ``Quantity``.
        quantity: its name.
        method: "vcavity" or a peer's name.
        tolerance: that was asked for; None for a peer, and for sums that are exact.
        what: "value", or "gradient": a misfit, with its derivatives by geometry and by all optical data.
        precision: "float64" or "float32".
        scenes: in a batch.
        device: "cpu" or "gpu".
        compile_s: seconds to trace and compile.
        time_us: microseconds.
        memory_kib: of a batch, beyond arguments and results.
        error: the largest absolute one of values; for a gradient, of the derivative by geometry.
        success: share of the scenes within the tolerance and finite.
        of_peak: see ``Peak.fraction``; None for peers, single precision and scenes that take a loop of their own.
    """

    part: str
    quantity: str
    method: str
    tolerance: float | None
    what: str
    precision: str
    scenes: int
    device: str
    compile_s: float
    time_us: float
    memory_kib: float
    error: float
    success: float
    of_peak: float | None = None


@dataclass(frozen=True)
class Effort:
    """How much is measured.

    Args:
        tolerances: of those of a quantity.
        batches: scenes that run together.
        seconds: for the repetitions of one figure.
        gradients: tolerances for which derivatives are measured.
        single: tolerances for which single precision is.
    """

    tolerances: tuple[float, ...] = (1e-3, 1e-6, 1e-9)
    batches: tuple[int, ...] = (100,)
    seconds: float = 0.3
    gradients: tuple[float, ...] = (1e-6,)
    single: tuple[float, ...] = ()


FULL = Effort((1e-3, 1e-6, 1e-9, 1e-12), (1, 100, 1000), 2.0, (1e-6, 1e-9), (1e-3, 1e-5))

Machines = Sequence[tuple[jax.Device, Peak]]
"""Devices to compute on, and what each can do."""

_MOST_HEAVY = 10
"""Scenes in a batch of what runs one after the other anyway."""


def rows(quantity: Quantity, effort: Effort, machines: Machines) -> Iterator[Row]:
    """Ours on each device, and its peers, side by side."""
    checked = quantity.geometry(_CHECKED)
    reference = quantity.reference(checked)
    for device, peak in machines:
        with jax.default_device(device):
            yield from _ours(quantity, effort, peak, checked, reference)
    for peer in quantity.peers:
        yield _peer(quantity, peer, checked, reference)


def _ours(quantity: Quantity, effort: Effort, peak: Peak, checked: Real, reference: Real) -> Iterator[Row]:
    batches = effort.batches
    if quantity.together == 1:
        batches = tuple(dict.fromkeys(min(batch, _MOST_HEAVY) for batch in batches))
    kept = [t for t in quantity.tolerances if t in effort.tolerances or quantity.exact_sum]
    for tolerance in kept:
        for batch in batches:
            yield _value(quantity, tolerance, batch, effort, peak, checked, reference)
    for tolerance in effort.single:
        if not quantity.exact_sum:
            yield _value(quantity, tolerance, max(batches), effort, None, checked, reference)
    for tolerance in effort.gradients if quantity.gradient else ():
        yield _gradient(quantity, tolerance, max(batches), effort, peak, checked)
        if quantity.exact_sum:
            break


def _value(
    quantity: Quantity,
    tolerance: float,
    batch: int,
    effort: Effort,
    peak: Peak | None,
    checked: Real,
    reference: Real,
) -> Row:
    """In single precision without a peak, which is that of double precision."""
    exact, precision = quantity.exact_sum, "float32" if peak is None else "float64"
    with jax.enable_x64(precision == "float64"):
        optical = jnp.asarray(quantity.optical)
        spectrum = quantity.ours(tolerance)
        function = _batched(lambda value: spectrum(value, optical), batch, quantity.together)
        values = jnp.asarray(np.resize(checked, batch))
        program, compile_s = compiled(function, values)
        seconds = median_time(lambda: program(values), effort.seconds, 50) / batch
        padded = np.resize(checked, (-(-len(checked) // batch), batch))
        parts = [np.asarray(program(jnp.asarray(part)), np.float64) for part in padded]
        found = np.concatenate(parts)[: len(checked)]
    errors = np.abs(found - reference).max(axis=1)
    rounding = 1e-12 if precision == "float64" else 1e-5
    allowed = rounding if exact else max(tolerance, 0 if precision == "float64" else rounding)
    return Row(
        quantity.part,
        quantity.name,
        "vcavity",
        None if exact else tolerance,
        "value",
        precision,
        batch,
        _device(),
        compile_s,
        1e6 * seconds,
        _memory(program),
        float(np.nanmax(errors)),
        float(np.mean(errors <= allowed)),
        _of_peak(peak, program, batch, quantity.together, seconds),
    )


def _gradient(quantity: Quantity, tolerance: float, batch: int, effort: Effort, peak: Peak, checked: Real) -> Row:
    """A misfit with its derivatives by geometry and optical data; their error against Richardson differences."""
    exact = quantity.exact_sum
    complex_valued = np.iscomplexobj(quantity.optical)
    data = quantity.optical
    parts = tuple(jnp.asarray(p) for p in ((data.real, data.imag) if complex_valued else (data,)))
    spectrum = quantity.ours(tolerance)

    def misfit(value: Array, optical: tuple[Array, ...]) -> Array:
        whole = jax.lax.complex(*optical) if complex_valued else optical[0]
        return jnp.sum((spectrum(value, whole) - 0.5) ** 2)

    def both(value: Array) -> Any:
        return jax.value_and_grad(misfit, argnums=(0, 1))(value, parts)

    values = jnp.asarray(np.resize(checked, batch))
    program, compile_s = compiled(_batched(both, batch, quantity.together), values)
    seconds = median_time(lambda: program(values), effort.seconds, 50) / batch
    few = checked[: min(10, batch)]
    fine, optical = quantity.ours(quantity.finest), jnp.asarray(data)
    plain = jax.jit(lambda these: jax.lax.map(lambda x: jnp.sum((fine(x, optical) - 0.5) ** 2), these))
    h = 1e-4 * few
    near, far = ((plain(jnp.asarray(few + k * h)) - plain(jnp.asarray(few - k * h))) / (2 * k * h) for k in (1, 2))
    slopes = np.asarray((4 * near - far) / 3)
    both_found = program(values)
    found = np.asarray(both_found[1][0])[: len(few)]
    errors = np.abs(found - slopes) / (1 + np.abs(slopes))
    finite = all(bool(np.isfinite(np.asarray(leaf)).all()) for leaf in jax.tree.leaves(both_found))
    return Row(
        quantity.part,
        quantity.name,
        "vcavity",
        None if exact else tolerance,
        "gradient",
        "float64",
        batch,
        _device(),
        compile_s,
        1e6 * seconds,
        _memory(program),
        float(np.median(errors)),  # A difference across a kink is no derivative.
        float(finite),
        _of_peak(peak, program, batch, quantity.together, seconds),
    )


def _peer(quantity: Quantity, peer: Peer, checked: Real, reference: Real) -> Row:
    used = checked[: 10 if peer.random else 20]
    times, found = [], []
    for value in used:
        start = time.perf_counter()
        found.append(peer.run(float(value)))
        times.append(time.perf_counter() - start)
    tracemalloc.start()
    peer.run(float(used[0]))
    memory = tracemalloc.get_traced_memory()[1] / 1024
    tracemalloc.stop()
    errors = np.abs(np.stack(found) - reference[: len(used)])
    error = float(np.sqrt(np.mean(errors**2))) if peer.random else float(errors.max())
    finite = float(np.mean(np.isfinite(np.stack(found)).all(axis=1)))
    return Row(
        quantity.part,
        quantity.name,
        peer.name,
        None,
        "value",
        "float64",
        1,
        "cpu",
        0.0,
        1e6 * statistics.median(times),
        memory,
        error,
        finite,
    )


def _batched(function: Callable[[Array], Any], batch: int, together: int) -> Callable[[Array], Any]:
    if batch == 1:
        return lambda values: jax.tree.map(lambda leaf: leaf[None], function(values[0]))
    # One by one without vmap, which makes loops over directions slower.
    batch_size = None if together == 1 else min(batch, together)
    return lambda values: jax.lax.map(function, values, batch_size=batch_size)


def _of_peak(peak: Peak | None, program: Any, batch: int, together: int, seconds: float) -> float | None:
    """None where each scene loops over directions or grooves: XLA counts one pass of such a loop, or some."""
    if peak is None or together == 1:
        return None
    return peak.fraction(program, _counted(batch, together), seconds)


def _counted(batch: int, together: int) -> int:
    """Scenes whose work XLA counts: of groups that run in a loop, one; and the rest."""
    return batch if batch <= together else together + batch % together


def _device() -> str:
    """The kind that computes now: "cpu" or "gpu"."""
    return next(iter(jnp.zeros(()).devices())).platform


def _memory(program: Any) -> float:
    """KiB of temporaries, as the compiler plans them."""
    try:
        return float(program.memory_analysis().temp_size_in_bytes) / 1024
    except (AttributeError, NotImplementedError, RuntimeError):
        return float("nan")
