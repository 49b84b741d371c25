"""Spectra with few free numbers: smooth ones, and refractive indices that follow a dispersion formula.

A coefficient of a formula is given as a range (low, high), then it is free, or as a number, then it is held.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fitting.priors import Normal, Number
from vcavity_jax import dispersion

_KEPT_VARIANCE = 1e-6
_REFERENCE_POINTS = 240

Range = Number | tuple[Number, Number]


@dataclass(frozen=True)
class Coefficient:
    """One free number of a form: its name, bounds, start and prior."""

    name: str
    lower: float
    upper: float
    start: float
    prior: Normal | None = None


@runtime_checkable
class Form(Protocol):
    """What the values of a spectrum at different wavelengths have in common."""

    @property
    def quantities(self) -> tuple[str, ...]:
        """Names of the spectrum's real parts."""

    @property
    def listed(self) -> bool:
        """Whether the coefficients mean something by themselves."""

    def coefficients(self, wavelengths_nm: Float[np.ndarray, " w"], own: np.ndarray) -> tuple[Coefficient, ...]:
        """Its free numbers, for the wavelengths of all measurements and the spectrum that the scene holds."""

    def spectrum(
        self, wavelengths_nm: Float[np.ndarray, " w"], span_nm: tuple[float, float], values: Float[Array, " c"]
    ) -> Float[Array, "quantities w"]:
        """The spectrum at some wavelengths within the span of all."""


@dataclass(frozen=True)
class Smooth:
    """A fraction whose logit is a Gaussian process: constant part plus a smooth one, of given correlation length.

    ln(r/(1 - r)) has the mean 0 and the covariance s² (1 + exp(-(λ - λ')² / 2ℓ²)). It is expanded in the
    eigenfunctions of that covariance, as many as have a millionth of the variance; their coefficients are
    standard normal.

    Args:
        quantity: the spectrum's name.
        length_nm: ℓ, nm, > 0; 30 to 80 suit pigments and inks.
        spread: s; 1.5 allows reflectances from 0.02 to 0.98.

    Raises:
        ValueError: a number is not positive.

    References:
        [Rasmussen2006, section 4.3] for eigenfunctions of a covariance, there called Nyström's method.
    """

    quantity: str
    length_nm: Number
    spread: Number = 1.5

    def __post_init__(self) -> None:
        for name in ("length_nm", "spread"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} is {getattr(self, name)!r}; expected a positive number")

    @property
    def quantities(self) -> tuple[str, ...]:
        """The spectrum's name."""
        return (self.quantity,)

    @property
    def listed(self) -> bool:
        """The coefficients mean nothing to anybody."""
        return False

    def _modes(self, span_nm: tuple[float, float], wavelengths_nm: np.ndarray) -> np.ndarray:
        grid = np.linspace(*span_nm, _REFERENCE_POINTS) if span_nm[1] > span_nm[0] else np.array(span_nm[:1])

        def covariance(here: np.ndarray) -> np.ndarray:
            apart = (here[:, None] - grid) / self.length_nm
            return np.asarray(self.spread**2 * (1 + np.exp(-0.5 * apart**2)))

        variances, modes = np.linalg.eigh(covariance(grid))
        kept = variances > _KEPT_VARIANCE * variances.sum()
        return np.asarray(covariance(wavelengths_nm) @ modes[:, kept][:, ::-1] / np.sqrt(variances[kept][::-1]))

    def coefficients(self, wavelengths_nm: Float[np.ndarray, " w"], own: np.ndarray) -> tuple[Coefficient, ...]:
        """Standard normal numbers, from zero."""
        span = float(wavelengths_nm[0]), float(wavelengths_nm[-1])
        count = self._modes(span, wavelengths_nm).shape[1]
        return tuple(Coefficient(str(i), -8.0, 8.0, 0.0, Normal(0.0, 1.0)) for i in range(count))

    def spectrum(
        self, wavelengths_nm: Float[np.ndarray, " w"], span_nm: tuple[float, float], values: Float[Array, " c"]
    ) -> Float[Array, "quantities w"]:
        """The logistic function of the expansion."""
        modes = jnp.asarray(self._modes(span_nm, wavelengths_nm), values.dtype)
        return jax.nn.sigmoid(modes @ values)[None]


class _Formula(ABC):
    """A dispersion formula: coefficients in the order of ``_named``, ranges or numbers."""

    @property
    @abstractmethod
    def quantities(self) -> tuple[str, ...]:
        """Names of the index's real parts."""

    @property
    def listed(self) -> bool:
        """The coefficients are physical."""
        return True

    @abstractmethod
    def _named(self) -> list[tuple[str, Range]]:
        """Every coefficient with its name."""

    @abstractmethod
    def _index(self, wavelengths_nm: Array, values: Array) -> Array:
        """The index for all coefficients."""

    def _check(self) -> None:
        for name, given in self._named():
            low, high = given if isinstance(given, tuple) else (given, given)
            bad = not (np.isfinite(low) and np.isfinite(high))
            if bad or (isinstance(given, tuple) and not low < high):
                raise ValueError(f"{name} is {given!r}; expected a number, or a range (low, high) to search")
        if not any(isinstance(given, tuple) for _, given in self._named()):
            raise ValueError(
                f"{type(self).__name__}: no coefficient is a range (low, high); expected at least one, "
                "or an index that is not free"
            )

    def coefficients(self, wavelengths_nm: Float[np.ndarray, " w"], own: np.ndarray) -> tuple[Coefficient, ...]:
        """Those given as ranges; they start where the formula fits the scene's own index best."""
        free = [(name, *given) for name, given in self._named() if isinstance(given, tuple)]
        low, high = (np.array([f[i] for f in free], dtype=np.float64) for i in (1, 2))
        start = self._fitted(wavelengths_nm, own, low, high)
        return tuple(
            Coefficient(name, float(a), float(b), float(s)) for (name, a, b), s in zip(free, start, strict=True)
        )

    def _fitted(
        self, wavelengths_nm: np.ndarray, own: np.ndarray, low: np.ndarray, high: np.ndarray
    ) -> np.ndarray:
        from scipy.optimize import least_squares  # type: ignore[import-untyped]

        span = float(wavelengths_nm[0]), float(wavelengths_nm[-1])
        target = np.stack([own.real, own.imag])[: len(self.quantities)]

        def misfit(share: Array) -> Array:
            return (self.spectrum(wavelengths_nm, span, low + (high - low) * share) - target).ravel()

        value, slope = jax.jit(misfit), jax.jit(jax.jacfwd(misfit))
        # Formulas with several terms have several minima: a few starts, always the same.
        starts = [np.full(len(low), 0.5), *np.random.default_rng(0).uniform(0.05, 0.95, (7, len(low)))]
        best = None
        for start in starts:
            with np.errstate(all="ignore"):
                if not np.isfinite(value(start)).all():
                    continue
                found = least_squares(
                    lambda s: np.asarray(value(s)), start, lambda s: np.asarray(slope(s)), (0, 1)
                )
            if best is None or found.cost < best.cost:
                best = found
        share = np.full(len(low), 0.5) if best is None else np.clip(best.x, 1e-3, 1 - 1e-3)
        return np.asarray(low + (high - low) * share)

    def spectrum(
        self, wavelengths_nm: Float[np.ndarray, " w"], span_nm: tuple[float, float], values: Float[Array, " c"]
    ) -> Float[Array, "quantities w"]:
        """The formula with the free coefficients put in."""
        values = jnp.asarray(values)
        left = iter(range(values.shape[0]))
        whole = [
            values[next(left)] if isinstance(given, tuple) else jnp.asarray(given, values.dtype)
            for _, given in self._named()
        ]
        index = self._index(jnp.asarray(wavelengths_nm, values.dtype), jnp.stack(whole))
        if len(self.quantities) == 1:
            return index[None]
        return jnp.stack([index.real, index.imag])


@dataclass(frozen=True)
class Cauchy(_Formula):
    """n = A + B/λ² + C/λ⁴, λ in micrometers: a clear material away from its absorption.

    Args:
        a: A.
        b_um2: B, µm².
        c_um4: C, µm⁴.

    Raises:
        ValueError: a coefficient is neither a number nor a range, or none is free.
    """

    a: Range = (1.2, 2.6)
    b_um2: Range = (-0.01, 0.05)
    c_um4: Range = 0.0

    def __post_init__(self) -> None:
        self._check()

    @property
    def quantities(self) -> tuple[str, ...]:
        """A real index."""
        return ("n",)

    def _named(self) -> list[tuple[str, Range]]:
        return [("a", self.a), ("b_um2", self.b_um2), ("c_um4", self.c_um4)]

    def _index(self, wavelengths_nm: Array, values: Array) -> Array:
        return dispersion.cauchy(wavelengths_nm, *values)


@dataclass(frozen=True)
class Sellmeier(_Formula):
    """n² = 1 + Σ Bᵢ λ²/(λ² - Cᵢ), λ in micrometers: a clear material.

    Args:
        b: Bᵢ of each term.
        c_um2: Cᵢ of each term, µm²; square of the wavelength of a resonance outside the measured range.

    Raises:
        ValueError: the lengths differ, a coefficient is neither a number nor a range, or none is free.
    """

    b: Sequence[Range]
    c_um2: Sequence[Range]

    def __post_init__(self) -> None:
        object.__setattr__(self, "b", tuple(self.b))
        object.__setattr__(self, "c_um2", tuple(self.c_um2))
        if len(self.b) != len(self.c_um2) or not self.b:
            raise ValueError(f"{len(self.b)} values of b and {len(self.c_um2)} of c_um2; expected one per term")
        self._check()

    @property
    def quantities(self) -> tuple[str, ...]:
        """A real index."""
        return ("n",)

    def _named(self) -> list[tuple[str, Range]]:
        pairs = enumerate(zip(self.b, self.c_um2, strict=True), start=1)
        return [entry for i, (b, c) in pairs for entry in ((f"b{i}", b), (f"c{i}_um2", c))]

    def _index(self, wavelengths_nm: Array, values: Array) -> Array:
        return dispersion.sellmeier(wavelengths_nm, values[0::2], values[1::2])


@dataclass(frozen=True)
class DrudeLorentz(_Formula):
    """ε(E) = ε∞ - ωp²/(E² + iEΓ) + Σ fⱼEⱼ²/(Eⱼ² - E² - iEγⱼ): a metal or an absorbing material.

    Args:
        epsilon_infinity: ε∞.
        plasma_ev: ωp, eV; 0 without free electrons.
        damping_ev: Γ, eV.
        oscillators: strength fⱼ, energy Eⱼ and width γⱼ (eV) of each bound resonance.

    Raises:
        ValueError: a coefficient is neither a number nor a range, or none is free.
    """

    epsilon_infinity: Range = (1.0, 10.0)
    plasma_ev: Range = (1.0, 15.0)
    damping_ev: Range = (0.01, 1.0)
    oscillators: Sequence[tuple[Range, Range, Range]] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "oscillators", tuple(tuple(o) for o in self.oscillators))
        for oscillator in self.oscillators:
            if len(oscillator) != 3:
                raise ValueError(f"oscillator {oscillator!r}; expected (strength, energy_ev, width_ev)")
        self._check()

    @property
    def quantities(self) -> tuple[str, ...]:
        """A complex index."""
        return ("n", "k")

    def _named(self) -> list[tuple[str, Range]]:
        names = ("epsilon_infinity", "plasma_ev", "damping_ev")
        named: list[tuple[str, Range]] = [(name, getattr(self, name)) for name in names]
        for i, oscillator in enumerate(self.oscillators, start=1):
            parts = (f"strength{i}", f"energy{i}_ev", f"width{i}_ev")
            named += list(zip(parts, oscillator, strict=True))
        return named

    def _index(self, wavelengths_nm: Array, values: Array) -> Array:
        bound = values[3:].reshape(-1, 3)
        infinity, plasma, damping = values[0], values[1], values[2]
        return dispersion.drude_lorentz(
            wavelengths_nm, infinity, plasma, damping, bound[:, 0], bound[:, 1], bound[:, 2]
        )


def as_array(value: Any, count: int) -> np.ndarray:
    """What a scene holds of a spectrum, one value for each wavelength."""
    return np.broadcast_to(np.asarray(value), (count,))
