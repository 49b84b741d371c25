"""The purely specular component of interfaced panels: light that never enters the material."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from vcavity_jax import planning, specular
from vcavity_jax.directions import components, within_range
from vcavity_jax.reflectance import check, reflectance_factor, wavelength_shape
from vcavity_jax.scene import (
    Annular,
    Diffuse,
    Directional,
    InterfacedLambertian,
    Mixed,
    Scene,
    Specular,
    VGrooves,
    View,
)


def specular_component(scene: Scene, tolerance: float = 1e-8) -> Float[Array, "*directions_and_wavelengths"]:
    """The part of an interfaced scene's reflectance factor that the material below the interface has no share in.

    ``reflectance_factor`` contains it in diffuse light (behind a gloss trap: what the trap leaves of it), unless
    the material says ``specular_included=False``. In parallel light it is a delta function of the direction. A
    source of small solid angle ω turns it into π r_s / (ω cos θ), θ being the polar angle of the source, in the
    directions in which the source is mirrored [SaintPierre2020, eq. 5.24]; ``reflectance_factor`` contains it if
    ``Directional`` has a ``solid_angle``.

    Args:
        scene: of ``InterfacedLambertian`` panels, or two of them.
        tolerance: as in ``reflectance_factor``.

    Returns:
        Fraction, of the shape of the reflectance factor. A ring of light, being thin, adds nothing in a direction.

    Raises:
        ValueError: as ``reflectance_factor``; the panels have no interface; the light is parallel and seen in a
            direction, but its solid angle is not given or the grooves are random.
    """
    panel = planning.interfaced_panel(scene.material)
    if panel is None:
        raise ValueError("only interfaced panels have a specular component: expected InterfacedLambertian")
    check(scene, None, None)
    mirrors = Specular(panel.index, panel.polarization)
    light, view = scene.illumination, scene.view
    shape = (*view.shape, *wavelength_shape(scene.material))
    if isinstance(view, View) and isinstance(light, Mixed):
        parts = [
            specular_component(Scene(scene.surface, scene.material, part, view), tolerance)
            for part in (Diffuse(), light.directional)
        ]
        return light.diffuse_fraction * parts[0] + (1 - light.diffuse_fraction) * parts[1]
    if isinstance(view, View) and isinstance(light, Annular):
        return jnp.zeros(shape, panel.reflectance.dtype)
    if isinstance(view, View) and isinstance(light, Directional):
        value = _glint(scene, panel, light, view)
    else:
        value = reflectance_factor(Scene(scene.surface, mirrors, light, view), tolerance)
    directions = len(view.shape)
    value = value.reshape(*view.shape, *(1,) * (len(shape) - value.ndim), *value.shape[directions:])
    return jnp.broadcast_to(value, shape)


def _glint(scene: Scene, panel: InterfacedLambertian, light: Directional, view: View) -> Array:
    if light.solid_angle is None:
        raise ValueError(
            "the specular component of parallel light is a delta function: expected Directional(..., solid_angle=)"
        )
    if not isinstance(scene.surface, VGrooves):
        raise ValueError(
            "the specular component of parallel light on random grooves is not modeled: expected VGrooves"
        )
    polar, azimuth = jnp.broadcast_arrays(view.polar, view.azimuth)
    rank = panel.index.ndim
    along, across, normal = (part.reshape(*view.shape, *(1,) * rank) for part in components(polar, azimuth))
    source = specular.disk_of(*components(light.polar, light.azimuth), light.solid_angle)
    angle = within_range(scene.surface.angle)
    return specular.glint(angle, source, along, across, normal, panel.index, panel.polarization)
