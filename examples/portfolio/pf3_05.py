"""PF3-5: facets of magenta grooves of seven dihedral angles, in frontal and diffuse light."""

import numpy as np
from common import DIFFUSE, FRONTAL, POSITIONS, WAVELENGTHS_NM, Claim, Plate, along, draw_strip, ink, seen, sheet
from matplotlib.figure import Figure

import vcavity_jax as vc

ANGLES_DEG = (30, 45, 60, 90, 120, 150, 180)


def make() -> tuple[Figure, list[Claim]]:
    """Spectra of all facets, and below them the band of color."""
    flat = ink("magenta")
    material = vc.Lambertian(flat)
    figure = sheet(7.2, 4.2)
    rows = figure.subplots(4, len(ANGLES_DEG), height_ratios=(4, 1, 4, 1), sharex="row", sharey="row")
    highest = {}
    for top, (name, light) in zip((0, 2), {"frontal": FRONTAL, "diffuse": DIFFUSE}.items(), strict=True):
        for column, angle in enumerate(ANGLES_DEG):
            across, mean = along(material, angle, light), seen(material, angle, light)
            highest[name, angle] = float((mean - flat).max())
            axes = rows[top][column]
            axes.plot(WAVELENGTHS_NM, across[:: len(POSITIONS) // 8].T, color="0.75", linewidth=0.4)
            axes.plot(WAVELENGTHS_NM, across[0], "k-", linewidth=0.8, label="rim")
            axes.plot(WAVELENGTHS_NM, across[len(POSITIONS) - 1], "k--", linewidth=0.8, label="fold")
            axes.plot(WAVELENGTHS_NM, flat, "--", color="C6", linewidth=0.8, label="flat")
            axes.plot(WAVELENGTHS_NM, mean, "-", color="C3", linewidth=0.8, label="mean")
            axes.set(title=f"{angle}°", xticks=(450, 650), ylim=(0, 1.2))
            draw_strip(rows[top + 1][column], across)
            rows[top + 1][column].set(xticks=[])
        rows[top][0].set_ylabel(f"{name} light\nradiance factor")
    figure.supxlabel("wavelength (nm); below: the groove from rim to rim", fontsize=8)
    handles, names = rows[0][0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=4)
    white = {a: float(seen(vc.Lambertian(np.ones(1)), a, FRONTAL)[0]) for a in ANGLES_DEG}
    darker = max(v for (name, angle), v in highest.items() if name == "diffuse" and angle < 180)
    return figure, [
        Claim(
            "frontal light: the mean exceeds 1 at 45° or less",
            "at reflectance 1 it does at every angle: "
            + ", ".join(f"{v:.4f} at {a}°" for a, v in white.items() if a < 180),
            False,
        ),
        Claim(
            "diffuse light: always lower than the flat surface, and the facets spread as the groove closes",
            f"largest excess of the mean {darker:.4f}",
            darker < 0,
        ),
    ]


PLATE = Plate("PF3-5", "Facets of magenta grooves of seven dihedral angles", make)

if __name__ == "__main__":
    PLATE.run()
