"""Scenes with interfaced panels: which wavelengths share their symbols, and which parts of a light are needed."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from vcavity_jax import (
    extended_light,
    illumination,
    interfaced_radiosity,
    interfaced_roughness,
    specular,
    subsurface,
)
from vcavity_jax.directions import components, within_range
from vcavity_jax.interfaced import Interface, InterfaceResolution
from vcavity_jax.interfaced_radiosity import Directions, Groove
from vcavity_jax.planning import Plan, interfaced_panel
from vcavity_jax.quadrature import clustered_nodes
from vcavity_jax.resolution import NEAREST_TO_ONE
from vcavity_jax.roughness import Slopes
from vcavity_jax.scene import (
    Annular,
    BeckmannGrooves,
    Diffuse,
    DiffuseWithTrap,
    Directional,
    Illumination,
    InterfacedLambertian,
    Mixed,
    Surface,
    TwoPanels,
    VGrooves,
)

Panels = InterfacedLambertian | TwoPanels


class Spectrum(NamedTuple):
    """The optical data of the panels.

    Args:
        n: refractive index, shape () or (W,).
        depth: optical depth of a layer that absorbs along each path, shape () or (W,); None for none.
        kappa: shape (W,), or (2, W) for two panels.
        complement: 1 - κ.
    """

    n: Float[Array, "..."]
    depth: Float[Array, "..."] | None
    kappa: Float[Array, "*panels w"]
    complement: Float[Array, "*panels w"]


def spectrum(material: InterfacedLambertian | TwoPanels, darkest: float) -> Spectrum:
    """The optical data; an index of 1 is raised by what no tolerance can tell, and so is κ = 0 of two panels."""
    if isinstance(material, TwoPanels):
        assert isinstance(material.first, InterfacedLambertian)
        assert isinstance(material.second, InterfacedLambertian)
        first, second = (spectrum(panel, darkest) for panel in (material.first, material.second))
        width = max(first.kappa.size, second.kappa.size)
        kappa = jnp.stack([jnp.broadcast_to(panel.kappa, width) for panel in (first, second)])
        # √κ has no gradient at 0.
        kappa = jnp.where(kappa < 1e-3, kappa + darkest, kappa)
        index = first.n if first.n.ndim else second.n
        return Spectrum(index, first.depth, kappa, 1 - kappa)
    index = material.index
    floor = 1 + max(NEAREST_TO_ONE, 4 * float(jnp.finfo(index.dtype).eps))
    index = index + lax.stop_gradient(jnp.maximum(floor - index, 0))
    # The index itself, not the raised one, decides what lies below: so that n = 1 is the bare material.
    albedo = subsurface.albedo(material)
    shape = material.wavelength_shape
    kappa, complement = (jnp.broadcast_to(part, shape).ravel() for part in (albedo.kappa, albedo.complement))
    depth = None if albedo.depth is None else albedo.depth.reshape(-1) if albedo.depth.ndim else albedo.depth
    return Spectrum(index.reshape(-1) if index.ndim else index, depth, kappa, complement)


def over_wavelengths(
    function: Callable[[Interface, Array, Array], Float[Array, "... w"]],
    data: Spectrum,
    polarized: bool,
    largest: int,
) -> Float[Array, "... w"]:
    """One call where all wavelengths have the same index and layer; else one for each wavelength.

    Args:
        function: of the interface, κ and 1 - κ.
        data: the material.
        polarized: how the interface treats polarization.
        largest: how many wavelengths may be in memory together.
    """
    if data.n.ndim == 0 and (data.depth is None or data.depth.ndim == 0):
        return function(Interface(data.n, data.depth, polarized), data.kappa, data.complement)
    width = data.kappa.shape[-1:]
    index = jnp.broadcast_to(data.n, width)
    depth = None if data.depth is None else jnp.broadcast_to(data.depth, width)

    def one(args: tuple[Array, Array | None, Array, Array]) -> Array:
        index, depth, kappa, complement = args
        return function(Interface(index, depth, polarized), kappa[..., None], complement[..., None])[..., 0]

    kappa, complement = (jnp.moveaxis(part, -1, 0) for part in (data.kappa, data.complement))
    values = lax.map(jax.checkpoint(one), (index, depth, kappa, complement), batch_size=largest)
    return jnp.moveaxis(values, 0, -1)


def reflectance(
    material: Panels, light: Illumination, surface: Surface, views: Directions | None, plan: Plan
) -> Float[Array, "... w"]:
    """Reflectance factor; views: None for the hemisphere of them."""
    data = spectrum(material, plan.darkest)
    value = _one_way(material, data, light, surface, views, plan)
    if isinstance(material, TwoPanels) and material.alternating:
        swapped = data._replace(kappa=data.kappa[::-1], complement=data.complement[::-1])
        value = (value + _one_way(material, swapped, light, surface, views, plan)) / 2
    return value


def _one_way(
    material: Panels, data: Spectrum, light: Illumination, surface: Surface, views: Directions | None, plan: Plan
) -> Float[Array, "... w"]:
    panel = interfaced_panel(material)
    assert panel is not None
    assert plan.interface is not None
    balanced = plan.balanced or views is None or isinstance(light, Diffuse | Annular)
    polarized, included = panel.polarization == "full", panel.specular_included

    def at(
        nodes: InterfaceResolution, angle: Array, light: Illumination, views: Directions | None, data: Spectrum
    ) -> Array:
        def lit(interface: Interface, kappa: Array, complement: Array) -> Array:
            of = interfaced_radiosity.groove(angle, interface, kappa, complement, nodes, balanced)
            return _lit(of, light, views, plan, nodes, included)

        return over_wavelengths(lit, data, polarized, max(1, int(2e6 / (nodes.images**2 * nodes.order * 40))))

    if isinstance(surface, VGrooves):
        return at(plan.interface, within_range(surface.angle), light, views, data)
    slopes: Slopes = "beckmann" if isinstance(surface, BeckmannGrooves) else "gaussian"
    lights, light_tree = jax.tree.flatten(light)
    panels = dict(
        data._asdict(), kappa=[*jnp.atleast_2d(data.kappa)], complement=[*jnp.atleast_2d(data.complement)]
    )
    leaves, tree = jax.tree.flatten(panels)

    def one(view: tuple[Array, Array, Array] | None) -> Float[Array, " w"]:
        seen = () if view is None else view
        sections = [] if view is None else [_section(*view)]
        if isinstance(light, Directional | Mixed):
            source = light.directional if isinstance(light, Mixed) else light
            sections.append(_section(*components(source.polar, source.azimuth)))

        def at_angle(nodes: InterfaceResolution, angle: Array, *arguments: Array) -> Float[Array, " w"]:
            shapes = [leaf.shape for leaf in (*lights, *leaves)]
            own = [a.reshape(shape) for a, shape in zip(arguments[len(seen) :], shapes, strict=True)]
            parts = jax.tree.unflatten(tree, own[len(lights) :])
            for name in ("kappa", "complement"):
                both = parts[name]
                parts[name] = jnp.stack(both) if isinstance(material, TwoPanels) else both[0]
            again = Spectrum(**parts)
            where = None
            if view is not None:
                x, y, z = (a.reshape(1) for a in arguments[:3])
                where = x, y, z
            value = at(nodes, angle, jax.tree.unflatten(light_tree, own[: len(lights)]), where, again)
            return value.reshape(value.shape[-1:])

        arguments = [jnp.atleast_1d(a) for a in (*seen, *lights, *leaves)]
        return interfaced_roughness.average(
            at_angle,
            surface.roughness,
            sections,
            arguments,
            plan.tiers,
            plan.order,
            plan.cutoff,
            plan.most,
            slopes,
        )

    return one(None) if views is None else lax.map(lambda view: one(view), views)


def _section(along: Array, across: Array, normal: Array) -> Array:
    vertical = (across == 0) & (normal == 0)
    return jnp.arctan2(across, jnp.where(vertical, jnp.ones_like(normal), normal))


def _lit(
    of: Groove,
    light: Illumination,
    views: Directions | None,
    plan: Plan,
    nodes: InterfaceResolution,
    included: bool,
) -> Float[Array, "... w"]:
    """Reflectance factor of one groove; included: with the specular component of diffuse light."""
    if views is None:
        return _collected(of, light, plan, nodes, included)
    if isinstance(light, Mixed):
        diffuse, directional = (
            _lit(of, part, views, plan, nodes, included) for part in (Diffuse(), light.directional)
        )
        return light.diffuse_fraction * diffuse + (1 - light.diffuse_fraction) * directional
    if isinstance(light, Diffuse):
        total = interfaced_radiosity.diffuse(of, views, nodes)
        return total if included else total - interfaced_radiosity.mirrored(of, views)
    if isinstance(light, Annular):
        return interfaced_radiosity.extended(of, light, views, nodes, plan.clustering)
    if isinstance(light, DiffuseWithTrap):
        whole = interfaced_radiosity.diffuse(of, views, nodes) - interfaced_radiosity.mirrored(of, views)
        whole -= interfaced_radiosity.extended(of, light, views, nodes, plan.clustering)
        if included:
            trap = specular.Trap(*components(light.polar, light.azimuth), light.half_angle)
            whole += interfaced_radiosity.mirrored(of, views, trap)
        return whole / (1 - illumination.disk_irradiance(light))
    source = components(light.polar, light.azimuth)
    value = interfaced_radiosity.directional(of, source, views, nodes, plan.open)
    if light.solid_angle is None or not included:
        return value
    return value + _glint(of, light, views)


def _collected(
    of: Groove, light: Illumination, plan: Plan, nodes: InterfaceResolution, included: bool
) -> Float[Array, " w"]:
    """All that is reflected."""
    if isinstance(light, Annular):
        # By reciprocity the mean over a ring of views; of two panels each is seen from its own side.
        rule = partial(clustered_nodes, clustering=plan.clustering)
        ring, weight = extended_light.ring(light.polar, extended_light.onsets(of.angle, nodes.hits), rule)
        weight = weight[:, 0]
        along, across, normal = (jnp.concatenate([part[:, 0], part[:, 0]]) for part in ring)
        across = across * jnp.repeat(jnp.asarray([1.0, -1.0], across.dtype), len(weight))
        each = _lit(of, Diffuse(), (along, across, normal), plan, nodes, included)
        return jnp.concatenate([weight, weight]) @ each / 2
    assert isinstance(light, Diffuse)
    assert plan.mirrors is not None
    total = interfaced_radiosity.bihemispherical_reflectance(of, nodes, plan.mirrors)
    return total if included else total - interfaced_radiosity.mirrored_bihemispherical(of, plan.mirrors)


def profile(
    material: Panels,
    light: Illumination,
    angle: Array,
    view: tuple[Array, Array, Array],
    position: Float[Array, " p"],
    plan: Plan,
) -> Float[Array, "2 p w"]:
    """Radiance along a view from positions on both panels; see ``radiance_profile``."""
    panel, nodes = interfaced_panel(material), plan.interface
    assert panel is not None
    assert nodes is not None

    def lit(of: Groove, light: Illumination) -> Float[Array, "2 p w"]:
        if isinstance(light, Mixed):
            diffuse, directional = (lit(of, part) for part in (Diffuse(), light.directional))
            return light.diffuse_fraction * diffuse + (1 - light.diffuse_fraction) * directional
        value = interfaced_radiosity.seen_along(of, view, position, light, nodes, plan.clustering)
        if isinstance(light, Diffuse) and panel.specular_included:
            value += interfaced_radiosity.mirrored_along(of, view, position, nodes)
        if isinstance(light, DiffuseWithTrap):
            whole = interfaced_radiosity.seen_along(of, view, position, Diffuse(), nodes, plan.clustering)
            value = (whole - value) / (1 - illumination.disk_irradiance(light))
        return value

    def at(interface: Interface, kappa: Array, complement: Array) -> Array:
        return lit(interfaced_radiosity.groove(angle, interface, kappa, complement, nodes, False), light)

    data = spectrum(material, plan.darkest)
    value = over_wavelengths(at, data, panel.polarization == "full", 1)
    if isinstance(material, TwoPanels) and material.alternating:
        swapped = data._replace(kappa=data.kappa[::-1], complement=data.complement[::-1])
        value = (value + over_wavelengths(at, swapped, panel.polarization == "full", 1)) / 2
    return value


def _glint(of: Groove, light: Directional, views: Directions) -> Float[Array, "d 1"]:
    """The purely specular component of a small disk of light: π / ω' times the share of the paths that meet it."""
    assert light.solid_angle is not None
    source = specular.disk_of(*components(light.polar, light.azimuth), light.solid_angle)
    along, across, normal = (component[:, None] for component in views)
    model = interfaced_radiosity.model_of(of.interface)
    return specular.glint(of.angle, source, along, across, normal, of.interface.n, model)
