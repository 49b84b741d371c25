"""From a scene to its reflectance factor: check it, plan the least work that it needs, do that work."""

import dataclasses
from collections.abc import Sequence
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from vcavity_jax import planning, radiosity, resolution, roughness, specular
from vcavity_jax.directions import components
from vcavity_jax.planning import Plan
from vcavity_jax.scene import (
    BeckmannGrooves,
    Diffuse,
    Directional,
    Lambertian,
    Scene,
    Specular,
    TwoPanels,
    VGrooves,
    concrete,
    refuse,
)


def reflectance_factor(
    scene: Scene, tolerance: float = 1e-8, *, smallest_angle: float | None = None
) -> Float[Array, "*directions_and_wavelengths"]:
    """Reflectance factor of a scene: its radiance seen from afar over that of a perfect white flat diffuser.

    Under diffuse light it is the hemispherical-directional reflectance factor, by reciprocity also the
    directional-hemispherical reflectance. The radiance is averaged over the projected visible area.

    It is continuous in every parameter. Its gradient jumps where the number of reflections or the visible
    part of a panel changes (``vc.kink_angles``); there it is the gradient of one side, and finite.

    Args:
        scene: the surface, material, illumination and view.
        tolerance: upper bound on the absolute numerical error, a plain number between 0 and 1. Rounding limits
            what can be reached: for diffusing panels to 1e-13 from 5 degrees and 1e-11 at 1 degree, with shadows
            or masks to 1e-11 from 10 degrees, 1e-10 at 5 and 1e-8 at 1; in float32 to 1e-5 from 20 degrees.
        smallest_angle: radians. Diffusing panels whose dihedral angle JAX traces cost several times less if it
            is known to stay above this; by default 0.1 degrees. A traced angle below it gives NaN.

    Returns:
        Fraction, of shape ``scene.view.shape`` followed by the material's wavelength shape.

    Raises:
        ValueError: the scene has no finite answer or combines parts that the models do not cover; diffusing
            grooves are known to be narrower than 0.1 degrees, or a roughness to exceed 10; a parameter that is
            one number is an array; the tolerance is not a plain number between 0 and 1, or the smallest angle
            not one between 0.1 degrees and π.

    References:
        [SaintPierre2020, chapters 3 and 4], with the corrections of docs/errata.md.
    """
    _check(scene, smallest_angle)
    value = _evaluate(planning.with_safe_index(scene), planning.plan(scene, tolerance, smallest_angle))
    return _within_plan(scene, value, smallest_angle)


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
    if isinstance(scene.material, Specular) or isinstance(scene.surface, BeckmannGrooves):
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
    diffuse = isinstance(scene.illumination, Diffuse)
    if isinstance(scene.material, Specular) and not diffuse:
        raise ValueError(
            "a specular groove under directional light, seen from one direction, has no finite reflectance "
            "factor (it is a delta function): use Diffuse() light"
        )
    if isinstance(scene.surface, BeckmannGrooves) and not diffuse:
        raise ValueError("randomly grooved surfaces are modeled under Diffuse() light only")
    for part in (scene.surface, scene.illumination, getattr(scene.illumination, "directional", None)):
        for name in ("angle", "roughness", "polar", "azimuth", "diffuse_fraction"):
            if jnp.ndim(getattr(part, name, 0.0)) != 0:
                raise ValueError(f"{name} is an array: expected one number; use jax.vmap for a batch of scenes")
    degrees = ". Did you pass degrees?"
    if smallest_angle is not None:
        bad = not resolution.NARROWEST <= smallest_angle <= np.pi
        refuse("a smallest angle in radians", smallest_angle, bad, "0.1 degrees (0.00175) to π", degrees)
    if isinstance(scene.surface, BeckmannGrooves):
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


def _within_plan(scene: Scene, value: Array, smallest_angle: float | None) -> Array:
    """NaN where a traced parameter turns out to lie beyond what the work was planned for."""
    if isinstance(scene.surface, BeckmannGrooves):
        parameter, kept = scene.surface.roughness, scene.surface.roughness <= planning.ROUGHEST
    elif not isinstance(scene.material, Specular):
        lowest = (resolution.NARROWEST if smallest_angle is None else smallest_angle) * (1 - 1e-6)
        parameter, kept = scene.surface.angle, scene.surface.angle >= lowest
    else:
        return value
    if concrete(parameter) is not None:
        return value
    return jnp.where(kept, value, jnp.full_like(value, jnp.nan))


@eqx.filter_jit
def _evaluate(scene: Scene, plan: Plan) -> Array:
    polar, azimuth = jnp.broadcast_arrays(scene.view.polar, scene.view.azimuth)
    directions = components(polar.ravel(), azimuth.ravel())
    if isinstance(scene.material, Specular):
        wavelength_shape = scene.material.index.shape
        value = _specular(scene, directions, plan)
    else:
        panels = _panels(scene.material)
        wavelength_shape = jnp.broadcast_shapes(*(jnp.shape(p) for p in panels))
        first, second = (jnp.broadcast_to(p, wavelength_shape).ravel() for p in panels)
        value = _diffusing(scene, (first, second), directions, plan)
        if isinstance(scene.material, TwoPanels) and scene.material.alternating:
            value = (value + _diffusing(scene, (second, first), directions, plan)) / 2
    return jnp.reshape(value, (*scene.view.shape, *wavelength_shape))


@eqx.filter_jit
def _profile(scene: Scene, position: Array, plan: Plan) -> Array:
    assert isinstance(scene.surface, VGrooves)
    panels = _panels(scene.material)
    wavelength_shape = jnp.broadcast_shapes(*(jnp.shape(p) for p in panels))
    first, second = (jnp.broadcast_to(p, wavelength_shape).ravel() for p in panels)
    angle = _within_range(scene.surface.angle)
    value = radiosity.local_radiance(scene.illumination, angle, (first, second), position.ravel(), plan)
    if isinstance(scene.material, TwoPanels) and scene.material.alternating:
        swapped = radiosity.local_radiance(scene.illumination, angle, (second, first), position.ravel(), plan)
        value = (value + swapped) / 2
    return jnp.reshape(value, (2, *position.shape, *wavelength_shape))


def _specular(scene: Scene, directions: tuple[Array, Array, Array], plan: Plan) -> Float[Array, "d w"]:
    assert isinstance(scene.material, Specular)
    along, across, normal = (component[:, None] for component in directions)
    index = scene.material.index.ravel()
    if isinstance(scene.surface, VGrooves):
        return specular.hemispherical_directional(
            _within_range(scene.surface.angle), along, across, normal, index, plan.model, plan.symmetric
        )
    return roughness.specular_average(
        scene.surface.roughness,
        along,
        across,
        normal,
        index,
        plan.model,
        plan.symmetric,
        plan.order,
        plan.cutoff,
        plan.most,
    )


def _within_range(angle: Float[Array, ""]) -> Float[Array, ""]:
    """The dihedral angle, where rounding (180 degrees in single precision) exceeds π."""
    return jnp.where(angle > np.pi, jnp.full_like(angle, np.pi), angle)


def _panels(material: Lambertian | TwoPanels | Specular) -> tuple[Array, Array]:
    if isinstance(material, TwoPanels):
        return material.first.reflectance, material.second.reflectance
    assert isinstance(material, Lambertian)
    return material.reflectance, material.reflectance


def _diffusing(
    scene: Scene, reflectances: tuple[Array, Array], directions: tuple[Array, Array, Array], plan: Plan
) -> Float[Array, "d w"]:
    light = scene.illumination
    alike = isinstance(scene.material, Lambertian)
    if isinstance(scene.surface, BeckmannGrooves):
        return _diffusing_average(scene.surface.roughness, reflectances, alike, directions, plan)
    angle = _within_range(scene.surface.angle)
    if isinstance(light, Directional):
        return radiosity.directional(angle, reflectances, alike, light, directions, plan)
    diffuse = radiosity.diffuse(angle, reflectances, alike, directions, plan, plan.open)
    if isinstance(light, Diffuse):
        return diffuse
    directional = radiosity.directional(angle, reflectances, alike, light.directional, directions, plan)
    return light.diffuse_fraction * diffuse + (1 - light.diffuse_fraction) * directional


def _diffusing_average(
    m: Array,
    reflectances: tuple[Array, Array],
    alike: bool,
    directions: tuple[Array, Array, Array],
    plan: Plan,
) -> Float[Array, "d w"]:
    """Randomly grooved diffusing surface under diffuse light."""

    def one(along: Array, across: Array, normal: Array) -> Float[Array, " w"]:
        direction = (along[None], across[None], normal[None])

        def at(fully_seen: bool) -> partial[Array]:
            return partial(_at_angle, reflectances, alike, direction, plan, fully_seen)

        section = jnp.arctan2(across, normal)
        masked = None if plan.open else at(False)
        return roughness.lambertian_average(m, section, at(True), masked, plan.order, plan.cutoff)

    return jax.vmap(one)(*directions)


def _at_angle(
    reflectances: tuple[Array, Array],
    alike: bool,
    direction: tuple[Array, Array, Array],
    plan: Plan,
    fully_seen: bool,
    angle: Array,
) -> Float[Array, " w"]:
    return radiosity.diffuse(angle, reflectances, alike, direction, plan, fully_seen)[0]
