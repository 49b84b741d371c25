"""PF3-13: all colors of the folded inks together, in frontal and diffuse light."""

from common import ANGLES_DEG, Claim, Plate, draw_colors, hue_deg, ink, lab, sheet
from matplotlib.figure import Figure
from sheets import over_angles

PATCHES = ("magenta", "cyan", "yellow", "green", "orange", "neutral-8", "white")


def make() -> tuple[Figure, list[Claim]]:
    """a*b*, left in frontal, right in diffuse light."""
    figure = sheet(7.2, 3.7)
    axes = dict(zip(("frontal", "diffuse"), figure.subplots(1, 2, sharex=True, sharey=True), strict=True))
    labels = ["30°", *[""] * (len(ANGLES_DEG) - 2), ""]
    turns: dict[str, dict[str, float]] = {}
    for patch in PATCHES:
        for light, spectra in over_angles(ink(patch)).items():
            draw_colors(axes[light], spectra, "ab", labels)
            hue = hue_deg(lab(spectra))
            turns.setdefault(patch, {})[light] = float((hue[0] - hue[-1] + 180) % 360 - 180)
    for light, one in axes.items():
        one.set_title(f"{light} light", loc="left")
        one.axhline(0, color="0.8", linewidth=0.5, zorder=0)
        one.axvline(0, color="0.8", linewidth=0.5, zorder=0)
    colored = PATCHES[:5]
    apart = max(abs(turns[p]["frontal"] - turns[p]["diffuse"]) for p in colored)
    told = ", ".join(f"{p} {turns[p]['frontal']:+.1f}° / {turns[p]['diffuse']:+.1f}°" for p in colored)
    red = turns["orange"]["frontal"] < 0 < turns["magenta"]["frontal"]
    return figure, [
        Claim(
            "the light hardly matters for how the hue turns as the groove closes",
            f"from flat to 30°, frontal / diffuse: {told}",
            apart < 5,
        ),
        Claim("orange and magenta become redder", "see the turns above", bool(red)),
        Claim("cyan becomes bluer", f"hue {turns['cyan']['frontal']:+.1f}°", turns["cyan"]["frontal"] > 0),
        Claim(
            "green almost keeps its hue",
            f"hue {turns['green']['frontal']:+.1f}°",
            abs(turns["green"]["frontal"]) < 5,
        ),
    ]


PLATE = Plate("PF3-13", "All folded inks together", make)

if __name__ == "__main__":
    PLATE.run()
