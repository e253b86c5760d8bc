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
    one chunk only, and nothing is computed twice. All chunks have the same size; elements that fill the last one
    up do not count.

    Args:
        function: from a module and one element to a number, differentiable once.
        module: whose floating-point arrays may be trained.
        elements: a pytree of floating-point arrays with a common first axis.
        at_once: how many elements a chunk holds.
    """
    count = jax.tree.leaves(elements)[0].shape[0]
    weights, rest = eqx.partition(module, eqx.is_inexact_array)

    def total(weights: Any, chunk: Any, counts: Array) -> Array:
        module = eqx.combine(weights, rest)
        return jnp.sum(counts * jax.vmap(lambda element: function(module, element))(chunk))

    if count <= at_once:
        return total(weights, elements, jnp.ones(count)) / count
    chunks = -(-count // at_once)
    size = -(-count // chunks)
    counts = (jnp.arange(chunks * size) < count).astype(jnp.float32).reshape(size, chunks).T

    def forward(weights: Any, elements: Any) -> tuple[Array, tuple[Any, Any]]:
        last = jnp.minimum(jnp.arange(chunks * size), count - 1)

        def split(leaf: Array) -> Array:
            # Neighbours go to different chunks: devices that have a part of the elements each share every chunk.
            filled = leaf if chunks * size == count else leaf[last]
            return filled.reshape(size, chunks, *leaf.shape[1:]).swapaxes(0, 1)

        def join(parts: Array) -> Array:
            return parts.swapaxes(0, 1).reshape(chunks * size, *parts.shape[2:])[:count]

        def add(sums: tuple[Array, Any], chunk: tuple[Any, Array]) -> tuple[tuple[Array, Any], Any]:
            value, (by_weights, by_elements) = jax.value_and_grad(total, argnums=(0, 1))(weights, *chunk)
            return (sums[0] + value, jax.tree.map(jnp.add, sums[1], by_weights)), by_elements

        zeros = (jnp.zeros(()), jax.tree.map(jnp.zeros_like, weights))
        (value, by_weights), by_elements = jax.lax.scan(add, zeros, (jax.tree.map(split, elements), counts))
        return value / count, (by_weights, jax.tree.map(join, by_elements))

    def backward(slopes: tuple[Any, Any], cotangent: Array) -> tuple[Any, Any]:
        return jax.tree.map(lambda slope: cotangent / count * slope, slopes)

    mean = jax.custom_vjp(lambda weights, elements: forward(weights, elements)[0])
    mean.defvjp(forward, backward)
    return mean(weights, elements)
