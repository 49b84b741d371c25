"""A surface seen from every direction: maps of the hemisphere in Lambert's azimuthal equal-area projection."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from numpy.typing import ArrayLike as Wavelengths
from numpy.typing import NDArray

from vcavity_jax import colorimetry
from vcavity_jax.colorimetry import Illuminant, Observer
from vcavity_jax.directions import components
from vcavity_jax.reflectance import reflectance_factor
from vcavity_jax.scene import (
    Annular,
    Diffuse,
    Lambertian,
    Scene,
    Specular,
    TwoPanels,
    VGrooves,
    View,
    concrete,
)
from vcavity_jax.specular import reflection_shares

_CHUNK = 256
"""Directions at a time: large enough for the loops to pay, small enough to stay in the cache."""


class ReflectanceMap(eqx.Module):
    """Reflectance factor over the hemisphere of views, on a square grid of equal solid angles.

    A direction (θ, φ) lies at u = 2 sin(θ/2) cos φ (to the right: across the grooves), v = 2 sin(θ/2) sin φ
    (up: along them), in the disk of radius √2 [SaintPierre2020, eq. 2.19]. Row 0 is the top; values belong to
    the centers of the pixels.

    Args:
        polar: θ of every pixel, radians, NaN outside the disk, shape (size, size).
        azimuth: φ of every pixel, radians from -π to π, NaN outside the disk.
        inside: whether a pixel's center is a direction of the hemisphere.
        reflectance_factor: fraction, NaN outside the disk, shape (size, size) and the material's wavelengths.
        reflections: the most reflections seen in each direction, 0 outside the disk; None unless the panels are
            mirrors of one groove angle.
    """

    polar: Float[Array, "size size"]
    azimuth: Float[Array, "size size"]
    inside: Bool[Array, "size size"]
    reflectance_factor: Float[Array, "size size *wavelengths"]
    reflections: Int[Array, "size size"] | None

    def srgb(
        self,
        wavelengths_nm: Wavelengths,
        illuminant: Illuminant = "D65",
        observer: Observer = "CIE 1931",
        *,
        partial: bool = False,
    ) -> Float[Array, "size size 3"]:
        """Colors for display: the perfect diffuser is white, what a display cannot show is clipped to 0 to 1.

        Args:
            wavelengths_nm: of the reflectance factor, shape (L,), see ``colorimetry.xyz``.
            illuminant: one of ``colorimetry.ILLUMINANTS``.
            observer: one of ``colorimetry.OBSERVERS``.
            partial: accept wavelengths that do not cover the visible range.

        Returns:
            sRGB, NaN outside the disk, shape (size, size, 3).

        Raises:
            ValueError: as ``colorimetry.xyz``.
        """
        light = (wavelengths_nm, illuminant, observer)
        white = colorimetry.white(*light, partial=partial)
        known = jnp.where(self.inside[..., None], self.reflectance_factor, jnp.zeros_like(self.reflectance_factor))
        shown = colorimetry.srgb(colorimetry.xyz(known, *light, partial=partial), white, clip=True)
        return jnp.where(self.inside[..., None], shown, jnp.full_like(shown, jnp.nan))


def reflection_count(scene: Scene) -> Int[Array, "*directions"]:
    """The most reflections between which light has entered a groove and leaves it in each view direction.

    Args:
        scene: ``VGrooves`` of a ``Specular`` material with a ``View``; its illumination and index are not used.

    Returns:
        Whole numbers, at least 1, of the view's shape. What fills no more of the aperture than rounding does not
        count. Along the fold (90° from the normal, φ = 90°), where nothing is seen, it is 1.

    Raises:
        ValueError: the scene has no largest number of reflections.
    """
    if not isinstance(scene.surface, VGrooves):
        raise ValueError("grooves of random angles have no largest number of reflections: expected VGrooves")
    if not isinstance(scene.material, Specular):
        raise ValueError("diffusing panels reflect light endlessly: expected a Specular material")
    if not isinstance(scene.view, View):
        raise ValueError("a hemispherical view has no direction: expected View(polar, azimuth)")
    return _most_reflections(scene.surface.angle, scene.view)


@jax.jit
def _most_reflections(angle: Float[Array, ""], view: View) -> Int[Array, "*directions"]:
    _, across, normal = components(*jnp.broadcast_arrays(view.polar, view.azimuth))
    angle = jnp.minimum(angle, jnp.asarray(np.pi, angle.dtype))
    most = jnp.ones(across.shape, int)
    for side in (across, -across):
        count, share, fewer = reflection_shares(angle, side, normal)
        rounding = 16 * count * jnp.finfo(share.dtype).eps
        for number, seen in ((count, share), (count - 1, fewer)):
            most = jnp.where(seen > rounding, jnp.maximum(most, number.astype(int)), most)
    return most


def reflectance_map(
    scene: Scene, size: int = 256, tolerance: float = 1e-6, *, smallest_angle: float | None = None
) -> ReflectanceMap:
    """Reflectance factor of a surface in all directions of view.

    It is differentiable in what the scene holds, as ``reflectance_factor``; gather ``[map.inside]`` before
    summing, as the rest is NaN. Directions that a symmetry of the scene makes equal are computed once.

    Args:
        scene: the surface, material and illumination; its view is replaced by the directions of the map.
        size: pixels along the edge.
        tolerance: upper bound on the absolute numerical error, see ``reflectance_factor``.
        smallest_angle: radians; diffusing panels whose dihedral angle JAX traces cost less if it stays above this.

    Returns:
        The map.

    Raises:
        ValueError: the size is not a whole number above 0; or as ``reflectance_factor``.
    """
    if not isinstance(size, int | np.integer) or isinstance(size, bool) or size < 1:
        raise ValueError(f"{size} is not a size of a map: expected a whole number of pixels above 0")
    with jax.ensure_compile_time_eval():
        place = np.arange(1 - size, size, 2)  # √2 / size is one unit: whole numbers decide exactly
        column, row = np.meshgrid(place, -place)
        inside = column**2 + row**2 <= size**2
        polar = 2 * np.arcsin(np.sqrt(np.where(inside, column**2 + row**2, 0) / 2) / size)
        azimuth = np.arctan2(row, column)
        chosen, origin = _distinct(scene, column, row, inside)
        # Neighbors in the section of the groove need alike work: the same visible parts, as many reflections.
        order = np.argsort(np.abs(np.tan(polar) * np.cos(azimuth)).ravel()[chosen], kind="stable")
        chosen = chosen[order]
        origin = np.argsort(order)[origin]
        views = View(jnp.asarray(polar.ravel()[chosen], float), jnp.asarray(azimuth.ravel()[chosen], float))
        shown = [jnp.asarray(np.where(inside, angle, np.nan), float) for angle in (polar, azimuth)]
        disk = jnp.asarray(inside)

    factor = _seen_from(scene, views, tolerance, smallest_angle)
    counts = None
    if isinstance(scene.surface, VGrooves) and isinstance(scene.material, Specular):
        number = reflection_count(_with_view(scene, views))
        counts = jnp.zeros((size, size), int).at[inside].set(number[origin])
    wavelengths = factor.shape[1:]
    whole = jnp.full((size, size, *wavelengths), jnp.nan, factor.dtype).at[inside].set(factor[origin])
    return ReflectanceMap(shown[0], shown[1], disk, whole, counts)


def _distinct(
    scene: Scene, column: NDArray[np.int64], row: NDArray[np.int64], inside: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pixels (as flat indices) that stand for all by symmetry; and for each pixel inside, which of them it is."""
    even = isinstance(scene.illumination, Diffuse | Annular)
    diffusing = isinstance(scene.material, Lambertian | TwoPanels)
    alike = not isinstance(scene.material, TwoPanels) or scene.material.alternating
    if even and alike:
        column = np.abs(column)
    if even or diffusing:  # Diffusing panels show only where the light and the view lie in the groove's section.
        row = np.abs(row)
    size = len(inside)
    chosen, origin = np.unique(
        (size - 1 - row[inside]) // 2 * size + (column[inside] + size - 1) // 2, return_inverse=True
    )
    return chosen, origin


def _with_view(scene: Scene, view: View) -> Scene:
    return Scene(scene.surface, scene.material, scene.illumination, view)


def _seen_from(
    scene: Scene, views: View, tolerance: float, smallest_angle: float | None
) -> Float[Array, "*directions_and_wavelengths"]:
    """Reflectance factor in many directions, a chunk at a time."""

    def one(polar: Array, azimuth: Array) -> Array:
        seen = _with_view(scene, View(polar, azimuth))
        return reflectance_factor(seen, tolerance, smallest_angle=smallest_angle)

    total = views.shape[0]
    chunk = min(_CHUNK, total)
    repeats = np.resize(np.arange(total), (-(-total // chunk), chunk))  # All chunks of one shape: one program.
    polar, azimuth = views.polar[repeats], views.azimuth[repeats]
    if all(concrete(leaf) is not None for leaf in jax.tree.leaves(scene)):
        # Each chunk is planned for its own directions: only some of them are masked.
        parts = [one(*views) for views in zip(polar, azimuth, strict=True)]
        values = jnp.concatenate(parts)
    else:
        values = jax.lax.map(lambda directions: jax.checkpoint(one)(*directions), (polar, azimuth))
        values = jnp.reshape(values, (-1, *values.shape[2:]))
    return values[:total]
