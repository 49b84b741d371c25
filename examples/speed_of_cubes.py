"""What a fit in every pixel of a cube costs: time, memory as the cube grows, and what a second worker saves.

    python examples/speed_of_cubes.py [OUTDIR] [--full]

writes speed_of_cubes.md into OUTDIR (a new temporary folder by default) and prints it. The default is a short run
of small cubes and one worker; --full takes a quarter of an hour and 2.2 GB of disk. The cubes are synthetic: gold
grooves of 40 to 110 degrees, whose angle and gain are free, which a table answers; and a print on grooves of 100
degrees, whose reflectance is free in every band, so that every pixel takes a fit of its own. Each run is a process
of its own, so that compilation is counted; what it may allocate is limited (RLIMIT_DATA) where a limit is given.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from fitting.bench.timing import describe_machine

DATA = Path(__file__).parent / "data"
NOISE = 0.004
SAMPLES = 250


def gold(wavelengths: np.ndarray, place: Any = 0.5) -> Any:
    """Grooves whose angle grows along a line, from place 0 to 1."""
    import vcavity_jax as vc

    metal = vc.Specular(vc.materials.refractive_index("Au-Johnson", wavelengths))
    return vc.Scene(vc.VGrooves(np.radians(40.0) + np.radians(70.0) * place), metal, vc.Diffuse(), vc.View())


def print_(wavelengths: np.ndarray, place: Any = 0.5) -> Any:
    """Grooves of 100 degrees with more and more orange ink along a line, from place 0 to 1."""
    import vcavity_jax as vc
    from fitting import read_spectrum

    nm, orange, _ = read_spectrum(DATA / "flat-orange.csv")
    ink = vc.Lambertian(np.interp(wavelengths, nm, orange) ** (0.3 + place))
    return vc.Scene(vc.VGrooves(np.radians(100.0)), ink, vc.Diffuse(), vc.View())


SCENES = {"gold": gold, "print": print_}


def write_cube(path: Path, sample: str, lines: int, wavelengths: np.ndarray, kind: type) -> None:
    """An ENVI cube, written line by line."""
    import jax
    import spectral.io.envi as envi

    import vcavity_jax as vc

    def spectrum(place: Any) -> Any:
        return vc.reflectance_factor(SCENES[sample](wavelengths, place), 1e-8, smallest_angle=np.radians(40.0))

    exact = np.asarray(jax.jit(jax.vmap(spectrum))(np.linspace(0, 1, SAMPLES)))
    random = np.random.default_rng(1)
    header = {
        "lines": lines,
        "samples": SAMPLES,
        "bands": len(wavelengths),
        "data type": {np.uint16: 12, np.float64: 5}[kind],
        "interleave": "bil",
        "byte order": 0,
        "reflectance scale factor": 10_000,
        "wavelength": [f"{w:.9g}" for w in wavelengths],
        "wavelength units": "Nanometers",
        "description": "synthetic: computed by examples/speed_of_cubes.py",
    }
    envi.write_envi_header(str(path), header)
    with path.with_suffix(".raw").open("wb") as stream:
        for _ in range(lines):
            gain = random.normal(1, 0.01, (SAMPLES, 1)) if sample == "gold" else 1.0
            line = exact * gain + NOISE * random.standard_normal(exact.shape)
            counts = np.clip(np.round(10_000 * line), 0, 65_535).astype(kind)
            stream.write(np.ascontiguousarray(counts.T).tobytes())


def fit_here(sample: str, path: str, output: str, workers: int, megabytes: int) -> None:
    """In a process of its own: fit, and print what it took as JSON."""
    if megabytes:
        resource.setrlimit(resource.RLIMIT_DATA, (megabytes << 20, megabytes << 20))
    start = time.perf_counter()
    import jax

    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_enable_compilation_cache", False)
    from fitting import free
    from fitting.cubes import fit_cube, local_cluster, open_cube

    wavelengths = np.asarray(open_cube(path).coords["wavelength"].values)
    scene = SCENES[sample](wavelengths)
    parameters = [free.angle(30, 120), free.gain()] if sample == "gold" else [free.reflectance()]
    with local_cluster(workers) if workers else nullcontext() as client:
        result = fit_cube(scene, path, parameters, output, standard_uncertainty=NOISE, client=client)
    seconds = time.perf_counter() - start
    counts = result.counts()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(json.dumps({"seconds": seconds, "peak": peak, "converged": counts["converged"] / sum(counts.values())}))


def measure(sample: str, path: Path, workers: int, megabytes: int) -> dict[str, float]:
    """Seconds with import and compilation, MB at most, and the share of pixels with an answer."""
    argv = [
        sys.executable,
        __file__,
        "--fit",
        sample,
        str(path),
        str(path.with_suffix(".nc")),
        str(workers),
        str(megabytes),
    ]
    return dict(
        json.loads(subprocess.run(argv, check=True, capture_output=True, text=True).stdout.splitlines()[-1])
    )


def main() -> None:
    if sys.argv[1:2] == ["--fit"]:
        sample, path, output, workers, megabytes = sys.argv[2:]
        fit_here(sample, path, output, int(workers), int(megabytes))
        return
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("outdir", nargs="?", type=Path, help="where to write; by default a new temporary folder")
    parser.add_argument("--full", action="store_true", help="100 000 spectra, cubes of 2.2 GB, two workers")
    given = parser.parse_args()
    folder = given.outdir or Path(tempfile.mkdtemp(prefix="vcavity-cubes-"))
    folder.mkdir(parents=True, exist_ok=True)
    lines = [f"- {name}: {value}" for name, value in describe_machine().items()]
    lines += [
        "",
        "| sample | cube | size (MB) | allowed (MB) | workers | time (s) | peak memory (MB) | with an answer |",
        "|---" * 8 + "|",
    ]

    def row(
        sample: str, count: int, bands: int, kind: type, workers: int = 0, megabytes: int = 0
    ) -> dict[str, float]:
        path = folder / f"{sample}-{count}-{bands}.hdr"
        if not path.exists():
            write_cube(path, sample, count, np.linspace(400, 700, bands), kind)
        found = measure(sample, path, workers, megabytes)
        size = path.with_suffix(".raw").stat().st_size / 1e6
        allowed = f"{megabytes}" if megabytes else "any"
        process = {0: "this process"}.get(workers, f"{workers} by dask")
        lines.append(
            f"| {sample} | {count} by {SAMPLES} by {bands} | {size:.0f} | {allowed} | {process} | "
            f"{found['seconds']:.0f} | {found['peak']:.0f} | {found['converged']:.1%} |"
        )
        print(lines[-1], flush=True)
        return found

    def two_workers(sample: str, bands: int, kind: type, short: int, long: int) -> None:
        few, many = ([row(sample, n, bands, kind, w)["seconds"] for w in (1, 2)] for n in (short, long))
        whole, further = many[0] / many[1], (many[0] - few[0]) / (many[1] - few[1])
        told.append(
            f"{sample}: two workers are {whole:.2f} times as fast as one, {further:.2f} once they have started."
        )

    told = [""]
    if given.full:
        row("gold", 400, 31, np.uint16)
        for count in (320, 1280, 5120):
            row("gold", count, 200, np.float64, megabytes=1500)
        two_workers("gold", 200, np.float64, 1280, 5120)
        row("print", 400, 31, np.uint16)
        two_workers("print", 31, np.uint16, 100, 400)
    else:
        row("gold", 20, 31, np.uint16)
        row("gold", 20, 31, np.float64, megabytes=1500)
        row("print", 4, 31, np.uint16)
    lines += told
    text = "\n".join(lines) + "\n"
    (folder / "speed_of_cubes.md").write_text(text, encoding="utf-8")
    print(f"\n{text}\nwritten to {folder}")


if __name__ == "__main__":
    main()
