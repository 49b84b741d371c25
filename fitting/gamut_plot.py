"""The picture of reachable colors: a* against b*, and L* against C*."""

from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from fitting.plots import write_figure

if TYPE_CHECKING:
    from fitting.gamut import ReachableColors

_MARKS = "osD^vP<X"
_DASHES: tuple[Any, ...] = ("-", "--", ":", "-.")
_ROUND_DEG = np.arange(0.0, 181.0, 30.0)
_ROUND = np.array([0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0])


def plot_reachable(colors: "ReachableColors", path: str | PathLike[str]) -> None:
    """See ``ReachableColors.plot``."""
    write_figure(lambda: draw_reachable(colors), path)


def draw_reachable(colors: "ReachableColors") -> Figure:
    """A curve for each look; marks filled with the color at round values, labeled on the first curve."""
    figure = Figure(figsize=(7.0, 3.7 + 0.17 * len(colors.looks)), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    lab = colors.lab
    chroma = np.hypot(lab[..., 1], lab[..., 2])
    _draw(left, colors, lab[..., 1], lab[..., 2])
    _draw(right, colors, chroma, lab[..., 0])
    left.set(xlabel="a*", ylabel="b*")
    left.set_aspect("equal", adjustable="datalim")
    right.set(xlabel="C*", ylabel="L*")
    handles = [
        Line2D(
            [],
            [],
            color="0.3",
            linestyle=_DASHES[k % 4],
            marker=_MARKS[k % 8],
            markersize=4,
            label=look.description,
        )
        for k, look in enumerate(colors.looks)
    ]
    what = "dihedral angle (°)" if colors.unit == "rad" else colors.name
    figure.legend(handles=handles, loc="outside lower center", ncols=2, title=f"marks: {what}; color seen from")
    return figure


def _draw(axes: Axes, colors: "ReachableColors", x: np.ndarray, y: np.ndarray) -> None:
    shown = colors.shown
    marked = _ROUND_DEG if colors.unit == "rad" else _ROUND
    marked = marked[(marked >= shown[0] * (1 - 1e-9)) & (marked <= shown[-1] * (1 + 1e-9))]
    if not marked.size:
        marked = shown[[0, -1]]
    at = [np.stack([np.interp(marked, shown, along[k]) for along in (x, y)]) for k in range(len(x))]
    for k, (across, up) in enumerate(at):
        axes.plot(x[k], y[k], color="0.3", linestyle=_DASHES[k % 4], linewidth=0.8, zorder=1)
        fill = np.stack([np.interp(marked, shown, channel) for channel in colors.srgb[k].T], axis=1)
        axes.scatter(across, up, c=fill, marker=_MARKS[k % 8], s=26, edgecolors="black", linewidths=0.6, zorder=2)
    axes.margins(0.12)
    taken: list[np.ndarray] = []
    room = np.array([np.ptp(x) or 1.0, np.ptp(y) or 1.0])
    for value, here in zip(marked, at[0].T, strict=True):
        if all(np.max(np.abs(here - other) / room) > 0.09 for other in taken):
            axes.annotate(f"{value:.3g}", tuple(here), (-5, 4), textcoords="offset points", fontsize=7, ha="right")
            taken.append(here)
