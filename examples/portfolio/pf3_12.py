"""PF3-12: white grooves of 30° to 180° (for five sheets of paper) in frontal and diffuse light."""

from common import Claim, Real, chroma, if_alike, lab
from sheets import angles_plate, shift


def claims(spectra: dict[str, Real]) -> list[Claim]:
    """What the thesis says of it."""
    color = lab(spectra["frontal"])
    return [
        Claim(
            "frontal light: spectra of different angles cross, as their reflectance passes the threshold",
            f"this patch reaches {spectra['frontal'][-1].max():.3f}, just below 0.932",
            None,
        ),
        Claim(
            "frontal light: the chroma shifts, towards yellow, without a loss of lightness",
            shift(spectra["frontal"]),
            if_alike(bool(chroma(color[0]) > chroma(color[-1]) and color[0, 0] > color[-1, 0] - 1)),
        ),
        Claim(
            "diffuse light: the same shift of chroma, and darker",
            shift(spectra["diffuse"]),
            bool(chroma(lab(spectra["diffuse"]))[0] > chroma(lab(spectra["diffuse"]))[-1]),
        ),
    ]


PLATE = angles_plate("PF3-12", "white", "White grooves of 30° to 180° (for five sheets of paper)", claims)

if __name__ == "__main__":
    PLATE.run()
