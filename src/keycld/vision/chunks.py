"""A loss over more pictures than memory holds the layers of."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree


def mean_in_chunks(
    function: Callable[[Any, Any], Float[Array, ""]], module: PyTree, elements: PyTree, at_once: int
) -> Float[Array, ""]:
    """Return the mean of `function(module, element)` over the elements, not more than `at_once` of them in parallel.

    Beyond that number, value and gradient of each chunk are computed before the next chunk: memory holds the layers of
    one chunk only, and nothing is computed twice. The chunks are not a loop of XLA, because on a CPU the gradients of
    convolutions are computed seventy times slower inside of one.

    Args:
        function: from a module and one element to a number, differentiable once.
        module: whose floating-point arrays may be trained.
        elements: a pytree of floating-point arrays with a common first axis.
        at_once: how many elements a chunk holds.
    """
    count = jax.tree.leaves(elements)[0].shape[0]
    weights, rest = eqx.partition(module, eqx.is_inexact_array)

    def total(weights: Any, chunk: Any) -> Array:
        module = eqx.combine(weights, rest)
        return jnp.sum(jax.vmap(lambda element: function(module, element))(chunk))

    if count <= at_once:
        return total(weights, elements) / count

    def forward(weights: Any, elements: Any) -> tuple[Array, tuple[Any, Any]]:
        value, by_weights, by_elements = jnp.zeros(()), jax.tree.map(jnp.zeros_like, weights), []
        ready = jnp.zeros(())
        for first in range(0, count, at_once):
            chunk = jax.tree.map(lambda leaf, k=first, zero=ready: leaf[k : k + at_once] + zero, elements)
            here, slopes = jax.value_and_grad(total, argnums=(0, 1))(weights, chunk)
            value, by_weights = value + here, jax.tree.map(jnp.add, by_weights, slopes[0])
            by_elements.append(slopes[1])
            # A zero that is known when the gradient is: without it XLA would compute the chunks side by side.
            ready = 0.0 * sum(jnp.sum(leaf.reshape(-1)[:1]) for leaf in jax.tree.leaves(slopes[0]))
        joined = jax.tree.map(lambda *parts: jnp.concatenate(parts), *by_elements)
        return value / count, (by_weights, joined)

    def backward(slopes: tuple[Any, Any], cotangent: Array) -> tuple[Any, Any]:
        return jax.tree.map(lambda slope: cotangent / count * slope, slopes)

    mean = jax.custom_vjp(lambda weights, elements: forward(weights, elements)[0])
    mean.defvjp(forward, backward)
    return mean(weights, elements)
