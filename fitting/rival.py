"""The same data under a rival model: how far the answer hangs on the model, and whether the data choose."""

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

import vcavity_jax as vc
from fitting.measurement import Measurement
from fitting.result import Estimate, FitResult

_RIVAL_INDEX = 1.5


@dataclass(frozen=True, eq=False)
class Rival:
    """A fit of a rival model beside the first one.

    Args:
        description: the rival model.
        result: its fit.
        shifts: rival less first value of each number that both have; radians for angles.
        chi_square_rise: chi-square of the rival less that of the first; a positive one speaks for the first.
    """

    description: str
    result: FitResult
    shifts: dict[str, float]
    chi_square_rise: float

    def summary(self) -> str:
        """One line: what changes, and by how much the fit is worse."""
        parts = []
        for name, shift in self.shifts.items():
            estimate = self.result.estimates[name]
            unit = {"rad": " degrees", "nm": " nm"}.get(estimate.unit, "")
            parts.append(f"{name} {estimate.displayed(shift):+.4g}{unit}")
        verdict = (
            "the data do not choose between them"
            if abs(self.chi_square_rise) < 4
            else ("the data speak for the first" if self.chi_square_rise > 0 else "the data speak for the rival")
        )
        return (
            f"as {self.description}: {', '.join(parts) or 'nothing in common'}; chi-square "
            f"{self.chi_square_rise:+.4g}: {verdict}"
        )


def refit_with_rival(result: FitResult) -> Rival:
    """Fit the same data with the model that is most easily taken for the first.

    A Lambertian sample becomes one under an interface of index 1.5 (with the intrinsic reflectance that makes its
    flat sample look alike), one under an interface becomes Lambertian, and a mirror loses its polarization.

    Args:
        result: of ``fit``, of a single measurement.

    Raises:
        ValueError: the model has no rival, or the fit has several measurements.
    """
    from fitting.solve import fit

    if len(result.scenes) > 1:
        raise ValueError("the fit has several measurements; expected one, whose model has one rival")
    scene, measurement = result.scene, result.measurement
    material, description = _rival(scene)
    other_scene = vc.Scene(scene.surface, material, scene.illumination, scene.view)
    kept = [p for p in result.problem.given if _has(other_scene, p)]
    rival = fit(other_scene, measurement, kept, tolerance=result.problem.layout.tolerance)
    shifts = {}
    for name, estimate in result.estimates.items():
        other = rival.estimates.get(name)
        if isinstance(estimate, Estimate) and isinstance(other, Estimate):
            shifts[name] = other.value - estimate.value
    return Rival(description, rival, shifts, rival.chi_square - result.chi_square)


def _has(scene: vc.Scene, parameter: Any) -> bool:
    """Whether a parameter has its place in a scene."""
    if parameter.where is None:
        return True
    try:
        return parameter.where(scene) is not None
    except AttributeError:
        return False


def _rival(scene: vc.Scene) -> tuple[Any, str]:
    material = scene.material
    if isinstance(material, vc.Specular):
        if material.polarization != "full":
            return vc.Specular(material.index, "full"), "a mirror that polarizes"
        return vc.Specular(material.index, "unpolarized"), "a mirror whose reflections are unpolarized"
    if isinstance(material, vc.Lambertian):
        flat = np.asarray(material.reflectance)
        intrinsic = _intrinsic(np.atleast_1d(flat)).reshape(flat.shape)
        index = jnp.asarray(_RIVAL_INDEX, material.reflectance.dtype)
        return vc.InterfacedLambertian(
            jnp.asarray(intrinsic), index
        ), f"a sample under an interface of index {_RIVAL_INDEX}"
    if isinstance(material, vc.InterfacedLambertian):
        smooth = vc.Scene(vc.VGrooves(jnp.asarray(jnp.pi, float)), material, vc.Diffuse(), vc.View())
        return vc.Lambertian(vc.reflectance_factor(smooth)), "a Lambertian sample"
    raise ValueError(f"{type(material).__name__} has no rival model; expected one material on both panels")


def _intrinsic(flat: np.ndarray) -> np.ndarray:
    """The reflectance below an interface that gives a flat sample's reflectance."""
    from fitting.recovery import recover_reflectance

    grid = np.arange(1.0, 1.0 + len(flat))
    measured = Measurement(grid, np.zeros(1), np.zeros(1), flat[None])
    index = jnp.asarray(_RIVAL_INDEX, float)
    below = vc.InterfacedLambertian(jnp.full(len(flat), 0.5), index)
    scene = vc.Scene(vc.VGrooves(jnp.asarray(jnp.pi, float)), below, vc.Diffuse(), vc.View())
    return np.asarray(recover_reflectance(scene, measured).reflectance)
