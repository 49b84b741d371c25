"""Pictures of reflectance maps: how often light is reflected, and the color, in every direction of view.

The arrangement is that of [SaintPierre2020, figure PF4-1]: one column per surface, the numbers of reflections
above, the colors below.
"""

from collections.abc import Sequence
from os import PathLike
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.patheffects import withStroke
from scipy import ndimage  # type: ignore[import-untyped]

from fitting.plots import write_figure
from vcavity_jax import ReflectanceMap
from vcavity_jax.colorimetry import Illuminant, Observer

_RADIUS = np.sqrt(2)
_NARROWEST = 1.75  # inches per column: rings and their names need as much
_ONCE, _OFTEN = "#d9d9d9", "YlGnBu"
# What a number of one, of two digits needs on each side of its center, inches.
_ROOM = (0.065, 0.11)
_HALO = [withStroke(linewidth=1.8, foreground="white")]


def plot_maps(
    maps: Sequence[ReflectanceMap],
    wavelengths_nm: Sequence[float] | np.ndarray,
    path: str | PathLike[str],
    *,
    titles: Sequence[str] = (),
    illuminant: Illuminant = "D65",
    observer: Observer = "CIE 1931",
    partial: bool = False,
) -> None:
    """Draw maps side by side: the most reflections in each direction (mirrors only), and the sRGB color.

    Azimuth 0° (across the grooves) is to the right, 90° (along them) is up; rings stand at polar angles of 30°,
    60° and, the rim, 90°. Equal areas are equal solid angles.

    Args:
        maps: one or more, all of the same wavelengths.
        wavelengths_nm: nm, shape (L,), see ``vcavity_jax.colorimetry.xyz``.
        path: the file; its ending, .png, .pdf or .svg, decides the format.
        titles: one for each map, or none.
        illuminant: one of ``vcavity_jax.colorimetry.ILLUMINANTS``.
        observer: one of ``vcavity_jax.colorimetry.OBSERVERS``.
        partial: accept wavelengths that do not cover the visible range.

    Raises:
        OSError: the file cannot be written.
        ValueError: no maps; titles that are not one per map; the ending; or as ``ReflectanceMap.srgb``.
    """
    if not maps:
        raise ValueError("no maps: expected one or more")
    if titles and len(titles) != len(maps):
        raise ValueError(f"{len(titles)} titles for {len(maps)} maps: expected one for each, or none")
    colors = [np.asarray(one.srgb(wavelengths_nm, illuminant, observer, partial=partial)) for one in maps]
    write_figure(lambda: _draw(maps, colors, list(titles) or [""] * len(maps)), path)


def _draw(maps: Sequence[ReflectanceMap], colors: list[np.ndarray], titles: list[str]) -> Figure:
    counted = any(one.reflections is not None for one in maps)
    width = 3.5 if len(maps) == 1 else max(min(7.0, 2.6 * len(maps)), _NARROWEST * len(maps))
    disk = width / len(maps) - 0.7  # the names of the azimuths stand beside it
    height = (disk + 0.38) * (1 + counted) + 0.25 * any(titles) + 0.2 * (len(maps) > 1)
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    rows = figure.subplots(1 + counted, len(maps), squeeze=False)
    if counted:
        _draw_counts(figure, maps, rows[0].tolist(), disk)
    for axes, one, color in zip(rows[-1], maps, colors, strict=True):
        _show(axes, color, np.asarray(one.inside))
    for axes, title in zip(rows[0], titles, strict=True):
        axes.set_title(title, pad=16)
    for row, words in zip(rows, ["most reflections"] * counted + ["color in sRGB"], strict=True):
        for i, axes in enumerate(row):
            _frame(axes, first=i == 0, alone=len(maps) == 1, rings=words == "color in sRGB")
        row[0].set_ylabel(words, labelpad=25)
    if len(maps) > 1:
        figure.supxlabel("φ = 0° across, 90° along the grooves; rings: θ = 30°, 60°, 90°", fontsize=8)
    return figure


def _draw_counts(figure: Figure, maps: Sequence[ReflectanceMap], row: list[Axes], inches: float) -> None:
    """The numbers of reflections, each with its color; named inside or, where that is too narrow, by a bar."""
    numbers = [None if one.reflections is None else np.asarray(one.reflections) for one in maps]
    most = max(int(number.max()) for number in numbers if number is not None)
    shades = matplotlib.colormaps[_OFTEN](np.linspace(0.2, 0.85, max(most - 1, 1)))
    palette = ListedColormap([_ONCE, *shades][:most])
    steps = BoundaryNorm(np.arange(0.5, most + 1), most)
    nameless = False
    for axes, one, number in zip(row, maps, numbers, strict=True):
        if number is None:
            axes.text(0, 0, "diffusing panels:\nno largest number", ha="center", va="center")
            continue
        _show(axes, palette(steps(number))[..., :3], np.asarray(one.inside))
        nameless |= _name_regions(axes, number, inches)
    if nameless:
        scale = matplotlib.cm.ScalarMappable(steps, palette)
        ticks = range(1, most + 1, -(-most // 12))
        bar = figure.colorbar(scale, ax=row, location="bottom", ticks=ticks, shrink=0.7, aspect=30, pad=0.02)
        bar.minorticks_off()


def _name_regions(axes: Axes, number: np.ndarray, inches: float) -> bool:
    """Write each number where it fits; whether there is one that fits nowhere."""
    pixel = 2 * _RADIUS / len(number)
    per_inch = len(number) / inches
    nameless = False
    for value in range(1, number.max() + 1):
        regions, count = ndimage.label(number == value)
        named = count == 0
        for region in range(1, count + 1):
            depth = ndimage.distance_transform_edt(np.pad(regions == region, 1))[1:-1, 1:-1]
            if depth.max() - 0.5 < _ROOM[value > 9] * per_inch:
                continue
            # Of the places that are almost as wide, the one nearest to the middle of the map.
            rows, columns = np.nonzero(depth >= 0.97 * depth.max())
            u, v = (columns + 0.5) * pixel - _RADIUS, _RADIUS - (rows + 0.5) * pixel
            best = np.argmin(u**2 + v**2)
            axes.text(u[best], v[best], str(value), ha="center", va="center", path_effects=_HALO, zorder=5)
            named = True
        nameless |= not named
    return nameless


def _show(axes: Axes, color: np.ndarray, inside: np.ndarray) -> None:
    """A picture in the disk. The pixels at the rim are continued outward and cut off, for a smooth edge."""
    nearest = ndimage.distance_transform_edt(~inside, return_distances=False, return_indices=True)
    extent = (-_RADIUS, _RADIUS, -_RADIUS, _RADIUS)
    picture = axes.imshow(color[tuple(nearest)], extent=extent, interpolation="nearest", zorder=1)
    picture.set_clip_path(Circle((0, 0), _RADIUS, transform=axes.transData))


def _frame(axes: Axes, first: bool, alone: bool, rings: bool) -> None:
    """Rings of equal polar angle and the names of the azimuths, at length where there is room."""
    line: dict[str, Any] = {"fill": False, "clip_on": False, "zorder": 3}
    axes.add_patch(Circle((0, 0), _RADIUS, lw=0.8, ec="black", **line))
    for degrees in (30, 60):
        radius = 2 * np.sin(np.deg2rad(degrees) / 2)
        axes.add_patch(Circle((0, 0), radius, lw=0.9, ec="white", **line))
        axes.add_patch(Circle((0, 0), radius, lw=0.5, ec="#404040", ls=(0, (4, 3)), **line))
        if rings:
            at = radius * np.sqrt(0.5)
            axes.text(at, -at, f"{degrees}°", ha="center", va="center", path_effects=_HALO, zorder=5)
    if rings and alone:
        at = _RADIUS * np.sqrt(0.5)
        axes.annotate("θ = 90°", (at, -at), (1, -1), textcoords="offset points", ha="left", va="top")
    across, along = ("φ = 0°", "φ = 90°") if first else ("0°", "90°")
    if alone:
        across, along = f"{across} across the grooves", f"{along} along the grooves"
    outside: tuple[tuple[str, tuple[float, float], str, str], ...] = (
        (across, (1, 0), "left", "center"),
        (along, (0, 1), "center", "bottom"),
        ("180°", (-1, 0), "right", "center"),
        ("270°", (0, -1), "center", "top"),
    )
    for name, (x, y), horizontal, vertical in outside:
        axes.annotate(
            name,
            (x * _RADIUS, y * _RADIUS),
            (3 * x, 3 * y),
            textcoords="offset points",
            ha=horizontal,
            va=vertical,
            rotation=270 if alone and x > 0 else 0,
        )
    axes.set(xlim=(-_RADIUS, _RADIUS), ylim=(-_RADIUS, _RADIUS), aspect="equal", xticks=[], yticks=[])
    for spine in axes.spines.values():
        spine.set_visible(False)
