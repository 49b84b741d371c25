"""The reflectance of a folded sheet, recovered from its grooves: the angle is known, the ink is not.

    python examples/recovered_reflectance.py [OUTDIR]

writes recovered_reflectance.png into OUTDIR (a new temporary folder by default) and prints a table. A matte orange
folded to 60 degrees and a varnished cyan folded to 75, rendered with noise, are turned back into the spectra of
the flat samples, which are known here: how far off is the result, and is that what its uncertainty says? From six
directions together, and from the frontal one alone.
"""
# ruff: noqa: RUF001 (the labels are typeset: Greek letters)

import argparse
import tempfile
from pathlib import Path

import jax
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

jax.config.update("jax_enable_x64", True)

import vcavity_jax as vc  # noqa: E402
from fitting import Measurement, Recovery, read_spectrum, recover_reflectance  # noqa: E402
from fitting.plots import write_figure  # noqa: E402

DATA = Path(__file__).parent / "data"
SAMPLES = {
    "matte orange, 60°": ("orange-v60.csv", "flat-orange.csv", 60.0, vc.Lambertian(0.5)),
    "varnished cyan, 75°": ("cyan-varnished-v75.csv", "flat-cyan.csv", 75.0, vc.InterfacedLambertian(0.5, 1.5)),
}
"""Grooved sample, spectrum of the flat material (below the varnish), angle in degrees, what it is made of."""


def frontal(measurement: Measurement) -> Measurement:
    """The frontal direction alone."""
    sigma = measurement.standard_uncertainty
    assert sigma is not None
    return Measurement(
        measurement.wavelengths_nm,
        measurement.polar[:1],
        measurement.azimuth[:1],
        measurement.reflectance_factor[:1],
        sigma[:1],
    )


def row(name: str, result: Recovery, truth: np.ndarray) -> str:
    """Root mean square error, what the uncertainty lets expect, their ratio, and the amplification of noise."""
    sigma = result.standard_uncertainty
    assert sigma is not None
    off = result.reflectance - truth
    stated, expected = result.measurement.standard_uncertainty, np.sqrt(np.mean(sigma**2))
    assert stated is not None
    return (
        f"{name:32}  {np.mean(stated):.4f}  {np.sqrt(np.mean(off**2)):.4f}     {expected:.4f}     "
        f"{np.sqrt(np.mean((off / sigma) ** 2)):.2f}    {np.max(np.abs(off / sigma)):.1f}    "
        f"{np.min(result.amplification):.2f} to {np.max(result.amplification):.2f}"
    )


def draw(results: dict[str, tuple[Recovery, np.ndarray]]) -> Figure:
    """Recovered and flat spectra side by side, and what the grooves show frontally; what is left below."""
    figure = Figure(figsize=(7.0, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    rows = figure.subplots(2, len(results), sharex=True, sharey="row", height_ratios=[2, 1])
    for (name, (result, truth)), above, below in zip(results.items(), *rows, strict=True):
        nm, sigma = result.wavelengths_nm, result.standard_uncertainty
        above.plot(nm, truth, color="black", label="flat sample")
        above.errorbar(
            nm,
            result.reflectance,
            sigma,
            fmt="o",
            ms=3.2,
            mfc="white",
            color="#0072B2",
            elinewidth=0.6,
            label="recovered ± σ",
        )
        grooved = result.measurement.reflectance_factor[0]
        above.plot(nm, grooved, ls=(0, (5, 1.5)), color="#D55E00", label="grooves, seen frontally")
        above.set_title(name)
        below.axhspan(-2, 2, color="#d9d9d9", lw=0, zorder=0)
        below.axhline(0, color="black", lw=0.6)
        below.plot(nm, (result.reflectance - truth) / sigma, "o", ms=2.6, mfc="white", color="#0072B2")
        below.set_xlabel("wavelength (nm)")
    rows[0, 0].set_ylabel("reflectance")
    rows[0, 0].set_ylim(bottom=0)
    rows[1, 0].set_ylabel("(recovered − flat) / σ")
    rows[0, 0].legend(loc="upper left")
    return figure


def main() -> None:
    """Recover, compare and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("outdir", nargs="?", type=Path, help="where to write")
    outdir = parser.parse_args().outdir or Path(tempfile.mkdtemp(prefix="recovered-reflectance-"))
    outdir.mkdir(parents=True, exist_ok=True)
    results = {}
    print("                                   noise  rms error  expected  in σ: rms  max  amplification")
    for name, (grooved, flat, degrees, material) in SAMPLES.items():
        measurement = Measurement.read(DATA / grooved)
        nm, truth, _ = read_spectrum(DATA / flat)
        assert np.array_equal(nm, measurement.wavelengths_nm)
        scene = vc.Scene(vc.VGrooves(np.deg2rad(degrees)), material, measurement.illumination, vc.View())
        for views, part in (("six views", measurement), ("frontal", frontal(measurement))):
            result = recover_reflectance(scene, part)
            print(row(f"{name}, {views}", result, truth))
            for warning in result.warnings:
                print(f"    {warning}")
            results.setdefault(name, (result, truth))
        by_angle = np.abs(results[name][0].angle_sensitivity) * np.deg2rad(1.0)
        print(f"    an angle that is 1° off would shift it by up to {np.max(by_angle):.4f}")
    path = outdir / "recovered_reflectance.png"
    write_figure(lambda: draw(results), path)
    print(f"wrote {path}")


if __name__ == "__main__":
    main()
