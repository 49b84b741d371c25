"""Figure 26b: the reflectance from which a groove outshines the flat surface, frontally lit and seen."""

import numpy as np
from common import Claim, Plate, sheet
from matplotlib.figure import Figure
from scipy.optimize import brentq, minimize_scalar

import vcavity_jax as vc


def threshold(angle_deg: float) -> float:
    """The reflectance r of sin(angle / 2) G(angle, r) = 1: the groove's reflectance factor is r as well."""

    def excess(reflectance: float) -> float:
        scene = vc.Scene(
            vc.VGrooves(np.radians(angle_deg)), vc.Lambertian(reflectance), vc.Directional(0.0, 0.0), vc.View()
        )
        return float(vc.reflectance_factor(scene, 1e-12)) / reflectance - 1

    return float(brentq(excess, 0.5, 1.0, xtol=1e-13))


def brightest_point(angle_deg: float) -> float:
    """The same for the brightest point of the groove, its fold: r = 1 / (1 + sin(angle / 2))."""
    return float(1 / (1 + np.sin(np.radians(angle_deg) / 2)))


def make() -> tuple[Figure, list[Claim]]:
    """Both against the dihedral angle."""
    angles = np.concatenate([[2.0, 5.0], np.arange(10.0, 180.0, 5.0), [179.0]])
    curve = np.array([threshold(float(angle)) for angle in angles])
    lowest = minimize_scalar(threshold, bounds=(35, 45), method="bounded", options={"xatol": 1e-4})
    figure = sheet(3.5, 2.9)
    axes = figure.subplots()
    axes.plot(angles, curve, "k-", label="mean of the groove")
    axes.plot(angles, [brightest_point(a) for a in angles], "k--", label="brightest point, the fold")
    axes.plot(lowest.x, lowest.fun, "o", color="C3", markersize=4, label=f"{lowest.x:.1f}°, {lowest.fun:.4f}")
    axes.set(
        xlabel="dihedral angle (°)", ylabel="reflectance", xlim=(0, 180), ylim=(0.45, 1), xticks=range(0, 181, 30)
    )
    axes.legend(loc="lower left")
    at_45 = threshold(45.0)
    return figure, [
        Claim("0.93 at 45°", f"{at_45:.10f}", round(at_45, 2) == 0.93),
        Claim(
            "lowest, around 0.93, at about 40°",
            f"{lowest.fun:.8f} at {lowest.x:.3f}°",
            round(float(lowest.fun), 2) == 0.93 and abs(lowest.x - 40) < 1,
        ),
        Claim(
            "at 179° no point of the groove is brighter than the flat surface below 0.55",
            f"1 / (1 + sin 89.5°) = {brightest_point(179):.7f}",
            abs(brightest_point(179) - 0.55) < 0.01,
        ),
    ]


PLATE = Plate("Figure 26", "The reflectance from which a groove outshines the flat surface", make)

if __name__ == "__main__":
    PLATE.run()
