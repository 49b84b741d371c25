"""No-U-turn sampling of the numbers and the free spectra together, by blackjax.

For more unknowns than an ensemble can sample and where the nested grid does not apply, as Student's t with free
spectra. Coordinates are without bounds and whitened by the Gauss-Newton covariance at the fit.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float

from fitting.density import Density, Kind, Setting
from fitting.result import FitResult

CHAINS, _WARM_UP = 4, 400


class NutsDraws(NamedTuple):
    """Draws of all chains.

    Args:
        natural: natural coordinates of the numbers, shape (chains, n, P).
        spectra: free ones, shape (chains, n, Q, U).
        log_density: of the posterior there in natural coordinates, up to a constant, shape (chains, n).
        divergent: where a trajectory broke down, shape (chains, n).
        acceptance: mean of the acceptance rate.
        effective: how many independent draws they are worth, for each number.
    """

    natural: np.ndarray
    spectra: np.ndarray
    log_density: np.ndarray
    divergent: np.ndarray
    acceptance: float
    effective: np.ndarray


class _Bounds(NamedTuple):
    """Lower and upper bounds of all coordinates, shape (n,) each; infinite ones are replaced by 0."""

    low: Array
    high: Array


def nuts_draws(result: FitResult, density: Density, count: int, seed: int) -> NutsDraws:
    """About so many draws in four chains, each after 400 steps of adaptation.

    Raises:
        ValueError: blackjax is missing.
    """
    try:
        from blackjax.diagnostics import effective_sample_size
    except ImportError:
        raise ValueError("method 'nuts' needs blackjax; expected the extra: pip install 'vcavity[nuts]'") from None
    shape = density.setting.spectra.shape
    start, bounds, kinds = _start(result, density)
    # blackjax adds integers to floats.
    with jax.numpy_dtype_promotion("standard"):
        name = f"nuts {kinds}"
        if name not in density.programs:
            density.programs[name] = _programs(density.kind, kinds, shape)
        whiten, sample = density.programs[name]
        dtype = density.setting.data.center.dtype
        root = whiten(jnp.asarray(start, dtype), bounds, density.setting)
        each = -(-count // CHAINS)
        keys = jax.random.split(jax.random.key(seed), CHAINS)
        z, logs, divergent, acceptance = (
            np.asarray(part)
            for part in sample(keys, jnp.asarray(start, dtype), root, bounds, density.setting, steps=each)
        )
    numbers, spectra = z[..., : len(density.numbers)], z[..., len(density.numbers) :]
    with jax.numpy_dtype_promotion("standard"):
        effective = [float(effective_sample_size(jnp.asarray(column))) for column in np.moveaxis(numbers, -1, 0)]
    return NutsDraws(
        numbers,
        spectra.reshape(*z.shape[:2], *shape),
        logs,
        divergent,
        float(np.mean(acceptance)),
        np.array(effective),
    )


def _start(result: FitResult, density: Density) -> tuple[np.ndarray, _Bounds, tuple[str, ...]]:
    """The fit in the coordinates without bounds, the bounds, and which of these are finite."""
    problem, minima = density.problem, result.found.minima.take([0])
    natural = problem.natural(minima.values)[0]
    if density.kind.noise:
        natural = np.append(natural, density.noise_at(minima.chi_square[0]))
    spectral = np.asarray(density.setting.data.spectral_bounds, np.float64)
    each = np.asarray(minima.spectra[0]).shape[1]
    low, high = (np.concatenate([density.bounds[i], np.repeat(spectral[i], each)]) for i in (0, 1))
    values = np.concatenate([natural, np.asarray(minima.spectra[0]).reshape(-1)])
    kinds = tuple(
        {(True, True): "both", (True, False): "low", (False, True): "high", (False, False): "free"}[pair]
        for pair in zip(np.isfinite(low).tolist(), np.isfinite(high).tolist(), strict=True)
    )
    room = np.where(np.isfinite(high - low), high - low, 1.0)
    inside = np.clip(values, low + 1e-3 * room, high - 1e-3 * room)
    dtype = density.setting.data.center.dtype
    bounds = _Bounds(*(jnp.asarray(np.nan_to_num(b, posinf=0.0, neginf=0.0), dtype) for b in (low, high)))
    with np.errstate(invalid="ignore", divide="ignore"):
        shares = (inside - low) / (high - low)
        unbound = {
            "both": np.log(shares) - np.log1p(-shares),
            "low": np.log(inside - low),
            "high": np.log(high - inside),
            "free": inside,
        }
    return np.array([unbound[kind][i] for i, kind in enumerate(kinds)]), bounds, kinds


def _programs(kind: Kind, kinds: tuple[str, ...], shape: tuple[int, ...]) -> tuple[Callable[..., Any], ...]:
    """Compiled: the root of the covariance at the fit, and chains of draws."""
    import blackjax

    which = {name: jnp.asarray([k == name for k in kinds]) for name in ("both", "low", "high")}
    size = len(kinds) - shape[0] * shape[1]

    def natural(z: Float[Array, " n"], bounds: _Bounds) -> tuple[Array, Array]:
        """Natural coordinates, and the logarithm of their volume over that of z."""
        bounded, above, below = which["both"], which["low"], which["high"]
        safe = jnp.where(bounded, 0.0, z).astype(z.dtype)
        grown = jnp.exp(safe)
        wide = jnp.where(bounded, bounds.high - bounds.low, 1.0).astype(z.dtype)
        share = jax.nn.sigmoid(z)
        x = jnp.where(bounded, bounds.low + wide * share, z)
        x = jnp.where(above, bounds.low + grown, jnp.where(below, bounds.high - grown, x))
        slope = jnp.log(wide) + jax.nn.log_sigmoid(z) + jax.nn.log_sigmoid(-z)
        slope = jnp.where(bounded, slope, jnp.where(above | below, z, 0.0).astype(z.dtype))
        return x, jnp.sum(slope)

    def log_target(z: Array, bounds: _Bounds, setting: Setting) -> Array:
        x, volume = natural(z, bounds)
        found = kind.log_joint(x[:size], x[size:].reshape(shape), setting) + volume
        return jnp.where(jnp.isfinite(found), found, -jnp.inf)

    @jax.jit
    def whiten(z: Array, bounds: _Bounds, setting: Setting) -> Array:
        def misfits(z: Array) -> Array:
            x, _ = natural(z, bounds)
            recorded = kind.predicted(x[:size], x[size:].reshape(shape), setting)
            parts = [(r * w).ravel() for r, w in zip(recorded, setting.data.weights, strict=True)]
            data = setting.data
            spread = data.spectral_tightness * (x[size:].reshape(shape) - data.spectral_center)
            own = x[: size - kind.noise]
            parts += [kind.layout.prior_residuals(own, data).ravel(), spread.ravel()]
            return jnp.concatenate(parts)

        jacobian = jax.jacfwd(misfits)(z)
        # A logistic variable has the curvature 1/2 at its center; a noise level that of n values.
        square = jacobian.T @ jacobian + jnp.eye(len(z), dtype=z.dtype) / 2
        if kind.noise:
            count = sum(jnp.sum(w > 0, dtype=jnp.int32) for w in setting.data.weights)
            slope = jax.jacfwd(lambda z: natural(z, bounds)[0][size - 1])(z)
            square = square + 2 * jnp.asarray(count).astype(z.dtype) * jnp.outer(slope, slope)
        values, vectors = jnp.linalg.eigh(square)
        return vectors / jnp.sqrt(jnp.maximum(values, 1e-6))

    def chain(key: Array, start: Array, root: Array, bounds: _Bounds, setting: Setting, steps: int) -> Any:
        def whitened(u: Array) -> Array:
            return log_target(start + root @ u, bounds, setting)

        first, second, third = jax.random.split(key, 3)
        place = jax.random.normal(first, start.shape, start.dtype)
        place = jnp.where(jnp.isfinite(whitened(place)), place, jnp.zeros_like(place))
        adaptation = blackjax.window_adaptation(blackjax.nuts, whitened, target_acceptance_rate=0.85)
        (state, tuned), _ = adaptation.run(second, place, num_steps=_WARM_UP)
        kernel = blackjax.nuts(whitened, **tuned)

        def step(state: Any, key: Array) -> Any:
            state, info = kernel.step(key, state)
            x, volume = natural(start + root @ state.position, bounds)
            return state, (x, state.logdensity - volume, info.is_divergent, info.acceptance_rate)

        return lax.scan(step, state, jax.random.split(third, steps))[1]

    def sample(keys: Array, start: Array, root: Array, bounds: _Bounds, setting: Setting, *, steps: int) -> Any:
        return jax.vmap(lambda key: chain(key, start, root, bounds, setting, steps))(keys)

    return whiten, jax.jit(sample, static_argnames="steps")
