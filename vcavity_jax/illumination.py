"""Rings and disks of light as they fall on a diffusing groove: uniform parts and steps.

A diffusing groove knows of a direction only its angle in the section across the grooves, tan θ' = tan θ cos φ.
What meets both panels lights each uniformly. The rest meets one panel beyond a hidden depth, a step each: a ring
or a disk of light is a weighted sum of such steps, a quadrature in one variable.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from vcavity_jax import wiener_hopf
from vcavity_jax.directions import components, hidden_depth
from vcavity_jax.quadrature import Clustering, clustered_nodes
from vcavity_jax.safe import floor_of
from vcavity_jax.scene import Annular, Diffuse, DiffuseWithTrap, Directional, Mixed

Section = tuple[Float[Array, ""], Float[Array, ""]]
"""A direction in the section across the grooves, (e_y, e_z) up to a factor."""


class Steps(NamedTuple):
    """A light as what it throws on the panels, in shares of its horizontal irradiance.

    Args:
        uniform: share that lights each of the two panels uniformly, shape (2,).
        distance: -ln of the hidden depth of each step, shape (steps,).
        visible: 1 - that depth.
        weight: share of each step on the first and on the second panel, shape (steps, 2).
    """

    uniform: Float[Array, "2"]
    distance: Float[Array, " steps"]
    visible: Float[Array, " steps"]
    weight: Float[Array, "steps 2"]


def shadow_sections(light: Diffuse | Directional | Mixed | Annular | DiffuseWithTrap) -> Float[Array, " onsets"]:
    """|θ'| at which shadows of a light set in or are complete, radians: α/2 = |θ'| is where R has a kink in α."""
    if isinstance(light, Mixed):
        return shadow_sections(light.directional)
    if isinstance(light, Directional):
        _, across, normal = components(light.polar, light.azimuth)
        return jnp.abs(jnp.arctan2(across, normal))[None]
    if isinstance(light, Annular):
        return light.polar[None]
    if isinstance(light, DiffuseWithTrap):
        disk = _disk(light)
        return jnp.abs(disk.section + jnp.arcsin(disk.reach) * jnp.asarray([-1, 1], disk.section.dtype))
    return jnp.zeros(0)


def ring(
    angle: Float[Array, ""], polar: Float[Array, ""], clustering: Clustering | None, split: Section | None = None
) -> Steps:
    """A ring of light. The azimuths ±φ and π ± φ are alike but for the panel, which so get equal shares.

    Args:
        angle: dihedral angle, radians.
        polar: of the ring, radians.
        clustering: of the nodes; None where the ring is known to be free of shadow.
        split: where the response to a step has a kink, as a direction; None for nowhere.
    """
    none = jnp.zeros(0, angle.dtype)
    if clustering is None:
        return Steps(jnp.full(2, 0.5, angle.dtype), none, none, jnp.zeros((0, 2), angle.dtype))
    _, sine, normal = components(polar, jnp.zeros_like(polar))

    def azimuth(section: Section) -> Array:
        across, up = (lax.stop_gradient(part) for part in section)
        # The integrand is continuous, so moving its ends adds nothing to the derivative.
        tangents = jnp.abs(across) * lax.stop_gradient(normal), up * lax.stop_gradient(sine)
        return jnp.arctan2(jnp.sqrt(jnp.maximum(tangents[1] ** 2 - tangents[0] ** 2, 0)), tangents[0])

    onset = azimuth((jnp.sin(angle / 2), jnp.cos(angle / 2)))
    middle = onset if split is None else jnp.minimum(azimuth(split), onset)
    phi, weight = clustered_nodes(jnp.zeros_like(middle), middle, clustering, half=True)
    if split is not None:
        more = clustered_nodes(middle, onset, clustering)
        phi, weight = (jnp.concatenate(pair) for pair in zip((phi, weight), more, strict=True))
    depth, visible = hidden_depth(angle, sine * jnp.cos(phi), jnp.broadcast_to(normal, phi.shape))
    share = jnp.broadcast_to(weight[:, None] / jnp.pi, (len(phi), 2))
    uniform = jnp.broadcast_to(0.5 - onset / jnp.pi, (2,))
    return Steps(uniform, wiener_hopf.log_distance(depth, visible), visible, share)


class _Disk(NamedTuple):
    """A disk of light: section angle, e_x and √(1 - e_x²) of its center, half-angle, largest sin(t - t_c)."""

    section: Float[Array, ""]
    along: Float[Array, ""]
    beside: Float[Array, ""]
    half_angle: Float[Array, ""]
    reach: Float[Array, ""]


def _disk(light: DiffuseWithTrap) -> _Disk:
    along, across, normal = components(light.polar, light.azimuth)
    beside = jnp.sqrt(across * across + normal * normal)
    sine = jnp.sin(light.half_angle)
    return _Disk(jnp.arctan2(across, normal), along, beside, light.half_angle, sine / beside)


def disk_irradiance(light: DiffuseWithTrap) -> Float[Array, ""]:
    """Share of the horizontal irradiance of a uniform hemisphere that the disk of the trap would give."""
    _, _, normal = components(light.polar, light.azimuth)
    return jnp.sin(light.half_angle) ** 2 * normal


def disk(
    angle: Float[Array, ""],
    light: DiffuseWithTrap,
    clustering: Clustering | None,
    split: Section | None = None,
) -> Steps:
    """The light that a trap takes away, in shares of the whole hemisphere's irradiance.

    With e = (sin η, cos η sin t, cos η cos t) the irradiance cos θ dΩ is cos²η cos t dη dt; the groove knows
    t = θ' alone, and the integral over η is closed.

    Args:
        angle: dihedral angle, radians.
        light: center and half-angle of the disk.
        clustering: of the nodes; None where the disk is known to be free of shadow.
        split: where the response to a step has a kink, as a direction; None for nowhere.
    """
    center = _disk(light)
    _, across, normal = components(light.polar, light.azimuth)
    cotangent = jnp.cos(angle / 2) / jnp.sin(angle / 2)
    sign = jnp.asarray([1, -1], angle.dtype)
    # As if all of it met both panels, in shares that are linear in tan t.
    squared_sine = jnp.sin(center.half_angle) ** 2
    uniform = squared_sine * (normal + sign * across * cotangent) / 2
    none = jnp.zeros(0, angle.dtype)
    if clustering is None:
        return Steps(uniform, none, none, jnp.zeros((0, 2), angle.dtype))

    def node_of(t: Array) -> Array:
        """ψ of a section angle, sin(t - t_c) = reach sin ψ, clipped to the disk."""
        gap = jnp.clip(t - center.section, -jnp.pi / 2, jnp.pi / 2)
        reach = jnp.maximum(center.reach, floor_of(center.reach))
        return lax.stop_gradient(jnp.arcsin(jnp.clip(jnp.sin(gap) / reach, -1, 1)))

    onset = angle / 2
    kink = onset if split is None else jnp.maximum(jnp.arctan2(jnp.abs(split[0]), split[1]), onset)
    right = jnp.full_like(onset, jnp.pi / 2)
    ends = [(node_of(onset), node_of(kink)), (node_of(kink), right)][0 if split is not None else 1 :]
    ends += [(node_of(-kink), node_of(-onset)), (-right, node_of(-kink))][0 if split is not None else 1 :]
    starts, stops = (jnp.stack(side) for side in zip(*ends, strict=True))
    psi, weight = clustered_nodes(starts, stops, clustering)
    psi, weight = psi.ravel(), weight.ravel()
    sine, cosine = center.reach * jnp.sin(psi), jnp.cos(psi)
    aside = jnp.sqrt(1 - sine * sine)
    t = center.section + jnp.arcsin(sine)
    w = jnp.arctan2(jnp.sin(center.half_angle) * cosine, jnp.cos(center.half_angle))
    squared_along, squared_beside = center.along**2, (center.beside * aside) ** 2
    doubled = (squared_beside - squared_along) / (squared_beside + squared_along)
    density = weight * center.reach * cosine / aside * (w + doubled * jnp.sin(2 * w) / 2) / jnp.pi
    across_share, normal_share = density * jnp.sin(t), density * jnp.cos(t)
    linear = (normal_share[:, None] + sign * (across_share * cotangent)[:, None]) / 2
    first = (t > 0).astype(t.dtype)
    share = normal_share[:, None] * jnp.stack([first, 1 - first], axis=-1)
    depth, visible = hidden_depth(angle, jnp.sin(t), jnp.cos(t))
    distance = wiener_hopf.log_distance(depth, visible)
    return Steps(uniform - jnp.sum(linear, axis=0), distance, visible, share)
