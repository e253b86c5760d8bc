"""A clip: some frames of a trajectory, in order."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from keycld.data.sample.resident import Resident


class Clip(eqx.Module):
    """Frames of one trajectory in order, gaps allowed; a sampler gives a batch of them, stacked.

    Attributes:
        frames: values in [0, 1], or None if the clip holds cached values alone.
        cached: the cached values of the frames, or None.
        index: frame numbers, counted from the first frame of the clip's window.
        u: the input, `[l]` constant or `[span, l]` from the first frame of the window on.
        dt: seconds between consecutive frame numbers.
        span: frames of the longest window, known at compile time; `index` is smaller.
    """

    frames: Float[Array, "*batch F H W 3"] | None
    cached: Float[Array, "*batch F dim"] | None
    index: Int[Array, "*batch F"]
    u: Float[Array, "*batch l"] | Float[Array, "*batch span l"]
    dt: Float[Array, "*batch"]
    span: int = eqx.field(static=True)


def gather(
    data: Resident,
    trajectory: Int[Array, "batch"],
    first: Int[Array, "batch"],
    index: Int[Array, "#batch F"],
    span: int,
    *,
    frames: bool = True,
    cached: bool = False,
) -> Clip:
    """Collect a batch of clips.

    Args:
        data: where from.
        trajectory: number of each clip's trajectory.
        first: where in it the window of the clip begins.
        index: the frames of the window to take.
        span: frames of the longest window.
        frames: False gives cached values instead of pictures.
        cached: True gives cached values with pictures too, if there are any.
    """
    rows, columns = trajectory[:, None], first[:, None] + index
    held = jnp.minimum(first[:, None] + jnp.arange(span)[None, :], data.image.shape[1] - 1)
    u = data.u[trajectory] if data.u.ndim == 2 else data.u[rows, held]
    return Clip(
        frames=data.image[rows, columns].astype(jnp.float32) / 255.0 if frames else None,
        cached=data.cached[rows, columns] if (cached or not frames) and data.cached is not None else None,
        index=index,
        u=u,
        dt=jnp.broadcast_to(data.dt, trajectory.shape),
        span=span,
    )
