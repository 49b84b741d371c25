"""What the slopes of the model at a point say about all unknowns: errors, correlations, what is not determined.

The free spectra are eliminated wavelength by wavelength; no matrix is larger than the count of the numbers.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

SINGULAR = 1e-6
"""Smallest singular value of the scaled Jacobian that rounding cannot fake."""

_NO_INFORMATION = 1e-12


@dataclass(frozen=True)
class LocalInformation:
    """What the slopes of the model at a point say about all unknowns.

    Args:
        singular_values: of the Jacobian of the numbers with the free spectra projected out, its columns scaled
            by their lengths before that, descending: shares of what is not mimicked by the others.
        covariance: of the numbers; NaN if they are not determined.
        singular: whether that is so.
        spectral_errors: standard errors of the free spectra, shape (Q, U), NaN where not determined.
        determined: at which wavelengths the data determine the free spectra for known numbers, shape (U,).
    """

    singular_values: np.ndarray
    covariance: np.ndarray
    singular: bool
    spectral_errors: np.ndarray
    determined: np.ndarray

    @property
    def standard_errors(self) -> np.ndarray:
        """Square roots of the covariance's diagonal, NaN where singular."""
        with np.errstate(invalid="ignore"):
            return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> np.ndarray:
        """The covariance with a unit diagonal."""
        errors = self.standard_errors
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(self.covariance / np.outer(errors, errors))


@dataclass(frozen=True)
class Normal:
    """Normal equations at n points, with the free spectra eliminated.

    Args:
        reduced: Schur complements, shape (n, P, P), priors included.
        lengths: of the columns of the Jacobian, shape (n, P).
        response: how the spectra follow the numbers, shape (n, U, Q, P).
        alone: inverse of the spectra's own blocks, shape (n, U, Q, Q).
        determined: whether the data determine the spectra at a wavelength for known numbers, shape (n, U).
    """

    reduced: np.ndarray
    lengths: np.ndarray
    response: np.ndarray
    alone: np.ndarray
    determined: np.ndarray

    def covariance(self, held: Bool[np.ndarray, " p"] | None = None) -> Float[np.ndarray, "n p p"]:
        """Covariance of the numbers that are not held: zero for those, NaN where the rest is not determined."""
        count = self.reduced.shape[-1]
        free = np.arange(count) if held is None else np.flatnonzero(~held)
        whole = np.zeros_like(self.reduced)
        if not len(free):
            return whole
        values, vectors, lengths = self._scaled(free)
        bad = (values[:, 0] <= SINGULAR**2) | ~np.isfinite(values).all(axis=1)
        safe = np.where(bad[:, None], 1.0, values)
        half = vectors / np.sqrt(safe)[:, None, :] / lengths[:, :, None]
        found = np.where(bad[:, None, None], np.nan, half @ half.transpose(0, 2, 1))
        whole[np.ix_(np.arange(len(whole)), free, free)] = found
        return whole

    def singular_values(self) -> Float[np.ndarray, "n p"]:
        """See ``LocalInformation``."""
        values = self._scaled(np.arange(self.reduced.shape[-1]))[0]
        return np.sqrt(np.clip(values, 0, None))[:, ::-1]

    def _scaled(self, free: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        lengths = np.where(self.lengths[:, free] > 0, self.lengths[:, free], 1.0)
        square = self.reduced[:, free[:, None], free] / (lengths[:, :, None] * lengths[:, None, :])
        good = np.isfinite(square).all(axis=(1, 2))
        values, vectors = np.linalg.eigh(np.where(good[:, None, None], square, np.eye(len(free))))
        return np.where(good[:, None], values, np.nan), vectors, lengths

    def spectral_variance(self, covariance: Float[np.ndarray, "n p p"]) -> Float[np.ndarray, "n q u"]:
        """Variances of the free spectra for a covariance of the numbers."""
        own = np.diagonal(self.alone, axis1=2, axis2=3)
        shared = np.einsum("nuqp,npr,nuqr->nuq", self.response, covariance, self.response)
        return np.where(self.determined[..., None], own + shared, np.inf).transpose(0, 2, 1)


def normal_equations(
    matrix: Float[np.ndarray, "n b m m"],
    prior_slopes: Float[np.ndarray, "n p"],
    units: Float[np.ndarray, "n p"],
    free_spectra: int,
) -> Normal:
    """Normal equations in the scene's units.

    Args:
        matrix: products of the Jacobian and the residual, see ``arrow.End``, in natural coordinates.
        prior_slopes: derivatives of the numbers' prior residuals, in natural coordinates.
        units: derivatives of the numbers with respect to their natural coordinates.
        free_spectra: Q.
    """
    numbers = matrix.shape[-1] - free_spectra - 1
    points, blocks = matrix.shape[:2]
    square = matrix[:, :, :numbers, :numbers].sum(axis=1)
    square = square + prior_slopes[:, :, None] * prior_slopes[:, None, :] * np.eye(numbers)
    square = square / (units[:, :, None] * units[:, None, :])
    lengths = np.sqrt(np.diagonal(square, axis1=1, axis2=2))
    if not free_spectra:
        return Normal(
            square,
            lengths,
            np.zeros((points, blocks, 0, numbers)),
            np.zeros((points, blocks, 0, 0)),
            np.ones((points, blocks), bool),
        )
    own = matrix[:, :, numbers:-1, numbers:-1]
    cross = matrix[:, :, numbers:-1, :numbers] / units[:, None, None, :]
    finite = np.isfinite(own).all(axis=(2, 3))
    scale = np.sqrt(np.diagonal(own, axis1=2, axis2=3))
    safe = np.where(scale > 0, scale, 1.0)
    scaled = own / (safe[..., :, None] * safe[..., None, :])
    values, vectors = np.linalg.eigh(np.where(finite[..., None, None], scaled, np.eye(free_spectra)))
    kept = values > _NO_INFORMATION
    inverse = (vectors * np.where(kept, 1 / np.where(kept, values, 1.0), 0.0)[..., None, :]) @ vectors.swapaxes(
        2, 3
    )
    inverse = inverse / (safe[..., :, None] * safe[..., None, :])
    response = inverse @ cross
    reduced = square - np.einsum("nuqp,nuqr->npr", cross, response)
    determined = kept.all(axis=-1) & (scale > 0).all(axis=-1) & finite
    return Normal(reduced, lengths, response, inverse, determined)


def local_information(normal: Normal, index: int = 0) -> LocalInformation:
    """What the normal equations say at one of their points.

    A pseudo-inverse would report a small error exactly where a number is not determined at all; here the
    covariance is NaN then.
    """
    one = Normal(*(part[index : index + 1] for part in vars(normal).values()))
    covariance = one.covariance()
    values = one.singular_values()[0]
    singular = bool(np.isnan(covariance).any()) or not (one.lengths[0] > 0).all()
    if singular:
        covariance = np.full_like(covariance, np.nan)
    variance = one.spectral_variance(covariance)[0]
    errors = np.sqrt(np.where(np.isfinite(variance), variance, np.nan))
    return LocalInformation(values, covariance[0], singular, errors, one.determined[0])
