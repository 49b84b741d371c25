"""Time per spectrum against error, beside the thesis's own recipe, and the price of gradients.

    python examples/speed_against_error.py [OUTDIR] [--full]

writes speed_against_error.md, .json and .png into OUTDIR (a new temporary folder by default) and prints the
table. The default is a short run; --full takes minutes: 1, 100 and 10 000 scenes, tolerances 1e-3 to 1e-12.

A scene is a groove of random angle, 20° to 170°, with a spectrum of 36 wavelengths. The recipe of the thesis
is fitting.bench. It runs scene by scene, its wavelengths vectorized; in the specular model its 100 entry
positions are vectorized too, which is kinder than one ray after the other. Ours is compiled once per batch.
It keeps one core busy; OPENBLAS_NUM_THREADS=1 holds NumPy to one as well.
"""

import argparse
import json
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from jaxtyping import Array

import vcavity_jax as vc
from fitting.bench import thesis_recipe
from fitting.bench.measure import ROUNDING, compiled, describe_machine, median_time

FRONTAL = 0.0, 0.0
SLANTED = np.deg2rad(45.0), 0.0
SHADOWED = np.deg2rad(30.0), 0.0
OBLIQUE = np.deg2rad(35.0), np.deg2rad(30.0)
REFLECTANCES = np.linspace(0.05, 0.95, 36)
WAVELENGTHS, KNOTS = np.linspace(380, 730, 36), (380, 480, 550, 600, 730)
GOLD = np.interp(WAVELENGTHS, KNOTS, (1.6, 1.3, 0.34, 0.22, 0.15)) + 1j * np.interp(
    WAVELENGTHS, KNOTS, (1.9, 1.8, 2.6, 3.1, 4.2)
)

SMALLEST_ANGLE, LARGEST_ANGLE = np.deg2rad(20.0), np.deg2rad(170.0)

TOLERANCE_OF_REFERENCE = 1e-13


FORWARD = "spectrum by angle (forward)"
REVERSE = "misfit by angle (reverse)"
REVERSE_ALL = "misfit by angle and 36 optical data (reverse)"
AIM_TIME, AIM_ERROR, AIM_GRADIENT = 100.0, 1e6, 3.0


@dataclass(frozen=True)
class Case:
    """One geometry, for both sides; light None is diffuse."""

    name: str
    light: tuple[float, float] | None
    view: tuple[float, float]
    specular: bool

    @property
    def chunk(self) -> int:
        """Scenes that run side by side: with more, the states of the specular model leave the caches."""
        return 10 if self.specular else 128

    @property
    def optical(self) -> Array:
        """Reflectances or refractive indices."""
        return jnp.asarray(GOLD if self.specular else REFLECTANCES)

    def ours(self, tolerance: float) -> Callable[[Array, Array], Array]:
        """Spectrum as a function of angle and optical data; what is fixed is built once, and so is known."""
        material = vc.Specular if self.specular else vc.Lambertian
        light = vc.Diffuse() if self.light is None else vc.Directional(*self.light)
        view = vc.View(*self.view)

        def spectrum(angle: Array, optical: Array) -> Array:
            scene = vc.Scene(vc.VGrooves(angle), material(optical), light, view)
            return vc.reflectance_factor(scene, tolerance, smallest_angle=SMALLEST_ANGLE)

        return spectrum

    def thesis(self, angle: float) -> np.ndarray:
        """Spectrum by the thesis's recipe."""
        if self.specular:
            return thesis_recipe.specular(angle, GOLD, self.view)
        return thesis_recipe.lambertian(angle, REFLECTANCES, self.light, self.view)

    def reference(self, angles: np.ndarray) -> np.ndarray:
        """Ours at its finest; for the specular model, which has no tolerance, an independent exact sum."""
        if self.specular:
            exact = partial(thesis_recipe.exact_entries, view=self.view)
            return np.array([thesis_recipe.specular(a, GOLD, self.view, exact(a)) for a in angles])
        evaluate = partial(self.ours(TOLERANCE_OF_REFERENCE), optical=self.optical)
        return np.asarray(jax.jit(partial(jax.lax.map, evaluate, batch_size=self.chunk))(angles))


CASES = (
    Case("diffusing, diffuse light, frontal view", None, FRONTAL, False),
    Case("diffusing, frontal light, frontal view", FRONTAL, FRONTAL, False),
    Case("diffusing, light 45°, view 30°", SLANTED, SHADOWED, False),
    Case("gold, diffuse light, view 35°, 30°", None, OBLIQUE, True),
    Case("gold, diffuse light, frontal view", None, FRONTAL, True),
)


@dataclass(frozen=True)
class Row:
    """One line of the table; times per spectrum, in microseconds; errors absolute, the worst of a run."""

    case: str
    scenes: int
    tolerance: float | None
    compile_s: float
    time_us: float
    error: float
    success: float
    thesis_us: float
    thesis_error: float
    time_ratio: float
    error_ratio: float
    extrapolated: bool


@dataclass(frozen=True)
class GradientRow:
    """Time of a value with its derivative, and of the value alone; per spectrum, in microseconds."""

    case: str
    derivative: str
    scenes: int
    compile_s: float
    value_us: float
    time_us: float
    ratio: float


def over_scenes(function: Callable[[Array], Any], count: int, chunk: int) -> Callable[[Array], Any]:
    """The function for one scene, or for a batch in chunks."""
    if count == 1:
        return lambda angles: jax.tree.map(lambda x: x[None], function(angles[0]))
    return partial(jax.lax.map, function, batch_size=chunk)


def time_thesis(case: Case, angles: np.ndarray) -> tuple[float, np.ndarray]:
    """Seconds per spectrum by the thesis's recipe, the median of three passes, and the spectra."""
    passes = []
    for _ in range(3):
        before = time.perf_counter()
        spectra = np.array([case.thesis(angle) for angle in angles])
        passes.append((time.perf_counter() - before) / len(angles))
    return statistics.median(passes), spectra


def measure(
    case: Case, angles: np.ndarray, counts: list[int], tolerances: list[float], patience: float
) -> Iterator[Row]:
    """Rows of one case. Errors are over the first 100 scenes; a batch of 1 takes them in turn."""
    checked = angles[:100]
    reference = case.reference(checked)
    for tolerance in [TOLERANCE_OF_REFERENCE] if case.specular else tolerances:
        thesis_s, spectra = time_thesis(case, checked)  # next to ours: the load of the machine changes
        thesis_error = float(np.max(np.abs(spectra - reference)))
        evaluate = partial(case.ours(tolerance), optical=case.optical)
        per_scene = 0.0
        for count in counts:
            batch = jnp.asarray(angles[:count])
            extrapolated = count * per_scene > patience
            if not extrapolated:
                program, compile_s = compiled(over_scenes(evaluate, count, case.chunk), batch)
                per_scene = median_time(lambda: program(batch), patience / 10) / count  # noqa: B023
                if count == 1:
                    values = np.concatenate([program(jnp.asarray([angle])) for angle in checked])
                else:
                    values = np.asarray(program(batch))
                finite = np.isfinite(values).all()
                errors = np.max(np.abs(values[: len(checked)] - reference[: len(values)]), axis=1)
                error, success = float(np.max(errors)), float(np.mean(errors <= tolerance)) * bool(finite)
            shown = None if case.specular else tolerance
            times = compile_s, per_scene * 1e6, error, success, thesis_s * 1e6, thesis_error
            ratios = thesis_s / per_scene, thesis_error / max(error, ROUNDING)
            yield Row(case.name, count, shown, *times, *ratios, extrapolated)


def measure_gradients(
    case: Case, angles: np.ndarray, tolerance: float, patience: float, kinds: Sequence[str]
) -> Iterator[GradientRow]:
    """Rows of one case: forward mode for the spectrum, reverse mode for a sum of squares."""
    spectrum = case.ours(tolerance)

    def misfit(angle: Array, optical: Array) -> Array:
        return jnp.sum((spectrum(angle, optical) - 0.5) ** 2)

    def forward(angle: Array, optical: Array) -> tuple[Array, Array]:
        return jax.jvp(lambda a: spectrum(a, optical), (angle,), (jnp.ones_like(angle),))

    functions = {
        "value": misfit,
        FORWARD: forward,
        REVERSE: jax.value_and_grad(misfit),
        REVERSE_ALL: jax.value_and_grad(misfit, argnums=(0, 1)),
    }
    value_s = 0.0
    for name in ("value", *kinds):
        batch, optical = jnp.asarray(angles), case.optical
        vectorized = over_scenes(lambda a, f=functions[name]: f(a, optical), len(batch), case.chunk)  # noqa: B023
        program, compile_s = compiled(vectorized, batch)
        seconds = median_time(lambda: program(batch), patience / 10) / len(batch)  # noqa: B023
        if name == "value":
            value_s = seconds
        else:
            times = compile_s, value_s * 1e6, seconds * 1e6, seconds / value_s
            yield GradientRow(case.name, name, len(batch), *times)


def markdown(rows: list[Row], gradients: list[GradientRow], machine: dict[str, str]) -> str:
    """The tables as the README quotes them."""
    lines = [f"- {name}: {value}" for name, value in machine.items()]
    lines += [
        "",
        "Times are per spectrum of 36 wavelengths, medians, without compilation; errors are the largest",
        "absolute ones over 100 scenes. The thesis's recipe is timed on those scenes one by one; its time",
        "for 10 000 is extrapolated from them. ~ marks a time of ours extrapolated from a smaller batch.",
        "",
        "| case | scenes | tolerance | compile, s | ours, µs | error | within tolerance |"
        " thesis, µs | its error | faster by | closer by | aim reached |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for r in rows:
        missed = ["time"] * (r.time_ratio < AIM_TIME) + ["error"] * (r.error_ratio < AIM_ERROR)
        aim = f"no: {', '.join(missed)}" if missed else "yes"
        tolerance = "exact" if r.tolerance is None else f"{r.tolerance:.0e}"
        compiling, mark = ("-", "~") if r.extrapolated else (f"{r.compile_s:.1f}", "")
        lines.append(
            f"| {r.case} | {r.scenes} | {tolerance} | {compiling} | {mark}{r.time_us:.3g} | {r.error:.1e} |"
            f" {r.success:.0%} | {r.thesis_us:.0f} | {r.thesis_error:.1e} | {r.time_ratio:.3g} |"
            f" {r.error_ratio:.1e} | {aim} |"
        )
    lines += [
        "",
        "| case | derivative | scenes | compile, s | value, µs | with derivative, µs | ratio | at most 3 |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for g in gradients:
        lines.append(
            f"| {g.case} | {g.derivative} | {g.scenes} | {g.compile_s:.1f} | {g.value_us:.3g} |"
            f" {g.time_us:.3g} | {g.ratio:.2f} | {'yes' if g.ratio <= AIM_GRADIENT else 'no'} |"
        )
    return "\n".join(lines) + "\n"


def draw(rows: list[Row], path: Path) -> None:
    """Error against time per spectrum, one panel per case; down and left is better."""
    names = list(dict.fromkeys(r.case for r in rows))
    figure, axes = plt.subplots(1, len(names), figsize=(3.1 * len(names), 3.4), sharex=True, sharey=True)
    for axis, name in zip(np.atleast_1d(axes), names, strict=True):
        mine = [r for r in rows if r.case == name]
        for count, marker in zip(sorted({r.scenes for r in mine}), "osD", strict=False):
            line = [r for r in mine if r.scenes == count]
            label = f"vcavity, {count} scene{'s' if count > 1 else ''}"
            axis.loglog(
                [r.time_us for r in line],
                [max(r.error, ROUNDING) for r in line],
                marker=marker,
                label=label,
                ms=5,
            )
        axis.loglog(mine[0].thesis_us, mine[0].thesis_error, "k*", ms=11, label="thesis's recipe")
        corner = mine[0].thesis_us / AIM_TIME, mine[0].thesis_error / AIM_ERROR
        axis.plot([1e-2, corner[0], corner[0]], [corner[1], corner[1], 1e-18], color="0.6", lw=1, label="aim")
        axis.set_title(name, fontsize=8)
        axis.grid(alpha=0.3)
        axis.set_xlabel("time per spectrum, µs")
    axes[0].set_ylabel("largest error")
    axes[0].set_ylim(1e-17, 1)
    axes[0].set_xlim(1, 1e5)
    axes[0].legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("outdir", nargs="?", type=Path, help="where to write; by default a new temporary folder")
    parser.add_argument("--full", action="store_true", help="the whole table, minutes instead of seconds")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    mpl.use("Agg")
    folder = options.outdir or Path(tempfile.mkdtemp(prefix="vcavity-speed-"))
    folder.mkdir(parents=True, exist_ok=True)
    full = options.full
    counts = [1, 100, 10_000] if full else [1, 100]
    tolerances = [1e-3, 1e-6, 1e-9, 1e-12] if full else [1e-3, 1e-6, 1e-9]
    patience = 10.0 if full else 0.5
    angles = np.random.default_rng(2020).uniform(SMALLEST_ANGLE, LARGEST_ANGLE, max(counts))
    machine = describe_machine()
    rows: list[Row] = []
    gradients: list[GradientRow] = []
    for case in CASES if full else (CASES[0], *CASES[2:]):
        rows += measure(case, angles, counts, tolerances, patience)
    kinds = (FORWARD, REVERSE, REVERSE_ALL) if full else (REVERSE_ALL,)
    for case in (CASES[0], CASES[2], CASES[3], CASES[4]) if full else (CASES[0], CASES[4]):
        gradients += measure_gradients(case, angles[:50], 1e-9, patience, kinds)
    text = markdown(rows, gradients, machine)
    (folder / "speed_against_error.md").write_text(text)
    record = {
        "machine": machine,
        "rows": [asdict(r) for r in rows],
        "gradients": [asdict(g) for g in gradients],
    }
    (folder / "speed_against_error.json").write_text(json.dumps(record, indent=1))
    draw(rows, folder / "speed_against_error.png")
    print(text)
    print(f"written to {folder}")


if __name__ == "__main__":
    main()
