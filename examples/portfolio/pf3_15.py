"""PF3-15: grooves of 45° with one cyan and one yellow panel, alternating or not, in four lights."""

import numpy as np
from common import (
    DIFFUSE,
    FRONTAL,
    OBLIQUE,
    WAVELENGTHS_NM,
    Claim,
    Plate,
    chroma,
    graded,
    hue_deg,
    if_alike,
    ink,
    lab,
    seen,
    shade,
    sheet,
)
from matplotlib.figure import Figure

import vcavity_jax as vc

VIEWS_DEG = np.arange(-75.0, 76.0, 15.0)
LIGHTS = {"frontal": FRONTAL, "45°": OBLIQUE, "-45°": vc.Directional(-np.radians(45.0), 0.0), "diffuse": DIFFUSE}
AT_700 = -1


def make() -> tuple[Figure, list[Claim]]:
    """Top row: cyan always on the left; bottom row: on either side in turn."""
    cyan, yellow = vc.Lambertian(ink("cyan")), vc.Lambertian(ink("yellow"))
    figure = sheet(7.2, 5.0)
    rows = figure.subplots(4, 4, height_ratios=(1, 5, 1, 5), sharey="row")
    found = {}
    middle = len(VIEWS_DEG) // 2
    for k, alternating in enumerate((False, True)):
        for column, (name, light) in enumerate(LIGHTS.items()):
            factors = seen(vc.TwoPanels(cyan, yellow, alternating=alternating), 45, light, VIEWS_DEG)
            found[name, alternating] = factors
            strip, axes = rows[2 * k][column], rows[2 * k + 1][column]
            strip.imshow(shade(factors)[None], aspect="auto", extent=(-82.5, 82.5, 0, 1))
            strip.set(yticks=[], xticks=(-60, 0, 60), title=f"{name} light" if not k else "")
            for view, color in zip(range(middle + 1), graded(middle + 1), strict=True):
                axes.plot(
                    WAVELENGTHS_NM,
                    factors[middle + view],
                    "-",
                    color=color,
                    linewidth=0.8,
                    label=f"{VIEWS_DEG[middle + view]:.0f}°",
                )
                axes.plot(WAVELENGTHS_NM, factors[middle - view], ":", color=color, linewidth=0.8)
            axes.set(xticks=(450, 650), ylim=(0, 0.7 if k else 1.3))
        rows[2 * k + 1][0].set_ylabel(
            "alternating sides\nreflectance factor" if k else "cyan left\nreflectance factor"
        )
    figure.supxlabel("wavelength (nm); above each: the color against the view (°)", fontsize=8)
    handles, names = rows[1][0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=6, title="view; dotted: from the other side")
    color = {key: lab(value) for key, value in found.items()}
    front = color["frontal", False]
    even = max(float(np.abs(found[n, True] - found[n, True][::-1]).max()) for n in ("frontal", "diffuse"))
    grazing = {n: float(found[n, False][0, AT_700]) for n in ("frontal", "diffuse")}
    hues = [float(hue_deg(front[k])) for k in (0, middle, -1)]
    sides = [float(chroma(color[n, False][k])) for n, k in (("45°", -1), ("frontal", -1))]
    return figure, [
        Claim(
            "cyan left, frontal light: a greenish mix where all is seen, cyan or yellow once masking sets in",
            f"hue {hues[1]:.0f}° from the front, {hues[2]:.0f}° from 75° and {hues[0]:.0f}° from -75°",
            bool(100 < hues[1] < 210 and hues[2] > 200 and hues[0] < 120),
        ),
        Claim(
            "lit from 45°: the cyan panel, more saturated than in frontal light",
            f"C* from 75° {sides[0]:.1f}; {sides[1]:.1f} in frontal light",
            sides[0] > sides[1],
        ),
        Claim(
            "alternating sides: the same from both sides",
            f"largest difference {even:.0e} in frontal and diffuse light",
            even < 1e-5,
        ),
        Claim(
            "yellow seen from -75°: 0.6 to 0.7 in diffuse, about 0.4 in frontal light",
            f"{grazing['diffuse']:.2f} and {grazing['frontal']:.2f} at 700 nm",
            if_alike(bool(0.55 < grazing["diffuse"] < 0.75 and grazing["frontal"] < 0.5)),
        ),
    ]


PLATE = Plate("PF3-15", "One cyan and one yellow panel", make)

if __name__ == "__main__":
    PLATE.run()
