"""The posterior density of a fit's numbers, with the spectra that are free at each wavelength integrated out.

For known numbers the wavelengths are independent, so that each integral is a small quadrature and no sampler
ever sees a spectrum. All is compiled once for a kind of fit and evaluated in batches.

A number without a prior is uniform within its bounds, in its logarithm if it is searched by that (roughness).
"""

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float
from scipy.special import expit, gammaln, log_expit, ndtr  # type: ignore[import-untyped]

from fitting.arrow import Lane, descend
from fitting.layout import Data, Layout
from fitting.parameters import Parameter
from fitting.priors import LogNormal, as_prior
from fitting.problem import INNER_STEPS, Problem
from fitting.programs import Kept, programs_for

LANES = 16
"""Points per call of a compiled density: half of an ensemble."""

NOISE = Parameter("noise", None, 0.1, 10.0, scale="log", start=1.0)
"""Ratio of the true standard uncertainty to the stated one, uniform in its logarithm."""

_NODES, _REACH = 13, 5.5
_NEWTON_STEPS = 4
_FINE = 129


class Setting(NamedTuple):
    """All that a compiled density may be given without being compiled again.

    Args:
        data: of the problem.
        spectra: where the integrals over the free spectra look for their maximum first, shape (Q, U).
        tail: degrees of freedom of Student's t; not used if the noise is Gaussian.
    """

    data: Data
    spectra: Array
    tail: Array


class _Spectra(NamedTuple):
    """Free spectra at one point of the numbers.

    Args:
        log_integral: over all of them, of their part of the density.
        nodes: of the quadrature, shape (K, U); the best spectra, shape (Q, U), if these are two per wavelength.
        log_density: there, shape (K, U); upper triangles of the inverse roots, shape (U, Q, Q), likewise.
    """

    log_integral: Array
    nodes: Array
    log_density: Array


@dataclass(frozen=True)
class Kind:
    """What a density is compiled for.

    Args:
        layout: of the problem; its numbers are followed by the noise level if that is free.
        noise: whether it is free.
        robust: Student's t instead of Gaussian noise.
        powers: power of each number in its prior's density in the natural coordinate, see ``_powers``.
    """

    layout: Layout
    noise: bool
    robust: bool
    powers: tuple[tuple[float, float], ...]

    def log_density(self, natural: Float[Array, " p"], setting: Setting) -> Array:
        """Log of the density in the natural coordinates, up to a constant, spectra integrated out."""
        return self.quadrature(natural, setting)[0]

    def log_joint(self, natural: Float[Array, " p"], spectra: Float[Array, "q u"], setting: Setting) -> Array:
        """Likewise, of the numbers and the free spectra."""
        own, data = self._split(natural, setting)
        likelihood = self._log_likelihood(own, spectra, data, setting.tail)
        spread = data.spectral_tightness * (spectra - data.spectral_center)
        return likelihood - jnp.sum(spread**2) / 2 + self._log_noise(natural, data) + self._log_prior(own, data)

    def quadrature(self, natural: Float[Array, " p"], setting: Setting) -> tuple[Array, Array, Array]:
        """The log density, and what the free spectra are drawn from for these numbers, see ``placed``."""
        own, data = self._split(natural, setting)
        rest = self._log_noise(natural, data) + self._log_prior(own, data)
        if not self.layout.free_spectra:
            none = setting.spectra
            return self._log_likelihood(own, none, data, setting.tail) + rest, none, none
        found = self._spectra(own, data, setting)
        return found.log_integral + rest, found.nodes, found.log_density

    def placed(
        self, nodes: Array, log_density: Array, uniform: Float[Array, "q u"], setting: Setting
    ) -> Float[Array, "q u"]:
        """Free spectra from their quadrature and uniform random numbers."""
        if not self.layout.free_spectra:
            return uniform
        bottom, top = (bound[:, None] for bound in setting.data.spectral_bounds)
        if self.layout.free_spectra > 1:
            normal = jnp.sqrt(2.0).astype(uniform.dtype) * lax.erf_inv(2 * uniform - 1)
            return jnp.clip(nodes + jnp.einsum("uqr,ru->qu", log_density, normal), bottom, top)
        return jax.vmap(_inverted, in_axes=(1, 1, 0))(nodes, log_density, uniform[0])[None]

    def draw(
        self, natural: Float[Array, " p"], uniform: Float[Array, "q u"], setting: Setting
    ) -> tuple[Array, Float[Array, "q u"]]:
        """The log density, and free spectra for these numbers, from uniform random numbers."""
        log_density, nodes, log_nodes = self.quadrature(natural, setting)
        return log_density, self.placed(nodes, log_nodes, uniform, setting)

    def predicted(
        self, natural: Float[Array, " p"], spectra: Float[Array, "q u"], setting: Setting
    ) -> tuple[Array, ...]:
        """Recorded values of each measurement."""
        own, data = self._split(natural, setting)
        return self._recorded(own, spectra, data)

    def _split(self, natural: Array, setting: Setting) -> tuple[Array, Data]:
        """The problem's numbers, and its data with the noise level put in."""
        data = setting.data
        if not self.noise:
            return natural, data
        level = jnp.exp(-natural[-1])
        return natural[:-1], data._replace(weights=tuple(w * level for w in data.weights))

    def _recorded(self, own: Array, spectra: Array, data: Data) -> tuple[Array, ...]:
        return tuple(
            self.layout.recorded(
                part, self.layout.factor(part, *self.layout.inputs(part, own, spectra), known), own, mean
            )
            for part, mean, known in zip(self.layout.parts, data.means, data.known, strict=True)
        )

    def _log_likelihood(self, own: Array, spectra: Array, data: Data, tail: Array) -> Array:
        total = jnp.zeros((), own.dtype)
        recorded = self._recorded(own, spectra, data)
        for predicted, values, weights in zip(recorded, data.values, data.weights, strict=True):
            squares = ((predicted - values) * weights) ** 2
            if self.robust:
                squares = (tail + 1) * jnp.log1p(squares / tail)
            total = total - jnp.sum(squares) / 2
        return total

    def _log_noise(self, natural: Array, data: Data) -> Array:
        if not self.noise:
            return jnp.zeros((), natural.dtype)
        count = sum(jnp.sum(w > 0, dtype=jnp.int32) for w in data.weights)
        return -jnp.asarray(count).astype(natural.dtype) * natural[-1]

    def _log_prior(self, own: Array, data: Data) -> Array:
        residuals = self.layout.prior_residuals(own, data)
        total = -jnp.sum(residuals**2) / 2
        for i, (of_logarithm, of_value) in enumerate(self.powers):
            if of_logarithm:
                total = total + of_logarithm * own[i]
            if of_value:
                total = total + of_value * jnp.log(own[i])
        return total

    def _spectra(self, own: Array, data: Data, setting: Setting) -> _Spectra:
        """Each wavelength by itself: its maximum, then a quadrature around it."""
        if self.layout.free_spectra > 1:
            return self._two_per_wavelength(own, data, setting)
        bottom, top = data.spectral_bounds[:, 0]
        whole = top - bottom
        best, curvature = setting.spectra[0], jnp.zeros_like(setting.spectra[0])
        for _ in range(_NEWTON_STEPS):
            slope, curvature = self._slopes(own, best, data)
            safe = jnp.where(curvature > 0, curvature, 1.0)
            best = jnp.clip(best - jnp.where(curvature > 0, slope / safe, 0.0), bottom, top)
        flat = curvature * whole**2 < 1
        width = jnp.where(flat, whole, _REACH / jnp.sqrt(jnp.where(flat, 1.0, curvature)))
        low, high = jnp.maximum(best - width, bottom), jnp.minimum(best + width, top)
        places, shares = np.polynomial.legendre.leggauss(_NODES)
        middle, half = (low + high) / 2, (high - low) / 2
        nodes = middle + half * jnp.asarray(places, own.dtype)[:, None]
        # What depends on the numbers alone is computed once for all nodes.
        log_density = -jax.vmap(lambda row: self._costs(own, row[None], data))(nodes) / 2
        highest = jnp.max(log_density, axis=0)
        weights = jnp.asarray(shares, own.dtype)[:, None]
        integral = half * jnp.sum(weights * jnp.exp(log_density - highest), axis=0)
        return _Spectra(jnp.sum(highest + jnp.log(integral)), nodes, log_density)

    def _slopes(self, own: Array, best: Float[Array, " u"], data: Data) -> tuple[Array, Array]:
        """Half the derivative of chi-square at each wavelength, and its Gauss-Newton curvature."""
        tight = data.spectral_tightness[0]
        slope, curvature = tight**2 * (best - data.spectral_center[0]), tight**2
        # One tangent of ones serves all wavelengths.
        recorded, pushed = jax.jvp(
            lambda row: self._recorded(own, row[None], data), (best,), (jnp.ones_like(best),)
        )
        for part, predicted, column, values, weights in zip(
            self.layout.parts, recorded, pushed, data.values, data.weights, strict=True
        ):
            column = column * weights
            slope = slope.at[part.places].add(jnp.sum(column * (predicted - values) * weights, axis=0))
            curvature = curvature.at[part.places].add(jnp.sum(column**2, axis=0))
        return slope, curvature

    def _two_per_wavelength(self, own: Array, data: Data, setting: Setting) -> _Spectra:
        """Laplace's method around the branch that the fit has found."""
        lane = Lane(
            own,
            setting.spectra,
            jnp.zeros(own.shape, bool),
            jnp.ones(setting.spectra.shape, bool),
            jnp.asarray(INNER_STEPS, jnp.int32),
            jnp.asarray(0, jnp.int32),
        )
        end = descend(self.layout, lane, data)
        numbers = own.shape[0]
        return _laplace(end.spectra, end.matrix[:, numbers:-1, numbers:-1], end.matrix[:, -1, -1])

    def _costs(self, own: Array, spectra: Array, data: Data) -> Float[Array, " u"]:
        """Chi-square at each wavelength."""
        spread = data.spectral_tightness * (spectra - data.spectral_center)
        total = jnp.sum(spread**2, axis=0)
        recorded = self._recorded(own, spectra, data)
        for part, predicted, values, weights in zip(
            self.layout.parts, recorded, data.values, data.weights, strict=True
        ):
            total = total.at[part.places].add(jnp.sum(((predicted - values) * weights) ** 2, axis=0))
        return total


def _laplace(spectra: Array, square: Array, lowest: Array) -> _Spectra:
    """Gaussian integrals around the maxima, of two values per wavelength; none where the data say nothing."""
    size = square.shape[-1]
    lengths = jnp.sqrt(jnp.maximum(jnp.diagonal(square, axis1=1, axis2=2), 1e-300))
    scaled = square / (lengths[:, :, None] * lengths[:, None, :])
    values, vectors = jnp.linalg.eigh(scaled + 1e-9 * jnp.eye(size, dtype=square.dtype))
    root = vectors / jnp.sqrt(jnp.maximum(values, 1e-9))[:, None, :] / lengths[:, :, None]
    log_volume = -jnp.sum(jnp.log(jnp.maximum(values, 1e-9)), axis=1) / 2 - jnp.sum(jnp.log(lengths), axis=1)
    return _Spectra(jnp.sum(-lowest / 2 + log_volume + size / 2 * math.log(2 * math.pi)), spectra, root)


def _inverted(nodes: Float[Array, " k"], log_density: Float[Array, " k"], uniform: Array) -> Array:
    """The value below which a share of a density lies, from its logarithm at Legendre nodes."""
    places, shares = np.polynomial.legendre.leggauss(_NODES)
    weights = jnp.asarray((-1.0) ** np.arange(_NODES) * np.sqrt((1 - places**2) * shares), nodes.dtype)
    fine = np.cos(np.linspace(np.pi, 0, _FINE))
    fine[[0, -1]] = -1.0, 1.0
    apart = jnp.asarray(fine[:, None] - places, nodes.dtype)  # no node is a point of the fine grid
    terms = weights / apart
    values = terms @ log_density / jnp.sum(terms, axis=1)
    density = jnp.exp(values - jnp.max(log_density))
    steps = jnp.asarray(np.diff(fine), nodes.dtype)
    rising = jnp.concatenate([jnp.zeros(1, nodes.dtype), jnp.cumsum(steps * (density[1:] + density[:-1]) / 2)])
    at = jnp.interp(uniform * rising[-1], rising, jnp.asarray(fine, nodes.dtype))
    middle = (nodes[0] + nodes[-1]) / 2
    return middle + (nodes[-1] - nodes[0]) / 2 / places[-1] * at


def _powers(parameter: Parameter) -> tuple[float, float]:
    """What turns a prior's density into one of the natural coordinate: powers of the value."""
    prior, logarithmic = parameter.prior, parameter.scale == "log"
    if prior is None:
        return 0.0, 0.0
    if isinstance(prior, LogNormal):
        return (0.0, 0.0) if logarithmic else (0.0, -1.0)
    return (1.0, 0.0) if logarithmic else (0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Density:
    """The posterior density of a problem's numbers.

    Args:
        problem: what was fitted.
        numbers: its numbers, and the noise level if that is free.
        kind: what is compiled.
        setting: the numbers in it.
        programs: what is compiled, shared by all densities of a kind.
    """

    problem: Problem
    numbers: tuple[Parameter, ...]
    kind: Kind
    setting: Setting
    programs: dict[str, Any]

    @property
    def bounds(self) -> np.ndarray:
        """Natural coordinates of lower and upper bounds, shape (2, P)."""
        ends = [[p.natural(p.lower) for p in self.numbers], [p.natural(p.upper) for p in self.numbers]]
        return np.array(ends, np.float64).reshape(2, len(self.numbers))

    @property
    def used(self) -> int:
        """Count of the values that are fitted."""
        return sum(int(np.sum(np.asarray(w) > 0)) for w in self.setting.data.weights)

    def noise_at(self, chi_square: Any) -> np.ndarray:
        """The best noise level for some chi-square, in its natural coordinate, within its bounds."""
        return np.clip(np.log(np.maximum(chi_square, 1e-12) / self.used) / 2, *self.bounds[:, -1])

    @property
    def names(self) -> tuple[str, ...]:
        """Of the numbers."""
        return tuple(p.name for p in self.numbers)

    def natural(self, values: Float[np.ndarray, "n p"]) -> Float[np.ndarray, "n p"]:
        """Natural coordinates of values in the scene's units."""
        return np.stack([p.natural(values[:, i]) for i, p in enumerate(self.numbers)], axis=1)

    def values(self, natural: Float[np.ndarray, "n p"]) -> Float[np.ndarray, "n p"]:
        """The inverse of ``natural``."""
        return np.stack([p.from_natural(natural[:, i]) for i, p in enumerate(self.numbers)], axis=1)

    def free(self, natural: Float[np.ndarray, "n p"]) -> Float[np.ndarray, "n p"]:
        """Coordinates without bounds: logit of the share of the range, or logarithm of the distance to a bound."""
        low, high = self.bounds
        columns = []
        for x, a, b in zip(natural.T, low, high, strict=True):
            if np.isfinite(a) and np.isfinite(b):
                share = np.clip((x - a) / (b - a), 1e-9, 1 - 1e-9)
                columns.append(np.log(share) - np.log1p(-share))
            elif np.isfinite(a) or np.isfinite(b):
                columns.append(np.log(np.maximum(x - a if np.isfinite(a) else b - x, 1e-12)))
            else:
                columns.append(x)
        return np.stack(columns, axis=1)

    def from_free(self, free: Float[np.ndarray, "n p"]) -> Float[np.ndarray, "n p"]:
        """The inverse of ``free``."""
        columns = []
        for z, a, b in zip(free.T, *self.bounds, strict=True):
            if np.isfinite(a) and np.isfinite(b):
                columns.append(a + (b - a) * expit(z))
            elif np.isfinite(a) or np.isfinite(b):
                columns.append(a + np.exp(z) if np.isfinite(a) else b - np.exp(z))
            else:
                columns.append(z)
        return np.stack(columns, axis=1)

    def log_jacobian(self, free: Float[np.ndarray, "n p"]) -> Float[np.ndarray, " n"]:
        """Log of the volume in natural coordinates over that in those without bounds."""
        total = np.zeros(len(free))
        for z, a, b in zip(free.T, *self.bounds, strict=True):
            if np.isfinite(a) and np.isfinite(b):
                total += np.log(b - a) + log_expit(z) + log_expit(-z)
            elif np.isfinite(a) or np.isfinite(b):
                total += z
        return total

    def log_density(self, natural: Float[np.ndarray, "n p"]) -> Float[np.ndarray, " n"]:
        """Log of the density in the natural coordinates; -inf beyond the bounds, NaN where the model has none."""
        low, high = self.bounds
        inside = ((natural >= low) & (natural <= high)).all(axis=1)
        found = np.full(len(natural), -np.inf)
        if inside.any():
            found[inside] = self._batched("density", natural[inside])[0]
        return found

    def log_free(self, free: Float[np.ndarray, "n p"]) -> Float[np.ndarray, " n"]:
        """Log of the density in the coordinates without bounds, up to the same constant; NaN where none."""
        low, high = self.bounds
        inside = np.clip(self.from_free(free), low, high)
        return self._batched("density", inside)[0] + self.log_jacobian(free)

    def draw(
        self, natural: Float[np.ndarray, "n p"], generator: np.random.Generator
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n q u"]]:
        """``log_density``, and one draw of the free spectra for each vector of numbers."""
        shape = len(natural), *self.setting.spectra.shape
        if not shape[1]:
            return self.log_density(natural), np.zeros(shape)
        low, high = self.bounds
        inside = ((natural >= low) & (natural <= high)).all(axis=1)
        logs, spectra = self._batched("draw", np.clip(natural, low, high), generator.random(shape))
        return np.where(inside, logs, -np.inf), spectra

    def quadrature(self, natural: Float[np.ndarray, "n p"]) -> tuple[np.ndarray, ...]:
        """``log_density`` within the bounds, and what free spectra are drawn from for each vector of numbers."""
        return self._batched("quadrature", natural)

    def placed(self, quadrature: tuple[np.ndarray, ...], uniform: Float[np.ndarray, "n q u"]) -> np.ndarray:
        """Free spectra from the last two parts of ``quadrature``, shape (n, Q, U)."""
        return self._batched("placed", *quadrature, uniform)[0]

    def predicted(
        self, natural: Float[np.ndarray, "n p"], spectra: Float[np.ndarray, "n q u"]
    ) -> tuple[np.ndarray, ...]:
        """Recorded values of each measurement, shape (n, D, L)."""
        return self._batched("predicted", natural, spectra)

    def _batched(self, what: str, *arguments: np.ndarray) -> tuple[np.ndarray, ...]:
        """Evaluate a compiled function in batches of one size, the last one filled up with copies."""
        count, dtype = len(arguments[0]), self.setting.data.center.dtype
        if what not in self.programs:
            function: dict[str, Any] = {
                "density": self.kind.log_density,
                "draw": self.kind.draw,
                "quadrature": self.kind.quadrature,
                "placed": self.kind.placed,
                "predicted": self.kind.predicted,
            }
            axes = (*[0] * len(arguments), None)
            self.programs[what] = jax.jit(jax.vmap(function[what], in_axes=axes))
        compiled = self.programs[what]
        found = []
        for first in range(0, count, LANES):
            chosen = np.minimum(np.arange(first, first + LANES), count - 1)
            batch = [np.asarray(a[chosen], dtype) for a in arguments]
            result = compiled(*batch, self.setting)
            found.append(result if isinstance(result, tuple) else (result,))
        # One wait for all.
        return tuple(
            np.concatenate([np.asarray(part, np.float64) for part in column])[:count]
            for column in zip(*found, strict=True)
        )

    @property
    def log_constant(self) -> float | None:
        """What makes it the likelihood times normalized priors; None if a prior cannot be normalized."""
        total = 0.0
        for weights in self.setting.data.weights:
            w = np.asarray(weights, np.float64)
            used = w[w > 0]
            each = math.log(2 * math.pi) / 2
            if self.kind.robust:
                nu = float(self.setting.tail)
                each = float(gammaln(nu / 2) - gammaln((nu + 1) / 2)) + math.log(nu * math.pi) / 2
            total += float(np.sum(np.log(used))) - len(used) * each
        for p in self.numbers:
            low, high = float(p.natural(p.lower)), float(p.natural(p.upper))
            if p.gaussian is None:
                if p.prior is not None and p.scale == "log":
                    low, high = float(p.lower), float(p.upper)
                if not np.isfinite(high - low):
                    return None
                total -= math.log(high - low)
                continue
            center, width, of_logarithm = p.gaussian
            ends = [float(np.log(v)) if of_logarithm and v > 0 else float(v) for v in (p.lower, p.upper)]
            if of_logarithm and p.lower <= 0:
                ends[0] = -np.inf
            share = float(ndtr((ends[1] - center) / width) - ndtr((ends[0] - center) / width))
            total -= math.log(width * math.sqrt(2 * math.pi) * max(share, 1e-300))
        return total + self._spectral_constant()

    def _spectral_constant(self) -> float:
        data = self.setting.data
        tight, center = (np.asarray(a, np.float64) for a in (data.spectral_tightness, data.spectral_center))
        low, high = (np.asarray(b, np.float64)[:, None] for b in data.spectral_bounds)
        safe = np.where(tight > 0, tight, 1.0)
        share = np.maximum(ndtr((high - center) * safe) - ndtr((low - center) * safe), 1e-300)
        gaussian = np.log(safe / math.sqrt(2 * math.pi) / share)
        return float(np.sum(np.where(tight > 0, gaussian, -np.log(high - low) + 0 * tight)))


_KEPT = Kept(32)


def density(
    problem: Problem,
    spectra: Float[np.ndarray, "q u"],
    noise: Parameter | None = None,
    student_t: float | None = None,
) -> Density:
    """The posterior density of a problem.

    Args:
        problem: what was fitted.
        spectra: the fitted free spectra.
        noise: the noise level if it is free.
        student_t: degrees of freedom of Student's t; None for Gaussian noise.
    """
    numbers = problem.numbers if noise is None else (*problem.numbers, noise)
    kind = Kind(
        problem.layout, noise is not None, student_t is not None, tuple(_powers(p) for p in problem.numbers)
    )
    dtype = problem.data.center.dtype
    tail = jnp.asarray(1.0 if student_t is None else student_t, dtype)
    setting = Setting(problem.data, jnp.asarray(spectra, dtype), tail)
    key = problem.layout.key, kind.noise, kind.robust, kind.powers, str(dtype)
    return Density(problem, numbers, kind, setting, _KEPT.get(key, dict))


def with_priors(problem: Problem, priors: dict[str, Any]) -> Problem:
    """The same problem with other priors of some numbers; those that had one lose it.

    Args:
        problem: what was fitted.
        priors: by name, as for ``fitting.free``: in degrees for angles.

    Raises:
        ValueError: there is no such number.
    """
    unknown = [name for name in priors if name not in {p.name for p in problem.numbers}]
    if unknown:
        known = ", ".join(p.name for p in problem.numbers)
        raise ValueError(f"priors name {unknown[0]!r}, which is not a number of the fit; expected one of {known}")
    numbers = []
    for p in problem.numbers:
        if p.name in priors:
            prior = as_prior(priors[p.name], p.name)
            p = replace(p, prior=prior if prior is None or p.unit != "rad" else prior.scaled(math.pi / 180))
        numbers.append(p)
    gaussian = [p.gaussian or (0.0, math.inf, False) for p in numbers]
    dtype = problem.data.center.dtype
    data = problem.data._replace(
        center=jnp.asarray([g[0] for g in gaussian], dtype),
        tightness=jnp.asarray([1 / g[1] for g in gaussian], dtype),
        bounds=jnp.asarray(
            [[p.natural(p.lower) for p in numbers], [p.natural(p.upper) for p in numbers]], dtype
        ).reshape(2, len(numbers)),
    )
    layout = replace(problem.layout, prior_of_logarithm=tuple(p.prior_of_logarithm for p in numbers))
    return replace(problem, numbers=tuple(numbers), layout=layout, data=data, programs=programs_for(layout, data))
