"""Scenes: what is accepted, what is refused and how it is said, shapes, and reuse of programs."""

from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest

import vcavity_jax as vc

WHITE = vc.Lambertian(0.9)


def scene(surface: Any = None, material: Any = WHITE, illumination: Any = None, view: Any = None) -> vc.Scene:
    return vc.Scene(surface or vc.VGrooves(0.8), material, illumination or vc.Diffuse(), view or vc.View())


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: vc.VGrooves(60.0), ["60.0", "dihedral angle", "π", "degrees"]),
        (lambda: vc.VGrooves(0.0), ["0.0", "dihedral angle"]),
        (lambda: vc.VGrooves(-0.5), ["-0.5", "dihedral angle"]),
        (lambda: vc.VGrooves(float("nan")), ["nan", "dihedral angle"]),
        (lambda: vc.BeckmannGrooves(-0.1), ["-0.1", "roughness"]),
        (lambda: vc.BeckmannGrooves(float("inf")), ["inf", "roughness"]),
        (lambda: vc.Lambertian(93.0), ["93.0", "reflectance", "percent"]),
        (lambda: vc.Lambertian(np.array([0.2, -0.1])), ["-0.1", "reflectance"]),
        (lambda: vc.Lambertian(float("nan")), ["nan", "reflectance"]),
        (lambda: vc.Specular(0.3 - 2.7j), ["0.3-2.7j", "index", "conjugate"]),
        (lambda: vc.Specular(-1.5), ["-1.5", "index", "n > 0"]),
        (lambda: vc.Specular(np.array([1.5, np.nan])), ["nan", "index"]),
        (lambda: vc.View(45.0), ["45.0", "polar angle", "degrees"]),
        (lambda: vc.View(0.1, 90.0), ["90.0", "azimuth", "degrees"]),
        (lambda: vc.Directional(45.0), ["45.0", "polar angle", "degrees"]),
        (lambda: vc.Directional(0.1, 90.0), ["90.0", "azimuth", "degrees"]),
        (lambda: vc.Mixed(1.2, vc.Directional()), ["1.2", "diffuse fraction"]),
    ],
)
def test_bad_numbers_are_named(make: Callable[[], Any], words: list[str]) -> None:
    """The value, the range, the likely cause."""
    with pytest.raises(ValueError, match=r"expected") as refusal:
        make()
    for word in words:
        assert word in str(refusal.value)
    assert "\n" not in str(refusal.value)


GLASS = vc.Specular(1.5)


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (scene(material=GLASS, illumination=vc.Directional(0.3)), "delta function"),
        (scene(material=GLASS, illumination=vc.Mixed(0.5, vc.Directional(0.3))), "delta function"),
        (scene(material=GLASS, illumination=vc.Annular(0.8)), "delta function"),
        (
            vc.Scene(vc.VGrooves(1.0), vc.Lambertian(0.5), vc.DiffuseWithTrap(-0.14, 0.0, 0.1), vc.Hemisphere()),
            "trap goes with a detector in one direction",
        ),
    ],
)
def test_scenes_without_an_answer(bad: vc.Scene, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        vc.reflectance_factor(bad)
    with pytest.raises(ValueError, match=reason):  # as well where the numbers are not known
        jax.jit(vc.reflectance_factor)(bad)


@pytest.mark.parametrize("tolerance", [0.0, -1e-3, 1.0, 7.0, float("nan")])
def test_bad_tolerances(tolerance: float) -> None:
    with pytest.raises(ValueError, match="not a tolerance"):
        vc.reflectance_factor(scene(), tolerance)


@pytest.fixture
def _as_users_meet_it() -> Iterator[None]:
    """Without the check of types that runs in these tests and would answer first."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.mark.usefixtures("_as_users_meet_it")
def test_traced_tolerance() -> None:
    with pytest.raises(ValueError, match="not a tolerance"):
        jax.jit(lambda t: vc.reflectance_factor(scene(), t))(1e-6)


@pytest.mark.usefixtures("_as_users_meet_it")
def test_unknown_polarization() -> None:
    with pytest.raises(ValueError, match=r"'exact' is not a polarization.*full.*unpolarized.*separate"):
        vc.Specular(1.5, "exact")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "bad", [scene(material=GLASS), scene(vc.BeckmannGrooves(0.3))], ids=["mirrors", "random angle"]
)
def test_no_profile(bad: vc.Scene) -> None:
    with pytest.raises(ValueError, match="diffusing panels and one groove angle"):
        vc.radiance_profile(bad, 0.5)


@pytest.mark.parametrize("position", [-0.1, 1.2, float("nan")])
def test_no_position(position: float) -> None:
    with pytest.raises(ValueError, match="not a position on a panel"):
        vc.radiance_profile(scene(), position)


def test_flat_angle_may_be_rounded_up() -> None:
    """π from degrees, from a float32 or one ulp above is flat, not an error."""
    for angle in (np.nextafter(np.pi, 4), np.pi * (1 + 1e-7), np.float64(np.float32(np.pi))):
        value = vc.reflectance_factor(scene(vc.VGrooves(angle)))
        np.testing.assert_allclose(value, 0.9, rtol=0, atol=1e-8)


@pytest.mark.parametrize(
    ("view", "waves", "shape"),
    [
        ((), (), ()),
        ((3,), (), (3,)),
        ((), (4,), (4,)),
        ((3,), (4,), (3, 4)),
        ((2, 3), (4,), (2, 3, 4)),
        ((1,), (1,), (1, 1)),
        ((0,), (4,), (0, 4)),
    ],
)
def test_shapes(view: tuple[int, ...], waves: tuple[int, ...], shape: tuple[int, ...]) -> None:
    """View's shape, then the wavelengths'."""
    where = vc.View(np.full(view, 0.3), np.full(view, 0.2))
    for material in (vc.Lambertian(np.full(waves, 0.5)), vc.Specular(np.full(waves, 1.5))):
        assert vc.reflectance_factor(scene(material=material, view=where), 1e-3).shape == shape


def test_profile_shapes() -> None:
    for position, waves in (((), ()), ((5,), (3,)), ((2, 2), (3,))):
        profile = vc.radiance_profile(
            scene(material=vc.Lambertian(np.full(waves, 0.5))), jnp.full(position, 0.5), 1e-3
        )
        assert profile.shape == (2, *position, *waves)


def test_panels_of_different_shape() -> None:
    """One number beside a spectrum is that number at each wavelength."""
    spectrum = np.array([0.2, 0.7])
    mixed = vc.TwoPanels(vc.Lambertian(0.4), vc.Lambertian(spectrum))
    full = vc.TwoPanels(vc.Lambertian(np.full(2, 0.4)), vc.Lambertian(spectrum))
    found, wanted = (vc.reflectance_factor(scene(material=m)) for m in (mixed, full))
    assert found.shape == (2,)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-15)


def test_view_broadcasts() -> None:
    polar, azimuth = np.array([[0.1], [0.5]]), np.array([0.0, 0.7, 1.5])
    view = vc.View(polar, azimuth)
    assert view.shape == (2, 3)
    value = vc.reflectance_factor(scene(view=view), 1e-12)
    single = vc.reflectance_factor(scene(view=vc.View(0.5, 1.5)), 1e-12)  # open: another sum
    assert float(value[1, 2]) == pytest.approx(float(single), abs=2e-12)


def test_first_panel_faces_the_light() -> None:
    """The convention, by hand: θ > 0, φ = 0 has e_y > 0 and meets the panel at y < 0, steeply only it."""
    bright_first = vc.TwoPanels(vc.Lambertian(0.8), vc.Lambertian(0.0))
    steep = vc.View(np.radians([80.0, -80.0]), 0.0)
    first, second = vc.reflectance_factor(scene(material=bright_first, view=steep))
    assert first > 0.3
    assert abs(second) < 1e-8


def test_parts_are_pytrees_of_arrays() -> None:
    """Plain numbers become arrays of JAX's float type: a new value is no new program, and has a gradient."""
    whole = scene(material=vc.Specular(1.5, "separate"))
    leaves = jax.tree.leaves(whole)
    assert all(isinstance(leaf, jax.Array) and leaf.dtype == jnp.float64 for leaf in leaves)
    assert len(leaves) == 4
    assert vc.Specular(1.5 + 0j).index.dtype == jnp.complex128
    assert vc.Lambertian(1).reflectance.dtype == jnp.float64
    assert vc.Directional().polar.dtype == jnp.float64


def test_new_values_reuse_the_program() -> None:
    """Angles of one range, any reflectance, any oblique view: compiled once."""
    compiled: list[str] = []

    def listen(name: str, *_: Any, **__: Any) -> None:
        if "backend_compile" in name:
            compiled.append(name)

    def run(angle: float, reflectance: float, polar: float) -> None:
        vc.reflectance_factor(
            scene(vc.VGrooves(angle), vc.Lambertian(reflectance), view=vc.View(polar, 0.3)), 1e-5
        ).block_until_ready()

    run(0.8, 0.5, 0.9)
    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        run(0.9, 0.6, 1.0)
        run(1.1, 0.2, 1.1)
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)
    assert compiled == []


@pytest.mark.parametrize("material", [WHITE, vc.Specular(0.35 + 2.7j)], ids=["diffuser", "mirror"])
def test_jit_and_vmap_change_nothing(material: Any) -> None:
    """To 1e-12 and the tolerance: planned, traced, and mapped over the angle."""
    where = vc.View(np.array([0.2, 1.1]), np.array([0.4, 1.0]))
    plain = vc.reflectance_factor(scene(material=material, view=where), 1e-12)
    compiled = jax.jit(lambda s: vc.reflectance_factor(s, 1e-12))(scene(material=material, view=where))

    def of(angle: Any) -> Any:
        return vc.reflectance_factor(scene(vc.VGrooves(angle), material, view=where), 1e-12)

    mapped = jax.vmap(of)(jnp.asarray([0.8, 0.3]))
    np.testing.assert_allclose(compiled, plain, rtol=0, atol=1e-12)
    np.testing.assert_allclose(mapped[0], plain, rtol=0, atol=1e-12)


def test_kink_angles_by_hand() -> None:
    """Frontal mirrors: α = π/k and 2π/(2k - 1); diffusers: 2|θ'| of light and view; random grooves: none."""
    frontal = scene(material=GLASS)
    expected = np.sort([np.pi / 2, np.pi, 2 * np.pi / 3, np.pi / 3, 2 * np.pi / 5])
    np.testing.assert_allclose(vc.kink_angles(frontal, 1.0, np.pi), expected, rtol=1e-14)
    lit = scene(illumination=vc.Directional(0.5), view=vc.View(np.array([-0.4, 1.5]), 0.0))
    np.testing.assert_allclose(vc.kink_angles(lit, 0.1, np.pi), [0.8, 1.0, 3.0], rtol=1e-14)
    assert vc.kink_angles(scene(vc.BeckmannGrooves(0.2), GLASS), 0.1, np.pi).size == 0
