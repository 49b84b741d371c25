"""Only what a scene needs: floating-point operations of the compiled programs, as XLA counts them."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import vcavity_jax as vc

R = np.linspace(0.05, 0.95, 36)
GOLD = 0.3 + 2.6j + 0.01 * np.arange(36)
FRONT, OBLIQUE, OPEN = vc.View(0.0, 0.0), vc.View(0.9, 0.4), vc.View(0.1, 0.0)
WIDE = np.radians(40.0)


def operations(
    material: Any, light: Any, view: Any, tolerance: float = 1e-8, surface: Any = None, **options: Any
) -> float:
    """Of the spectrum as a function of the angle (or the roughness) and nothing else."""
    make = surface or vc.VGrooves

    def spectrum(value: Any) -> Any:
        return vc.reflectance_factor(vc.Scene(make(value), material, light, view), tolerance, **options)

    cost = jax.jit(spectrum).lower(jnp.asarray(1.0)).compile().cost_analysis()
    return float(cost["flops"])


def matte(light: Any, view: Any, tolerance: float = 1e-8) -> float:
    return operations(vc.Lambertian(R), light, view, tolerance, smallest_angle=WIDE)


def test_an_open_scene_needs_no_contour() -> None:
    """Fully lit and fully seen: one real sum."""
    assert 20 * matte(vc.Diffuse(), FRONT) < matte(vc.Diffuse(), OBLIQUE)
    assert 20 * matte(vc.Directional(0.0, 0.0), FRONT) < matte(vc.Directional(0.9, 0.0), OBLIQUE)


def test_one_parity_is_enough_where_nothing_opposite_is_lit() -> None:
    """A frontal view halves the work of shadowed light."""
    shadowed = vc.Directional(0.9, 0.0)
    assert matte(shadowed, FRONT) < 0.7 * matte(shadowed, OBLIQUE)


def test_a_mirror_across_the_grooves_needs_no_coupling() -> None:
    across = operations(vc.Specular(GOLD), vc.Diffuse(), vc.View(0.9, 0.0))
    assert across < 0.8 * operations(vc.Specular(GOLD), vc.Diffuse(), OBLIQUE)


def test_a_frontal_mirror_needs_one_side() -> None:
    front = operations(vc.Specular(GOLD, "unpolarized"), vc.Diffuse(), FRONT)
    assert front < 0.7 * operations(vc.Specular(GOLD, "unpolarized"), vc.Diffuse(), vc.View(0.9, 0.0))


def test_a_dielectric_needs_real_arithmetic() -> None:
    real = operations(vc.Specular(GOLD.real + 1), vc.Diffuse(), OBLIQUE)
    assert real < 0.5 * operations(vc.Specular(GOLD), vc.Diffuse(), OBLIQUE)


@pytest.mark.parametrize("degrees", [90.0, 120.0, 179.0])
def test_wide_grooves_reflect_twice_at_most(degrees: float) -> None:
    polar = np.linspace(0, 1.5, 40)
    scene = vc.Scene(vc.VGrooves(np.radians(degrees)), vc.Specular(1.5), vc.Diffuse(), vc.View(polar, 0.3))
    assert int(np.max(vc.reflection_count(scene))) <= 2


def test_no_index_is_no_interface() -> None:
    """n = 1 and no layer are planned as bare panels."""
    bare = operations(vc.Lambertian(R), vc.Diffuse(), FRONT)
    assert operations(vc.InterfacedLambertian(R, 1.0), vc.Diffuse(), FRONT) < 1.1 * bare
    assert operations(vc.InterfacedLambertian(R, 1.5), vc.Diffuse(), FRONT, smallest_angle=WIDE) > 10 * bare


@pytest.mark.parametrize(
    ("material", "light", "view"),
    [
        (vc.Lambertian(R), vc.Directional(0.9, 0.0), OBLIQUE),
        (vc.InterfacedLambertian(R, 1.5), vc.Diffuse(), FRONT),
        (vc.InterfacedLambertian(R, 1.5), vc.Directional(0.0, 0.0), FRONT),
    ],
    ids=["matte in shadow", "varnished, diffuse light", "varnished, frontal light"],
)
def test_tolerance_buys_speed(material: Any, light: Any, view: Any) -> None:
    coarse, fine = (operations(material, light, view, t, smallest_angle=WIDE) for t in (1e-4, 1e-10))
    assert fine > 3 * coarse


def test_nothing_is_compiled_again_when_values_change(caplog: pytest.LogCaptureFixture) -> None:
    """A user's calls: another angle of the same kind, other reflectances, another direction."""

    def call(angle: float, reflectance: float, polar: float) -> None:
        for material in (vc.Lambertian(reflectance * R), vc.InterfacedLambertian(reflectance * R, 1.5)):
            scene = vc.Scene(vc.VGrooves(angle), material, vc.Diffuse(), vc.View(polar, 0.0))
            vc.reflectance_factor(scene, 1e-6).block_until_ready()
        mirror = vc.Specular(reflectance * GOLD)
        view = vc.View(polar, 0.2)
        vc.reflectance_factor(vc.Scene(vc.VGrooves(angle), mirror, vc.Diffuse(), view)).block_until_ready()

    call(1.0, 1.0, 0.1)
    with jax.log_compiles(), caplog.at_level("WARNING"):
        call(1.02, 0.9, 0.12)
    assert not [r.getMessage() for r in caplog.records if "Compiling" in r.getMessage()]
