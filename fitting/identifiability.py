"""How far a fit can be trusted: what the data determine, and every known reason to doubt it, in words."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import gammaincc, stdtrit  # type: ignore[import-untyped]

import vcavity_jax as vc
from fitting.problem import Problem
from fitting.result import Estimate, Minimum
from vcavity_jax.planning import interfaced_panel

WEAK = 0.05
"""Smallest singular value of the scaled Jacobian below which parameters are hardly told apart."""

SINGULAR = 1e-7
# Roughness below which a matte surface, or an interfaced one seen from the front, looks flat to 0.0025, and a
# mirror seen from the front to 0.0005.
_FLAT: dict[type, tuple[float, float]] = {vc.BeckmannGrooves: (0.1, 0.2), vc.GaussianGrooves: (0.14, 0.24)}
_BAD_FIT = 1e-3
_ONE_IN_A_THOUSAND = 3.09
_ROUNDING = 1e-5
_ADVICE: dict[type, str] = {
    vc.Lambertian: "; if the sample is glossy, varnished or printed, model its interface: "
    "vcavity_jax.InterfacedLambertian, or --material interfaced"
}
"""What else to try if a material does not describe the data."""

_LIKELIHOOD_95 = 3.841458820694124


@dataclass(frozen=True)
class LocalInformation:
    """What the slopes of the model at a point say about all parameters.

    Args:
        singular_values: of the Jacobian with its columns scaled to unit length, descending.
        covariance: of all parameters; NaN if the Jacobian is singular.
        singular: whether it is.
    """

    singular_values: np.ndarray
    covariance: np.ndarray
    singular: bool

    @property
    def standard_errors(self) -> np.ndarray:
        """Square roots of the covariance's diagonal, NaN where singular."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> np.ndarray:
        """The covariance with a unit diagonal."""
        errors = self.standard_errors
        return np.asarray(self.covariance / np.outer(errors, errors))


def local_information(jacobian: Float[np.ndarray, "rows parameters"]) -> LocalInformation:
    """Gauss-Newton covariance of a weighted Jacobian.

    A pseudo-inverse would report a small error exactly where a parameter is not determined at all; here the
    covariance is NaN then.

    Args:
        jacobian: derivative of the weighted residuals, priors included.
    """
    count = jacobian.shape[1]
    lengths = np.linalg.norm(jacobian, axis=0)
    if not np.isfinite(jacobian).all():
        return LocalInformation(np.full(count, np.nan), np.full((count, count), np.nan), True)
    scaled = jacobian / np.where(lengths > 0, lengths, 1.0)
    _, values, turned = np.linalg.svd(scaled, full_matrices=False)
    if len(values) < count or values[-1] <= SINGULAR or not lengths.all():
        values = np.pad(values, (0, count - len(values)))
        return LocalInformation(values, np.full((count, count), np.nan), True)
    half = turned.T / values / lengths[:, None]
    return LocalInformation(values, half @ half.T, False)


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
    estimates: dict[str, Estimate],
    minima: Sequence[Minimum],
    information: LocalInformation,
    open_names: Sequence[str],
    chi_square: float,
    residuals: Float[np.ndarray, "d l"],
    uncertainty_estimated: bool,
) -> tuple[str, ...]:
    """Every reason to doubt a fit, one sentence each.

    Args:
        problem: what was fitted.
        estimates: by name.
        minima: distinct ones within 9 in chi-square.
        information: at the best fit.
        open_names: parameters whose profile does not close within the allowed range.
        chi_square: at the best fit.
        residuals: measured less predicted, NaN where missing.
        uncertainty_estimated: sigma is not known but estimated.
    """
    found = _fit_quality(problem, residuals, chi_square, uncertainty_estimated)
    found += _blind_spots(problem, estimates)
    if len(minima) > 1:
        found.append(
            f"{len(minima)} distinct minima lie within 9 in chi-square ({_list_minima(problem, minima)}): "
            f"the data do not choose between them; {more_to_measure(problem)} or fix what else is known"
        )
    for name, estimate in estimates.items():
        if estimate.at_kink:
            found.append(
                f"{name} lies at a kink of the model, where the slopes on both sides differ: trust the 95 % "
                "interval, not the standard error"
            )
        if name in open_names:
            found.append(_one_sided(problem, name, estimate))
    weakest = information.singular_values[-1]
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


def go_together(residuals: Float[np.ndarray, "d l"]) -> bool:
    """Whether residuals at neighboring wavelengths are too much alike for noise, at one in a thousand.

    Their correlation is compared with that of independent values. Misfits of the size of rounding say nothing.
    """
    products = residuals[:, 1:] * residuals[:, :-1]
    pairs, power = np.sum(np.isfinite(products)), np.nanmean(residuals**2)
    if not pairs or power < _ROUNDING**2:
        return False
    return bool(np.nansum(products) > _ONE_IN_A_THOUSAND * np.sqrt(pairs) * power)


def _fit_quality(
    problem: Problem, residuals: Float[np.ndarray, "d l"], chi_square: float, uncertainty_estimated: bool
) -> list[str]:
    found = []
    dof, rms_misfit = problem.degrees_of_freedom, np.sqrt(np.nanmean(residuals**2))
    advice = _ADVICE.get(type(problem.scene.material), "")
    if dof == 0:
        found.append("no degree of freedom is left: any model would fit, so that this one cannot be tested")
    elif uncertainty_estimated:
        found.append(
            f"the measurement states no uncertainty: {rms_misfit:.2g} is estimated from the residuals, as if "
            "the model were right; give a standard uncertainty to test it"
        )
        if go_together(residuals):
            found.append(
                "the residuals are not noise, because neighboring wavelengths go together: the model describes "
                f"this spectrum only to about {rms_misfit:.2g}; standard errors are not to be trusted{advice}"
            )
    elif not describes_data(chi_square, dof, uncertainty_estimated):
        found.append(
            f"the model does not describe this spectrum: chi-square per degree of freedom "
            f"{chi_square / dof:.2g}, rms misfit {rms_misfit:.2g}; values and standard errors are not to be "
            f"trusted{advice}"
        )
    values, weights = np.asarray(problem.data.values), np.asarray(problem.data.weights)
    beyond = (values - 1) * weights > 3
    below = values * weights < -3
    diffuse = isinstance(problem.scene.illumination, vc.Diffuse)
    # Energy bounds the light that goes everywhere, and by reciprocity the one that comes from everywhere.
    if (diffuse or problem.measurement.hemispherical) and (beyond | below).any():
        worst = values[beyond | below][np.argmax(np.abs(values[beyond | below] - 0.5))]
        found.append(
            f"{int((beyond | below).sum())} measured values lie outside 0 to 1 by more than three standard "
            f"uncertainties (the worst is {worst:.3g}): no surface does that "
            f"{'in diffuse light' if diffuse else 'with all its light collected'}; check the calibration"
        )
    return found


def _known_directions(problem: Problem) -> tuple[np.ndarray, np.ndarray] | None:
    """Polar angles and azimuths that the data distinguish; None if light and view are both averaged over.

    Where all reflected light is collected they are those of the light, by reciprocity.
    """
    measurement, light = problem.measurement, problem.scene.illumination
    if not measurement.hemispherical:
        return measurement.polar, measurement.azimuth
    if isinstance(light, vc.Directional):
        return np.asarray(light.polar, np.float64)[None], np.asarray(light.azimuth, np.float64)[None]
    return None


def more_to_measure(problem: Problem) -> str:
    """What measurement would say more, in words that follow "or"."""
    if not problem.measurement.hemispherical:
        return "add directions"
    if _known_directions(problem) is None:
        return "measure in single directions, as in d:8"
    return "add directions of the light (as views in diffuse light, by reciprocity)"


def _blind_spots(problem: Problem, estimates: dict[str, Estimate]) -> list[str]:
    """What the geometry cannot see of what is asked of it."""
    scene = problem.scene
    shiny = isinstance(scene.material, vc.Specular)
    matte = not shiny and interfaced_panel(scene.material) is None
    # Light or view averages over the hemisphere: which of them does not matter, by reciprocity.
    averaged = isinstance(scene.illumination, vc.Diffuse) or problem.measurement.hemispherical
    known = _known_directions(problem)
    frontal = known is not None and bool((np.abs(known[0]) < np.radians(60)).all())
    found = []
    if known is not None:
        polar, azimuth = known
        section = np.abs(np.arctan2(np.sin(polar) * np.cos(azimuth), np.cos(polar)))
        if matte and problem.nonlinear and (section < 1e-6).all() and (np.abs(polar) > 1e-6).any():
            found.append(
                "all directions lie along the grooves (tan θ' = tan θ cos φ = 0): they tell no more about "
                "the grooves than one frontal view; add directions across them"
            )
        angle = None if problem.is_angle is None else estimates[problem.nonlinear[problem.is_angle].name].value
        steep = angle is not None and angle > np.radians(120)
        if shiny and averaged and steep and (section < np.radians(30)).all():
            found.append(
                "each ray is reflected once, near the normal, where the reflectance hardly depends on the angle: "
                "these directions are blind; add one at θ ≥ 75 degrees across the grooves"
            )
    rough = estimates.get("roughness")
    if rough is not None and averaged and isinstance(scene.surface, tuple(_FLAT)):
        matte_limit, mirror_limit = _FLAT[type(scene.surface)]
        # Whatever is glossy changes with its roughness if it is seen at grazing angles.
        limit = (mirror_limit if shiny else matte_limit) if matte or frontal else 0.0
        if rough.value < limit:
            found.append(
                f"roughness {rough.value:.2g} is below {limit}, where the reflectance no longer depends on "
                "it: take the interval's upper end as a limit"
            )
    return found


def _one_sided(problem: Problem, name: str, estimate: Estimate) -> str:
    parameter = next(p for p in problem.parameters if p.name == name)
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
    first = problem.nonlinear[0]
    return ", ".join(f"{first.name} {first.displayed(m.values[first.name]):.4g}" for m in minima)
