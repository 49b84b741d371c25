"""Is a grooved sample matte or varnished? How many directions it takes to tell, from rendered measurements.

    python examples/which_material.py [OUTDIR] [--full]

writes which_material.png into OUTDIR (a new temporary folder by default) and prints a table. A matte orange of 60
degrees and a varnished cyan of 75 are fitted as what they are and as the other, to the first directions of each
file. The flat sample's spectrum is unknown; with --full it is also known. A positive difference of AIC speaks for
the truth.
"""

import argparse
import dataclasses
import tempfile
from pathlib import Path
from typing import Any

import jax
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

jax.config.update("jax_enable_x64", True)

import vcavity_jax as vc  # noqa: E402
from fitting import Comparison, Measurement, compare_models, free, read_spectrum, rivals  # noqa: E402
from fitting.plots import write_figure  # noqa: E402

DATA = Path(__file__).parent / "data"
SAMPLES = {
    "matte orange, 60°": ("orange-v60.csv", "flat-orange.csv", "Lambertian"),
    "varnished cyan, 75°": ("cyan-varnished-v75.csv", "flat-cyan.csv", "interfaced, unpolarized"),
}
"""Measurement, spectrum of the flat material (below the varnish), and the model that is true."""


def of_first(measurement: Measurement, count: int) -> Measurement:
    """The first directions alone; the others are masked, so that nothing is compiled anew."""
    values = measurement.reflectance_factor.copy()
    values[count:] = np.nan
    return dataclasses.replace(measurement, reflectance_factor=values)


def compared(file: str, flat: str, count: int, parameters: list[Any]) -> Comparison:
    """Matte against varnished."""
    measurement = of_first(Measurement.read(DATA / file), count)
    _, reflectance, _ = read_spectrum(DATA / flat)
    material = vc.Lambertian(reflectance) if "orange" in file else vc.InterfacedLambertian(reflectance, 1.5)
    scene = vc.Scene(vc.VGrooves(1.0), material, measurement.illumination, measurement.view)
    models = {k: v for k, v in rivals(scene).items() if k != "interfaced, full"}
    return compare_models(models, measurement, parameters, tolerance=1e-5)


def draw(found: dict[str, dict[int, float]]) -> Figure:
    """Differences of AIC against the number of directions."""
    figure = Figure(figsize=(3.5, 3.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    axes.axhspan(-2, 2, color="0.88", linewidth=0, label="no choice")
    for name, differences in found.items():
        style = ("s" if "cyan" in name else "o") + ("--" if "unknown" in name else "-")
        color = "#0072B2" if "cyan" in name else "#D55E00"
        axes.plot(list(differences), list(differences.values()), style, color=color, markersize=4, label=name)
    axes.set_yscale("symlog", linthresh=10)
    axes.set_xlabel("directions")
    axes.set_ylabel("AIC, wrong less true model")
    figure.legend(fontsize=7, loc="outside lower center")
    return figure


def main() -> None:
    """Compare all and show them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("outdir", nargs="?", type=Path)
    parser.add_argument("--full", action="store_true")
    given = parser.parse_args()
    outdir = given.outdir or Path(tempfile.mkdtemp())
    unknowns = {"spectrum unknown": [free.angle(10, 170), free.reflectance()]}
    if given.full:
        unknowns["spectrum known"] = [free.angle(10, 170)]
    found: dict[str, dict[int, float]] = {}
    print("sample               spectrum         directions  AIC difference  angle if true  if the other  chosen")
    for sample, (file, flat, true) in SAMPLES.items():
        for known, parameters in unknowns.items():
            # A free spectrum needs a second direction to leave anything to test.
            for count in (1, 2, 3, 6) if known == "spectrum known" else (2, 3, 6):
                comparison = compared(file, flat, count, parameters)
                right = comparison[true]
                (wrong,) = [m for m in comparison.models if m.name != true]
                found.setdefault(f"{sample}, {known}", {})[count] = wrong.aic - right.aic
                angles = [np.degrees(m.result.estimates["angle"].value) for m in (right, wrong)]
                chosen = "nothing" if abs(wrong.aic - right.aic) < 2 else comparison.best.name
                print(
                    f"{sample:20} {known:16} {count:10}  {wrong.aic - right.aic:14.1f}  {angles[0]:13.2f}  "
                    f"{angles[1]:12.2f}  {chosen}"
                )
    outdir.mkdir(parents=True, exist_ok=True)
    write_figure(lambda: draw(found), outdir / "which_material.png")
    print(f"wrote {outdir / 'which_material.png'}")


if __name__ == "__main__":
    main()
