"""Three layouts that several figures share: over views, over dihedral angles, and mirrors in and out of order."""

from collections.abc import Callable

import numpy as np
from common import (
    ANGLES_DEG,
    DIFFUSE,
    FRONTAL,
    OBLIQUE,
    TOLERANCE,
    WAVELENGTHS_NM,
    Claim,
    Plate,
    Real,
    chroma,
    difference,
    draw_colors,
    draw_spectra,
    hue_deg,
    if_alike,
    ink,
    lab,
    seen,
    sheet,
)
from matplotlib.figure import Figure

import vcavity_jax as vc
from vcavity_jax import materials

VIEWS_DEG = np.arange(-75.0, 76.0, 15.0)
LIGHTS = {"frontal": FRONTAL, "45° oblique": OBLIQUE, "diffuse": DIFFUSE}
MIRROR_ANGLES_DEG = (45, 60, 90, 120, 150, 180)
ROUGHNESSES = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0)
AT_550_NM = int(np.argmin(np.abs(WAVELENGTHS_NM - 550)))


def over_views(material: vc.Lambertian) -> dict[str, Real]:
    """Reflectance factors of a 45° groove for each light, shape (views, L)."""
    return {name: seen(material, 45, light, VIEWS_DEG) for name, light in LIGHTS.items()}


def views_figure(spectra: dict[str, Real]) -> Figure:
    """A row for each light: spectra, L*C*, a*b*, and the color difference from the frontal view."""
    figure = sheet(7.2, 5.8)
    rows = figure.subplots(len(spectra), 4, width_ratios=(1.3, 1, 1, 1))
    labels = [f"{view:.0f}°" for view in VIEWS_DEG]
    middle = len(VIEWS_DEG) // 2
    for row, (light, factors) in zip(rows, spectra.items(), strict=True):
        draw_spectra(row[0], factors[middle:], labels[middle:], linewidth=0.8)
        draw_spectra(row[0], factors[middle::-1], labels[middle::-1], dashes=("--",), linewidth=0.8)
        for side, marker in ((slice(middle, None), "o"), (slice(None, middle + 1), "s")):
            for axes, kind in ((row[1], "LC"), (row[2], "ab")):
                draw_colors(axes, factors[side], kind, labels[side] if marker == "o" else [""] * 6, marker)
        color = lab(factors)
        row[3].plot(VIEWS_DEG, difference(color, color[middle]), "k.-", linewidth=0.8)
        row[3].set(xlabel="view (°)", ylabel="ΔE00 from the front", xticks=(-60, 0, 60))
        row[0].set_title(f"{light} light", loc="left")
    handles, names = rows[0][0].get_legend_handles_labels()
    figure.legend(
        handles[: middle + 1],
        names[: middle + 1],
        loc="outside lower center",
        ncols=6,
        title="view; dashed: from the other side",
    )
    return figure


def view_claims(spectra: dict[str, Real]) -> list[Claim]:
    """What the thesis says of all inks."""
    color = {name: lab(factors) for name, factors in spectra.items()}
    middle = len(VIEWS_DEG) // 2
    off = {name: difference(one, one[middle]) for name, one in color.items()}
    uneven = max(float(np.abs(spectra[n] - spectra[n][::-1]).max()) for n in ("frontal", "diffuse"))
    frontal = color["frontal"][middle:]
    lightness, saturation = frontal[:, 0], chroma(frontal)
    falls = bool((np.diff(lightness) < 1e-4).all() and (np.diff(saturation) < 1e-4).all())
    lit = dict(zip(VIEWS_DEG, color["45° oblique"][:, 0], strict=True))
    diffuse = color["diffuse"][middle:]
    return [
        Claim(
            "frontal and diffuse light: no difference between both sides",
            f"largest difference {uneven:.0e}",
            uneven < 1e-5,
        ),
        Claim(
            "frontal light: lightness and chroma diminish towards grazing views",
            f"L* {lightness[0]:.1f} to {lightness[-1]:.1f}, C* {saturation[0]:.1f} to {saturation[-1]:.1f}, "
            f"{'' if falls else 'not '}monotonic",
            falls,
        ),
        Claim(
            "oblique light: brightest from 45°, where the light comes from, then 60°, then 75°",
            ", ".join(f"L* {lit[v]:.1f} at {v:.0f}°" for v in (30.0, 45.0, 60.0, 75.0)),
            bool(lit[45.0] > lit[60.0] > lit[75.0] > lit[15.0]),
        ),
        Claim(
            "oblique light, shadowed side: -45° is higher than the others",
            ", ".join(f"L* {lit[v]:.1f} at {v:.0f}°" for v in (-30.0, -45.0, -60.0, -75.0)),
            bool(lit[-45.0] > max(lit[-30.0], lit[-60.0], lit[-75.0])),
        ),
        Claim(
            "oblique light: the difference is largest in the direction of the light",
            f"ΔE00 {off['45° oblique'].max():.1f} at {VIEWS_DEG[off['45° oblique'].argmax()]:.0f}°",
            bool(VIEWS_DEG[off["45° oblique"].argmax()] == 45),
        ),
        Claim(
            "diffuse light: lightness rises with the view angle, chroma barely changes",
            f"L* {diffuse[0, 0]:.1f} to {diffuse[-1, 0]:.1f}, "
            f"C* {chroma(diffuse)[0]:.1f} to {chroma(diffuse)[-1]:.1f}",
            bool((np.diff(diffuse[:, 0]) > -1e-4).all() and np.ptp(chroma(diffuse)) < np.ptp(diffuse[:, 0])),
        ),
    ]


def over_angles(reflectance: Real) -> dict[str, Real]:
    """Reflectance factors seen frontally in frontal and diffuse light, shape (angles, L)."""
    material = vc.Lambertian(reflectance)
    return {
        name: np.stack([seen(material, angle, LIGHTS[name]) for angle in ANGLES_DEG])
        for name in ("frontal", "diffuse")
    }


def angles_figure(spectra: dict[str, Real]) -> Figure:
    """A row for each light: spectra, L*C*, a*b*, and the color difference from the flat surface."""
    figure = sheet(7.2, 4.1)
    rows = figure.subplots(2, 4, width_ratios=(1.3, 1, 1, 1))
    labels = [f"{angle}°" for angle in ANGLES_DEG]
    for row, (light, factors) in zip(rows, spectra.items(), strict=True):
        draw_spectra(row[0], factors, labels, linewidth=0.8)
        draw_colors(row[1], factors, "LC", labels)
        draw_colors(row[2], factors, "ab", labels)
        color = lab(factors)
        row[3].plot(ANGLES_DEG, difference(color, color[-1]), "k.-", linewidth=0.8)
        row[3].set(xlabel="dihedral angle (°)", ylabel="ΔE00 from flat", xticks=(30, 90, 150))
        row[0].set_title(f"{light} light", loc="left")
    handles, names = rows[0][0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=11, handlelength=1.0, columnspacing=0.8)
    return figure


def always_darker(spectra: dict[str, Real]) -> Claim:
    """Holds for every material in diffuse light: r - L = (1 - r)(g - 1) >= 0."""
    excess = float((spectra["diffuse"][:-1] - spectra["diffuse"][-1]).max())
    return Claim(
        "diffuse light: the grooved surface is always darker than the flat one",
        f"largest excess at any wavelength and angle {excess:.4f}",
        excess < 0,
    )


def shift(spectra: Real) -> str:
    """How lightness, chroma and hue change from flat to 30°."""
    first, flat = lab(spectra[0]), lab(spectra[-1])
    turn = (hue_deg(first) - hue_deg(flat) + 180) % 360 - 180
    return (
        f"flat to 30°: L* {flat[0]:.1f} to {first[0]:.1f}, C* {chroma(flat):.1f} to {chroma(first):.1f}, "
        f"hue {turn:+.1f}°, ΔE00 {float(difference(first, flat)):.1f}"
    )


def angles_plate(name: str, patch: str, title: str, claims: Callable[[dict[str, Real]], list[Claim]]) -> Plate:
    """PF3-6 to PF3-12: one ink folded at all angles."""

    def make() -> tuple[Figure, list[Claim]]:
        spectra = over_angles(ink(patch))
        return angles_figure(spectra), [*claims(spectra), always_darker(spectra)]

    return Plate(name, title, make)


def metal_index(name: str) -> Real:
    """Index n + ik at the wavelengths of the figures."""
    return np.asarray(materials.refractive_index(name, WAVELENGTHS_NM))


def mirrors(index: Real) -> tuple[Real, Real]:
    """Bi-hemispherical reflectances at given angles and of given roughnesses, each of shape (., L)."""
    material, everywhere = vc.Specular(index), vc.Hemisphere()
    in_order = [
        vc.reflectance_factor(
            vc.Scene(vc.VGrooves(np.radians(float(a))), material, vc.Diffuse(), everywhere), TOLERANCE
        )
        for a in MIRROR_ANGLES_DEG
    ]
    table = vc.bihemispherical_table(material, TOLERANCE, roughest=max(ROUGHNESSES))
    random = [table.average(m, "beckmann") for m in ROUGHNESSES]
    return np.stack([np.asarray(one) for one in in_order]), np.stack([np.asarray(one) for one in random])


def mirrors_figure(in_order: Real, random: Real) -> Figure:
    """Left one angle, right random angles: spectra, L*C*, a*b*."""
    figure = sheet(5.4, 6.4)
    rows = figure.subplots(3, 2)
    columns = ((in_order, [f"{a}°" for a in MIRROR_ANGLES_DEG]), (random, [f"m = {m:g}" for m in ROUGHNESSES]))
    for column, (spectra, labels) in enumerate(columns):
        draw_spectra(rows[0][column], spectra, labels, linewidth=0.9)
        rows[0][column].set(ylim=(0, 1), ylabel="bi-hemispherical reflectance")
        rows[0][column].legend(fontsize=6, ncols=2)
        draw_colors(rows[1][column], spectra, "LC", labels)
        draw_colors(rows[2][column], spectra, "ab", labels)
    rows[0][0].set_title("all grooves alike", loc="left")
    rows[0][1].set_title("Beckmann-distributed slopes", loc="left")
    return figure


def table_2(in_order: Real, thesis: tuple[float, ...]) -> Claim:
    """The thesis's Table 2 at 550 nm, in percent."""
    ours = 100 * in_order[:, AT_550_NM]
    off = float(np.abs(ours - np.array(thesis)).max())
    return Claim(
        f"Table 2, 550 nm, 45° to 180°: {', '.join(f'{v:.1f}' for v in thesis)} %",
        f"{', '.join(f'{v:.2f}' for v in ours)} % (at most {off:.2f} apart; its sampling errs by up to 0.6)",
        if_alike(off <= 0.6),
    )


def mirror_claims(in_order: Real, random: Real) -> list[Claim]:
    """What it says of all mirrors."""
    nearly_flat = float(np.abs(random[0] / in_order[-1] - 1).max())
    color_change = float(difference(lab(random[0]), lab(in_order[-1])))
    rises = float(np.diff(in_order, axis=0).min())
    falls = float(np.diff(random, axis=0).max())
    return [
        Claim(
            "the narrower the grooves, the lower the reflectance",
            f"least rise with the angle {rises:.1e}",
            rises > 0,
        ),
        Claim(
            "m = 0.05 is identical to the flat mirror",
            f"lower by up to {100 * nearly_flat:.2f} %, which cannot be seen: ΔE00 {color_change:.2f}",
            color_change < 0.3,
        ),
        Claim("the rougher, the lower the reflectance", f"largest step with roughness {falls:.1e}", falls < 0),
    ]


def colored_metal(metal: str) -> Callable[[Real, Real], list[Claim]]:
    """What it says of copper and of gold."""

    def claims(in_order: Real, random: Real) -> list[Claim]:
        hue, color = hue_deg(lab(in_order)), chroma(lab(random))
        return [
            Claim(
                f"the hue of {metal} remains unchanged",
                f"{hue.min():.1f}° to {hue.max():.1f}°",
                float(np.ptp(hue)) < 5,
            ),
            Claim(
                "roughness raises its chroma",
                f"C* {color[0]:.1f} at m = 0.05, {color[-1]:.1f} at m = 2",
                bool(color[-1] > color[0]),
            ),
        ]

    return claims


def metal_plate(
    name: str, index: str, title: str, thesis: tuple[float, ...], claims: Callable[[Real, Real], list[Claim]]
) -> Plate:
    """PF4-3 to PF4-7: one material, in order and at random."""

    def make() -> tuple[Figure, list[Claim]]:
        found = mirrors(metal_index(index))
        return mirrors_figure(*found), [table_2(found[0], thesis), *mirror_claims(*found), *claims(*found)]

    return Plate(name, f"{title} ({index})", make)
