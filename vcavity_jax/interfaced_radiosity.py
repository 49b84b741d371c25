"""How light, view and an interfaced groove are put together: reflectance factors and local radiances.

A light or a view is a sum of bands on the two panels (``interfaced.bands``); diffuse light is uniform but for the
shade of the groove. docs/interfaced.md derives the formulas.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from vcavity_jax import bihemispherical, extended_light, fresnel, interfaced, resolvent, specular, wiener_hopf
from vcavity_jax.bands import Bands, Footprint, footprint
from vcavity_jax.directions import components
from vcavity_jax.interfaced import Exchange, Interface, InterfaceResolution
from vcavity_jax.quadrature import Clustering
from vcavity_jax.resolution import BihemisphericalResolution
from vcavity_jax.resolvent import Resolvent
from vcavity_jax.scene import Annular, Diffuse, DiffuseWithTrap, Directional, Polarization

Directions = tuple[Float[Array, " d"], Float[Array, " d"], Float[Array, " d"]]


NEAREST_TO_FOLD = 1e-8
"""Distance from the fold that stands for smaller ones, where the sums lose their digits."""


class Groove(NamedTuple):
    """A groove, ready for any light and view; all of one symbol.

    Args:
        angle: dihedral angle, radians.
        interface: of the panels.
        kappa: the material below, see ``subsurface``; shape (W,) for alike panels, (2, W) for two.
        complement: 1 - κ.
        exchange: symbols of the panels' exchange.
        resolvent: (1 - κK)⁻¹.
        scale: κ of alike panels, shape (W,); 1 for two, whose κ is in the resolvent.
    """

    angle: Float[Array, ""]
    interface: Interface
    kappa: Float[Array, "*panels w"]
    complement: Float[Array, "*panels w"]
    exchange: Exchange
    resolvent: Resolvent
    scale: Float[Array, " w"]

    @property
    def through(self) -> Float[Array, ""]:
        """t₁₂ of the clear interface."""
        return fresnel.diffuse_transmittance(self.interface.n)

    @property
    def alike(self) -> bool:
        """Whether both panels are of the same material."""
        return self.kappa.ndim == 1


def groove(
    angle: Float[Array, ""],
    interface: Interface,
    kappa: Float[Array, "*panels w"],
    complement: Float[Array, "*panels w"],
    resolution: InterfaceResolution,
    balanced: bool,
) -> Groove:
    """Factor the exchange of a groove; balanced: light or view is known to meet both panels alike."""
    exchange = interfaced.exchange(angle, interface, resolution)
    if kappa.ndim == 1:
        factors = resolvent.of_alike_panels(exchange, kappa, angle, resolution.contour, balanced)
        return Groove(angle, interface, kappa, complement, exchange, factors, kappa)
    factors = resolvent.of_unlike_panels(exchange, kappa, angle, resolution.contour)
    return Groove(angle, interface, kappa, complement, exchange, factors, jnp.ones_like(kappa[0]))


def met_by(of: Groove, direction: tuple[Array, Array, Array], resolution: InterfaceResolution) -> Footprint:
    """What a direction lights or sees."""
    return footprint(interfaced.bands(of.angle, *direction, of.interface, resolution.hits), resolution.contour)


def model_of(interface: Interface) -> Polarization:
    """How a mirror follows the polarization as this interface does."""
    return "full" if interface.polarized else "unpolarized"


def diffuse(of: Groove, views: Directions, resolution: InterfaceResolution) -> Float[Array, "d w"]:
    """Diffuse light, with the specular component."""
    mirrors = None if _furnace(of) else mirrored(of, views)
    lit = jax.vmap(lambda x, y, z: diffusely_lit(of, met_by(of, (x, y, z), resolution), resolution))(*views)
    return lit if mirrors is None else mirrors + lit


def _furnace(of: Groove) -> bool:
    """Whether everything follows from what a white material under the interface does: all that is lit is white."""
    return of.alike and of.interface.depth is None


def diffusely_lit(of: Groove, seen: Footprint, resolution: InterfaceResolution) -> Float[Array, " w"]:
    """Diffuse light without the specular component, ⟨V, m⟩; with it where all follows from the white furnace.

    Alike panels without an absorbing layer: 1 - (1 - κ) ⟨V, (1 - κK)⁻¹ 1⟩, specular component included. Else
    ⟨V, κ (1 - κK)⁻¹ e⟩ with the irradiance e = t₁₂(τ) / t₁₂ - K' 1, K' being the exchange from a clear interface.
    """
    both = resolvent.by_parity(of.resolvent, jnp.ones(2, of.kappa.dtype))
    mean = resolvent.mean_over(of.resolvent, seen, both, resolution.contour)
    if _furnace(of):
        return 1 - of.complement * mean
    phi, _ = resolvent.shaded(of.resolvent, _entering(of), both, resolution.contour)
    transforms = resolvent.by_parity(of.resolvent, seen.transform)
    return of.scale * (_unshaded(of) * mean - resolvent.with_shaded(transforms, phi))


def _entering(of: Groove) -> tuple[Array, Array]:
    if of.exchange.entering is not None:
        return of.exchange.entering
    symbol = of.exchange.cross + of.exchange.same
    return symbol, symbol


def _unshaded(of: Groove) -> Float[Array, ""]:
    """t₁₂(τ) / t₁₂: what of diffuse light passes the layer of a flat surface."""
    if of.interface.depth is None:
        return jnp.ones_like(of.angle)
    return fresnel.absorbing_transmittance(of.interface.n, of.interface.depth) / of.through


def mirrored(of: Groove, views: Directions, trap: specular.Trap | None = None) -> Float[Array, "d 1"]:
    """The purely specular component in diffuse light; trap: a part of the hemisphere from which none comes."""
    along, across, normal = (component[:, None] for component in views)
    model = model_of(of.interface)
    return specular.hemispherical_directional(of.angle, along, across, normal, of.interface.n, model, trap=trap)


def directional(
    of: Groove, light: tuple[Array, Array, Array], views: Directions, resolution: InterfaceResolution, whole: bool
) -> Float[Array, "d w"]:
    """Parallel light, without the specular component; whole: nothing is known to be hidden from light or view."""
    source = met_by(of, light, resolution)
    field = resolvent.edge_field(of.resolvent, source)

    def one(x: Array, y: Array, z: Array) -> Float[Array, " w"]:
        seen = met_by(of, (x, y, z), resolution)
        return resolvent.between(of.resolvent, seen, source, field, resolution.contour, whole)

    return lit_scale(of) * jax.vmap(one)(*views)


def extended(
    of: Groove,
    light: Annular | DiffuseWithTrap,
    views: Directions,
    resolution: InterfaceResolution,
    clustering: Clustering,
) -> Float[Array, "d w"]:
    """A ring or a disk of light, without the specular component, in shares of its hemisphere's irradiance."""
    source = extended_light.lit_smoothly(of.angle, light, of.interface, resolution, clustering)
    field = resolvent.edge_field(of.resolvent, source)

    def one(view: tuple[Array, Array, Array]) -> Float[Array, " w"]:
        seen = met_by(of, view, resolution)
        return _extended_on(of, light, seen, source, field, resolution)

    return lit_scale(of) * lax.map(one, views)


def _extended_on(
    of: Groove,
    light: Annular | DiffuseWithTrap,
    seen: Footprint,
    source: Footprint,
    field: resolvent.Vector,
    resolution: InterfaceResolution,
) -> Float[Array, " w"]:
    direct = extended_light.lit_directly(of.angle, light, of.interface, seen.bands, resolution.hits)
    return resolvent.between(of.resolvent, seen, source, field, resolution.contour, False, direct)


def seen_along(
    of: Groove,
    view: tuple[Array, Array, Array],
    position: Float[Array, " p"],
    light: Diffuse | Directional | Annular | DiffuseWithTrap,
    resolution: InterfaceResolution,
    clustering: Clustering,
) -> Float[Array, "2 p w"]:
    """Radiance along a view from positions on both panels, without the specular component.

    Each ray is followed to the points below the interface where it began: Σ ∏ R T m(y sin β₁ / sin β_j).
    """
    paths = interfaced.followed(of.angle, *view, of.interface, resolution.hits)
    place = position[:, None, None] * paths.ratio  # shape (P, hits, sides)
    inside = (place <= 1) & paths.alive
    distance = -jnp.log(jnp.clip(jnp.where(inside, place, jnp.ones_like(place)), NEAREST_TO_FOLD, 1))
    source, field = None, None
    if not isinstance(light, Diffuse):
        if isinstance(light, Directional):
            source = met_by(of, components(light.polar, light.azimuth), resolution)
        else:
            source = extended_light.lit_smoothly(of.angle, light, of.interface, resolution, clustering)
        field = resolvent.edge_field(of.resolvent, source)

    def at(args: tuple[Array, Array]) -> Float[Array, " w"]:
        distance, sign = args
        none = jnp.zeros(1, distance.dtype)
        point = footprint(Bands(distance[None], none, none, none + 1, sign[None]), resolution.contour)
        if source is None or field is None:
            return diffusely_lit(of, point, resolution)
        if isinstance(light, Annular | DiffuseWithTrap):
            return lit_scale(of) * _extended_on(of, light, point, source, field, resolution)
        return lit_scale(of) * resolvent.between(of.resolvent, point, source, field, resolution.contour, False)

    shape = distance.shape
    signs = jnp.broadcast_to(paths.sign, shape)
    local = lax.map(at, (distance.ravel(), signs.ravel()), batch_size=8).reshape(*shape, -1)
    weight = jnp.where(inside, paths.entered, jnp.zeros_like(place))
    return jnp.moveaxis(jnp.sum(weight[..., None] * local, axis=1), 1, 0)


def mirrored_along(
    of: Groove, view: tuple[Array, Array, Array], position: Float[Array, " p"], resolution: InterfaceResolution
) -> Float[Array, "2 p 1"]:
    """The purely specular component in diffuse light along a view, from positions on both panels."""
    paths = interfaced.followed(of.angle, *view, of.interface, resolution.hits)
    inside = (position[:, None, None] * paths.ratio <= 1) & paths.alive
    last = inside & ~jnp.concatenate([inside[:, 1:], jnp.zeros_like(inside[:, :1])], axis=1)
    return jnp.sum(jnp.where(last, paths.passed, jnp.zeros_like(paths.passed)), axis=1).T[..., None]


def lit_scale(of: Groove) -> Float[Array, " w"]:
    """From ⟨V, (1 - κK)⁻¹ E⟩ of a light of unit mass to the reflectance factor."""
    return of.scale * 2 * jnp.sin(of.angle / 2) / of.through


def bihemispherical_reflectance(
    of: Groove, resolution: InterfaceResolution, mirrors: BihemisphericalResolution
) -> Float[Array, " w"]:
    """Reflected over incident flux in diffuse light, with the specular component.

    With s = sin(α/2), 1 - (1 - κ) t₁₂ / s [1 - (1 - κ) (G - 1) / κ]; else S + t₁₂ / 2s ⟨e, κ (1 - κK)⁻¹ e⟩.
    """
    opening = of.through / jnp.sin(of.angle / 2)
    if _furnace(of):
        symbol = _entering(of)[0]
        exchanged = wiener_hopf.mean_exchange(symbol, of.kappa, resolution.contour)
        return 1 - of.complement * opening * (1 - of.complement * exchanged)
    one = jnp.ones(2, of.kappa.dtype)
    both = resolvent.by_parity(of.resolvent, one)
    phi, root = resolvent.shaded(of.resolvent, _entering(of), both, resolution.contour)
    nodes = len(wiener_hopf.contour(resolution.contour).tau)
    whole = jnp.ones((2, nodes), of.exchange.cross.dtype)
    everything = Footprint(interfaced.no_bands(of.angle), whole, one)
    uniform = resolvent.mean_over(of.resolvent, everything, both, resolution.contour)
    shade = resolvent.with_shaded(resolvent.by_parity(of.resolvent, whole), phi)
    square = resolvent.square_of_shaded(root, resolution.contour)
    unshaded = _unshaded(of)
    lit = unshaded * (unshaded * uniform - 2 * shade) + square
    return mirrored_bihemispherical(of, mirrors) + of.scale * opening / 2 * lit


def mirrored_bihemispherical(of: Groove, resolution: BihemisphericalResolution) -> Float[Array, " 1"]:
    """The purely specular component of all reflected flux in diffuse light."""
    return bihemispherical.specular(of.angle, of.interface.n[None], model_of(of.interface), resolution)
