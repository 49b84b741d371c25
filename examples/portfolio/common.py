"""What the figures of the portfolio share: materials, lights, colors, panels, and what is said of them."""

import argparse
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

jax.config.update("jax_enable_x64", True)

import vcavity_jax as vc  # noqa: E402
from fitting import read_spectrum  # noqa: E402
from fitting.plots import write_figure  # noqa: E402
from vcavity_jax import colorimetry  # noqa: E402

Real = np.ndarray
DATA = Path(__file__).parents[1] / "data"
sys.path.append(str(DATA.parent))  # The other examples.
WAVELENGTHS_NM = np.arange(400.0, 701.0, 10.0)
FRONTAL = vc.Directional(0.0, 0.0)
OBLIQUE = vc.Directional(np.radians(45.0), 0.0)
DIFFUSE = vc.Diffuse()
ANGLES_DEG = (30, 45, 60, 75, 90, 105, 120, 135, 150, 165, 180)
POSITIONS = (np.arange(64) + 0.5) / 64
"""Along a panel, in units of its width, from the fold to the rim."""

TOLERANCE = 1e-6
_DPI = 140
_ANGLE_MAP = "viridis"


@dataclass(frozen=True)
class Claim:
    """One thing that the thesis says of a figure, and what comes out here.

    Args:
        thesis: in its sense.
        ours: the figures that bear on it.
        holds: whether these bear it out; None where our materials are not its own and nothing can be said.
    """

    thesis: str
    ours: str
    holds: bool | None

    @property
    def verdict(self) -> str:
        """One word or two."""
        return {True: "yes", False: "**no**", None: "open"}[self.holds]


@dataclass(frozen=True)
class Plate:
    """A figure of the portfolio.

    Args:
        name: of the thesis, as "PF3-6".
        title: what is shown.
        make: draws it, and returns what is said of it.
    """

    name: str
    title: str
    make: Callable[[], tuple[Figure, list[Claim]]]

    @property
    def file(self) -> str:
        """Of the picture."""
        return f"{self.name.lower().replace(' ', '-')}.png"

    def write(self, folder: Path) -> list[Claim]:
        """Draw it into a folder."""
        claims: list[Claim] = []

        def draw() -> Figure:
            figure, said = self.make()
            claims.extend(said)
            return figure

        folder.mkdir(parents=True, exist_ok=True)
        write_figure(draw, folder / self.file, dpi=_DPI)
        return claims

    def run(self) -> None:
        """The command line of a script."""
        parser = argparse.ArgumentParser(description=self.title)
        parser.add_argument("outdir", nargs="?", type=Path, help="a new temporary folder by default")
        outdir = parser.parse_args().outdir or Path(tempfile.mkdtemp())
        print(f"{self.name}: {self.title}")
        for claim in self.write(outdir):
            print(f"  thesis: {claim.thesis}\n    ours: {claim.ours}  [{claim.verdict.strip('*')}]")
        print(f"wrote {outdir / self.file}")


def if_alike(holds: bool) -> bool | None:
    """A verdict on what depends on the spectrum: open if ours, which is another one, does not show it."""
    return True if holds else None


def ink(name: str) -> Real:
    """Reflectance of a measured matte patch, shape (L,)."""
    return read_spectrum(DATA / f"flat-{name}.csv")[1]


def seen(material: Any, angle_deg: float, light: Any, polar_deg: Any = 0.0, azimuth_deg: float = 0.0) -> Real:
    """Reflectance factors, shape (views, L) or (L,)."""
    view = vc.View(np.radians(polar_deg), np.radians(azimuth_deg))
    return np.asarray(
        vc.reflectance_factor(vc.Scene(vc.VGrooves(np.radians(angle_deg)), material, light, view), TOLERANCE)
    )


def along(material: Any, angle_deg: float, light: Any) -> Real:
    """Radiance across a groove, first panel from its rim to the fold, then the second, shape (2 P, L)."""
    scene = vc.Scene(vc.VGrooves(np.radians(angle_deg)), material, light, vc.View())
    first, second = np.asarray(vc.radiance_profile(scene, POSITIONS, TOLERANCE))
    return np.concatenate([first[::-1], second])


def lab(spectra: Real, illuminant: Any = "D65") -> Real:
    """L*, a*, b* for the 2° observer, shape (..., 3)."""
    white = colorimetry.white(WAVELENGTHS_NM, illuminant)
    return np.asarray(colorimetry.lab(colorimetry.xyz(spectra, WAVELENGTHS_NM, illuminant), white))


def chroma(color: Real) -> Real:
    """C* of L*, a*, b*."""
    return np.hypot(color[..., 1], color[..., 2])


def hue_deg(color: Real) -> Real:
    """Hue angle of L*, a*, b*, degrees from 0 to 360."""
    return np.degrees(np.arctan2(color[..., 2], color[..., 1])) % 360


def shade(spectra: Real, illuminant: Any = "D65") -> Real:
    """Color on a display, shape (..., 3)."""
    white = colorimetry.white(WAVELENGTHS_NM, illuminant)
    return np.asarray(colorimetry.srgb(colorimetry.xyz(spectra, WAVELENGTHS_NM, illuminant), white, clip=True))


def difference(first: Real, second: Real) -> Real:
    """ΔE₀₀ of L*, a*, b*, shape (...)."""
    return np.asarray(colorimetry.delta_e_2000(first, second))


def sheet(width: float, height: float) -> Figure:
    """An empty figure, inches."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def graded(count: int) -> Real:
    """Distinct colors, dark to light, that differ in gray as well."""
    import matplotlib as mpl

    return np.asarray(mpl.colormaps[_ANGLE_MAP](np.linspace(0, 0.9, count)))


def draw_spectra(
    axes: Axes, spectra: Real, labels: Sequence[str], *, dashes: Sequence[str] = ("-",), **style: Any
) -> None:
    """One curve for each label."""
    for k, (values, label, color) in enumerate(zip(spectra, labels, graded(len(labels)), strict=True)):
        axes.plot(WAVELENGTHS_NM, values, dashes[k % len(dashes)], label=label, color=color, **style)
    axes.set(xlabel="wavelength (nm)", ylabel="reflectance factor", xlim=(400, 700))
    axes.set_ylim(bottom=0)


def draw_colors(
    axes: Axes, spectra: Real, kind: str, labels: Sequence[str], marker: str = "o", path: bool = True
) -> None:
    """L*C* ("LC") or a*b* ("ab") in the colors themselves; the first and last are labeled."""
    color = lab(spectra)
    x, y = (chroma(color), color[:, 0]) if kind == "LC" else (color[:, 1], color[:, 2])
    if path:
        axes.plot(x, y, "-", color="0.6", linewidth=0.6, zorder=1)
    axes.scatter(x, y, c=shade(spectra), marker=marker, s=20, edgecolors="black", linewidths=0.5, zorder=2)
    for k in {0, len(labels) - 1}:
        if labels[k]:
            axes.annotate(labels[k], (x[k], y[k]), (3, 3), textcoords="offset points", fontsize=6)
    axes.set(xlabel="C*" if kind == "LC" else "a*", ylabel="L*" if kind == "LC" else "b*")
    axes.margins(0.15)


def draw_strip(axes: Axes, spectra: Real, illuminant: Any = "D65") -> None:
    """A band of the groove in its colors, from rim to rim."""
    axes.imshow(shade(spectra, illuminant)[None], aspect="auto", extent=(-1, 1, 0, 1))
    axes.set(yticks=[], xticks=[-1, 0, 1], xticklabels=["rim", "fold", "rim"])
