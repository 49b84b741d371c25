"""From measurement to parameters: fits of V-grooved surfaces, and how far they can be trusted.

Names are imported when they are first used: whoever asks a command for its help does not wait for JAX.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fitting import free as free
    from fitting import priors as priors
    from fitting import spectra as spectra
    from fitting import target as target
    from fitting.comparison import Comparison as Comparison
    from fitting.comparison import compare_models as compare_models
    from fitting.comparison import compare_results as compare_results
    from fitting.cubes import fit_cube as fit_cube
    from fitting.designing import Design as Design
    from fitting.designing import design as design
    from fitting.gamut import ReachableColors as ReachableColors
    from fitting.gamut import reachable_colors as reachable_colors
    from fitting.many import ManyResult as ManyResult
    from fitting.many import fit_many as fit_many
    from fitting.measurement import Measurement as Measurement
    from fitting.measurement import read_spectrum as read_spectrum
    from fitting.parameters import Parameter as Parameter
    from fitting.parameters import SpectralParameter as SpectralParameter
    from fitting.planning import plan_views as plan_views
    from fitting.posterior import Posterior as Posterior
    from fitting.profile import ProfileLikelihood as ProfileLikelihood
    from fitting.profile import profile_likelihood as profile_likelihood
    from fitting.recovery import Recovery as Recovery
    from fitting.recovery import recover_reflectance as recover_reflectance
    from fitting.residuals import residual_structure as residual_structure
    from fitting.result import Estimate as Estimate
    from fitting.result import FitResult as FitResult
    from fitting.result import Minimum as Minimum
    from fitting.result import SpectralEstimate as SpectralEstimate
    from fitting.rival import Rival as Rival
    from fitting.rival import refit_with_rival as refit_with_rival
    from fitting.rival import rivals as rivals
    from fitting.sampling import sample_posterior as sample_posterior
    from fitting.solve import fit as fit
    from fitting.view_plan import PlannedView as PlannedView
    from fitting.view_plan import ViewPlan as ViewPlan

_HOMES = {
    "Comparison": "fitting.comparison",
    "Design": "fitting.designing",
    "Estimate": "fitting.result",
    "FitResult": "fitting.result",
    "ManyResult": "fitting.many",
    "Measurement": "fitting.measurement",
    "Minimum": "fitting.result",
    "Parameter": "fitting.parameters",
    "PlannedView": "fitting.view_plan",
    "Posterior": "fitting.posterior",
    "ProfileLikelihood": "fitting.profile",
    "ReachableColors": "fitting.gamut",
    "Recovery": "fitting.recovery",
    "Rival": "fitting.rival",
    "SpectralEstimate": "fitting.result",
    "SpectralParameter": "fitting.parameters",
    "ViewPlan": "fitting.view_plan",
    "compare_models": "fitting.comparison",
    "compare_results": "fitting.comparison",
    "design": "fitting.designing",
    "fit": "fitting.solve",
    "fit_cube": "fitting.cubes",
    "fit_many": "fitting.many",
    "plan_views": "fitting.planning",
    "profile_likelihood": "fitting.profile",
    "reachable_colors": "fitting.gamut",
    "read_spectrum": "fitting.measurement",
    "recover_reflectance": "fitting.recovery",
    "refit_with_rival": "fitting.rival",
    "residual_structure": "fitting.residuals",
    "rivals": "fitting.rival",
    "sample_posterior": "fitting.sampling",
}
# fit_cube is not in __all__: it needs an extra, and "from fitting import *" shall not.
_MODULES = ("free", "priors", "spectra", "target")

__all__ = [
    "Comparison",
    "Design",
    "Estimate",
    "FitResult",
    "ManyResult",
    "Measurement",
    "Minimum",
    "Parameter",
    "PlannedView",
    "Posterior",
    "ProfileLikelihood",
    "ReachableColors",
    "Recovery",
    "Rival",
    "SpectralEstimate",
    "SpectralParameter",
    "ViewPlan",
    "compare_models",
    "compare_results",
    "design",
    "fit",
    "fit_many",
    "free",
    "plan_views",
    "priors",
    "profile_likelihood",
    "reachable_colors",
    "read_spectrum",
    "recover_reflectance",
    "refit_with_rival",
    "residual_structure",
    "rivals",
    "sample_posterior",
    "spectra",
    "target",
]


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return import_module(f"fitting.{name}")
    if name not in _HOMES:
        raise AttributeError(f"module 'fitting' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
