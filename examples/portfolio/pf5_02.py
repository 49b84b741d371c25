"""PF5-2: the colors along a magenta groove of 45° by the index of its interface."""

from common import (
    FRONTAL,
    POSITIONS,
    Claim,
    Plate,
    along,
    chroma,
    difference,
    if_alike,
    ink,
    lab,
    shade,
    sheet,
)
from matplotlib.figure import Figure
from pf5_01 import ANGLE_DEG, INDICES, LIMIT, material
from thesis_chapter5 import intrinsic


def make() -> tuple[Figure, list[Claim]]:
    """Left L*C* of all places, right ΔE00 from the groove without interface."""
    magenta = ink("magenta")
    half = {
        "same intrinsic reflectance": {
            n: along(material(magenta, n), ANGLE_DEG, FRONTAL)[len(POSITIONS) :] for n in INDICES
        },
        "same flat sample": {
            n: along(material(intrinsic(magenta, n), n), ANGLE_DEG, FRONTAL)[len(POSITIONS) :] for n in INDICES
        },
    }
    figure = sheet(7.2, 3.5)
    left, right = figure.subplots(1, 2)
    first = half["same intrinsic reflectance"]
    for (n, spectra), marker in zip(first.items(), "so^", strict=True):
        color = lab(spectra)
        left.scatter(
            chroma(color),
            color[:, 0],
            c=shade(spectra),
            marker=marker,
            s=16,
            edgecolors="black",
            linewidths=0.4,
            label=f"n = {n:g}",
        )
    left.set(xlabel="C*", ylabel="L*")
    left.legend()
    far = POSITIONS > LIMIT
    mean: dict[tuple[str, float], tuple[float, float]] = {}
    for (name, found), dash in zip(half.items(), ("-", "--"), strict=True):
        for n, color in ((1.33, "C0"), (1.5, "C3")):
            off = difference(lab(found[n]), lab(first[1.0]))
            mean[name, n] = float(off[far].mean()), float(off[~far].mean())
            right.plot(POSITIONS, off, dash, color=color, label=f"n = {n:g}, {name}")
    right.axvline(LIMIT, color="0.7", linewidth=0.8, linestyle=":")
    right.set(xlabel="place on the panel, from the fold", ylabel="ΔE00 from n = 1", xlim=(0, 1), ylim=(0, None))
    figure.legend(*right.get_legend_handles_labels(), loc="outside lower right", ncols=2, fontsize=7)
    told = "; ".join(f"n = {n:g}, {name}: {a:.1f} above, {b:.1f} below" for (name, n), (a, b) in mean.items())
    return figure, [
        Claim(
            "above y = 0.414 the difference averages 2.5 for n = 1.33 and for 1.5",
            told,
            if_alike(all(abs(a - 2.5) < 0.5 for a, _ in mean.values())),
        ),
        Claim(
            "it is smaller near the fold, where one mirror reflection comes in",
            "see above",
            all(b < a for a, b in mean.values()),
        ),
        Claim(
            "it decreases from n = 1.33 to 1.5 near the fold",
            ", ".join(f"{name}: {mean[name, 1.33][1]:.1f} to {mean[name, 1.5][1]:.1f}" for name in half),
            all(mean[name, 1.5][1] < mean[name, 1.33][1] for name in half),
        ),
    ]


PLATE = Plate("PF5-2", "Colors along a magenta groove by the index of its interface", make)

if __name__ == "__main__":
    PLATE.run()
