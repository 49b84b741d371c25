"""Halftones for grooved prints: the coverage that makes a ridged surface match a flat proof.

    python examples/proof_and_groove.py [OUTDIR]

writes proof_and_groove.png into OUTDIR (a new temporary folder by default) and prints a table. Cyan is printed
as a halftone under a smooth interface [ClapperYule1953; SaintPierre2020, section 5.5]. Ridges of 2.5D prints
darken it: dots must be smaller to look as on the flat proof, in diffuse light, in frontal light, or in both as
well as they can be together.
"""

import argparse
import tempfile
from pathlib import Path

import jax
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

jax.config.update("jax_enable_x64", True)

import vcavity_jax as vc  # noqa: E402
from fitting import design, free, read_spectrum, target  # noqa: E402
from fitting.plots import write_figure  # noqa: E402
from vcavity_jax import colorimetry  # noqa: E402

DATA = Path(__file__).parent / "data"
ANGLE_DEG = 100.0
COVERAGES = np.linspace(0.2, 0.9, 8)
LIGHTS = {"diffuse": vc.Diffuse(), "frontal": vc.Directional(0.0, 0.0)}
WISHES = {"diffuse": ("diffuse",), "frontal": ("frontal",), "both": ("diffuse", "frontal")}


def main() -> None:
    """A tone curve for each light and for both."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("outdir", nargs="?", type=Path)
    outdir = parser.parse_args().outdir or Path(tempfile.mkdtemp())
    outdir.mkdir(parents=True, exist_ok=True)
    nm, cyan, _ = read_spectrum(DATA / "flat-cyan.csv")
    _, paper, _ = read_spectrum(DATA / "flat-white.csv")
    # An ink that makes this paper as cyan as the patch: light passes it twice.
    ink = np.sqrt(np.minimum(cyan / paper, 1.0))
    white = colorimetry.white(nm)

    def printed(coverage: float, angle_deg: float, light: str) -> vc.Scene:
        material = vc.InterfacedLambertian(paper, 1.5, vc.Halftone(coverage, ink), specular_included=False)
        return vc.Scene(vc.VGrooves(np.radians(angle_deg)), material, LIGHTS[light], vc.View())

    def lab(scene: vc.Scene) -> np.ndarray:
        return np.asarray(colorimetry.lab(colorimetry.xyz(vc.reflectance_factor(scene, 1e-6), nm), white))

    looks = {light: target.Look(illumination=LIGHTS[light]) for light in LIGHTS}
    found: dict[str, list[float]] = {wish: [] for wish in WISHES}
    left: dict[str, list[float]] = {wish: [] for wish in WISHES}
    before = []
    print(f"grooves of {ANGLE_DEG:g}°: coverage for the same look as a flat proof, and the ΔE00 that is left")
    print("proof   unchanged   in diffuse light   in frontal light   in both")
    for proof in COVERAGES:
        flat = {light: lab(printed(proof, 180.0, light)) for light in LIGHTS}
        unchanged = [
            float(colorimetry.delta_e_2000(flat[light], lab(printed(proof, ANGLE_DEG, light)))) for light in LIGHTS
        ]
        before.append(max(unchanged))
        for wish, lights in WISHES.items():
            best = design(
                printed(0.5, ANGLE_DEG, "diffuse"),
                [free.coverage()],
                [target.color(flat[light], looks[light]) for light in lights],
                wavelengths_nm=nm,
                starts=4,
            ).best
            found[wish].append(best.values["coverage"])
            left[wish].append(max(best.reached))
        told = "".join(f"   {found[w][-1]:.3f} ({left[w][-1]:.2f})  " for w in WISHES)
        print(f"{proof:.2f}      {before[-1]:6.2f}    {told}")

    def draw() -> Figure:
        figure = Figure(figsize=(6.4, 2.8), layout="constrained")
        FigureCanvasAgg(figure)
        axes, errors = figure.subplots(1, 2)
        for wish, style in zip(WISHES, ("k-", "k--", "k:"), strict=True):
            axes.plot(
                COVERAGES,
                100 * (np.array(found[wish]) - COVERAGES),
                style,
                label=f"{wish} light" if wish != "both" else "both lights",
            )
            errors.plot(COVERAGES, left[wish], style)
        errors.plot(COVERAGES, before, "-", color="#D55E00", label="proof's own coverage")
        axes.set(xlabel="coverage of the flat proof", ylabel="change on the grooves (points)", xlim=(0, 1))
        axes.set_ylim(top=0)
        errors.set(xlabel="coverage of the flat proof", ylabel="ΔE00 that is left", xlim=(0, 1), ylim=(0, None))
        axes.legend(fontsize=7)
        errors.legend(fontsize=7)
        return figure

    write_figure(draw, outdir / "proof_and_groove.png")
    print(f"wrote {outdir / 'proof_and_groove.png'}")


if __name__ == "__main__":
    main()
