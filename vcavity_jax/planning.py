"""What a scene needs, decided before it is traced: only that is computed.

Planning looks at what is known when a function is called. A view that is known to be frontal, an index that
is known to be real, panels that are known to be fully lit and seen: each drops a part of the model. What JAX
traces is treated in full generality.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from vcavity_jax import resolution
from vcavity_jax.lambertian import MeanResolution
from vcavity_jax.scene import (
    Directional,
    Mixed,
    Polarization,
    Scene,
    Specular,
    VGrooves,
    concrete,
)
from vcavity_jax.wiener_hopf import Resolution

_CLEARLY_VISIBLE = 0.01
"""A lit or seen part of a panel above which its rim layer needs no extra care."""

ROUGHEST = 10.0
"""The roughness that the work is planned for when it is not known."""


@dataclasses.dataclass(frozen=True)
class Plan:
    """What a scene needs, fixed before it is traced.

    Args:
        darkest: the product of two panels' reflectances that may stand for zero.
        open: every panel is known to be fully lit and fully seen.
        balanced: light or view is known to meet both panels alike, so that one parity is enough.
        symmetric: every view is known to lie in the plane along the grooves.
        model: treatment of polarization that is exact for what the user asked.
        mean: sampling for G.
        step: sampling for shadows and masks.
        order: nodes per panel of an average over groove angles.
        cutoff: its largest slope.
        most: orders of kinks that it resolves.
    """

    darkest: float
    open: bool
    balanced: bool
    symmetric: bool
    model: Polarization
    mean: MeanResolution
    step: Resolution
    order: int
    cutoff: float
    most: int


def _known_directions(scene: Scene) -> list[tuple[np.ndarray, ...]] | None:
    """Components of the view, then of the light if it is directional; None where one of them is traced."""
    light = scene.illumination.directional if isinstance(scene.illumination, Mixed) else scene.illumination
    pairs = [(scene.view.polar, scene.view.azimuth)]
    if isinstance(light, Directional):
        pairs.append((light.polar, light.azimuth))
    known = []
    for polar, azimuth in pairs:
        theta, phi = concrete(polar), concrete(azimuth)
        if theta is None or phi is None:
            return None
        parts = np.sin(theta) * np.sin(phi), np.sin(theta) * np.cos(phi), np.cos(theta)
        known.append(tuple(np.atleast_1d(part) for part in parts))
    return known


def plan(scene: Scene, tolerance: float, smallest_angle: float | None = None) -> Plan:
    """The least work that keeps the tolerance for a scene.

    Args:
        scene: what is traced in it counts as unknown.
        tolerance: absolute error of the reflectance factor.
        smallest_angle: of a groove angle that is traced, radians.
    """
    tolerance = resolution.check_tolerance(tolerance)
    if isinstance(scene.material, Specular) and isinstance(scene.surface, VGrooves):
        cutoff, order, most = 0.0, 0, 0  # An exact finite sum: it serves every tolerance and angle.
        angle = None
        tolerance = 0.1
    elif isinstance(scene.surface, VGrooves):
        cutoff, order, most = 0.0, 0, 0
        value = concrete(scene.surface.angle)
        angle = smallest_angle if value is None else float(np.min(value))
    else:
        cutoff, order = resolution.slope_cutoff(tolerance), resolution.panel_order(tolerance)
        value = concrete(scene.surface.roughness)
        rough = ROUGHEST if value is None else max(float(np.max(value)), 1e-3)
        angle = 2 * float(np.arctan2(1, rough * cutoff))
        # A coarse ladder of orders keeps the number of compiled programs small.
        most = 2 ** int(np.ceil(np.log2(2 * np.pi / angle + 1)))
    directions = _known_directions(scene)
    in_fold_plane = [bool(np.all(np.abs(y) < 1e-15)) for _, y, _ in directions] if directions else [False]
    fully, visible = all(in_fold_plane), None
    if directions is not None and angle is not None:
        if isinstance(scene.surface, VGrooves):
            fully = fully or all(np.all(_hidden(angle, y, z) <= 0) for _, y, z in directions)
        narrowest = resolution.planned_angle(angle)
        seen = 1 - max(float(np.max(_hidden(narrowest, y, z), initial=0)) for _, y, z in directions)
        # Two cases only: every one is compiled for itself. Beyond, the rim layer is treated in full.
        visible = _CLEARLY_VISIBLE if seen >= _CLEARLY_VISIBLE else None
    model: Polarization = "full"
    if isinstance(scene.material, Specular):
        model = scene.material.polarization
        across_only = directions is not None and bool(np.all(np.abs(directions[0][0]) < 1e-15))
        if model == "full" and across_only:
            model = "separate"  # Without a component along the fold nothing couples s and p.
    return Plan(
        darkest=0.1 * tolerance,
        open=fully,
        balanced=any(in_fold_plane),
        symmetric=in_fold_plane[0],
        model=model,
        mean=resolution.mean_resolution(tolerance, angle),
        step=resolution.step_resolution(tolerance, angle, visible),
        order=order,
        cutoff=cutoff,
        most=most,
    )


def _hidden(angle: float, across: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Hidden depth of the panel that faces a direction; negative where both panels are met."""
    facing, behind = np.abs(across) * np.cos(angle / 2), normal * np.sin(angle / 2)
    return (facing - behind) / (facing + behind)


def with_safe_index(scene: Scene) -> Scene:
    """A real index stays real only where it is known to be at least 1; below, refraction may be complex."""
    if not isinstance(scene.material, Specular) or jnp.iscomplexobj(scene.material.index):
        return scene
    value = concrete(scene.material.index)
    if value is not None and bool(np.all(value >= 1)):
        return scene
    index = scene.material.index
    return eqx.tree_at(lambda s: s.material.index, scene, jax.lax.complex(index, jnp.zeros_like(index)))
