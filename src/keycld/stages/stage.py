"""Stages, the parts of a recipe: what is sampled, what is minimised and which parameters are trained."""

import dataclasses
import functools
import operator
from collections.abc import Callable, Hashable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optax

from keycld._errors import KeycldError
from keycld.data import AbstractSampler, Resident
from keycld.stages.losses import AbstractLoss, AbstractStatefulLoss
from keycld.stages.optimisers import adam

# `part("estimator", "renderer")` is `lambda model: (model.estimator, model.renderer)`, and equal to itself.
part = functools.cache(operator.attrgetter)


def whole(model: Any) -> Any:
    """Return the model: selects all parameters."""
    return model


MakeOptimiser = Callable[[optax.Schedule], optax.GradientTransformation]


@dataclasses.dataclass(frozen=True)
class Group:
    """Parameters that are trained in the same way.

    Attributes:
        name: for messages and the optimiser's state.
        where: selects the parameters: a function from the model to its parts, such as `part("dynamics")`.
        rate: their peak learning rate; zero freezes them.
        optimiser: makes an optax transformation from a schedule; None: the one of the stage.
    """

    name: str
    where: Callable[[Any], Any]
    rate: float
    optimiser: MakeOptimiser | None = None


@dataclasses.dataclass(frozen=True)
class Rule:
    """What turns the gradients of a stage into steps, apart from the learning rates.

    Rules with equal attributes are equal, so that stages that differ in numbers only share one compiled program.

    Attributes:
        groups: as in `Stage`, with 1 for every rate above zero.
        optimiser: as in `Stage`.
        clip: as in `Stage`.
        skips: as in `Stage`.
    """

    groups: tuple[Group, ...]
    optimiser: MakeOptimiser
    clip: float | None
    skips: int

    def labels(self, model: eqx.Module) -> list[str | None]:
        """Return the name of the group of each leaf of the model, None where it is not trained.

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
                raise KeycldError(f"group '{group.name}' matches no parameter of this model: correct or remove it.")
            for k in trainable:
                names[k] = group.name if group.rate > 0 else None
        return names

    def transformation(self, model: eqx.Module, rates: Mapping[str, jax.Array | float]) -> optax.GradientTransformation:
        """Return the optimiser for the trainable part of a model, with the learning rates of one step."""

        def constant(rate: jax.Array | float) -> optax.Schedule:
            return lambda count: rate

        rules: dict[Hashable, optax.GradientTransformation] = {
            group.name: (group.optimiser or self.optimiser)(constant(rates[group.name]))
            for group in self.groups
            if group.rate > 0
        }
        combined = optax.multi_transform(rules, jax.tree.unflatten(jax.tree.structure(model), self.labels(model)))
        if self.clip is not None:
            combined = optax.chain(optax.clip_by_global_norm(self.clip), combined)
        return optax.apply_if_finite(combined, self.skips) if self.skips else combined


@dataclasses.dataclass(frozen=True)
class Stage:
    """One part of a training run.

    Attributes:
        name: for the progress bar, the metrics and the names of checkpoints.
        steps: optimiser steps.
        sampler: samples the clips of a step.
        loss: what is minimised.
        groups: the trained parameters with their rates. If two groups hold the same parameter, the later one counts;
            parameters in no group are not trained.
        optimiser: makes an optax transformation from a learning-rate schedule.
        schedule: makes that schedule from the peak rate and the number of steps.
        clip: largest global norm of a gradient; larger ones are scaled down to it. None: unlimited.
        skips: steps in a row whose loss or gradient may be not finite: they change nothing. One more fails the stage,
            and training begins again with other initial weights; 0: the first one ends it.
        prepare: changes the model and the resident data before the first step: statistics, cached keypoints, a
            least-squares fit.
        every: steps between repetitions of `refresh`; 0: none.
        refresh: changes the model and the resident data as `prepare` does, after each `every` steps; all arrays keep
            their shapes.
        candidates: number of random initialisations to try; only for a first stage.
        trial: steps of each of these trials; the one with the lowest loss continues.
        alternative: loss of every second candidate in its trial; None: `loss`. Their values must be comparable.
        judge: says after the last step what has failed, or None, from the model and the data.
            Training then begins again with other initial weights.
        validate: whether the validation set is scored after the last step.
        with_validation: whether the resident data are those of training and validation: for a last fit of what was
            chosen, after the last choice.
    """

    name: str
    steps: int
    sampler: AbstractSampler
    loss: AbstractLoss | AbstractStatefulLoss
    groups: tuple[Group, ...]
    optimiser: MakeOptimiser = adam
    schedule: Callable[[float, int], optax.Schedule] = lambda rate, steps: optax.constant_schedule(rate)
    clip: float | None = None
    skips: int = 0
    prepare: Callable[[Any, Resident], tuple[Any, Resident]] | None = None
    every: int = 0
    refresh: Callable[[Any, Resident], tuple[Any, Resident]] | None = None
    candidates: int = 1
    trial: int = 0
    alternative: AbstractLoss | None = None
    judge: Callable[[Any, Resident], str | None] | None = None
    validate: bool = False
    with_validation: bool = False

    def labels(self, model: eqx.Module) -> list[str | None]:
        """Return the name of the group of each leaf of the model, None where it is not trained.

        Raises:
            KeycldError: a group matches no parameter.
        """
        try:
            return self.rule.labels(model)
        except KeycldError as error:
            raise KeycldError(f"stage '{self.name}': {error}") from None

    def trainable(self, model: eqx.Module) -> Any:
        """Return a pytree with the structure of the model: True at each leaf that this stage trains."""
        return jax.tree.unflatten(jax.tree.structure(model), [name is not None for name in self.labels(model)])

    def rates(self) -> dict[str, jax.Array]:
        """Return the learning rate of each trained group at each step.

        The last one is repeated up to a multiple of 4096 steps, so that few shapes occur, and compiled programs serve
        stages of many lengths.
        """
        step = jnp.minimum(jnp.arange(-(-max(self.steps, 1) // 4096) * 4096), max(self.steps - 1, 0))
        return {
            group.name: jnp.broadcast_to(jax.vmap(self.schedule(group.rate, self.steps))(step), step.shape)
            for group in self.groups
            if group.rate > 0
        }

    def skipped(self, optimiser: Any) -> int:
        """Return how many steps the stage has skipped so far, from the state of its optimiser."""
        return int(optimiser.total_notfinite) if self.skips else 0

    @property
    def rule(self) -> Rule:
        """What turns gradients into steps."""
        groups = tuple(dataclasses.replace(group, rate=float(group.rate > 0)) for group in self.groups)
        return Rule(groups, self.optimiser, self.clip, self.skips)

    @property
    def numbers(self) -> Any:
        """The sampler and the loss with their float attributes as arrays, which a program takes as arguments."""
        return jax.tree.map(lambda leaf: jnp.asarray(leaf) if type(leaf) is float else leaf, (self.sampler, self.loss))


def _is_parameter(leaf: Any) -> bool:
    """Return whether a leaf is an array of real numbers, or the shape of one."""
    return isinstance(leaf, (jax.Array, jax.ShapeDtypeStruct)) and jnp.issubdtype(leaf.dtype, jnp.inexact)
