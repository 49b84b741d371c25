"""Hyperspectral cubes of a grooved gold sample and of a grooved print: written as ENVI, read back, fitted.

    python examples/grooved_cubes.py [OUTDIR]

Both cubes are synthetic: computed by the project's own models, in counts of a camera with uneven light, an offset,
noise, a dead element of the detector and a saturated highlight, beside a white and a dark reference. Writes
gold.hdr, print.hdr, their references, the maps (.nc) and figures (.png) into OUTDIR (a new temporary folder by
default), and prints how far the fitted angles are from the true ones.
"""

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import spectral.io.envi as envi

import vcavity_jax as vc
from fitting import free, read_spectrum
from fitting.cubes import CubeResult, fit_cube, open_cube

jax.config.update("jax_enable_x64", True)

DATA = Path(__file__).parent / "data"
WAVELENGTHS_NM = np.arange(400.0, 701.0, 10.0)
LINES, SAMPLES = 60, 90
FULL_SCALE, BRIGHTEST, DARK = 65_535, 40_000.0, 400.0
NOISE = 0.004
DEAD_SAMPLE = 70


def wedge() -> np.ndarray:
    """Gold: the angle falls from 110 to 45 degrees along the lines; a strip of 80 degrees across it."""
    angle = np.broadcast_to(np.linspace(110, 45, SAMPLES), (LINES, SAMPLES)).copy()
    angle[27:33] = 80.0
    return np.radians(angle)


def emblem() -> np.ndarray:
    """A print: a ring of 60 degrees on grooves of 100."""
    line, sample = np.mgrid[:LINES, :SAMPLES]
    radius = np.hypot(line - LINES / 2, sample - SAMPLES / 2)
    return np.radians(np.where((radius > 12) & (radius < 22), 60.0, 100.0))


def factors(scene_at: Callable[[Any], vc.Scene], angle: np.ndarray) -> np.ndarray:
    """Reflectance factors of every pixel; each angle is computed once."""
    distinct, place = np.unique(angle, return_inverse=True)
    narrowest = float(distinct[0])

    def one(value: Any) -> Any:
        return vc.reflectance_factor(scene_at(value), 1e-8, smallest_angle=narrowest)

    spectra = np.asarray(jax.lax.map(one, jnp.asarray(distinct), batch_size=64))
    return spectra[place].reshape(*angle.shape, -1)


def record(folder: Path, name: str, exact: np.ndarray) -> None:
    """Counts of a sample and of both references, as a camera writes them."""
    random = np.random.default_rng(46)
    light = (
        BRIGHTEST
        * (1 - 0.3 * np.linspace(-1, 1, SAMPLES)[:, None] ** 2)
        * np.linspace(0.6, 1, len(WAVELENGTHS_NM))
    )
    light[DEAD_SAMPLE, 10:14] = 0.0
    gain = random.normal(1, 0.01, (LINES, SAMPLES, 1))
    values = exact * gain + NOISE * random.standard_normal(exact.shape)
    values[5:9, 5:9] += 30.0  # a highlight
    header = {
        "description": f"synthetic: computed by examples/grooved_cubes.py, {name}",
        "wavelength": [f"{w:g}" for w in WAVELENGTHS_NM],
        "wavelength units": "Nanometers",
    }
    for what, counts in (
        (name, DARK + light * values),
        (f"{name}-white", np.broadcast_to(DARK + light, (8, *light.shape))),
        (f"{name}-dark", np.full((8, *light.shape), DARK)),
    ):
        stored = np.clip(np.round(counts), 0, FULL_SCALE).astype(np.uint16)
        envi.save_image(
            str(folder / f"{what}.hdr"),
            stored,
            dtype=np.uint16,
            interleave="bil",
            ext=".raw",
            force=True,
            metadata=header,
        )


def fitted(folder: Path, name: str, scene: vc.Scene, truth: np.ndarray) -> CubeResult:
    """Fit what was written, and compare."""
    result = fit_cube(
        scene,
        folder / f"{name}.hdr",
        [free.angle(lower_deg=30), free.gain()],
        folder / f"{name}.nc",
        standard_uncertainty=NOISE,
        white=folder / f"{name}-white.hdr",
        dark=folder / f"{name}-dark.hdr",
        saturation=FULL_SCALE,
    )
    result.plot(folder / f"{name}.png")
    print(f"\n{name}\n{result.summary()}")
    with result.open() as maps:
        good = maps["status"].values == 0
        off = maps["angle"].values - np.degrees(truth)
        within = np.abs(off) < 2 * maps["angle_standard_error"].values
    share, middle = float(np.mean(within[good])), float(np.median(np.abs(off[good])))
    print(
        f"median distance from the true angle {middle:.2g}°; within two standard errors {share:.1%} of the pixels"
    )
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("outdir", nargs="?", type=Path, help="where to write; by default a new temporary folder")
    folder = parser.parse_args().outdir or Path(tempfile.mkdtemp(prefix="vcavity-cubes-"))
    folder.mkdir(parents=True, exist_ok=True)
    gold = vc.Specular(vc.materials.refractive_index("Au-Johnson", WAVELENGTHS_NM))
    nm, orange, _ = read_spectrum(DATA / "flat-orange.csv")
    ink = vc.Lambertian(np.interp(WAVELENGTHS_NM, nm, orange))
    samples: tuple[tuple[str, Any, np.ndarray], ...] = (("gold", gold, wedge()), ("print", ink, emblem()))
    for name, material, angle in samples:

        def scene_at(value: Any, material: Any = material) -> vc.Scene:
            return vc.Scene(vc.VGrooves(value), material, vc.Diffuse(), vc.View())

        record(folder, name, factors(scene_at, angle))
        print(f"{name}.hdr: {dict(open_cube(folder / f'{name}.hdr').sizes)}")
        fitted(folder, name, scene_at(1.0), angle)
    print(f"\nwritten to {folder}")


if __name__ == "__main__":
    main()
