"""Samples of a posterior: the nested grid where it applies, an ensemble or importance sampling elsewhere."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from os import PathLike
from typing import Any

import numpy as np

from fitting import ensemble
from fitting.density import NOISE, Density, density, with_priors
from fitting.importance import importance_draws
from fitting.nested import Draws, nested_draws, reason_against
from fitting.nuts import NutsDraws, nuts_draws
from fitting.parameters import Parameter
from fitting.posterior import Posterior, assembled
from fitting.priors import as_prior
from fitting.problem import Problem
from fitting.result import FitResult
from fitting.solve import solved

METHODS = ("auto", "nested", "emcee", "importance", "nuts")
_FAR = 6.0
_FEWEST_EFFECTIVE = 200


@dataclass(frozen=True)
class _Asked:
    """How many draws, and from which random numbers."""

    draws: int
    seed: int


def sample_posterior(
    result: FitResult | Problem,
    method: str | None = None,
    *,
    draws: int = 2000,
    walkers: int | None = None,
    steps: int | None = None,
    most_steps: int = 20_000,
    chain: str | PathLike[str] | None = None,
    noise: str | tuple[float | int, float | int] | None = None,
    student_t: float | int | None = None,
    priors: Mapping[str, Any] | None = None,
    seed: int = 0,
    progress: bool = False,
) -> Posterior:
    """Sample the posterior of a fit's parameters.

    Free parameters have their priors; without one a parameter is uniform within its bounds, a roughness in its
    logarithm. Spectra that are free at each wavelength are integrated out by quadrature and drawn afterwards.

    Args:
        result: of ``fit``; a ``Problem``, as ``FitResult.problem``, is fitted first.
        method: "nested", exact where one number is searched and the rest is Gaussian or falls apart into
            wavelengths, and safe with several modes; "emcee", an ensemble with differential-evolution and
            snooker moves, for up to six numbers; "importance", Laplace importance sampling, for more; "nuts", a
            gradient-based sampler of everything at once (the extra ``nuts``). "auto" (the default) takes the
            first that applies, and emcee if ``walkers``, ``steps`` or ``chain`` is given.
        draws: how many to keep; an ensemble keeps all of its own if it is thinned to no less.
        walkers: of the ensemble, even, at least twice the parameters; 32 or four times the parameters if None.
        steps: of the ensemble; None to run until it is 50 autocorrelation times long.
        most_steps: then, at most.
        chain: HDF5 file that keeps the ensemble step by step. If it exists the chain goes on where it stopped.
        noise: "known", or "free": the ratio of the true noise to the stated one is a parameter, uniform in its
            logarithm from 0.1 to 10, or between other bounds, (lower, upper). None for "free" if the fit had to
            estimate the uncertainty.
        student_t: degrees of freedom of Student's t instead of Gaussian noise, for spectra with outliers; 4 is
            usual.
        priors: other priors than those of the fit, by name, as in ``fitting.free`` (degrees for angles).
        seed: of the random numbers.
        progress: show a bar with the time left on standard error.

    Raises:
        OSError: the chain file cannot be written.
        ValueError: the method does not apply, or an argument does not fit; the message says what is expected.
    """
    asked = _Asked(_whole("draws", draws, 100), _whole("seed", seed, 0))
    if method is None:
        method = "auto"
    if method not in METHODS:
        raise ValueError(f"method is {method!r}; expected one of {', '.join(METHODS)}")
    if isinstance(result, Problem):
        result = solved(result)
    level = _noise_level(noise, result.uncertainty_estimated)
    if student_t is not None and not 1 <= student_t < np.inf:
        raise ValueError(f"student_t is {student_t!r}; expected at least 1 degree of freedom, 4 is usual")
    if priors:
        result = _with_priors(result, priors)
    own = density(
        result.problem,
        result.found.minima.spectra[0],
        level,
        None if student_t is None else float(student_t),
    )
    if not own.numbers:
        raise ValueError("the fit has no free number; expected one, as the dihedral angle")
    if own.kind.robust and own.kind.layout.free_spectra and method != "nuts":
        raise ValueError(
            "spectra that are free at each wavelength cannot be integrated out of Student's t; expected "
            "method='nuts', or a smooth spectrum"
        )
    ensemble_wanted = walkers is not None or steps is not None or chain is not None
    against = reason_against(result, own)
    if method == "auto":
        method = (
            "emcee"
            if ensemble_wanted
            else "nested"
            if against is None
            else "emcee"
            if len(own.numbers) <= ensemble.MOST_NUMBERS
            else "importance"
        )
    if ensemble_wanted and method != "emcee":
        raise ValueError(f"walkers, steps and chain are an ensemble's; expected method='emcee', not {method!r}")
    if method == "nested" and against is not None:
        raise ValueError(f"the nested grid does not apply: {against}; expected method='emcee' or 'importance'")
    generator = np.random.default_rng(asked.seed)
    if method == "emcee":
        if steps is not None:
            _whole("steps", steps, 10)
        found = ensemble.run(
            result,
            own,
            walkers=walkers,
            steps=steps,
            most_steps=most_steps,
            seed=asked.seed,
            path=chain,
            progress=progress,
        )
        return _of_chain(result, own, found, asked, generator, against is None)
    if method == "nuts":
        return _of_nuts(result, own, nuts_draws(result, own, asked.draws, asked.seed))
    drawn = (nested_draws if method == "nested" else importance_draws)(result, own, asked.draws, generator)
    return _of_draws(result, own, drawn, method, generator)


def log_evidence(result: FitResult) -> float | None:
    """Logarithm of the likelihood of a fit's values averaged over the priors of its parameters.

    Args:
        result: of ``fit``. Where it had to estimate the uncertainty, that is averaged over, too.

    Returns:
        None if a prior has no finite volume: a parameter without bounds needs one.

    Raises:
        ValueError: the fit has no free number, or does not determine its numbers.
    """
    own = density(result.problem, result.found.minima.spectra[0], _noise_level(None, result.uncertainty_estimated))
    method = "nested" if own.numbers and reason_against(result, own) is None else "importance"
    return sample_posterior(result, method).log_evidence


def _noise_level(noise: Any, estimated: bool) -> Parameter | None:
    """The noise level as a parameter; None if it is known."""
    if noise is None:
        noise = "free" if estimated else "known"
    if isinstance(noise, str):
        if noise not in ("known", "free"):
            raise ValueError(f"noise is {noise!r}; expected 'known', 'free', or bounds (lower, upper)")
        return NOISE if noise == "free" else None
    low, high = (float(end) for end in noise)
    if not 0 < low < high < np.inf:
        raise ValueError(f"noise is {noise!r}; expected bounds 0 < lower < upper of its ratio to the stated one")
    return replace(NOISE, lower=low, upper=high, start=float(np.sqrt(low * high)))


def _whole(name: str, value: Any, least: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < least:
        raise ValueError(f"{name} is {value!r}; expected a whole number of at least {least}")
    return value


def _with_priors(result: FitResult, priors: Mapping[str, Any]) -> FitResult:
    """A result whose problem has other priors, which must allow the fit."""
    known = {p.name: p for p in result.problem.numbers}
    for name, given in priors.items():
        prior = as_prior(given, name)
        if prior is None or name not in known:
            continue
        parameter = known[name]
        value = float(parameter.displayed(result.estimates[name].value))
        error = float(parameter.displayed(result.estimates[name].standard_error))
        low, high = prior.limits
        far = not low <= value <= high
        if prior.gaussian is not None:
            center, width, of_logarithm = prior.gaussian
            place = np.log(value) if of_logarithm else value
            own = (error / value if of_logarithm else error) if np.isfinite(error) else 0.0
            far = far or abs(place - center) > _FAR * np.hypot(width, own)
        if far:
            raise ValueError(
                f"the prior of {name}, {prior!r}, excludes the fit, {value:.4g}; expected one that allows it, "
                "or a new fit with this prior"
            )
    return replace(result, problem=with_priors(result.problem, dict(priors)))


def _of_draws(
    result: FitResult, own: Density, drawn: Draws, method: str, generator: np.random.Generator
) -> Posterior:
    constant = own.log_constant
    warnings = []
    good = drawn.effective >= 0.1 * len(drawn.natural)
    if not good:
        warnings.append(
            f"the weights are uneven: {len(drawn.natural)} draws are worth {drawn.effective:.0f}; raise draws, "
            "or use method='emcee'"
        )
    if own.kind.layout.free_spectra > 1:
        warnings.append("two values per wavelength are integrated by Laplace's method around one branch")
    return assembled(
        result,
        own,
        method,
        drawn.natural[None],
        drawn.spectra[None],
        drawn.log_density[None],
        effective=np.full(len(own.numbers), drawn.effective),
        time=None,
        acceptance=None,
        log_evidence=None if constant is None else drawn.log_integral + constant,
        warnings=warnings,
        converged=good,
        message=_worth(drawn) if good else "Too few draws carry the weight.",
    )


def _worth(drawn: Draws) -> str:
    if drawn.effective >= 0.999 * len(drawn.natural):
        return "The draws are independent."
    return f"The draws are weighted, and worth {drawn.effective:.0f} independent ones."


def _of_nuts(result: FitResult, own: Density, drawn: NutsDraws) -> Posterior:
    lost = int(drawn.divergent.sum())
    warnings = []
    if lost:
        warnings.append(
            f"{lost} of {drawn.divergent.size} trajectories diverged: the posterior has corners that the sampler "
            "does not reach; compare with another method"
        )
    enough = float(np.min(drawn.effective)) >= _FEWEST_EFFECTIVE
    worth = f"The draws are worth {np.min(drawn.effective):.0f} independent ones"
    return assembled(
        result,
        own,
        "nuts",
        drawn.natural,
        drawn.spectra,
        drawn.log_density,
        effective=drawn.effective,
        time=None,
        acceptance=drawn.acceptance,
        log_evidence=None,
        warnings=warnings,
        converged=enough and not lost,
        message=f"{worth}." if enough else f"{worth}, but {_FEWEST_EFFECTIVE} are needed: raise draws.",
        divergent=drawn.divergent,
    )


def _of_chain(
    result: FitResult,
    own: Density,
    chain: ensemble.Chain,
    asked: _Asked,
    generator: np.random.Generator,
    checked: bool,
) -> Posterior:
    kept, walkers, size = chain.free.shape
    effective = np.where(
        np.isfinite(chain.autocorrelation_time), kept * walkers / chain.autocorrelation_time, np.nan
    )
    # More than the draws asked for would only cost time where spectra are drawn.
    thin = max(1, kept * walkers // max(4 * asked.draws, 1)) if own.kind.layout.free_spectra else 1
    free, logs = chain.free[::-1][::thin][::-1], chain.log_density[::-1][::thin][::-1]
    flat = free.reshape(-1, size)
    natural = own.from_free(flat)
    _, spectra = own.draw(natural, generator)
    warnings = []
    if size > ensemble.MOST_NUMBERS:
        warnings.append(
            f"{size} parameters are more than an ensemble can sample ({ensemble.MOST_NUMBERS}), it will not "
            "converge: use method='nested', 'importance' or 'nuts'"
        )
    still = (np.ptp(chain.free, axis=0) == 0).all(axis=1)
    if still.any():
        warnings.append(f"{int(still.sum())} of {walkers} walkers never moved")
    if chain.lost:
        warnings.append(f"the model gave no number at {chain.lost} proposals, which were refused")
    time = chain.autocorrelation_time
    if chain.long_enough:
        message = f"The chain is {kept / np.max(time):.0f} autocorrelation times long."
    elif np.isfinite(time).all():
        more = int(np.ceil((ensemble.LENGTHS + 5) * np.max(time))) - chain.steps
        message = (
            f"The chain is {kept / np.max(time):.0f} autocorrelation times long, but {ensemble.LENGTHS} are "
            f"needed: about {max(more, 1)} more steps"
        )
    else:
        message = "The chain is too short to tell its autocorrelation time: take more steps"
    jacobian = own.log_jacobian(flat).reshape(logs.shape)
    if checked and chain.long_enough:
        warnings += _disagreements(result, own, natural, effective, generator)
    chains = natural.reshape(*free.shape).transpose(1, 0, 2)
    return assembled(
        result,
        own,
        "emcee",
        chains,
        spectra.reshape(*free.shape[:2], *spectra.shape[1:]).swapaxes(0, 1),
        (logs - jacobian).T,
        effective=effective,
        time=time,
        acceptance=chain.acceptance,
        log_evidence=None,
        warnings=warnings,
        converged=chain.long_enough and not still.any(),
        message=message,
    )


def _disagreements(
    result: FitResult, own: Density, natural: np.ndarray, effective: np.ndarray, generator: np.random.Generator
) -> list[str]:
    """Where the ensemble's means differ from those of the nested grid by more than chance allows."""
    exact = nested_draws(result, own, 2000, generator)
    found = []
    for i, name in enumerate(own.names):
        spread = float(np.std(exact.natural[:, i]))
        apart = abs(float(np.mean(natural[:, i]) - np.mean(exact.natural[:, i])))
        allowed = 5 * spread * np.sqrt(1 / effective[i] + 1 / exact.effective)
        if apart > allowed:
            found.append(
                f"the mean of {name} differs from the nested grid's by {apart / spread:.2g} standard deviations: "
                "trust method='nested'"
            )
    return found
