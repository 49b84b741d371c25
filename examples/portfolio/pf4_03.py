"""PF4-3: bi-hemispherical reflectance of grooved copper, in order and at random."""

from sheets import colored_metal, metal_plate

PLATE = metal_plate(
    "PF4-3",
    "Cu-Johnson",
    "Copper, all grooves alike and at random",
    (33.9, 42.8, 54.4, 61.2, 63.9, 64.6),
    colored_metal("copper"),
)

if __name__ == "__main__":
    PLATE.run()
