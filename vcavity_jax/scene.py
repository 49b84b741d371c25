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


def _optional_real(value: ArrayLike | None) -> Array | None:
    return None if value is None else _real(value)


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
        layer: none; a colored layer lies on the diffusing material of ``InterfacedLambertian``.

    Raises:
        ValueError: a known index has k < 0 or n ≤ 0, the polarization is unknown, or a layer is given.
    """

    index: Inexact[Array, "*wavelengths"] = eqx.field(converter=_index)
    polarization: Polarization = eqx.field(static=True, default="full")
    layer: None = eqx.field(static=True, default=None)

    def __check_init__(self) -> None:
        if self.layer is not None or isinstance(self.polarization, ColoredLayer | Halftone):
            raise ValueError(
                "a layer on a specular material is not modeled: expected Specular(index), or "
                "InterfacedLambertian(reflectance, index, layer) for a colored layer on diffusing material"
            )
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


LayerModel = Literal["williams-clapper", "berns"]
LAYER_MODELS: tuple[LayerModel, ...] = ("williams-clapper", "berns")


def _refuse_beyond_unity(what: str, value: Any) -> None:
    known = concrete(value)
    if known is not None:
        refuse(what, known, ~((known >= 0) & (known <= 1)), "0 to 1", ". Did you pass percent?")


class ColoredLayer(eqx.Module):
    """A clear colored layer (ink, glaze, varnish) between the interface and the diffusing material.

    Args:
        transmittance: of the layer for one normal passage, fraction, 0 to 1; one number or one per wavelength,
            shape () or (L,).
        model: "williams-clapper" follows the length of every path through the layer exactly
            [WilliamsClapper1953]; "berns" takes every passage for a normal one [Berns1993, as SaintPierre2020,
            eq. 5.27], which is cheaper and too bright: by a third at t = 0.9 in grooves of 45 degrees.

    Raises:
        ValueError: a known transmittance lies outside 0 to 1, or the model is not one of the two.
    """

    transmittance: Float[Array, "*wavelengths"] = eqx.field(converter=_real)
    model: LayerModel = eqx.field(static=True, default="williams-clapper")

    def __check_init__(self) -> None:
        if self.model not in LAYER_MODELS:
            raise ValueError(f"{self.model!r} is not a model of a layer: expected one of {LAYER_MODELS}")
        _refuse_beyond_unity("a transmittance", self.transmittance)


class Halftone(eqx.Module):
    """A halftone screen of one ink between the interface and the diffusing material.

    Dots are far smaller than the way light travels in the material, so that its passages are independent
    [ClapperYule1953]; each passes the ink with the probability of its coverage.

    Args:
        coverage: area fraction a of the ink, 0 to 1; one number or one per wavelength, shape () or (L,).
        transmittance: t of the ink for one passage, 0 to 1, shape () or (L,).

    Raises:
        ValueError: a known coverage or transmittance lies outside 0 to 1.
    """

    coverage: Float[Array, "*wavelengths"] = eqx.field(converter=_real)
    transmittance: Float[Array, "*wavelengths"] = eqx.field(converter=_real)

    def __check_init__(self) -> None:
        _refuse_beyond_unity("a coverage", self.coverage)
        _refuse_beyond_unity("a transmittance", self.transmittance)


Layer = ColoredLayer | Halftone
InterfacedPolarization = Literal["unpolarized", "full"]
INTERFACED_POLARIZATIONS: tuple[InterfacedPolarization, ...] = ("unpolarized", "full")


class InterfacedLambertian(eqx.Module):
    """Diffusing panels under a smooth interface: glossy paper, paint, varnished or 2.5D-printed matter.

    Light is reflected by the interfaces of both panels any number of times, enters, is scattered below the
    interface, which reflects a part back inside, and leaves again, at every order. It is the model of
    [Saunderson1942] in a groove [SaintPierre2020, chapter 5], without its restrictions.

    Args:
        reflectance: ρ, the intrinsic reflectance of the material below its interface, fraction, 0 to 1; one
            number or one per wavelength, shape () or (L,). A flat sample shows less, by the Saunderson correction.
        index: refractive index n ≥ 1 of the material against air, real, shape () or, with dispersion, (L,).
        layer: colored layer between interface and material, ``ColoredLayer`` or ``Halftone``; None for none.
        polarization: "unpolarized" multiplies the unpolarized reflectances along a path; "full" follows the
            polarization of each path exactly from outside the groove to the material, which depolarizes.
        specular_included: whether the light that never enters the material counts in diffuse light. See
            ``specular_component``.

    Raises:
        ValueError: a known reflectance lies outside 0 to 1, a known index is below 1 or complex, the layer is not
            one, or the numbers of wavelengths differ.
    """

    reflectance: Float[Array, "*wavelengths"] = eqx.field(converter=_real)
    index: Inexact[Array, "*wavelengths"] = eqx.field(converter=_index)
    layer: Layer | None = None
    polarization: InterfacedPolarization = eqx.field(static=True, default="unpolarized")
    specular_included: bool = eqx.field(static=True, default=True)

    def __check_init__(self) -> None:
        if self.polarization not in INTERFACED_POLARIZATIONS:
            raise ValueError(
                f"{self.polarization!r} is not a polarization of an interfaced material: expected one of "
                f"{INTERFACED_POLARIZATIONS}"
            )
        if isinstance(self.layer, (int, float, str, type, np.ndarray, jax.Array)):
            raise ValueError(f"{self.layer!r} is not a layer: expected ColoredLayer(t), Halftone(a, t) or None")
        _refuse_beyond_unity("a reflectance", self.reflectance)
        if jnp.iscomplexobj(self.index):
            value = concrete(self.index)
            given = "a complex number" if value is None else value.ravel()[0]
            raise ValueError(f"{given} is not the index of a clear interface: expected a real n ≥ 1")
        known = concrete(self.index)
        if known is not None:
            refuse("a refractive index of an interface", known, ~((known >= 1) & np.isfinite(known)), "n ≥ 1")
        parts = [self.reflectance, self.index, *jax.tree.leaves(self.layer)]
        shapes = {jnp.shape(part) for part in parts if eqx.is_array_like(part)} - {()}
        if len(shapes) > 1:
            raise ValueError(
                f"reflectance, index and layer have shapes {sorted(shapes)}: expected the same wavelengths"
            )

    @property
    def wavelength_shape(self) -> tuple[int, ...]:
        """() or (L,)."""
        return jnp.broadcast_shapes(
            *(jnp.shape(a) for a in (self.reflectance, self.index, *jax.tree.leaves(self.layer)))
        )


class TwoPanels(eqx.Module):
    """A groove whose two sides differ.

    Args:
        first: material of the panel at y < 0, which faces a light with θ > 0, φ = 0.
        second: material of the panel at y > 0; of the same kind. Two ``InterfacedLambertian`` share one interface
            (index, polarization, specular_included) and may differ in reflectance and in layer.
        alternating: average over grooves whose sides are swapped.

    Raises:
        ValueError: a panel is neither ``Lambertian`` nor ``InterfacedLambertian``, their kinds, numbers of
            wavelengths or known interfaces differ, or not both carry the same Williams-Clapper layer.
    """

    first: Lambertian | InterfacedLambertian
    second: Lambertian | InterfacedLambertian
    alternating: bool = eqx.field(static=True, default=False)

    def __check_init__(self) -> None:
        for panel in (self.first, self.second):
            if not isinstance(panel, Lambertian | InterfacedLambertian):
                raise ValueError(
                    f"{panel!r} is not a panel: expected Lambertian(reflectance) or InterfacedLambertian(...) for "
                    "each of the two"
                )
        if type(self.first) is not type(self.second):
            raise ValueError("one panel has an interface and the other has none: expected two of the same kind")
        shapes = {jnp.shape(leaf) for leaf in jax.tree.leaves((self.first, self.second))} - {()}
        if len(shapes) > 1:
            raise ValueError(
                f"the panels' reflectances have shapes {sorted(shapes)}: expected the same wavelengths"
            )
        if isinstance(self.first, InterfacedLambertian) and isinstance(self.second, InterfacedLambertian):
            _check_shared_interface(self.first, self.second)


def _check_shared_interface(first: InterfacedLambertian, second: InterfacedLambertian) -> None:
    a, b = concrete(first.index), concrete(second.index)
    differ = a is not None and b is not None and bool(np.any(a != b))
    flags = (first.polarization, first.specular_included) != (second.polarization, second.specular_included)
    if differ or flags:
        raise ValueError(
            "the panels differ in their interface: expected the same index, polarization and specular_included"
        )
    slanted = [
        isinstance(layer, ColoredLayer) and layer.model == "williams-clapper"
        for layer in (first.layer, second.layer)
    ]
    if any(slanted):
        same = all(slanted)
        if isinstance(first.layer, ColoredLayer) and isinstance(second.layer, ColoredLayer):
            a, b = concrete(first.layer.transmittance), concrete(second.layer.transmittance)
            same = same and (a is None or b is None or bool(np.all(a == b)))
        if not same:
            raise ValueError(
                "two panels with different williams-clapper layers are not modeled: expected the same on both, "
                'or ColoredLayer(t, model="berns") or Halftone(a, t) on each'
            )


class Diffuse(eqx.Module):
    """Uniform light from the whole hemisphere."""


class Directional(eqx.Module):
    """Parallel light.

    Args:
        polar: angle from the mean normal, radians, -π/2 to π/2.
        azimuth: 0 across the grooves, π/2 along them, radians.
        solid_angle: ω of the source, a small disk, as seen from the sample, steradians. It is needed only for the
            purely specular component of interfaced panels, which grows as 1/ω where the source is mirrored
            [SaintPierre2020, eq. 5.24]; None leaves that out.

    Raises:
        ValueError: a known angle lies outside its range, or the source reaches the horizon.
    """

    polar: Float[Array, ""] = eqx.field(converter=_real, default=0.0)
    azimuth: Float[Array, ""] = eqx.field(converter=_real, default=0.0)
    solid_angle: Float[Array, ""] | None = eqx.field(converter=_optional_real, default=None)

    def __check_init__(self) -> None:
        _check_direction(self.polar, self.azimuth)
        known, polar = concrete(self.solid_angle), concrete(self.polar)
        if known is not None:
            above = 2 * np.pi * (1 - (0.0 if polar is None else np.sin(np.abs(polar))))
            refuse(
                "a solid angle of a source in steradians",
                known,
                ~((known > 0) & (known < above)),
                "above 0, and the source above the horizon",
            )


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
Material = Lambertian | Specular | TwoPanels | InterfacedLambertian
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
        material: ``Specular``, ``Lambertian``, ``InterfacedLambertian`` or ``TwoPanels``.
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
