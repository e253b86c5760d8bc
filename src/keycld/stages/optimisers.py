"""Optimisers and schedules for stages, in addition to those of optax."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array
from optax import contrib

_ITERATION = (3.4445, -4.7750, 2.0315)
"""Coefficients of Muon's quintic Newton–Schulz iteration, those of optax. Given once for each iteration, optax compiles
a loop; given once for all, it writes the iterations out one by one, which takes longer to compile."""


def warmup_cosine(rate: float, steps: int, *, warmup: float = 0.05, final: float = 0.02) -> optax.Schedule:
    """Return a schedule that rises linearly from 0 to `rate`, then falls along half a cosine to `final · rate`.

    Args:
        rate: peak learning rate.
        steps: steps of the stage.
        warmup: share of the steps in which the rate rises.
        final: the last rate, as a share of `rate`.
    """
    rise = max(1, round(warmup * steps))
    return optax.warmup_cosine_decay_schedule(0.0, rate, rise, max(steps, rise + 1), final * rate)


def adam(schedule: optax.ScalarOrSchedule) -> optax.GradientTransformation:
    """Return Adam with optax's defaults, over all parameters as one vector (`packed`).

    Args:
        schedule: learning rate by step.
    """
    return packed(optax.adam(schedule))


def muon(schedule: optax.Schedule, *, dense: bool = True) -> optax.GradientTransformation:
    """Return Muon for kernels and Adam for all other parameters.

    The momentum of a kernel, as a matrix from its inputs to its outputs, is replaced by the nearest orthogonal
    matrix, scaled to the root mean square of an update of Adam. Measured on our U-Nets: after about 200 steps the
    reconstruction error that Adam reaches after 600, at the same cost of a step. Kernels of one shape are updated
    together (`packed`).

    Args:
        schedule: learning rate by step. Good peak rates: 5e-3 to 1e-2.
        dense: whether matrices `[outputs, inputs]` are kernels too, or only convolutions `[rows, columns, inputs,
            outputs]`.
    """

    def stacks(packs: Any) -> Any:
        matrices = contrib.MuonDimensionNumbers((1,), (2,))
        return {name: None if name == "rest" else matrices for name in packs}

    inner = contrib.muon(
        schedule, ns_coeffs=(_ITERATION,) * 5, muon_weight_dimension_numbers=stacks, consistent_rms=0.2
    )
    return packed(inner, (2, 4) if dense else (4,))


def packed(inner: optax.GradientTransformation, kernels: tuple[int, ...] = ()) -> optax.GradientTransformation:
    """Return an optimiser that acts on a few large arrays instead of many small ones; the updates are the same.

    Each array costs an optimiser several small programs. A U-Net has dozens of arrays, but few shapes.

    Args:
        inner: an optimiser of a dict: "INPUTSxOUTPUTS" holds all kernels of that shape `[number, inputs, outputs]`,
            "rest" all other parameters `[number]`.
        kernels: dimensions of the arrays that are kernels: 4, convolutions `[rows, columns, inputs, outputs]`; 2,
            matrices `[outputs, inputs]`.
    """

    def matrix(leaf: Array) -> Array:
        return leaf.T if leaf.ndim == 2 else leaf.reshape(-1, leaf.shape[-1])

    def places(leaves: list[Array]) -> dict[str, list[int]]:
        found: dict[str, list[int]] = {}
        for k, leaf in enumerate(leaves):
            shape = jax.eval_shape(matrix, leaf).shape if leaf.ndim in kernels else ()
            found.setdefault("x".join(map(str, shape)) or "rest", []).append(k)
        return found

    def pack(tree: Any) -> dict[str, Array]:
        leaves = jax.tree.leaves(tree)
        return {
            name: jnp.concatenate([leaves[k].reshape(-1) for k in members])
            if name == "rest"
            else jnp.stack([matrix(leaves[k]) for k in members])
            for name, members in places(leaves).items()
        }

    def unpack(packs: Any, tree: Any) -> Any:
        leaves, structure = jax.tree.flatten(tree)
        parts = list(leaves)
        for name, members in places(leaves).items():
            if name == "rest":
                ends = np.cumsum([leaves[k].size for k in members])[:-1]
                found = jnp.split(packs[name], ends)
            else:
                found = [each.T if leaves[k].ndim == 2 else each for k, each in zip(members, packs[name], strict=True)]
            for k, part in zip(members, found, strict=True):
                parts[k] = part.reshape(leaves[k].shape)
        return jax.tree.unflatten(structure, parts)

    def update(updates: Any, state: Any, params: Any = None) -> tuple[Any, Any]:
        changes, state = inner.update(pack(updates), state, None if params is None else pack(params))
        return unpack(changes, updates), state

    return optax.GradientTransformation(lambda params: inner.init(pack(params)), update)


def forgetful(optimiser: Callable[[optax.Schedule], optax.GradientTransformation]):
    """Return an optimiser that drops its state at every step, as KeyCLD's released code does by mistake.

    With Adam the update is then close to −rate · sign(gradient), for any size of the gradient.

    Args:
        optimiser: makes an optax transformation from a schedule.
    """

    def make(schedule: optax.Schedule) -> optax.GradientTransformation:
        inner = optimiser(schedule)

        def update(updates: Any, state: Any, params: Any = None):
            fresh, _ = inner.update(updates, inner.init(params), params)
            return fresh, state

        return optax.GradientTransformation(lambda params: optax.EmptyState(), update)

    return make
