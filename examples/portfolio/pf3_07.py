"""PF3-7: cyan grooves of 30° to 180° in frontal and diffuse light."""

from common import Claim, Real, difference, if_alike, lab
from sheets import angles_plate


def claims(spectra: dict[str, Real]) -> list[Claim]:
    """What the thesis says of it."""
    off = {light: float(difference(lab(s[0]), lab(s[-1]))) for light, s in spectra.items()}
    return [
        Claim(
            "frontal light: all grooves are darker than the flat surface",
            f"largest excess {(spectra['frontal'][:-1] - spectra['frontal'][-1]).max():.4f}",
            bool((spectra["frontal"][:-1] < spectra["frontal"][-1]).all()),
        ),
        Claim(
            "the difference between 30° and flat exceeds 20",
            f"ΔE00 {off['frontal']:.1f} in frontal, {off['diffuse']:.1f} in diffuse light",
            if_alike(min(off.values()) > 20),
        ),
    ]


PLATE = angles_plate("PF3-7", "cyan", "Cyan grooves of 30° to 180°", claims)

if __name__ == "__main__":
    PLATE.run()
