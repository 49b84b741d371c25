"""From a scene to its reflectance factor: check it, plan the least work that it needs, do that work."""

import dataclasses
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

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
)


def reflectance_factor(
    scene: Scene, tolerance: float = 1e-8, *, smallest_angle: float | None = None
) -> Float[Array, "*directions_and_wavelengths"]:
    """Reflectance factor of a scene: its radiance seen from afar over that of a perfect white flat diffuser.

    Under diffuse light it is the hemispherical-directional reflectance factor, by reciprocity also the
    directional-hemispherical reflectance. The radiance is averaged over the projected visible area.

    It is continuous in every parameter. Its gradient jumps where the number of reflections or the visible
    part of a panel changes (``kinks.kink_angles``); there it is the gradient of one side, and finite.

    Args:
        scene: the surface, material, illumination and view.
        tolerance: upper bound on the absolute numerical error, a plain number between 0 and 1. Rounding limits
            what can be reached to 1e-13; with shadows or masks to 1e-11 at 10 degrees, 1e-10 at 5 and 1e-8 at
            1; in float32 to 1e-5 above 20 degrees.
        smallest_angle: radians; where JAX traces the dihedral angle, diffusing panels cost several times less
            if it is known to stay above this (by default 0.1 degrees). Below it the result is NaN.

    Returns:
        Fraction, of shape ``scene.view.shape`` followed by the material's wavelength shape.

    Raises:
        ValueError: the scene has no finite answer, combines parts that the models do not cover, or the
            tolerance is not a plain number between 0 and 1.

    References:
        [SaintPierre2020, chapters 3 and 4], with the corrections of docs/errata.md.
    """
    _check(scene)
    value = _evaluate(planning.with_safe_index(scene), planning.plan(scene, tolerance, smallest_angle))
    if smallest_angle is None or not isinstance(scene.surface, VGrooves):
        return value
    promised = scene.surface.angle >= smallest_angle * (1 - 1e-6)
    return jnp.where(promised, value, jnp.full_like(value, jnp.nan))


def radiance_profile(
    scene: Scene, position: Float[Array, "*positions"] | float, tolerance: float = 1e-8
) -> Float[Array, "2 ..."]:
    """Local radiance along both panels of a diffusing groove; it does not depend on the view.

    Args:
        scene: ``VGrooves`` of ``Lambertian`` or ``TwoPanels``; its view is not used.
        position: distance from the fold in panel widths, 0 to 1, any shape.
        tolerance: upper bound on the absolute numerical error for positions above 1e-6; nearer to the fold,
            but for the fold itself, rounding grows as 1e-16 / √position.

    Returns:
        First panel (y < 0), then second, in units of the radiance of a flat white diffuser in the same light;
        shape (2,) + position.shape + wavelength shape.

    Raises:
        ValueError: the panels are specular, the groove angle is random, or a known position is not in 0 to 1.

    References:
        [SaintPierre2020, sections 3.3 to 3.5].
    """
    if isinstance(scene.material, Specular) or isinstance(scene.surface, BeckmannGrooves):
        raise ValueError("a radiance profile needs diffusing panels and one groove angle: Lambertian, VGrooves")
    position = jnp.asarray(position, jnp.result_type(float))
    value = concrete(position)
    if value is not None and not np.all((value >= 0) & (value <= 1)):
        raise ValueError(f"{value} is not a position on a panel: expected 0 (fold) to 1 (rim)")
    plan = dataclasses.replace(
        planning.plan(scene, tolerance),
        step=resolution.step_resolution(resolution.check_tolerance(tolerance), None, None),
    )
    return _profile(scene, position, plan)


def _check(scene: Scene) -> None:
    if isinstance(scene.material, Specular) and not isinstance(scene.illumination, Diffuse):
        raise ValueError(
            "a specular groove under directional light, seen from one direction, has no finite reflectance "
            "factor (it is a delta function): use Diffuse() light"
        )
    if isinstance(scene.surface, BeckmannGrooves) and not isinstance(scene.illumination, Diffuse):
        raise ValueError("randomly grooved surfaces are modeled under Diffuse() light only")


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
    return jnp.minimum(angle, jnp.asarray(np.pi, angle.dtype))


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
