"""Grooves that turn copper red: one dihedral angle, or a roughness.

    python examples/red_from_copper.py [OUTDIR]

writes red_from_copper.png into OUTDIR (a new temporary folder by default) and prints both designs. Every
reflection takes blue and green from the light, so narrow or rough grooves deepen the color of a metal without
any pigment [SaintPierre2020, section 4.4]. The target is seen from the front in diffuse light: once with all
grooves alike, once with Beckmann-distributed ones; a red of paint, beyond what copper can do, shows how close
one can come and what binds.
"""

import argparse
import tempfile
from pathlib import Path
from typing import Any

import jax
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

jax.config.update("jax_enable_x64", True)

import vcavity_jax as vc  # noqa: E402
from fitting import ReachableColors, design, free, reachable_colors, read_spectrum, target  # noqa: E402
from fitting.plots import write_figure  # noqa: E402
from vcavity_jax import colorimetry  # noqa: E402

DATA = Path(__file__).parent / "data"
NM = np.arange(400.0, 701.0, 10.0)
WISH = (65.0, 31.0, 29.0)
FRONT = target.Look()


def scenes() -> dict[str, tuple[vc.Scene, Any]]:
    """Copper in both surfaces, and what is free."""
    copper = vc.Specular(vc.materials.refractive_index("Cu-Johnson", NM))
    return {
        "all grooves alike": (vc.Scene(vc.VGrooves(1.0), copper, vc.Diffuse(), vc.View()), free.angle(40, 175)),
        "rough": (vc.Scene(vc.BeckmannGrooves(0.5), copper, vc.Diffuse(), vc.View()), free.roughness(0.05, 2.0)),
    }


def draw(colors: dict[str, ReachableColors], reds: dict[str, np.ndarray]) -> Figure:
    """Reachable colors and the targets, a*b* and L*C*."""
    figure = Figure(figsize=(7.0, 3.2), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    for (name, found), dash in zip(colors.items(), ("-", "--"), strict=True):
        light, a, b = found.lab[0].T
        for axes, x, y in ((left, a, b), (right, np.hypot(a, b), light)):
            axes.plot(x, y, f"k{dash}", linewidth=0.8, label=name, zorder=1)
            axes.scatter(x[::6], y[::6], c=found.srgb[0, ::6], s=22, edgecolors="black", linewidths=0.4, zorder=2)
    for (name, (light, a, b)), marker in zip(reds.items(), "*X", strict=True):
        for axes, x, y in ((left, a, b), (right, np.hypot(a, b), light)):
            axes.plot(x, y, marker, color="#D55E00", markersize=8, label=name, zorder=3)
    left.set(xlabel="a*", ylabel="b*")
    right.set(xlabel="C*", ylabel="L*")
    right.legend(fontsize=7)
    return figure


def main() -> None:
    """Design both, and try the paint."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("outdir", nargs="?", type=Path)
    outdir = parser.parse_args().outdir or Path(tempfile.mkdtemp())
    outdir.mkdir(parents=True, exist_ok=True)
    _, paint, _ = read_spectrum(DATA / "flat-red.csv")
    red = np.asarray(colorimetry.lab(colorimetry.xyz(paint, NM), colorimetry.white(NM)))
    colors = {}
    for name, (scene, parameter) in scenes().items():
        for wish, step in ((WISH, 2.0), (red, 2.0)):
            found = design(
                scene, [parameter], target.color(wish, FRONT, step=step), wavelengths_nm=NM, tolerance=1e-4
            )
            print(f"{name}:\n{found.summary()}\n")
        colors[name] = reachable_colors(scene, FRONT, parameter, wavelengths_nm=NM, count=73, tolerance=1e-4)
    reds = {"target": np.array(WISH), "red paint": red}
    write_figure(lambda: draw(colors, reds), outdir / "red_from_copper.png")
    print(f"wrote {outdir / 'red_from_copper.png'}")


if __name__ == "__main__":
    main()
