"""What is compiled of a fit: the table of its predictions and the descent from many starts at once.

The known directions and surface of a scene are compiled in, because the model picks cheaper paths for them;
the material is passed on. Programs are kept, so that the next fit of the same kind of scene, with the same
directions, starts at once, whatever its material.
"""

from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from fitting.arrow import Lane, descend
from fitting.layout import Data, Layout

CHUNK = 32
"""Vectors of numbers per call of the table: few, lest wide grooves wait for narrow ones."""

# XLA would take five times as long to compile this than to run it.
_CHEAP_TO_COMPILE = {"xla_backend_optimization_level": 0, "xla_cpu_use_fusion_emitters": False}
_QUICK_VALUES = 2000
_WORKERS = ThreadPoolExecutor(max_workers=2, thread_name_prefix="compile")


@dataclass(frozen=True, eq=False)
class Programs:
    """A layout and what is compiled of it.

    Args:
        layout: of the fit for which they were made first.
        compiled: by name; each is ready, or becomes so in the background.
    """

    layout: Layout
    compiled: dict[Any, Future[Any]] = field(default_factory=dict)

    @property
    def quick(self) -> bool:
        """So few values are predicted that compiling a descent takes longer than running it."""
        return sum(int(np.prod(part.shape)) for part in self.layout.parts) <= _QUICK_VALUES

    def begin_table(self, data: Data) -> None:
        """Compile the true reflectance factors for ``CHUNK`` vectors of numbers."""
        layout = self.layout
        spectra = jax.ShapeDtypeStruct((layout.free_spectra, layout.blocks), data.center.dtype)

        def one(natural: Array, known: tuple[tuple[Array, ...], ...]) -> tuple[Array, ...]:
            none = jnp.zeros(spectra.shape, spectra.dtype)
            return tuple(
                layout.factor(part, *layout.inputs(part, natural, none), numbers)
                for part, numbers in zip(layout.parts, known, strict=True)
            )

        shape = jax.ShapeDtypeStruct((CHUNK, len(layout.logarithmic)), data.center.dtype)
        self._begin("table", lambda: jax.jit(jax.vmap(one, in_axes=(0, None))).lower(shape, data.known), None)

    def table(self, data: Data) -> Any:
        """The program of ``begin_table``."""
        self.begin_table(data)
        return self.compiled["table"].result()

    def begin_descent(self, data: Data, lanes: int, batched: bool, cheap: bool) -> None:
        """Compile ``lanes`` descents at once.

        Args:
            data: its shapes count; if batched, measured values have a first axis of ``lanes``.
            lanes: how many.
            batched: each has its own measured values, weights and means.
            cheap: it will run too little to be worth optimizing.
        """
        layout = self.layout
        numbers, free, blocks = len(layout.logarithmic), layout.free_spectra, layout.blocks
        kind = data.center.dtype
        lane = Lane(
            jax.ShapeDtypeStruct((lanes, numbers), kind),  # type: ignore[arg-type]
            jax.ShapeDtypeStruct((lanes, free, blocks), kind),  # type: ignore[arg-type]
            jax.ShapeDtypeStruct((lanes, numbers), bool),  # type: ignore[arg-type]
            jax.ShapeDtypeStruct((lanes, free, blocks), bool),  # type: ignore[arg-type]
            jax.ShapeDtypeStruct((lanes,), jnp.int32),  # type: ignore[arg-type]
            jax.ShapeDtypeStruct((lanes,), jnp.int32),  # type: ignore[arg-type]
        )
        own = 0 if batched else None
        axes: Any = Data(own, own, own, None, None, None, None, None, None, None, None)  # type: ignore[arg-type]

        def one(lane: Lane, data: Data) -> Any:
            return descend(layout, lane, data)

        options = _CHEAP_TO_COMPILE if cheap and self.quick else None
        name = ("descent", lanes, batched)
        self._begin(name, lambda: jax.jit(jax.vmap(one, in_axes=(0, axes))).lower(lane, data), options)

    def descent(self, data: Data, lanes: int, batched: bool, cheap: bool) -> Any:
        """The program of ``begin_descent``."""
        self.begin_descent(data, lanes, batched, cheap)
        return self.compiled["descent", lanes, batched].result()

    def once(self, name: str, program: Callable[..., Any], *examples: Any) -> Any:
        """A program that runs too little to be worth optimizing, compiled for the shapes of some arguments.

        Args:
            name: under which it is kept: it must depend on nothing but the layout and its arguments.
            program: what is compiled.
            examples: arguments, or their shapes.
        """
        options = _CHEAP_TO_COMPILE if self.quick else None
        self._begin(name, lambda: jax.jit(program).lower(*examples), options)
        return self.compiled[name].result()

    def _begin(self, name: Any, lower: Any, options: dict[str, Any] | None) -> None:
        """Compile a program in the background, unless that has been done.

        It is traced here, because JAX's settings belong to a thread; only XLA's work moves to another one.
        """
        if name not in self.compiled:
            self.compiled[name] = _WORKERS.submit(_compile, lower(), options)


class Kept:
    """What was used last of what is costly to make, by what it depends on.

    Args:
        most: how many to keep.
    """

    def __init__(self, most: int) -> None:
        self._most, self._found = most, OrderedDict[Any, Any]()

    def get(self, key: Any, make: Callable[[], Any]) -> Any:
        """What is kept under a key; made if it is not there."""
        if key not in self._found:
            self._found[key] = make()
        self._found.move_to_end(key)
        while len(self._found) > self._most:
            self._found.popitem(last=False)
        return self._found[key]


_KEPT = Kept(8)


def _compile(lowered: Any, options: dict[str, Any] | None) -> Any:
    if options and jax.default_backend() == "cpu":
        try:
            return lowered.compile(compiler_options=options)
        except (RuntimeError, ValueError):
            pass  # Another version of XLA may not know them: they only save time.
    return lowered.compile()


def programs_for(layout: Layout, data: Data) -> Programs:
    """The programs of a kind of fit, new or kept from an earlier one.

    Raises:
        ValueError: a scene cannot be evaluated, or its wavelengths are not the measurement's.
    """
    dtype = jnp.result_type(float)

    def made() -> Programs:
        _check_shapes(layout, data)
        return Programs(layout)

    found: Programs = _KEPT.get((layout.key, str(dtype)), made)
    return found


def _check_shapes(layout: Layout, data: Data) -> None:
    natural = jax.ShapeDtypeStruct(data.center.shape, data.center.dtype)
    spectra = jax.ShapeDtypeStruct((layout.free_spectra, layout.blocks), data.center.dtype)
    for part, known in zip(layout.parts, data.known, strict=True):

        def evaluate(natural: Array, spectra: Array, known: Any, part: Any = part) -> Array:
            return layout.evaluated(part, layout.placed(part, *layout.inputs(part, natural, spectra), known))

        full = jax.eval_shape(evaluate, natural, spectra, known)
        found, wanted = full.shape[len(part.scene.view.shape) :], part.shape[1]
        if found not in ((), (wanted,)):
            raise ValueError(
                f"the material has wavelength shape {found}, the measurement {wanted} wavelengths; expected () "
                f"or ({wanted},): tabulate the material at the measurement's wavelengths"
            )
