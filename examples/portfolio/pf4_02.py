"""PF4-2: copper and gold grooves in diffuse light, seen frontally and obliquely, across and along the grooves."""

import numpy as np
from common import DIFFUSE, WAVELENGTHS_NM, Claim, Plate, Real, chroma, graded, lab, seen, shade, sheet
from matplotlib.figure import Figure
from sheets import AT_550_NM, MIRROR_ANGLES_DEG, metal_index

import vcavity_jax as vc

METALS = {"copper": "Cu-Johnson", "gold": "Au-Johnson"}
VIEWS = {
    "frontal": (0.0, 0.0, "-", "o"),
    "45° across": (45.0, 0.0, "--", "^"),
    "45° along": (45.0, 90.0, ":", "X"),
}


def make() -> tuple[Figure, list[Claim]]:
    """Spectra above, L*C* below."""
    figure = sheet(7.2, 5.4)
    rows = figure.subplots(2, 2)
    found: dict[tuple[str, str], Real] = {}
    for column, (metal, table) in enumerate(METALS.items()):
        material = vc.Specular(metal_index(table))
        for view, (polar, azimuth, dash, marker) in VIEWS.items():
            factors = np.stack([seen(material, angle, DIFFUSE, polar, azimuth) for angle in MIRROR_ANGLES_DEG])
            found[metal, view] = factors
            for angle, spectrum, color in zip(
                MIRROR_ANGLES_DEG, factors, graded(len(MIRROR_ANGLES_DEG)), strict=True
            ):
                label = f"{angle}°" if view == "frontal" else None
                rows[0][column].plot(WAVELENGTHS_NM, spectrum, dash, color=color, linewidth=0.9, label=label)
            color = lab(factors)
            rows[1][column].scatter(
                chroma(color),
                color[:, 0],
                c=shade(factors),
                marker=marker,
                s=26,
                edgecolors="black",
                linewidths=0.5,
                label=view,
            )
        rows[0][column].set(xlabel="wavelength (nm)", ylabel="reflectance factor", xlim=(400, 700), ylim=(0, 1))
        rows[0][column].set_title(f"{metal} ({table})", loc="left")
        rows[1][column].set(xlabel="C*", ylabel="L*")
    rows[0][0].legend(
        fontsize=7,
        ncols=2,
        loc="upper left",
        title="dashed: across, dotted: along",
        title_fontsize=7,
    )
    rows[1][0].legend(fontsize=7)
    at = {angle: k for k, angle in enumerate(MIRROR_ANGLES_DEG)}
    copper = {view: found["copper", view] for view in VIEWS}
    flat = float(np.abs(copper["45° across"][at[90]] - copper["45° across"][at[180]]).max())
    normal = float(np.abs(copper["45° across"][at[90]] - copper["frontal"][at[180]]).max())
    along = float(np.abs(copper["45° along"][at[60]] - copper["frontal"][at[60]]).max())
    higher = copper["45° across"][at[90]] - copper["45° across"][at[120]]
    color = {metal: chroma(lab(found[metal, "frontal"])) for metal in METALS}
    fall = {
        metal: 1 - found[metal, "frontal"][0, AT_550_NM] / found[metal, "frontal"][-1, AT_550_NM]
        for metal in METALS
    }
    return figure, [
        Claim(
            "90° seen at 45° across the grooves cannot be told from flat: one reflection, at normal incidence",
            f"within {normal:.0e} of the flat surface seen frontally, {flat:.3f} of it seen at 45°",
            normal < 1e-4,
        ),
        Claim(
            "seen so, 90° is higher than 120°",
            f"by {higher.min():.3f} to {higher.max():.3f} for copper",
            bool(higher.min() > 0),
        ),
        Claim(
            "60°: frontal and 45° along the grooves coincide", f"up to {along:.3f} apart for copper", along < 0.01
        ),
        Claim(
            "the narrower the grooves, the higher the chroma",
            "; ".join(
                f"{m}, frontal, 45° to 180°: C* {', '.join(f'{v:.2f}' for v in c)}" for m, c in color.items()
            ),
            all(bool((np.diff(c) < 0.2).all()) for c in color.values()),
        ),
        Claim(
            "gold loses less lightness than copper",
            "; ".join(f"{m} loses {100 * f:.0f} % at 550 nm" for m, f in fall.items()),
            bool(fall["gold"] < fall["copper"]),
        ),
    ]


PLATE = Plate("PF4-2", "Copper and gold grooves in diffuse light", make)

if __name__ == "__main__":
    PLATE.run()
