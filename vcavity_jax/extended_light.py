"""Rings and disks of light on interfaced panels: quadratures over their directions.

What a direction lights changes abruptly at known angles θ' in the section across the grooves, where a hit appears
or begins to be cut off by the rim or by a shadow. There the nodes part. The direct light on a view's bands, an
elementary sum, has further kinks, where an end of a lit band passes an end of a seen one.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from vcavity_jax import interfaced
from vcavity_jax.bands import Bands, Footprint, footprint, overlap
from vcavity_jax.directions import components
from vcavity_jax.interfaced import Interface, InterfaceResolution
from vcavity_jax.quadrature import Clustering, clustered_nodes, legendre_nodes
from vcavity_jax.scene import Annular, DiffuseWithTrap

Nodes = tuple[tuple[Array, Array, Array], Array]
"""Components of directions, each of shape (nodes, tilts), and their shares of the horizontal irradiance."""

_DIRECT_ORDER = 10
_TILTS = 10


def onsets(angle: Float[Array, ""], hits: int) -> Float[Array, " onsets"]:
    """θ' > 0 at which what a direction lights changes abruptly: α/2, (π - jα)/2 and π - (j - 1/2)α."""
    j = jnp.arange(1, hits + 1, dtype=angle.dtype)
    return jnp.concatenate([angle[None] / 2, jnp.abs(jnp.pi - j * angle) / 2, jnp.abs(jnp.pi - (j - 0.5) * angle)])


def crossings(angle: Float[Array, ""], seen: Bands, hits: int) -> Float[Array, " crossings"]:
    """|θ'| at which an end of a lit band passes an end of a seen one."""
    ends = jnp.exp(-jnp.concatenate([seen.outer, seen.outer + seen.length]))[:, None]
    turn = angle * jnp.arange(1, hits + 1, dtype=angle.dtype)
    beta = jnp.arctan2(ends * jnp.sin(turn), 1 - ends * jnp.cos(turn))
    return jnp.abs(jnp.concatenate([(beta - angle / 2).ravel(), (beta + angle / 2).ravel()]))


def ring(
    polar: Float[Array, ""], marks: Float[Array, " marks"], rule: Callable[..., tuple[Array, Array]]
) -> Nodes:
    """A quarter of a ring; by symmetry its light falls on both panels alike.

    Args:
        polar: of the ring, radians.
        marks: θ' > 0 at which the nodes part.
        rule: from starts and ends of intervals to nodes and weights.
    """
    tangent = jnp.tan(jnp.clip(marks, 0, 1.57)) * jnp.cos(polar)
    sine = jnp.sin(polar)
    cosine = jnp.clip(tangent / jnp.maximum(sine, 1e-30), 0, 1)
    ends = jnp.sort(lax.stop_gradient(jnp.arccos(jnp.minimum(cosine, 1 - 1e-15))))
    ends = jnp.concatenate([jnp.zeros(1, ends.dtype), ends, jnp.full(1, jnp.pi / 2, ends.dtype)])
    phi, weight = (part.ravel() for part in rule(ends[:-1], ends[1:]))
    phi = phi[:, None]
    return components(jnp.broadcast_to(polar, phi.shape), phi), weight[:, None] / (jnp.pi / 2)


def disk(light: DiffuseWithTrap, marks: Float[Array, " marks"], rule: Callable[..., tuple[Array, Array]]) -> Nodes:
    """A disk of the hemisphere, in shares of the irradiance of the whole hemisphere.

    In e = (sin η, cos η sin t, cos η cos t) the irradiance is cos²η cos t dη dt; t = t_c + arcsin(reach sin χ).
    """
    along, across, normal = components(light.polar, light.azimuth)
    beside = jnp.sqrt(across * across + normal * normal)
    center, reach = jnp.arctan2(across, normal), jnp.sin(light.half_angle) / beside
    gaps = jnp.clip(jnp.concatenate([marks, -marks]) - center, -jnp.pi / 2, jnp.pi / 2)
    inside = jnp.clip(jnp.sin(gaps) / jnp.maximum(reach, 1e-30), -1, 1)
    ends = jnp.sort(lax.stop_gradient(jnp.arcsin(jnp.clip(inside, -1 + 1e-15, 1 - 1e-15))))
    half = jnp.full(1, jnp.pi / 2, ends.dtype)
    ends = jnp.concatenate([-half, ends, half])
    chi, weight = (part.ravel() for part in rule(ends[:-1], ends[1:]))
    sine = reach * jnp.sin(chi)
    aside = jnp.sqrt(1 - sine * sine)
    t = center + jnp.arcsin(sine)
    tilt = jnp.arctan2(along, beside * aside)
    spread = jnp.arctan2(jnp.sin(light.half_angle) * jnp.cos(chi), jnp.cos(light.half_angle))
    eta, eta_weight = legendre_nodes(tilt - spread, tilt + spread, _TILTS)
    measure = (weight * reach * jnp.cos(chi) / aside * jnp.cos(t) / jnp.pi)[:, None] * eta_weight
    cosine = jnp.cos(eta)
    directions = jnp.sin(eta), cosine * jnp.sin(t)[:, None], cosine * jnp.cos(t)[:, None]
    return directions, measure * cosine * cosine


def lit_by(angle: Float[Array, ""], nodes: Nodes, interface: Interface, hits: int, symmetric: bool) -> Bands:
    """The bands of all nodes; symmetric: as many light the other panel.

    Where a band lies follows from θ' alone: of all tilts with the same θ' only the masses add up.
    """
    directions, share = nodes
    of = jax.vmap(jax.vmap(lambda x, y, z: interfaced.bands(angle, x, y, z, interface, hits)))
    each = of(*directions)
    mass = jnp.sum(each.mass * share[..., None], axis=1)
    flat = Bands(*(part[:, 0].ravel() for part in each))._replace(mass=mass.ravel())
    return flat._replace(sign=jnp.zeros_like(flat.sign)) if symmetric else flat


def quadrature_of(light: Annular | DiffuseWithTrap) -> Callable[..., Nodes]:
    """The quadrature over a light's directions, of marks and a rule."""
    if isinstance(light, Annular):
        return lambda marks, rule: ring(light.polar, marks, rule)
    return lambda marks, rule: disk(light, marks, rule)


def lit_smoothly(
    angle: Float[Array, ""],
    light: Annular | DiffuseWithTrap,
    interface: Interface,
    resolution: InterfaceResolution,
    clustering: Clustering,
) -> Footprint:
    """The light as a sum of bands, for all but its overlap with what is seen."""
    nodes = quadrature_of(light)(onsets(angle, resolution.hits), lambda a, b: clustered_nodes(a, b, clustering))
    bands = lit_by(angle, nodes, interface, resolution.hits, isinstance(light, Annular))
    return footprint(bands, resolution.contour)


def lit_directly(
    angle: Float[Array, ""], light: Annular | DiffuseWithTrap, interface: Interface, seen: Bands, hits: int
) -> Float[Array, "2"]:
    """Overlap of the light with what is seen, by panel."""
    marks = jnp.concatenate([onsets(angle, hits), crossings(angle, seen, hits)])
    nodes = quadrature_of(light)(marks, lambda a, b: legendre_nodes(a, b, _DIRECT_ORDER))
    return overlap(seen, lit_by(angle, nodes, interface, hits, isinstance(light, Annular)))
