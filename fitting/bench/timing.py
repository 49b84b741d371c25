"""Timers: compilation apart from running, and the machine that the times depend on."""

import os
import platform
import statistics
import time
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jaxtyping import Array


def compiled(function: Callable[..., Any], *arguments: Array) -> tuple[Any, float]:
    """The program for arguments of these shapes, and the seconds that tracing and compiling it took."""
    start = time.perf_counter()
    program = jax.jit(function).lower(*arguments).compile()
    return program, time.perf_counter() - start


def median_time(run: Callable[[], Any], seconds: float, most: int = 15) -> float:
    """Median duration of at least three calls, and more while there is time."""
    start = time.perf_counter()
    times: list[float] = []
    while len(times) < 3 or (len(times) < most and time.perf_counter() - start < seconds):
        before = time.perf_counter()
        jax.block_until_ready(run())
        times.append(time.perf_counter() - before)
    return statistics.median(times)


def describe_machine() -> dict[str, str]:
    """What the times depend on."""
    load = ", ".join(f"{x:.1f}" for x in os.getloadavg()) if hasattr(os, "getloadavg") else "unknown"
    return {
        "hardware": f"{os.cpu_count()} CPUs, {platform.machine()}, {platform.system()}",
        "load average at the start": load,
        "versions": f"Python {platform.python_version()}, jax {jax.__version__} on {jax.default_backend()}, "
        f"NumPy {np.__version__}",
    }
