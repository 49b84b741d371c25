"""What lies below the interface of a panel: the one number κ per wavelength in which the material enters.

Of the light that has entered a panel, κ leaves it again into the exchange between the panels, in units of the
diffuse transmittance t₁₂: κ = ρ (1 - r_i) / (1 - r_i ρ) for a bare material, with r_i = 1 - t₁₂ / n² the internal
reflectance of the interface [Saunderson1942]. Layers change κ; only that of Williams and Clapper also absorbs
along each path outside of the material, by its optical depth.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from vcavity_jax import fresnel
from vcavity_jax.scene import ColoredLayer, Halftone, InterfacedLambertian


class Albedo(NamedTuple):
    """κ and 1 - κ, the latter free of cancellation; arrays that broadcast over the wavelengths.

    Args:
        kappa: 0 to 1.
        complement: 1 - κ.
        depth: optical depth -ln t of a layer that every path crosses at its own slant; None for none.
    """

    kappa: Float[Array, "*wavelengths"]
    complement: Float[Array, "*wavelengths"]
    depth: Float[Array, "*wavelengths"] | None


def albedo(material: InterfacedLambertian) -> Albedo:
    """κ of a panel.

    Args:
        material: its index must be real.

    References:
        [Saunderson1942], [WilliamsClapper1953], [Berns1993], [ClapperYule1953].
    """
    rho, index, layer = material.reflectance, material.index, material.layer
    escape = fresnel.diffuse_transmittance(index) / (index * index)  # 1 - r_i
    if isinstance(layer, ColoredLayer) and layer.model == "williams-clapper":
        depth = optical_depth(layer.transmittance)
        lost = 1 - rho * fresnel.internal_reflectance(*jnp.broadcast_arrays(index, depth))
        kappa = rho * escape / lost
        return Albedo(kappa, 1 - kappa, depth)
    if layer is None:
        lost = 1 - (1 - escape) * rho
        return Albedo(rho * escape / lost, (1 - rho) / lost, None)
    if isinstance(layer, ColoredLayer):
        rho = rho * layer.transmittance**2
        lost = 1 - (1 - escape) * rho
        return Albedo(rho * escape / lost, (1 - rho) / lost, None)
    assert isinstance(layer, Halftone)
    a, t = layer.coverage, layer.transmittance
    once = 1 - a * (1 - t)
    spread = a * (1 - a) * (1 - t) ** 2  # of the squared transmittance about that of the mean
    lost = 1 - (1 - escape) * rho * (once * once + spread)
    kappa = rho * once * once * escape / lost
    return Albedo(kappa, (1 - rho * once * once - (1 - escape) * rho * spread) / lost, None)


def optical_depth(transmittance: Float[Array, "..."]) -> Float[Array, "..."]:
    """-ln t; a black layer counts as one of t = 1e-30, with a finite gradient."""
    return -jnp.log(jnp.maximum(transmittance, 1e-30))
