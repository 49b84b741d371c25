"""PF4-1: how often light is reflected, and the colors of mirrors in every direction, for six dihedral angles."""

import numpy as np
from common import WAVELENGTHS_NM, Claim, Plate, Real, seen, sheet
from matplotlib.figure import Figure
from sheets import AT_550_NM, MIRROR_ANGLES_DEG, metal_index

import vcavity_jax as vc

SIZE = 80
MIRRORS = {
    "black glass": "",
    "silicon": "Si-Green-2008",
    "gold": "Au-Johnson",
    "silver": "Ag-Johnson",
    "copper": "Cu-Johnson",
    "aluminum": "Al-Rakic",
}


def index_of(name: str) -> Real:
    """Index n + ik, 1.5 for black glass."""
    return metal_index(MIRRORS[name]) if MIRRORS[name] else np.full(WAVELENGTHS_NM.size, 1.5)


def make() -> tuple[Figure, list[Claim]]:
    """Equal-area maps; the grooves run upwards."""
    figure = sheet(7.2, 8.6)
    rows = figure.subplots(len(MIRRORS) + 1, len(MIRROR_ANGLES_DEG))
    silver: list[float] = []
    most: list[int] = []
    for column, angle in enumerate(MIRROR_ANGLES_DEG):
        surface = vc.VGrooves(np.radians(float(angle)))
        maps = {
            name: vc.reflectance_map(
                vc.Scene(surface, vc.Specular(index_of(name)), vc.Diffuse(), vc.View()), SIZE, 1e-4
            )
            for name in MIRRORS
        }
        one = maps["silver"]
        inside = np.asarray(one.inside)
        polar, azimuth = np.where(inside, one.polar, 0.0), np.where(inside, one.azimuth, 0.0)
        view = vc.View(polar[inside], azimuth[inside])
        counts = np.full(inside.shape, np.nan)
        counts[inside] = vc.reflection_count(vc.Scene(surface, vc.Specular(1.5), vc.Diffuse(), view))
        most.append(int(np.nanmax(counts)))
        silver += list(np.asarray(one.reflectance_factor)[inside][:, AT_550_NM])
        rows[0][column].imshow(counts, cmap="Greys", vmin=0, vmax=5, origin="lower")
        rows[0][column].set_title(f"{angle}°, up to {most[-1]}")
        for row, found in zip(rows[1:], maps.values(), strict=True):
            row[column].imshow(np.where(inside[..., None], found.srgb(WAVELENGTHS_NM), 1.0), origin="lower")
    for row, name in zip(rows, ["reflections", *MIRRORS], strict=True):
        row[0].set_ylabel(name)
        for axes in row:
            axes.set(xticks=[], yticks=[])
            axes.spines[:].set_visible(False)
    glass = seen(vc.Specular(1.5), 180, vc.Diffuse(), np.array([0.0, 89.9]))
    center, side = seen(vc.Specular(1.5), 90, vc.Diffuse(), np.array([0.0, 60.0]), 0.0)
    return figure, [
        Claim(
            "up to 4, 3, 2, 2, 2 and 1 reflections at 45° to 180°",
            f"{', '.join(map(str, most))}: 180° over the angle, rounded up",
            most == [4, 3, 2, 2, 2, 1],
        ),
        Claim(
            "black glass, flat: its reflectance tends to 1 at grazing angles",
            f"{glass[0]:.3f} from the front, {glass[1]:.3f} from 89.9°",
            bool(glass[1] > 0.98),
        ),
        Claim(
            "black glass, 90°: a central area is lighter, where light is reflected once",
            f"that area lies to the sides, {side:.4f} from 60° across the grooves; the center is darker, "
            f"{center:.4f}: there all light is reflected twice",
            bool(center > side),
        ),
        Claim(
            "silver looks constant over all directions and angles",
            f"550 nm: {min(silver):.3f} to {max(silver):.3f}",
            bool(min(silver) > 0.8),
        ),
    ]


PLATE = Plate("PF4-1", "Mirrors seen from everywhere", make)

if __name__ == "__main__":
    PLATE.run()
