"""From a scene to its reflectance factor: check it, plan the least work that it needs, do that work."""

import dataclasses
from collections.abc import Sequence
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from vcavity_jax import (
    angle_table,
    bihemispherical,
    illumination,
    planning,
    radiosity,
    resolution,
    ring,
    roughness,
    specular,
)
from vcavity_jax.angle_table import BihemisphericalTable
from vcavity_jax.directions import components
from vcavity_jax.planning import Plan
from vcavity_jax.resolution import AngleTableResolution, BihemisphericalResolution
from vcavity_jax.roughness import Slopes
from vcavity_jax.scene import (
    Annular,
    BeckmannGrooves,
    Diffuse,
    DiffuseWithTrap,
    Directional,
    Hemisphere,
    Illumination,
    Lambertian,
    Mixed,
    Polarization,
    Scene,
    Specular,
    Surface,
    TwoPanels,
    VGrooves,
    View,
    concrete,
    refuse,
)

_EXTENDED_AT_ONCE = 4
"""Views of a random surface in a ring or a disk of light that are in memory together."""


def reflectance_factor(
    scene: Scene, tolerance: float = 1e-8, *, smallest_angle: float | None = None
) -> Float[Array, "*directions_and_wavelengths"]:
    """Reflectance factor of a scene: its radiance seen from afar over that of a perfect white flat diffuser.

    Under diffuse light it is the hemispherical-directional reflectance factor, by reciprocity also the
    directional-hemispherical reflectance. The radiance is averaged over the projected visible area. With a
    hemispherical view it is the reflectance: reflected over incident flux.

    It is continuous in every parameter. Its gradient jumps where the number of reflections or the visible
    part of a panel changes (``vc.kink_angles``); there it is the gradient of one side, and finite. One thing
    jumps itself: a mirror groove in a sphere with a gloss trap, where a path turns into the trap.

    Args:
        scene: the surface, material, illumination and view.
        tolerance: upper bound on the absolute numerical error, a plain number between 0 and 1. Rounding limits
            what can be reached: for diffusing panels to 1e-13 from 5 degrees and 1e-11 at 1 degree, with shadows
            or masks to 1e-11 from 10 degrees, 1e-10 at 5 and 1e-8 at 1; in float32 to 1e-5 from 20 degrees. Not
            kept for mirrors of n < 1 and k < 0.01 seen by a hemisphere: docs/geometries.md.
        smallest_angle: radians. Diffusing panels, and mirrors lit by a ring, cost several times less if a
            dihedral angle that JAX traces is known to stay above this; by default 0.1 degrees. There a traced
            angle below it gives NaN.

    Returns:
        Fraction, of shape ``scene.view.shape`` (none for a hemispherical view) followed by the material's
        wavelength shape.

    Raises:
        ValueError: the scene has no finite answer or combines parts that the models do not cover; diffusing
            grooves are known to be narrower than 0.1 degrees, or a roughness to exceed 10; a parameter that is
            one number is an array; the tolerance is not a plain number between 0 and 1, or the smallest angle
            not one between 0.1 degrees and π.

    References:
        [SaintPierre2020, chapters 3 and 4], with the corrections of docs/errata.md.
    """
    _check(scene, smallest_angle)
    light = scene.illumination
    if isinstance(scene.view, Hemisphere):
        if isinstance(light, Mixed):
            diffuse, directional = (
                reflectance_factor(_lit(scene, part), tolerance, smallest_angle=smallest_angle)
                for part in (Diffuse(), light.directional)
            )
            return light.diffuse_fraction * diffuse + (1 - light.diffuse_fraction) * directional
        if isinstance(light, Directional):
            # Reciprocity: what a direction lights diffusely is what diffuse light sends in that direction.
            scene = Scene(scene.surface, scene.material, Diffuse(), View(light.polar, light.azimuth))
    scene = Scene(scene.surface, planning.with_safe_index(scene.material), scene.illumination, scene.view)
    value = _evaluate(scene, planning.plan(scene, tolerance, smallest_angle))
    return _within_plan(scene, value, smallest_angle)


def _lit(scene: Scene, light: Illumination) -> Scene:
    return Scene(scene.surface, scene.material, light, scene.view)


def bihemispherical_table(
    material: Specular, tolerance: float = 1e-8, *, roughest: float = 5.0
) -> BihemisphericalTable:
    """Bi-hemispherical reflectance of a mirror at all groove angles that randomly grooved surfaces have.

    It takes as long as the reflectance of the roughest surface, once. Then ``table.average(roughness, slopes)`` is
    the reflectance of a surface of any roughness, for slopes "beckmann" or "gaussian", and ``table.at(angle)``
    that of one groove angle; both are differentiable.

    Args:
        material: the mirror.
        tolerance: upper bound on the absolute numerical error, see ``reflectance_factor``.
        roughest: the largest roughness m that will be asked for, above 0, up to 10.

    Returns:
        The table; its spectra have the shape (L,), with L = 1 for a single index.

    Raises:
        ValueError: the material is not ``Specular``, the roughness is out of range, or the tolerance is.
    """
    if not isinstance(material, Specular):
        raise ValueError(f"{material!r} is not a mirror: expected Specular(index)")
    refuse("a largest roughness", roughest, not 0 < roughest <= planning.ROUGHEST, "above 0, up to 10")
    nodes = planning.table_resolution(material, resolution.check_tolerance(tolerance), roughest)
    mirror = planning.with_safe_index(material)
    assert isinstance(mirror, Specular)
    return _build_table(mirror.index.ravel(), mirror.polarization, nodes)


@eqx.filter_jit
def _build_table(index: Array, model: Polarization, nodes: AngleTableResolution) -> BihemisphericalTable:
    return BihemisphericalTable.build(index, model, nodes)


def radiance_profile(
    scene: Scene, position: ArrayLike | Sequence[float], tolerance: float = 1e-8
) -> Float[Array, "2 ..."]:
    """Local radiance along both panels of a diffusing groove; it does not depend on the view.

    Args:
        scene: ``VGrooves`` of ``Lambertian`` or ``TwoPanels``; its view is not used.
        position: distance from the fold in panel widths, 0 to 1, any shape.
        tolerance: upper bound on the absolute numerical error for positions above 1e-4, a plain number between
            0 and 1. Nearer to the fold the error grows as 1 / √position; below 1e-14 the radiance at 1e-14
            is returned, and that of the fold itself, exactly, at 0.

    Returns:
        First panel (y < 0), then second, in units of the radiance of a flat white diffuser in the same light;
        shape (2,) + position.shape + wavelength shape.

    Raises:
        ValueError: as ``reflectance_factor``; the panels are specular, the groove angle is random, or a known
            position is not in 0 to 1.

    References:
        [SaintPierre2020, sections 3.3 to 3.5].
    """
    if isinstance(scene.material, Specular) or not isinstance(scene.surface, VGrooves):
        raise ValueError("a radiance profile needs diffusing panels and one groove angle: Lambertian, VGrooves")
    _check(scene, None)
    position = jnp.asarray(position, jnp.result_type(float))
    value = concrete(position)
    if value is not None:
        refuse("a position on a panel", value, ~((value >= 0) & (value <= 1)), "0 (fold) to 1 (rim)")
    plan = dataclasses.replace(
        planning.plan(scene, tolerance),
        step=resolution.step_resolution(resolution.check_tolerance(tolerance), None, None),
    )
    return _within_plan(scene, _profile(scene, position, plan), None)


def _check(scene: Scene, smallest_angle: float | None) -> None:
    """Refuse what has no answer, or none that the models cover, in one clear line."""
    light, sphere = scene.illumination, isinstance(scene.view, Hemisphere)
    if isinstance(scene.material, Specular) and not sphere and not isinstance(light, Diffuse | DiffuseWithTrap):
        raise ValueError(
            "a specular groove under directional light, seen from one direction, has no finite reflectance "
            "factor (it is a delta function): use Diffuse() light or a hemispherical view"
        )
    if isinstance(light, DiffuseWithTrap):
        if sphere:
            raise ValueError("a gloss trap goes with a detector in one direction: expected View(polar, azimuth)")
        _check_trap(light, scene.view)
    for part in (scene.surface, light, getattr(light, "directional", None)):
        for name in ("angle", "roughness", "polar", "azimuth", "half_angle", "diffuse_fraction"):
            if jnp.ndim(getattr(part, name, 0.0)) != 0:
                raise ValueError(f"{name} is an array: expected one number; use jax.vmap for a batch of scenes")
    degrees = ". Did you pass degrees?"
    if smallest_angle is not None:
        bad = not resolution.NARROWEST <= smallest_angle <= np.pi
        refuse("a smallest angle in radians", smallest_angle, bad, "0.1 degrees (0.00175) to π", degrees)
    if not isinstance(scene.surface, VGrooves):
        known = concrete(scene.surface.roughness)
        if known is not None:
            refuse("a roughness that is modeled", known, known > planning.ROUGHEST, "m ≤ 10")
    elif not isinstance(scene.material, Specular):
        known = concrete(scene.surface.angle)
        if known is not None:
            narrow = known < resolution.NARROWEST * (1 - 1e-6)
            refuse(
                "an angle of diffusing grooves that is modeled", known, narrow, "at least 0.1 degrees (0.00175)"
            )


def _check_trap(light: DiffuseWithTrap, view: View | Hemisphere) -> None:
    assert isinstance(view, View)
    known = [concrete(a) for a in (view.polar, view.azimuth, light.polar, light.azimuth, light.half_angle)]
    if any(part is None for part in known):
        return
    polar, azimuth, center, center_azimuth, half_angle = (np.asarray(part) for part in known)
    cosine = np.cos(polar) * np.cos(center) + np.sin(polar) * np.sin(center) * np.cos(azimuth - center_azimuth)
    covered = (cosine > np.cos(half_angle)) & (half_angle > 0)
    refuse(
        "a half-angle of a gloss trap",
        np.broadcast_to(half_angle, covered.shape),
        covered,
        f"less than {np.min(np.arccos(np.clip(cosine, -1, 1))):.4f}, where the trap covers the detector",
    )


def _within_plan(scene: Scene, value: Array, smallest_angle: float | None) -> Array:
    """NaN where a traced parameter turns out to lie beyond what the work was planned for."""
    if not isinstance(scene.surface, VGrooves):
        parameter, kept = scene.surface.roughness, scene.surface.roughness <= planning.ROUGHEST
    elif not isinstance(scene.material, Specular) or isinstance(scene.illumination, Annular):
        lowest = (resolution.NARROWEST if smallest_angle is None else smallest_angle) * (1 - 1e-6)
        parameter, kept = scene.surface.angle, scene.surface.angle >= lowest
    else:
        return value
    if concrete(parameter) is not None:
        return value
    return jnp.where(kept, value, jnp.full_like(value, jnp.nan))


@eqx.filter_jit
def _evaluate(scene: Scene, plan: Plan) -> Array:
    directions = _directions(scene.view)
    if isinstance(scene.material, Specular):
        wavelength_shape = scene.material.index.shape
        value = _specular(scene, directions, plan)
    else:
        panels = _panels(scene.material)
        wavelength_shape = jnp.broadcast_shapes(*(jnp.shape(p) for p in panels))
        first, second = (jnp.broadcast_to(p, wavelength_shape).ravel() for p in panels)
        value = _diffusing(scene, (first, second), directions, plan)
        if isinstance(scene.material, TwoPanels) and scene.material.alternating and directions is not None:
            value = (value + _diffusing(scene, (second, first), directions, plan)) / 2
    return jnp.reshape(value, (*scene.view.shape, *wavelength_shape))


@eqx.filter_jit
def _profile(scene: Scene, position: Array, plan: Plan) -> Array:
    assert isinstance(scene.surface, VGrooves)
    panels = _panels(scene.material)
    wavelength_shape = jnp.broadcast_shapes(*(jnp.shape(p) for p in panels))
    first, second = (jnp.broadcast_to(p, wavelength_shape).ravel() for p in panels)
    angle = _within_range(scene.surface.angle)
    value = radiosity.local_radiance(
        scene.illumination, angle, (first, second), position.ravel(), plan, plan.clustering
    )
    if isinstance(scene.material, TwoPanels) and scene.material.alternating:
        swapped = radiosity.local_radiance(
            scene.illumination, angle, (second, first), position.ravel(), plan, plan.clustering
        )
        value = (value + swapped) / 2
    return jnp.reshape(value, (2, *position.shape, *wavelength_shape))


def _directions(view: View | Hemisphere) -> tuple[Array, Array, Array] | None:
    """Components of the views, each of shape (D,); None for the hemisphere."""
    if isinstance(view, Hemisphere):
        return None
    polar, azimuth = jnp.broadcast_arrays(view.polar, view.azimuth)
    return components(polar.ravel(), azimuth.ravel())


def _slopes(surface: Surface) -> Slopes:
    return "beckmann" if isinstance(surface, BeckmannGrooves) else "gaussian"


def _specular(scene: Scene, directions: tuple[Array, Array, Array] | None, plan: Plan) -> Float[Array, "... w"]:
    assert isinstance(scene.material, Specular)
    index, surface, light = scene.material.index.ravel(), scene.surface, scene.illumination
    if directions is None:
        return _specular_sphere(surface, light, index, plan)
    along, across, normal = (component[:, None] for component in directions)
    trap = None
    if isinstance(light, DiffuseWithTrap):
        trap = specular.Trap(*components(light.polar, light.azimuth), light.half_angle)
    if isinstance(surface, VGrooves):
        value = specular.hemispherical_directional(
            _within_range(surface.angle), along, across, normal, index, plan.model, plan.symmetric, trap
        )
    else:
        value = roughness.specular_average(
            surface.roughness,
            along,
            across,
            normal,
            index,
            plan.model,
            plan.symmetric and trap is None,
            plan.order,
            plan.cutoff,
            plan.most,
            _slopes(surface),
            trap,
        )
    return value if trap is None else value / (1 - jnp.sin(trap.half_angle) ** 2 * trap.normal)


def _specular_sphere(surface: Surface, light: Illumination, index: Array, plan: Plan) -> Float[Array, " w"]:
    """Mirrors seen by a detector that collects all light."""
    if isinstance(surface, VGrooves):
        angle = _within_range(surface.angle)
        if isinstance(light, Annular):
            return ring.specular_average_over_ring(angle, light.polar, index, plan.model, plan.order, plan.most)
        assert isinstance(plan.sphere, BihemisphericalResolution)
        return bihemispherical.specular(angle, index, plan.model, plan.sphere)
    slopes = _slopes(surface)
    if isinstance(light, Annular):
        return ring.random_average_over_ring(
            surface.roughness, light.polar, index, plan.model, plan.order, plan.cutoff, plan.most, slopes
        )
    assert isinstance(plan.sphere, AngleTableResolution)
    return angle_table.average(surface.roughness, index, plan.model, plan.sphere, slopes)


def _within_range(angle: Float[Array, ""]) -> Float[Array, ""]:
    """The dihedral angle, where rounding (180 degrees in single precision) exceeds π."""
    return jnp.where(angle > np.pi, jnp.full_like(angle, np.pi), angle)


def _panels(material: Lambertian | TwoPanels | Specular) -> tuple[Array, Array]:
    if isinstance(material, TwoPanels):
        return material.first.reflectance, material.second.reflectance
    assert isinstance(material, Lambertian)
    return material.reflectance, material.reflectance


def _diffusing(
    scene: Scene, reflectances: tuple[Array, Array], directions: tuple[Array, Array, Array] | None, plan: Plan
) -> Float[Array, "... w"]:
    alike = isinstance(scene.material, Lambertian)
    at = partial(_diffusing_at, scene.illumination, reflectances, alike)
    if isinstance(scene.surface, VGrooves):
        return at(directions, plan, _within_range(scene.surface.angle))
    m, slopes = scene.surface.roughness, _slopes(scene.surface)
    shadows = illumination.shadow_sections(scene.illumination).astype(m.dtype)
    unhidden = dataclasses.replace(plan, lit=True, seen=True)

    def average(direction: tuple[Array, Array, Array] | None, sections: Array) -> Float[Array, " w"]:
        """One view, or the hemisphere of them."""
        fully_open, general = partial(at, direction, unhidden), partial(at, direction, plan)
        return roughness.lambertian_average(
            m,
            sections,
            lambda angle: fully_open(angle).reshape(-1),
            None if plan.open else lambda angle: general(angle).reshape(-1),
            plan.averaging,
            plan.cutoff,
            slopes,
        )

    if directions is None:
        return average(None, shadows)

    def one(along: Array, across: Array, normal: Array) -> Float[Array, " w"]:
        masks = jnp.abs(jnp.arctan2(across, normal))[None]
        return average((along[None], across[None], normal[None]), jnp.concatenate([masks, shadows]))

    # Rings and disks of light have many nodes for each view.
    extended = isinstance(scene.illumination, Annular | DiffuseWithTrap)
    batch = _EXTENDED_AT_ONCE if extended else directions[0].size
    return jax.lax.map(lambda direction: one(*direction), directions, batch_size=max(batch, 1))


def _diffusing_at(
    light: Illumination,
    reflectances: tuple[Array, Array],
    alike: bool,
    directions: tuple[Array, Array, Array] | None,
    plan: Plan,
    angle: Array,
) -> Float[Array, "... w"]:
    """Diffusing panels at one groove angle."""
    if directions is None:
        if isinstance(light, Annular):
            return radiosity.annular_hemispherical(
                angle, reflectances, alike, light.polar, plan, plan.clustering, plan.lit
            )
        return radiosity.bihemispherical(angle, reflectances, alike, plan)
    if isinstance(light, Annular):
        return radiosity.annular(
            angle, reflectances, alike, light.polar, directions, plan, plan.clustering, plan.lit, plan.seen
        )
    if isinstance(light, DiffuseWithTrap):
        return radiosity.trapped(
            angle, reflectances, alike, light, directions, plan, plan.clustering, plan.lit, plan.seen
        )
    if isinstance(light, Directional):
        return radiosity.directional(angle, reflectances, alike, light, directions, plan)
    diffuse = radiosity.diffuse(angle, reflectances, alike, directions, plan, plan.seen)
    if isinstance(light, Diffuse):
        return diffuse
    directional = radiosity.directional(angle, reflectances, alike, light.directional, directions, plan)
    return light.diffuse_fraction * diffuse + (1 - light.diffuse_fraction) * directional
