"""The same data under a rival model: how far the answer hangs on the model, and whether the data choose."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

import vcavity_jax as vc
from fitting.measurement import Measurement
from fitting.parameters import Parameter
from fitting.result import Estimate, FitResult
from vcavity_jax.planning import interfaced_panel
from vcavity_jax.resolution import INTERFACED_NARROWEST

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
    other_scene = _with(scene, material)
    kept = adapted(other_scene, result.problem.given)
    rival = fit(other_scene, measurement, kept, tolerance=result.problem.layout.tolerance)
    shifts = {}
    for name, estimate in result.estimates.items():
        other = rival.estimates.get(name)
        if isinstance(estimate, Estimate) and isinstance(other, Estimate):
            shifts[name] = other.value - estimate.value
    return Rival(description, rival, shifts, rival.chi_square - result.chi_square)


def rivals(scene: vc.Scene) -> dict[str, vc.Scene]:
    """The models that one measurement should be compared under: the scene's own first, then the usual other ones.

    A Lambertian sample gets one under an interface of index 1.5; one under an interface the other treatment of
    polarization, and a Lambertian one; a mirror the two approximate treatments of polarization, or the exact one.
    Rivals with another material have the flat sample's reflectance in common.

    Args:
        scene: of one material on both panels.

    Returns:
        Scenes by name.

    Raises:
        ValueError: the material has no rival.
    """
    material = scene.material
    if isinstance(material, vc.Specular):
        every: tuple[Any, ...] = ("full", "unpolarized", "separate")
        treatments = sorted(every, key=lambda one: one != material.polarization)
        return {f"specular, {one}": _with(scene, vc.Specular(material.index, one)) for one in treatments}
    if isinstance(material, vc.Lambertian):
        return {"Lambertian": scene, f"interfaced {_RIVAL_INDEX}": _with(scene, _interfaced(material))}
    if isinstance(material, vc.InterfacedLambertian):
        other: Any = "full" if material.polarization == "unpolarized" else "unpolarized"
        polarized = dataclasses.replace(material, polarization=other)
        return {
            f"interfaced, {material.polarization}": scene,
            f"interfaced, {other}": _with(scene, polarized),
            "Lambertian": _with(scene, _matte(material)),
        }
    raise ValueError(f"{type(material).__name__} has no rival model; expected one material on both panels")


def adapted(scene: vc.Scene, parameters: Sequence[Any]) -> list[Any]:
    """The free parameters that have a place in a scene, within what is modeled there.

    Args:
        scene: the one to fit.
        parameters: free ones, pairs put one after the other. An angle's lower bound is raised to the narrowest
            groove that is modeled for the material.
    """
    kept = [p for p in parameters if _has(scene, p)]
    if interfaced_panel(scene.material) is None or not isinstance(scene.surface, vc.VGrooves):
        return kept
    angle, least = scene.surface.angle, INTERFACED_NARROWEST
    return [
        dataclasses.replace(p, lower=least)
        if isinstance(p, Parameter) and p.where and p.where(scene) is angle and p.lower < least < p.upper
        else p
        for p in kept
    ]


def _with(scene: vc.Scene, material: Any) -> vc.Scene:
    return vc.Scene(scene.surface, material, scene.illumination, scene.view)


def _has(scene: vc.Scene, parameter: Any) -> bool:
    """Whether a parameter has its place in a scene."""
    if parameter.where is None:
        return True
    try:
        return parameter.where(scene) is not None
    except AttributeError:
        return False


def _rival(scene: vc.Scene) -> tuple[Any, str]:
    """The one model that is most easily taken for a scene's own."""
    material = scene.material
    if isinstance(material, vc.Specular):
        if material.polarization != "full":
            return vc.Specular(material.index, "full"), "a mirror that polarizes"
        return vc.Specular(material.index, "unpolarized"), "a mirror whose reflections are unpolarized"
    if isinstance(material, vc.Lambertian):
        return _interfaced(material), f"a sample under an interface of index {_RIVAL_INDEX}"
    if isinstance(material, vc.InterfacedLambertian):
        return _matte(material), "a Lambertian sample"
    raise ValueError(f"{type(material).__name__} has no rival model; expected one material on both panels")


def _interfaced(material: vc.Lambertian) -> vc.InterfacedLambertian:
    """Under an interface, with the reflectance that makes its flat sample look alike."""
    flat = np.asarray(material.reflectance)
    intrinsic = _intrinsic(np.atleast_1d(flat)).reshape(flat.shape)
    index = jnp.asarray(_RIVAL_INDEX, material.reflectance.dtype)
    return vc.InterfacedLambertian(jnp.asarray(intrinsic), index)


def _matte(material: vc.InterfacedLambertian) -> vc.Lambertian:
    """Without its interface, with the flat sample's reflectance."""
    smooth = vc.Scene(vc.VGrooves(jnp.asarray(jnp.pi, float)), material, vc.Diffuse(), vc.View())
    return vc.Lambertian(vc.reflectance_factor(smooth))


def _intrinsic(flat: np.ndarray) -> np.ndarray:
    """The reflectance below an interface that gives a flat sample's reflectance."""
    from fitting.recovery import recover_reflectance

    grid = np.arange(1.0, 1.0 + len(flat))
    measured = Measurement(grid, np.zeros(1), np.zeros(1), flat[None])
    index = jnp.asarray(_RIVAL_INDEX, float)
    below = vc.InterfacedLambertian(jnp.full(len(flat), 0.5), index)
    scene = vc.Scene(vc.VGrooves(jnp.asarray(jnp.pi, float)), below, vc.Diffuse(), vc.View())
    return np.asarray(recover_reflectance(scene, measured).reflectance)
