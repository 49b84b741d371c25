"""PF3-2: what is seen of a magenta groove of 45°, lit from 45°, at each angle of view."""

import numpy as np
from common import OBLIQUE, POSITIONS, WAVELENGTHS_NM, Claim, Plate, along, graded, ink, seen, shade, sheet
from matplotlib.figure import Figure

import vcavity_jax as vc

VIEWS_DEG = (0.0, 22.5, 30.0, 45.0, 60.0, 75.0)
HALF = np.radians(22.5)


def hidden(view_deg: float) -> float:
    """Share of the far panel, from the fold, that the near one masks; below 0 when both are wholly seen."""
    view = np.radians(abs(view_deg))
    return float(np.sin(view - HALF) / np.sin(view + HALF))


def make() -> tuple[Figure, list[Claim]]:
    """Bands of the groove with what is masked in gray, for both sides; and the mean spectra."""
    material = vc.Lambertian(ink("magenta"))
    band = shade(along(material, 45, OBLIQUE))
    figure = sheet(7.2, 3.6)
    left, right = figure.subplots(1, 2, width_ratios=(1, 1.1))
    ordered = [-v for v in VIEWS_DEG[:0:-1]] + list(VIEWS_DEG)
    place = np.concatenate([-POSITIONS[::-1], POSITIONS])
    rows = []
    for view in ordered:
        limit = hidden(view)
        # A view from θ > 0 sees the panel at y < 0, and of the other one nothing once that is masked in part.
        masked = np.zeros(place.size, bool) if limit <= 1e-12 else np.sign(view) * place > -limit
        rows.append(np.where(masked[:, None], 0.85, band))
    left.imshow(np.stack(rows), aspect="auto", extent=(-1, 1, len(ordered) - 0.5, -0.5), interpolation="nearest")
    left.set(yticks=range(len(ordered)), yticklabels=[f"{v:+g}°" for v in ordered], xticks=(-1, 0, 1))
    left.set(xticklabels=("rim", "fold", "rim"), ylabel="view", title="seen in color, masked in gray")
    factors = seen(material, 45, OBLIQUE, np.array(ordered))
    for spectrum, view, color in zip(factors, ordered, graded(len(ordered)), strict=True):
        right.plot(WAVELENGTHS_NM, spectrum, "-" if view >= 0 else "--", color=color, label=f"{view:+g}°")
    right.set(xlabel="wavelength (nm)", ylabel="reflectance factor", xlim=(400, 700), ylim=(0, None))
    right.legend(ncols=2, fontsize=6)
    finer = np.arange(0.0, 80.0, 0.5)
    gray = seen(vc.Lambertian(np.full(1, 0.93)), 45, OBLIQUE, finer)[:, 0]
    best = finer[gray.argmax()]
    return figure, [
        Claim(
            "the groove is wholly seen from -22.5° to 22.5°",
            f"masked share at 22.5°: {hidden(22.5):.1e}",
            abs(hidden(22.5)) < 1e-12,
        ),
        Claim(
            "brightest from 30°, where the whole lit zone is seen (section 3.6; elsewhere it says 45°)",
            f"brightest from {best:g}° (reflectance 0.93: {gray.max():.3f}; {gray[finer == 30][0]:.3f} from 30°)",
            bool(best == 30),
        ),
    ]


PLATE = Plate("PF3-2", "What is seen of a groove of 45°, lit from 45°", make)

if __name__ == "__main__":
    PLATE.run()
