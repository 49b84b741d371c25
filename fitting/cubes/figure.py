"""The summary figure of a cube: maps of the fitted value and of its standard error, a histogram, the failures."""

import numpy as np
import xarray as xr
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure

from fitting.cubes.blocks import STATUSES

_MOST_PIXELS = 1000
"""Along an edge of a map; larger ones are thinned."""

_COLORS = ("#d9d9d9", "#e69f00", "#cc79a7", "#0072b2", "#009e73", "#f0e442", "#d55e00", "#56b4e9", "#000000")


def draw(maps: xr.Dataset) -> Figure:
    """Draw it.

    Args:
        maps: see ``CubeResult.open``.
    """
    name = maps.attrs["free"].split()[0]
    called = name
    if maps[name].ndim > 2:  # A spectrum is shown where its middle is.
        maps = maps.isel(wavelength=maps.sizes["wavelength"] // 2)
        called = f"{name} at {float(maps['wavelength']):g} nm"
    lines, samples = maps["status"].shape
    step = {
        "line": slice(None, None, -(-lines // _MOST_PIXELS)),
        "sample": slice(None, None, -(-samples // _MOST_PIXELS)),
    }
    thin = maps[[name, f"{name}_standard_error", "status"]].isel(step).load()
    good = thin["status"].values == 0
    unit = {"degree": " (°)", "1": ""}.get(maps[name].attrs["units"], f" ({maps[name].attrs['units']})")
    figure = Figure(figsize=(10, 7.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 2)
    extent = (-0.5, samples - 0.5, lines - 0.5, -0.5)
    for axis, key, title in (
        (axes[0, 0], name, f"{called}{unit}"),
        (axes[0, 1], f"{name}_standard_error", f"standard error of {called}{unit}"),
    ):
        values = np.where(good, thin[key].values, np.nan)
        limits = np.nanpercentile(values, [1, 99]) if np.isfinite(values).any() else (0.0, 1.0)
        image = axis.imshow(values, extent=extent, vmin=limits[0], vmax=limits[1], cmap="viridis", aspect="equal")
        axis.set_facecolor("0.85")
        axis.set(title=title, xlabel="sample", ylabel="line")
        figure.colorbar(image, ax=axis, extend="both", shrink=0.85)
    values = thin[name].values[good]
    axes[1, 0].hist(values, bins=80, color="#0072b2") if values.size else None
    axes[1, 0].set(title=f"{values.size} pixels with an answer", xlabel=f"{called}{unit}", ylabel="pixels")
    status = thin["status"].values
    axes[1, 1].imshow(
        status,
        extent=extent,
        cmap=ListedColormap(_COLORS[: len(STATUSES)]),
        norm=BoundaryNorm(np.arange(len(STATUSES) + 1) - 0.5, len(STATUSES)),
        interpolation="nearest",
        aspect="equal",
    )
    axes[1, 1].set(title="how the fits ended", xlabel="sample", ylabel="line")
    for code in np.unique(status):
        share = np.mean(status == code)
        axes[1, 1].plot(
            [], [], "s", color=_COLORS[code], markeredgecolor="0.4", label=f"{STATUSES[code]}: {share:.2%}"
        )
    axes[1, 1].legend(loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=3, fontsize=8, frameon=False)
    return figure
