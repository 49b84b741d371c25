"""How far a fit can be trusted: what the data determine, and every known reason to doubt it, in words."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.special import gammaincc, stdtrit  # type: ignore[import-untyped]

import vcavity_jax as vc
from fitting.blind_spots import blind_spots, more_to_measure
from fitting.information import LocalInformation
from fitting.problem import Problem
from fitting.residuals import structure_in
from fitting.result import Estimate, Minimum, SpectralEstimate
from fitting.spectra import Smooth

WEAK = 0.05
"""Smallest singular value of the scaled Jacobian below which parameters are hardly told apart."""

_BAD_FIT = 1e-3
_ADVICE: dict[type, str] = {
    vc.Lambertian: "; if the sample is glossy, varnished or printed, model its interface: "
    "vcavity_jax.InterfacedLambertian, or --material interfaced"
}
"""What else to try if a material does not describe the data."""

_LIKELIHOOD_95 = 3.841458820694124


def threshold_95(degrees_of_freedom: int, uncertainty_estimated: bool) -> float:
    """Rise of chi-square that bounds a 95 % interval.

    3.84 if the uncertainty is known; the squared 97.5 % point of Student's t, that is the F-type limit, if it
    is estimated from the same residuals.
    """
    if not uncertainty_estimated:
        return _LIKELIHOOD_95
    return float(stdtrit(degrees_of_freedom, 0.975)) ** 2


def p_value(chi_square: float, degrees_of_freedom: int) -> float:
    """Chance that a true model fits at least as badly."""
    return float(gammaincc(degrees_of_freedom / 2, chi_square / 2)) if degrees_of_freedom > 0 else math.nan


def describes_data(chi_square: float, degrees_of_freedom: int, uncertainty_estimated: bool) -> bool | None:
    """Whether a misfit is one that a true model may have; None if that cannot be tested."""
    if uncertainty_estimated or degrees_of_freedom == 0:
        return None
    return p_value(chi_square, degrees_of_freedom) >= _BAD_FIT


def find_warnings(
    problem: Problem,
    estimates: Mapping[str, Any],
    minima: Sequence[Minimum],
    information: LocalInformation,
    open_names: Sequence[str],
    chi_square: float,
    residuals: Sequence[np.ndarray],
    uncertainty_estimated: bool,
    branches: int,
) -> tuple[str, ...]:
    """Every reason to doubt a fit, one sentence each.

    Args:
        problem: what was fitted.
        estimates: by name.
        minima: distinct ones within 9 in chi-square.
        information: at the best fit.
        open_names: parameters whose profile does not close within the allowed range.
        chi_square: at the best fit.
        residuals: measured less predicted, NaN where missing, of each measurement.
        uncertainty_estimated: sigma is not known but estimated.
        branches: wavelengths at which other values of the free spectra fit as well.
    """
    found = _fit_quality(problem, estimates, residuals, chi_square, uncertainty_estimated)
    found += blind_spots(problem, estimates)
    if len(minima) > 1:
        found.append(
            f"{len(minima)} distinct minima lie within 9 in chi-square ({_list_minima(problem, minima)}): "
            f"the data do not choose between them; {more_to_measure(problem)} or fix what else is known"
        )
    if branches:
        found.append(
            f"at {branches} of {len(problem.layout.wavelengths_nm)} wavelengths other values of "
            f"{' and '.join(problem.free_names)} fit as well (within 9 in chi-square): the answer depends on the "
            "branch; give a prior around a table, or a dispersion formula"
        )
    for name, estimate in estimates.items():
        if isinstance(estimate, SpectralEstimate):
            found += _spectral_doubts(name, estimate)
            continue
        if estimate.at_kink:
            found.append(
                f"{name} lies at a kink of the model, where the slopes on both sides differ: trust the 95 % "
                "interval, not the standard error"
            )
        if name in open_names:
            found.append(_one_sided(problem, name, estimate))
    weakest = min(information.singular_values, default=1.0)
    if information.singular:
        found.append(
            "the parameters cannot be told apart (the Jacobian is singular): fix one, give a prior, or "
            f"{more_to_measure(problem)}"
        )
    elif weakest < WEAK:
        found.append(
            f"the parameters are hardly told apart (smallest singular value of the scaled Jacobian "
            f"{weakest:.2g}, below {WEAK}): fix one, give a prior, or {more_to_measure(problem)}"
        )
    return tuple(found)


def _spectral_doubts(name: str, estimate: SpectralEstimate) -> list[str]:
    found = []
    lost, bound = np.isnan(estimate.value), estimate.at_bound
    for which, words in (
        (lost, "is not determined by the data; give a prior, a smooth form, or values"),
        (bound, "lies on a bound of its range: noise or a wrong gain pushes it there"),
    ):
        if which.any():
            first = estimate.wavelengths_nm[which]
            where = f"{first[0]:g} nm" if len(first) == 1 else f"{first[0]:g} to {first[-1]:g} nm"
            found.append(f"{name} at {int(which.sum())} of {len(which)} wavelengths ({where}) {words}")
    return found


def _fit_quality(
    problem: Problem,
    estimates: Mapping[str, Any],
    residuals: Sequence[np.ndarray],
    chi_square: float,
    uncertainty_estimated: bool,
) -> list[str]:
    found = []
    dof = problem.degrees_of_freedom
    rms_misfit = np.sqrt(np.nanmean(np.concatenate([r.ravel() for r in residuals]) ** 2))
    kinds = [type(part.scene.material) for part in problem.layout.parts]
    advice = next((_ADVICE[kind] for kind in kinds if kind in _ADVICE), "")
    if any(isinstance(use.form, Smooth) for use in problem.layout.forms):
        advice = "; a smooth spectrum may need a shorter correlation length" + advice
    if dof == 0:
        found.append("no degree of freedom is left: any model would fit, so that this one cannot be tested")
    elif uncertainty_estimated:
        found.append(
            f"the measurement states no uncertainty: {rms_misfit:.2g} is estimated from the residuals, as if "
            "the model were right; give a standard uncertainty to test it"
        )
    elif not describes_data(chi_square, dof, uncertainty_estimated):
        found.append(
            f"the model does not describe this spectrum: chi-square per degree of freedom "
            f"{chi_square / dof:.2g}, rms misfit {rms_misfit:.2g}; values and standard errors are not to be "
            f"trusted{advice}"
        )
    structure = structure_in(problem, residuals, estimates)
    if structure is not None and structure.structured:
        found.append(structure.sentence() + ("" if any(advice in told for told in found) else advice))
    for index, measurement in enumerate(problem.measurements):
        found += _beyond_energy(problem, index, measurement.hemispherical)
    return found


def _beyond_energy(problem: Problem, index: int, hemispherical: bool) -> list[str]:
    """Energy bounds the light that goes everywhere, and by reciprocity the one that comes from everywhere."""
    values, weights = np.asarray(problem.data.values[index]), np.asarray(problem.data.weights[index])
    outside = ((values - 1) * weights > 3) | (values * weights < -3)
    diffuse = isinstance(problem.layout.parts[index].scene.illumination, vc.Diffuse)
    if not (diffuse or hemispherical) or not outside.any():
        return []
    worst = values[outside][np.argmax(np.abs(values[outside] - 0.5))]
    return [
        f"{int(outside.sum())} measured values lie outside 0 to 1 by more than three standard "
        f"uncertainties (the worst is {worst:.3g}): no surface does that "
        f"{'in diffuse light' if diffuse else 'with all its light collected'}; check the calibration"
    ]


def _one_sided(problem: Problem, name: str, estimate: Estimate) -> str:
    parameter = next(p for p in problem.numbers if p.name == name)
    low, high = estimate.interval_95[0][0], estimate.interval_95[-1][1]
    unit = " degrees" if parameter.unit == "rad" else ""
    shown_low, shown_high = parameter.displayed(low), parameter.displayed(high)
    at_low, at_high = low <= parameter.lower, high >= parameter.upper
    if (at_low and at_high) or not (at_low or at_high):
        limit = "any allowed value fits" if len(estimate.interval_95) == 1 else "no limit can be given"
    elif at_high:
        limit = f"only that it is at least {shown_low:.4g}{unit}"
    else:
        limit = f"only that it is at most {shown_high:.4g}{unit}"
    return (
        f"{name} is not determined within its allowed range ({limit}): no standard error; "
        f"{more_to_measure(problem)}, widen the range, or fix what else is known"
    )


def _list_minima(problem: Problem, minima: Sequence[Minimum]) -> str:
    first = problem.numbers[0]
    return ", ".join(f"{first.name} {first.displayed(m.values[first.name]):.4g}" for m in minima)
