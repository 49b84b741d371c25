"""Picture of a plan of views: where they lie among the candidates, and the standard errors after each of them."""

from os import PathLike
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, NullLocator, ScalarFormatter

from fitting.parameters import displayed
from fitting.plots import write_figure
from fitting.view_plan import PlannedView, ViewPlan

_WIDTH = 3.5  # inches: one column of a journal
_MARKS = "osD^vP"
_COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#555555", "#000000")
_MOST = 4
_NEAR = 9.0  # degrees: labels of views nearer than this to each other would overlap
_HALO = [withStroke(linewidth=2.0, foreground="white")]


def plot_plan(plan: ViewPlan, path: str | PathLike[str]) -> None:
    """Draw a plan: directions above (radius: polar angle), standard errors against the count of views below.

    Args:
        plan: from ``plan_views``.
        path: the file; its ending, .png, .pdf or .svg, decides the format.

    Raises:
        OSError: the file cannot be written.
        ValueError: the ending is none of the three.
    """
    write_figure(lambda: _draw(plan), path)


def _draw(plan: ViewPlan) -> Figure:
    lights = list(dict.fromkeys(view.light for view in plan.candidates))
    names = _drawn(plan)
    heights = [3.4] * len(lights) + [1.5] * len(names)
    figure = Figure(figsize=(_WIDTH, sum(heights) + 0.6), layout="constrained")
    FigureCanvasAgg(figure)
    every = figure.subplots(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0].tolist()
    letters = iter("abcdefghijklmnopqrstuvwxyz")
    for light, axes in zip(lights, every, strict=False):
        _draw_sky(
            plan,
            light,
            axes,
            f"({next(letters)}) views in {light} light" if len(lights) == 1 else f"({next(letters)}) {light}",
        )
    below = every[len(lights) :]
    for k, (name, axes) in enumerate(zip(names, below, strict=True)):
        _draw_errors(plan, name, axes, next(letters), first=k == 0, last=k == len(names) - 1)
    figure.align_ylabels(below)
    return figure


def _drawn(plan: ViewPlan) -> list[str]:
    """What matters first, and only what becomes identifiable at last."""
    names = [*plan.interest, *(name for name in plan.standard_errors if name not in plan.interest)]
    known = [n for n in dict.fromkeys(names) if n in plan.standard_errors and plan.identifiable[n][-1]]
    return known[:_MOST]


def _place(views: tuple[PlannedView, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Across and along the grooves, degrees from the normal."""
    polar = np.degrees([view.polar for view in views])
    azimuth = np.array([view.azimuth for view in views])
    return np.asarray(polar * np.cos(azimuth)), np.asarray(polar * np.sin(azimuth))


def _draw_sky(plan: ViewPlan, light: str, axes: Axes, title: str) -> None:
    """The hemisphere from above; rings at 30, 60 and 90 degrees."""
    angles = np.linspace(0, 2 * np.pi, 181)
    for ring in (30, 60, 90):
        axes.plot(ring * np.cos(angles), ring * np.sin(angles), color="0.75", lw=0.5, zorder=0)
        axes.text(0, -ring, f"{ring}°", fontsize=7, color="0.35", ha="center", va="center", zorder=1).set_bbox(
            {"facecolor": "white", "edgecolor": "none", "pad": 0.8}
        )
    own = tuple(view for view in plan.candidates if view.light == light)
    x, y = _place(own)
    axes.plot(x, y, ".", color="0.55", ms=3, zorder=2, label="candidate")
    done = tuple(view for view in plan.measured if not np.isnan(view.polar))
    if done and light == plan.candidates[0].light:
        x, y = _place(done)
        axes.plot(x, y, "x", color="black", ms=6, mew=1.2, zorder=3, label="measured")
    chosen = [(i + 1, view) for i, view in enumerate(plan.views) if view.light == light]
    if chosen:
        x, y = _place(tuple(view for _, view in chosen))
        axes.plot(x, y, "o", mfc="white", mec=_COLORS[0], mew=1.3, ms=6, zorder=4, label="to measure, in order")
        for numbers, across, along in _clusters([number for number, _ in chosen], x, y):
            axes.annotate(
                ", ".join(map(str, numbers)),
                (across, along),
                xytext=(0, 9),
                textcoords="offset points",
                fontsize=8,
                color=_COLORS[0],
                weight="bold",
                ha="center",
                va="center",
                zorder=5,
                path_effects=_HALO,
            )
    axes.set_xlim(-98, 98)
    axes.set_ylim(-98, 98)
    axes.set_aspect("equal")
    axes.set_xlabel("across the grooves, θ cos φ (deg)")
    axes.set_ylabel("along, θ sin φ (deg)")
    axes.set_xticks([-90, -60, -30, 0, 30, 60, 90])
    axes.set_yticks([-90, -60, -30, 0, 30, 60, 90])
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.19), ncols=3, handletextpad=0.2, columnspacing=1.0)
    axes.set_title(title, loc="left")


def _clusters(numbers: list[int], x: np.ndarray, y: np.ndarray) -> list[tuple[list[int], float, float]]:
    """Numbers of views that are too near to each other for a label each, and the middle of their places."""
    groups: list[list[int]] = []
    for i in range(len(numbers)):
        near = next((g for g in groups if any(np.hypot(x[i] - x[j], y[i] - y[j]) < _NEAR for j in g)), None)
        if near is None:
            groups.append([i])
        else:
            near.append(i)
    return [([numbers[i] for i in g], float(np.mean(x[g])), float(np.mean(y[g]))) for g in groups]


def _draw_errors(plan: ViewPlan, name: str, axes: Axes, letter: str, *, first: bool, last: bool) -> None:
    """Standard errors before and after each view; none is drawn where there is none."""
    count = np.arange(len(plan.views) + 1)
    unit = plan.units[name]
    shown = {"rad": " (deg)", "nm": " (nm)"}.get(unit, "")

    def one(errors: np.ndarray) -> np.ndarray:
        median: Any = np.median(errors.reshape(len(errors), -1), axis=1)
        return np.asarray(np.where(np.isfinite(median), displayed(median, unit), np.nan))

    nominal, worst = one(plan.standard_errors[name]), one(plan.worst_standard_errors[name])
    if any(plan.spread.values()):
        axes.plot(
            count, worst, "--", color=_COLORS[1], marker=_MARKS[1], ms=4, mfc="white", label="worst of the spread"
        )
    axes.plot(count, nominal, "-", color=_COLORS[0], marker=_MARKS[0], ms=4, label="at the expected values")
    axes.set_yscale("log")
    low, high = np.nanmin(np.append(nominal, worst)), np.nanmax(np.append(nominal, worst))
    axes.set_ylim(low / 1.3, high * (2.2 if first else 1.3))
    if high / low < 6:
        axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
        axes.yaxis.set_minor_locator(NullLocator())
        axes.yaxis.set_major_formatter(ScalarFormatter())
    else:
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if high / low < 100 else (1,)))
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter(NullFormatter())
    lost = count[np.isnan(nominal)]
    if len(lost):
        axes.axvspan(-0.3, lost[-1] + 0.5, color="0.92", lw=0, zorder=0)
        axes.text(
            (lost[-1] + 0.2) / 2,
            0.3,
            "not\nidentifiable",
            fontsize=7,
            ha="center",
            va="center",
            transform=axes.get_xaxis_transform(),
        )
    axes.set_xlim(-0.3, count[-1] + 0.3)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_ylabel(f"std. error{shown}")
    if last:
        axes.set_xlabel("views measured in addition")
    if first:
        axes.legend(loc="upper right")
    median = ", median over the wavelengths" if plan.standard_errors[name].ndim > 1 else ""
    axes.set_title(f"({letter}) {name}{median}", loc="left")
