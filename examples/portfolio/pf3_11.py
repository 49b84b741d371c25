"""PF3-11: gray grooves of 30° to 180° (for the single sheet of paper) in frontal and diffuse light."""

from common import Claim, Real, difference, lab
from sheets import angles_plate, shift


def claims(spectra: dict[str, Real]) -> list[Claim]:
    """What the thesis says of it."""
    off = {light: float(difference(lab(s[0]), lab(s[-1]))) for light, s in spectra.items()}
    return [
        Claim(
            "frontal light: not reflective enough for strong interreflections, darker",
            shift(spectra["frontal"]),
            bool((spectra["frontal"][:-1] < spectra["frontal"][-1]).all()),
        ),
        Claim(
            "diffuse light: the difference from flat spreads further",
            f"ΔE00 at 30° {off['diffuse']:.1f}; in frontal light {off['frontal']:.1f}",
            off["diffuse"] > off["frontal"],
        ),
    ]


PLATE = angles_plate("PF3-11", "neutral-8", "Gray grooves of 30° to 180° (for the single sheet of paper)", claims)

if __name__ == "__main__":
    PLATE.run()
