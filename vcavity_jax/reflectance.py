"""From a scene to its reflectance factor: check it, plan the least work that it needs, do that work."""

import dataclasses
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from vcavity_jax import (
    angle_table,
    bihemispherical,
    illumination,
    interfaced_scene,
    planning,
    radiosity,
    resolution,
    ring,
    roughness,
    specular,
)
from vcavity_jax.angle_table import BihemisphericalTable
from vcavity_jax.directions import components, within_range
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
    InterfacedLambertian,
    Lambertian,
    Material,
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
    scene: Scene,
    tolerance: float = 1e-8,
    *,
    smallest_angle: float | None = None,
    smallest_index: float | None = None,
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
            dihedral angle that JAX traces is known to stay above this; by default 0.1 degrees, and 2 degrees for
            interfaced panels, the narrowest that are modeled. There a traced
            angle below it gives NaN.
        smallest_index: interfaced panels cost several times less if an index that JAX traces is known to stay at
            or above this; by default 1. There a traced index below it gives NaN.

    Returns:
        Fraction, of shape ``scene.view.shape`` (none for a hemispherical view) followed by the material's
        wavelength shape.

    Raises:
        ValueError: the scene has no finite answer or combines parts that the models do not cover; diffusing
            grooves are known to be narrower than 0.1 degrees, or a roughness to exceed 10; a parameter that is
            one number is an array; the tolerance is not a plain number between 0 and 1, or the smallest angle
            not one between 0.1 degrees and π.

    References:
        [SaintPierre2020, chapters 3 to 5], with the corrections of docs/errata.md.
    """
    check(scene, smallest_angle, smallest_index)
    light = scene.illumination
    if isinstance(scene.view, Hemisphere):
        if isinstance(light, Mixed):
            promised = {"smallest_angle": smallest_angle, "smallest_index": smallest_index}
            diffuse, directional = (
                reflectance_factor(_lit(scene, part), tolerance, **promised)
                for part in (Diffuse(), light.directional)
            )
            return light.diffuse_fraction * diffuse + (1 - light.diffuse_fraction) * directional
        if isinstance(light, Directional):
            # Reciprocity: what a direction lights diffusely is what diffuse light sends in that direction.
            scene = Scene(scene.surface, scene.material, Diffuse(), View(light.polar, light.azimuth))
    material = planning.with_safe_index(planning.simplified(scene.material))
    scene = Scene(scene.surface, material, scene.illumination, scene.view)
    value = _evaluate(scene, planning.plan(scene, tolerance, smallest_angle, smallest_index))
    return within_plan(scene, value, smallest_angle, smallest_index)


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


def check(scene: Scene, smallest_angle: float | None, smallest_index: float | None) -> None:
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
    if not isinstance(scene.surface, VGrooves) and isinstance(scene.view, View):
        source = light.directional if isinstance(light, Mixed) else light
        if getattr(source, "solid_angle", None) is not None:
            raise ValueError(
                "the specular component of a source of given solid angle on random grooves is not modeled: "
                "expected Directional without solid_angle"
            )
    for part in (scene.surface, light, getattr(light, "directional", None)):
        for name in ("angle", "roughness", "polar", "azimuth", "half_angle", "diffuse_fraction"):
            if jnp.ndim(getattr(part, name, 0.0)) != 0:
                raise ValueError(f"{name} is an array: expected one number; use jax.vmap for a batch of scenes")
    degrees = ". Did you pass degrees?"
    if smallest_angle is not None:
        bad = not resolution.NARROWEST <= smallest_angle <= np.pi
        refuse("a smallest angle in radians", smallest_angle, bad, "0.1 degrees (0.00175) to π", degrees)
    if smallest_index is not None:
        refuse("a smallest index", smallest_index, not 1 <= smallest_index < np.inf, "a number n ≥ 1")
    if not isinstance(scene.surface, VGrooves):
        known = concrete(scene.surface.roughness)
        if known is not None:
            refuse("a roughness that is modeled", known, known > planning.ROUGHEST, "m ≤ 10")
    elif not isinstance(scene.material, Specular):
        known = concrete(scene.surface.angle)
        if known is not None:
            limit, expected = resolution.NARROWEST, "at least 0.1 degrees (0.00175)"
            kind = "diffusing"
            if planning.interfaced_panel(planning.simplified(scene.material)) is not None:
                limit, expected = resolution.INTERFACED_NARROWEST, "at least 2 degrees (0.0349)"
                kind = "interfaced"
            narrow = known < limit * (1 - 1e-6)
            refuse(f"an angle of {kind} grooves that is modeled", known, narrow, expected)


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


def within_plan(scene: Scene, value: Array, smallest_angle: float | None, smallest_index: float | None) -> Array:
    """NaN where a traced parameter turns out to lie beyond what the work was planned for."""
    panel = planning.interfaced_panel(scene.material)
    limits: list[tuple[Array, Array]] = []
    if not isinstance(scene.surface, VGrooves):
        limits.append((scene.surface.roughness, scene.surface.roughness <= planning.ROUGHEST))
    elif not isinstance(scene.material, Specular) or isinstance(scene.illumination, Annular):
        narrowest = resolution.NARROWEST if panel is None else resolution.INTERFACED_NARROWEST
        lowest = max(narrowest, smallest_angle or 0.0) * (1 - 1e-6)
        limits.append((scene.surface.angle, scene.surface.angle >= lowest))
    if panel is not None:
        least = (smallest_index or 1.0) * (1 - 1e-12)
        limits.append((panel.index, jnp.all(panel.index >= least)))
    for parameter, kept in limits:
        if concrete(parameter) is None:
            value = jnp.where(kept, value, jnp.full_like(value, jnp.nan))
    return value


@eqx.filter_jit
def _evaluate(scene: Scene, plan: Plan) -> Array:
    directions = _directions(scene.view)
    if isinstance(scene.material, Specular):
        shape = scene.material.index.shape
        value = _specular(scene, directions, plan)
    elif planning.interfaced_panel(scene.material) is not None:
        shape = wavelength_shape(scene.material)
        assert isinstance(scene.material, InterfacedLambertian | TwoPanels)
        value = interfaced_scene.reflectance(scene.material, scene.illumination, scene.surface, directions, plan)
    else:
        both = panels(scene.material)
        shape = jnp.broadcast_shapes(*(jnp.shape(p) for p in both))
        first, second = (jnp.broadcast_to(p, shape).ravel() for p in both)
        value = _diffusing(scene, (first, second), directions, plan)
        if isinstance(scene.material, TwoPanels) and scene.material.alternating and directions is not None:
            value = (value + _diffusing(scene, (second, first), directions, plan)) / 2
    return jnp.reshape(value, (*scene.view.shape, *shape))


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
        # Real arithmetic, and what polarization does not couple, are as fast in a loop.
        unrolled = plan.most and plan.model == "full" and jnp.iscomplexobj(index)
        angle, most = within_range(surface.angle), plan.most if unrolled else None
        value = specular.hemispherical_directional(
            angle, along, across, normal, index, plan.model, plan.symmetric, trap, most
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
        angle = within_range(surface.angle)
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


def wavelength_shape(material: Material) -> tuple[int, ...]:
    """Wavelength shape of interfaced panels, () or (L,)."""
    panels = (material.first, material.second) if isinstance(material, TwoPanels) else (material,)
    return jnp.broadcast_shapes(*(p.wavelength_shape for p in panels if isinstance(p, InterfacedLambertian)))


def panels(material: Material) -> tuple[Array, Array]:
    """Reflectances of the first and the second of two bare panels."""
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
        return at(directions, plan, within_range(scene.surface.angle))
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
