"""Trajectories on the device, from which samplers take clips."""

from collections.abc import Iterable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt8

from keycld._errors import KeycldError
from keycld.data.format.derived import renderer_of
from keycld.data.format.trajectories import Trajectories
from keycld.data.sample.rendered_later import RenderedLater
from keycld.systems import AbstractRenderedSystem, in_single_precision

# XLA uses host memory as it is, without a copy, where it begins at a multiple of this.
_ALIGNMENT = 64


class Resident(eqx.Module):
    """Training trajectories on the device. The true state is never among them.

    Attributes:
        image: all pictures, or a renderer of those that are indexed.
        u: the input, constant along a trajectory `[N, l]` or held from each frame to the next `[N, T, l]`; l is 0 if
            nothing drives the motion.
        dt: seconds between frames.
        cached: what the `prepare` of a stage computed for every frame, for example observed keypoints.
    """

    image: UInt8[Array, "N T H W 3"] | RenderedLater
    u: Float[Array, "N *T l"]
    dt: Float[Array, ""]
    cached: Float[Array, "N T dim"] | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of the pictures, (N, T, H, W, 3)."""
        return self.image.shape


def resident(trajectories: Trajectories) -> Resident:
    """Put trajectories on the device: their pictures, or a renderer if only states are stored.

    Raises:
        KeycldError: there are neither pictures nor a renderer for the states.
    """
    host = on_host([trajectories], len(trajectories))
    return on_device(host, needed_renderer(trajectories), trajectories.dt)


class Host(NamedTuple):
    """What a `Resident` holds, as NumPy arrays with a common first axis.

    Attributes:
        image: uint8 pictures [N, T, H, W, 3], or what they show, float32 [N, T, m].
        u: float32 input.
        constants: parameters that a renderer needs; none with pictures.
    """

    image: np.ndarray
    u: np.ndarray
    constants: dict[str, np.ndarray]

    @property
    def bytes(self) -> int:
        """The memory that the arrays take."""
        return sum(array.nbytes for array in jax.tree.leaves(self))


def needed_renderer(trajectories: Trajectories) -> AbstractRenderedSystem | None:
    """Find the system that renders the pictures of these trajectories; None if they have pictures.

    Raises:
        KeycldError: there are neither pictures nor a renderer for the states.
    """
    system = renderer_of(trajectories) if trajectories.image is None else None
    if system is None and trajectories.image is None:
        raise KeycldError("these data hold neither pictures nor states that a renderer of keycld knows: add '/image'.")
    return system


def on_host(blocks: Iterable[Trajectories], count: int) -> Host:
    """Collect `count` trajectories that come block by block; only they and one block are in memory at any time.

    Raises:
        KeycldError: as `needed_renderer`.
    """
    whole, row = None, 0
    for block in map(_converted, blocks):
        whole = whole or jax.tree.map(lambda array: _aligned((count, *array.shape[1:]), array.dtype), block)
        for target, values in zip(jax.tree.leaves(whole), jax.tree.leaves(block), strict=True):
            target[row : row + len(values)] = values
        row += len(block.u)
    assert whole is not None and row == count
    return whole


def on_device(host: Host, system: AbstractRenderedSystem | None, dt: float) -> Resident:
    """Pass the arrays to JAX, with the system that renders them or None; on a CPU nothing is copied."""
    image, u, constants = jax.device_put(host)
    if system is not None:
        image = RenderedLater(image, constants, system.render, system.size)
    return Resident(image, u, jnp.asarray(dt, jnp.float32))


def _converted(block: Trajectories) -> Host:
    if block.image is not None:
        return Host(block.image, block.input, {})
    system = needed_renderer(block)
    assert system is not None and block.state is not None
    return Host(system.all_visible(block.state, block.parameters), block.input, in_single_precision(block.parameters))


def _aligned(shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
    size = int(np.prod(shape)) * dtype.itemsize
    memory = np.empty(size + _ALIGNMENT, np.uint8)
    first = -memory.ctypes.data % _ALIGNMENT
    return memory[first : first + size].view(dtype).reshape(shape)
