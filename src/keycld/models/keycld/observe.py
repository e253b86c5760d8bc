"""Which recordings of the training data are observed, and the keypoints there."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from keycld.data import Resident

# About how many recordings a fit observes, and a comparison.
FITTED, COMPARED = 150, 8
# Consecutive frames of a recording that a fit observes, at most. They tell the forces; more frames cost memory and time
# in proportion, and tell little where nearby motions part. Of few recordings all frames are observed.
_SPAN, _MOST = 80, 12_000


def observed_keypoints(
    model: Any, data: Resident, trajectories: int, first: int = 0, *, taken_up: bool = True
) -> tuple[jax.Array, jax.Array]:
    """Return the keypoints `[n, T, 2K]` that the model observes in about so many recordings, and their inputs.

    Many long recordings are observed for a while only: `taken_up`, from frames on that are spread over them, else from
    their first frame on.
    """
    some, begin, span = chosen(data, trajectories, first, taken_up=taken_up)
    x = [observe(model, data.image[i][k : k + span]) for i, k in zip(some, begin, strict=True)]
    u = data.u[some.start : some.stop : some.step]
    if u.ndim == 3:
        u = jnp.stack([each[k : k + span] for each, k in zip(u, begin, strict=True)])
    return jnp.stack(x), u


def spread(data: Resident, count: int, first: int = 0) -> range:
    """Return about so many recordings at equal distances."""
    step = max(1, len(data.u) // count)
    return range(first % step, len(data.u), step)


def chosen(
    data: Resident, trajectories: int, first: int = 0, *, taken_up: bool = True
) -> tuple[range, np.ndarray, int]:
    """Return the recordings that `observed_keypoints` observes, the first frame in each, and how many frames."""
    some, length = spread(data, trajectories, first), data.image.shape[1]
    span = min(length, max(_SPAN, _MOST // len(some)))
    return some, np.linspace(0, (length - span) * taken_up, len(some)).round().astype(int), span


# Compiled once for all stages.
@eqx.filter_jit
def observe(model: Any, image: jax.Array) -> jax.Array:
    """Return the keypoints `[T, 2K]` that the model observes in a recording, uint8 `[T, H, W, 3]`."""
    frames = image.astype(jnp.float32) / 255.0
    return model.observe_clips(frames[None]).keypoints.reshape(len(frames), -1)
