"""Pictures of a fit: the spectra, what is left of them, and the objective along each parameter.

One column of print wide, readable in gray and with any color vision: series differ in lightness, line style
and marker, not in hue alone. Figures are drawn without pyplot, so no state of the caller is touched.
"""
# ruff: noqa: RUF001 (the labels are typeset: Greek letters, a real minus)

import io
from collections.abc import Callable
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator, NullFormatter, SymmetricalLogLocator

from fitting import files
from fitting.identifiability import threshold_95
from fitting.measurement import Measurement
from fitting.profile import ProfileLikelihood
from fitting.result import FitResult, SpectralEstimate

FORMATS = ("png", "pdf", "svg")
MOST_SERIES = 8
MOST_PROFILES = 6
# More points than this in a series and error bars run into each other.
MOST_MARKS = 45

_WIDTH = 3.5  # inches: one column of a journal
_MARKS = "os^DvP<X"
_DASHES: tuple[Any, ...] = ("-", (0, (5, 1.5)), (0, (1, 1)), (0, (5, 1.2, 1, 1.2)))
_LABELS = {"angle": "dihedral angle α", "roughness": "roughness m"}
_BAND, _ACCENT = "#d9d9d9", "#0072B2"
_STYLE = {
    "font.size": 8.0,
    "axes.labelsize": 8.0,
    "axes.titlesize": 8.0,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "legend.fontsize": 8.0,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "lines.linewidth": 1.0,
    "legend.frameon": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "figure.constrained_layout.h_pad": 0.04,
    "figure.constrained_layout.w_pad": 0.03,
    "pdf.fonttype": 42,
    "svg.fonttype": "none",
    "svg.hashsalt": "vcavity",
}


@dataclass(frozen=True)
class _Series:
    """One curve: where, what was measured and what the model says, all of the same length."""

    label: str
    place: np.ndarray
    measured: np.ndarray
    uncertainty: np.ndarray | None
    predicted: np.ndarray
    residual: np.ndarray


def plot_fit(result: FitResult, path: str | PathLike[str]) -> None:
    """Draw a fit into a file: data and model, residuals, and the profile of each searched parameter.

    At most eight directions are drawn, evenly chosen, and the figure says so. A measurement at a single
    wavelength is drawn over the view angle instead. The file is replaced as a whole or not at all, and the
    same result gives the same bytes.

    Args:
        result: the `FitResult`.
        path: the file; its ending, .png, .pdf or .svg, decides the format.

    Raises:
        OSError: the file cannot be written.
        ValueError: the ending is none of the three.
    """
    write_figure(lambda: _draw(result), path)


def write_figure(draw: Callable[[], Figure], path: str | PathLike[str], *, dpi: int = 300) -> None:
    """Draw a figure in the style of this package and write it, whole or not at all.

    Args:
        draw: makes the figure; it is called with the style set.
        path: the file; its ending, .png, .pdf or .svg, decides the format.
        dpi: dots per inch of a .png.

    Raises:
        OSError: the file cannot be written.
        ValueError: the ending is none of the three.
    """
    target = Path(path)
    kind = target.suffix.lower().removeprefix(".")
    if kind not in FORMATS:
        raise ValueError(f"{path}: the ending is {target.suffix!r}; expected .png, .pdf or .svg")
    # The caller's matplotlibrc has no say, and nothing of ours stays behind.
    with matplotlib.style.context(["default", _STYLE]):
        figure = draw()
        contents = io.BytesIO()
        dates: dict[str, dict[str, Any]] = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}
        figure.savefig(contents, format=kind, dpi=dpi, metadata=dates.get(kind, {}))
    files.write(target, contents.getvalue())


def _draw(result: FitResult) -> Figure:
    drawn = [name for name, (_, chi_square) in result.profiles.items() if np.isfinite(chi_square).sum() > 1]
    profiles = [_profile(result, name) for name in drawn[:MOST_PROFILES]]
    spectra = [name for name, e in result.estimates.items() if isinstance(e, SpectralEstimate)]
    heights = [2.2, 1.1] * len(result.scenes) + [1.8] * len(spectra)
    for profile in profiles:
        heights += [1.35] * len(profile.ranges)
    figure = Figure(figsize=(_WIDTH, sum(heights) + 1.0), layout="constrained")
    FigureCanvasAgg(figure)
    rows = figure.subplots(len(heights), 1, height_ratios=heights).tolist()
    below, letters = iter(rows), iter("abcdefghijklmnopqrstuvwxyz")
    for index in range(len(result.scenes)):
        _draw_spectra(figure, result, index, [next(below), next(below)], [next(letters), next(letters)])
    for name in spectra:
        _draw_estimate(result.estimates[name], name, next(letters), next(below))
    for profile in profiles:
        _draw_profile(profile, next(letters), [next(below) for _ in profile.ranges])
    figure.align_ylabels(rows)
    return figure


def plot_profile(profile: ProfileLikelihood, path: str | PathLike[str]) -> None:
    """Draw the profile likelihood of one parameter into a file.

    Args:
        profile: from ``FitResult.profile``.
        path: the file; its ending, .png, .pdf or .svg, decides the format.

    Raises:
        OSError: the file cannot be written.
        ValueError: the ending is none of the three.
    """

    def draw() -> Figure:
        figure = Figure(figsize=(_WIDTH, 2.2), layout="constrained")
        FigureCanvasAgg(figure)
        where = "" if profile.wavelength_nm is None else f" at {profile.wavelength_nm:g} nm"
        unit = {"rad": " (deg)", "nm": " (nm)"}.get(profile.unit, "")
        place = np.asarray(profile.displayed(profile.values))
        shown = _Profile(
            label=f"{_LABELS.get(profile.name, profile.name.replace('_', ' '))}{where}{unit}",
            place=place,
            rise=profile.chi_square - profile.minimum,
            best=float(profile.displayed(profile.best)),
            others=[],
            pieces=[(float(profile.displayed(a)), float(profile.displayed(b))) for a, b in profile.interval_95],
            level=profile.level,
            logarithmic=False,
        )
        _draw_profile(shown, "a", [figure.subplots()], whole=True)
        return figure

    write_figure(draw, path)


def _draw_estimate(estimate: SpectralEstimate, name: str, letter: str, axes: Axes) -> None:
    """A fitted spectrum and its intervals."""
    nm = estimate.wavelengths_nm
    for low, high in estimate.interval_95:
        axes.fill_between(nm, low, high, color=_BAND, lw=0, zorder=0)
    axes.plot(nm, estimate.value, color=_ACCENT, marker="o" if len(nm) <= MOST_MARKS else None, ms=2.2, zorder=3)
    axes.set_xlabel("wavelength (nm)")
    axes.set_ylabel(name)
    _title(axes, letter, "fitted spectrum; band: 95 % interval at each wavelength")


def _draw_spectra(figure: Figure, result: FitResult, index: int, panels: list[Axes], letters: list[str]) -> None:
    """Measured and fitted spectra of one measurement, and their difference."""
    above, below = panels
    series, axis_label, total = _series(result, index)
    in_sigma = all(one.uncertainty is not None for one in series)
    shades = matplotlib.colormaps["viridis"](np.linspace(0.0, 0.78, len(series)))
    handles = []
    thinned = 1
    for i, one in enumerate(series):
        every = -(-one.place.size // MOST_MARKS)
        thinned = max(thinned, every)
        dash = _DASHES[i % len(_DASHES)] if one.place.size > 1 else "none"
        look: dict[str, Any] = {"color": shades[i], "zorder": 3 + i}
        mark = {**look, "marker": _MARKS[i], "markersize": 3.2, "markeredgewidth": 0.7}
        shown = slice(i % every, None, every)
        place, measured = one.place[shown], one.measured[shown]
        bars = None if one.uncertainty is None else one.uncertainty[shown]
        above.errorbar(
            place, measured, bars, ls="none", elinewidth=0.6, capsize=0, markerfacecolor="white", **mark
        )
        above.plot(one.place, one.predicted, ls=dash, **look)
        scaled = one.residual if one.uncertainty is None else one.residual / one.uncertainty
        below.plot(place, scaled[shown], ls="none", markerfacecolor="white", **{**mark, "markersize": 2.6})
        handles.append(Line2D([], [], ls=dash, markerfacecolor="white", label=one.label, **mark))

    above.set_ylabel("reflectance factor")
    above.sharex(below)
    above.tick_params(labelbottom=False)
    above.set_ylim(bottom=min(0.0, above.get_ylim()[0]))
    below.axhline(0, color="black", lw=0.6, zorder=1)
    if in_sigma:
        below.axhspan(-2, 2, color=_BAND, lw=0, zorder=0)
        reach = max(3.0, 1.08 * np.nanmax(np.abs(below.dataLim.intervaly)))
        below.set_ylim(-reach, reach)
        below.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 4, 10]))
        below.set_ylabel("residual / σ")
    else:
        below.set_ylabel("residual")
    below.set_xlabel(axis_label)
    marked = "measured" if thinned == 1 else f"measured (one in {thinned})"
    of = "" if len(result.scenes) == 1 else f"{result.labels[index]}; "
    _title(above, letters[0], f"{of}points: {marked}, lines: fitted")
    sigma = "σ, σ estimated" if result.uncertainty_estimated else "σ"
    _title(below, letters[1], "measured minus fitted" + (f" (band: ±2{sigma})" if in_sigma else ""))
    shown_of_all = f" ({len(series)} of {total} shown)" if total > len(series) else ""
    alone = len(result.scenes) == 1
    legend = figure.legend if alone else above.legend
    place_of_legend: dict[str, Any] = {"loc": "outside upper center"} if alone else {"loc": "best", "fontsize": 6}
    legend(
        handles=handles,
        **place_of_legend,
        ncols=min(4, len(handles)),
        title=_legend_title(result.measurements[index]) + shown_of_all,
        handlelength=2.2,
        columnspacing=1.0,
        handletextpad=0.4,
    )


def _series(result: FitResult, index: int) -> tuple[list[_Series], str, int]:
    """The curves to draw, the label of their axis, and how many there are in all."""
    m = result.measurements[index]
    sigma = m.standard_uncertainty
    polar, azimuth = np.rad2deg(m.polar), np.rad2deg(m.azimuth)

    def cut(label: str, place: np.ndarray, part: Any) -> _Series:
        return _Series(
            label,
            place,
            m.reflectance_factor[part],
            None if sigma is None else sigma[part],
            result.predictions[index][part],
            result.misfits[index][part],
        )

    if m.wavelengths_nm.size == 1 and m.polar.size > 1:
        groups = list(dict.fromkeys(azimuth.tolist()))
        members = [np.flatnonzero(azimuth == group) for group in _chosen(groups)]
        members = [group[np.argsort(polar[group], kind="stable")] for group in members]
        series = [cut(_degrees(azimuth[group[0]]), polar[group], (group, 0)) for group in members]
        return series, "polar angle of the view (deg)", len(groups)
    if m.hemispherical:
        return [cut("all directions", m.wavelengths_nm, 0)], "wavelength (nm)", 1
    one_azimuth = np.ptp(azimuth) < 1e-9
    series = [
        cut(
            _degrees(polar[i]) if one_azimuth else f"{_degrees(polar[i])}, {_degrees(azimuth[i])}",
            m.wavelengths_nm,
            i,
        )
        for i in _chosen(list(range(polar.size)))
    ]
    return series, "wavelength (nm)", polar.size


def _chosen(all_of_them: list[Any]) -> list[Any]:
    """At most eight, evenly spread, the first and the last among them."""
    places = np.linspace(0, len(all_of_them) - 1, min(MOST_SERIES, len(all_of_them))).round().astype(int)
    return [all_of_them[i] for i in places]


def _legend_title(m: Measurement) -> str:
    if m.hemispherical:
        return "view"
    if m.wavelengths_nm.size == 1 and m.polar.size > 1:
        return f"azimuth of the view at {m.wavelengths_nm[0]:g} nm"
    if np.ptp(m.azimuth) < 1e-9:
        return f"polar angle of the view at azimuth {_degrees(np.rad2deg(m.azimuth[0]))}"
    return "view: polar angle, azimuth"


def _degrees(value: float) -> str:
    # Adding 0.0 turns -0.0 into 0.0.
    return f"{round(float(value), 2) + 0.0:g}°".replace("-", "−")


def _plain(value: float, _: Any) -> str:
    """A power of ten without small raised digits, which print too small to read."""
    return f"{value:g}" if abs(value) < 1e4 else f"{value:.0e}".replace("e+0", "e").replace("e+", "e")


def _title(axes: Axes, letter: str, text: str) -> None:
    axes.set_title(f"({letter}) {text}", loc="left")


@dataclass(frozen=True)
class _Profile:
    """The objective along one parameter, in the unit it is shown in, less its least value."""

    label: str
    place: np.ndarray
    rise: np.ndarray
    best: float
    others: list[tuple[float, float]]
    pieces: list[tuple[float, float]]
    level: float
    logarithmic: bool

    @property
    def ranges(self) -> list[tuple[float, float]]:
        """What to draw: all of it; and around the answer, if that is much narrower."""
        first, last = float(self.place[0]), float(self.place[-1])
        low = min([self.best, *(piece[0] for piece in self.pieces)])
        high = max([self.best, *(piece[1] for piece in self.pieces)])
        margin = 0.6 * (high - low) or 0.02 * (last - first)
        close = max(low - margin, first), min(high + margin, last)
        return [(first, last)] + [close] * (close[1] - close[0] < 0.5 * (last - first))


def _profile(result: FitResult, name: str) -> _Profile:
    """The profile of a parameter; where it has no value, the curve has a gap."""
    estimate = result.estimates[name]
    values, chi_square = (np.asarray(part, dtype=np.float64) for part in result.profiles[name])
    place = np.asarray(estimate.displayed(values))
    minima = [(float(estimate.displayed(m.values[name])), m.chi_square) for m in result.minima]
    lowest = min([float(np.nanmin(chi_square)), *(chi for _, chi in minima)])
    best = float(estimate.displayed(estimate.value))
    label = _LABELS.get(name, name.replace("_", " "))
    first, last = float(place[0]), float(place[-1])
    return _Profile(
        label=label if estimate.display_unit == "1" else f"{label} ({estimate.display_unit})",
        place=place,
        rise=chi_square - lowest,
        best=best,
        others=[(at, chi - lowest) for at, chi in minima if abs(at - best) > 1e-9 * max(1.0, abs(best))],
        pieces=[
            (max(float(estimate.displayed(low)), first), min(float(estimate.displayed(high)), last))
            for low, high in estimate.interval_95
        ],
        level=threshold_95(result.degrees_of_freedom, result.uncertainty_estimated),
        logarithmic=estimate.unit == "1" and first > 0 and last > 20 * first,
    )


def _draw_profile(profile: _Profile, letter: str, panels: list[Axes], whole: bool = False) -> None:
    ranges = profile.ranges[:1] if whole else profile.ranges
    for i, (axes, (low, high)) in enumerate(zip(panels, ranges, strict=True)):
        for piece in profile.pieces:
            axes.axvspan(*piece, color=_BAND, lw=0, zorder=0)
            for edge in piece:
                axes.axvline(edge, color="gray", lw=0.5, zorder=1)
        axes.axhline(profile.level, color="black", ls=(0, (4, 2)), lw=0.7, zorder=2)
        axes.plot(profile.place, profile.rise, color=_ACCENT, zorder=3)
        at = [place for place, _ in profile.others]
        rise = [height for _, height in profile.others]
        axes.plot(at, rise, ls="none", marker="^", ms=4.5, mfc="white", mec="black", zorder=5)
        axes.plot(profile.best, 0, ls="none", marker="D", ms=4, color="black", zorder=6, clip_on=False)
        axes.set_ylabel("Δχ²")
        axes.set_xlabel(profile.label)
        axes.set_xlim(low, high)
        inside = profile.rise[(profile.place >= low) & (profile.place <= high)]
        highest = float(np.nanmax(inside, initial=0.0))
        if i == 0 and highest > 20 * profile.level:
            _use_decades(axes, highest)
        else:
            most = 20 * profile.level if i == 0 else 4 * profile.level
            axes.set_ylim(0, float(np.clip(highest, 1.6 * profile.level, most)))
        if i == 0 and profile.logarithmic:
            axes.set_xscale("log")
            axes.xaxis.set_major_formatter(_plain)
            axes.xaxis.set_minor_formatter(NullFormatter())
        else:
            axes.xaxis.set_major_locator(MaxNLocator(6 if high - low > 10 else 4))
            axes.ticklabel_format(axis="x", useOffset=False)
    band = "; band: 95 % interval"
    marks = "◆ best, △ other minima" if profile.others else "◆ best"
    _title(panels[0], letter, f"objective; {marks}" + band * (len(panels) == 1 and not profile.others))
    if len(panels) > 1:
        _title(panels[1], letter + "′", "the same, close up" + band)
    panels[-1].annotate(
        "95 %",
        (1, profile.level),
        xycoords=("axes fraction", "data"),
        xytext=(-2, 1.5),
        textcoords="offset points",
        ha="right",
        va="bottom",
    )


def _use_decades(axes: Axes, highest: float) -> None:
    """A vertical axis that is linear up to 10 and logarithmic above."""
    axes.set_yscale("symlog", linthresh=10, linscale=1.0)
    decades = SymmetricalLogLocator(base=10, linthresh=10)
    decades.set_params(numticks=6)
    axes.yaxis.set_major_locator(decades)
    axes.yaxis.set_major_formatter(_plain)
    axes.set_ylim(0, 2 * highest)
