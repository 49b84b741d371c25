"""PF4-4: bi-hemispherical reflectance of grooved gold, in order and at random."""

import numpy as np
from common import Claim, Real, chroma, hue_deg, lab
from sheets import metal_plate


def claims(in_order: Real, random: Real) -> list[Claim]:
    """What the thesis says of it."""
    hue, color = hue_deg(lab(in_order)), chroma(lab(random))
    return [
        Claim(
            "the hue of gold remains unchanged", f"{hue.min():.1f}° to {hue.max():.1f}°", float(np.ptp(hue)) < 5
        ),
        Claim(
            "roughness raises its chroma",
            f"C* {color[0]:.1f} at m = 0.05, {color[-1]:.1f} at m = 2",
            bool(color[-1] > color[0]),
        ),
    ]


PLATE = metal_plate(
    "PF4-4", "Au-McPeak", "Gold, all grooves alike and at random", (66.3, 72.9, 80.0, 83.6, 85.1, 85.4), claims
)

if __name__ == "__main__":
    PLATE.run()
