"""One smooth interface: amplitudes of reflection, without cancellation anywhere.

Conventions: complex index n + ik, k ≥ 0, time factor exp(-iωt), Im cos θ_t ≥ 0, and r_p = +r_s at normal
incidence, the sign that an unfolded chain of reflections needs.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float, Inexact

from vcavity_jax.safe import floor_of


def permittivity_contrast(index: Inexact[Array, "..."]) -> Inexact[Array, "..."]:
    """(n + ik)² - 1 as (n + ik - 1)(n + ik + 1), exact as the index tends to 1."""
    return (index - 1) * (index + 1)


def amplitudes(
    cosine: Float[Array, "..."], contrast: Inexact[Array, "..."]
) -> tuple[Inexact[Array, "..."], Inexact[Array, "..."]]:
    """Amplitude r_s, and κ such that r_p = r_s + κ sin²θ.

    With g = √(contrast + cos²θ):  r_s = -contrast / (cos θ + g)²  and
    κ = 2 contrast / ((g + (1 + contrast) cos θ)(cos θ + g)) [SaintPierre2020, eq. 2.22 and 2.23, rearranged:
    nothing cancels for n → 1, and there is no 0/0 at grazing or normal incidence].

    Args:
        cosine: cos of the angle of incidence, 0 to 1.
        contrast: (n + ik)² - 1; real for a dielectric with n ≥ 1 (then everything is real), else complex.
    """
    cosine = jnp.maximum(cosine, floor_of(cosine)).astype(contrast.dtype)
    g = jnp.sqrt(contrast + cosine * cosine)
    total = 1 / (cosine + g)
    r_s = -contrast * total * total
    return r_s, 2 * contrast * total / (g + (1 + contrast) * cosine)


def power(amplitude: Inexact[Array, "..."]) -> Float[Array, "..."]:
    """|amplitude|², with a gradient at zero."""
    return amplitude.real**2 + amplitude.imag**2
