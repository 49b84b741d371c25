"""From measurement to parameters: fits of V-grooved surfaces, and how far they can be trusted.

Names are imported when they are first used: whoever asks a command for its help does not wait for JAX.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fitting import free as free
    from fitting.measurement import Measurement as Measurement
    from fitting.measurement import read_spectrum as read_spectrum
    from fitting.parameters import Parameter as Parameter
    from fitting.result import Estimate as Estimate
    from fitting.result import FitResult as FitResult
    from fitting.result import Minimum as Minimum
    from fitting.solve import fit as fit

_HOMES = {
    "Measurement": "fitting.measurement",
    "read_spectrum": "fitting.measurement",
    "Parameter": "fitting.parameters",
    "Estimate": "fitting.result",
    "FitResult": "fitting.result",
    "Minimum": "fitting.result",
    "fit": "fitting.solve",
}

__all__ = ["Estimate", "FitResult", "Measurement", "Minimum", "Parameter", "fit", "free", "read_spectrum"]


def __getattr__(name: str) -> Any:
    if name == "free":
        return import_module("fitting.free")
    if name not in _HOMES:
        raise AttributeError(f"module 'fitting' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
