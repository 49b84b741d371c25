"""PF5-1: a groove of 45° of diffusing material under an interface, along the panels and from afar."""

import numpy as np
from common import FRONTAL, POSITIONS, WAVELENGTHS_NM, Claim, Plate, Real, along, draw_strip, ink, seen, sheet
from matplotlib.figure import Figure
from thesis_chapter5 import LIMIT, MEANINGS, flat, grooved, threshold

import vcavity_jax as vc

ANGLE_DEG = 45
INDICES = (1.5, 1.33, 1.0)
RAMP = np.linspace(0, 1, WAVELENGTHS_NM.size)


def material(reflectance: Real, index: float) -> vc.InterfacedLambertian:
    """Without the light that never enters it."""
    return vc.InterfacedLambertian(reflectance, index, specular_included=False)


def make() -> tuple[Figure, list[Claim]]:
    """Columns: indices; rows: against the reflectance, spectra of magenta, the band of color."""
    magenta = ink("magenta")
    figure = sheet(7.2, 5.6)
    rows = figure.subplots(3, 3, height_ratios=(4, 4, 1), sharey="row")
    intrinsic = MEANINGS["intrinsic reflectance"]
    crossings = {n: (threshold(grooved, flat, n), threshold(grooved, intrinsic, n)) for n in INDICES}
    means: dict[float, Real] = {}
    jump = {}
    limit = int(np.searchsorted(POSITIONS, LIMIT))
    for column, index in enumerate(INDICES):
        for row, (x, reflectance) in enumerate(((RAMP, RAMP), (WAVELENGTHS_NM, magenta))):
            across = along(material(reflectance, index), ANGLE_DEG, FRONTAL)[len(POSITIONS) :]
            mean = seen(material(reflectance, index), ANGLE_DEG, FRONTAL)
            axes = rows[row][column]
            axes.plot(x, across[::8].T, color="0.75", linewidth=0.5)
            axes.plot(x, across[0], "k--", label="fold")
            axes.plot(x, across[-1], "k-", label="rim")
            axes.plot(x, flat(reflectance, index), "--", color="C6", label="flat")
            axes.plot(x, mean, "-", color="C3", label="mean")
            jump[index] = float((across[limit - 1] - across[limit]).max())
        means[index] = mean
        rows[0][column].set(xlabel="intrinsic reflectance", title=f"n = {index:g}", xlim=(0, 1), ylim=(0, 2.7))
        rows[1][column].set(xlabel="wavelength (nm)", xlim=(400, 700), ylim=(0, 1.1))
        draw_strip(rows[2][column], along(material(magenta, index), ANGLE_DEG, FRONTAL))
    for row in (0, 1):
        rows[row][0].set_ylabel("radiance factor")
    rows[0][0].legend()
    said = {1.0: 0.93, 1.33: 0.98, 1.5: 0.97}
    absorbed = int(magenta.argmin())
    ratio = {n: float(means[n][absorbed] / flat(magenta, n)[absorbed]) for n in INDICES}
    return figure, [
        Claim(
            "the groove outshines the flat surface from 0.93 (n = 1), 0.98 (1.33), 0.97 (1.5)",
            "; ".join(
                f"n = {n:g}: flat sample {a:.4f}, its intrinsic reflectance {b:.4f}"
                for n, (a, b) in crossings.items()
            ),
            all(round(value, 2) == said[n] for n, pair in crossings.items() for value in pair),
        ),
        Claim(
            "higher with an interface than without",
            "see above",
            all(min(crossings[n]) > crossings[1.0][0] for n in (1.33, 1.5)),
        ),
        Claim(
            f"a discontinuity at y = {LIMIT:.3f}, none without interface",
            ", ".join(f"step {step:.4f} at n = {n:g}" for n, step in jump.items()),
            bool(jump[1.5] > 3 * jump[1.0] and jump[1.33] > 1.5 * jump[1.0]),
        ),
        Claim(
            "where much is absorbed, an interface makes the groove lose less",
            ", ".join(f"groove / flat {value:.3f} at n = {n:g}" for n, value in ratio.items()),
            ratio[1.5] > ratio[1.0] and ratio[1.33] > ratio[1.0],
        ),
    ]


PLATE = Plate("PF5-1", "A groove of 45° under an interface", make)

if __name__ == "__main__":
    PLATE.run()
