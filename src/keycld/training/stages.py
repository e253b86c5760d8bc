"""A recipe is a list of stages; a stage says what is sampled, what is minimised and what may change."""

import dataclasses
from collections.abc import Callable, Hashable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array
from optax import contrib

from keycld.data import AbstractSampler, Resident

Loss = Callable[..., tuple[Array, dict[str, Array]]]


@dataclasses.dataclass(frozen=True)
class Stage:
    """One part of a training run.

    - `name`: appears in the progress, the metrics and the checkpoints' names.
    - `steps`: optimiser steps.
    - `sampler`: draws the clips of a step.
    - `loss`: `loss(model, clips, key=key, step=step) -> (scalar, terms)`.
    - `rates`: learning rate of each named group of parameters; what no name covers stays as it is. A group is named
      by its place in the model, such as `dynamics` or `dynamics.law.potential.perceptron`; the longest name that
      fits a parameter counts, and a rate of zero freezes.
    - `optimiser`: makes an optax transformation from a learning-rate schedule.
    - `schedule`: makes that schedule from the peak rate and the number of steps.
    - `clip`: largest global norm of a gradient; larger ones are shortened to it. None: unlimited.
    - `prepare`: changes the model and adds to the resident data before the first step (statistics, cached
      keypoints, a least-squares start).
    - `candidates`, `trial`: in a first stage, how many random starts are tried for that many steps; the one with the
      lowest loss goes on from there.
    - `remark`: what to tell the person who waits when the stage has ended, from the model and the last logged terms;
      None where all is well.
    - `validate`: score the validation set when the stage has ended.
    """

    name: str
    steps: int
    sampler: AbstractSampler
    loss: Loss
    rates: Mapping[str, float]
    optimiser: Callable[[optax.Schedule], optax.GradientTransformation] = optax.adam
    schedule: Callable[[float, int], optax.Schedule] = lambda rate, steps: optax.constant_schedule(rate)
    clip: float | None = None
    prepare: Callable[[Any, Resident], tuple[Any, Resident]] | None = None
    candidates: int = 1
    trial: int = 0
    remark: Callable[[Any, Mapping[str, float]], str | None] | None = None
    validate: bool = False

    def groups(self, model: eqx.Module) -> Any:
        """A pytree of the model's shape: at every leaf the name of its group, or None where nothing is trained."""

        def name_of(path: Any, leaf: Any) -> str | None:
            place = jax.tree_util.keystr(path, simple=True, separator=".") + "."
            inside = [name for name in self.rates if place.startswith(name + ".")]
            return max(inside, key=len) if inside and eqx.is_inexact_array(leaf) else None

        return jax.tree_util.tree_map_with_path(name_of, model)

    def trainable(self, model: eqx.Module) -> Any:
        """A pytree of the model's shape: True at every leaf that this stage trains."""
        groups = self.groups(model)
        return jax.tree.map(lambda name: name is not None and self.rates[name] > 0, groups, is_leaf=lambda x: x is None)

    def transformation(self, model: eqx.Module) -> optax.GradientTransformation:
        """The optimiser of this stage for the trainable part of a model."""
        names = jax.tree.map(
            lambda name: name if name is not None and self.rates[name] > 0 else None,
            self.groups(model),
            is_leaf=lambda x: x is None,
        )
        rules: dict[Hashable, optax.GradientTransformation] = {
            name: self.optimiser(self.schedule(rate, self.steps)) for name, rate in self.rates.items() if rate > 0
        }
        combined = optax.multi_transform(rules, names)
        if self.clip is None:
            return combined
        return optax.chain(optax.clip_by_global_norm(self.clip), combined)


def warmup_cosine(rate: float, steps: int, *, warmup: float = 0.05, final: float = 0.02) -> optax.Schedule:
    """Linear rise over the first `warmup` part of the steps, then half a cosine down to `final · rate`."""
    rise = max(1, round(warmup * steps))
    return optax.warmup_cosine_decay_schedule(0.0, rate, rise, max(steps, rise + 1), final * rate)


def muon(schedule: optax.Schedule) -> optax.GradientTransformation:
    """Muon for the networks' kernels, Adam for everything else.

    The momentum of a kernel, as a matrix from its inputs to its outputs, is replaced by the nearest orthogonal
    matrix, with the root mean square that an update of Adam has. Measured on our U-Nets: the reconstruction error
    that Adam reaches after 600 steps after about 200, at the same cost a step. Good peak rates: 5e-3 to 1e-2.
    """

    def kernels(parameters: Any) -> Any:
        def of(path: Any, leaf: Any) -> contrib.MuonDimensionNumbers | None:
            if leaf.ndim == 4:  # a convolution: rows, columns and inputs → outputs
                return contrib.MuonDimensionNumbers((0, 1, 2), (3,))
            network = jax.tree_util.keystr(path, simple=True, separator=".").split(".")[0] != "dynamics"
            return contrib.MuonDimensionNumbers((1,), (0,)) if network and leaf.ndim == 2 else None

        return jax.tree_util.tree_map_with_path(of, parameters)

    return contrib.muon(schedule, muon_weight_dimension_numbers=kernels, consistent_rms=0.2)


def forgetful(optimiser: Callable[[optax.Schedule], optax.GradientTransformation]):
    """The fault of the released code: the optimiser starts from an empty state at every step.

    With Adam the update is then close to −rate · sign(gradient), whatever the gradient's size.
    """

    def make(schedule: optax.Schedule) -> optax.GradientTransformation:
        inner = optimiser(schedule)

        def update(updates: Any, state: Any, params: Any = None):
            fresh, _ = inner.update(updates, inner.init(params), params)
            return fresh, state

        return optax.GradientTransformation(lambda params: optax.EmptyState(), update)

    return make


def step_keys(seed: int, stage: int) -> tuple[Array, Array]:
    """Two keys of a stage: one draws the clips, one is the loss's own. A step folds its number in."""
    key = jax.random.fold_in(jax.random.key(seed), stage + 1)
    clips, loss = jax.random.split(key)
    return clips, loss


def finite(tree: Any) -> Array:
    """Whether every number of a pytree is finite."""
    leaves = [jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(tree) if eqx.is_inexact_array(leaf)]
    return jnp.all(jnp.stack(leaves)) if leaves else jnp.array(True)
