"""Two inks of one color that folding tells apart: a metamer found by gradient, for the security of documents.

    python examples/folded_metamers.py [OUTDIR]

writes folded_metamers.png into OUTDIR (a new temporary folder by default) and prints a table. To a measured
orange another reflectance is found that has exactly its color in D65, curves no more than inks do, and differs
from it the most once both are folded to 60 degrees and lit from the front [SaintPierre2020, section 3.8]. Equal
colors, bounds and curvature are linear in the reflectance; only the color of the fold is not: its exact gradient
drives the search.
"""

import argparse
import tempfile
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.optimize import LinearConstraint, lsq_linear, minimize

jax.config.update("jax_enable_x64", True)

import vcavity_jax as vc  # noqa: E402
from fitting import read_spectrum  # noqa: E402
from fitting.plots import write_figure  # noqa: E402
from vcavity_jax import colorimetry  # noqa: E402

Real = np.ndarray
DATA = Path(__file__).parent / "data"
LOWEST, HIGHEST = 0.02, 0.95
STARTS = 8
MOST_CURVATURE = 0.04
"""Largest second difference of reflectances 10 nm apart: what steep inks have."""


def folded(reflectance: Real | Array, angle_deg: float, light: Any) -> Array:
    """Reflectance factor of the fold, seen from the front."""
    scene = vc.Scene(vc.VGrooves(np.radians(angle_deg)), vc.Lambertian(reflectance), light, vc.View())
    return vc.reflectance_factor(scene, 1e-8)


def lab(factor: Real | Array, wavelengths_nm: Real, illuminant: Any) -> Array:
    """L*, a*, b* for the 2° observer."""
    white = colorimetry.white(wavelengths_nm, illuminant)
    return colorimetry.lab(colorimetry.xyz(factor, wavelengths_nm, illuminant), white)


def metamer(
    reflectance: Real, wavelengths_nm: Real, angle_deg: float, light: Any, illuminant: Any = "D65"
) -> Real:
    """A reflectance of the same color, the most different from the first once both are folded.

    Args:
        reflectance: of the flat material, shape (L,).
        wavelengths_nm: shape (L,).
        angle_deg: of the fold.
        light: on the fold.
        illuminant: in which the flat materials look the same.
    """
    weights = np.asarray(colorimetry.xyz(np.eye(reflectance.size), wavelengths_nm, illuminant)).T
    curvature = np.diff(np.eye(reflectance.size), 2, axis=0)
    color = weights @ reflectance
    known = lab(folded(reflectance, angle_deg, light), wavelengths_nm, illuminant)

    @jax.jit
    @jax.value_and_grad
    def likeness(other: Array) -> Array:
        found = lab(folded(other, angle_deg, light), wavelengths_nm, illuminant)
        return -jnp.sum(colorimetry.components_2000(known, found) ** 2)

    # The search begins at the smoothest one of that color and beside it, since there are several maxima.
    smoothest = lsq_linear(
        np.concatenate([curvature, 1e3 * weights]),
        np.concatenate([np.zeros(len(curvature)), 1e3 * color]),
        bounds=(LOWEST, HIGHEST),
    ).x
    random = np.random.default_rng(0)
    begun = [smoothest, *(smoothest + 0.1 * random.normal(size=(STARTS - 1, reflectance.size)))]
    ends = [
        minimize(
            lambda x: tuple(np.asarray(part, np.float64) for part in likeness(x)),
            start.clip(LOWEST, HIGHEST),
            jac=True,
            method="SLSQP",
            bounds=[(LOWEST, HIGHEST)] * reflectance.size,
            constraints=[
                LinearConstraint(weights, color, color),
                LinearConstraint(curvature, -MOST_CURVATURE, MOST_CURVATURE),
            ],
            options={"maxiter": 300, "ftol": 1e-8},
        )
        for start in begun
    ]
    return np.asarray(min((end for end in ends if end.success), key=lambda end: end.fun).x)


def difference(
    first: Real, second: Real, angle_deg: float, light: Any, nm: Real, illuminant: Any = "D65"
) -> float:
    """ΔE00 of both materials, folded."""
    return float(
        colorimetry.delta_e_2000(*(lab(folded(r, angle_deg, light), nm, illuminant) for r in (first, second)))
    )


def draw(
    nm: Real, inks: dict[str, Real], angle_deg: float, light: Any, off: dict[str, Real], angles: Real
) -> Figure:
    """Spectra flat and folded, patches of color, and ΔE00 against the dihedral angle."""
    figure = Figure(figsize=(7.0, 2.9), layout="constrained")
    FigureCanvasAgg(figure)
    left, middle, right = figure.subplots(1, 3, width_ratios=(2, 1, 2))
    patches = np.zeros((2, 2, 3))
    white = colorimetry.white(nm)
    for k, ((name, reflectance), color) in enumerate(zip(inks.items(), ("#D55E00", "#0072B2"), strict=True)):
        fold = np.asarray(folded(reflectance, angle_deg, light))
        left.plot(nm, reflectance, "-", color=color, label=name)
        left.plot(nm, fold, "--", color=color)
        for row, factor in enumerate((reflectance, fold)):
            patches[row, k] = colorimetry.srgb(colorimetry.xyz(factor, nm), white, clip=True)
    left.set(xlabel="wavelength (nm)", ylabel="reflectance factor", xlim=(400, 700), ylim=(0, None))
    left.legend(title=f"dashed: folded to {angle_deg:g}°", title_fontsize=7, fontsize=7)
    middle.imshow(patches, aspect="auto")
    middle.set(xticks=(0, 1), xticklabels=("first", "second"), yticks=(0, 1), yticklabels=("flat", "folded"))
    for (name, differences), dash in zip(off.items(), ("-", "--", ":"), strict=True):
        right.plot(angles, differences, f"k{dash}", label=name)
    right.set(xlabel="dihedral angle (°)", ylabel="ΔE00 between the two", xlim=(20, 180), ylim=(0, None))
    right.legend(fontsize=7)
    return figure


def main() -> None:
    """Find the metamer and show it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("outdir", nargs="?", type=Path)
    outdir = parser.parse_args().outdir or Path(tempfile.mkdtemp())
    nm, first, _ = read_spectrum(DATA / "flat-orange.csv")
    angle_deg, frontal = 60.0, vc.Directional(0.0, 0.0)
    second = metamer(first, nm, angle_deg, frontal)
    angles = np.arange(20.0, 181.0, 8.0)
    shown = {
        "frontal light, D65": (frontal, "D65"),
        "diffuse light, D65": (vc.Diffuse(), "D65"),
        "diffuse light, A": (vc.Diffuse(), "A"),
    }
    off = {
        name: np.array([difference(first, second, angle, light, nm, lamp) for angle in angles])
        for name, (light, lamp) in shown.items()
    }
    print("ΔE00 between the two      flat    120°     90°     60°     40°")
    for name, (light, lamp) in shown.items():
        told = [difference(first, second, angle, light, nm, lamp) for angle in (180.0, 120.0, 90.0, 60.0, 40.0)]
        print(f"{name:22}" + "".join(f"{value:8.2f}" for value in told))
    path = outdir / "folded_metamers.png"
    outdir.mkdir(parents=True, exist_ok=True)
    write_figure(lambda: draw(nm, {"first": first, "second": second}, angle_deg, frontal, off, angles), path)
    print(f"wrote {path}")


if __name__ == "__main__":
    main()
