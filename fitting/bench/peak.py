"""What the machine can do at best, measured: to say how near to it a program comes."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from fitting.bench.timing import compiled, median_time

_LONG, _STEPS = 1 << 20, 64  # long enough that starting a program does not count


@dataclass(frozen=True)
class Peak:
    """Rates that compiled programs reach when they do nothing else.

    Args:
        operations: additions and multiplications in a second, the better of a chain of them and a matrix product.
        transcendentals: logarithms in a second, summed.
    """

    operations: float
    transcendentals: float

    def fraction(self, program: Any, scenes: int, seconds: float) -> float:
        """The time that a program's arithmetic needs at these rates, over its own.

        XLA counts what a program does; of a loop, one pass. Its count of memory traffic is left aside: it takes
        arrays in full of which a program reads a slice, and cannot tell what a cache holds.

        Args:
            program: compiled.
            scenes: that XLA counts in it.
            seconds: for each.
        """
        counted = program.cost_analysis() or {}
        arithmetic = counted.get("flops", 0.0) / self.operations
        arithmetic += counted.get("transcendentals", 0.0) / self.transcendentals
        return arithmetic / scenes / seconds

    def __str__(self) -> str:
        """For the description of the machine."""
        return (
            f"{self.operations / 1e9:.3g} G additions and multiplications, {self.transcendentals / 1e9:.2g} G "
            "logarithms in a second"
        )


def measure_peak(device: Any = None) -> Peak:
    """In double precision, with as many threads as XLA takes; half a second or so."""

    def chain(x: Any) -> Any:
        for _ in range(_STEPS):
            x = x * 0.999 + 0.001
        return x

    def logarithms(x: Any) -> Any:
        return jnp.log(x).sum(axis=0)

    def rate(function: Callable[[Any], Any], of: float, *shape: int) -> float:
        values = jax.device_put(jnp.linspace(1.0, 2.0, _LONG).reshape(shape), device)
        program, _ = compiled(function, values)
        return of / median_time(lambda: program(values), 0.1, 200)

    side = 512
    return Peak(
        max(
            rate(chain, 2.0 * _STEPS * _LONG, _LONG),
            rate(lambda x: x @ x.T, 2.0 * side * _LONG, side, -1),
        ),
        rate(logarithms, float(_LONG), 16, -1),
    )
