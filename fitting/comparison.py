"""Several models of one measurement side by side: which one the data prefer, and whether any describes them.

The likelihood is that of the n measured values alone: priors belong to the estimate, not to the information
criteria. With known standard uncertainties σ, ln L = -χ²/2 - Σ ln σ - (n/2) ln 2π; with an estimated σ each model
is given its own best one, ln L = -(n/2) (ln(2π S/n) + 1) with the sum S of squared misfits, and σ is one more
unknown.

Then AIC = 2k - 2 ln L and BIC = k ln n - 2 ln L for k unknowns, where each value of a free spectrum and each
coefficient of a form counts as one, whether or not it has a prior. The correction of AIC for small samples,
2k(k + 1)/(n - k - 1), holds for an estimated σ and n > k + 1; with a known σ AIC needs none.

References:
    [Burnham2002, sections 2.2 to 2.9] for the criteria, the weights and the rules of thumb in the verdict;
    [Schwarz1978] for BIC; [Kass1995] for the scale of evidence.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fitting.assembly import flattened
from fitting.identifiability import p_value
from fitting.residuals import ALARM, residual_structure
from fitting.result import FitResult, plain
from fitting.rival import adapted
from fitting.sampling import log_evidence

_TOO_CLOSE = 2.0
_CLEAR = 10.0


@dataclass(frozen=True, eq=False)
class Model:
    """One model of a comparison.

    Args:
        name: as given.
        result: its fit.
        chi_square: of the n values at the best fit, without priors.
        degrees_of_freedom: of the fit, values and priors less unknowns.
        p_value: chance that a true model fits at least as badly, priors included; None if the model cannot be
            tested, because the uncertainty is estimated or no degree of freedom is left.
        unknowns: k; an estimated uncertainty is one of them.
        values: n.
        log_likelihood: ln L of the values at the best fit, normalized.
        aic: 2k - 2 ln L.
        aicc: with the correction for small samples; None where that does not apply (see the module).
        bic: k ln n - 2 ln L.
        delta: of the comparison's criterion, less its smallest.
        delta_bic: BIC less the smallest.
        weight: Akaike weight, exp(-delta/2) over the sum of all models'.
        log_evidence: logarithm of the likelihood averaged over the priors; None if not asked for, or if a prior
            has no finite volume.
        structure: probability that independent noise looks as structured along the wavelength as the residuals
            do, see ``residual_structure``; None if there is nothing to test.
    """

    name: str
    result: FitResult
    chi_square: float
    degrees_of_freedom: int
    p_value: float | None
    unknowns: int
    values: int
    log_likelihood: float
    aic: float
    aicc: float | None
    bic: float
    delta: float
    delta_bic: float
    weight: float
    log_evidence: float | None
    structure: float | None


@dataclass(frozen=True, eq=False)
class Comparison:
    """Models of one measurement, best first.

    Args:
        models: by the criterion.
        criterion: "AICc" if it applies to every model, else "AIC".
    """

    models: tuple[Model, ...]
    criterion: str

    @property
    def best(self) -> Model:
        """The model with the smallest criterion. It need not be good: see ``verdict``."""
        return self.models[0]

    def __getitem__(self, name: str) -> Model:
        """A model by its name.

        Raises:
            KeyError: there is none of that name.
        """
        for model in self.models:
            if model.name == name:
                return model
        raise KeyError(name)

    def verdict(self) -> tuple[str, ...]:
        """What follows, one sentence each."""
        said = [_choice(self), *_tests(self)]
        if self.best.result.status != "converged":
            said.append(
                f"{self.best.name} has no trustworthy answer ({self.best.result.status}): "
                f"{self.best.result.message}"
            )
        if self.best.structure is not None and self.best.structure < ALARM:
            said.append(
                f"the residuals of {self.best.name} are structured along the wavelength (probability "
                f"{self.best.structure:.1g}): the criteria, which take the noise for independent, exaggerate "
                "differences"
            )
        return tuple(said)

    def summary(self) -> str:
        """A table, the best model first, and the verdict in words."""
        evident = any(m.log_evidence is not None for m in self.models)
        head = [
            "model",
            "chi-square",
            "dof",
            "p",
            "k",
            "ln L",
            self.criterion,
            "difference",
            "weight",
            "BIC diff.",
        ]
        rows = [head + (["ln evidence"] if evident else [])]
        for m in self.models:
            criterion = m.aic if self.criterion == "AIC" else m.aicc
            row = [
                m.name,
                f"{m.chi_square:.4g}",
                str(m.degrees_of_freedom),
                "-" if m.p_value is None else f"{m.p_value:.2g}",
                str(m.unknowns),
                f"{m.log_likelihood:.2f}",
                f"{criterion:.2f}",
                f"{m.delta:.2f}",
                f"{m.weight:.3f}",
                f"{m.delta_bic:.2f}",
            ]
            if evident:
                row.append("-" if m.log_evidence is None else f"{m.log_evidence:.2f}")
            rows.append(row)
        widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
        lines = [
            "  ".join([row[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(row[1:], widths[1:], strict=True))])
            for row in rows
        ]
        return "\n".join([line.rstrip() for line in lines] + [f"verdict: {one}" for one in self.verdict()])

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers; None for what does not exist. Each model's parameters in the units of ``fit.json``."""
        models = []
        for m in self.models:
            content = {
                field.name: getattr(m, field.name) for field in dataclasses.fields(m) if field.name != "result"
            }
            fitted = m.result.to_dict()
            models.append(content | {key: fitted[key] for key in ("status", "describes_data", "parameters")})
        shown: dict[str, Any] = plain(
            {
                "criterion": self.criterion,
                "best": self.best.name,
                "verdict": list(self.verdict()),
                "models": models,
            }
        )
        return shown


def compare_models(
    scenes: Mapping[str, Any],
    measurement: Any,
    parameters: Any,
    *,
    standard_uncertainty: float | int | None = None,
    evidence: bool = False,
    tolerance: float = 1e-8,
    max_steps: int = 60,
) -> Comparison:
    """Fit several models to one measurement and compare them.

    Args:
        scenes: the models by name, see ``rivals`` for the usual ones. As in ``fit``, each may be a list or
            dictionary of scenes if there are several measurements.
        measurement: as in ``fit``; all models are fitted to the same values.
        parameters: free ones: one list for all models, of which each takes what has a place in it; or a dictionary
            of lists by the models' names, which are taken as they are.
        standard_uncertainty: as in ``fit``.
        evidence: also integrate each model's likelihood over its priors, which takes seconds for each.
        tolerance: bound on the models' numerical error.
        max_steps: most steps of each descent to a minimum.

    Raises:
        ValueError: there is no model, a name is not in both dictionaries, a parameter has a place in no model, a
            fit is refused (the message begins with the model's name), or the models are not fitted to the same
            values.
    """
    from fitting.solve import fit

    if not scenes:
        raise ValueError("no model to compare; expected at least one scene by its name")
    results = {}
    for name, own in _chosen(scenes, parameters).items():
        try:
            results[name] = fit(
                scenes[name],
                measurement,
                own,
                standard_uncertainty=standard_uncertainty,
                tolerance=tolerance,
                max_steps=max_steps,
            )
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None
    return compare_results(results, evidence=evidence)


def compare_results(results: Mapping[str, FitResult], *, evidence: bool = False) -> Comparison:
    """Compare fits of the same measured values.

    Args:
        results: of ``fit``, by the models' names.
        evidence: see ``compare_models``.

    Raises:
        ValueError: there is none, or they are not fits of the same values with the same uncertainties.
    """
    if not results:
        raise ValueError("no model to compare; expected at least one fit by its name")
    _require_same_data(results)
    counted = {name: _counted(result) for name, result in results.items()}
    criterion = "AICc" if all(c["aicc"] is not None for c in counted.values()) else "AIC"
    costs = {name: c[criterion.lower()] for name, c in counted.items()}
    least, least_bic = min(costs.values()), min(c["bic"] for c in counted.values())
    weights = {name: math.exp((least - cost) / 2) for name, cost in costs.items()}
    models = []
    for name, result in results.items():
        structure = residual_structure(result)
        models.append(
            Model(
                name=name,
                result=result,
                **counted[name],
                delta=costs[name] - least,
                delta_bic=counted[name]["bic"] - least_bic,
                weight=weights[name] / sum(weights.values()),
                log_evidence=log_evidence(result) if evidence else None,
                structure=None if structure is None else structure.probability,
            )
        )
    return Comparison(tuple(sorted(models, key=lambda m: m.delta)), criterion)


def _chosen(scenes: Mapping[str, Any], parameters: Any) -> dict[str, list[Any]]:
    """The free parameters of each model."""
    if isinstance(parameters, Mapping):
        if set(parameters) != set(scenes):
            raise ValueError(
                f"parameters are for the models {', '.join(map(str, parameters))}; expected them for "
                f"{', '.join(map(str, scenes))}"
            )
        return {name: flattened(parameters[name]) for name in scenes}
    given = flattened(parameters)
    chosen: dict[str, list[Any]] = {}
    for name, scene in scenes.items():
        several = isinstance(scene, Mapping | Sequence)
        # Which of several scenes a parameter belongs to is for the fit to say.
        chosen[name] = given if several else adapted(scene, given)
    for p in given:
        if not any(p.name == kept.name for own in chosen.values() for kept in own):
            raise ValueError(
                f"parameter {p.name!r} has a place in none of the models {', '.join(map(str, scenes))}"
            )
    return chosen


def _fitted_values(result: FitResult) -> list[np.ndarray]:
    """Which measured values a fit used, shape (D, L) for each measurement."""
    return [np.asarray(w) > 0 for w in result.problem.data.weights]


def _require_same_data(results: Mapping[str, FitResult]) -> None:
    names = list(results)
    first = results[names[0]]
    for name in names[1:]:
        other = results[name]
        if other.uncertainty_estimated != first.uncertainty_estimated:
            raise ValueError(
                f"the uncertainty is estimated in one of {names[0]} and {name}; expected both or none"
            )
        same = len(first.measurements) == len(other.measurements)
        if same:
            for a, b in zip(first.measurements, other.measurements, strict=True):
                same &= np.array_equal(a.reflectance_factor, b.reflectance_factor, equal_nan=True)
                if not first.uncertainty_estimated:
                    sigma = [np.asarray(m.standard_uncertainty, np.float64) for m in (a, b)]
                    same &= np.array_equal(sigma[0], sigma[1], equal_nan=True)
        used = zip(_fitted_values(first), _fitted_values(other), strict=same)
        if not same or not all(np.array_equal(*pair) for pair in used):
            raise ValueError(
                f"{names[0]} and {name} are not fitted to the same values; expected one measurement with the same "
                "uncertainties, and a free wavelength_shift, which leaves out the ends, in all models or none"
            )


def _counted(result: FitResult) -> dict[str, Any]:
    """The likelihood of the data and what is made of it."""
    problem = result.problem
    weights = [np.asarray(w, np.float64) for w in problem.data.weights]
    predicted = [p[0] for p in result.found.minima.predicted]
    pairs = list(zip(problem.data.values, predicted, weights, strict=True))
    misfits = [np.where(w > 0, np.asarray(v, np.float64) - p, 0.0) for v, p, w in pairs]
    chi_square = float(sum(np.sum((m * w) ** 2) for m, w in zip(misfits, weights, strict=True)))
    n = int(sum(np.sum(w > 0) for w in weights))
    k = problem.unknowns(weights)
    dof = result.degrees_of_freedom
    if result.uncertainty_estimated:
        k += 1
        squares = float(sum(np.sum(m**2) for m in misfits))
        # A perfect fit is not known to be better than the model's numerical error.
        variance = max(squares / n, problem.layout.tolerance**2)
        log_likelihood = -n / 2 * (math.log(2 * math.pi * variance) + 1)
    else:
        logs = float(sum(np.sum(np.log(w[w > 0])) for w in weights))
        log_likelihood = -chi_square / 2 + logs - n / 2 * math.log(2 * math.pi)
    aic = 2 * k - 2 * log_likelihood
    corrected = result.uncertainty_estimated and n > k + 1
    testable = dof > 0 and not result.uncertainty_estimated
    return {
        "chi_square": chi_square,
        "degrees_of_freedom": dof,
        "p_value": p_value(result.chi_square, dof) if testable else None,
        "unknowns": k,
        "values": n,
        "log_likelihood": log_likelihood,
        "aic": aic,
        "aicc": aic + 2 * k * (k + 1) / (n - k - 1) if corrected else None,
        "bic": k * math.log(n) - 2 * log_likelihood,
    }


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _choice(comparison: Comparison) -> str:
    """Whether the data choose."""
    models, criterion = comparison.models, comparison.criterion
    if len(models) == 1:
        return "there is one model, and nothing to compare it with"
    close = [m.name for m in models if m.delta < _TOO_CLOSE]
    if len(close) > 1:
        said = f"the data do not choose between {_listed(close)} ({criterion} within {_TOO_CLOSE:g})"
    else:
        second = models[1]
        strength = "lean to" if second.delta < _CLEAR else "speak for"
        said = f"the data {strength} {close[0]} ({criterion} of {second.name}, the next, {second.delta:+.1f})"
    by_bic = min(models, key=lambda m: m.delta_bic)
    if models[0].delta_bic >= _TOO_CLOSE:
        said += f"; BIC, which charges more for unknowns, prefers {by_bic.name} by {models[0].delta_bic:.1f}"
    if all(m.log_evidence is not None for m in models):
        ranked = sorted(models, key=lambda m: -(m.log_evidence or 0.0))
        gap = (ranked[0].log_evidence or 0.0) - (ranked[1].log_evidence or 0.0)
        said += (
            "; the evidence does not choose"
            if gap < _TOO_CLOSE / 2
            else f"; the evidence prefers {ranked[0].name} to {ranked[1].name} (ln of the ratio {gap:.1f})"
        )
    return said


def _tests(comparison: Comparison) -> list[str]:
    """Whether any model describes the data."""
    models = comparison.models
    if models[0].result.uncertainty_estimated:
        return [
            "no model can be tested, because the uncertainty is estimated from its own residuals: the best may be "
            "as wrong as the others"
        ]
    said = []
    untested = [m.name for m in models if m.p_value is None]
    if untested:
        said.append(f"{_listed(untested)} cannot be tested: no degree of freedom is left, any model would fit")
    tested = [m for m in models if m.p_value is not None]
    poor = [m for m in tested if (m.p_value or 0.0) < ALARM]
    if tested and len(poor) == len(tested):
        largest = max(m.p_value or 0.0 for m in tested)
        said.append(
            f"no {'tested ' if untested else ''}model describes the data (largest probability {largest:.1g}): the "
            "best is only the least wrong, or the stated uncertainty is too small"
        )
    elif models[0] in poor:
        said.append(f"{models[0].name} does not describe the data (probability {models[0].p_value:.1g})")
    return said
