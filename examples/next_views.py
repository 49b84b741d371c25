"""Which three directions to measure: planned ones against evenly spaced ones, for every angle of the grooves.

    python examples/next_views.py [OUTDIR]

writes next_views.png into OUTDIR (a new temporary folder by default) and prints a table. The reflectance of a
matte sample, and n and k of gold, are unknown at each wavelength; values have a noise of 0.005 in diffuse light.
The planned views are best for the worst angle within 2 degrees. Where a curve ends, the angle is not identifiable.
"""
# ruff: noqa: RUF001 (the labels are typeset: Greek letters)

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
from fitting import ViewPlan, free, plan_views, read_spectrum  # noqa: E402
from fitting.plots import write_figure  # noqa: E402

NOISE, SPREAD_DEG = 0.005, 2.0
WAVELENGTHS_NM = np.arange(400.0, 701.0, 30.0)
ANGLES_DEG = np.arange(20.0, 171.0, 5.0)
EVEN = {"0, 40, 80°": ("--", "#D55E00", (0.0, 40.0, 80.0)), "0, 30, 60°": (":", "black", (0.0, 30.0, 60.0))}
"""Evenly spaced directions across the grooves, and how they are drawn."""


def candidates() -> vc.View:
    """Every 10 degrees, across the grooves, along them and between."""
    azimuth, polar = np.meshgrid(
        np.radians([0.0, 45.0, 90.0]), np.radians(np.arange(0.0, 81.0, 10.0)), indexing="ij"
    )
    return vc.View(polar.ravel(), azimuth.ravel())


def materials() -> dict[str, tuple[Any, list[Any]]]:
    """What is measured and what of it is unknown."""
    nm, orange, _ = read_spectrum(Path(__file__).parent / "data" / "flat-orange.csv")
    gold = vc.materials.refractive_index("Au-Johnson", WAVELENGTHS_NM)
    return {
        "matte orange, reflectance unknown": (
            vc.Lambertian(orange[np.searchsorted(nm, WAVELENGTHS_NM)]),
            [free.angle(), free.reflectance()],
        ),
        "gold, n and k unknown": (vc.Specular(gold), [free.angle(), free.index_spectrum(complex_valued=True)]),
    }


def plan(material: Any, parameters: list[Any], angle_deg: float, directions: vc.View) -> ViewPlan:
    """The best three of some directions."""
    scene = vc.Scene(vc.VGrooves(np.radians(angle_deg)), material, vc.Diffuse(), vc.View())
    return plan_views(
        scene, parameters, directions, 3, NOISE, wavelengths_nm=WAVELENGTHS_NM, spread=np.radians(SPREAD_DEG)
    )


def error_deg(result: ViewPlan) -> float:
    """The worst standard error of the angle within the spread; NaN if it is not identifiable."""
    worst = np.degrees(result.worst_standard_errors["angle"][-1])
    return float(worst) if np.isfinite(worst) else np.nan


def shown(result: ViewPlan) -> str:
    """The views in words."""
    named = zip(np.degrees(result.polar), np.degrees(result.azimuth), strict=True)
    return ", ".join(f"{p:.0f}" if round(a) == 0 or p == 0 else f"{p:.0f}@{a:.0f}" for p, a in named)


def draw(errors: dict[str, dict[str, list[float]]]) -> Figure:
    figure = Figure(figsize=(7.0, 2.9), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, letter, (name, curves) in zip(figure.subplots(1, 2, sharey=True), "ab", errors.items(), strict=True):
        axes.plot(ANGLES_DEG, curves["planned"], "o-", ms=3, color="#0072B2", label="planned for each angle")
        for label, (line, color, _) in EVEN.items():
            axes.plot(ANGLES_DEG, curves[label], line, color=color, lw=1.3, label=label)
        axes.set_yscale("log")
        axes.set_ylim(0.1, 40)
        axes.set_yticks([0.1, 1, 10], ["0.1", "1", "10"])
        axes.set_xlim(15, 175)
        axes.set_xticks(np.arange(20, 161, 20))
        axes.set_xlabel("dihedral angle α (deg)")
        axes.grid(color="0.9", lw=0.5)
        axes.set_title(f"({letter}) {name}", loc="left")
    figure.axes[0].set_ylabel("standard error of α (deg)")
    figure.axes[0].legend(loc="upper left", title="three views", alignment="left")
    return figure


def main(output: Path) -> None:
    output.mkdir(parents=True, exist_ok=True)
    errors: dict[str, dict[str, list[float]]] = {}
    print("view angles in degrees, across the grooves or @azimuth; standard errors of the angle in degrees")
    for name, (material, parameters) in materials().items():
        curves: dict[str, list[float]] = {"planned": [], **{label: [] for label in EVEN}}
        print(f"\n{name}\nangle  planned views          error  " + "  ".join(EVEN))
        for angle in ANGLES_DEG:
            best = plan(material, parameters, angle, candidates())
            curves["planned"].append(error_deg(best))
            for label, (_, _, polar) in EVEN.items():
                fixed = vc.View(np.radians(polar), np.zeros(3))
                curves[label].append(error_deg(plan(material, parameters, angle, fixed)))
            if angle % 30 == 0:
                numbers = "  ".join(f"{curves[label][-1]:10.2f}" for label in EVEN)
                print(
                    f"{angle:5.0f}  {shown(best):20}  {curves['planned'][-1]:6.2f}  {numbers}".replace(
                        "nan", "  -"
                    )
                )
        errors[name] = curves
    path = output / "next_views.png"
    write_figure(lambda: draw(errors), path)
    print(f"\nwrote {path}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("output", nargs="?", type=Path, help="folder (default: a new temporary one)")
    main(parser.parse_args().output or Path(tempfile.mkdtemp()))
