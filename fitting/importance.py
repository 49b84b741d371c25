"""Laplace importance sampling: draws from Student's t around every minimum, weighted by the density."""

import numpy as np
from scipy.special import logsumexp  # type: ignore[import-untyped]

from fitting.density import Density
from fitting.nested import Draws, resampled, student_draws, student_log_density
from fitting.result import FitResult


def importance_draws(result: FitResult, density: Density, count: int, generator: np.random.Generator) -> Draws:
    """Draws from the posterior by importance sampling; good for one mode, or several that the fit has found.

    Raises:
        ValueError: the fit does not determine its numbers, so that there is no covariance to draw with.
    """
    centers, roots = modes(result, density)
    shares = mode_weights(density, centers, roots)

    def proposed(total: int) -> tuple[np.ndarray, ...]:
        chosen = generator.choice(len(centers), total, p=shares)
        free, _ = student_draws(centers[chosen], roots[chosen], generator)
        natural = np.clip(density.from_free(free), *density.bounds)
        found, spectra = density.draw(natural, generator)
        log_proposal = mixture_log_density(free, centers, roots, shares)
        return natural, spectra, found, found + density.log_jacobian(free) - log_proposal

    return resampled(proposed, count, generator)


def modes(result: FitResult, density: Density) -> tuple[np.ndarray, np.ndarray]:
    """All minima in the coordinates without bounds, shape (m, P), and roots of their covariances.

    Raises:
        ValueError: no minimum has a covariance.
    """
    problem, minima = density.problem, result.found.minima
    size = len(problem.numbers)
    covariance = problem.normal(minima).covariance()
    natural = problem.natural(minima.values)
    if density.kind.noise:
        used = density.used
        level = density.noise_at(minima.chi_square)
        natural = np.concatenate([natural, level[:, None]], axis=1)
        whole = np.zeros((len(covariance), size + 1, size + 1))
        whole[:, :-1, :-1] = covariance * np.exp(2 * level)[:, None, None]
        whole[:, -1, -1] = 1 / (2 * max(used - size, 1))
        covariance = whole
    # Away from the bounds, where a step has no length in the free coordinates.
    low, high = density.bounds
    errors = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    room = np.where(np.isfinite(high - low), high - low, np.inf)
    units = np.where([p.scale == "log" for p in density.numbers], density.values(natural), 1.0)
    margin = np.minimum(np.nan_to_num(errors, nan=np.inf) / units / 2, room / 20)
    inside = np.clip(natural, low + margin, high - margin)
    free = density.free(inside)
    step = 1e-6
    slopes = (density.from_free(free + step) - density.from_free(free - step)) / (2 * step) * units
    scale = errors / slopes
    good = np.isfinite(scale).all(axis=1)
    if not good.any():
        raise ValueError(
            "the fit does not determine its parameters, so that there is nothing to draw with; expected a prior, "
            "a parameter less, or more to measure"
        )
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = covariance / (errors[:, :, None] * errors[:, None, :])
    correlation = correlation[good] + 1e-10 * np.eye(len(density.numbers))
    return free[good], scale[good][:, :, None] * np.linalg.cholesky(correlation)


def mode_weights(density: Density, centers: np.ndarray, roots: np.ndarray) -> np.ndarray:
    """Shares of the modes in the posterior, by Laplace's method; none is left out altogether."""
    logs = density.log_free(centers) + np.sum(np.log(np.diagonal(roots, axis1=1, axis2=2)), axis=1)
    logs = np.where(np.isfinite(logs), logs, -np.inf)
    if not np.isfinite(logs).any():
        return np.full(len(centers), 1 / len(centers))
    shares = np.exp(logs - logsumexp(logs))
    shares = np.maximum(shares, 0.02)
    return np.asarray(shares / shares.sum())


def mixture_log_density(
    free: np.ndarray, centers: np.ndarray, roots: np.ndarray, weights: np.ndarray
) -> np.ndarray:
    """Log density of a mixture of Student's t distributions."""
    parts = [
        np.log(w) + student_log_density(free, center, root)
        for center, root, w in zip(centers, roots, weights, strict=True)
    ]
    return np.asarray(logsumexp(parts, axis=0))
