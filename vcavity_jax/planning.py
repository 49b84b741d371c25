"""What a scene needs, decided before it is traced: only that is computed.

Planning looks at what is known when a function is called. A view that is known to be frontal, an index that
is known to be real, panels that are known to be fully lit and seen: each drops a part of the model. What JAX
traces is treated in full generality.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from vcavity_jax import bihemispherical, resolution, specular, subsurface
from vcavity_jax.interfaced import InterfaceResolution
from vcavity_jax.lambertian import MeanResolution
from vcavity_jax.quadrature import Clustering
from vcavity_jax.resolution import AngleTableResolution, BihemisphericalResolution
from vcavity_jax.scene import (
    Annular,
    ColoredLayer,
    Diffuse,
    DiffuseWithTrap,
    Directional,
    Hemisphere,
    InterfacedLambertian,
    Lambertian,
    Material,
    Mixed,
    Polarization,
    Scene,
    Specular,
    TwoPanels,
    VGrooves,
    View,
    concrete,
)
from vcavity_jax.wiener_hopf import Resolution

_CLEARLY_VISIBLE = 0.01
"""A lit or seen part of a panel above which its rim layer needs no extra care."""

ROUGHEST = 10.0
"""The roughness that the work is planned for when it is not known."""


Sphere = BihemisphericalResolution | AngleTableResolution


@dataclasses.dataclass(frozen=True)
class Plan:
    """What a scene needs, fixed before it is traced.

    Args:
        darkest: the product of two panels' reflectances that may stand for zero.
        lit: every panel is known to be fully lit.
        seen: every panel is known to be fully seen.
        balanced: light or view is known to meet both panels alike, so that one parity is enough.
        symmetric: every view is known to lie in the plane along the grooves.
        model: treatment of polarization that is exact for what the user asked.
        mean: sampling for G.
        step: sampling for shadows and masks.
        order: nodes per panel of an average over groove angles.
        cutoff: its largest slope.
        most: orders of kinks that it resolves; of a mirror seen from a direction, the reflections, 0 for many.
        clustering: nodes of a ring or a disk of light.
        averaging: nodes of an average over groove angles of diffusing panels.
        sphere: nodes of the integral over all directions of a mirror, None if it is not needed.
        interface: sampling of interfaced panels, None if there are none.
        tiers: the same for parts of the range of angles of random grooves, with the smallest angle of each.
    """

    darkest: float
    lit: bool
    seen: bool
    balanced: bool
    symmetric: bool
    model: Polarization
    mean: MeanResolution
    step: Resolution
    order: int
    cutoff: float
    most: int
    clustering: Clustering
    averaging: Clustering
    sphere: Sphere | None
    interface: InterfaceResolution | None
    tiers: tuple[tuple[float, InterfaceResolution], ...]

    @property
    def mirrors(self) -> BihemisphericalResolution | None:
        """Nodes of the specular component of interfaced panels that are lit and seen by the hemisphere."""
        return self.sphere if isinstance(self.sphere, BihemisphericalResolution) else None

    @property
    def open(self) -> bool:
        """Every panel is known to be fully lit and fully seen."""
        return self.lit and self.seen


Directions = tuple[np.ndarray, np.ndarray, np.ndarray]


def _known_view(scene: Scene) -> Directions | None:
    """Components of the views, none for a hemisphere (it is seen without masks); None if one is traced."""
    if isinstance(scene.view, Hemisphere):
        return np.zeros(0), np.zeros(0), np.zeros(0)
    return _components(concrete(scene.view.polar), concrete(scene.view.azimuth))


def _known_light(scene: Scene) -> Directions | None:
    """The directions of the light that a groove hides first, none for diffuse light; None if one is traced."""
    light = scene.illumination.directional if isinstance(scene.illumination, Mixed) else scene.illumination
    if isinstance(light, Directional):
        return _components(concrete(light.polar), concrete(light.azimuth))
    if isinstance(light, Annular):
        return _components(concrete(light.polar), np.zeros(()))
    if isinstance(light, DiffuseWithTrap):
        center = _components(concrete(light.polar), concrete(light.azimuth))
        half_angle = concrete(light.half_angle)
        if center is None or half_angle is None:
            return None
        _, across, normal = center
        beside = np.hypot(across, normal)
        reach = np.arcsin(np.minimum(np.sin(half_angle) / np.maximum(beside, 1e-30), 1))
        ends = np.arctan2(across, normal) + np.append(-reach, reach)
        return np.zeros(2), np.sin(ends), np.cos(ends)
    return np.zeros(0), np.zeros(0), np.zeros(0)


def _components(polar: np.ndarray | None, azimuth: np.ndarray | None) -> Directions | None:
    if polar is None or azimuth is None:
        return None
    parts = np.sin(polar) * np.sin(azimuth), np.sin(polar) * np.cos(azimuth), np.cos(polar)
    along, across, normal = (np.atleast_1d(part) for part in parts)
    return along, across, normal


def plan(
    scene: Scene, tolerance: float, smallest_angle: float | None = None, smallest_index: float | None = None
) -> Plan:
    """The least work that keeps the tolerance for a scene.

    Args:
        scene: what is traced in it counts as unknown.
        tolerance: absolute error of the reflectance factor.
        smallest_angle: of a groove angle that is traced, radians.
        smallest_index: of an interface's index that is traced.
    """
    tolerance = resolution.check_tolerance(tolerance)
    cutoff, order, most = 0.0, resolution.panel_order(tolerance), 0
    angle: float | None
    roughest: float | None = None
    if isinstance(scene.surface, VGrooves):
        value = concrete(scene.surface.angle)
        angle = smallest_angle if value is None else float(np.min(value))
    else:
        cutoff = resolution.slope_cutoff(tolerance)
        value = concrete(scene.surface.roughness)
        roughest = ROUGHEST if value is None else max(float(np.max(value)), 1e-3)
        angle = 2 * float(np.arctan2(1, roughest * cutoff))
    if isinstance(scene.material, Specular):
        if isinstance(scene.surface, VGrooves) and isinstance(scene.view, View):
            # An exact finite sum: it serves every tolerance and angle.
            reflections = 0 if angle is None else int(np.ceil(np.pi / angle - 1e-14))
            most = reflections if reflections <= specular.LONGEST_UNROLLED else 0
            tolerance, angle, order = 0.1, None, 0
        else:
            # A coarse ladder of orders keeps the number of compiled programs small.
            narrowest = resolution.NARROWEST if angle is None else angle
            most = 2 ** int(np.ceil(np.log2(2 * np.pi / narrowest + 1)))
    elif interfaced_panel(scene.material) is not None and angle is not None:
        most = 2 ** int(np.ceil(np.log2(2 * np.pi / max(angle, resolution.INTERFACED_NARROWEST) + 1)))
    view, light = _known_view(scene), _known_light(scene)
    single = isinstance(scene.surface, VGrooves)
    lit, seen = (_fully_met(part, angle, single) for part in (light, view))
    visible = None
    if view is not None and light is not None and angle is not None:
        narrowest = resolution.planned_angle(angle)
        hidden = max(float(np.max(_hidden(narrowest, y, z), initial=0)) for _, y, z in (view, light))
        # Two cases only: every one is compiled for itself. Beyond, the rim layer is treated in full.
        visible = _CLEARLY_VISIBLE if 1 - hidden >= _CLEARLY_VISIBLE else None
    model: Polarization = "full"
    if isinstance(scene.material, Specular):
        model = scene.material.polarization
        across_only = view is not None and view[0].size > 0 and bool(np.all(np.abs(view[0]) < 1e-15))
        if model == "full" and across_only:
            model = "separate"  # Without a component along the fold nothing couples s and p.
    even = isinstance(scene.illumination, Diffuse | Annular)
    return Plan(
        darkest=0.1 * tolerance,
        lit=lit,
        seen=seen,
        balanced=_in_fold_plane(view)
        or (_in_fold_plane(light) and not even)
        or isinstance(scene.illumination, Annular),
        symmetric=_in_fold_plane(view),
        model=model,
        mean=resolution.mean_resolution(tolerance, angle),
        step=resolution.step_resolution(tolerance, angle, visible),
        order=order,
        cutoff=cutoff,
        most=most,
        clustering=resolution.clustering(tolerance, visible),
        averaging=resolution.average_clustering(tolerance),
        sphere=_sphere(scene, tolerance, None if value is None else angle, roughest),
        interface=_interface(scene, tolerance, angle, 1.0 if lit and seen else visible, smallest_index),
        tiers=() if single else _tiers(scene, tolerance, angle, smallest_index),
    )


_WIDE = (np.pi / 3, np.pi / 7)
"""Angles at which the work for random grooves with interfaces is divided."""


def _interface(
    scene: Scene, tolerance: float, angle: float | None, visible: float | None, smallest_index: float | None
) -> InterfaceResolution | None:
    panel = interfaced_panel(scene.material)
    if panel is None:
        return None
    known = concrete(panel.index)
    index = None if smallest_index is None else (smallest_index, resolution.HIGHEST)
    if known is not None and known.size:
        index = float(np.min(known)), float(np.max(known))
    return resolution.interface_resolution(tolerance, angle, index, visible)


def _tiers(
    scene: Scene, tolerance: float, angle: float | None, smallest_index: float | None
) -> tuple[tuple[float, InterfaceResolution], ...]:
    narrowest = resolution.INTERFACED_NARROWEST if angle is None else angle
    ends = [*(wide for wide in _WIDE if wide > narrowest), narrowest]
    nodes = [_interface(scene, tolerance, end, None, smallest_index) for end in ends]
    return tuple((end, part) for end, part in zip(ends, nodes, strict=True) if part is not None)


def interfaced_panel(material: Material) -> InterfacedLambertian | None:
    """The material of the panels, the first of two, if they have an interface."""
    panel = material.first if isinstance(material, TwoPanels) else material
    return panel if isinstance(panel, InterfacedLambertian) else None


def _sphere(scene: Scene, tolerance: float, angle: float | None, roughest: float | None) -> Sphere | None:
    """Nodes of a mirror that is lit and seen by the hemisphere, at a known angle or at any."""
    if not (isinstance(scene.view, Hemisphere) and isinstance(scene.illumination, Diffuse)):
        return None
    if interfaced_panel(scene.material) is not None:
        return resolution.bihemispherical_orders(tolerance, angle if roughest is None else None, tame=True)
    if not isinstance(scene.material, Specular):
        return None
    if roughest is not None:
        return table_resolution(scene.material, tolerance, roughest)
    return resolution.bihemispherical_orders(tolerance, angle, _is_tame(scene.material))


def table_resolution(material: Specular, tolerance: float, roughest: float) -> AngleTableResolution:
    """Nodes of a mirror's reflectance as a function of the groove angle, for roughnesses up to the largest."""
    return resolution.angle_table_resolution(tolerance, roughest, _is_tame(material))


def _is_tame(material: Specular) -> bool:
    index = concrete(material.index)
    return index is not None and bool(np.all(bihemispherical.is_tame(index)))


def _in_fold_plane(directions: Directions | None) -> bool:
    return directions is not None and directions[1].size > 0 and bool(np.all(np.abs(directions[1]) < 1e-15))


def _fully_met(directions: Directions | None, angle: float | None, single: bool) -> bool:
    """Whether directions are known to meet both panels in full, whatever the other circumstances."""
    if directions is None:
        return False
    _, across, normal = directions
    if bool(np.all(np.abs(across) < 1e-15)):
        return True
    return single and angle is not None and bool(np.all(_hidden(angle, across, normal) <= 0))


def _hidden(angle: float, across: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Hidden depth of the panel that faces a direction; negative where both panels are met."""
    facing, behind = np.abs(across) * np.cos(angle / 2), normal * np.sin(angle / 2)
    return (facing - behind) / (facing + behind)


def simplified(material: Material) -> Material:
    """Interfaced panels of index 1, if that is known, are bare ones, unless a layer absorbs along each path."""
    if isinstance(material, TwoPanels):
        first, second = simplified(material.first), simplified(material.second)
        if isinstance(first, Lambertian) and isinstance(second, Lambertian):
            return TwoPanels(first, second, material.alternating)
        return material
    if not isinstance(material, InterfacedLambertian):
        return material
    known = concrete(material.index)
    if known is None or not bool(np.all(known == 1)) or has_slanted_layer(material):
        return material
    return Lambertian(jnp.broadcast_to(subsurface.albedo(material).kappa, material.wavelength_shape))


def has_slanted_layer(material: InterfacedLambertian) -> bool:
    """Whether a layer absorbs along each path at its own slant."""
    return isinstance(material.layer, ColoredLayer) and material.layer.model == "williams-clapper"


def with_safe_index(material: Material) -> Material:
    """A real index stays real only where it is known to be at least 1; below, refraction may be complex."""
    if not isinstance(material, Specular) or jnp.iscomplexobj(material.index):
        return material
    value = concrete(material.index)
    if value is not None and bool(np.all(value >= 1)):
        return material
    index = jax.lax.complex(material.index, jnp.zeros_like(material.index))
    return Specular(index, material.polarization)
