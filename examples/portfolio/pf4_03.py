"""PF4-3: bi-hemispherical reflectance of grooved copper, in order and at random."""

import numpy as np
from common import Claim, Real, chroma, hue_deg, lab
from sheets import metal_plate


def claims(in_order: Real, random: Real) -> list[Claim]:
    """What the thesis says of it."""
    hue, color = hue_deg(lab(in_order)), chroma(lab(random))
    return [
        Claim(
            "the hue of copper remains unchanged", f"{hue.min():.1f}° to {hue.max():.1f}°", float(np.ptp(hue)) < 5
        ),
        Claim(
            "roughness raises its chroma",
            f"C* {color[0]:.1f} at m = 0.05, {color[-1]:.1f} at m = 2",
            bool(color[-1] > color[0]),
        ),
    ]


PLATE = metal_plate(
    "PF4-3", "Cu-Johnson", "Copper, all grooves alike and at random", (33.9, 42.8, 54.4, 61.2, 63.9, 64.6), claims
)

if __name__ == "__main__":
    PLATE.run()
