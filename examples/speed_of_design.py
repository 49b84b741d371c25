"""How fast colors and designs are, with gradients.

    python examples/speed_of_design.py [OUTDIR]

writes speed_of_design.md into OUTDIR (a new temporary folder by default) and prints it: ΔE00 of 10 000 spectra
with its gradient by all their values, beside colour-science, which has no gradient and would need one more
evaluation for every wavelength; and a design of three parameters with four colors, beside SciPy without
derivatives on the same model. Times are the shortest of several, first calls apart.
"""

import argparse
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares

from fitting.bench.timing import describe_machine

jax.config.update("jax_enable_x64", True)

import vcavity_jax as vc  # noqa: E402
from fitting import design, free, read_spectrum, target  # noqa: E402
from vcavity_jax import colorimetry  # noqa: E402

DATA = Path(__file__).parent / "data"
NM = np.arange(400.0, 701.0, 10.0)
SPECTRA = 10_000


def timed(call: Callable[[], Any], repeats: int) -> tuple[float, float]:
    """First and shortest time of a call, seconds."""
    taken = []
    for _ in range(repeats + 1):
        start = time.perf_counter()
        jax.block_until_ready(call())
        taken.append(time.perf_counter() - start)
    return taken[0], min(taken[1:])


def colors() -> list[str]:
    """ΔE00 of many spectra and its gradient."""
    rng = np.random.default_rng(1)
    spectra = jnp.asarray(
        np.clip(rng.uniform(0.1, 0.9, (SPECTRA, 1)) + 0.05 * rng.normal(size=(SPECTRA, NM.size)), 0, 1)
    )
    white = colorimetry.white(NM)
    weights = jnp.asarray(colorimetry.xyz(np.eye(NM.size), NM))
    reference = jnp.asarray([55.0, 20.0, 30.0])

    def off(reflectance: jax.Array) -> jax.Array:
        return colorimetry.delta_e_2000(colorimetry.lab(reflectance @ weights, white), reference)

    value = jax.jit(off)
    gradient = jax.jit(jax.grad(lambda r: jnp.sum(off(r))))
    first_value, best_value = timed(lambda: value(spectra), 20)
    first, best = timed(lambda: gradient(spectra), 20)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import colour

    plain, scale = np.asarray(spectra), np.asarray(white)
    known = np.asarray(weights)
    xy = colour.XYZ_to_xy(scale / 100)

    def theirs() -> np.ndarray:
        lab = colour.XYZ_to_Lab(plain @ known / 100, xy)
        return np.asarray(colour.difference.delta_E_CIE2000(lab, np.asarray(reference)))

    _, peer = timed(theirs, 5)
    apart = float(np.abs(theirs() - np.asarray(value(spectra))).max())
    step = 1e-6
    ahead, behind = (value(spectra.at[:, 7].add(sign * step)) for sign in (1, -1))
    slope = float(jnp.abs((ahead - behind) / (2 * step) - gradient(spectra)[:, 7]).max())
    return [
        f"## ΔE00 of {SPECTRA} spectra of {NM.size} wavelengths",
        "",
        "| what | first call (s) | time (ms) |",
        "|---|---|---|",
        f"| values | {first_value:.2f} | {1e3 * best_value:.1f} |",
        f"| gradient by all {NM.size} values of each | {first:.2f} | {1e3 * best:.1f} |",
        f"| values, colour-science {colour.__version__} | | {1e3 * peer:.1f} |",
        f"| gradient by differences of it, {NM.size + 1} evaluations | | {1e3 * peer * (NM.size + 1):.0f} |",
        "",
        f"The values agree within {apart:.0e}, the gradient with differences within {slope:.0e}. "
        f"Aim: a gradient in 50 ms; {'met' if best < 0.05 else 'missed'}. "
        f"Ratio to differences of colour-science: {peer * (NM.size + 1) / best:.0f}.",
        "",
    ]


def designs() -> list[str]:
    """Angle, index and coverage of a print, from its colors in two lights and two views."""
    _, cyan, _ = read_spectrum(DATA / "flat-cyan.csv")
    _, paper, _ = read_spectrum(DATA / "flat-white.csv")
    ink = np.sqrt(np.minimum(cyan / paper, 1.0))
    frontal = vc.Directional(0.0, 0.0)
    looks = [target.Look(polar, illumination=light) for light in (None, frontal) for polar in (0.0, 0.7)]
    white = colorimetry.white(NM)

    def printed(angle: Any, index: Any, coverage: Any, light: Any, polar: float) -> vc.Scene:
        material = vc.InterfacedLambertian(paper, index, vc.Halftone(coverage, ink), specular_included=False)
        return vc.Scene(vc.VGrooves(angle), material, light, vc.View(polar, 0.0))

    def lab(values: Any, look: target.Look) -> jax.Array:
        light = vc.Diffuse() if look.illumination is None else look.illumination
        factor = vc.reflectance_factor(
            printed(*values, light, float(look.polar)), 1e-6, smallest_angle=np.radians(60.0), smallest_index=1.3
        )
        return colorimetry.lab(colorimetry.xyz(factor, NM), white)

    matte = vc.Scene(
        vc.VGrooves(1.5), vc.TwoPanels(vc.Lambertian(0.5), vc.Lambertian(0.5)), vc.Diffuse(), vc.View()
    )
    gray = [
        free.angle(40, 170),
        free.parameter("left", lambda s: s.material.first.reflectance, 0.05, 0.95),
        free.parameter("right", lambda s: s.material.second.reflectance, 0.05, 0.95),
    ]
    truth = (np.radians(110.0), 1.5, 0.6)
    wishes = [target.color(np.asarray(lab(truth, look)), look) for look in looks]
    parameters = [free.angle(60, 170), free.index(1.3, 1.8), free.coverage(0.05, 0.95)]
    scene = printed(1.5, 1.4, 0.5, vc.Diffuse(), 0.0)
    rows = []
    for name, one, unknown in (
        ("print: angle, index, coverage", scene, parameters),
        ("matte: angle, two grays", matte, gray),
    ):
        wanted = wishes if one is scene else _gray_wishes(one, looks)
        tries: list[Any] = []

        def go(
            one: vc.Scene = one, unknown: Any = unknown, wanted: Any = wanted, tries: list[Any] = tries
        ) -> float:
            tries.append(design(one, unknown, wanted, wavelengths_nm=NM))
            return 0.0

        first, best = timed(go, 3)
        reached = max(tries[-1].best.reached)
        rows.append(f"| {name}, 16 starts | {first:.1f} | {best:.3f} | {reached:.1e} |")

    stack = jax.jit(
        lambda x: jnp.concatenate(
            [
                colorimetry.components_2000(jnp.asarray(w.value), lab(x, look))
                for w, look in zip(wishes, looks, strict=True)
            ]
        )
    )
    low, high = np.array([np.radians(60.0), 1.3, 0.05]), np.array([np.radians(170.0), 1.8, 0.95])

    def without() -> float:
        costs = []
        for share in np.random.default_rng(0).uniform(0.1, 0.9, (8, 3)):
            begun = low + share * (high - low)
            costs.append(
                least_squares(lambda x: np.asarray(stack(jnp.asarray(x))), begun, bounds=(low, high)).cost
            )
        return min(costs)

    first, best = timed(without, 1)
    left = np.sqrt(2 * without())
    rows.append(
        f"| print, SciPy's differences of the compiled model, 8 starts | {first:.1f} | {best:.3f} | {left:.1e} |"
    )
    return [
        "## Designs of three parameters and four colors",
        "",
        "| what | first call (s) | time (s) | largest ΔE00 that is left |",
        "|---|---|---|---|",
        *rows,
        "",
        "Aim: 1 s after the first call.",
        "",
    ]


def _gray_wishes(scene: vc.Scene, looks: list[target.Look]) -> list[target.Target]:
    """Colors of a known pair of panels."""
    material = vc.TwoPanels(vc.Lambertian(0.3), vc.Lambertian(0.7))
    white = colorimetry.white(NM)
    wishes = []
    for look in looks:
        light = vc.Diffuse() if look.illumination is None else look.illumination
        known = vc.Scene(vc.VGrooves(np.radians(80.0)), material, light, vc.View(look.polar, 0.0))
        factor = np.full(NM.size, float(vc.reflectance_factor(known)))
        wishes.append(target.color(np.asarray(colorimetry.lab(colorimetry.xyz(factor, NM), white)), look))
    return wishes


def main() -> None:
    """Time both."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("outdir", nargs="?", type=Path)
    outdir = parser.parse_args().outdir or Path(tempfile.mkdtemp())
    outdir.mkdir(parents=True, exist_ok=True)
    machine = [f"- {key}: {value}" for key, value in describe_machine().items()]
    text = "\n".join([*colors(), *designs(), *machine, ""])
    (outdir / "speed_of_design.md").write_text(text, encoding="utf-8")
    print(f"{text}wrote {outdir / 'speed_of_design.md'}")


if __name__ == "__main__":
    main()
