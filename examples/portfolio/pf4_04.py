"""PF4-4: bi-hemispherical reflectance of grooved gold, in order and at random."""

from sheets import colored_metal, metal_plate

PLATE = metal_plate(
    "PF4-4",
    "Au-McPeak",
    "Gold, all grooves alike and at random",
    (66.3, 72.9, 80.0, 83.6, 85.1, 85.4),
    colored_metal("gold"),
)

if __name__ == "__main__":
    PLATE.run()
