"""How often a fit finds the global minimum, without tuning and without a start.

    python examples/search_reliability.py [OUTDIR] [--full] [--rows ROW ...] [--only ROW:INDEX]

draws random samples, each from the seed (row seed, index), makes their spectra with and without noise, fits them
with the default settings, and writes search_reliability.md and .json into OUTDIR (a new temporary folder by
default). --full fits 1000 per row, which takes hours: pick rows. --only shows a single problem in full.

A fit succeeds if its chi-square does not exceed that of the best answer known by more than 0.02 (and 0.5): the
lowest of what fit_many and fit found, of a descent that starts at the truth and, without noise, of the truth
itself, where it is 0. Whether the data determine the parameter is another question: truths are drawn from the
range in which the directions do (for unknown reflectances: up to twice the largest polar angle).
"""

import argparse
import json
import math
import os
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

import vcavity_jax as vc  # noqa: E402
from fitting import Measurement, fit, fit_many, free  # noqa: E402
from fitting.assembly import build  # noqa: E402

WAVELENGTHS = np.linspace(400.0, 700.0, 11)
SIGMA = 0.005
GAIN, OFFSET, INDEX = 0.01, 0.002, 0.03
"""Standard deviations of the priors, and of the truths of noisy problems."""

LIMITS = (0.02, 0.5)
TOLERANCE = 1e-6
TABLES = {"gold": "Au-Johnson", "silicon": "Si-Green-2008", "copper": "Cu-Johnson"}
KNOWN_REFLECTANCE = 0.2 + 0.6 / (1 + np.exp(-(WAVELENGTHS - 550) / 40))
FRONTAL, FAN3, FAN7 = (0.0,), (-75.0, 0.0, 75.0), tuple(np.linspace(-75.0, 75.0, 7))


@dataclass(frozen=True)
class Truth:
    """One random sample and what an instrument says of it, shape (D, L)."""

    value: float
    spectra: np.ndarray
    gain: float
    offset: float
    measured: np.ndarray


@dataclass(frozen=True)
class Row:
    """A kind of problem.

    Args:
        name: for --rows and --only.
        seed: problem i is drawn from the seed (seed, i).
        material: "diffuser", "interfaced" or a metal.
        polar_deg: the views, at azimuth 0, in diffuse light.
        lowest, highest: of the truths: dihedral angles in degrees, or roughness.
        unknown: the reflectance, or n and k, are free at each wavelength.
        instrument: gain and offset are free, with their priors.
        rough: random grooves.
        short: problems and single fits of the default run.
        full: likewise of --full.
    """

    name: str
    seed: int
    material: str
    polar_deg: tuple[float, ...]
    lowest: float
    highest: float
    unknown: bool = False
    instrument: bool = False
    rough: bool = False
    short: tuple[int, int] = (0, 0)
    full: tuple[int, int] = (1000, 100)

    @cached_property
    def known(self) -> np.ndarray:
        """The material's spectra, shape (Q, L): reflectance, or n and k."""
        if self.material in TABLES:
            index = vc.materials.refractive_index(TABLES[self.material], WAVELENGTHS)
            return np.stack([np.real(index), np.imag(index)])
        return KNOWN_REFLECTANCE[None]

    def scene(self, value: Any, spectra: Any) -> vc.Scene:
        """The sample; a groove's angle in radians."""
        if self.material in TABLES:
            material = vc.Specular(spectra[0] + 1j * spectra[1])
        elif self.material == "interfaced":
            material = vc.InterfacedLambertian(spectra[0], 1.5)
        else:
            material = vc.Lambertian(spectra[0])
        surface = vc.BeckmannGrooves(value) if self.rough else vc.VGrooves(value)
        return vc.Scene(surface, material, vc.Diffuse(), vc.View(np.radians(self.polar_deg)))

    @property
    def parameters(self) -> list[Any]:
        """What is fitted, all with the default ranges."""
        found: list[Any] = [free.roughness() if self.rough else free.angle()]
        if self.unknown and self.material in TABLES:
            found.append(free.index_spectrum(complex_valued=True, prior=INDEX))
        elif self.unknown:
            found.append(free.reflectance())
        return found + ([free.gain((1.0, GAIN)), free.offset((0.0, OFFSET))] if self.instrument else [])

    @cached_property
    def model(self) -> Any:
        """Compiled: true reflectance factors."""
        low = None if self.rough else math.radians(self.lowest) * 0.999

        def factors(value: Any, spectra: Any) -> Any:
            return vc.reflectance_factor(self.scene(value, spectra), TOLERANCE / 100, smallest_angle=low)

        return jax.jit(factors)

    def truth(self, index: int, noisy: bool) -> Truth:
        """Problem ``index``. Without noise the material, gain and offset are what their priors expect."""
        rng = np.random.default_rng([self.seed, index])
        share, noise = rng.uniform(), SIGMA * rng.normal(size=(len(self.polar_deg), len(WAVELENGTHS)))
        ends, place, width = rng.uniform(0.03, 0.95, 2), rng.uniform(400, 700), rng.uniform(10, 60)
        instrument, deviation = rng.normal(size=2), rng.normal(size=(2, len(WAVELENGTHS)))
        spectra = self.known
        if self.unknown and self.material in TABLES:
            spectra = self.known + noisy * INDEX * np.hypot(*self.known) * deviation
        elif self.unknown:
            spectra = (ends[0] + np.diff(ends) / (1 + np.exp(-(WAVELENGTHS - place) / width)))[None]
        if self.rough:
            value = self.lowest * (self.highest / self.lowest) ** share
        else:
            value = math.radians(self.lowest + (self.highest - self.lowest) * share)
        gain, offset = (noisy * self.instrument * instrument * (GAIN, OFFSET)).tolist()
        factors = np.asarray(self.model(value, spectra)).reshape(noise.shape)
        return Truth(value, spectra, 1 + gain, offset, (1 + gain) * factors + offset + noisy * noise)

    def measurement(self, values: np.ndarray) -> Measurement:
        """What ``fit`` is given."""
        polar = np.radians(self.polar_deg)
        return Measurement(WAVELENGTHS, polar, np.zeros_like(polar), values, np.full(values.shape, SIGMA))

    def shown(self, value: Any) -> Any:
        """Degrees, or roughness."""
        return value if self.rough else np.degrees(value)


def pair(name: str, seed: int, *arguments: Any, **options: Any) -> tuple[Row, Row]:
    """A row, and the same with gain and offset free."""
    short = options.pop("short", (0, 0))
    return (
        Row(name, seed, *arguments, short=short, **options),
        Row(f"{name}-instrument", seed + 1, *arguments, instrument=True, **options),
    )


ROWS = (
    *pair("diffuser", 100, "diffuser", FAN3, 10, 175, short=(100, 2)),
    *pair("gold", 110, "gold", FAN3, 10, 175, short=(100, 2)),
    *pair("gold-fan7", 120, "gold", FAN7, 10, 175),
    *pair("silicon", 130, "silicon", FAN3, 10, 175),
    *pair("copper", 140, "copper", FAN3, 10, 175),
    Row("diffuser-frontal", 150, "diffuser", FRONTAL, 10, 175),
    Row("gold-frontal", 151, "gold", FRONTAL, 10, 120),
    Row("silicon-frontal", 152, "silicon", FRONTAL, 10, 120),
    *pair("diffuser-unknown", 200, "diffuser", FAN7, 10, 145, unknown=True, short=(10, 0)),
    *pair("gold-unknown", 210, "gold", FAN7, 10, 175, unknown=True),
    *pair("interfaced", 300, "interfaced", FAN3, 10, 175),
    *pair("interfaced-unknown", 310, "interfaced", FAN7, 10, 175, unknown=True, full=(1000, 20)),
    *pair("rough-diffuser", 400, "diffuser", FAN7, 0.02, 3, rough=True),
    *pair("rough-gold", 410, "gold", FAN3, 0.02, 3, rough=True),
)


def from_truth(row: Row, truths: list[Truth]) -> np.ndarray:
    """Chi-square where a descent from each truth ends, shape (N,)."""
    typical = row.measurement(np.full(truths[0].measured.shape, 0.5))
    problem = build(row.scene(1.0, row.known), typical, row.parameters, None, TOLERANCE)
    own = np.array([[t.value, t.gain, t.offset][: len(problem.numbers)] for t in truths])
    every = np.array([t.measured for t in truths])
    free_ones = [t.spectra[: len(problem.free_names)] for t in truths]
    spectra = np.reshape(free_ones, (len(truths), *problem.starts.shape[1:]))

    def measured(starts: np.ndarray) -> Any:
        values = every[starts]
        return problem.data._replace(
            values=(values,), weights=(np.full(values.shape, 1 / SIGMA),), means=(values.mean(axis=2),)
        )

    chi_square = problem.descend(own, spectra, measured=measured).chi_square
    return np.where(np.isfinite(chi_square), chi_square, np.inf)


@dataclass
class Tally:
    """What came of one row, with or without noise."""

    row: Row
    noisy: bool
    truths: list[Truth]
    many: Any
    chi_square: np.ndarray
    best: np.ndarray
    seconds: float
    single: dict[int, Any] = field(default_factory=dict)
    single_seconds: float = math.nan

    def excess(self) -> np.ndarray:
        """Of fit_many."""
        return self.chi_square - self.best

    def single_excess(self) -> np.ndarray:
        """Of fit."""
        return np.array([r.chi_square - self.best[i] for i, r in self.single.items()])

    def failures(self) -> list[dict[str, Any]]:
        """All that missed the smaller limit."""
        name = self.row.parameters[0].name
        where = [
            ("fit_many", i, self.excess()[i], self.many.values[name][i], self.many.status[i])
            for i in range(len(self.truths))
        ] + [
            ("fit", i, r.chi_square - self.best[i], r.estimates[name].value, r.status)
            for i, r in self.single.items()
        ]
        return [
            {
                "problem": f"{self.row.name}:{i}",
                "noise": self.noisy,
                "by": by,
                "excess": float(excess),
                "truth": float(self.row.shown(self.truths[i].value)),
                "found": float(self.row.shown(found)),
                "status": str(status),
            }
            for by, i, excess, found, status in where
            if not excess <= LIMITS[0]
        ]


def measure(row: Row, indices: list[int], singles: int, noisy: bool) -> Tally:
    """Fits of some problems of a row; the first ones also by ``fit``."""
    truths = [row.truth(i, noisy) for i in indices]
    spectra, scene = np.array([t.measured for t in truths]), row.scene(1.0, row.known)
    start = time.perf_counter()
    many = fit_many(scene, row.measurement(spectra[0]), row.parameters, spectra=spectra, tolerance=TOLERANCE)
    seconds = time.perf_counter() - start
    chi_square = np.where(np.isfinite(many.chi_square), many.chi_square, np.inf)
    best = np.minimum(chi_square, from_truth(row, truths))
    best = best if noisy else np.minimum(best, 0.0)
    tally = Tally(row, noisy, truths, many, chi_square, best, seconds)
    start = time.perf_counter()
    for i in range(min(singles, len(truths))):
        tally.single[i] = fit(scene, row.measurement(spectra[i]), row.parameters)
        best[i] = min(best[i], tally.single[i].chi_square)
    tally.single_seconds = time.perf_counter() - start
    return tally


def counted(excess: np.ndarray) -> str:
    """Successes at both limits."""
    return " / ".join(f"{np.sum(excess <= limit)}" for limit in LIMITS) if len(excess) else "-"


def line(tally: Tally) -> str:
    """One line of the table."""
    row, unit = tally.row, "" if tally.row.rough else "°"
    statuses = Counter(str(s) for s in tally.many.status)
    words = ", ".join(f"{n} {word}" for word, n in statuses.most_common())
    cells = [
        row.name,
        str(row.seed),
        f"{row.lowest:g} to {row.highest:g}{unit}",
        f"{len(row.polar_deg)}",
        "yes" if tally.noisy else "no",
        f"{len(tally.truths)}",
        counted(tally.excess()),
        words,
        f"{tally.seconds:.0f}",
        f"{len(tally.single)}",
        counted(tally.single_excess()),
        f"{tally.single_seconds:.0f}" if tally.single else "-",
    ]
    return f"| {' | '.join(cells)} |"


HEAD = (
    "| row | seed | truths | views | noise | fits | fit_many at 0.02 / 0.5 | statuses | s | fits |"
    " fit at 0.02 / 0.5 | s |\n|---|---|---|---|---|---|---|---|---|---|---|---|"
)


def show(row: Row, index: int) -> None:
    """One problem in full."""
    name = row.parameters[0].name
    for noisy in (False, True):
        tally = measure(row, [index], 1, noisy)
        result, truth, many = tally.single[0], tally.truths[0], tally.many
        print(f"{row.name}:{index}, {'noisy' if noisy else 'noiseless'}: {name} {row.shown(truth.value):.6f}")
        print(f"best answer known: {tally.best[0]:.6g}; from the truth {from_truth(row, [truth])[0]:.6g}")
        found = row.shown(many.values[name][0])
        print(f"fit_many: {found:.6f}, chi-square {many.chi_square[0]:.6g}, {many.status[0]}")
        print(f"fit:\n{result.summary()}\n")


def main() -> None:
    names = [row.name for row in ROWS]
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("outdir", nargs="?", type=Path, help="where to write; by default a new temporary folder")
    parser.add_argument("--full", action="store_true", help="1000 problems of every row, hours instead of seconds")
    parser.add_argument("--rows", nargs="+", choices=names, metavar="ROW", help=f"some of {', '.join(names)}")
    parser.add_argument("--only", metavar="ROW:INDEX", help="show a single problem in full")
    parser.add_argument("--problems", type=int, help="how many of each row")
    parser.add_argument("--fits", type=int, help="how many of them one by one as well")
    options = parser.parse_args()
    if options.only:
        name, index = options.only.split(":")
        show(ROWS[names.index(name)], int(index))
        return
    folder = options.outdir or Path(tempfile.mkdtemp(prefix="vcavity-reliability-"))
    folder.mkdir(parents=True, exist_ok=True)
    lines, failures = [], []
    load = ", ".join(f"{x:.1f}" for x in os.getloadavg()) if hasattr(os, "getloadavg") else "unknown"
    print(f"{os.cpu_count()} CPUs, load average {load}; sigma {SIGMA}, {len(WAVELENGTHS)} wavelengths\n\n{HEAD}")
    for row in ROWS:
        problems, singles = row.full if options.full else row.short
        problems = problems if options.problems is None else options.problems
        singles = singles if options.fits is None else options.fits
        if row.name not in options.rows if options.rows else not problems:
            continue
        for noisy in (False, True):
            tally = measure(row, list(range(max(problems, 1))), singles, noisy)
            lines.append(line(tally))
            failures += tally.failures()
            print(lines[-1], flush=True)
    text = "\n".join([HEAD, *lines]) + "\n"
    if failures:
        text += "\n| failure | noise | by | excess | truth | found | status |\n|---|---|---|---|---|---|---|\n"
    for f in failures:
        text += f"| {f['problem']} | {'yes' if f['noise'] else 'no'} | {f['by']} | {f['excess']:.3g} |"
        text += f" {f['truth']:.4f} | {f['found']:.4f} | {f['status']} |\n"
    (folder / "search_reliability.md").write_text(text, encoding="utf-8")
    (folder / "search_reliability.json").write_text(json.dumps(failures, indent=1), encoding="utf-8")
    print(f"\n{text[text.index(lines[-1]) + len(lines[-1]) + 1 :]}" if failures else "\nno failure")
    print(f"written to {folder}")


if __name__ == "__main__":
    main()
