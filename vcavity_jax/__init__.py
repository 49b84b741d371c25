"""Differentiable forward models of V-grooved surfaces, in closed form."""

from vcavity_jax import colorimetry as colorimetry
from vcavity_jax import dispersion as dispersion
from vcavity_jax import materials as materials
from vcavity_jax.geometries import (
    cie_geometry as cie_geometry,
)
from vcavity_jax.kinks import kink_angles as kink_angles
from vcavity_jax.maps import (
    ReflectanceMap as ReflectanceMap,
)
from vcavity_jax.maps import (
    reflectance_map as reflectance_map,
)
from vcavity_jax.maps import (
    reflection_count as reflection_count,
)
from vcavity_jax.profile import (
    radiance_profile as radiance_profile,
)
from vcavity_jax.reflectance import (
    bihemispherical_table as bihemispherical_table,
)
from vcavity_jax.reflectance import (
    reflectance_factor as reflectance_factor,
)
from vcavity_jax.scene import (
    Annular as Annular,
)
from vcavity_jax.scene import (
    BeckmannGrooves as BeckmannGrooves,
)
from vcavity_jax.scene import (
    ColoredLayer as ColoredLayer,
)
from vcavity_jax.scene import (
    Diffuse as Diffuse,
)
from vcavity_jax.scene import (
    DiffuseWithTrap as DiffuseWithTrap,
)
from vcavity_jax.scene import (
    Directional as Directional,
)
from vcavity_jax.scene import (
    GaussianGrooves as GaussianGrooves,
)
from vcavity_jax.scene import (
    Halftone as Halftone,
)
from vcavity_jax.scene import (
    Hemisphere as Hemisphere,
)
from vcavity_jax.scene import (
    InterfacedLambertian as InterfacedLambertian,
)
from vcavity_jax.scene import (
    Lambertian as Lambertian,
)
from vcavity_jax.scene import (
    Mixed as Mixed,
)
from vcavity_jax.scene import (
    Scene as Scene,
)
from vcavity_jax.scene import (
    Specular as Specular,
)
from vcavity_jax.scene import (
    TwoPanels as TwoPanels,
)
from vcavity_jax.scene import (
    VGrooves as VGrooves,
)
from vcavity_jax.scene import (
    View as View,
)
from vcavity_jax.specular_component import (
    specular_component as specular_component,
)

__version__ = "0.1.0"
