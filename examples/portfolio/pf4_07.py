"""PF4-7: bi-hemispherical reflectance of grooved silicon, in order and at random."""

from common import Claim, Real, lab
from sheets import metal_plate


def claims(in_order: Real, random: Real) -> list[Claim]:
    """What the thesis says of it."""
    light = lab(in_order)[:, 0]
    return [
        Claim(
            "silicon loses much lightness",
            f"L* {light[-1]:.1f} flat, {light[0]:.1f} at 45°",
            bool(light[0] < light[-1] - 20),
        ),
    ]


PLATE = metal_plate(
    "PF4-7",
    "Si-Green-2008",
    "Silicon, all grooves alike and at random",
    (11.0, 16.6, 26.4, 34.0, 36.8, 37.3),
    claims,
)

if __name__ == "__main__":
    PLATE.run()
