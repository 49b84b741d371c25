"""Differentiable forward models of V-grooved surfaces, in closed form."""

from vcavity_jax import materials as materials
from vcavity_jax.kinks import kink_angles as kink_angles
from vcavity_jax.reflectance import (
    radiance_profile as radiance_profile,
    reflectance_factor as reflectance_factor,
)
from vcavity_jax.scene import (
    BeckmannGrooves as BeckmannGrooves,
    Diffuse as Diffuse,
    Directional as Directional,
    Lambertian as Lambertian,
    Mixed as Mixed,
    Scene as Scene,
    Specular as Specular,
    TwoPanels as TwoPanels,
    VGrooves as VGrooves,
    View as View,
)

__version__ = "0.1.0"
