"""PF3-9: green grooves of 30° to 180° in frontal and diffuse light."""

from common import Claim, Real, hue_deg, lab
from sheets import angles_plate, shift


def claims(spectra: dict[str, Real]) -> list[Claim]:
    """What the thesis says of it."""
    turns = {}
    for light, s in spectra.items():
        first, flat = lab(s[0]), lab(s[-1])
        turns[light] = float((hue_deg(first) - hue_deg(flat) + 180) % 360 - 180)
    return [
        Claim(
            "as cyan, but its hue hardly changes",
            f"hue {turns['frontal']:+.1f}° in frontal, {turns['diffuse']:+.1f}° in diffuse light",
            max(abs(t) for t in turns.values()) < 5,
        ),
        Claim(
            "frontal light: darker",
            shift(spectra["frontal"]),
            bool((spectra["frontal"][:-1] < spectra["frontal"][-1]).all()),
        ),
    ]


PLATE = angles_plate("PF3-9", "green", "Green grooves of 30° to 180°", claims)

if __name__ == "__main__":
    PLATE.run()
