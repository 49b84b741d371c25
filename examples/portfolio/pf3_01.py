"""PF3-1: a magenta groove of 45° in frontal, oblique and diffuse light, facet by facet."""

import numpy as np
from common import (
    DIFFUSE,
    FRONTAL,
    OBLIQUE,
    POSITIONS,
    WAVELENGTHS_NM,
    Claim,
    Plate,
    along,
    draw_strip,
    ink,
    seen,
    sheet,
)
from matplotlib.figure import Figure

import vcavity_jax as vc

RIM, FOLD = 0, len(POSITIONS) - 1


def make() -> tuple[Figure, list[Claim]]:
    """A row for each light: the groove's band of color, and the spectra along it."""
    flat = ink("magenta")
    material = vc.Lambertian(flat)
    figure = sheet(7.2, 5.6)
    rows = figure.subplots(3, 2, width_ratios=(1, 1.4))
    lights = {"frontal": FRONTAL, "45° oblique": OBLIQUE, "diffuse": DIFFUSE}
    radiance = {name: along(material, 45, light) for name, light in lights.items()}
    mean = {name: seen(material, 45, light) for name, light in lights.items()}
    for (left, right), (name, across) in zip(rows, radiance.items(), strict=True):
        draw_strip(left, across)
        left.set_title(f"{name} light", loc="left")
        right.plot(WAVELENGTHS_NM, across[:: len(POSITIONS) // 16].T, color="0.75", linewidth=0.5)
        right.plot(WAVELENGTHS_NM, across[RIM], "k-", label="rim")
        right.plot(WAVELENGTHS_NM, across[FOLD], "k--", label="fold")
        right.plot(WAVELENGTHS_NM, flat, "--", color="C6", label="flat")
        right.plot(WAVELENGTHS_NM, mean[name], "-", color="C3", label="mean")
        right.set(xlabel="wavelength (nm)", ylabel="radiance factor", xlim=(400, 700), ylim=(0, 1.3))
    rows[0][1].legend(ncols=2)
    brightest = int(flat.argmax())
    white = along(vc.Lambertian(np.ones(1)), 45, OBLIQUE)[len(POSITIONS) :, 0]
    share = 100 * np.sin(np.radians(22.5))
    frontal = radiance["frontal"][:, brightest]
    excess = float((mean["diffuse"] - flat).max())
    return figure, [
        Claim(
            "the panels receive 39 % of the frontal irradiance", f"sin 22.5° = {share:.1f} %", round(share) == 39
        ),
        Claim(
            "frontal light: brighter at the fold, darker at the rims",
            f"{frontal[FOLD]:.3f} and {frontal[RIM]:.3f}, flat {flat.max():.3f}",
            bool(frontal[FOLD] > flat.max() > frontal[RIM]),
        ),
        Claim(
            "frontal light: the mean exceeds the flat surface where little is absorbed",
            f"it takes a reflectance above 0.9326; this patch reaches {flat.max():.2f}, and its mean "
            f"{mean['frontal'][brightest]:.2f}",
            None,
        ),
        Claim(
            "oblique light: the shadowed panel is brightest near its middle",
            f"at {POSITIONS[white.argmax()]:.2f} of its width for reflectance 1",
            bool(0.4 < POSITIONS[white.argmax()] < 0.6),
        ),
        Claim(
            "diffuse light: darker at the fold, and everywhere darker than the flat surface",
            f"largest excess of the mean {excess:.4f}",
            bool(excess < 0 and radiance["diffuse"][FOLD, brightest] < radiance["diffuse"][RIM, brightest]),
        ),
    ]


PLATE = Plate("PF3-1", "A magenta groove of 45° in three lights, facet by facet", make)

if __name__ == "__main__":
    PLATE.run()
