"""Time of one step of a joint fit of the groove's angle and a whole spectrum: with its structure, and without.

    python examples/arrow_against_dense.py [OUTDIR] [--full]

Each reflectance touches its own wavelength only, so that the Jacobian is an arrow: one full column (the angle)
beside a diagonal. The arrow step pushes the model twice (the angle, and all reflectances at once) and eliminates
the reflectances one by one; the dense step pushes it once for every unknown and solves the normal equations. Both
are compiled, alternate in one process, and give the same step. Then the whole fit, from the search to the
intervals. Matte groove of 60 degrees in diffuse light, seven directions from -75 to 75 degrees. Prints tables;
with an OUTDIR, writes them to arrow_against_dense.txt there.
"""

import argparse
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import vcavity_jax as vc
from fitting import Measurement, fit, free
from fitting.arrow import _arrow_step, linearized
from fitting.assembly import build
from fitting.problem import Problem

jax.config.update("jax_enable_x64", True)

FAN = np.radians(np.linspace(-75, 75, 7))
DAMPING = 1e-3
PARAMETERS = [free.angle(20, 170), free.reflectance()]


def measured(count: int) -> tuple[vc.Scene, Measurement]:
    """A noisy measurement at so many wavelengths, and a scene to begin with."""
    nm = np.linspace(380.0, 730.0, count)
    reflectance = 0.1 + 0.7 / (1 + np.exp((560 - nm) / 20))
    view = vc.View(FAN, np.zeros(len(FAN)))
    truth = vc.Scene(vc.VGrooves(np.radians(60.0)), vc.Lambertian(reflectance), vc.Diffuse(), view)
    values = np.asarray(vc.reflectance_factor(truth)) + 0.005 * np.random.default_rng(count).standard_normal(
        (7, count)
    )
    m = Measurement(nm, FAN, np.zeros(7), values, np.full(values.shape, 0.005))
    return vc.Scene(vc.VGrooves(1.0), vc.Lambertian(np.full(count, 0.5)), vc.Diffuse(), view), m


def steps(problem: Problem) -> tuple[Any, Any]:
    """Both steps as compiled functions of the angle and the reflectances."""
    layout, data = problem.layout, problem.data
    part, free_everywhere = layout.parts[0], jnp.ones((1, layout.blocks), bool)

    def arrow(natural: jax.Array, spectra: jax.Array) -> tuple[jax.Array, jax.Array]:
        matrix, _ = linearized(layout, natural, spectra, data)
        damping = jnp.asarray(DAMPING)
        return _arrow_step(layout, matrix, natural, damping, jnp.ones(1, bool), free_everywhere, data)

    def residual(unknown: jax.Array) -> jax.Array:
        numbers, rows = layout.inputs(part, unknown[:1], unknown[None, 1:])
        predicted = layout.factor(part, numbers, rows, data.known[0])
        return ((predicted - data.values[0]) * data.weights[0]).ravel()

    def dense(natural: jax.Array, spectra: jax.Array) -> tuple[jax.Array, jax.Array]:
        unknown = jnp.concatenate([natural, spectra[0]])
        jacobian = jax.jacfwd(residual)(unknown)
        square = jacobian.T @ jacobian
        damped = square + DAMPING * jnp.diag(jnp.diagonal(square))
        step = -jnp.linalg.solve(damped, jacobian.T @ residual(unknown))
        return step[:1], step[None, 1:]

    return jax.jit(arrow), jax.jit(dense)


def seconds(function: Any, *arguments: Any) -> float:
    """One call."""
    start = time.perf_counter()
    jax.block_until_ready(function(*arguments))
    return time.perf_counter() - start


def main() -> None:
    """Time and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("outdir", nargs="?", type=Path, help="where to write")
    parser.add_argument("--full", action="store_true", help="up to a thousand wavelengths")
    given = parser.parse_args()
    lines = [f"{'wavelengths':>11s}  {'arrow, ms':>9s}  {'dense, ms':>9s}  {'ratio':>6s}  {'difference':>10s}"]
    for count in (36, 150, 400, 1000) if given.full else (36, 150):
        scene, measurement = measured(count)
        problem = build(scene, measurement, PARAMETERS, None, 1e-8)
        start = jnp.asarray([np.radians(57.0)]), jnp.asarray(problem.starts[0])
        arrow, dense = steps(problem)
        found = [jax.block_until_ready(f(*start)) for f in (arrow, dense)]
        difference = max(float(jnp.abs(a - b).max()) for a, b in zip(*found, strict=True))
        repeats = max(3, 3000 // count // (1 if count < 100 else 10))
        times = np.array([[seconds(f, *start) for f in (arrow, dense)] for _ in range(repeats)])
        fast, slow = 1e3 * np.median(times, axis=0)
        lines.append(f"{count:11d}  {fast:9.3f}  {slow:9.2f}  {slow / fast:6.0f}  {difference:10.0e}")
    lines += [
        "",
        f"{'wavelengths':>11s}  {'first fit, s':>12s}  {'next, s':>8s}  {'angle':>14s}  {'chi2/dof':>8s}",
    ]
    for count in (36, 1000) if given.full else (36,):
        scene, measurement = measured(count)
        times = []
        for _ in range(2):
            begin = time.perf_counter()
            result = fit(scene, measurement, PARAMETERS)
            times.append(time.perf_counter() - begin)
        angle = result.estimates["angle"]
        value = f"{np.degrees(angle.value):.3f} ± {np.degrees(angle.standard_error):.3f}"
        ratio = result.chi_square / result.degrees_of_freedom
        lines.append(f"{count:11d}  {times[0]:12.1f}  {times[1]:8.2f}  {value:>14s}  {ratio:8.3f}")
    print("\n".join(lines))
    if given.outdir is not None:
        given.outdir.mkdir(parents=True, exist_ok=True)
        (given.outdir / "arrow_against_dense.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
