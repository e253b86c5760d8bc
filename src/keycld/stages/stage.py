"""A recipe is a list of stages; a stage says what is sampled, what is minimised and what may change."""

import dataclasses
from collections.abc import Callable, Hashable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optax

from keycld._errors import KeycldError
from keycld.data import AbstractSampler, Resident
from keycld.stages.losses import AbstractLoss, AbstractStatefulLoss

MakeOptimiser = Callable[[optax.Schedule], optax.GradientTransformation]


@dataclasses.dataclass(frozen=True)
class Group:
    """Parameters that are trained alike.

    Attributes:
        name: for messages and the optimiser's state.
        where: selects them: a function from the model to one of its parts, such as `lambda m: m.dynamics`.
        rate: their learning rate; zero freezes them.
        optimiser: makes an optax transformation from a schedule; None: the stage's own.
    """

    name: str
    where: Callable[[Any], Any]
    rate: float
    optimiser: MakeOptimiser | None = None


@dataclasses.dataclass(frozen=True)
class Stage:
    """One part of a training run.

    Attributes:
        name: appears in the progress, the metrics and the checkpoints' names.
        steps: optimiser steps.
        sampler: samples the clips of a step.
        loss: what is minimised.
        groups: what is trained, and how fast. Of two groups that hold a parameter the later one counts; what none
            holds stays as it is.
        optimiser: makes an optax transformation from a learning-rate schedule.
        schedule: makes that schedule from the peak rate and the number of steps.
        clip: largest global norm of a gradient; larger ones are scaled down to it. None: unlimited.
        prepare: changes the model and adds to the resident data before the first step: statistics, cached keypoints, a
            least-squares fit.
        candidates: in a first stage, how many random initialisations are tried.
        trial: for so many steps each; the one with the lowest loss continues from there.
        warn: what to tell the user when the stage has ended, from the model and the last logged terms; None where all
            is well.
        validate: score the validation set when the stage has ended.
    """

    name: str
    steps: int
    sampler: AbstractSampler
    loss: AbstractLoss | AbstractStatefulLoss
    groups: tuple[Group, ...]
    optimiser: MakeOptimiser = optax.adam
    schedule: Callable[[float, int], optax.Schedule] = lambda rate, steps: optax.constant_schedule(rate)
    clip: float | None = None
    prepare: Callable[[Any, Resident], tuple[Any, Resident]] | None = None
    candidates: int = 1
    trial: int = 0
    warn: Callable[[Any, Mapping[str, float]], str | None] | None = None
    validate: bool = False

    def labels(self, model: eqx.Module) -> list[str | None]:
        """Return for every leaf of the model the name of its group, None where nothing is trained.

        Raises:
            KeycldError: a group matches no parameter.
        """
        leaves, structure = jax.tree.flatten(model)
        numbered = jax.tree.unflatten(structure, range(len(leaves)))
        names: list[str | None] = [None] * len(leaves)
        for group in self.groups:
            try:
                chosen = jax.tree.leaves(group.where(numbered))
            except AttributeError:
                chosen = []
            trainable = [k for k in chosen if isinstance(k, int) and _is_parameter(leaves[k])]
            if not trainable:
                raise KeycldError(
                    f"group '{group.name}' of stage '{self.name}' matches no parameter of this model: correct or "
                    "remove it."
                )
            for k in trainable:
                names[k] = group.name if group.rate > 0 else None
        return names

    def trainable(self, model: eqx.Module) -> Any:
        """Return a pytree of the model's shape: True at every leaf that this stage trains."""
        return jax.tree.unflatten(jax.tree.structure(model), [name is not None for name in self.labels(model)])

    def transformation(self, model: eqx.Module) -> optax.GradientTransformation:
        """Return the optimiser of this stage for the trainable part of a model."""
        rules: dict[Hashable, optax.GradientTransformation] = {
            group.name: (group.optimiser or self.optimiser)(self.schedule(group.rate, self.steps))
            for group in self.groups
            if group.rate > 0
        }
        combined = optax.multi_transform(rules, jax.tree.unflatten(jax.tree.structure(model), self.labels(model)))
        if self.clip is None:
            return combined
        return optax.chain(optax.clip_by_global_norm(self.clip), combined)


def _is_parameter(leaf: Any) -> bool:
    """Return whether a leaf is an array of real numbers, or the shape of one."""
    return isinstance(leaf, (jax.Array, jax.ShapeDtypeStruct)) and jnp.issubdtype(leaf.dtype, jnp.inexact)
