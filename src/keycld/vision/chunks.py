"""Networks over more pictures than memory holds the layers of."""

from collections.abc import Callable
from typing import Any

import jax
from jaxtyping import PyTree


def over_frames(function: Callable[[Any], PyTree], frames: PyTree, at_once: int) -> PyTree:
    """Apply a function to every element along the first axis of a pytree, not more than `at_once` in parallel.

    Up to that number this is `jax.vmap`. Beyond it, chunks follow one another and are computed again for the gradient,
    so memory holds the layers of one chunk only. That costs one more forward pass, and on a CPU a factor of four:
    XLA runs convolutions inside a loop without its fast kernels there.

    Args:
        function: from one element to a pytree of arrays, differentiable.
        frames: a pytree of arrays with a common first axis.
        at_once: how many elements a chunk holds.
    """
    if jax.tree.leaves(frames)[0].shape[0] <= at_once:
        return jax.vmap(function)(frames)
    # A function around `function`, because `checkpoint` hashes what it is given, and a module may be traced.
    return jax.lax.map(jax.checkpoint(lambda frame: function(frame)), frames, batch_size=at_once)
