"""PF4-5: bi-hemispherical reflectance of grooved silver, in order and at random."""

import numpy as np
from common import Claim, Real, lab
from sheets import metal_plate


def claims(in_order: Real, random: Real) -> list[Claim]:
    """What the thesis says of it."""
    yellow = lab(in_order)[:, 2]
    return [
        Claim(
            "silver is yellowish, the more the narrower the grooves",
            f"b* {yellow[-1]:.1f} flat, {yellow[0]:.1f} at 45°",
            bool((np.diff(yellow) < 0).all()),
        )
    ]


PLATE = metal_plate(
    "PF4-5", "Ag-McPeak", "Silver, all grooves alike and at random", (89.7, 92.1, 94.4, 95.6, 96.0, 96.1), claims
)

if __name__ == "__main__":
    PLATE.run()
