"""Which dihedral angle makes this orange paper most saturated, and which colors can it take at all?

    python examples/most_saturated_fold.py [OUTDIR]

writes reachable_colors.png and most_saturated_fold.png into OUTDIR (a new temporary folder by default) and
prints a table. A measured orange is folded, in frontal and in diffuse light, and seen from the front.
Interreflections deepen its color, shadows darken it: chroma C* has a maximum, where its exact derivative by the
angle is zero, while the saturation C* / √(C*² + L*²) rises to the narrowest fold.
"""

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.optimize import brentq

jax.config.update("jax_enable_x64", True)

import vcavity_jax as vc  # noqa: E402
from fitting import reachable_colors, read_spectrum, target  # noqa: E402
from fitting.plots import write_figure  # noqa: E402
from vcavity_jax import colorimetry  # noqa: E402

DATA = Path(__file__).parent / "data"
LIGHTS = {"frontal light": vc.Directional(0.0, 0.0), "diffuse light": vc.Diffuse()}
NARROWEST = np.radians(20.0)


def color_of(reflectance: np.ndarray, nm: np.ndarray, light: Any) -> Callable[[Array], Array]:
    """L*, C*, h of the fold by its angle, compiled."""
    white = colorimetry.white(nm)

    def color(angle: Array) -> Array:
        scene = vc.Scene(vc.VGrooves(angle), vc.Lambertian(reflectance), light, vc.View())
        factor = vc.reflectance_factor(scene, 1e-8, smallest_angle=float(NARROWEST))
        return colorimetry.lch(colorimetry.lab(colorimetry.xyz(factor, nm), white))

    return jax.jit(color)


def steepest_and_best(color: Callable[[Array], Array]) -> tuple[float, float]:
    """The angle of the largest chroma, where its derivative vanishes; and the derivative at 60°, per degree."""
    slope = jax.jit(jax.grad(lambda angle: color(angle)[1]))

    def at(angle: float) -> float:
        return float(slope(jnp.asarray(angle)))

    grid = np.linspace(NARROWEST, np.pi - 0.02, 24)
    signs = np.sign([at(float(a)) for a in grid])
    falls = int(np.flatnonzero((signs[:-1] > 0) & (signs[1:] <= 0))[0])
    return float(brentq(at, grid[falls], grid[falls + 1], xtol=1e-9)), np.radians(at(np.radians(60.0)))


def draw(curves: dict[str, np.ndarray], best: dict[str, float], angles: np.ndarray) -> Figure:
    """Chroma and saturation against the angle."""
    figure = Figure(figsize=(6.0, 2.7), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    for (name, lch), dash in zip(curves.items(), ("-", "--"), strict=True):
        lightness, chroma = lch[:, 0], lch[:, 1]
        left.plot(angles, chroma, f"k{dash}", label=name)
        left.plot(best[name], np.interp(best[name], angles, chroma), "o", color="#D55E00", markersize=4)
        right.plot(angles, chroma / np.hypot(chroma, lightness), f"k{dash}", label=name)
    left.set(xlabel="dihedral angle (°)", ylabel="chroma C*", xlim=(20, 180), xticks=range(30, 181, 30))
    right.set(xlabel="dihedral angle (°)", ylabel="C* / √(C*² + L*²)", xlim=(20, 180), xticks=range(30, 181, 30))
    left.legend()
    return figure


def main() -> None:
    """Find both angles and draw the colors."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("outdir", nargs="?", type=Path)
    outdir = parser.parse_args().outdir or Path(tempfile.mkdtemp())
    outdir.mkdir(parents=True, exist_ok=True)
    nm, orange, _ = read_spectrum(DATA / "flat-orange.csv")
    angles = np.degrees(np.linspace(NARROWEST, np.pi, 81))
    curves, best = {}, {}
    print("                largest C*   at angle   C* flat   dC*/d angle at 60°   saturation flat, at 60°, at 20°")
    for name, light in LIGHTS.items():
        color = color_of(orange, nm, light)
        curves[name] = np.asarray(jax.lax.map(color, jnp.radians(angles)))
        angle, slope = steepest_and_best(color)
        best[name] = float(np.degrees(angle))
        lightness, chroma = curves[name][:, 0], curves[name][:, 1]
        saturation = np.interp((180, 60, 20), angles, chroma / np.hypot(chroma, lightness))
        print(
            f"{name:15} {float(color(jnp.asarray(angle))[1]):10.3f} {best[name]:9.3f}° {chroma[-1]:9.3f} "
            f"{slope:12.4f} per °        {saturation[0]:.3f}, {saturation[1]:.3f}, {saturation[2]:.3f}"
        )
    write_figure(lambda: draw(curves, best, angles), outdir / "most_saturated_fold.png")
    looks = [target.Look(illumination=light) for light in LIGHTS.values()] + [target.Look(np.radians(60.0))]
    scene = vc.Scene(vc.VGrooves(1.0), vc.Lambertian(orange), vc.Diffuse(), vc.View())
    reachable_colors(scene, looks, wavelengths_nm=nm).plot(outdir / "reachable_colors.png")
    print(f"wrote {outdir / 'most_saturated_fold.png'} and {outdir / 'reachable_colors.png'}")


if __name__ == "__main__":
    main()
