"""Which colors a material can take: folded at every angle, or rough by every degree."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from os import PathLike
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fitting import files
from fitting import free as ready
from fitting.layout import Data, Layout
from fitting.looks import Places, color_weights, factors_of, finite_bounds, seen_from
from fitting.parameters import Parameter
from fitting.programs import Kept
from fitting.solve import warn_of_float32
from fitting.target import Look
from vcavity_jax import colorimetry

_TOGETHER = 16
_KEPT = Kept(8)


@dataclass(frozen=True, eq=False)
class ReachableColors:
    """The colors that one parameter goes through.

    Args:
        name: of the parameter.
        unit: "rad" or "1".
        values: of the parameter, rising, shape (P,); radians for angles.
        looks: from where and in which light, K of them.
        reflectance_factor: shape (K, P, L).
        lab: L*, a*, b*, shape (K, P, 3).
        srgb: for display, clipped to 0 to 1, shape (K, P, 3).
        wavelengths_nm: shape (L,).
    """

    name: str
    unit: str
    values: np.ndarray
    looks: tuple[Look, ...]
    reflectance_factor: np.ndarray
    lab: np.ndarray
    srgb: np.ndarray
    wavelengths_nm: np.ndarray

    @property
    def shown(self) -> np.ndarray:
        """The values as people read them: angles in degrees."""
        return np.degrees(self.values) if self.unit == "rad" else self.values

    def nearest(self, lab: Any, look: int = 0) -> tuple[float, float]:
        """The value whose color is nearest to another, and the ΔE₀₀ that remains, among those computed.

        Args:
            lab: L*, a*, b*, shape (3,).
            look: which of the looks.
        """
        off = np.asarray(colorimetry.delta_e_2000(np.asarray(lab, np.float64), self.lab[look]))
        best = int(np.argmin(off))
        return float(self.values[best]), float(off[best])

    def plot(self, path: str | PathLike[str]) -> None:
        """Draw a* against b* and L* against C*, a curve for each look, in the colors themselves.

        Raises:
            OSError: the file cannot be written.
            ValueError: the ending is not .png, .pdf or .svg.
        """
        from fitting.gamut_plot import plot_reachable  # Loads Matplotlib.

        plot_reachable(self, path)

    def to_csv(self, path: str | PathLike[str]) -> None:
        """Write look, value, L*, a*, b*, C* and sRGB, one line each.

        Raises:
            OSError: the file cannot be written.
        """
        unit = "_deg" if self.unit == "rad" else ""
        lines = [f"look,{self.name}{unit},L*,a*,b*,C*,R,G,B"]
        for look, lab, srgb in zip(self.looks, self.lab, self.srgb, strict=True):
            for value, (l, a, b), color in zip(self.shown, lab, srgb, strict=True):  # noqa: E741
                numbers = [value, l, a, b, np.hypot(a, b), *color]
                lines.append(f'"{look.description}",' + ",".join(f"{n:.8g}" for n in numbers))
        files.write(path, ("\n".join(lines) + "\n").encode())


def reachable_colors(
    scene: Any,
    looks: Sequence[Look] | Look | None = None,
    parameter: Any = None,
    *,
    wavelengths_nm: Any,
    count: int = 151,
    tolerance: float = 1e-6,
) -> ReachableColors:
    """The colors of a scene along one of its parameters: of a flat material, folded at every angle.

    Args:
        scene: its light is used where a look has none; its view and the parameter's value are not.
        looks: from where, in which light and illuminant; None for the front, in D65.
        parameter: a number of the scene with finite bounds; None for the dihedral angle from 20 to 180 degrees.
        wavelengths_nm: of the scene's spectra, the visible range, nm, shape (L,).
        count: how many values of the parameter, evenly spaced (in its logarithm for a roughness).
        tolerance: bound on the model's numerical error.

    Returns:
        Spectra and colors.

    Raises:
        ValueError: the inputs do not fit together; the message says what is expected.
    """
    warn_of_float32()
    views = (looks,) if isinstance(looks, Look) else tuple(looks or (Look(),))
    varied = ready.angle(20, 180) if parameter is None else parameter
    if not isinstance(varied, Parameter):
        raise ValueError(
            f"parameter is a {type(varied).__name__}; expected one number of the scene, as free.angle()"
        )
    if isinstance(count, bool) or not isinstance(count, int) or count < 2:
        raise ValueError(f"count is {count!r}; expected a whole number of at least 2")
    grid = np.asarray(wavelengths_nm, np.float64)
    weights, whites = color_weights(views, grid)
    problem, places = seen_from(scene, [varied], views, grid, tolerance)
    (low,), (high,) = finite_bounds(problem)
    natural = np.linspace(low, high, count)
    layout = problem.layout
    compiled = _KEPT.get((layout.key, places), lambda: jax.jit(partial(_all_factors, layout, places)))
    factors = np.asarray(
        compiled(jnp.asarray(natural[:, None], problem.data.center.dtype), problem.data), np.float64
    )
    factors = np.swapaxes(factors, 0, 1)
    tristimulus = np.einsum("kpl,klc->kpc", factors, weights)
    return ReachableColors(
        varied.name,
        varied.unit,
        np.array([float(varied.from_natural(x)) for x in natural]),
        views,
        factors,
        np.asarray(colorimetry.lab(tristimulus, whites[:, None])),
        np.asarray(colorimetry.srgb(tristimulus, whites[:, None], clip=True)),
        grid,
    )


def _all_factors(layout: Layout, places: Places, x: Float[Array, "p 1"], data: Data) -> Float[Array, "p k l"]:
    found: Array = jax.lax.map(lambda one: factors_of(layout, places, one, data), x, batch_size=_TOGETHER)
    return found
