"""The clips of a step, shared by several devices within a loss."""

import contextlib
import contextvars
from collections.abc import Callable, Iterator
from typing import Any

import equinox as eqx
import jax
from jax.sharding import Mesh, PartitionSpec
from jaxtyping import PyTree

_MESH: contextvars.ContextVar[Mesh | None] = contextvars.ContextVar("mesh", default=None)


@contextlib.contextmanager
def shared_by(mesh: Mesh | None) -> Iterator[None]:
    """Tell what is traced within that the devices of a mesh, of one axis, share the clips of a step; None: one does."""
    token = _MESH.set(mesh)
    try:
        yield
    finally:
        _MESH.reset(token)


def by_device(function: Callable[..., Any], module: PyTree, *clips: PyTree) -> PyTree:
    """Return `function(module, *part)` for the part of the clips that each device has, stacked.

    XLA keeps one sum of derivatives by the module, which devices that share the clips would complete in every iteration
    of a loop within the function: for a motion of 60 frames they would send 60 times as much as need be. So each device
    computes alone, and the derivatives are added once, after the loop.

    Args:
        function: of a module and clips. Clips that the devices cannot share equally are one part.
        module: arrays, all of them on each device.
        clips: pytrees of arrays with a common first axis.
    """
    mesh, count = _MESH.get(), jax.tree.leaves(clips)[0].shape[0]

    def alone(module: PyTree, *part: PyTree) -> PyTree:
        return jax.tree.map(lambda leaf: leaf[None], function(module, *part))

    if mesh is None or count % mesh.size:
        return alone(module, *clips)
    whole, divided = PartitionSpec(), PartitionSpec(mesh.axis_names)
    specs = (whole, *[divided] * len(clips))
    return jax.shard_map(alone, mesh=mesh, in_specs=specs, out_specs=divided, check_vma=False)(module, *clips)


def over_clips(function: Callable[..., Any], module: PyTree, *clips: PyTree) -> PyTree:
    """Return `function(module, *clip)` of every clip: a `vmap` that several devices share, as `by_device` does.

    Args:
        function: of a module and one clip.
        module: a pytree with arrays, such as an Equinox module.
        clips: pytrees of arrays with a common first axis.
    """
    arrays, rest = eqx.partition(module, eqx.is_array)

    def every(arrays: PyTree, *part: PyTree) -> PyTree:
        return jax.vmap(lambda *clip: function(eqx.combine(arrays, rest), *clip))(*part)

    return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), by_device(every, arrays, *clips))
