"""Nodes and time against error for the geometries of instruments, beside directions on a grid as in the thesis.

    python examples/speed_of_geometries.py [OUTDIR] [--full]

writes speed_of_geometries.md, .json and .png into OUTDIR (a new temporary folder by default) and prints the
tables. The default is a short run; --full takes minutes: all quantities, tolerances 1e-3 to 1e-12.

The thesis averages over directions θ, φ on a grid, and in mirror grooves over 100 entry positions for each of
them [SaintPierre2020, eq. 4.33]: thesis_grid.py, where its recipe is treated kindly. Random groove angles are a
sum in steps of the angle; for the bi-hemispherical reflectance the sum is over an interpolation between six
angles [eq. 4.45]. Ours is compiled once for any groove angle or roughness, with the optical data fixed. Both keep
to one core if OPENBLAS_NUM_THREADS=1.
"""

import argparse
import json
import math
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from jaxtyping import Array
from thesis_grid import (
    directions_on_grid,
    facets_in_trapped_sphere,
    facets_seen,
    kinks_in_section,
    mirrors_over,
    random_mirrors_over_sphere,
    random_trapped_mirrors,
    ring_on_grid,
    sphere_of_views,
    trapped_mirrors,
)

import vcavity_jax as vc
from fitting.bench import thesis_recipe
from fitting.bench.diffusing import FRONTAL, REFLECTANCES, SLANTED
from fitting.bench.diffusing import SMALLEST as SMALLEST_ANGLE
from fitting.bench.measure import ROUNDING
from fitting.bench.mirrors import GOLD, WAVELENGTHS_NM
from fitting.bench.thesis_recipe import Real
from fitting.bench.timing import compiled, describe_machine, median_time
from vcavity_jax import planning, resolution
from vcavity_jax.angle_table import BihemisphericalTable
from vcavity_jax.planning import Plan

ROUGHNESS = 0.3
SILICON = vc.materials.refractive_index("Si-Green-2008", WAVELENGTHS_NM)
MAP_SIZE, MAP_SAMPLE = 256, 60
HEADLINE = "mirrors d:d, gold 45°"
TABULATED = "random mirrors d:d, gold m = 0.3, table"
MAP = f"map {MAP_SIZE} x {MAP_SIZE}, gold 45°"
AIM_SPHERE_MS, AIM_TABLE_MS, AIM_MAP_S = 5.0, 1.0, 2.0
AIM_TOLERANCE = 1e-6
TOLERANCE_OF_REFERENCE = 1e-13


def chains(plan: Plan, angle: float) -> str:
    """Fresnel reflections per wavelength of a bi-hemispherical reflectance."""
    most = math.ceil(math.pi / angle - 1e-9)
    return f"{2 * plan.sphere.across * plan.sphere.along * (2 * most - 1)} reflections"


def ring_nodes(plan: Plan, angle: float) -> str:
    """Directions on the ring, order times panels."""
    tangents = np.tan(kinks_in_section(angle)) / np.tan(SLANTED[0])
    marks = np.unique(np.round(np.concatenate([np.arccos(tangents[tangents < 1]), [0.4, 0.8, 1.2]]), 9))
    return f"{plan.order * (len(marks) + 1)} directions"


def contour_nodes(plan: Plan, _: float) -> str:
    """Nodes of the Wiener-Hopf contour."""
    return f"{math.ceil(plan.step.reach / plan.step.step) + 1} contour"


def with_light_nodes(intervals: int, half: bool, plan: Plan, parameter: float) -> str:
    """The same times the nodes of a ring (the half of an interval) or a disk."""
    count = math.ceil(plan.clustering.reach / plan.clustering.step)
    return f"{contour_nodes(plan, parameter)} x {intervals * (count + 1 if half else 2 * count + 1)} light"


@dataclass(frozen=True)
class Quantity:
    """One quantity, for both sides.

    Args:
        name: for the tables.
        group: panel of the figure.
        parameter: dihedral angle in radians, or roughness.
        optical: refractive indices or reflectances.
        geometry: illumination and view.
        thesis: spectrum as a function of the step of the grid in degrees.
        nodes: what a plan comes down to.
        surface: of the parameter.
        steps: of the grid, in degrees, as far as patience goes; inf is a single direction.
        reference: independent spectrum; by default ours, two digits finer than all that is measured.
        short: whether it is part of the default run.
        exact: a finite sum, which the tolerance does not change.
    """

    name: str
    group: str
    parameter: float
    optical: Array
    geometry: tuple[object, object]
    thesis: Callable[[float], Real]
    nodes: Callable[[Plan, float], str]
    surface: Callable[[Array], object] = vc.VGrooves
    steps: tuple[float, ...] = (15, 5, 2, 1)
    reference: Callable[[], Real] | None = None
    short: bool = True
    exact: bool = False
    chunk: int = field(default=1, init=False)

    def scene(self, parameter: Array, optical: Array) -> vc.Scene:
        """The scene of a parameter."""
        material = vc.Specular if jnp.iscomplexobj(optical) else vc.Lambertian
        return vc.Scene(self.surface(parameter), material(optical), *self.geometry)

    @property
    def smallest_angle(self) -> float | None:
        """Known for single grooves."""
        return SMALLEST_ANGLE if self.surface is vc.VGrooves else None

    def ours(self, tolerance: float) -> Callable[[Array, Array], Array]:
        """Spectrum as a function of parameter and optical data."""

        def spectrum(parameter: Array, optical: Array) -> Array:
            scene = self.scene(parameter, optical)
            return vc.reflectance_factor(scene, tolerance, smallest_angle=self.smallest_angle)

        return spectrum

    def size(self, tolerance: float) -> str:
        """What the plan for a parameter that is traced comes down to."""
        found: list[Plan] = []

        def note(parameter: Array) -> Array:
            found.append(planning.plan(self.scene(parameter, self.optical), tolerance, self.smallest_angle))
            return parameter

        jax.eval_shape(note, jnp.asarray(self.parameter))
        return self.nodes(found[0], self.parameter)

    def table_ms(self, tolerance: float) -> float:
        """Time to build the table, if there is one."""
        return 0.0


@dataclass(frozen=True)
class Tabulated(Quantity):
    """Random mirrors d:d after the table of their material has been built, for any roughness up to this one.

    Args:
        built: tables and the seconds that they took, by tolerance.
    """

    built: dict[float, tuple[BihemisphericalTable, float]] = field(default_factory=dict, init=False)

    def ours(self, tolerance: float) -> Callable[[Array, Array], Array]:
        """Spectrum as a function of roughness; the optical data are those of the table."""
        if tolerance not in self.built:
            sampling = resolution.angle_table_resolution(tolerance, self.parameter, tame=True)
            build = partial(BihemisphericalTable.build, model="full", resolution=sampling)
            program, _ = compiled(build, self.optical)
            before = time.perf_counter()
            table = jax.block_until_ready(program(self.optical))
            self.built[tolerance] = table, time.perf_counter() - before
        table, _ = self.built[tolerance]
        return lambda roughness, optical: table.average(roughness)

    def size(self, tolerance: float) -> str:
        """Groove angles in the table."""
        return f"{len(self.built[tolerance][0].values)} angles"

    def table_ms(self, tolerance: float) -> float:
        """Time to build the table."""
        return self.built[tolerance][1] * 1e3


def most_angles(plan: Plan, _: float) -> str:
    """Groove angles that are evaluated if the roughness is the largest; else those that matter."""
    build = partial(BihemisphericalTable.build, model="full", resolution=plan.sphere)
    return f"at most {len(jax.eval_shape(build, jnp.asarray(GOLD)).values)} angles"


def sphere(name: str, angle_deg: float, optical: Array, short: bool) -> Quantity:
    """Bi-hemispherical reflectance of mirrors."""
    angle, index = np.deg2rad(angle_deg), np.asarray(optical)
    return Quantity(
        name=f"mirrors d:d, {name} {angle_deg:g}°",
        group="mirrors, bi-hemispherical",
        parameter=angle,
        optical=optical,
        geometry=vc.cie_geometry("d:d"),
        thesis=lambda step: mirrors_over(index, angle, directions_on_grid(step)),
        nodes=chains,
        reference=lambda: sphere_of_views(index, angle),
        short=short,
    )


def quantities() -> list[Quantity]:
    """What is measured."""
    gold, reflectances, half_right = jnp.asarray(GOLD), jnp.asarray(REFLECTANCES), np.deg2rad(45.0)
    normal = [FRONTAL], np.ones(1)
    random_sphere = {
        "group": "mirrors, bi-hemispherical",
        "optical": gold,
        "surface": vc.BeckmannGrooves,
        "parameter": ROUGHNESS,
        "geometry": vc.cie_geometry("d:d"),
        "thesis": partial(random_mirrors_over_sphere, GOLD, ROUGHNESS),
        "nodes": most_angles,
    }
    mirrors = partial(Quantity, group="mirrors, other", optical=gold)
    diffusers = partial(Quantity, group="diffusers", optical=reflectances, parameter=half_right)
    return [
        sphere("gold", 45, gold, True),
        sphere("silicon", 45, jnp.asarray(SILICON), False),
        sphere("gold", 20, gold, False),
        sphere("gold", 90, gold, False),
        Quantity(**random_sphere, name="random mirrors d:d, gold m = 0.3", steps=(), short=False),
        Tabulated(**random_sphere, name=TABULATED),
        mirrors(
            name="mirrors ring 45° : hemisphere, gold 45°",
            parameter=half_right,
            geometry=(vc.Annular(half_right), vc.Hemisphere()),
            thesis=lambda step: mirrors_over(GOLD, half_right, ring_on_grid(step)),
            nodes=ring_nodes,
        ),
        mirrors(
            name="mirrors de:8, gold 45°",
            parameter=half_right,
            geometry=vc.cie_geometry("de:8"),
            thesis=lambda _: trapped_mirrors(half_right),
            nodes=lambda plan, angle: f"{2 * math.ceil(math.pi / angle - 1e-9)} reflections",
            steps=(math.inf,),
            reference=lambda: trapped_mirrors(half_right, exact=True),
            exact=True,
        ),
        mirrors(
            name="random mirrors de:8, gold m = 0.3",
            surface=vc.BeckmannGrooves,
            parameter=ROUGHNESS,
            geometry=vc.cie_geometry("de:8"),
            thesis=partial(random_trapped_mirrors, ROUGHNESS),
            nodes=lambda plan, _: f"{plan.order} per panel",
            short=False,
        ),
        diffusers(
            name="diffusers d:d, 45°",
            geometry=vc.cie_geometry("d:d"),
            thesis=lambda step: facets_seen(half_right, None, directions_on_grid(step)),
            nodes=lambda plan, _: f"{math.ceil(plan.mean.reach / plan.mean.step) + 1} of a sum",
        ),
        diffusers(
            name="diffusers 45a:0, 45°",
            geometry=vc.cie_geometry("45a:0"),
            thesis=lambda step: facets_seen(half_right, ring_on_grid(step), normal),
            nodes=partial(with_light_nodes, 1, True),
        ),
        diffusers(
            name="diffusers 45x:0, 45°",
            geometry=vc.cie_geometry("45x:0"),
            thesis=lambda _: thesis_recipe.lambertian(half_right, REFLECTANCES, SLANTED, FRONTAL),
            nodes=contour_nodes,
            steps=(math.inf,),
            short=False,
        ),
        diffusers(
            name="diffusers de:8, 45°",
            geometry=vc.cie_geometry("de:8"),
            thesis=partial(facets_in_trapped_sphere, half_right),
            nodes=partial(with_light_nodes, 2, False),
            short=False,
        ),
    ]


@dataclass(frozen=True)
class Row:
    """Ours: one quantity at one tolerance; time per spectrum, compilation and the building of a table apart."""

    quantity: str
    group: str
    tolerance: float | None
    nodes: str
    compile_s: float
    table_ms: float
    time_ms: float
    error: float

    @property
    def total_ms(self) -> float:
        """What the thesis's way is compared with."""
        return self.table_ms + self.time_ms


@dataclass(frozen=True)
class GridRow:
    """The thesis's way at one step of the grid, in degrees; inf is a single direction."""

    quantity: str
    group: str
    step_deg: float
    time_ms: float
    error: float


def largest_error(values: object, reference: Real) -> float:
    """Absolute; infinite if something is not finite."""
    error = float(np.max(np.abs(np.asarray(values) - reference)))
    return error if math.isfinite(error) else math.inf


def measure(quantity: Quantity, tolerances: list[float], patience: float) -> Iterator[Row | GridRow]:
    """Rows of one quantity, and of the thesis's way to it."""
    parameter = jnp.asarray(quantity.parameter)

    def program_for(spectrum: Callable[[Array, Array], Array]) -> tuple[Callable[[Array], Array], float]:
        return compiled(partial(spectrum, optical=quantity.optical), parameter)

    if quantity.reference is None:
        finest = max(tolerances[-1] / 100, TOLERANCE_OF_REFERENCE)
        reference = np.asarray(program_for(Quantity.ours(quantity, finest))[0](parameter))
    else:
        reference = quantity.reference()
    for tolerance in [AIM_TOLERANCE] if quantity.exact else tolerances:
        program, compile_s = program_for(quantity.ours(tolerance))
        seconds = median_time(lambda: program(parameter), patience / 15)  # noqa: B023
        error = largest_error(program(parameter), reference)
        nodes = quantity.size(tolerance)
        shown = None if quantity.exact else tolerance
        times_ms = quantity.table_ms(tolerance), seconds * 1e3
        yield Row(quantity.name, quantity.group, shown, nodes, compile_s, *times_ms, error)
    expected = 0.0
    for step in quantity.steps:
        if expected / step**2 > patience:
            break
        times: list[float] = []
        while len(times) < 3 and sum(times) < patience / 10:
            before = time.perf_counter()
            spectrum = quantity.thesis(step)
            times.append(time.perf_counter() - before)
        seconds = statistics.median(times)
        expected = seconds * step**2
        yield GridRow(quantity.name, quantity.group, step, seconds * 1e3, largest_error(spectrum, reference))


def measure_map() -> Iterator[Row | GridRow]:
    """A map of gold grooves. The thesis's way is timed on a few of its distinct directions; errors are theirs."""
    angle = np.deg2rad(45.0)
    scene = vc.Scene(vc.VGrooves(angle), vc.Specular(GOLD), vc.Diffuse(), vc.View())

    def run() -> vc.ReflectanceMap:
        return jax.block_until_ready(vc.reflectance_map(scene, MAP_SIZE))

    before = time.perf_counter()
    found = run()
    first = time.perf_counter() - before
    seconds = median_time(run, 0.0)
    inside = np.asarray(found.inside)
    chosen = np.random.default_rng(2020).choice(np.flatnonzero(inside), MAP_SAMPLE, replace=False)
    polar, azimuth = np.asarray(found.polar).ravel()[chosen], np.asarray(found.azimuth).ravel()[chosen]
    views = list(zip(polar, azimuth, strict=True))
    entries = [thesis_recipe.exact_entries(angle, view) for view in views]
    exact = np.array([thesis_recipe.specular(angle, GOLD, *pair) for pair in zip(views, entries, strict=True)])
    error = largest_error(found.reflectance_factor.reshape(-1, len(GOLD))[chosen], exact)
    distinct = inside.sum() // 4
    yield Row(MAP, "map", None, f"{distinct} views", first - seconds, 0.0, seconds * 1e3, error)
    before = time.perf_counter()
    sampled = np.array([thesis_recipe.specular(angle, GOLD, view) for view in views])
    per_view = (time.perf_counter() - before) / len(views)
    yield GridRow(MAP, "map", math.inf, per_view * distinct * 1e3, largest_error(sampled, exact))


def aims(rows: list[Row]) -> list[str]:
    """The aims, with what was measured."""

    def verdict(what: str, value: float, aim: float, unit: str) -> str:
        return f"- {what}: {value:.3g} {unit}, aim {aim:g} {unit}: {'reached' if value < aim else 'NOT reached'}"

    time_ms = {(r.quantity, r.tolerance): r.time_ms for r in rows}
    return [
        verdict(f"{HEADLINE}, 1e-6", time_ms[HEADLINE, AIM_TOLERANCE], AIM_SPHERE_MS, "ms"),
        verdict(f"{TABULATED} once built, 1e-6", time_ms[TABULATED, AIM_TOLERANCE], AIM_TABLE_MS, "ms"),
        verdict(MAP, time_ms[MAP, None] / 1e3, AIM_MAP_S, "s"),
    ]


def markdown(rows: list[Row], grid: list[GridRow], aims: list[str], machine: dict[str, str]) -> str:
    """The tables."""
    lines = [f"- {name}: {value}" for name, value in machine.items()] + aims
    lines += [
        "",
        "Times are per spectrum of 36 wavelengths (of the whole map), medians, without compilation; errors are",
        "the largest absolute ones.",
        "",
        "| quantity | tolerance | nodes | compile, s | table, ms | time, ms | error | within tolerance |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for r in rows:
        kept = "yes" if r.error <= (r.tolerance or 1e-13) else "NO"
        tolerance = f"{r.tolerance:.0e}" if r.tolerance else "exact"
        table = f"{r.table_ms:.3g}" if r.table_ms else "-"
        lines.append(
            f"| {r.quantity} | {tolerance} | {r.nodes} | {r.compile_s:.1f} | {table} | {r.time_ms:.3g} |"
            f" {r.error:.1e} | {kept} |"
        )
    lines += [
        "",
        "The thesis's way, and the fastest of ours with at most its error, its table included.",
        "",
        "| quantity | grid | thesis, ms | its error | ours, ms | our error | faster by |",
        "|---|---|---|---|---|---|---|",
    ]
    for g in grid:
        better = [r for r in rows if r.quantity == g.quantity and r.error <= g.error]
        best = min(better, key=lambda r: r.total_ms, default=None)
        ours = "- | - | -"
        if best is not None:
            ours = f"{best.total_ms:.3g} | {best.error:.1e} | {g.time_ms / best.total_ms:.3g}"
        step = "one direction" if math.isinf(g.step_deg) else f"{g.step_deg:g}°"
        lines.append(f"| {g.quantity} | {step} | {g.time_ms:.3g} | {g.error:.1e} | {ours} |")
    return "\n".join(lines) + "\n"


def draw(rows: list[Row], grid: list[GridRow], path: Path) -> None:
    """Error against time, tables included: down and left is better."""
    groups = [group for group in dict.fromkeys(r.group for r in rows) if group != "map"]
    figure, axes = plt.subplots(1, len(groups), figsize=(4.0 * len(groups), 5.4), sharex=True, sharey=True)
    for axis, group in zip(np.atleast_1d(axes), groups, strict=True):
        names = list(dict.fromkeys(r.quantity for r in rows if r.group == group))
        for name, marker, color in zip(names, "osD^vP", ("C0", "C3", "C2", "C1", "0.2", "C4"), strict=False):
            mine = [(r.total_ms, max(r.error, ROUNDING)) for r in rows if r.quantity == name]
            theirs = [(g.time_ms, max(g.error, ROUNDING)) for g in grid if g.quantity == name]
            axis.loglog(*zip(*mine, strict=True), color=color, marker=marker, ms=5, lw=1.2, label=name)
            axis.loglog(*zip(*theirs, strict=True), color=color, marker=marker, ms=8, mfc="none", ls=":", lw=1)
        axis.set_title(group)
        axis.grid(alpha=0.3)
        axis.set_xlabel("time per spectrum, ms")
        axis.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.13), frameon=False)
    axes[0].set_ylabel("largest error")
    note = {"ha": "right", "fontsize": 9, "transform": axes[-1].transAxes}
    axes[-1].text(0.97, 0.03, "filled: vcavity\nopen: the thesis's way", **note)
    figure.tight_layout()
    figure.savefig(path, dpi=200)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("outdir", nargs="?", type=Path, help="where to write; by default a new temporary folder")
    parser.add_argument("--full", action="store_true", help="all of it, minutes instead of seconds")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    mpl.use("Agg")
    folder = options.outdir or Path(tempfile.mkdtemp(prefix="vcavity-geometries-"))
    folder.mkdir(parents=True, exist_ok=True)
    full = options.full
    tolerances = [10.0**-digits for digits in (range(3, 13) if full else (3, 6, 9))]
    patience = 30.0 if full else 3.0
    machine = describe_machine()
    found: list[Row | GridRow] = []
    for quantity in quantities():
        if not (full or quantity.short):
            continue
        found += measure(quantity, tolerances, patience)
    found += measure_map()
    rows = [r for r in found if isinstance(r, Row)]
    grid = [r for r in found if isinstance(r, GridRow)]
    text = markdown(rows, grid, aims(rows), machine)
    (folder / "speed_of_geometries.md").write_text(text, encoding="utf-8")
    record = {
        "machine": machine,
        "rows": [asdict(r) for r in rows],
        "grid": [asdict(r) for r in grid],
    }
    (folder / "speed_of_geometries.json").write_text(json.dumps(record, indent=1), encoding="utf-8")
    draw(rows, grid, folder / "speed_of_geometries.png")
    print(text)
    print(f"written to {folder}")


if __name__ == "__main__":
    main()
