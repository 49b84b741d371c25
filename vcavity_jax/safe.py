"""Arithmetic whose value and gradient stay finite where the plain formula has 0/0."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Inexact


def floor_of(x: Inexact[Array, "..."]) -> float:
    """A positive number so small that its fourth power's inverse is still finite in the dtype of ``x``."""
    return float(jnp.finfo(x.dtype).tiny) ** 0.2


def safe_divide(numerator: Inexact[Array, "..."], denominator: Inexact[Array, "..."]) -> Inexact[Array, "..."]:
    """Numerator / denominator, and 0 with zero gradient where the denominator vanishes.

    ``where`` alone does not shield a gradient from NaN, so the divisor itself is replaced as well.
    """
    zero = denominator == 0
    quotient = numerator / jnp.where(zero, jnp.ones_like(denominator), denominator)
    return jnp.where(zero, jnp.zeros_like(quotient), quotient)


def safe_hypot(x: Float[Array, "..."], y: Float[Array, "..."]) -> Float[Array, "..."]:
    """√(x² + y²), and 1 with zero gradient where both vanish: what it divides is 0 there."""
    squared = x * x + y * y
    return jnp.sqrt(jnp.where(squared == 0, jnp.ones_like(squared), squared))


def elementwise_forward(function: Callable[..., Any], nested: bool = False) -> Callable[..., Any]:
    """Let reverse mode differentiate an elementwise function that contains a loop of unknown length.

    JAX differentiates such loops forward only. The derivative of an elementwise function is one partial
    derivative per argument and element, so the rule runs the loop with one tangent per perturbed argument and
    multiplies: linear in the tangents, hence transposable. Unperturbed arguments cost nothing.

    Args:
        function: of arrays that broadcast against each other, to a pytree of arrays of the broadcast shape,
            each element of which depends on the matching elements of the arguments alone. Complex arguments
            must enter holomorphically.
        nested: run the tangents one after the other instead of side by side. It costs more, but XLA for the
            CPU (jaxlib 0.10) miscompiles side-by-side tangents of a loop within a loop.
    """

    @jax.custom_jvp
    def wrapped(*arguments: Array) -> Any:
        return function(*arguments)

    @partial(wrapped.defjvp, symbolic_zeros=True)
    def rule(primals: tuple[Array, ...], tangents: tuple[Any, ...]) -> tuple[Any, Any]:
        perturbed = [i for i, t in enumerate(tangents) if not isinstance(t, jax.custom_derivatives.SymbolicZero)]
        if not perturbed:
            out = function(*primals)
            return out, jax.tree.map(jnp.zeros_like, out)

        def along(chosen: Array | int) -> tuple[Any, Any]:
            def varied(*arguments: Array) -> Any:
                return function(*_replaced(primals, perturbed, arguments))

            units = tuple(jnp.full_like(primals[i], chosen == slot) for slot, i in enumerate(perturbed))
            return jax.jvp(varied, tuple(primals[i] for i in perturbed), units)

        if nested or len(perturbed) == 1:
            out, first = along(0)
            columns = [first, *(along(slot)[1] for slot in range(1, len(perturbed)))]
        else:
            out, stacked = jax.vmap(along, out_axes=(None, 0))(jnp.arange(len(perturbed)))
            columns = [jax.tree.map(lambda a, slot=slot: a[slot], stacked) for slot in range(len(perturbed))]

        def contract(*partials: Array) -> Array:
            terms = [p * jnp.asarray(tangents[i], p.dtype) for p, i in zip(partials, perturbed, strict=True)]
            return sum(terms[1:], start=terms[0])

        return out, jax.tree.map(contract, *columns)

    return wrapped


def _replaced(values: tuple[Array, ...], positions: list[int], new: tuple[Array, ...]) -> tuple[Array, ...]:
    replaced = dict(zip(positions, new, strict=True))
    return tuple(replaced.get(i, value) for i, value in enumerate(values))
