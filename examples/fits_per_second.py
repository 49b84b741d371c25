"""Fits per second and how good they are, beside what one would use instead: SciPy with finite differences.

    python examples/fits_per_second.py [OUTDIR] [--full]

writes fits_per_second.md and .json into OUTDIR (a new temporary folder by default) and prints the table.

Gold grooves of random angles, seen in diffuse light from six directions at 31 wavelengths, with noise of 0.005;
the gain is known, or free. The rivals are scipy.optimize.least_squares (bounds, 2-point differences) on the
thesis's recipe (fitting.bench) and on our own model, from one start in the middle or the best of several random
ones. All get the same problems in turns. Ours are compiled before the clock starts; fit also draws intervals, and
fit_many makes its table anew in every call. OPENBLAS_NUM_THREADS=1 and taskset keep all to one core.
"""

import argparse
import json
import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np
from scipy.optimize import least_squares

from fitting.bench import thesis_recipe
from fitting.bench.timing import describe_machine

jax.config.update("jax_enable_x64", True)

import vcavity_jax as vc  # noqa: E402
from fitting import Measurement, fit, fit_many, free  # noqa: E402

WAVELENGTHS = np.linspace(400.0, 700.0, 31)
GOLD = np.asarray(vc.materials.refractive_index("Au-Johnson", WAVELENGTHS))
POLAR = np.radians(np.linspace(0.0, 75.0, 6))
SIGMA = 0.005
TRUTHS_DEG = 20.0, 170.0
RANGE = np.radians([5.0, 180.0])
GAINS, GAIN_SPREAD = (0.5, 1.5), 0.03
STARTS = 8
SEED = 2020
AIM_RATIO, LARGEST_ERROR_DEG, LARGEST_DEVIATION = 50.0, 1.0, 4.0

Real = np.ndarray


def scene(angle: Any) -> vc.Scene:
    """A gold groove; its angle in radians."""
    return vc.Scene(vc.VGrooves(angle), vc.Specular(GOLD), vc.Diffuse(), vc.View(POLAR))


@jax.jit
def ours(angle: Any) -> Any:
    """Reflectance factors, shape (D, L)."""
    return vc.reflectance_factor(scene(angle), smallest_angle=float(RANGE[0]))


def recipe(angle: float) -> Real:
    """Likewise, as the thesis computes them."""
    return np.array([thesis_recipe.specular(angle, GOLD, (polar, 0.0)) for polar in POLAR])


@dataclass(frozen=True)
class Problems:
    """Random grooves, what is measured of them, shape (N, D, L), and the smallest standard error of each angle."""

    angles: Real
    spectra: Real
    errors: Real
    gain: bool

    def first(self, count: int) -> "Problems":
        """The first ones."""
        return Problems(self.angles[:count], self.spectra[:count], self.errors[:count], self.gain)

    def measurement(self, index: int) -> Measurement:
        """One of them."""
        values = self.spectra[index]
        return Measurement(WAVELENGTHS, POLAR, np.zeros_like(POLAR), values, np.full(values.shape, SIGMA))

    @property
    def parameters(self) -> list[Any]:
        """What is fitted: the angle in its default range, and the gain without a prior."""
        return [free.angle(), free.gain(None)] if self.gain else [free.angle()]


def problems(count: int, gain: bool) -> Problems:
    """Random problems."""
    rng = np.random.default_rng(SEED)
    angles = np.radians(rng.uniform(*TRUTHS_DEG, count))
    gains = 1 + gain * GAIN_SPREAD * rng.normal(size=(count, 1, 1))
    exact = np.array([ours(angle) for angle in angles])
    slope = jax.jit(jax.jacfwd(ours))
    slopes = gains * np.array([slope(angle) for angle in angles])
    if gain:  # What the gain could explain tells nothing of the angle.
        slopes -= exact * (np.sum(exact * slopes, (1, 2)) / np.sum(exact**2, (1, 2)))[:, None, None]
    errors = SIGMA / np.sqrt(np.sum(slopes**2, (1, 2)))
    return Problems(angles, gains * exact + SIGMA * rng.normal(size=exact.shape), errors, gain)


def scipy_fits(model: Callable[[float], Real], starts: int, given: Problems) -> Real:
    """Angles by scipy.optimize.least_squares: from 90 degrees, or the best of random starts.

    Its default step of the differences serves the recipe best: with larger ones, or a thousandth, it is lost more
    often, because the numbers of reflections at its entry positions jump.
    """
    rng = np.random.default_rng(SEED + 1)
    found = []
    for measured in given.spectra:

        def residuals(x: Real, measured: Real = measured) -> Real:
            return np.ravel((x[1] if given.gain else 1.0) * np.asarray(model(x[0])) - measured) / SIGMA

        bounds = np.array([RANGE, GAINS] if given.gain else [RANGE]).T
        angles = np.radians(rng.uniform(*TRUTHS_DEG, starts)) if starts > 1 else [np.pi / 2 + 0.01]
        ends = [least_squares(residuals, [angle, 1.0][: bounds.shape[1]], bounds=bounds) for angle in angles]
        found.append(min(ends, key=lambda end: end.cost).x[0])
    return np.array(found)


def single_fits(given: Problems) -> Real:
    """Angles by ``fit``, one problem after the other."""
    found = [fit(scene(1.0), given.measurement(i), given.parameters) for i in range(len(given.angles))]
    return np.array([result.estimates["angle"].value for result in found])


def many_fits(given: Problems) -> Real:
    """Angles by ``fit_many``, all at once."""
    return fit_many(scene(1.0), given.measurement(0), given.parameters, spectra=given.spectra).values["angle"]


@dataclass(frozen=True)
class Method:
    """A way to fit; how many problems the default run and --full give to it."""

    name: str
    run: Callable[[Problems], Real]
    short: int
    full: int


RIVAL = "recipe + SciPy, one start"
METHODS = (
    Method(RIVAL, partial(scipy_fits, recipe, 1), 20, 100),
    Method(f"recipe + SciPy, best of {STARTS} starts", partial(scipy_fits, recipe, STARTS), 1, 30),
    Method("our model + SciPy, one start", partial(scipy_fits, ours, 1), 6, 100),
    Method(f"our model + SciPy, best of {STARTS} starts", partial(scipy_fits, ours, STARTS), 6, 100),
    Method("fit, with intervals", single_fits, 3, 100),
    Method("fit_many", many_fits, 1024, 4000),
)


@dataclass(frozen=True)
class Result:
    """One line of the table; errors in degrees. What is shared is of the problems that the rival got, too."""

    method: str
    gain: bool
    fits: int
    first_call_s: float
    per_second: float
    success: float
    within: float
    median_deg: float
    percentile_95_deg: float
    rms_deg: float
    shared_success: float
    shared_rms_deg: float


def measure(gain: bool, full: bool) -> list[Result]:
    """All methods in turns, so that a busy machine is busy for all."""
    every = problems(max(m.full if full else m.short for m in METHODS), gain)
    given = {m.name: every.first(m.full if full else m.short) for m in METHODS}
    first: dict[str, float] = {}
    for method in METHODS:
        before = time.perf_counter()
        method.run(every.first(1))
        first[method.name] = time.perf_counter() - before
    times: dict[str, list[float]] = {m.name: [] for m in METHODS}
    angles: dict[str, Real] = {}
    for _ in range(3):
        for method in METHODS:
            before = time.perf_counter()
            angles[method.name] = method.run(given[method.name])  # NumPy arrays: nothing is left to wait for
            times[method.name].append(time.perf_counter() - before)
    found = []
    for method in METHODS:
        own = given[method.name]
        error = np.abs(angles[method.name] - own.angles)
        error = np.where(np.isfinite(error), error, np.pi)
        near = error <= np.radians(LARGEST_ERROR_DEG)
        degrees = np.degrees(error)
        good = near & (error <= LARGEST_DEVIATION * own.errors)
        shared = slice(len(given[RIVAL].angles))
        found.append(
            Result(
                method.name,
                gain,
                len(own.angles),
                first[method.name],
                len(own.angles) / statistics.median(times[method.name]),
                float(np.mean(good)),
                float(np.mean(near)),
                float(np.median(degrees)),
                float(np.percentile(degrees, 95)),
                float(np.sqrt(np.mean(degrees**2))),
                float(np.mean(good[shared])),
                float(np.sqrt(np.mean(degrees[shared] ** 2))),
            )
        )
    return found


def markdown(results: list[Result], machine: dict[str, str]) -> str:
    """The table and the aim."""
    lines = [f"- {name}: {value}" for name, value in machine.items()]
    lines += [
        "",
        f"Success: within {LARGEST_ERROR_DEG:g}° and within {LARGEST_DEVIATION:g} standard errors of the truth.",
        "Times: medians of three rounds in which all take turns, without compilation.",
        "",
        "| method | gain | fits | first call, s | fits per second | times the rival's | success | within 1° |"
        " median error, ° | 95 % below, ° | rms, ° |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    aims = []
    for r in results:
        rival = next(o for o in results if o.method == RIVAL and o.gain == r.gain)
        ratio = r.per_second / rival.per_second
        lines.append(
            f"| {r.method} | {'free' if r.gain else 'known'} | {r.fits} | {r.first_call_s:.1f} |"
            f" {r.per_second:.3g} | {ratio:.3g} | {r.success:.1%} | {r.within:.1%} | {r.median_deg:.3f} |"
            f" {r.percentile_95_deg:.3f} | {r.rms_deg:.3f} |"
        )
        if r.method == "fit_many":
            as_good = r.shared_rms_deg <= 1.01 * rival.rms_deg and r.shared_success >= rival.success
            reached = ratio >= AIM_RATIO and as_good
            aims.append(
                f"- gain {'free' if r.gain else 'known'}: fit_many makes {ratio:.3g} times as many fits as"
                f" {rival.method}; on its {rival.fits} problems the rms error is {r.shared_rms_deg:.3f}° against"
                f" {rival.rms_deg:.3f}°, success {r.shared_success:.0%} against {rival.success:.0%}; aim"
                f" {AIM_RATIO:g} times at no larger error (+1 %): {'reached' if reached else 'NOT reached'}"
            )
    return "\n".join([*lines, "", *aims]) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("outdir", nargs="?", type=Path, help="where to write; by default a new temporary folder")
    parser.add_argument("--full", action="store_true", help="more fits of each kind, minutes instead of seconds")
    options = parser.parse_args()
    folder = options.outdir or Path(tempfile.mkdtemp(prefix="vcavity-fits-"))
    folder.mkdir(parents=True, exist_ok=True)
    machine = describe_machine()
    results = [r for gain in (False, True) for r in measure(gain, options.full)]
    text = markdown(results, machine)
    (folder / "fits_per_second.md").write_text(text, encoding="utf-8")
    record = {"machine": machine, "results": [asdict(r) for r in results]}
    (folder / "fits_per_second.json").write_text(json.dumps(record, indent=1), encoding="utf-8")
    print(text)
    print(f"written to {folder}")


if __name__ == "__main__":
    main()
