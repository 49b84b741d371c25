"""Arithmetic whose value and gradient stay finite where the plain formula has 0/0."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Inexact


def floor_of(x: Inexact[Array, "..."]) -> float:
    """A positive number so small that its fourth power's inverse is still finite in the dtype of ``x``."""
    return float(jnp.finfo(x.dtype).tiny) ** 0.2


def safe_divide(numerator: Inexact[Array, "..."], denominator: Inexact[Array, "..."]) -> Inexact[Array, "..."]:
    """numerator / denominator, and 0 with zero gradient where the denominator vanishes.

    ``where`` alone does not shield a gradient from NaN, so the divisor itself is replaced as well.
    """
    zero = denominator == 0
    quotient = numerator / jnp.where(zero, jnp.ones_like(denominator), denominator)
    return jnp.where(zero, jnp.zeros_like(quotient), quotient)


def elementwise_forward(function: Callable[..., Any]) -> Callable[..., Any]:
    """Let reverse mode differentiate an elementwise function that contains a loop of unknown length.

    JAX differentiates such loops forward only. The derivative of an elementwise function is one partial
    derivative per argument and element, so the rule runs the loop once more with one tangent per perturbed
    argument and multiplies: linear in the tangents, hence transposable. Unperturbed arguments cost nothing.

    Args:
        function: of arrays that broadcast against each other, to a pytree of arrays of the broadcast shape,
            each element of which depends on the matching elements of the arguments alone. Complex arguments
            must enter holomorphically.
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

        def along(chosen: Array) -> tuple[Any, Any]:
            units = [
                jnp.full_like(p, 0) + jnp.asarray(perturbed.index(i) == chosen, p.dtype)
                if i in perturbed
                else jnp.zeros_like(p)
                for i, p in enumerate(primals)
            ]
            return jax.jvp(function, primals, tuple(units))

        out, partials = jax.vmap(along, out_axes=(None, 0))(jnp.arange(len(perturbed)))

        def contract(partial_derivatives: Array) -> Array:
            terms = [partial_derivatives[slot] * tangents[i].astype(partial_derivatives.dtype) for slot, i in enumerate(perturbed)]
            return sum(terms[1:], start=terms[0])

        return out, jax.tree.map(contract, partials)

    return wrapped
