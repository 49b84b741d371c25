"""Panels under an interface: error against orders, nodes and time, beside the thesis's recipe; and times per case.

    python examples/interfaced_speed_against_error.py [OUTDIR] [--full]

writes interfaced_speed_against_error.md into OUTDIR (a new temporary folder by default) and prints it. The
default is a short run; --full takes minutes: all cases, angles of 45° and 20°, tolerances 1e-3 to 1e-12, a batch.

Spectra have 36 wavelengths. Angle, index, directions and reflectances are arguments of the programs, so that
nothing is computed beforehand. The recipe of the thesis, fitting.bench, has 64 facets and one reflection; here
its wavelengths are solved together. Errors are the largest of a spectrum, against a tolerance of 1e-13; times are
the shortest of many calls, of compiled programs.
"""

import argparse
import dataclasses
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

import vcavity_jax as vc
from fitting.bench import thesis_recipe
from fitting.bench.diffusing import REFLECTANCES
from fitting.bench.diffusing import SMALLEST as SMALLEST_ANGLE
from fitting.bench.timing import compiled, describe_machine
from vcavity_jax import interfaced_scene, planning, wiener_hopf
from vcavity_jax.directions import components
from vcavity_jax.planning import Plan
from vcavity_jax.scene import Illumination

jax.config.update("jax_enable_x64", True)

INDEX = 1.5
TOLERANCE_OF_REFERENCE = 1e-13
DISPERSED = INDEX + 0.004 * jnp.linspace(1, -1, REFLECTANCES.size)
LAYER = jnp.linspace(0.2, 0.95, REFLECTANCES.size)
AIM_VALUE_MS, AIM_GRADIENT_MS = 1.0, 5.0
LARGEST_ANGLE, STEEPEST = np.deg2rad(170.0), np.deg2rad(75.0)


@dataclasses.dataclass(frozen=True)
class Case:
    """A groove in its light; azimuth 0 is across the grooves.

    Args:
        name: for the tables.
        light: diffuse or directional.
        view: polar angle and azimuth, degrees.
        material: what differs from an interface of n = 1.5 without a layer.
    """

    name: str
    light: Illumination
    view: tuple[float, float]
    material: dict[str, Any] = dataclasses.field(default_factory=dict)

    def scene(self, angle: float | Array, index: Any = None, reflectance: Any = REFLECTANCES) -> vc.Scene:
        """The scene for one groove."""
        given = {"index": INDEX, **self.material} | ({} if index is None else {"index": index})
        material = vc.InterfacedLambertian(reflectance, **given)
        return vc.Scene(vc.VGrooves(jnp.asarray(angle)), material, self.light, vc.View(*np.deg2rad(self.view)))


FRONTAL = Case("frontal light and view", vc.Directional(), (0, 0))
DIFFUSE = Case("diffuse light, frontal view", vc.Diffuse(), (0, 0))
CASES = (
    DIFFUSE,
    Case("diffuse light, view 45°, 30°", vc.Diffuse(), (45, 30)),
    FRONTAL,
    Case("light 15°, 20°, view 10°, 60°: all lit and seen", vc.Directional(*np.deg2rad((15, 20))), (10, 60)),
    Case("light 50°, 20°, view 40°: shadow and mask", vc.Directional(*np.deg2rad((50, 20))), (40, 0)),
    Case("diffuse light, frontal view, full polarization", vc.Diffuse(), (0, 0), {"polarization": "full"}),
    Case("diffuse light, frontal view, colored layer", vc.Diffuse(), (0, 0), {"layer": vc.ColoredLayer(LAYER)}),
    Case("diffuse light, frontal view, dispersed index", vc.Diffuse(), (0, 0), {"index": DISPERSED}),
)


@partial(jax.jit, static_argnums=0)
def evaluate(plan: Plan, scene: vc.Scene) -> Array:
    """The reflectance factor with given nodes; what ``vc.reflectance_factor`` compiles."""
    material, view = scene.material, scene.view
    assert isinstance(material, vc.InterfacedLambertian)
    assert isinstance(view, vc.View)
    views = components(jnp.atleast_1d(view.polar), jnp.atleast_1d(view.azimuth))
    return interfaced_scene.reflectance(material, scene.illumination, scene.surface, views, plan)[0]


def shortest(run: Callable[[], Any], seconds: float = 0.5) -> float:
    """Shortest duration of several calls, in milliseconds."""
    start = time.perf_counter()
    times: list[float] = []
    while len(times) < 3 or time.perf_counter() - start < seconds:
        before = time.perf_counter()
        jax.block_until_ready(run())
        times.append(time.perf_counter() - before)
    return 1e3 * min(times)


@dataclasses.dataclass(frozen=True)
class Measured:
    """A spectrum, the milliseconds it takes, and the seconds of the first call."""

    values: np.ndarray
    milliseconds: float
    first_s: float

    @classmethod
    def of(cls, plan: Plan, scene: vc.Scene) -> "Measured":
        """The program for one scene; it is compiled once."""
        before = time.perf_counter()
        values = np.asarray(evaluate(plan, scene))
        first_s = time.perf_counter() - before
        return cls(values, shortest(lambda: evaluate(plan, scene)), first_s)

    def error(self, reference: np.ndarray) -> float:
        """The largest of the spectrum."""
        return float(np.max(np.abs(self.values - reference)))


def table(heads: list[str], rows: Iterator[list[str]]) -> str:
    """A Markdown table."""
    lines = ["| " + " | ".join(cells) + " |" for cells in (heads, ["---"] * len(heads), *rows)]
    return "\n".join(lines) + "\n"


def nodes(plan: Plan) -> str:
    """What a plan comes down to: nodes of the contour, of the path of the symbol and of the tilt of rays."""
    of = plan.interface
    assert of is not None
    path = np.arcsinh(of.reach / min(of.contour.smallest_angle, 1.2) / np.cos(of.tilt)) / of.step
    return f"{len(wiener_hopf.contour(of.contour).tau)}, {int(np.ceil(path)) + 1}, {of.order}"


def against_recipe(angle_deg: float, tolerances: list[float], orders: list[int]) -> Iterator[list[str]]:
    """Rows for one groove in frontal light: kept reflections, tolerances, the thesis."""
    angle = np.deg2rad(angle_deg)
    scene = FRONTAL.scene(angle)
    finest = planning.plan(scene, TOLERANCE_OF_REFERENCE)
    assert finest.interface is not None
    reference = Measured.of(finest, scene)

    def row(name: str, kept: int, of: str, measured: Measured, compiling: str) -> list[str]:
        error = measured.error(reference.values)
        return [f"{angle_deg:g}°", name, f"{kept}", of, f"{error:.1e}", f"{measured.milliseconds:.2f}", compiling]

    recipe = partial(thesis_recipe.interfaced, angle, REFLECTANCES, INDEX)
    yield row("thesis's recipe", 1, "64 facets", Measured(recipe(), shortest(recipe), 0), "-")
    for kept in orders:
        fewer = dataclasses.replace(finest.interface, images=kept + 1, hits=kept + 1)
        plan = dataclasses.replace(finest, interface=fewer)
        measured = Measured.of(plan, scene)
        yield row("fewer reflections", kept, nodes(plan), measured, f"{measured.first_s:.1f}")
    for tolerance in tolerances:
        plan = planning.plan(scene, tolerance)
        measured = Measured.of(plan, scene)
        assert plan.interface is not None
        kept, keeps = plan.interface.hits - 1, measured.error(reference.values) <= tolerance
        name = f"tolerance {tolerance:.0e}, {'kept' if keeps else 'NOT KEPT'}"
        yield row(name, kept, nodes(plan), measured, f"{measured.first_s:.1f}")


def values(cases: tuple[Case, ...], tolerances: list[float], called: bool) -> Iterator[list[str]]:
    """Rows for one spectrum of a groove of 45°."""
    for case in cases:
        scene = case.scene(np.deg2rad(45.0))
        reference = Measured.of(planning.plan(scene, TOLERANCE_OF_REFERENCE), scene)
        for tolerance in tolerances:
            measured = Measured.of(planning.plan(scene, tolerance), scene)
            error = measured.error(reference.values)
            call = f"{shortest(lambda: vc.reflectance_factor(scene, tolerance)):.2f}" if called else "-"  # noqa: B023
            yield [
                case.name,
                f"{tolerance:.0e}",
                f"{error:.1e}, {'kept' if error <= tolerance else 'NOT KEPT'}",
                f"{measured.first_s:.1f}",
                f"{measured.milliseconds:.2f}",
                call,
                "yes" if measured.milliseconds < AIM_VALUE_MS else "no",
            ]


def gradients(cases: tuple[Case, ...], tolerance: float, check: bool) -> Iterator[list[str]]:
    """Rows for a sum of squares and its derivative by angle, index and every reflectance, all of them traced."""
    at = jnp.deg2rad(45.0), jnp.asarray(INDEX), jnp.asarray(REFLECTANCES)
    promises = {"smallest_angle": np.deg2rad(40.0), "smallest_index": 1.3}

    def misfit(case: Case, tolerance: float, angle: Array, index: Array, reflectance: Array) -> Array:
        spectrum = vc.reflectance_factor(case.scene(angle, index, reflectance), tolerance, **promises)
        return jnp.sum((spectrum - 0.5) ** 2)

    for case in cases:
        with_gradient = jax.value_and_grad(partial(misfit, case, tolerance), argnums=(0, 1, 2))
        program, compile_s = compiled(with_gradient, *at)
        value, _ = compiled(partial(misfit, case, tolerance), *at)
        value_ms, both_ms = shortest(lambda: value(*at)), shortest(lambda: program(*at))  # noqa: B023
        error = "-"
        if check:
            exact = jax.jit(jax.grad(partial(misfit, case, 1e-12), argnums=(0, 1, 2)))(*at)
            pairs = zip(program(*at)[1], exact, strict=True)
            error = f"{max(float(jnp.max(jnp.abs(a - b) / jnp.max(jnp.abs(b)))) for a, b in pairs):.1e}"
        cells = [f"{compile_s:.1f}", f"{value_ms:.2f}", f"{both_ms:.2f}", f"{both_ms / value_ms:.1f}"]
        yield [case.name, f"{tolerance:.0e}", error, *cells, "yes" if both_ms < AIM_GRADIENT_MS else "no"]


def batch(count: int, tolerance: float, chunk: int) -> str:
    """Microseconds per spectrum of many grooves and views in diffuse light, and whether the tolerance was kept."""
    random = np.random.default_rng(2020)
    geometries = tuple(
        jnp.asarray(random.uniform(low, high, count))
        for low, high in ((SMALLEST_ANGLE, LARGEST_ANGLE), (0.0, STEEPEST), (-np.pi, np.pi))
    )

    def spectra(tolerance: float, *geometries: Array) -> Array:
        def one(geometry: tuple[Array, Array, Array]) -> Array:
            angle, polar, azimuth = geometry
            scene = dataclasses.replace(DIFFUSE.scene(angle), view=vc.View(polar, azimuth))
            return vc.reflectance_factor(scene, tolerance, smallest_angle=SMALLEST_ANGLE)

        return jax.lax.map(one, geometries, batch_size=chunk)

    program, compile_s = compiled(partial(spectra, tolerance), *geometries)
    microseconds = 1e3 * shortest(lambda: program(*geometries)) / count
    few = tuple(part[:50] for part in geometries)
    error = float(jnp.max(jnp.abs(program(*geometries)[:50] - jax.jit(partial(spectra, 1e-12))(*few))))
    return (
        f"{count} grooves of 20° to 170°, each in a view of its own, diffuse light, tolerance {tolerance:.0e}: "
        f"{microseconds:.0f} µs per spectrum, compiled in {compile_s:.1f} s; largest error of 50 {error:.1e}, "
        f"{'kept' if error <= tolerance else 'NOT KEPT'}.\n"
    )


def main() -> None:
    """Measure, print and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("outdir", nargs="?", type=Path, help="where to write")
    parser.add_argument("--full", action="store_true", help="everything, minutes instead of seconds")
    options = parser.parse_args()
    folder = options.outdir or Path(tempfile.mkdtemp(prefix="vcavity-interfaced-speed-"))
    folder.mkdir(parents=True, exist_ok=True)
    full = options.full
    machine = [f"- {name}: {value}" for name, value in describe_machine().items()]
    tolerances = [1e-3, 1e-6, 1e-8, 1e-10, 1e-12] if full else [1e-6]
    rows = list(against_recipe(45, tolerances, [0, 1, 2, 3] if full else [1]))
    if full:
        rows += against_recipe(20, tolerances, [0, 1, 2, 3, 4, 6, 8])
    orders = ["angle", "what", "reflections", "nodes", "error", "ms", "first call, s"]
    one = ["case", "tolerance", "error", "first call, s", "ms", "call, ms", "under 1 ms"]
    derived = ["case", "tolerance", "error", "compile, s", "value, ms", "with gradient, ms", "ratio", "under 5 ms"]
    text = [
        *machine,
        "",
        "Frontal light and view, n = 1.5; nodes are those of the contour, the path and the tilt:",
        "",
        table(orders, iter(rows)),
        "A spectrum of a groove of 45°; a call is that of vcavity, with its checks and its planning in Python:",
        "",
        table(one, values(CASES if full else (FRONTAL,), [1e-6, 1e-8] if full else [1e-6], called=full)),
        "A sum of squares with its gradient in angle, index and 36 reflectances; error relative to the largest:",
        "",
        table(derived, gradients(CASES[:5] if full else (DIFFUSE,), 1e-6, check=full)),
        batch(1000, 1e-6, chunk=8) if full else "",
    ]
    report = "\n".join(text)
    (folder / "interfaced_speed_against_error.md").write_text(report, encoding="utf-8")
    print(report)
    print(f"written to {folder}")


if __name__ == "__main__":
    main()
