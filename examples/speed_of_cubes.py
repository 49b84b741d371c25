"""What a fit in every pixel of a cube costs: time, memory as the cube grows, and what a second worker saves.

    python examples/speed_of_cubes.py [OUTDIR] [--full]

writes speed_of_cubes.md into OUTDIR (a new temporary folder by default) and prints it. The default is a short run
of small cubes and one worker; --full takes ten minutes and 2.2 GB of disk. The cubes are synthetic gold grooves of
40 to 110 degrees; angle and gain are free. Each fit is a process of its own, so that compilation is counted, and
what it may allocate is limited (RLIMIT_DATA) where a limit is given.
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

NOISE = 0.004
SAMPLES = 250


def write_cube(path: Path, lines: int, wavelengths: np.ndarray, kind: type) -> None:
    """An ENVI cube, written line by line."""
    import jax
    import spectral.io.envi as envi

    import vcavity_jax as vc

    gold = vc.Specular(vc.materials.refractive_index("Au-Johnson", wavelengths))

    def spectrum(angle: Any) -> Any:
        scene = vc.Scene(vc.VGrooves(angle), gold, vc.Diffuse(), vc.View())
        return vc.reflectance_factor(scene, 1e-8, smallest_angle=np.radians(40.0))

    exact = np.asarray(jax.jit(jax.vmap(spectrum))(np.radians(np.linspace(40, 110, SAMPLES))))
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
            line = exact * random.normal(1, 0.01, (SAMPLES, 1)) + NOISE * random.standard_normal(exact.shape)
            counts = np.clip(np.round(10_000 * line), 0, 65_535).astype(kind)
            stream.write(np.ascontiguousarray(counts.T).tobytes())


def fit_here(path: str, output: str, workers: int, megabytes: int) -> None:
    """In a process of its own: fit, and print what it took as JSON."""
    if megabytes:
        resource.setrlimit(resource.RLIMIT_DATA, (megabytes << 20, megabytes << 20))
    start = time.perf_counter()
    import jax

    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_enable_compilation_cache", False)
    import vcavity_jax as vc
    from fitting import free
    from fitting.cubes import fit_cube, local_cluster, open_cube

    wavelengths = np.asarray(open_cube(path).coords["wavelength"].values)
    gold = vc.Specular(vc.materials.refractive_index("Au-Johnson", wavelengths))
    scene = vc.Scene(vc.VGrooves(1.0), gold, vc.Diffuse(), vc.View())
    parameters = [free.angle(30, 120), free.gain()]
    with local_cluster(workers) if workers else nullcontext() as client:
        result = fit_cube(scene, path, parameters, output, standard_uncertainty=NOISE, client=client)
    seconds = time.perf_counter() - start
    counts = result.counts()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(json.dumps({"seconds": seconds, "peak": peak, "converged": counts["converged"] / sum(counts.values())}))


def measure(path: Path, workers: int = 0, megabytes: int = 0) -> dict[str, float]:
    """Seconds with import and compilation, MB at most, and the share of pixels with an answer."""
    argv = [
        sys.executable,
        __file__,
        "--fit",
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
        path, output, workers, megabytes = sys.argv[2:]
        fit_here(path, output, int(workers), int(megabytes))
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
        "| cube | size (MB) | allowed (MB) | workers | time (s) | peak memory (MB) | with an answer |",
        "|---" * 7 + "|",
    ]

    def row(count: int, bands: int, kind: type, workers: int = 0, megabytes: int = 0) -> dict[str, float]:
        path = folder / f"cube-{count}-{bands}.hdr"
        if not path.exists():
            write_cube(path, count, np.linspace(400, 700, bands), kind)
        found = measure(path, workers, megabytes)
        size = path.with_suffix(".raw").stat().st_size / 1e6
        allowed = f"{megabytes}" if megabytes else "any"
        process = {0: "this process"}.get(workers, f"{workers} by dask")
        lines.append(
            f"| {count} by {SAMPLES} by {bands} | {size:.0f} | {allowed} | {process} | {found['seconds']:.0f} | "
            f"{found['peak']:.0f} | {found['converged']:.1%} |"
        )
        print(lines[-1], flush=True)
        return found

    row(400 if given.full else 20, 31, np.uint16)
    for times in (1, 4, 16) if given.full else (1, 2):
        row((320 if given.full else 10) * times, 200 if given.full else 31, np.float64, megabytes=1500)
    if given.full:
        few, many = ([row(320 * n, 200, np.float64, w)["seconds"] for w in (1, 2)] for n in (4, 16))
        whole, further = many[0] / many[1], (many[0] - few[0]) / (many[1] - few[1])
        lines += [
            "",
            f"Two workers are {whole:.2f} times as fast as one, {further:.2f} times once they have started.",
        ]
    text = "\n".join(lines) + "\n"
    (folder / "speed_of_cubes.md").write_text(text, encoding="utf-8")
    print(f"\n{text}\nwritten to {folder}")


if __name__ == "__main__":
    main()
