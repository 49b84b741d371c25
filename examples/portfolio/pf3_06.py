"""PF3-6: magenta grooves of 30° to 180° in frontal and diffuse light."""

from common import Claim, Real, hue_deg, if_alike, lab
from sheets import angles_plate, shift


def claims(spectra: dict[str, Real]) -> list[Claim]:
    """What the thesis says of it."""
    first, flat = lab(spectra["frontal"][0]), lab(spectra["frontal"][-1])
    turn = abs((hue_deg(first) - hue_deg(flat) + 180) % 360 - 180)
    return [
        Claim(
            "frontal light: spectra of different angles cross where little is absorbed",
            f"it takes a reflectance above 0.932; this patch reaches {spectra['frontal'][-1].max():.2f}",
            None,
        ),
        Claim(
            "frontal light: L* drops much, C* changes little, the hue turns much",
            shift(spectra["frontal"]),
            if_alike(bool(turn > 10)),
        ),
        Claim("diffuse light: comparable, and less saturated", shift(spectra["diffuse"]), None),
    ]


PLATE = angles_plate("PF3-6", "magenta", "Magenta grooves of 30° to 180°", claims)

if __name__ == "__main__":
    PLATE.run()
