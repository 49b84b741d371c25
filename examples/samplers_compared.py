"""Effective samples per second of every way to sample a posterior, and how far they agree.

    python examples/samplers_compared.py [OUTDIR] [--full]

writes samplers_compared.md into OUTDIR (a new temporary folder by default) and prints it: rendered gold of 45
degrees with free angle, gain and offset, and rendered orange of 60 degrees with free angle and reflectance
(--full: and gain and offset, and by NUTS and importance sampling, too). What one would use instead is emcee's
stretch move on a log density in NumPy: the thesis's recipe (fitting.bench). Its time is that of the log
density, from some hundred calls, times the autocorrelation time of the stretch move, from a long chain with a
compiled model.
"""

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

import emcee
import jax
import jax.numpy as jnp
import numpy as np

from fitting.bench import thesis_recipe
from fitting.bench.timing import describe_machine

jax.config.update("jax_enable_x64", True)

import vcavity_jax as vc  # noqa: E402
from fitting import FitResult, Measurement, fit, free, sample_posterior  # noqa: E402

DATA = Path(__file__).parent / "data"
RANGE = np.radians([5.0, 180.0])
GAIN, OFFSET = (1.0, 0.01), (0.0, 0.002)
WALKERS, LONG, CALLS = 32, 3000, 100
AIM_RATIO, AIM_SECONDS, AIM_SAMPLES = 100.0, 15.0, 1000.0


def gold() -> tuple[vc.Scene, Measurement, list[Any]]:
    """Angle, gain and offset of a mirror."""
    measurement = Measurement.read(DATA / "gold-v45.csv")
    index = vc.materials.refractive_index("Au-Johnson", measurement.wavelengths_nm)
    scene = vc.Scene(vc.VGrooves(1.0), vc.Specular(index), measurement.illumination, measurement.view)
    angle = free.angle(*np.degrees(RANGE))
    return scene, measurement, [angle, free.gain(GAIN), free.offset(OFFSET)]


def orange(more: bool) -> tuple[vc.Scene, Measurement, list[Any]]:
    """Angle and reflectance of a matte sample."""
    measurement = Measurement.read(DATA / "orange-v60.csv")
    start = np.full(len(measurement.wavelengths_nm), 0.5)
    scene = vc.Scene(vc.VGrooves(1.0), vc.Lambertian(start), measurement.illumination, measurement.view)
    parameters: list[Any] = [free.angle(*np.degrees(RANGE)), free.reflectance()]
    return scene, measurement, parameters + ([free.gain(GAIN), free.offset(OFFSET)] if more else [])


def ours(name: str, result: FitResult, methods: tuple[str, ...]) -> list[dict[str, Any]]:
    """Each method twice: the first time it is compiled."""
    rows, exact = [], None
    for method in methods:
        times = []
        for _ in range(2):
            start = time.perf_counter()
            posterior = sample_posterior(result, method)
            times.append(time.perf_counter() - start)
        one = posterior.estimates["angle"]
        exact = exact or one
        rows.append(
            {
                "posterior": name,
                "method": method,
                "first": times[0],
                "again": times[1],
                "effective": one.effective_samples,
                "mean": np.degrees(one.mean),
                "deviation": np.degrees(one.standard_deviation),
                "apart": (one.mean - exact.mean) / exact.standard_deviation,
            }
        )
    return rows


def log_prior(theta: np.ndarray) -> np.ndarray:
    """Of angle, gain and offset, shape (n, 3)."""
    angle, gain, offset = theta.T
    gaussian = ((gain - GAIN[0]) / GAIN[1]) ** 2 + ((offset - OFFSET[0]) / OFFSET[1]) ** 2
    return np.where((angle > RANGE[0]) & (angle < RANGE[1]), -gaussian / 2, -np.inf)


def rival(result: FitResult) -> tuple[float, float, np.ndarray]:
    """Seconds for a log density in NumPy, autocorrelation time of the stretch move, and its draws of the angle."""
    m, index = result.measurement, np.asarray(result.scene.material.index)
    sigma = m.standard_uncertainty
    assert sigma is not None

    def in_numpy(theta: np.ndarray) -> float:
        views = zip(m.polar, m.azimuth, strict=True)
        model = np.array([thesis_recipe.specular(theta[0], index, view) for view in views])
        misfit = (theta[1] * model + theta[2] - m.reflectance_factor) / sigma
        return float(log_prior(theta[None])[0] - np.sum(misfit**2) / 2)

    @jax.jit
    @jax.vmap
    def chi_square(theta: jax.Array) -> jax.Array:
        scene = vc.Scene(vc.VGrooves(theta[0]), result.scene.material, m.illumination, m.view)
        model = vc.reflectance_factor(scene, smallest_angle=float(RANGE[0]))
        return jnp.sum(((theta[1] * model + theta[2] - m.reflectance_factor) / sigma) ** 2)

    def compiled(theta: np.ndarray) -> np.ndarray:
        inside = np.clip(theta[:, 0], *RANGE)[:, None]
        return log_prior(theta) - np.asarray(chi_square(np.concatenate([inside, theta[:, 1:]], axis=1))) / 2

    random = np.random.default_rng(1)
    best = np.array([result.estimates[name].value for name in ("angle", "gain", "offset")])
    start = best + random.standard_normal((WALKERS, 3)) @ np.linalg.cholesky(result.covariance).T
    in_numpy(best)
    begun = time.perf_counter()
    for theta in np.resize(start, (CALLS, 3)):
        in_numpy(theta)
    seconds = (time.perf_counter() - begun) / CALLS
    sampler = emcee.EnsembleSampler(WALKERS, 3, compiled, vectorize=True)
    sampler.random_state = np.random.RandomState(1).get_state()
    sampler.run_mcmc(start, LONG)
    steps = emcee.autocorr.integrated_time(sampler.get_chain(discard=LONG // 10))[0]
    return seconds, float(steps), sampler.get_chain(discard=LONG // 10, flat=True)[:, 0]


def table(rows: list[dict[str, Any]]) -> str:
    """Markdown."""
    head = ("posterior", "method", "first s", "again s", "effective", "per s", "angle °", "± °", "mean, in ±")
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for r in rows:
        lines.append(
            f"| {r['posterior']} | {r['method']} | {r['first']:.2f} | {r['again']:.2f} | {r['effective']:.0f} | "
            f"{r['effective'] / r['again']:.3g} | {r['mean']:.3f} | {r['deviation']:.3f} | {r['apart']:+.2f} |"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("outdir", nargs="?", type=Path)
    parser.add_argument("--full", action="store_true")
    given = parser.parse_args()
    outdir = given.outdir or Path(tempfile.mkdtemp())
    begun = time.perf_counter()
    result = fit(*gold())
    fitted = time.perf_counter() - begun
    name = "gold: angle, gain, offset"
    rows = ours(name, result, ("nested", "importance", "emcee", *(("nuts",) if given.full else ())))
    matte = fit(*orange(False), tolerance=1e-6)
    slow = ("importance",) if given.full else ()
    rows += ours("orange: angle, 31 reflectances", matte, ("nested", *slow))
    if given.full:
        matte = fit(*orange(True), tolerance=1e-6)
        rows += ours("orange: angle, 31 reflectances, gain, offset", matte, ("nested", "importance"))
    seconds, steps, draws = rival(result)
    exact = rows[0]
    needed = AIM_SAMPLES * steps * seconds
    rows.append(
        {
            "posterior": name,
            "method": "emcee, stretch move, NumPy recipe",
            "first": needed,
            "again": needed,
            "effective": AIM_SAMPLES,
            "mean": np.degrees(draws.mean()),
            "deviation": np.degrees(draws.std()),
            "apart": (np.degrees(draws.mean()) - exact["mean"]) / exact["deviation"],
        }
    )
    ratio = exact["effective"] / exact["again"] * needed / AIM_SAMPLES
    machine = "; ".join(f"{key}: {value}" for key, value in describe_machine().items())
    text = "\n".join(
        [
            f"{machine}.",
            "",
            table(rows),
            "",
            f"The recipe's log density takes {1e3 * seconds:.1f} ms, the stretch move {steps:.0f} steps for an "
            f"independent sample. The default sampler has {ratio:.0f} times as many effective samples per second "
            f"(aim {AIM_RATIO:.0f}). {exact['effective']:.0f} of three parameters take {exact['first']:.1f} s "
            f"after a fit of {fitted:.1f} s, compilation included (aim {AIM_SAMPLES:.0f} in {AIM_SECONDS:.0f} s).",
        ]
    )
    outdir.mkdir(parents=True, exist_ok=True)
    (outdir / "samplers_compared.md").write_text(text + "\n", encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
