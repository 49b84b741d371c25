"""PF3-10: orange grooves of 30° to 180° in frontal and diffuse light."""

from common import Claim, Real, chroma, hue_deg, if_alike, lab
from sheets import angles_plate, shift


def claims(spectra: dict[str, Real]) -> list[Claim]:
    """What the thesis says of it."""
    claims = []
    for light, s in spectra.items():
        color = lab(s)
        turn = float((hue_deg(color[0]) - hue_deg(color[-1]) + 180) % 360 - 180)
        claims += [
            Claim(
                f"{light} light: L* falls, C* rises a little as the groove closes",
                shift(s),
                if_alike(bool(chroma(color[0]) > chroma(color[-1]))),
            ),
            Claim(f"{light} light: it becomes redder", f"hue {turn:+.1f}° from flat to 30°", turn < 0),
        ]
    return claims


PLATE = angles_plate("PF3-10", "orange", "Orange grooves of 30° to 180°", claims)

if __name__ == "__main__":
    PLATE.run()
