"""Runs the benchmark and writes what was found: JSON, a Markdown table and a figure."""

import argparse
import dataclasses
import sys
from collections.abc import Callable, Iterable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import jax
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from fitting import files
from fitting.bench.measure import FULL, ROUNDING, Effort, Machines, Quantity, Row, rows
from fitting.bench.peak import measure_peak
from fitting.bench.timing import describe_machine
from fitting.plots import write_figure

PARTS = {
    "diffusing": "diffusing",
    "mirrors": "mirrors",
    "interfaced": "interfaced",
    "random grooves": "random_grooves",
}
"""Names, and the modules that hold the quantities."""


def quantities(parts: Iterable[str]) -> list[Quantity]:
    """Of some parts."""
    return [q for part in parts for q in import_module(f"fitting.bench.{PARTS[part]}").QUANTITIES]


def find_machines() -> tuple[Machines, dict[str, str]]:
    """The CPU, and a GPU where JAX finds one; and words on them."""
    cpu, best = jax.devices("cpu")[0], jax.devices()[0]
    machines = [(device, measure_peak(device)) for device in dict.fromkeys((cpu, best))]
    return machines, describe_machine() | {
        f"peak of the {device.platform}, double precision": str(peak) for device, peak in machines
    }


def run(
    parts: Iterable[str],
    effort: Effort,
    machines: Machines,
    told: Callable[[str], None],
    peers: Sequence[str] = (),
) -> list[Row]:
    """All rows; each is told as soon as it is measured.

    Args:
        parts: of ``PARTS``.
        effort: how much is measured.
        machines: see ``find_machines``.
        told: is given a line of text for each row.
        peers: optional ones that are asked for: "mitsuba".

    Raises:
        ValueError: a peer is not installed.
    """
    found = []
    for quantity in quantities(parts):
        for peer in peers:
            quantity = import_module(f"fitting.bench.{peer}_peer").beside(quantity)
        for row in rows(quantity, effort, machines):
            told(line(row))
            found.append(row)
    return found


def line(row: Row) -> str:
    """One row to read."""
    asked = "" if row.tolerance is None else f" {row.tolerance:.0e}"
    return (
        f"{row.part}: {row.quantity}: {row.method}{asked}, {row.what}, {row.precision}, {row.scenes} scenes, "
        f"{row.device}: "
        f"{row.time_us:.3g} µs, error {row.error:.1e}"
    )


def markdown(found: Sequence[Row], machine: dict[str, str]) -> str:
    """The table, with ratios to ours at the tolerance next below a peer's error."""
    lines = [f"- {name}: {value}" for name, value in machine.items()]
    lines += [
        "",
        "Times are medians per spectrum of 36 wavelengths, without compilation. Errors are the largest absolute",
        "ones over random scenes; of path tracers, root mean squares; of a gradient, the median of the relative",
        "error of the derivative by the angle or the roughness. Of peak: the time that the arithmetic (as XLA",
        "counts it; of a loop, one pass) takes at best, over the time. Slower by: than ours at an error not",
        "larger.",
        "",
        "| part | quantity | method | device | tolerance | what | scenes | compile (s) | time (µs) | memory (KiB) "
        "| error | success | of peak | slower by |",
        "|---" * 14 + "|",
    ]
    for row in found:
        asked = "" if row.tolerance is None else f"{row.tolerance:.0e}"
        method = row.method if row.precision == "float64" else f"{row.method}, float32"
        compiling = f"{row.compile_s:.1f}" if row.compile_s else ""
        share = f"{row.of_peak:.0%}" if row.of_peak is not None else ""
        lines.append(
            f"| {row.part} | {row.quantity} | {method} | {row.device} | {asked} | {row.what} | {row.scenes} "
            f"| {compiling} | {row.time_us:.3g} | {row.memory_kib:.0f} | {row.error:.1e} | {row.success:.0%} | "
            f"{share} | {_ratio(row, found)} |"
        )
    return "\n".join(lines) + "\n"


def _ratio(row: Row, found: Sequence[Row]) -> str:
    """How much slower a peer is than the fastest of ours that errs no more."""
    if row.method == "vcavity":
        return ""
    ours = [
        one.time_us
        for one in found
        if one.quantity == row.quantity and one.part == row.part and one.method == "vcavity"
        if one.what == "value" and one.precision == "float64" and one.error <= row.error
    ]
    return f"{row.time_us / min(ours):.3g}" if ours else ""


def draw(found: Sequence[Row]) -> Figure:
    """Error against time per spectrum, a panel for each quantity; down and left is better."""
    names = list(dict.fromkeys((row.part, row.quantity) for row in found))
    columns = min(len(names), 4)
    lines = -(-len(names) // columns)
    figure = Figure(figsize=(2.6 * columns + 0.6, 2.5 * lines + 0.9), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False).ravel()
    seen: dict[str, Any] = {}
    for axes, (part, quantity) in zip(panels, names, strict=False):
        mine = [row for row in found if (row.part, row.quantity) == (part, quantity) and row.what == "value"]
        own = [row for row in mine if row.method == "vcavity"]
        for device, precision, batch in dict.fromkeys((row.device, row.precision, row.scenes) for row in own):
            chosen = [row for row in own if (row.device, row.precision, row.scenes) == (device, precision, batch)]
            label = f"vcavity, batch of {batch}" if precision == "float64" else "vcavity, float32"
            label += "" if device == "cpu" else f", {device}"
            style = {"color": "#0072B2", "linestyle": "-" if batch > 1 else ":", "marker": "o", "markersize": 4}
            if precision == "float32":
                style["color"] = "#56B4E9"
            if device != "cpu":
                style["color"] = "#009E73"
            (seen[label],) = axes.plot(
                [row.time_us for row in chosen], [max(row.error, ROUNDING) for row in chosen], **style
            )
        for row in mine:
            if row.method != "vcavity":
                kind = row.method.split(",")[0]
                marker = {"thesis's recipe": "s", "dense Nyström": "^", "path tracer": "x"}.get(kind, "D")
                (seen[kind],) = axes.plot(row.time_us, max(row.error, ROUNDING), marker, color="0.2", markersize=5)
        axes.set(xscale="log", yscale="log", ylim=(1e-17, 1))
        axes.set_title(f"{part}: {quantity}", fontsize=6)
    for k, axes in enumerate(panels):
        axes.set_visible(k < len(names))
        axes.tick_params(labelbottom=k + columns >= len(names))
    figure.supxlabel("time per spectrum (µs)", fontsize=8)
    figure.supylabel("error", fontsize=8)
    figure.legend(list(seen.values()), list(seen), loc="outside upper center", ncols=4, fontsize=7)
    return figure


def write(found: Sequence[Row], machine: dict[str, str], folder: Path) -> list[Path]:
    """``bench.json``, ``bench.md`` and ``bench.png``."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"bench.{kind}" for kind in ("json", "md", "png")]
    files.write_json(paths[0], {"machine": machine, "rows": [dataclasses.asdict(row) for row in found]})
    files.write(paths[1], markdown(found, machine).encode())
    write_figure(lambda: draw(found), paths[2], dpi=150)
    return paths


def main(part: str) -> None:
    """The command line of one part."""
    parser = argparse.ArgumentParser(description=f"Speed against error: {part}.")
    parser.add_argument("outdir", nargs="?", type=Path, help="where to write bench.json, bench.md and bench.png")
    parser.add_argument("--full", action="store_true", help="all tolerances, batches and single precision")
    given = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    machines, words = find_machines()
    effort = FULL if given.full else Effort()
    found = run([part], effort, machines, lambda text: print(text, file=sys.stderr, flush=True))
    if given.outdir is not None:
        write(found, words, given.outdir)
    print(markdown(found, words))
