"""Local radiance along the panels of a groove."""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from vcavity_jax import interfaced_scene, planning, radiosity, resolution
from vcavity_jax.directions import components, within_range
from vcavity_jax.planning import Plan
from vcavity_jax.reflectance import check, panels, wavelength_shape, within_plan
from vcavity_jax.scene import (
    Hemisphere,
    InterfacedLambertian,
    Scene,
    Specular,
    TwoPanels,
    VGrooves,
    View,
    concrete,
    refuse,
)


def radiance_profile(
    scene: Scene, position: ArrayLike | Sequence[float], tolerance: float = 1e-8
) -> Float[Array, "2 ..."]:
    """Local radiance along both panels of a groove.

    Bare diffusing panels have it alike in all directions. Interfaced ones are seen along the scene's view: what a
    camera shows at a position of a panel, with what is mirrored there of the other one.

    Args:
        scene: ``VGrooves`` of ``Lambertian``, ``InterfacedLambertian`` or ``TwoPanels``. Its view, one direction,
            is used for interfaced panels only; where the other panel hides a position, it is as if it did not.
        position: distance from the fold in panel widths, 0 to 1, any shape.
        tolerance: upper bound on the absolute numerical error for positions above 1e-4, a plain number between
            0 and 1. Nearer to the fold the error grows as 1 / √position; below 1e-14 the radiance at 1e-14
            is returned, and that of the fold itself, exactly, at 0. Interfaced panels: below 1e-8 that at 1e-8.

    Returns:
        First panel (y < 0), then second, in units of the radiance of a flat white diffuser in the same light;
        shape (2,) + position.shape + wavelength shape.

    Raises:
        ValueError: as ``reflectance_factor``; the panels are specular, the groove angle is random, interfaced
            panels are not seen from one direction, or a known position is not in 0 to 1.

    References:
        [SaintPierre2020, sections 3.3 to 3.5].
    """
    if isinstance(scene.material, Specular) or not isinstance(scene.surface, VGrooves):
        raise ValueError("a radiance profile needs diffusing panels and one groove angle: Lambertian, VGrooves")
    scene = Scene(scene.surface, planning.simplified(scene.material), scene.illumination, scene.view)
    interfaced = planning.interfaced_panel(scene.material) is not None
    if interfaced and (isinstance(scene.view, Hemisphere) or scene.view.shape != ()):
        raise ValueError(
            "a radiance profile of interfaced panels is seen from one direction: expected View(polar, azimuth)"
        )
    check(scene, None, None)
    position = jnp.asarray(position, jnp.result_type(float))
    value = concrete(position)
    if value is not None:
        refuse("a position on a panel", value, ~((value >= 0) & (value <= 1)), "0 (fold) to 1 (rim)")
    kept = resolution.check_tolerance(tolerance)
    plan = dataclasses.replace(
        # A point of an interfaced panel is the limit of a narrow band: its sums converge the more slowly.
        planning.plan(scene, max(kept / 100, 1e-13) if interfaced else kept),
        step=resolution.step_resolution(kept, None, None),
    )
    return within_plan(scene, _profile(scene, position, plan), None, None)


@eqx.filter_jit
def _profile(scene: Scene, position: Array, plan: Plan) -> Array:
    assert isinstance(scene.surface, VGrooves)
    angle = within_range(scene.surface.angle)
    if planning.interfaced_panel(scene.material) is not None:
        assert isinstance(scene.material, InterfacedLambertian | TwoPanels)
        assert isinstance(scene.view, View)
        view = components(scene.view.polar, scene.view.azimuth)
        value = interfaced_scene.profile(scene.material, scene.illumination, angle, view, position.ravel(), plan)
        return jnp.reshape(value, (2, *position.shape, *wavelength_shape(scene.material)))
    both = panels(scene.material)
    shape = jnp.broadcast_shapes(*(jnp.shape(p) for p in both))
    first, second = (jnp.broadcast_to(p, shape).ravel() for p in both)
    value = radiosity.local_radiance(
        scene.illumination, angle, (first, second), position.ravel(), plan, plan.clustering
    )
    if isinstance(scene.material, TwoPanels) and scene.material.alternating:
        swapped = radiosity.local_radiance(
            scene.illumination, angle, (second, first), position.ravel(), plan, plan.clustering
        )
        value = (value + swapped) / 2
    return jnp.reshape(value, (2, *position.shape, *shape))
