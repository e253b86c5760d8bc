"""A loss over more pictures than memory holds the layers of."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

from keycld._shares import by_device


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
        at_once: how many elements a chunk holds, on each device.
    """
    weights, rest = eqx.partition(module, eqx.is_inexact_array)

    def of_part(weights: Any, elements: Any) -> Array:
        return _mean_in_chunks(
            lambda weights, each: function(eqx.combine(weights, rest), each), weights, elements, at_once
        )

    return jnp.mean(by_device(of_part, weights, elements))


def _mean_in_chunks(function: Callable[[Any, Any], Array], weights: Any, elements: Any, at_once: int) -> Array:
    """Return the mean over the elements of one device."""
    count = jax.tree.leaves(elements)[0].shape[0]

    def total(weights: Any, chunk: Any, counts: Array) -> Array:
        return jnp.sum(counts * jax.vmap(lambda element: function(weights, element))(chunk))

    if count <= at_once:
        return total(weights, elements, jnp.ones(count)) / count
    chunks = -(-count // at_once)
    size = -(-count // chunks)
    counts = (jnp.arange(chunks * size) < count).astype(jnp.float32).reshape(chunks, size)

    def forward(weights: Any, elements: Any) -> tuple[Array, tuple[Any, Any]]:
        last = jnp.minimum(jnp.arange(chunks * size), count - 1)

        def split(leaf: Array) -> Array:
            filled = leaf if chunks * size == count else leaf[last]
            return filled.reshape(chunks, size, *leaf.shape[1:])

        def join(parts: Array) -> Array:
            return parts.reshape(chunks * size, *parts.shape[2:])[:count]

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
