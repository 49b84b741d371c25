"""One color from the left, another from the right: the two panels of a groove, designed.

    python examples/two_faced_groove.py [OUTDIR]

writes two_faced_groove.png into OUTDIR (a new temporary folder by default) and prints the design. Smooth
reflectances of both panels and the dihedral angle are sought so that the surface is blue from 50 degrees on one
side and orange from the other, in diffuse light [SaintPierre2020, section 3.9]. Each panel lights the other one
with its own color, so inks that are right on flat sheets are wrong in a groove: what they give is shown beside.
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
from fitting import Design, design, free, target  # noqa: E402
from fitting.plots import write_figure  # noqa: E402
from vcavity_jax import colorimetry  # noqa: E402

NM = np.arange(400.0, 701.0, 10.0)
WHITE = colorimetry.white(NM)
ORANGE, BLUE = (62.0, 25.0, 40.0), (52.0, -10.0, -32.0)
LEFT, RIGHT = target.Look(np.radians(50.0)), target.Look(np.radians(-50.0))


def scene(first: np.ndarray, second: np.ndarray, angle_deg: float, views_deg: np.ndarray) -> vc.Scene:
    """Two panels in diffuse light."""
    material = vc.TwoPanels(vc.Lambertian(first), vc.Lambertian(second))
    return vc.Scene(
        vc.VGrooves(np.radians(angle_deg)), material, vc.Diffuse(), vc.View(np.radians(views_deg), 0.0)
    )


def designed() -> Design:
    """Both panels and the angle."""
    gray = np.full(NM.size, 0.4)
    return design(
        scene(gray, gray, 90.0, np.zeros(1)),
        [
            free.angle(60, 130),
            free.reflectance(where=lambda s: s.material.first.reflectance, name="first", smooth_nm=60),
            free.reflectance(where=lambda s: s.material.second.reflectance, name="second", smooth_nm=60),
        ],
        [
            target.color(BLUE, LEFT, name="blue from 50°"),
            target.color(ORANGE, RIGHT, name="orange from -50°"),
            target.different(LEFT, RIGHT, least=40.0, name="both sides differ"),
        ],
        wavelengths_nm=NM,
        starts=4,
    )


def flat_match(lab: tuple[float, float, float]) -> np.ndarray:
    """A reflectance whose flat sheet has the color: what one would print without a model of grooves."""
    found = design(
        vc.Scene(vc.VGrooves(np.pi), vc.Lambertian(np.full(NM.size, 0.4)), vc.Diffuse(), vc.View()),
        [free.reflectance(smooth_nm=60)],
        [target.color(lab)],
        wavelengths_nm=NM,
        starts=2,
    )
    return found.best.spectra["reflectance"]


def lab_of(factors: np.ndarray) -> np.ndarray:
    """L*, a*, b*."""
    return np.asarray(colorimetry.lab(colorimetry.xyz(factors, NM), WHITE))


def draw(
    panels: dict[str, tuple[np.ndarray, np.ndarray]], seen: dict[str, np.ndarray], views: np.ndarray
) -> Figure:
    """Reflectances of the panels, and the color from everywhere."""
    figure = Figure(figsize=(7.0, 3.0), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, width_ratios=(1, 1.2))
    for (name, both), dash in zip(panels.items(), ("-", "--"), strict=True):
        for values, color, side in zip(both, ("#0072B2", "#D55E00"), ("blue", "orange"), strict=True):
            left.plot(NM, values, dash, color=color, label=f"{side} panel, {name}")
    left.set(xlabel="wavelength (nm)", ylabel="reflectance", xlim=(400, 700), ylim=(0, 1))
    left.legend(fontsize=7)
    shown = [
        np.asarray(colorimetry.srgb(colorimetry.xyz(factors, NM), WHITE, clip=True)) for factors in seen.values()
    ]
    right.imshow(np.stack(shown), aspect="auto", extent=(views[0], views[-1], len(shown) - 0.5, -0.5))
    right.set(xlabel="view (°)", yticks=range(len(seen)), yticklabels=list(seen), xticks=(-60, -30, 0, 30, 60))
    return figure


def main() -> None:
    """Design, compare and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("outdir", nargs="?", type=Path)
    outdir = parser.parse_args().outdir or Path(tempfile.mkdtemp())
    outdir.mkdir(parents=True, exist_ok=True)
    found = designed()
    print(found.summary())
    angle = float(np.degrees(found.best.values["angle"]))
    panels = {
        "designed": (found.best.spectra["first"], found.best.spectra["second"]),
        "as flat sheets": (flat_match(BLUE), flat_match(ORANGE)),
    }
    views = np.linspace(-80, 80, 81)
    seen = {name: np.asarray(vc.reflectance_factor(scene(*both, angle, views))) for name, both in panels.items()}
    for name, factors in seen.items():
        off = [
            float(colorimetry.delta_e_2000(np.array(wish), lab_of(factors[np.argmin(np.abs(views - view))])))
            for wish, view in ((BLUE, 50.0), (ORANGE, -50.0))
        ]
        print(f"{name}: ΔE00 {off[0]:.2f} from blue, {off[1]:.2f} from orange")
    write_figure(lambda: draw(panels, seen, views), outdir / "two_faced_groove.png")
    print(f"wrote {outdir / 'two_faced_groove.png'}")


if __name__ == "__main__":
    main()
