"""How rough are real metals? Fit Beckmann grooves to integrating-sphere spectra of NASA TN D-5353.

Usage: python examples/metal_roughness.py [OUTDIR]

Prints a table and writes metal_roughness.png. Copper is the honest failure among the four: its spectrum is
not that of a rough clean metal, and the fit says so.
"""

import sys
import tempfile
from pathlib import Path

import jax
import numpy as np
from matplotlib.figure import Figure

jax.config.update("jax_enable_x64", True)

import vcavity_jax as vc  # noqa: E402
from fitting import FitResult, Measurement, fit, free  # noqa: E402

TABLE = Path(__file__).parent / "data" / "metals-nasa-tn-d-5353.csv"
METALS = {"nickel": "Ni-Johnson", "titanium": "Ti-Johnson", "gold": "Au-Johnson", "copper": "Cu-Johnson"}
RANGE_NM = (390.0, 800.0)
UNCERTAINTY = 0.02  # what the report's repeatability suggests; the table itself states none


def rough_metal(measurement: Measurement, index_name: str) -> vc.Scene:
    index = vc.materials.refractive_index(index_name, measurement.wavelengths_nm)
    return vc.Scene(
        vc.BeckmannGrooves(0.3),
        vc.Specular(index),
        vc.Diffuse(),
        vc.View(measurement.polar, measurement.azimuth),
    )


def draw(results: dict[str, FitResult], path: Path) -> None:
    figure = Figure(figsize=(7, 5.2), layout="constrained")
    for axes, (name, result) in zip(
        figure.subplots(2, 2, sharex=True, sharey=True).flat, results.items(), strict=True
    ):
        wavelengths = result.measurement.wavelengths_nm
        flat = vc.reflectance_factor(vc.Scene(vc.VGrooves(np.pi), *_rest(result.scene)))
        roughness = result.estimates["roughness"]
        axes.errorbar(
            wavelengths,
            result.measurement.reflectance_factor[0],
            UNCERTAINTY,
            fmt="o",
            ms=4,
            mfc="white",
            color="black",
            lw=0.8,
            label="measured ± 0.02",
        )
        axes.plot(wavelengths, result.predicted[0], color="#0072B2", label="fitted grooves")
        axes.plot(wavelengths, flat[0], "--", color="#D55E00", label="flat metal")
        axes.set_title(f"{name}: m = {roughness.value:.2f}, rms misfit {result.rms_misfit:.3f}", fontsize=10)
    figure.axes[0].legend(fontsize=8, frameon=False, loc="upper left")
    figure.supxlabel("wavelength (nm)", fontsize=10)
    figure.supylabel("hemispherical reflectance", fontsize=10)
    figure.savefig(path, dpi=200)


def _rest(scene: vc.Scene) -> tuple[vc.Specular, vc.Diffuse, vc.View]:
    return scene.material, scene.illumination, scene.view


def main(output: Path) -> None:
    output.mkdir(parents=True, exist_ok=True)
    results = {}
    print("metal      roughness m       95 % interval    rms misfit  chi-square/dof")
    for name, index_name in METALS.items():
        measurement = Measurement.read(TABLE, column=name).select(wavelengths_nm=RANGE_NM)
        scene = rough_metal(measurement, index_name)
        result = fit(scene, measurement, [free.roughness()], standard_uncertainty=UNCERTAINTY)
        estimate = result.estimates["roughness"]
        pieces = ", ".join(f"{low:.3f} to {high:.3f}" for low, high in estimate.interval_95)
        quality = result.chi_square / result.degrees_of_freedom
        print(
            f"{name:9}  {estimate.value:.3f} ± {estimate.standard_error:.3f}  {pieces:18}"
            f"  {result.rms_misfit:.4f}      {quality:.2f}"
        )
        for warning in result.warnings:
            print(f"           {warning}")
        results[name] = result
    path = output / "metal_roughness.png"
    draw(results, path)
    print(f"wrote {path}")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(tempfile.mkdtemp()))
