"""The devices that share each batch of a training."""

import contextlib
import dataclasses
import os
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import PyTree

from keycld._errors import KeycldError
from keycld.data import Resident
from keycld.stages import Stage

_CLIPS = "clips"
_SIMULATE = "--xla_force_host_platform_device_count"


@dataclasses.dataclass(frozen=True)
class Devices:
    """Devices that each take an equal part of the clips of a step: data parallelism.

    All of them hold the parameters, the optimiser's state and the resident trajectories. A step is one program for the
    whole batch, which XLA divides, so that terms which couple clips are those of one device, up to rounding. Loops over
    frames are within `keycld._shares.by_device`, so that gradients are added once a step. What happens between steps
    (least-squares fits, cached keypoints, scores) happens on the first device of each process.

    Attributes:
        mesh: None: one device, and nothing is moved or divided.
    """

    mesh: Mesh | None = None

    @property
    def count(self) -> int:
        """The number of devices."""
        return 1 if self.mesh is None else self.mesh.size

    def everywhere(self, tree: PyTree) -> PyTree:
        """Return the arrays of a pytree on all devices; those that are there already stay as they are."""
        if self.mesh is None:
            return tree
        whole = NamedSharding(self.mesh, PartitionSpec())

        def copied(leaf: Any) -> Any:
            if not eqx.is_array(leaf) or leaf.sharding == whole:
                return leaf
            return _on_all(leaf, whole)

        return jax.tree.map(copied, tree)

    def here(self, tree: PyTree) -> PyTree:
        """Return the first device's copy of what `everywhere` or a step returned."""
        if self.mesh is None:
            return tree
        return jax.tree.map(lambda leaf: leaf.addressable_data(0) if eqx.is_array(leaf) else leaf, tree)

    def divided(self, batch: PyTree) -> PyTree:
        """Let each device compute its part of a batch, in a compiled function; the first axis counts the clips."""
        return self._laid_out(batch, PartitionSpec(_CLIPS))

    def whole(self, tree: PyTree) -> PyTree:
        """Let each device have all of an outcome, in a compiled function."""
        return self._laid_out(tree, PartitionSpec())

    def check(self, stage: Stage, data: Resident) -> None:
        """Refuse a stage whose clips cannot be shared equally.

        Raises:
            KeycldError: their number is no multiple of that of the devices.
        """
        clips = eqx.filter_eval_shape(stage.sampler, data, jax.random.key(0), jax.numpy.array(0))
        batch = clips.index.shape[0]
        if stage.steps and batch % self.count:
            raise KeycldError(
                f"stage '{stage.name}' takes {batch} clips a step, which {self.count} devices cannot share equally: "
                f"set its batch to a multiple of {self.count}, or take fewer devices."
            )

    def _laid_out(self, tree: PyTree, how: PartitionSpec) -> PyTree:
        if self.mesh is None:
            return tree
        layout = NamedSharding(self.mesh, how)
        return jax.tree.map(lambda leaf: jax.lax.with_sharding_constraint(leaf, layout), tree)


def _on_all(leaf: Any, whole: NamedSharding) -> Any:
    """Return an array on all devices; those of other processes get their copies there, of the same values."""
    if whole.is_fully_addressable:
        return jax.device_put(leaf, whole)
    if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        return jax.random.wrap_key_data(_on_all(jax.random.key_data(leaf), whole))
    values = np.asarray(leaf)
    return jax.make_array_from_callback(values.shape, whole, lambda index: values[index])


def use_devices(count: int) -> Devices:
    """Return the first devices of this machine, or of each process that has joined the training.

    A processor counts as so many devices, unless the process has computed before, or `XLA_FLAGS` says how many.

    Args:
        count: how many of each process.

    Raises:
        KeycldError: there are fewer.
    """
    if count > 1 and _SIMULATE not in os.environ.get("XLA_FLAGS", ""):
        with contextlib.suppress(RuntimeError):
            jax.config.update("jax_num_cpu_devices", count)
    found = jax.local_devices()
    if not 1 <= count <= len(found):
        kind = found[0].platform
        known = f"a number from 1 to {len(found)}, those" if len(found) > 1 else "1, the only one"
        how = ": take fewer" if count > 1 else ""
        if how and kind == "cpu":
            how += f", or simulate more with XLA_FLAGS={_SIMULATE}={count}"
        raise KeycldError(f"--devices is {known} of this machine ({kind}), not {count}{how}.")
    if count == jax.process_count() == 1:
        return Devices()
    each = [[d for d in jax.devices() if d.process_index == k][:count] for k in range(jax.process_count())]
    return Devices(Mesh(np.concatenate(each), (_CLIPS,)))
