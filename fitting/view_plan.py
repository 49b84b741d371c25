"""A plan of views: what to measure next, and what it will tell; in Python, as text and as files."""

import math
from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np

from fitting import files
from fitting.parameters import displayed
from fitting.result import plain

_MOST_COLUMNS = 5


@dataclass(frozen=True)
class PlannedView:
    """One direction in one light.

    Args:
        light: the light's name, or the label of a measurement.
        polar: radians; NaN if all reflected light is collected.
        azimuth: radians; likewise.
    """

    light: str
    polar: float
    azimuth: float


@dataclass(frozen=True, eq=False)
class ViewPlan:
    """The views to measure next, and the standard errors to expect.

    Errors are those of the slopes of the model (Cramér-Rao): no unbiased estimate is better, and a fit attains
    them where the model is smooth and has one minimum.

    Args:
        views: to measure, the most useful first, N of them.
        chosen: their places among the candidates.
        candidates: all that could be chosen.
        measured: the directions measured before, under the labels of their measurements.
        values: for which the plan is made, by name; radians for angles.
        units: "rad", "nm" or "1", by name.
        spread: how much what is searched may differ, by name, in the same units.
        standard_errors: by name, before any view and after each of them, at these values: shape (N + 1,), or
            (N + 1, L) for a spectrum. Infinite where not identifiable.
        worst_standard_errors: likewise, the largest within the spread.
        interest: names of what the criterion counts.
        criterion: "A" or "D".
        criterion_values: shape (N + 1,), less is better: the regularized sum of relative variances ("A"), or the
            logarithm of the determinant of the scaled covariance ("D").
        method: "exchange", "greedy" or "exhaustive".
        noise: standard uncertainty at each wavelength, shape (L,).
        wavelengths_nm: nm, shape (L,); None if none were given.
        attainable: by name, whether all candidates together would make a number identifiable.
    """

    views: tuple[PlannedView, ...]
    chosen: tuple[int, ...]
    candidates: tuple[PlannedView, ...]
    measured: tuple[PlannedView, ...]
    values: dict[str, float]
    units: dict[str, str]
    spread: dict[str, float]
    standard_errors: dict[str, np.ndarray]
    worst_standard_errors: dict[str, np.ndarray]
    interest: tuple[str, ...]
    criterion: str
    criterion_values: np.ndarray
    method: str
    noise: np.ndarray
    wavelengths_nm: np.ndarray | None
    attainable: dict[str, bool]

    @property
    def polar(self) -> np.ndarray:
        """Polar angles of the views, radians, shape (N,)."""
        return np.array([view.polar for view in self.views])

    @property
    def azimuth(self) -> np.ndarray:
        """Azimuths of the views, radians, shape (N,)."""
        return np.array([view.azimuth for view in self.views])

    @property
    def lights(self) -> tuple[str, ...]:
        """The light of each view, by name."""
        return tuple(view.light for view in self.views)

    @property
    def identifiable(self) -> dict[str, np.ndarray]:
        """By name, whether it is identifiable anywhere within the spread: before and after each view, (N + 1,)."""
        return {
            name: np.isfinite(errors.reshape(len(errors), -1)).all(axis=1)
            for name, errors in self.worst_standard_errors.items()
        }

    @property
    def all_identifiable(self) -> bool:
        """Whether everything is identifiable after the last view."""
        return all(bool(known[-1]) for known in self.identifiable.values())

    @property
    def message(self) -> str:
        """What the plan attains, and what to do if that is not enough."""
        lost = [name for name, known in self.identifiable.items() if not known[-1]]
        if not lost:
            return "every parameter is identifiable after these views"
        names = f"not identifiable after these views: {', '.join(lost)}; "
        if all(self.attainable.get(name, True) for name in lost):
            return names + "choose more of them (a larger count)"
        return names + (
            "not even all candidates together determine this: add candidates (more grazing, across the grooves), "
            "fix a parameter or give it a prior"
        )

    def summary(self) -> str:
        """A table to read: the views, and the standard errors before and after each of them."""
        others = [name for name in self.standard_errors if name not in self.interest]
        shown = [*self.interest, *others][: max(_MOST_COLUMNS, len(self.interest))]
        shown = [name for name in shown if name in self.standard_errors]
        spread = any(self.spread.values())
        header = ["view", "light", "polar", "azimuth"]
        for name in shown:
            header.append(name)
            if spread and name in self.interest:
                header.append("at worst")
        rows = [header]
        for step in range(len(self.views) + 1):
            rows.append(self._row(step, shown, spread))
        widths = [max(len(row[i]) for row in rows) for i in range(len(header))]
        lines = ["  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in rows]
        hidden = len(self.standard_errors) - len(shown)
        if hidden:
            lines.append(f"and {hidden} more")
        return "\n".join([*lines, "", self._about(), f"{self.message}."])

    def _row(self, step: int, shown: list[str], spread: bool) -> list[str]:
        if step:
            view = self.views[step - 1]
            everywhere = math.isnan(view.polar)
            row = [
                str(step),
                view.light,
                "all" if everywhere else _degrees(view.polar),
                "" if everywhere else _degrees(view.azimuth),
            ]
        else:
            row = ["before", f"{len(self.measured)} measured" if self.measured else "none", "", ""]
        for name in shown:
            row.append(self._cell(self.standard_errors[name][step], name))
            if spread and name in self.interest:
                row.append(self._cell(self.worst_standard_errors[name][step], name))
        return row

    def _cell(self, error: Any, name: str) -> str:
        """A standard error; of a spectrum the median."""
        unit = {"rad": " deg", "nm": " nm"}.get(self.units[name], "")
        if not np.isfinite(error).all():
            return "not identifiable"
        number = displayed(float(np.median(error)), self.units[name])
        return f"± {number:.2g}{unit}" if number < 10 else f"± {number:.0f}{unit}"

    def _about(self) -> str:
        """How and for what it was planned."""
        near = []
        for name, value in self.values.items():
            if name in self.spread:
                unit = " deg" if self.units[name] == "rad" else ""
                shown, wide = (displayed(v, self.units[name]) for v in (value, self.spread[name]))
                near.append(f"{name} {shown:.4g} ± {wide:.2g}{unit}" if wide else f"{name} {shown:.4g}{unit}")
        low, high = float(self.noise.min()), float(self.noise.max())
        noise = f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"
        planned = f"planned for {', '.join(near)}; " if near else ""
        return (
            f"{planned}{self.criterion}-optimal for {', '.join(self.interest)} ({self.method}, "
            f"{len(self.candidates)} candidates, noise {noise})"
        )

    def to_dict(self) -> dict[str, Any]:
        """The content of ``plan.json``: plain numbers, angles in degrees, None for what is not identifiable."""
        from vcavity_jax import __version__

        def direction(view: PlannedView) -> dict[str, Any]:
            return {
                "light": view.light,
                "polar_deg": math.degrees(view.polar),
                "azimuth_deg": math.degrees(view.azimuth),
            }

        parameters = {
            name: {
                "unit": "deg" if self.units[name] == "rad" else self.units[name],
                "standard_error": displayed(errors, self.units[name]),
                "worst_standard_error": displayed(self.worst_standard_errors[name], self.units[name]),
                "identifiable": self.identifiable[name],
            }
            | ({"value": displayed(self.values[name], self.units[name])} if name in self.values else {})
            | ({"spread": displayed(self.spread[name], self.units[name])} if name in self.spread else {})
            for name, errors in self.standard_errors.items()
        }
        content = {
            "views": [direction(view) for view in self.views],
            "measured": [direction(view) for view in self.measured],
            "candidates": [direction(view) for view in self.candidates],
            "chosen": list(self.chosen),
            "parameters": parameters,
            "interest": list(self.interest),
            "identifiable": self.all_identifiable,
            "message": self.message,
            "criterion": self.criterion,
            "criterion_values": self.criterion_values,
            "method": self.method,
            "noise": self.noise,
            "wavelengths_nm": self.wavelengths_nm,
            "version": __version__,
        }
        shown: dict[str, Any] = plain(content)
        return shown

    def to_json(self, path: str | PathLike[str]) -> None:
        """Write ``to_dict()`` to a file, whole or not at all.

        Raises:
            OSError: the file cannot be written.
        """
        files.write_json(path, self.to_dict())

    def to_csv(self, path: str | PathLike[str]) -> None:
        """Write a table: a row for "before" (view 0) and one for each view; of spectra the median of the errors.

        Angles and their errors are degrees. A cell is empty without a direction, or where nothing is identifiable.

        Raises:
            OSError: the file cannot be written.
        """
        columns = ["view", "light", "polar_deg", "azimuth_deg", "criterion"]
        for name in self.standard_errors:
            suffix = {"rad": "_deg", "nm": "_nm"}.get(self.units[name], "")
            columns += [f"{name}_standard_error{suffix}", f"{name}_worst_standard_error{suffix}"]
        lines = [",".join(columns)]
        for step in range(len(self.views) + 1):
            cells: list[Any] = [None, None]
            light = ""
            if step:
                view = self.views[step - 1]
                light, cells = view.light, [math.degrees(view.polar), math.degrees(view.azimuth)]
            cells.append(float(self.criterion_values[step]))
            for name in self.standard_errors:
                for errors in (self.standard_errors, self.worst_standard_errors):
                    cells.append(displayed(float(np.median(errors[name][step])), self.units[name]))
            quoted = f'"{light.replace(chr(34), chr(34) * 2)}"' if set(light) & set(',"\n') else light
            numbers = [files.number(c) if c is not None and math.isfinite(c) else "" for c in cells]
            lines.append(",".join([str(step), quoted, *numbers]))
        files.write(path, "\n".join(lines) + "\n")

    def plot(self, path: str | PathLike[str]) -> None:
        """Draw the directions and the errors to a picture file.

        Raises:
            OSError: the file cannot be written.
            ValueError: its ending is not .png, .pdf or .svg.
        """
        from fitting.plan_plot import plot_plan

        plot_plan(self, path)


def _degrees(angle: float) -> str:
    return f"{round(math.degrees(angle), 6) + 0.0:.4g} deg"
