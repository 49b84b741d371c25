"""How often intervals hold the truth: standard errors, profile likelihood and posterior, at 68 and 95 %.

    python examples/coverage_of_intervals.py [--replicates 400] [--cases all] [--seed 1]

prints a table: synthetic measurements with a noise of 0.005 are fitted and sampled again and again. A rate that
differs from its promise by more than chance allows, once in a thousand, is marked with a star. A fit without a
standard error has no interval of that kind; how many have one is said in the last column.
"""

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from scipy.stats import binom

jax.config.update("jax_enable_x64", True)

import vcavity_jax as vc  # noqa: E402
from fitting import FitResult, Measurement, Posterior, SpectralEstimate, fit, free, sample_posterior  # noqa: E402
from fitting.intervals import Profile, pieces_within  # noqa: E402

NM = np.array([450.0, 500.0, 550.0, 600.0, 650.0])
RED = np.array([0.08, 0.12, 0.3, 0.55, 0.7])
PLACE = 3  # of the wavelength whose reflectance is counted
SIGMA, DRAWS = 0.005, 1000
LEVELS = {0.68: (1.0, 0.15865525), 0.95: (3.841459, 0.025)}
"""Of each: rise of chi-square at the ends of the interval, and share of the posterior below the lower one."""

QUICK = ["gold, 63°", "gold, kink at 90° from the front", "orange, 60°, unknown"]
"""Cases that are run if none is named."""

KINDS = ("standard error", "profile", "posterior")
FRONTAL, FAN = (0.0,), (0.0, 25.0, 50.0, 75.0)


@dataclass(frozen=True)
class Case:
    """A truth, and what is fitted.

    Args:
        surface: the true one.
        material: the true one.
        polar_deg: of the views, across the grooves.
        parameters: free ones.
        of: names of those whose intervals are counted; of a spectrum at 600 nm.
    """

    surface: Any
    material: Any
    polar_deg: tuple[float, ...]
    parameters: tuple[Any, ...]
    of: tuple[str, ...]


def cases() -> dict[str, Case]:
    """Easy ones, kinks, and the edge of what the data determine."""
    mirror = vc.Specular(vc.materials.refractive_index("Au-Johnson", NM))
    matte = vc.Lambertian(RED)
    angle, unknown = (free.angle(30, 170),), (free.angle(30, 170), free.reflectance())
    bench = (free.angle(30, 170), free.gain((1.0, 0.02)), free.offset())
    rough = (free.roughness(0.02, 2.0),)

    def grooves(degrees: float) -> vc.VGrooves:
        return vc.VGrooves(np.radians(degrees))

    return {
        "gold, 63°": Case(grooves(63), mirror, FAN, angle, ("angle",)),
        "gold, 63°, gain and offset": Case(grooves(63), mirror, FAN, bench, ("angle",)),
        "gold, kink at 90° from the front": Case(grooves(90), mirror, FRONTAL, angle, ("angle",)),
        "gold, kink at 90°": Case(grooves(90), mirror, FAN, angle, ("angle",)),
        "orange, 60°": Case(grooves(60), matte, FAN, angle, ("angle",)),
        "orange, 60°, unknown": Case(grooves(60), matte, FAN, unknown, ("angle", "reflectance")),
        "orange, 140°, unknown": Case(grooves(140), matte, FAN, unknown, ("angle", "reflectance")),
        "gold, roughness 0.3": Case(vc.BeckmannGrooves(0.3), mirror, FAN, rough, ("roughness",)),
        "gold, roughness 0.05": Case(vc.BeckmannGrooves(0.05), mirror, FAN, rough, ("roughness",)),
    }


def holds(pieces: list[tuple[float, float]], truth: float) -> bool:
    """Whether an interval in pieces holds the truth."""
    return any(low <= truth <= high for low, high in pieces)


def intervals(result: FitResult, posterior: Posterior, name: str) -> Iterator[tuple[str, float, Any]]:
    """All intervals of a parameter with their kinds and levels; None for one that does not exist."""
    estimate = result.estimates[name]
    value, error, drawn = estimate.value, estimate.standard_error, posterior.samples[name]
    if isinstance(estimate, SpectralEstimate):
        value, error, drawn = value[PLACE], error[PLACE], drawn[:, PLACE]
        table = result.profile(name, wavelength_nm=NM[PLACE])
    else:
        slot, found = result.numbers.index(name), result.found
        profile = Profile(result.problem, slot, found.table, found.minima)
    for level, (rise, share) in LEVELS.items():
        reach = np.sqrt(rise) * error
        yield "standard error", level, [(value - reach, value + reach)] if np.isfinite(error) else None
        if isinstance(estimate, SpectralEstimate):
            yield "profile", level, pieces_within(table.values, table.chi_square - table.minimum, rise)[0]
        else:
            yield "profile", level, profile.region(result.chi_square, rise)[0]
        low, high = np.quantile(drawn, [share, 1 - share])
        yield "posterior", level, [(float(low), float(high))]


def truth_of(case: Case, name: str) -> float:
    """The true value."""
    if name == "reflectance":
        return float(RED[PLACE])
    return float(case.surface.angle if name == "angle" else case.surface.roughness)


def replicate(case: Case) -> Callable[[np.random.Generator], FitResult]:
    """A function that measures the truth with noise and fits it."""
    polar = np.radians(case.polar_deg)
    scene = vc.Scene(case.surface, case.material, vc.Diffuse(), vc.View(polar, 0 * polar))
    clean = np.asarray(vc.reflectance_factor(scene))

    def once(random: np.random.Generator) -> FitResult:
        values = clean + SIGMA * random.standard_normal(clean.shape)
        measured = Measurement(NM, polar, 0 * polar, values, np.full(clean.shape, SIGMA))
        return fit(scene, measured, list(case.parameters), tolerance=1e-6)

    return once


def counted(case: Case, replicates: int, seed: int) -> dict[tuple[str, str, float], tuple[int, int]]:
    """How often the truth was held, of how many intervals, by parameter, kind and level."""
    measured_and_fitted, random = replicate(case), np.random.default_rng(seed)
    found = {(name, kind, level): (0, 0) for name in case.of for kind in KINDS for level in LEVELS}
    for _ in range(replicates):
        result = measured_and_fitted(random)
        posterior = sample_posterior(result, draws=DRAWS)
        for name in case.of:
            for kind, level, pieces in intervals(result, posterior, name):
                hits, total = found[name, kind, level]
                if pieces is not None:
                    hit = holds(pieces, truth_of(case, name))
                    found[name, kind, level] = hits + hit, total + 1
    return found


def within_chance(hits: int, total: int, level: float, odds: float = 1e-3) -> bool:
    """Whether a count is between the exact binomial limits of its promise."""
    return bool(binom.ppf(odds / 2, total, level) <= hits <= binom.ppf(1 - odds / 2, total, level))


def main() -> None:
    """Count and print."""
    known = cases()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("outdir", nargs="?", help="not used: nothing is drawn")
    parser.add_argument("--replicates", type=int, default=20)
    parser.add_argument("--cases", nargs="+", choices=[*known, "all"], default=QUICK, metavar="CASE")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    head = "".join(f"{f'{kind} {level:.0%}':>20}" for kind in KINDS for level in LEVELS)
    print(f"{'case':34}{'of':12}{head}   with a standard error")
    for case_name in known if "all" in given.cases else given.cases:
        start = time.perf_counter()
        found = counted(known[case_name], given.replicates, given.seed)
        for name in known[case_name].of:
            row = ""
            for kind in KINDS:
                for level in LEVELS:
                    hits, total = found[name, kind, level]
                    mark = " " if within_chance(hits, total, level) else "*"
                    row += f"{f'{100 * hits / max(total, 1):.1f} %{mark}':>20}"
            errors = found[name, KINDS[0], 0.95][1]
            print(f"{case_name:34}{name:12}{row}   {errors} of {given.replicates}", flush=True)
        print(f"  {(time.perf_counter() - start) / given.replicates:.2f} s for each replicate", flush=True)


if __name__ == "__main__":
    main()
