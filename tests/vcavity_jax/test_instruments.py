"""Every geometry from the outside: independent oracles, physical laws, gradients, what is refused."""

from typing import Any

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest

import vcavity_jax as vc
from vcavity_jax.geometries import GEOMETRIES

MIRROR = 1e9
"""A real index so high that every reflection is total."""
GOLD, GLASS = 0.35 + 2.7j, 1.5
SURFACES = {"grooves": vc.VGrooves, "beckmann": vc.BeckmannGrooves, "gaussian": vc.GaussianGrooves}


def traced_exits(angle: float, view: np.ndarray, entries: int) -> np.ndarray:
    """Directions, shape (entries, 3), in which rays from a viewer leave a mirror groove: traced in its section."""
    sine, cosine = np.sin(angle / 2), np.cos(angle / 2)
    found = []
    for y in ((np.arange(entries) + 0.5) / entries * 2 - 1) * sine:
        place, direction, last = np.array([y, cosine]), -view[1:], 0
        while True:
            hits = []
            for side in (-1, 1):
                if side != last:
                    panel = np.array([side * sine, cosine])
                    distance, along = np.linalg.solve(np.stack([direction, -panel], axis=1), -place)
                    if distance > 1e-12 and 0 <= along <= 1:
                        hits.append((distance, side))
            if not hits:
                break
            distance, last = min(hits)
            normal = np.array([-last * cosine, sine])
            place, direction = place + distance * direction, direction - 2 * direction @ normal * normal
        found.append([-view[0], *direction])
    return np.array(found)


def unit(polar: Any, azimuth: Any) -> np.ndarray:
    return np.array([np.sin(polar) * np.sin(azimuth), np.sin(polar) * np.cos(azimuth), np.cos(polar)])


def test_gloss_trap_of_mirrors_against_traced_rays() -> None:
    """The share of rays that miss the trap; 300 entries resolve it to 4/300."""
    rng = np.random.default_rng(3)

    @jax.jit
    def value(angle: Any, view: Any, trap: Any) -> Any:
        scene = vc.Scene(vc.VGrooves(angle), vc.Specular(MIRROR), vc.DiffuseWithTrap(*trap), vc.View(*view))
        return vc.reflectance_factor(scene)

    partly = 0
    for _ in range(40):
        angle = np.radians(rng.uniform(15, 178))
        view = np.array([np.radians(rng.uniform(0, 80)), rng.uniform(0, 2 * np.pi)])
        exits = traced_exits(angle, unit(*view), 300)
        center = exits[rng.integers(300)] + 0.1 * rng.normal(size=3)
        polar, azimuth = np.arccos(center[2] / np.linalg.norm(center)), np.arctan2(center[0], center[1])
        half_angle = min(rng.uniform(0.05, 0.3), np.pi / 2 - polar - 1e-3)
        if half_angle < 0.02:
            continue
        seen = exits @ unit(polar, azimuth) < np.cos(half_angle)
        wanted = np.mean(seen) / (1 - np.sin(half_angle) ** 2 * np.cos(polar))
        assert value(angle, view, np.array([polar, azimuth, half_angle])) == pytest.approx(wanted, abs=4 / 300)
        partly += 0 < np.mean(seen) < 1
    assert partly > 5


def reading(surface: Any, material: Any, name: Any, tolerance: float = 1e-6, **options: Any) -> Any:
    return vc.reflectance_factor(vc.Scene(surface, material, *vc.cie_geometry(name, **options)), tolerance)


def test_reciprocity_of_instruments() -> None:
    for surface in (vc.VGrooves(0.9), vc.GaussianGrooves(0.4)):
        for material in (vc.Specular(GOLD), vc.Lambertian(0.6)):
            assert reading(surface, material, "8:d", azimuth=0.4) == reading(surface, material, "d:8", azimuth=0.4)


def test_flat_samples() -> None:
    """A flat matte sample reads its reflectance everywhere; a flat mirror nothing beyond a gloss trap."""
    for name in GEOMETRIES:
        np.testing.assert_allclose(
            reading(vc.VGrooves(np.pi), vc.Lambertian(0.37), name), 0.37, rtol=0, atol=1e-12
        )
    assert reading(vc.VGrooves(np.pi), vc.Specular(GOLD), "de:8") == 0
    smooth = reading(vc.VGrooves(np.pi), vc.Specular(GOLD), "d:d", 1e-9)
    for surface in (vc.BeckmannGrooves(1e-5), vc.GaussianGrooves(1e-5)):
        np.testing.assert_allclose(reading(surface, vc.Specular(GOLD), "d:d", 1e-8), smooth, rtol=0, atol=1e-4)


@pytest.mark.parametrize(
    "surface", [vc.VGrooves(0.5), pytest.param(vc.GaussianGrooves(0.7), marks=pytest.mark.slow)]
)
def test_white_furnace(surface: Any) -> None:
    """Nothing is lost by a perfect mirror or a perfect diffuser."""
    for light in (vc.Diffuse(), vc.Annular(1.2), vc.Mixed(0.3, vc.Directional(0.8, 0.5))):
        for material in (vc.Specular(MIRROR), vc.Lambertian(1.0)):
            scene = vc.Scene(surface, material, light, vc.Hemisphere())
            assert vc.reflectance_factor(scene, 1e-4) == pytest.approx(1, abs=1e-4)


def test_degenerate_lights() -> None:
    groove, matte = vc.VGrooves(0.9), vc.Lambertian(0.7)
    view = vc.View(0.6, 0.2)

    def lit(light: Any, view: Any = view) -> Any:
        return vc.reflectance_factor(vc.Scene(groove, matte, light, view), 1e-10)

    assert lit(vc.Annular(0.0)) == pytest.approx(float(lit(vc.Directional(0.0, 0.0))), abs=1e-10)
    assert lit(vc.DiffuseWithTrap(-0.3, 0.0, 0.0)) == pytest.approx(float(lit(vc.Diffuse())), abs=1e-12)
    assert lit(vc.Hemisphere()) == lit(vc.Diffuse())
    mixed = vc.Mixed(0.3, vc.Directional(0.8, 0.5))
    parts = lit(vc.Diffuse(), vc.Hemisphere()), lit(mixed.directional, vc.Hemisphere())
    assert lit(mixed, vc.Hemisphere()) == pytest.approx(float(0.3 * parts[0] + 0.7 * parts[1]), abs=1e-12)


def test_sphere_is_the_mean_of_directions() -> None:
    """Bi-hemispherical reflectance against the hemispherical-directional one, panels ending at its kinks."""
    angle = 1.1
    for material, bound in ((vc.Lambertian(0.8), 1e-9), (vc.Specular(GOLD), 1e-9)):
        marks = {0.0, np.pi / 2, angle / 2}
        marks |= {abs(k * angle - np.pi) / 2 for k in range(1, 7)} | {
            abs((k - 0.5) * angle - np.pi) for k in range(1, 7)
        }
        ends = np.array(sorted(m for m in marks if m <= np.pi / 2))
        x, w = np.polynomial.legendre.leggauss(24)
        s, ws = 0.5 + 0.5 * x, w / 2
        # Nodes cluster at both ends: a mask sets in with a fractional power.
        grown, slope = s**3 * (10 - 15 * s + 6 * s * s), 30 * s**2 * (1 - s) ** 2
        t = (ends[:-1, None] + np.diff(ends)[:, None] * grown).ravel()
        wt = (np.diff(ends)[:, None] * slope * ws).ravel() * np.cos(t)
        eta = np.pi / 2 * (1 - s * s)
        we = np.pi * s * ws * np.cos(eta) ** 2
        eta, t = np.meshgrid(eta, t)
        e = np.sin(eta), np.cos(eta) * np.sin(t), np.cos(eta) * np.cos(t)
        view = vc.View(np.arctan2(np.hypot(e[0], e[1]), e[2]).ravel(), np.arctan2(e[0], e[1]).ravel())
        seen = vc.reflectance_factor(vc.Scene(vc.VGrooves(angle), material, vc.Diffuse(), view), 1e-12)
        mean = 4 / np.pi * (wt[:, None] * we).ravel() @ np.asarray(seen)
        assert reading(vc.VGrooves(angle), material, "d:d", 1e-12) == pytest.approx(mean, abs=bound)


NAMES = {"mirror": ("d:d", "8:d", "de:8"), "matte": ("d:d", "8:d", "de:8", "45a:0", "45x:0")}
QUICK = {("matte", "d:d", "beckmann")}


def case(material: str, name: str, kind: str) -> Any:
    """Random grooves take long to compile: most of them are slow."""
    slow = kind != "grooves" and (material, name, kind) not in QUICK
    return pytest.param(name, kind, material, marks=[pytest.mark.slow] if slow else [])


CASES = [case(material, name, kind) for material in NAMES for name in NAMES[material] for kind in SURFACES]


@pytest.mark.parametrize(("name", "kind", "material"), CASES)
def test_tolerance_and_gradient(name: Any, kind: str, material: str) -> None:
    """Coarse values keep their promise; reverse mode, compiled with known constants, agrees with differences."""
    geometry = vc.cie_geometry(name, 0.3) if name != "45a:0" else vc.cie_geometry(name)
    optical = np.array([GOLD, 3.0 + 0.1j]) if material == "mirror" else np.array([0.2, 0.9])

    def value(parameter: Any, optical: Any, tolerance: float) -> Any:
        made = vc.Specular(optical) if material == "mirror" else vc.Lambertian(optical)
        return vc.reflectance_factor(vc.Scene(SURFACES[kind](parameter), made, *geometry), tolerance)

    at = 0.83 if kind == "grooves" else 0.42
    fine = jax.jit(lambda p: value(p, optical, 1e-10))
    coarse = jax.jit(lambda p: value(p, optical, 1e-4))
    np.testing.assert_allclose(coarse(at), fine(at), rtol=0, atol=1e-4)
    slope = jax.jit(jax.grad(lambda p: jnp.sum(value(p, optical, 1e-10))))(at)
    step = 1e-3
    points = [jnp.sum(fine(at + k * step)) for k in (-2, -1, 1, 2)]
    wanted = (points[0] - 8 * points[1] + 8 * points[2] - points[3]) / (12 * step)
    assert slope == pytest.approx(float(wanted), rel=2e-6, abs=1e-8)


@pytest.mark.parametrize("kind", ["beckmann", "gaussian"])
@pytest.mark.parametrize("material", [vc.Specular(GOLD), vc.Lambertian(0.5)], ids=["mirror", "matte"])
def test_roughness_tends_to_zero(kind: str, material: Any) -> None:
    """Traced and 0: the flat value, and a finite slope that the values next to it have."""
    read = jax.jit(jax.value_and_grad(lambda m: reading(SURFACES[kind](m), material, "d:d", 1e-8)))
    value, slope = read(0.0)
    assert value == pytest.approx(float(reading(vc.VGrooves(np.pi), material, "d:d", 1e-8)), abs=2e-8)
    assert np.isfinite(slope)
    assert read(1e-3)[0] - value == pytest.approx(float(1e-3 * slope), abs=2e-5)


def test_a_trap_covers_what_it_covers() -> None:
    with pytest.raises(ValueError, match=r"is not a half-angle of a gloss trap.*covers the detector"):
        vc.cie_geometry("de:8", trap_half_angle=np.radians(16))
    light = vc.DiffuseWithTrap(-0.1, 0.0, 0.3)
    with pytest.raises(ValueError, match="covers the detector"):
        vc.reflectance_factor(vc.Scene(vc.VGrooves(1.0), vc.Lambertian(0.5), light, vc.View(np.array([0.1, 0.5]))))
    with pytest.raises(ValueError, match="above the horizon"):
        vc.DiffuseWithTrap(1.4, 0.0, 0.2)


def test_unknown_geometry() -> None:
    jaxtyping.config.update(
        "jaxtyping_disable", True
    )  # as users meet it: without the check of types in these tests
    try:
        with pytest.raises(ValueError, match=r"'8:8' is not a geometry: expected one of d:0, d:8, .*45x:0"):
            vc.cie_geometry("8:8")  # type: ignore[arg-type]
    finally:
        jaxtyping.config.update("jaxtyping_disable", False)


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (lambda: vc.View(np.radians(95), 0.0), "is not a polar angle in radians"),
        (lambda: vc.Annular(45.0), r"45\.0 is not a polar angle of a ring.*degrees\?"),
        (lambda: vc.BeckmannGrooves(0.0), r"0\.0 is not a roughness: expected m > 0.*VGrooves\(π\)"),
        (lambda: vc.GaussianGrooves(-1.0), r"-1\.0 is not a roughness"),
        (lambda: vc.Scene(1.0, vc.Lambertian(0.5), vc.Diffuse(), vc.View()), "1.0 is not a surface.*VGrooves"),  # type: ignore[arg-type]
        (lambda: vc.bihemispherical_table(vc.Specular(1.5), roughest=11.0), "not a largest roughness"),
    ],
)
def test_bad_input(bad: Any, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        bad()


def test_kinks_are_where_slopes_jump() -> None:
    """Second differences stand out at listed angles only, and at some of them."""
    scene = vc.Scene(vc.VGrooves(1.0), vc.Specular(GOLD), *vc.cie_geometry("8:d", 0.2))
    degrees = np.linspace(50, 130, 1601)
    value = jax.jit(jax.vmap(lambda a: reading(vc.VGrooves(a), vc.Specular(GOLD), "8:d", azimuth=0.2)))
    second = np.abs(np.diff(np.asarray(value(np.radians(degrees))), 2))
    beside = np.maximum(second[:-20], second[20:])  # half a degree away
    sharp = degrees[11:-11][second[10:-10] > 4 * beside]
    listed = np.degrees(vc.kink_angles(scene, 0.8, 2.4))
    assert len(sharp) > 3
    assert np.all(np.min(np.abs(sharp[:, None] - listed), axis=1) < 0.1)


@pytest.mark.parametrize("light", [vc.Diffuse(), vc.Annular(np.radians(45))], ids=["sphere", "ring"])
def test_averages_over_directions_keep_their_slope(light: Any) -> None:
    """At 45 degrees another reflection sets in; for the ring the slope then changes as a square root."""
    surface = vc.VGrooves(np.radians(45))
    assert vc.kink_angles(vc.Scene(surface, vc.Specular(GOLD), light, vc.Hemisphere()), 0.5, 3.0).size == 0

    @jax.jit
    @jax.grad
    def slope(angle: Any) -> Any:
        return vc.reflectance_factor(vc.Scene(vc.VGrooves(angle), vc.Specular(GOLD), light, vc.Hemisphere()), 1e-9)

    below, above = (slope(np.radians(45) + step) for step in (-1e-8, 1e-8))
    assert above == pytest.approx(float(below), abs=1e-4)
