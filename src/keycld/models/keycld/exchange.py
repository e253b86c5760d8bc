"""Which keypoint is which part, where the parts exchange their looks from recording to recording.

An estimator follows what it sees best, such as a colour. Where the inner disc is red in one recording and the outer one
in another, its keypoints are other parts in each recording, and only the constraints tell which. Ours, in no paper.
"""

import itertools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray

from keycld.mechanics import moved
from keycld.vision import Observation

Phi = Callable[[Float[Array, "dim"]], Float[Array, "n"]]


def orders(count: int) -> Int[Array, "P K"]:
    """Return all orders of so many keypoints, the given one first."""
    return jnp.array(list(itertools.permutations(range(count))))


def fitting_order(
    phi: Phi,
    constants: Float[Array, "n"] | None,
    x: Float[Array, "T K 2"],
    place: Callable[[Float[Array, "T dim"]], Float[Array, "2"]] | None = None,
) -> tuple[Int[Array, "K"], Float[Array, "n"]]:
    """Return the order of keypoints in which the constraints hold best over T frames of one recording.

    It has the least mean over frames of Σ_i (Φ_i(x) − c_i)² / |DΦ_i(x)|², a squared length.

    Args:
        phi: Φ.
        constants: c; None: for each order the mean of Φ over the frames, which must show a motion.
        x: the observed keypoints.
        place: gives the place around which Φ holds from flat keypoints `[T, 2K]`; None: the origin.

    Returns:
        the order, and c.
    """
    count = x.shape[1]

    def misfit(order: Array) -> tuple[Array, Array]:
        flat = x[:, order].reshape(len(x), -1)
        if place is not None:
            flat = moved(flat, place(flat))
        values = jax.vmap(phi)(flat)
        wanted = jnp.mean(values, axis=0) if constants is None else constants
        slopes = jnp.sum(jax.vmap(jax.jacfwd(phi))(flat) ** 2, axis=-1)
        return jnp.mean(jnp.sum((values - wanted[None]) ** 2 / (slopes + 1e-6), axis=-1)), wanted

    choices = orders(count)
    misfits, wanted = jax.vmap(misfit)(choices)
    best = jnp.argmin(misfits)
    return choices[best], wanted[best]


def nearest_order(x: Float[Array, "B K 2"], wanted: Float[Array, "B K 2"]) -> Int[Array, "B K"]:
    """Return the order of keypoints in each frame in which they are nearest to wanted positions."""
    choices = orders(x.shape[1])
    apart = jnp.sum((x[:, choices] - wanted[:, None]) ** 2, axis=(2, 3))
    return choices[jnp.argmin(apart, axis=1)]


def arranged(observed: Observation, order: Int[Array, "B K"]) -> Observation:
    """Return observations of B frames; keypoint k is what keypoint `order[b, k]` was."""
    row = jnp.arange(len(order))[:, None]
    return jax.tree.map(lambda part: part[row, order], observed)


def shuffled(observed: Observation, clip: int, key: PRNGKeyArray) -> Observation:
    """Return observations of clips of so many frames each, with the keypoints of every clip in an order of its own.

    A renderer that learns from them reads from looks alone how a part looks.
    """
    count = observed.keypoints.shape[1]
    keys = jax.random.split(key, len(observed.keypoints) // clip)
    order = jax.vmap(lambda key: jax.random.permutation(key, count))(keys)
    return arranged(observed, order.repeat(clip, axis=0))


def shared_constants(phi: Phi, x: Float[np.ndarray, "N T K 2"]) -> Float[Array, "n"]:
    """Return the constants that all recordings share, from keypoints whose order in each is not known.

    In the right order Φ is constant over a recording. The constants are the median over recordings of those in the best
    order of each.
    """
    found = jax.jit(jax.vmap(lambda x: fitting_order(phi, None, x)[1]))(jnp.asarray(x))
    return jnp.median(found, axis=0)
