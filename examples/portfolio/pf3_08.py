"""PF3-8: yellow grooves of 30° to 180° in frontal and diffuse light."""

from common import ANGLES_DEG, Claim, Real, chroma, difference, if_alike, ink, lab
from sheets import angles_plate, over_angles, shift


def claims(spectra: dict[str, Real]) -> list[Claim]:
    """What the thesis says of it."""
    other = over_angles(ink("cyan"))["frontal"]
    mine, theirs = (float(difference(lab(s[0]), lab(s[-1]))) for s in (spectra["frontal"], other))
    color = chroma(lab(spectra["frontal"]))
    return [
        Claim(
            "frontal light: the chroma increases by interreflections",
            f"C* {color[-1]:.1f} flat, at most {color.max():.1f} at {ANGLES_DEG[color.argmax()]}°, "
            f"{color[0]:.1f} at 30°; this patch reaches a reflectance of {spectra['frontal'][-1].max():.2f}",
            if_alike(bool(color.max() > color[-1] + 0.5)),
        ),
        Claim(
            "the difference from flat is smaller than for cyan",
            f"ΔE00 at 30° {mine:.1f}; cyan {theirs:.1f}",
            mine < theirs,
        ),
        Claim("diffuse light: little altered", shift(spectra["diffuse"]), None),
    ]


PLATE = angles_plate("PF3-8", "yellow", "Yellow grooves of 30° to 180°", claims)

if __name__ == "__main__":
    PLATE.run()
