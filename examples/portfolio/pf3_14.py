"""PF3-14: two metamers, flat and folded to 45°, in frontal and diffuse light of equal energy."""

from common import (
    DIFFUSE,
    FRONTAL,
    POSITIONS,
    WAVELENGTHS_NM,
    Claim,
    Plate,
    along,
    chroma,
    difference,
    draw_strip,
    hue_deg,
    if_alike,
    ink,
    lab,
    seen,
    sheet,
)
from folded_metamers import metamer
from matplotlib.figure import Figure

import vcavity_jax as vc

ANGLE_DEG = 45


def make() -> tuple[Figure, list[Claim]]:
    """Left frontal, right diffuse light: bands, ΔE00 along the panel, spectra."""
    first = ink("bluish-green")
    flats = (first, metamer(first, WAVELENGTHS_NM, ANGLE_DEG, FRONTAL, "E"))
    figure = sheet(7.2, 6.0)
    rows = figure.subplots(4, 2, height_ratios=(1, 1, 3, 4))
    off_flat = float(difference(*(lab(flat, "E") for flat in flats)))
    off, inside, colors = {}, {}, {}
    for column, (name, light) in enumerate({"frontal": FRONTAL, "diffuse": DIFFUSE}.items()):
        bands = [along(vc.Lambertian(flat), ANGLE_DEG, light) for flat in flats]
        means = [seen(vc.Lambertian(flat), ANGLE_DEG, light) for flat in flats]
        for k, style in enumerate(("-", "--")):
            draw_strip(rows[k][column], bands[k], "E")
            rows[k][column].set(xticks=[], ylabel=("first", "second")[k])
            color = ("C4", "C2")[k]
            rows[3][column].plot(
                WAVELENGTHS_NM,
                flats[k],
                style,
                color=color,
                linewidth=0.8,
                label=f"{('first', 'second')[k]}, flat",
            )
            rows[3][column].plot(
                WAVELENGTHS_NM,
                means[k],
                style,
                color=color,
                linewidth=1.6,
                label=f"{('first', 'second')[k]}, folded",
            )
        half = [lab(band[len(POSITIONS) :], "E") for band in bands]
        inside[name] = difference(*half)
        colors[name] = [lab(mean, "E") for mean in means]
        off[name] = float(difference(*colors[name]))
        rows[2][column].plot(POSITIONS, inside[name], "k-")
        rows[2][column].set(xlabel="place on the panel, from the fold", ylabel="ΔE00", xlim=(0, 1), ylim=(0, None))
        rows[3][column].set(xlabel="wavelength (nm)", ylabel="reflectance factor", xlim=(400, 700), ylim=(0, None))
        rows[0][column].set_title(f"{name} light: ΔE00 {off_flat:.2f} flat, {off[name]:.2f} folded", loc="left")
    rows[3][0].legend(fontsize=7)
    greener = [float(hue_deg(c)) for c in colors["frontal"]]
    return figure, [
        Claim(
            "metamers (ΔE00 1.87 flat) become distinguishable: 4.7 folded in frontal, 4.2 in diffuse light",
            f"{off_flat:.2f} flat, {off['frontal']:.2f} in frontal, {off['diffuse']:.2f} in diffuse light",
            min(off.values()) > 1,
        ),
        Claim(
            "in diffuse light they are slightly less different",
            f"{off['diffuse']:.2f} against {off['frontal']:.2f}",
            off["diffuse"] < off["frontal"],
        ),
        Claim(
            "frontal light: most different near the fold",
            f"ΔE00 {inside['frontal'][0]:.1f} there, {inside['frontal'][-1]:.1f} at the rim, "
            f"at most {inside['frontal'].max():.1f} at {POSITIONS[inside['frontal'].argmax()]:.2f}",
            bool(inside["frontal"].argmax() < len(POSITIONS) // 3),
        ),
        Claim(
            "the first, of a sharper peak, becomes greener, the second stays bluer",
            f"hue {greener[0]:.0f}° and {greener[1]:.0f}° in frontal light, "
            f"C* {float(chroma(colors['frontal'][0])):.1f} and {float(chroma(colors['frontal'][1])):.1f}; "
            f"peaks of {flats[0].max():.2f} and {flats[1].max():.2f}",
            if_alike(greener[0] < greener[1] and flats[0].max() > flats[1].max()),
        ),
    ]


PLATE = Plate("PF3-14", "Two metamers, flat and folded to 45°", make)

if __name__ == "__main__":
    PLATE.run()
