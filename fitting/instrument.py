"""What the bench adds to the true spectrum: gain, offset, tilt of the sample, stray light, a wavelength shift.

recorded(λ) = (1 - s) (gain × R(λ + shift) + offset) + s × mean of the recorded spectrum
"""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import vcavity_jax as vc
from vcavity_jax.directions import components

_NUDGE = 1e-9
"""A direction this near to the normal is moved off it: polar angle and azimuth have no derivative there."""

_STENCIL = 5


def tilted(scene: Any, across: Float[Array, ""], along: Float[Array, ""]) -> tuple[Any, Array]:
    """A scene as seen by a sample that is tilted, and the factor on its reflectance factor.

    The reference white was not tilted: where light comes from a direction, the irradiance of the sample changes
    by cos θ'/cos θ.

    Args:
        scene: its light is ``Diffuse`` or ``Directional``, its view has directions.
        across: adds to the polar angle of a direction at azimuth 0, radians.
        along: adds to that of a direction at azimuth π/2, radians.
    """
    polar, azimuth = jnp.broadcast_arrays(scene.view.polar, scene.view.azimuth)
    view = vc.View(*_turned(polar, azimuth, across, along)[:2])
    light, factor = scene.illumination, jnp.ones_like(across)
    if isinstance(light, vc.Directional):
        new_polar, new_azimuth, normal = _turned(light.polar, light.azimuth, across, along)
        factor = normal / jnp.cos(light.polar)
        light = vc.Directional(new_polar, new_azimuth, light.solid_angle)
    return vc.Scene(scene.surface, scene.material, light, view), factor


def _turned(polar: Array, azimuth: Array, across: Array, along: Array) -> tuple[Array, Array, Array]:
    """Polar angle, azimuth and normal component of directions in the frame of the tilted sample."""
    x, y, z = components(polar, azimuth)
    y, z = y * jnp.cos(across) + z * jnp.sin(across), z * jnp.cos(across) - y * jnp.sin(across)
    x, z = x * jnp.cos(along) + z * jnp.sin(along), z * jnp.cos(along) - x * jnp.sin(along)
    frontal = x * x + y * y < _NUDGE**2
    nudge = jnp.where(frontal, jnp.full_like(x, _NUDGE), jnp.zeros_like(x))
    x, y = x + nudge, y + nudge
    return jnp.arctan2(jnp.sqrt(x * x + y * y), z), jnp.arctan2(x, y), z


def can_tilt(scene: Any) -> bool:
    """Whether the model of a tilt covers a scene."""
    return isinstance(scene.view, vc.View) and isinstance(scene.illumination, vc.Diffuse | vc.Directional)


def within_shift(wavelengths_nm: Float[np.ndarray, " w"], least_nm: float, most_nm: float) -> np.ndarray:
    """Which wavelengths stay within the measured range whatever the shift between two limits."""
    low, high = wavelengths_nm[0] - least_nm, wavelengths_nm[-1] - most_nm
    return np.asarray((wavelengths_nm >= low) & (wavelengths_nm <= high))


def shifted(
    factor: Float[Array, "d w"], wavelengths_nm: Float[np.ndarray, " w"], shift_nm: Float[Array, ""]
) -> Float[Array, "d w"]:
    """Spectra at λ + shift: cubic Hermite interpolation with slopes of fourth order, smooth in the shift."""
    places, weights = _slope_stencil(wavelengths_nm)
    dtype = factor.dtype
    slopes = jnp.sum(jnp.asarray(weights, dtype) * factor[:, places], axis=-1)
    grid = jnp.asarray(wavelengths_nm, dtype)
    wanted = grid + shift_nm
    left = jnp.clip(jnp.searchsorted(grid, wanted, side="right") - 1, 0, len(wavelengths_nm) - 2)
    step = grid[left + 1] - grid[left]
    t = (wanted - grid[left]) / step
    a, b, da, db = factor[:, left], factor[:, left + 1], slopes[:, left] * step, slopes[:, left + 1] * step
    return a + t * (da + t * (3 * (b - a) - 2 * da - db + t * (2 * (a - b) + da + db)))


def _slope_stencil(wavelengths_nm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """At each wavelength the neighbors and weights of the derivative of the polynomial through them."""
    count = min(_STENCIL, len(wavelengths_nm))
    first = np.clip(np.arange(len(wavelengths_nm)) - count // 2, 0, len(wavelengths_nm) - count)
    places = first[:, None] + np.arange(count)
    scale = np.ptp(wavelengths_nm[places], axis=1)[:, None]
    away = (wavelengths_nm[places] - wavelengths_nm[:, None]) / scale
    powers = away[:, None, :] ** np.arange(count)[None, :, None]
    wanted = np.zeros((len(wavelengths_nm), count, 1))
    wanted[:, 1] = 1
    return places, np.linalg.solve(powers, wanted)[..., 0] / scale


def observed(
    factor: Float[Array, "d w"],
    values: Mapping[str, Array],
    wavelengths_nm: Float[np.ndarray, " w"],
    mean: Float[Array, " d"],
) -> Float[Array, "d w"]:
    """What the instrument records of a true reflectance factor.

    Args:
        factor: the true one.
        values: gain, offset, stray light and wavelength shift, those that are free.
        wavelengths_nm: nm.
        mean: of the recorded spectrum in each direction.
    """
    if "wavelength_shift" in values:
        factor = shifted(factor, wavelengths_nm, values["wavelength_shift"])
    if "gain" in values:
        factor = values["gain"] * factor
    if "offset" in values:
        factor = factor + values["offset"]
    if "stray_light" in values:
        share = values["stray_light"]
        factor = (1 - share) * factor + share * mean[:, None]
    return factor
