"""PF4-6: bi-hemispherical reflectance of grooved aluminum, in order and at random."""

from common import Claim, Real
from sheets import AT_550_NM, metal_plate


def claims(in_order: Real, random: Real) -> list[Claim]:
    """What the thesis says of it."""
    last = 100 * in_order[-2:, AT_550_NM]
    return [
        Claim(
            "higher at 150° (91.0 %) than flat (90.9 %)",
            f"{last[0]:.2f} % and {last[1]:.2f} %",
            bool(last[0] > last[1]),
        ),
    ]


PLATE = metal_plate(
    "PF4-6", "Al-Rakic", "Aluminum, all grooves alike and at random", (77.1, 82.2, 87.4, 90.2, 91.0, 90.9), claims
)

if __name__ == "__main__":
    PLATE.run()
