"""PF3-3: a magenta groove of 45° seen from -75° to 75° in three lights."""

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
    spectra = over_views(vc.Lambertian(ink("magenta")))
    frontal, oblique = (float(off(spectra[light]).max()) for light in ("frontal", "45° oblique"))
    return views_figure(spectra), [
        *view_claims(spectra),
        Claim(
            "the difference reaches 5 in frontal light, 19 in oblique light",
            f"{frontal:.1f} and {oblique:.1f} for this patch",
            None,
        ),
    ]


PLATE = Plate("PF3-3", "A magenta groove of 45° seen from -75° to 75° in three lights", make)

if __name__ == "__main__":
    PLATE.run()
