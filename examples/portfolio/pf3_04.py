"""PF3-4: a cyan groove of 45° seen from -75° to 75° in three lights."""

from common import Claim, Plate, Real, difference, ink, lab
from matplotlib.figure import Figure
from sheets import over_views, view_claims, views_figure

import vcavity_jax as vc


def off(factors: Real) -> Real:
    """ΔE00 from the frontal view."""
    color = lab(factors)
    return difference(color, color[len(color) // 2])


def make() -> tuple[Figure, list[Claim]]:
    """Spectra and colors over views."""
    spectra = over_views(vc.Lambertian(ink("cyan")))
    other = over_views(vc.Lambertian(ink("magenta")))
    mine, theirs = (float(off(one["diffuse"]).max()) for one in (spectra, other))
    bright = float(spectra["frontal"].max())
    return views_figure(spectra), [
        *view_claims(spectra),
        Claim("frontal light: the mean never exceeds 1", f"largest reflectance factor {bright:.3f}", bright < 1),
        Claim(
            "diffuse light: the eye is more sensitive to it than for magenta",
            f"ΔE00 up to {mine:.1f}; magenta {theirs:.1f}",
            mine > theirs,
        ),
    ]


PLATE = Plate("PF3-4", "A cyan groove of 45° seen from -75° to 75° in three lights", make)

if __name__ == "__main__":
    PLATE.run()
