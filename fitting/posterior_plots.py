"""Pictures of a posterior: corner plot, traces, and the measurement against what the posterior predicts."""
# ruff: noqa: RUF001 (the labels are typeset: Greek letters, a real minus)

from os import PathLike

import corner
import numpy as np
from matplotlib.figure import Figure

from fitting.plots import write_figure
from fitting.posterior import Posterior

_MOST_NUMBERS = 8
_MOST_VIEWS = 6
_DRAWS = 300
_LABELS = {"angle": "dihedral angle α", "roughness": "roughness m", "noise": "noise / stated noise"}


def _label(posterior: Posterior, name: str) -> str:
    unit = {"rad": " (°)", "nm": " (nm)"}.get(posterior.estimates[name].unit, "")
    return f"{_LABELS.get(name, name.replace('_', ' '))}{unit}"


def _shown(posterior: Posterior, name: str) -> np.ndarray:
    one = posterior.estimates[name]
    return np.asarray(one.displayed(posterior.chains[name]))


def plot_corner(posterior: Posterior, path: str | PathLike[str]) -> None:
    """Marginal histograms and pairwise densities, with 68 and 95 % contours and the median dashed."""

    def draw() -> Figure:
        names = list(posterior.chains)[:_MOST_NUMBERS]
        size = max(3.5, 1.5 * len(names) + 0.8)
        figure = Figure(figsize=(size, size))
        data = np.stack([_shown(posterior, name).reshape(-1) for name in names], axis=1)
        corner.corner(
            data,
            fig=figure,
            bins=30,
            labels=[_label(posterior, name) for name in names],
            levels=(0.68, 0.95),
            quantiles=[0.025, 0.5, 0.975],
            plot_datapoints=False,
            smooth=1.0,
            max_n_ticks=3,
            labelpad=0.12,
            hist_kwargs={"linewidth": 1.0},
        )
        figure.subplots_adjust(left=0.75 / size, bottom=0.75 / size, right=1 - 0.15 / size, top=1 - 0.15 / size)
        return figure

    write_figure(draw, path)


def plot_trace(posterior: Posterior, path: str | PathLike[str]) -> None:
    """Every chain against its steps."""

    def draw() -> Figure:
        names = list(posterior.chains)[:_MOST_NUMBERS]
        figure = Figure(figsize=(3.5, 0.5 + 1.1 * len(names)), layout="constrained")
        axes = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
        for one, name in zip(axes, names, strict=True):
            one.plot(_shown(posterior, name).T, color="0.2", linewidth=0.3, alpha=0.5, rasterized=True)
            one.set_ylabel(_label(posterior, name))
        axes[-1].set_xlabel("step after burn-in" if posterior.method == "emcee" else "draw")
        figure.align_ylabels(axes)
        return figure

    write_figure(draw, path)


def plot_predictive(posterior: Posterior, path: str | PathLike[str]) -> None:
    """Measured values and the 95 % band of new measurements, noise included, in each direction."""

    def draw() -> Figure:
        result, random = posterior.result, np.random.default_rng(0)
        level = posterior.chains["noise"].mean() if "noise" in posterior.chains else 1.0
        every = [(i, d) for i, m in enumerate(result.measurements) for d in range(len(m.polar))]
        count = len(every)
        chosen = np.unique(np.linspace(0, count - 1, min(count, _MOST_VIEWS)).astype(int))
        figure = Figure(figsize=(3.5, 0.5 + 1.2 * len(chosen)), layout="constrained")
        axes = figure.subplots(len(chosen), 1, sharex=True, squeeze=False)[:, 0]
        bands = []
        for predicted, m in zip(posterior.predicted(_DRAWS), result.measurements, strict=True):
            assert m.standard_uncertainty is not None
            noise = level * m.standard_uncertainty * random.standard_normal(predicted.shape)
            bands.append((*np.quantile(predicted + noise, [0.025, 0.975], axis=0), np.median(predicted, axis=0)))
        for one, (i, d) in zip(axes, [every[k] for k in chosen], strict=True):
            m, (low, high, middle) = result.measurements[i], (band[d] for band in bands[i])
            place = m.wavelengths_nm
            # The bands are thinner than the line of a spectrum: all is drawn less the predicted median.
            one.fill_between(place, low - middle, high - middle, color="0.8", linewidth=0, label="95 % predicted")
            one.axhline(0, color="0.3", label="median")
            one.plot(place, m.reflectance_factor[d] - middle, "o", color="#0072B2", markersize=2, label="measured")
            polar, azimuth = (float(np.degrees(a[d])) for a in (m.polar, m.azimuth))
            where = f"θ = {polar:.0f}°, φ = {azimuth:.0f}°"
            one.set_title(where if len(result.labels) == 1 else f"{result.labels[i]}: {where}", loc="left")
        axes[0].legend(ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.12), fontsize=7, handlelength=1.2)
        axes[-1].set_xlabel("wavelength (nm)")
        figure.supylabel("reflectance factor less the predicted median", fontsize=8)
        return figure

    write_figure(draw, path)
