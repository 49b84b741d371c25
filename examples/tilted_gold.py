"""A tilted, mis-scaled gold groove as a hyperspectral camera sees it (thesis, section 4.6).

    python examples/tilted_gold.py [OUTDIR]

The camera's reflectance scale is off (gain and offset unknown), the sample lies tilted on the stage, and the lamp
is too weak below 450 nm and above 700 nm, which are masked. The data, examples/data/gold-camera.csv, are computed
(they are no laboratory measurement): this script makes them anew and compares. It fits them as if the bench were
perfect, with gain and offset, and with the tilt too; then from one side of the normal only. Prints a table of
estimates, writes tilted_gold.png and tilted_gold_tilt.png into OUTDIR (a new temporary folder by default).
"""

import argparse
import tempfile
from pathlib import Path

import jax
import numpy as np

import vcavity_jax as vc
from fitting import FitResult, Measurement, fit, free
from fitting.instrument import tilted

jax.config.update("jax_enable_x64", True)

DATA = Path(__file__).parent / "data" / "gold-camera.csv"
BAND_NM = (450.0, 700.0)
ANGLE_DEG, ACROSS_DEG, ALONG_DEG, GAIN, OFFSET = 62.3, 1.8, -0.7, 0.82, 0.013
WAVELENGTHS_NM = np.arange(400.0, 751.0, 10.0)
POLAR_DEG = np.array([-60.0, -40.0, -20.0, 0.0, 20.0, 40.0, 60.0])


def record() -> Measurement:
    """The model of a tilted groove, mis-scaled, with noise, and useless at both ends of the band."""
    random = np.random.default_rng(46)
    index = vc.materials.refractive_index("Au-Johnson", WAVELENGTHS_NM)
    view = vc.View(np.radians(POLAR_DEG))
    groove = vc.Scene(vc.VGrooves(np.radians(ANGLE_DEG)), vc.Specular(index), vc.Diffuse(), view)
    seen, _ = tilted(groove, *jax.numpy.radians(jax.numpy.array([ACROSS_DEG, ALONG_DEG])))
    values = GAIN * np.asarray(vc.reflectance_factor(seen, 1e-10)) + OFFSET
    low, high = BAND_NM
    weak = (low > WAVELENGTHS_NM) | (high < WAVELENGTHS_NM)
    sigma = np.broadcast_to(np.where(weak, 0.04, 0.004), values.shape)
    values = values + 0.06 * weak + sigma * random.standard_normal(values.shape)
    # As written to the file: what is not in it cannot be read from it.
    return Measurement(
        WAVELENGTHS_NM,
        np.radians(POLAR_DEG),
        np.zeros(len(POLAR_DEG)),
        values.round(5),
        np.full(values.shape, 0.004),
    )


def write(measurement: Measurement, path: Path) -> None:
    """The measurement as a file in the native format."""
    lines = [
        "# title: V-grooved gold, tilted, seen by a camera with a wrong scale",
        "# illumination: diffuse",
        "# instrument: computed by examples/tilted_gold.py: not a laboratory measurement",
        "# reflectance_unit: fraction",
        f"# truth: angle_deg = {ANGLE_DEG}, tilt_across_deg = {ACROSS_DEG}, tilt_along_deg = {ALONG_DEG}, "
        f"gain = {GAIN}, offset = {OFFSET}; wavelengths below 450 nm and above 700 nm are wrong",
        "wavelength_nm,polar_deg,azimuth_deg,reflectance_factor,standard_uncertainty",
    ]
    for polar, row in zip(POLAR_DEG, measurement.reflectance_factor, strict=True):
        lines += [f"{nm:g},{polar:g},0,{value:.5f},0.004" for nm, value in zip(WAVELENGTHS_NM, row, strict=True)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def row(label: str, result: FitResult) -> str:
    """One line of the table."""
    angle = result.estimates["angle"]
    value, error = np.degrees([angle.value, angle.standard_error])
    ratio = result.chi_square / result.degrees_of_freedom
    parts = [f"{label:28s} {value:6.2f} ± {error:.2f}  {(value - ANGLE_DEG) / error:+6.1f}  {ratio:8.2f}"]
    for name, scale in (("gain", 1.0), ("offset", 1.0), ("tilt_across", 180 / np.pi), ("tilt_along", 180 / np.pi)):
        e = result.estimates.get(name)
        parts.append("-" if e is None else f"{scale * e.value:.3f} ± {scale * e.standard_error:.3f}")
    return parts[0] + "".join(f"  {part:>16s}" for part in parts[1:])


def main() -> None:
    """Fit and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("outdir", nargs="?", type=Path, help="where to write")
    parser.add_argument("--write-data", action="store_true", help="write examples/data/gold-camera.csv anew")
    given = parser.parse_args()
    outdir = given.outdir or Path(tempfile.mkdtemp(prefix="tilted-gold-"))
    outdir.mkdir(parents=True, exist_ok=True)
    if given.write_data:
        write(record(), DATA)

    whole = Measurement.read(DATA)
    difference = np.abs(whole.reflectance_factor - record().reflectance_factor).max()
    print(f"the file and the model that made it differ by {difference:.0e}, one digit of the file at most\n")
    camera = whole.select(wavelengths_nm=BAND_NM)
    index = vc.materials.refractive_index("Au-Johnson", camera.wavelengths_nm)
    scene = vc.Scene(vc.VGrooves(1.0), vc.Specular(index), vc.Diffuse(), camera.view)
    right = camera.polar >= 0
    one_side = Measurement(
        camera.wavelengths_nm,
        camera.polar[right],
        camera.azimuth[right],
        camera.reflectance_factor[right],
        camera.standard_uncertainty[right],
    )
    angle = free.angle(20, 170)
    scale = [free.gain(None), free.offset(None)]
    print(f"{'':28s} {'angle':>13s}  {'/ s.e.':>6s}  {'chi2/dof':>8s}  {'gain':>16s}  {'offset':>16s}", end="")
    print(f"  {'tilt across':>16s}  {'tilt along':>16s}")
    truth = f"{GAIN:.3f}", f"{OFFSET:.3f}", f"{ACROSS_DEG:.3f}", f"{ALONG_DEG:.3f}"
    print(f"{'truth':28s} {ANGLE_DEG:6.2f} {'':24s}" + "".join(f"  {value:>16s}" for value in truth))
    results = {}
    for label, measurement, parameters in (
        ("a perfect bench", camera, [angle]),
        ("gain and offset", camera, [angle, *scale]),
        ("gain, offset and tilt", camera, [angle, *scale, *free.tilt((0.0, 2.0))]),
        ("the same, θ ≥ 0 only", one_side, [angle, *scale, *free.tilt((0.0, 2.0))]),
    ):
        results[label] = fit(scene, measurement, parameters)
        print(row(label, results[label]))
    best = results["gain, offset and tilt"]
    for label, result in results.items():
        for warning in result.warnings:
            print(f"\n{label}: {warning}")
    best.plot(outdir / "tilted_gold.png")
    best.profile("tilt_across").plot(outdir / "tilted_gold_tilt.png")
    print(f"\nwrote {outdir / 'tilted_gold.png'} and {outdir / 'tilted_gold_tilt.png'}")


if __name__ == "__main__":
    main()
