"""Derivatives: exact records, finite differences, compiled or not, and finite wherever the value is."""

import json
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import vcavity_jax as vc
from vcavity_jax import roughness
from vcavity_jax.directions import components
from vcavity_jax.kinks import reflection_kinks

DATA = Path(__file__).parents[1] / "data"
MIRRORS: list[dict[str, Any]] = json.loads((DATA / "specular.json").read_text())["gradients"]
DIFFUSERS: list[dict[str, Any]] = json.loads((DATA / "lambertian.json").read_text())["gradients"]
MODELS = {"exact": "full", "unpol": "unpolarized", "sep": "separate"}
GOLD = 0.35 + 2.7j


@pytest.fixture(autouse=True, scope="module")
def _forget_programs() -> Iterator[None]:
    yield
    jax.clear_caches()


def mirror(model: Any) -> Callable[..., Any]:
    def value(angle: Any, polar: Any, azimuth: Any, n: Any, k: Any) -> Any:
        material = vc.Specular(jax.lax.complex(n, k), model)
        view = vc.View(polar, azimuth)
        return vc.reflectance_factor(vc.Scene(vc.VGrooves(angle), material, vc.Diffuse(), view))

    return value


def lit(
    angle: Any,
    polar: Any,
    azimuth: Any,
    light: Any,
    turn: Any,
    first: Any,
    second: Any,
    tolerance: float = 1e-12,
) -> Any:
    material = vc.TwoPanels(vc.Lambertian(first), vc.Lambertian(second))
    scene = vc.Scene(vc.VGrooves(angle), material, vc.Directional(light, turn), vc.View(polar, azimuth))
    return vc.reflectance_factor(scene, tolerance)


def shaded(angle: Any, polar: Any, azimuth: Any, reflectance: Any, tolerance: float = 1e-12) -> Any:
    material = vc.Lambertian(reflectance)
    scene = vc.Scene(vc.VGrooves(angle), material, vc.Diffuse(), vc.View(polar, azimuth))
    return vc.reflectance_factor(scene, tolerance)


def differences(function: Callable[[Any], Any], at: Any, step: float) -> np.ndarray:
    """Central differences of fourth order."""
    f = [np.asarray(function(at + i * step)) for i in (-2, -1, 1, 2)]
    return (f[0] - 8 * f[1] + 8 * f[2] - f[3]) / (12 * step)


# -- records ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", MODELS)
def test_mirror_records(model: str) -> None:
    """1e-9 relative, near kinks as well: the records lie on one side of them. Measured 1.2e-12.

    What vanishes by symmetry (∂/∂φ at φ = 0) is recorded as some 1e-40: absolute 1e-14.
    """
    records = [r for r in MIRRORS if r["model"] == model]
    assert any(r["near_kink"] for r in records)
    angles = (np.radians([r[key] for r in records]) for key in ("alpha_deg", "theta_deg", "phi_deg"))
    columns = [jnp.asarray(c) for c in (*angles, [r["n"] for r in records], [r["k"] for r in records])]
    gradient = jax.jit(jax.vmap(jax.grad(mirror(MODELS[model]), argnums=(0, 1, 2, 3, 4))))(*columns)
    for name, found in zip(("alpha_per_rad", "theta_per_rad", "phi_per_rad", "n", "k"), gradient, strict=True):
        truth = np.array([np.nan if r["d" + name] is None else r["d" + name] for r in records])
        given = np.isfinite(truth)
        assert given.sum() > 20
        np.testing.assert_allclose(np.asarray(found)[given], truth[given], rtol=1e-9, atol=1e-14, err_msg=name)


def test_diffuser_records() -> None:
    """1e-9 relative; measured 3e-13 where the derivative itself nearly vanishes.

    A uniform groove as two equal panels: ∂/∂r is the sum of both.
    """

    def direction(name: Any) -> tuple[float, float]:
        return (0.0, 0.0) if name == "frontal" else (np.radians(name[0]), np.radians(name[1]))

    for diffuse in (True, False):
        records = [r for r in DIFFUSERS if (r["light"] == "diffuse") == diffuse]
        assert records
        angle = jnp.radians(jnp.asarray([float(r["alpha_deg"]) for r in records]))
        reflectance = jnp.asarray([r["r"] for r in records])
        view = [jnp.asarray(c) for c in np.array([direction(r["view"]) for r in records]).T]
        if diffuse:
            gradient = jax.jit(jax.vmap(jax.grad(shaded, argnums=(0, 3))))(angle, *view, reflectance)
        else:
            light = [jnp.asarray(c) for c in np.array([direction(r["light"]) for r in records]).T]
            by = jax.jit(jax.vmap(jax.grad(lit, argnums=(0, 5, 6))))
            gradient = by(angle, *view, *light, reflectance, reflectance)
            gradient = gradient[0], gradient[1] + gradient[2]
        for key, found in zip(("d_dalpha_per_rad", "d_dr"), gradient, strict=True):
            np.testing.assert_allclose(found, [r[key] for r in records], rtol=1e-9, atol=0, err_msg=key)


# -- finite differences ----------------------------------------------------------------------------


def away_from_kinks(angle: np.ndarray, polar: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    """No kink within 2e-3 of the angle, and none on the way of the other arguments' steps either."""
    section = np.arctan2(np.sin(polar) * np.cos(azimuth), np.cos(polar))
    kinks = np.asarray(reflection_kinks(jnp.asarray(section), 40))
    return np.min(np.abs(kinks - angle[:, None]), axis=-1) > 2e-3


def compare(function: Callable[..., Any], columns: list[np.ndarray], names: str) -> None:
    """Every partial derivative: 1e-6 relative to the larger of itself and the value.

    Steps of 1e-4 and fourth order: 1e-12 from the steps where the scale of change is 0.1, 1e-12 in rounding.
    """
    values = [jnp.asarray(c) for c in columns]
    every = tuple(range(len(columns)))
    gradient = jax.jit(jax.vmap(jax.grad(function, argnums=every)))(*values)
    batch = jax.jit(jax.vmap(function))
    scale = np.abs(np.asarray(batch(*values)))
    for i, name in enumerate(names.split()):
        expected = differences(lambda x, i=i: batch(*values[:i], x, *values[i + 1 :]), values[i], 1e-4)
        error = np.abs(np.asarray(gradient[i]) - expected)
        worst = int(np.argmax(error - 1e-6 * np.maximum(np.abs(expected), scale)))
        message = f"{name} of {[float(c[worst]) for c in columns]}: {gradient[i][worst]} for {expected[worst]}"
        assert error[worst] <= 1e-6 * max(abs(expected[worst]), scale[worst]), message


@pytest.mark.parametrize("model", MODELS.values())
def test_mirrors_against_differences(model: str) -> None:
    random = np.random.default_rng(7)
    size = 300
    columns = [
        np.radians(random.uniform(15, 178, size)),
        np.radians(random.uniform(-85, 85, size)),
        np.radians(random.uniform(0, 180, size)),
        random.uniform(0.1, 4, size),
        random.uniform(0.3, 5, size),
    ]
    keep = away_from_kinks(*columns[:3])
    assert keep.sum() > 150
    compare(mirror(model), [c[keep] for c in columns], "angle polar azimuth n k")


def test_diffusers_against_differences() -> None:
    random = np.random.default_rng(8)
    size = 40
    angle = np.radians(random.uniform(10, 178, size))
    view, light = (np.radians(random.uniform([-85, 0], [85, 180], (size, 2))) for _ in range(2))
    r = random.uniform(0.05, 0.999, (2, size))
    section = [np.arctan2(np.sin(d[:, 0]) * np.cos(d[:, 1]), np.cos(d[:, 0])) for d in (view, light)]
    keep = np.min([np.abs(2 * np.abs(s) - angle) for s in section], axis=0) > 5e-3
    # Light and view on one shadow edge: the mean is smooth there but for its second derivative.
    keep &= np.abs(np.abs(section[0]) - np.abs(section[1])) > 5e-3
    columns = [angle, *view.T, *light.T, *r]
    compare(lit, [c[keep] for c in columns], "angle polar azimuth light turn first second")
    compare(shaded, [c[keep] for c in (*columns[:3], columns[5])], "angle polar azimuth reflectance")


# -- compiled or not, constant or traced -----------------------------------------------------------

POLAR, AZIMUTH = np.radians([33.0, 64.0]), np.radians([35.0, 90.0])
WAVES = np.array([GOLD, 1.5 + 0j])


def weighed(value: Any) -> Any:
    """A sum that mixes nothing up: every entry has its own weight."""
    return jnp.ravel(value) @ jnp.arange(1.0, 1 + value.size)


def grooves(parameter: Any, index: Any, polar: Any, azimuth: Any, model: Any) -> Any:
    view = vc.View(polar, azimuth)
    scene = vc.Scene(vc.VGrooves(parameter), vc.Specular(index, model), vc.Diffuse(), view)
    return weighed(vc.reflectance_factor(scene))


def beckmann(parameter: Any, index: Any, polar: Any, azimuth: Any, model: Any) -> Any:
    """The average with the few kinks that one roughness needs; a traced one in public resolves 256."""
    directions = (component[:, None] for component in components(jnp.asarray(polar), jnp.asarray(azimuth)))
    index = jnp.asarray(index)
    return weighed(roughness.specular_average(parameter, *directions, index, model, False, 12, 5.5, 16))


def public_beckmann(parameter: Any, index: Any, polar: Any, azimuth: Any, model: Any) -> Any:
    view = vc.View(polar, azimuth)
    scene = vc.Scene(vc.BeckmannGrooves(parameter), vc.Specular(index, model), vc.Diffuse(), view)
    return weighed(vc.reflectance_factor(scene, 1e-8))


SURFACES = {"grooves": (grooves, 0.83, 1e-4), "Beckmann": (beckmann, 0.6, 1e-3)}


def all_ways(value: Callable[..., Any], at: float, step: float, model: Any, brief: bool = False) -> None:
    """XLA for the CPU once miscompiled the derivative of the loop when index and view were constants of it.

    Finite differences of the plain value: 1e-6, from steps of fourth order and the quadrature's own error.
    """
    x = jnp.asarray(at)

    def constant(parameter: Any) -> Any:
        return value(parameter, WAVES, POLAR, AZIMUTH, model)

    def arguments(parameter: Any, *rest: Any) -> Any:
        return value(parameter, *rest, model)

    compiled = jax.jit(constant)
    expected = differences(compiled, x, step)
    np.testing.assert_allclose(jax.grad(compiled)(x), expected, rtol=1e-6, err_msg="grad of jit")
    if brief:  # every further way takes ten seconds to compile
        return
    np.testing.assert_allclose(jax.jit(jax.jacfwd(constant))(x), expected, rtol=1e-6, err_msg="forward")
    rest = tuple(jnp.asarray(a) for a in (WAVES, POLAR, AZIMUTH))
    np.testing.assert_allclose(jax.jit(jax.grad(arguments))(x, *rest), expected, rtol=1e-6, err_msg="traced")


@pytest.mark.parametrize(
    ("surface", "model"),
    [
        pytest.param(s, m, marks=pytest.mark.slow if s == "Beckmann" and m != "unpolarized" else [])
        for s in SURFACES
        for m in MODELS.values()
    ],
)
def test_constants_closed_over(surface: str, model: str) -> None:
    value, at, step = SURFACES[surface]
    all_ways(value, at, step, model, brief=surface == "Beckmann" or model == "separate")


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS.values())
@pytest.mark.parametrize("value", [beckmann, public_beckmann])
def test_constants_closed_over_in_every_way(value: Any, model: str) -> None:
    all_ways(value, 0.6, 1e-3, model)


@pytest.mark.parametrize(
    ("surface", "view"),
    [
        ("grooves", True),
        pytest.param("Beckmann", False, marks=pytest.mark.slow),
        pytest.param("Beckmann", True, marks=pytest.mark.slow),
    ],
)
def test_index_and_view_with_the_surface_constant(surface: str, view: bool) -> None:
    """The same for n, k and the view, several tangents at once, which is where the miscompilation struck."""
    value, at, step = SURFACES[surface]

    def constant(p: Any) -> Any:
        index = jax.lax.complex(p[0], p[1])[None]
        return value(jnp.asarray(at), index, p[2][None] if view else np.array([0.7]), np.array([0.6]), "full")

    p = jnp.asarray([GOLD.real, GOLD.imag, 0.7][: 2 + view])
    compiled = jax.jit(constant)
    expected = [differences(lambda x, i=i: compiled(p.at[i].set(x)), p[i], step) for i in range(2 + view)]
    np.testing.assert_allclose(jax.grad(compiled)(p), expected, rtol=1e-6)


def test_not_compiled() -> None:
    """Without jit around it: the public function's gradient in angle, from a scene that is a pytree."""
    scene = vc.Scene(vc.VGrooves(0.83), vc.Specular(WAVES), vc.Diffuse(), vc.View(POLAR, AZIMUTH))
    by = jax.grad(lambda surface: weighed(vc.reflectance_factor(vc.Scene(surface, *parts_of(scene)))))
    expected = differences(lambda a: grooves(a, WAVES, POLAR, AZIMUTH, "full"), jnp.asarray(0.83), 1e-4)
    np.testing.assert_allclose(by(scene.surface).angle, expected, rtol=1e-6)


def parts_of(scene: vc.Scene) -> tuple[Any, Any, Any]:
    return scene.material, scene.illumination, scene.view


def test_real_index_alone() -> None:
    """A dielectric's derivative in n, in real arithmetic, is the complex one's."""

    def real(n: Any) -> Any:
        return vc.reflectance_factor(
            vc.Scene(vc.VGrooves(0.7), vc.Specular(n), vc.Diffuse(), vc.View(POLAR, AZIMUTH))
        ).sum()

    def complexed(n: Any) -> Any:
        return real(jax.lax.complex(n, jnp.zeros_like(n)))

    n = jnp.asarray(1.5)
    np.testing.assert_allclose(jax.jacrev(real)(n), jax.grad(complexed)(n), rtol=1e-12)
    np.testing.assert_allclose(jax.grad(complexed)(n), differences(real, n, 1e-4), rtol=1e-6)


# -- finite everywhere -----------------------------------------------------------------------------


def beside(value: float) -> list[float]:
    return [np.nextafter(value, 0), value, np.nextafter(value, 9)]


NARROW = list(np.radians([0.1, 0.7]))
ANGLES = [
    *np.radians([5.0, 37.0, 100.0, 179.999]),
    *(a for k in (2, 3, 4, 7, 30) for a in beside(np.pi / k)),
    np.nextafter(np.pi, 0),
    np.pi,
]
POLARS = [0.0, *beside(np.pi / 8)[:2], np.pi / 6, np.pi / 4, 1.2, -1.2, np.pi / 2 - 1e-9, np.pi / 2]
AZIMUTHS = [0.0, 0.5, np.pi / 2, 1e-12]
INDICES = [1 + 0j, 1 + 1e-9 + 0j, 1.5 + 0j, 50 + 0j, 1 + 20j, 0.05 + 0j, 0.05 + 3j, GOLD]


def assert_all_finite(function: Callable[..., Any], columns: list[Any], lowest: float, highest: float) -> None:
    every = tuple(range(len(columns)))
    value, gradient = jax.jit(jax.vmap(jax.value_and_grad(function, argnums=every)))(*columns)
    for name, what in zip(("value", *every), (value, *gradient), strict=True):
        bad = ~np.isfinite(np.asarray(what))
        assert not bad.any(), (name, bad.sum(), [float(c[bad][0]) for c in columns])
    # Beyond the physical limits by no more than the tolerance of the coarsest function here.
    assert np.min(value) >= lowest - 1e-6
    assert np.max(value) <= highest + 1e-6


FEW = [0.0, 1.2, np.pi / 2]


@pytest.mark.parametrize(
    ("angles", "polars", "model"),
    [
        *(pytest.param(ANGLES, POLARS, model, id=f"wide-{model}") for model in MODELS.values()),
        pytest.param(NARROW, FEW, "full", id="narrow-full"),
        *(
            pytest.param(NARROW, FEW, model, id=f"narrow-{model}", marks=pytest.mark.slow)
            for model in ("unpolarized", "separate")
        ),
    ],
)
def test_mirrors_finite_everywhere(angles: list[float], polars: list[float], model: Any) -> None:
    """Values from 0 to 1, but for the rounding of up to 1800 products."""
    columns = [g.ravel() for g in np.meshgrid(angles, polars, AZIMUTHS, np.array(INDICES), indexing="ij")]
    arguments = [*(jnp.asarray(c.real) for c in columns), jnp.asarray(columns[3].imag)]
    assert_all_finite(mirror(model), arguments, 0, 1 + 1e-12)


def test_diffusers_finite_everywhere() -> None:
    """No upper limit under parallel light: white grooves send it back where it came from."""

    def outer(*grid: list[float]) -> list[Any]:
        return [jnp.asarray(g.ravel()) for g in np.meshgrid(*grid, indexing="ij")]

    angles = [*NARROW, *np.radians([5.0, 100.0, 179.999]), *beside(np.pi / 4), np.nextafter(np.pi, 0), np.pi]
    polars = [0.0, np.pi / 8, 1.2, np.pi / 2 - 1e-9, np.pi / 2]
    assert_all_finite(partial(shaded, tolerance=1e-6), outer(angles, polars, AZIMUTHS, [0.0, 0.3, 1.0]), 0, 1)
    some = [0.0, np.pi / 8, np.pi / 2]
    grid = outer(angles, some, [0.0, np.pi / 2], some, [0.4], [0.0, 0.3, 1.0], [0.0, 1.0])
    assert_all_finite(partial(lit, tolerance=1e-6), grid, 0, np.inf)


ROUGHNESSES = [0.0, 1e-9, 0.3, 2.0]
THREE_POLARS, THREE_AZIMUTHS = [0.0, 0.9, np.pi / 2], [0.0, 0.5, np.pi / 2]


def test_random_grooves_finite_everywhere() -> None:
    """Also as the roughness vanishes; n from 1 on, in real arithmetic, that is quick to compile."""

    def value(m: Any, polar: Any, azimuth: Any, n: Any) -> Any:
        return average_of(m, polar, azimuth, n, "separate")

    grid = [ROUGHNESSES, THREE_POLARS, THREE_AZIMUTHS, [1.0, 1.5, 50.0]]
    assert_all_finite(value, [jnp.asarray(g.ravel()) for g in np.meshgrid(*grid, indexing="ij")], 0, 1)


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS.values())
def test_random_metal_grooves_finite_everywhere(model: Any) -> None:
    def value(m: Any, polar: Any, azimuth: Any, n: Any, k: Any) -> Any:
        return average_of(m, polar, azimuth, jax.lax.complex(n, k), model)

    grid = [ROUGHNESSES, THREE_POLARS, THREE_AZIMUTHS, [0.05, 1.0, 50.0], [0.0, 3.0]]
    assert_all_finite(value, [jnp.asarray(g.ravel()) for g in np.meshgrid(*grid, indexing="ij")], 0, 1)


def average_of(m: Any, polar: Any, azimuth: Any, index: Any, model: Any) -> Any:
    direction = components(polar, azimuth)
    return roughness.specular_average(m, *direction, index, model, False, order=5, cutoff=4.0, most=16)
