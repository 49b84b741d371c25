"""What a user composes: a surface, a material, an illumination and a view.

Every part is a pytree whose physical parameters are traced leaves; tables are computed from them inside the
evaluation, never stored. Angles are radians. The conventions are those of docs/conventions.md: the fold lies
along x, the grooves repeat along y, z is the mean normal, and a direction (polar θ, azimuth φ) is
e = (sin θ sin φ, sin θ cos φ, cos θ), so that φ = 0 looks across the grooves.
"""

from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Inexact

Polarization = Literal["full", "unpolarized", "separate"]
POLARIZATIONS: tuple[Polarization, ...] = ("full", "unpolarized", "separate")


def _real(value: ArrayLike) -> Array:
    """Turn a number into an array of JAX's float type: a bare Python float would recompile for each value.

    Known numbers stay known inside a traced function, so that the work can be planned for them.
    """
    if not _is_plain(value):
        return jnp.asarray(value)
    with jax.ensure_compile_time_eval():
        return jnp.asarray(value, dtype=jnp.result_type(float))


def _index(value: ArrayLike) -> Array:
    """The same for a refractive index: a real one stays real (a dielectric), a complex one complex."""
    if not _is_plain(value):
        return jnp.asarray(value)
    with jax.ensure_compile_time_eval():
        return jnp.asarray(value, dtype=jnp.result_type(complex if np.iscomplexobj(value) else float))


def _is_plain(value: Any) -> bool:
    return not isinstance(value, jax.Array) or not jnp.issubdtype(value.dtype, jnp.inexact)


def concrete(value: Any) -> np.ndarray | None:
    """The value as a NumPy array, or None while JAX traces it (then it cannot be checked)."""
    return None if isinstance(value, jax.core.Tracer) or not eqx.is_array_like(value) else np.asarray(value)


def refuse(what: str, value: Any, bad: Any, expected: str, hint: str = "") -> None:
    """Raise one clear line if any concrete entry of a parameter is bad."""
    bad = np.asarray(bad)
    if bad.any():
        worst = np.asarray(value)[bad].ravel()[0]
        raise ValueError(f"{worst} is not {what}: expected {expected}{hint}")


def _check_direction(polar: Any, azimuth: Any) -> None:
    for name, angle in (("polar angle", polar), ("azimuth", azimuth)):
        value = concrete(angle)
        if value is not None:
            limit = np.pi / 2 if name == "polar angle" else 2 * np.pi
            refuse(
                f"{'a' if name[0] == 'p' else 'an'} {name} in radians",
                value,
                ~(np.abs(value) <= limit * (1 + 1e-6)),
                "-π/2 to π/2" if name == "polar angle" else "-2π to 2π",
                ". Did you pass degrees?",
            )


class VGrooves(eqx.Module):
    """Parallel V-shaped grooves of one dihedral angle.

    Args:
        angle: full angle between the panels of a groove, radians, 0 < angle ≤ π; π is the flat surface.

    Raises:
        ValueError: the angle is known and outside its range.
    """

    angle: Float[Array, ""] = eqx.field(converter=_real)

    def __check_init__(self) -> None:
        value = concrete(self.angle)
        if value is not None:
            refuse(
                "a dihedral angle in radians",
                value,
                ~((value > 0) & (value <= np.pi * (1 + 1e-6))),
                "0 < angle ≤ π",
                ". Did you pass degrees?",
            )


def _check_roughness(roughness: Any) -> None:
    value = concrete(roughness)
    if value is not None:
        flat = ". A flat surface is VGrooves(π)" if np.any(value == 0) else ""
        refuse("a roughness", value, ~((value > 0) & np.isfinite(value)), "m > 0", flat)


class BeckmannGrooves(eqx.Module):
    """V-grooves whose dihedral angle α is random, with Beckmann-distributed facet slopes.

    With α = π - 2 θ_h and t = tan θ_h, the density of t is (t/m²) exp(-t²/2m²) [SaintPierre2020, eq. 4.43 to
    4.45]: the slopes of an isotropic surface, rms √2 m. Renderers use α_b = √2 m. Flat facets are rare.

    Args:
        roughness: m, without unit, m > 0; it tends to the flat surface for m → 0. Models reach up to 10.

    Raises:
        ValueError: the roughness is known and not positive or not finite.
    """

    roughness: Float[Array, ""] = eqx.field(converter=_real)

    def __check_init__(self) -> None:
        _check_roughness(self.roughness)


class GaussianGrooves(eqx.Module):
    """V-grooves whose dihedral angle α is random, with the slopes of a Gaussian profile in one dimension.

    With α = π - 2 θ_h and t = tan θ_h ≥ 0, the density of t is √(2/π)/m exp(-t²/2m²): what a surface that is
    rough across the grooves and straight along them has, with the rms slope m. Flat facets are the most
    frequent ones. See docs/conventions.md on when to choose which.

    Args:
        roughness: m, the rms slope, without unit, m > 0; it tends to the flat surface for m → 0. Models reach
            up to 10.

    Raises:
        ValueError: the roughness is known and not positive or not finite.
    """

    roughness: Float[Array, ""] = eqx.field(converter=_real)

    def __check_init__(self) -> None:
        _check_roughness(self.roughness)


class Lambertian(eqx.Module):
    """Perfectly diffusing panels.

    Args:
        reflectance: fraction, 0 to 1; one number or one per wavelength, shape () or (L,).

    Raises:
        ValueError: a known reflectance lies outside 0 to 1.
    """

    reflectance: Float[Array, "*wavelengths"] = eqx.field(converter=_real)

    def __check_init__(self) -> None:
        value = concrete(self.reflectance)
        if value is not None:
            refuse("a reflectance", value, ~((value >= 0) & (value <= 1)), "0 to 1", ". Did you pass percent?")


class Specular(eqx.Module):
    """Smooth mirror-like panels: metal, glass, any refractive index against air.

    Args:
        index: n + ik with k ≥ 0 (time factor exp(-iωt)); one number or one per wavelength, shape () or (L,).
        polarization: "full" follows the polarization exactly through all reflections; "unpolarized"
            multiplies unpolarized reflectances; "separate" keeps s and p apart without coupling. The last two
            are the approximations of [SaintPierre2020, eq. 4.34 to 4.41].

    Raises:
        ValueError: a known index has k < 0 or n ≤ 0, or the polarization is not one of the three.
    """

    index: Inexact[Array, "*wavelengths"] = eqx.field(converter=_index)
    polarization: Polarization = eqx.field(static=True, default="full")

    def __check_init__(self) -> None:
        if self.polarization not in POLARIZATIONS:
            raise ValueError(f"{self.polarization!r} is not a polarization: expected one of {POLARIZATIONS}")
        value = concrete(self.index)
        if value is not None:
            refuse(
                "a refractive index",
                value,
                ~((value.real > 0) & (value.imag >= 0) & np.isfinite(value)),
                "n + ik with n > 0 and k ≥ 0",
                ". Is it tabulated as n - ik? Take the complex conjugate",
            )


class TwoPanels(eqx.Module):
    """A groove whose two sides differ.

    Args:
        first: material of the panel at y < 0, which faces a light with θ > 0, φ = 0.
        second: material of the panel at y > 0.
        alternating: average over grooves whose sides are swapped.

    Raises:
        ValueError: a panel is not ``Lambertian``, or their numbers of wavelengths differ.
    """

    first: Lambertian
    second: Lambertian
    alternating: bool = eqx.field(static=True, default=False)

    def __check_init__(self) -> None:
        for panel in (self.first, self.second):
            if not isinstance(panel, Lambertian):
                raise ValueError(f"{panel!r} is not a panel: expected Lambertian(reflectance) for each of the two")
        shapes = {jnp.shape(panel.reflectance) for panel in (self.first, self.second)} - {()}
        if len(shapes) > 1:
            raise ValueError(
                f"the panels' reflectances have shapes {sorted(shapes)}: expected the same wavelengths"
            )


class Diffuse(eqx.Module):
    """Uniform light from the whole hemisphere."""


class Directional(eqx.Module):
    """Parallel light.

    Args:
        polar: angle from the mean normal, radians, -π/2 to π/2.
        azimuth: 0 across the grooves, π/2 along them, radians.

    Raises:
        ValueError: a known angle lies outside its range.
    """

    polar: Float[Array, ""] = eqx.field(converter=_real, default=0.0)
    azimuth: Float[Array, ""] = eqx.field(converter=_real, default=0.0)

    def __check_init__(self) -> None:
        _check_direction(self.polar, self.azimuth)


class Mixed(eqx.Module):
    """Diffuse and parallel light of equal horizontal irradiance, mixed [SaintPierre2020, eq. 3.43].

    Args:
        diffuse_fraction: share of the diffuse light, 0 to 1.
        directional: the parallel part.

    Raises:
        ValueError: a known fraction lies outside 0 to 1.
    """

    diffuse_fraction: Float[Array, ""] = eqx.field(converter=_real)
    directional: Directional

    def __check_init__(self) -> None:
        value = concrete(self.diffuse_fraction)
        if value is not None:
            refuse("a diffuse fraction", value, ~((value >= 0) & (value <= 1)), "0 to 1")


class Annular(eqx.Module):
    """A ring of light: uniform in azimuth at one polar angle, as in the geometry 45°a:0°.

    Args:
        polar: angle from the mean normal, radians, 0 to π/2.

    Raises:
        ValueError: a known angle lies outside its range.
    """

    polar: Float[Array, ""] = eqx.field(converter=_real)

    def __check_init__(self) -> None:
        value = concrete(self.polar)
        if value is not None:
            bad = ~((value >= 0) & (value <= np.pi / 2 * (1 + 1e-6)))
            refuse("a polar angle of a ring in radians", value, bad, "0 to π/2", ". Did you pass degrees?")


class DiffuseWithTrap(eqx.Module):
    """Uniform light from the whole hemisphere but for a dark disk: an integrating sphere with a gloss trap.

    The white diffuser that a reflectance factor refers to is lit by the same sphere, with its trap.

    Args:
        polar: angle of the trap's center from the mean normal, radians, -π/2 to π/2.
        azimuth: its azimuth, radians.
        half_angle: angle under which the trap's radius is seen from the sample, radians; 0 is no trap. The
            trap must end above the horizon.

    Raises:
        ValueError: a known angle lies outside its range, or the trap reaches the horizon.
    """

    polar: Float[Array, ""] = eqx.field(converter=_real)
    azimuth: Float[Array, ""] = eqx.field(converter=_real)
    half_angle: Float[Array, ""] = eqx.field(converter=_real)

    def __check_init__(self) -> None:
        _check_direction(self.polar, self.azimuth)
        polar, half_angle = concrete(self.polar), concrete(self.half_angle)
        if half_angle is not None:
            left = np.pi / 2 - (0.0 if polar is None else np.abs(polar))
            bad = ~((half_angle >= 0) & (half_angle < left))
            above = "0 up to less than the trap's height above the horizon"
            refuse("a half-angle of a trap in radians", half_angle, bad, above, ". Did you pass degrees?")


class Hemisphere(eqx.Module):
    """All directions: as a view, a detector that collects all light; as an illumination, diffuse light.

    A reflectance factor with a hemispherical view is the reflectance: reflected over incident flux.
    """

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the directions: none."""
        return ()


class View(eqx.Module):
    """Directions of observation; any shape, polar and azimuth broadcast against each other.

    Args:
        polar: angle from the mean normal, radians, -π/2 to π/2.
        azimuth: 0 across the grooves, π/2 along them, radians.

    Raises:
        ValueError: a known angle lies outside its range.
    """

    polar: Float[Array, "*directions"] = eqx.field(converter=_real, default=0.0)
    azimuth: Float[Array, "*directions"] = eqx.field(converter=_real, default=0.0)

    def __check_init__(self) -> None:
        _check_direction(self.polar, self.azimuth)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the directions, ``*directions``."""
        return jnp.broadcast_shapes(jnp.shape(self.polar), jnp.shape(self.azimuth))


RandomGrooves = BeckmannGrooves | GaussianGrooves
Surface = VGrooves | RandomGrooves
Material = Lambertian | Specular | TwoPanels
Illumination = Diffuse | Directional | Mixed | Annular | DiffuseWithTrap


def _part(name: str, kinds: Any) -> Any:
    def check(value: Any) -> Any:
        # What transformations put in place of a part (None, a marker) passes: they do not build scenes.
        if isinstance(value, (int, float, str, type, np.ndarray)):
            known = ", ".join(kind.__name__ for kind in kinds.__args__)
            raise ValueError(f"{value!r} is not {name}: expected one of {known}")
        return value

    return check


def _light(value: Any) -> Any:
    return Diffuse() if isinstance(value, Hemisphere) else _part("an illumination", Illumination)(value)


def _view(value: Any) -> Any:
    return Hemisphere() if isinstance(value, Diffuse) else _part("a view", View | Hemisphere)(value)


class Scene(eqx.Module):
    """A grooved surface, what it is made of, how it is lit and from where it is seen.

    Args:
        surface: ``VGrooves``, ``BeckmannGrooves`` or ``GaussianGrooves``.
        material: ``Specular``, ``Lambertian`` or ``TwoPanels``.
        illumination: ``Diffuse`` (or ``Hemisphere``), ``Directional``, ``Mixed``, ``Annular`` or
            ``DiffuseWithTrap``.
        view: ``View``, or ``Hemisphere`` for a detector that collects all light.

    Raises:
        ValueError: a part is not one of these.
    """

    surface: Surface = eqx.field(converter=_part("a surface", Surface))
    material: Material = eqx.field(converter=_part("a material", Material))
    illumination: Illumination = eqx.field(converter=_light)
    view: View | Hemisphere = eqx.field(converter=_view)
