"""Which unknown goes where: from vectors of unknowns to scenes, spectra and what the instruments record.

Unknowns are P numbers, and Q spectra with a value at each of the U wavelengths of all measurements.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

import vcavity_jax as vc
from fitting import instrument
from fitting.parameters import Parameter
from fitting.spectra import Form


class Data(NamedTuple):
    """All numbers that may change without a new compilation; M measurements of (D, L) values each.

    Args:
        values: measured reflectance factors, 0 where missing, M arrays of shape (D, L).
        weights: inverse standard uncertainties, 0 where missing.
        means: of the measured spectrum in each direction, shape (D,).
        known: numbers of the scenes that are neither free nor compiled in.
        center: of the priors of the numbers, in the value or its logarithm, shape (P,).
        tightness: inverse widths of these priors, 0 for none, shape (P,).
        bounds: natural coordinates of lower and upper bounds, shape (2, P).
        step: steps in the natural coordinates at which a polish stops, shape (P,).
        spectral_bounds: lower and upper bounds of the spectra, shape (2, Q).
        spectral_center: of the priors of the spectra, shape (Q, U).
        spectral_tightness: inverse widths of these, 0 for none, shape (Q, U).
    """

    values: tuple[Array, ...]
    weights: tuple[Array, ...]
    means: tuple[Array, ...]
    known: tuple[tuple[Array, ...], ...]
    center: Array
    tightness: Array
    bounds: Array
    step: Array
    spectral_bounds: Array
    spectral_center: Array
    spectral_tightness: Array


@dataclass(frozen=True)
class FormUse:
    """A form and which numbers are its coefficients."""

    form: Form
    numbers: tuple[int, ...]


@dataclass(frozen=True)
class SpectralSlot:
    """A spectrum of a scene.

    Args:
        leaf: of the scene.
        source: index of a ``FormUse``; None for free spectra.
        rows: of the free spectra, or of the form's quantities: one, or two for n and k.
    """

    leaf: int
    source: int | None
    rows: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Part:
    """One measurement's share of a layout.

    Args:
        scene: with the measurement's view.
        wavelengths_nm: shape (L,).
        shape: (D, L).
        slots: leaves of the scene that are single unknown numbers, and which ones.
        spectral: its unknown spectra.
        roles: what of the instrument is unknown, and which number it is.
        passed: leaves that are handed to the compiled programs instead of being compiled in.
        places: where its wavelengths stand among all, shape (L,).
        smallest: dihedral angle, radians, and index of an interface, for each that is free.
    """

    scene: Any
    wavelengths_nm: np.ndarray
    shape: tuple[int, int]
    slots: tuple[tuple[int, int], ...]
    spectral: tuple[SpectralSlot, ...]
    roles: tuple[tuple[str, int], ...]
    passed: tuple[int, ...]
    places: np.ndarray
    smallest: tuple[float | None, float | None]

    @property
    def tilts(self) -> bool:
        """Whether a tilt of the sample is free."""
        return any(role in ("tilt_across", "tilt_along") for role, _ in self.roles)

    def reached(self, numbers: Sequence[Parameter]) -> np.ndarray:
        """At which wavelengths there is a prediction whatever the wavelength shift, shape (L,)."""
        for role, number in self.roles:
            if role == "wavelength_shift":
                shift = numbers[number]
                return instrument.within_shift(self.wavelengths_nm, float(shift.lower), float(shift.upper))
        return np.ones(len(self.wavelengths_nm), bool)

    @property
    def key(self) -> tuple[Any, ...]:
        """Equal for measurements that can share a compiled program."""
        leaves, tree = jax.tree.flatten(self.scene)
        free = {leaf for leaf, _ in self.slots} | {s.leaf for s in self.spectral} | set(self.passed)
        known = tuple(
            (None if i in free else np.asarray(leaf).tobytes(), np.shape(leaf), str(np.asarray(leaf).dtype))
            for i, leaf in enumerate(leaves)
        )
        depends = any(role == "wavelength_shift" for role, _ in self.roles) or any(
            s.source is not None for s in self.spectral
        )
        grid = self.wavelengths_nm.tobytes() if depends else None
        shares = (self.shape, self.slots, self.spectral, self.roles, self.passed, self.places.tobytes())
        return tree, known, grid, self.smallest, *shares

    def put(self, numbers: Sequence[Any], spectra: Sequence[Any], known: Sequence[Any]) -> Any:
        """The scene with unknown numbers, spectra and what is passed on put in."""
        leaves, tree = jax.tree.flatten(self.scene)
        for (leaf, _), value in zip(self.slots, numbers, strict=True):
            leaves[leaf] = value
        for slot, spectrum in zip(self.spectral, spectra, strict=True):
            leaves[slot.leaf] = spectrum
        for leaf, value in zip(self.passed, known, strict=True):
            leaves[leaf] = value
        return jax.tree.unflatten(tree, leaves)


@dataclass(frozen=True, eq=False)
class Layout:
    """The unknowns of a fit and how each measurement depends on them.

    Args:
        parts: the measurements.
        logarithmic: which numbers are searched by their logarithm.
        prior_of_logarithm: which numbers have a prior of their logarithm.
        forms: spectra with a form.
        free_spectra: how many spectra are free at each wavelength, Q.
        wavelengths_nm: of all measurements, shape (U,).
        tolerance: bound on the model's numerical error.
    """

    parts: tuple[Part, ...]
    logarithmic: tuple[bool, ...]
    prior_of_logarithm: tuple[bool, ...]
    forms: tuple[FormUse, ...]
    free_spectra: int
    wavelengths_nm: np.ndarray
    tolerance: float

    @property
    def key(self) -> tuple[Any, ...]:
        """Equal for fits that can share compiled programs."""
        parts = tuple(part.key for part in self.parts)
        grid = (len(self.wavelengths_nm), self.wavelengths_nm.tobytes() if self.forms else None)
        flags = (self.logarithmic, self.prior_of_logarithm)
        return parts, flags, self.forms, self.free_spectra, grid, self.tolerance

    @property
    def blocks(self) -> int:
        """Groups of values that share no unknown but the numbers: the wavelengths, if a spectrum is free."""
        return len(self.wavelengths_nm) if self.free_spectra else 1

    @property
    def hidden(self) -> frozenset[int]:
        """Numbers that mean nothing by themselves: coefficients of a form that does not list them."""
        return frozenset(i for use in self.forms if not use.form.listed for i in use.numbers)

    def values(self, natural: Float[Array, " p"]) -> Float[Array, " p"]:
        """From natural coordinates to the scene's units."""
        mask = np.asarray(self.logarithmic, bool)
        if not mask.any():
            return natural
        # The exponential of a number that is not a logarithm might overflow: its gradient must not see it.
        safe = jnp.where(mask, natural, jnp.zeros_like(natural))
        return jnp.where(mask, jnp.exp(safe), natural)

    def prior_residuals(self, natural: Float[Array, " p"], data: Data) -> Float[Array, " p"]:
        """Of the numbers' priors."""
        values, mask = self.values(natural), np.asarray(self.prior_of_logarithm, bool)
        if mask.any():
            safe = jnp.where(mask, values, jnp.ones_like(values))
            values = jnp.where(mask, jnp.log(safe), values)
        return data.tightness * (values - data.center)

    def inputs(
        self, part: Part, natural: Float[Array, " p"], spectra: Float[Array, "q u"]
    ) -> tuple[Float[Array, " s"], Float[Array, "c w"]]:
        """What a measurement's model depends on: S numbers (tilts last) and C real spectra."""
        values = self.values(natural)
        numbers = [values[i] for _, i in part.slots]
        if part.tilts:
            roles, none_at_all = dict(part.roles), jnp.zeros((), natural.dtype)
            numbers += [values[roles[r]] if r in roles else none_at_all for r in ("tilt_across", "tilt_along")]
        span = float(self.wavelengths_nm[0]), float(self.wavelengths_nm[-1])
        rows = []
        for slot in part.spectral:
            if slot.source is None:
                rows += [spectra[row][part.places] for row in slot.rows]
            else:
                use = self.forms[slot.source]
                whole = use.form.spectrum(part.wavelengths_nm, span, values[np.asarray(use.numbers)])
                rows += [whole[row] for row in slot.rows]
        none = jnp.zeros(0, natural.dtype)
        return jnp.stack(numbers) if numbers else none, jnp.stack(rows) if rows else none.reshape(0, 1)

    def placed(self, part: Part, numbers: Array, rows: Array, known: Sequence[Array]) -> Any:
        """The scene of one measurement, without tilt, for its S numbers and C spectra."""
        spectra, next_row = [], 0
        for slot in part.spectral:
            if len(slot.rows) == 2:
                spectra.append(lax.complex(rows[next_row], rows[next_row + 1]))
            else:
                spectra.append(rows[next_row])
            next_row += len(slot.rows)
        return part.put([numbers[i] for i in range(len(part.slots))], spectra, known)

    def factor(self, part: Part, numbers: Array, rows: Array, known: Sequence[Array]) -> Float[Array, "d w"]:
        """True reflectance factors of one measurement, for its S numbers and C spectra."""
        scene, tilt = self.placed(part, numbers, rows, known), None
        if part.tilts:
            scene, tilt = instrument.tilted(scene, numbers[-2], numbers[-1])
        # A hemispherical view has no axis of directions, a gray material none of wavelengths.
        value = jnp.broadcast_to(jnp.reshape(self.evaluated(part, scene), (part.shape[0], -1)), part.shape)
        return value if tilt is None else value * tilt

    def evaluated(self, part: Part, scene: Any) -> Array:
        """Reflectance factors of a measurement's scene, shaped as the model returns them."""
        angle, index = part.smallest
        return vc.reflectance_factor(scene, self.tolerance, smallest_angle=angle, smallest_index=index)

    def recorded(
        self, part: Part, factor: Float[Array, "d w"], natural: Float[Array, " p"], mean: Float[Array, " d"]
    ) -> Float[Array, "d w"]:
        """What the instrument of one measurement makes of true reflectance factors."""
        values = self.values(natural)
        return instrument.observed(factor, {r: values[i] for r, i in part.roles}, part.wavelengths_nm, mean)
