"""Optimiser steps, one or several in a dispatch, as a compiled function."""

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array

from keycld._shares import shared_by
from keycld.data import Clip, Resident
from keycld.stages import AbstractLoss, AbstractStatefulLoss, Rule, Stage
from keycld.training.devices import Devices


class Progress(NamedTuple):
    """The values that a step changes.

    Attributes:
        parameters: the trained parameters.
        optimiser: the optimiser's state.
        memory: the loss's state; () where it has none.
        step: number of the next step.
        healthy: False from the first step on whose loss or gradient is not finite and may not be skipped. Then nothing
            changes any more, so that `diagnose` can examine the parameters of that step.
    """

    parameters: Any
    optimiser: Any
    memory: Any
    step: Array
    healthy: Array


def initial_progress(stage: Stage, model: eqx.Module) -> tuple[Progress, Any]:
    """Return the progress at the stage's first step, and the part of the model that the stage does not train."""
    parameters, rest = _parted(stage, model)
    state = stage.rule.transformation(model, stage.rates()).init(parameters)
    # Copies too: a step donates its buffers, and the same initial state may serve several candidates.
    memory = jax.tree.map(jnp.array, stage.loss.initial()) if isinstance(stage.loss, AbstractStatefulLoss) else ()
    return Progress(parameters, state, memory, jnp.array(0), jnp.array(True)), rest


def refreshed(stage: Stage, model: eqx.Module, progress: Progress) -> tuple[Progress, Any]:
    """Return the progress with the parameters of a changed model, and the part that the stage does not train."""
    parameters, rest = _parted(stage, model)
    return progress._replace(parameters=parameters), rest


def _parted(stage: Stage, model: eqx.Module) -> tuple[Any, Any]:
    # Copies, because a step donates buffers that the caller may still hold. With their dtypes, because a step would be
    # compiled twice otherwise: for weakly typed numbers, and for the strongly typed ones that it returns.
    strong = jax.tree.map(lambda leaf: jnp.array(leaf, leaf.dtype) if eqx.is_array(leaf) else leaf, model)
    return eqx.partition(strong, stage.trainable(strong))


def make_step(
    stage: Stage,
    number: int,
    seed: int,
    steps: int,
    devices: Devices = Devices(),  # noqa: B008
    take: "Take | None" = None,
) -> Callable:
    """Compile `steps` optimiser steps of a stage into one function.

    Several steps hide the time that a dispatch takes, on a GPU most of all.

    Args:
        stage: what is trained.
        number: its number in the recipe, for the random keys.
        seed: of the run.
        steps: optimiser steps of one call.
        devices: share the clips of each step.
        take: takes the steps; by default `take_steps`.

    Returns:
        `run((rest, data), progress) -> (progress, terms)`, of arrays on all devices. Terms are stacked over the steps.
        The buffers of the given progress are donated.
    """
    # Arguments, not constants, of the program: a stage that differs from another in numbers only, such as its seed, its
    # steps, rates or weights, does not compile again.
    chosen = devices.everywhere((step_keys(seed, number), stage.rates(), stage.numbers))
    rule, take = stage.rule, take or take_steps
    return lambda fixed, progress: take(Fixed(rule, devices, steps, chosen, *fixed), progress)


class Fixed(NamedTuple):
    """What steps do not change. What is no array here decides which program takes them.

    Attributes:
        rule: turns gradients into steps.
        devices: share the clips of each step.
        steps: how many.
        chosen: (keys of the stage, learning rates of each step, (sampler, loss)).
        rest: the part of the model that the stage does not train.
        data: the resident data.
    """

    rule: Rule
    devices: Devices
    steps: int
    chosen: tuple[tuple[Array, Array], dict[str, Array], tuple[Any, Any]]
    rest: Any
    data: Resident

    def clips(self, step: Array) -> Clip:
        """Sample the clips of a step."""
        (key, _), _, (sampler, _) = self.chosen
        return sampler(self.data, key, step)


# Several steps: their progress, and the terms stacked over the steps.
Taken = tuple[Progress, dict[str, Array]]
Take = Callable[[Fixed, Progress], Taken]


@functools.partial(eqx.filter_jit, donate="all-except-first")
def take_steps(fixed: Fixed, progress: Progress) -> Taken:
    """Take some steps."""
    rule, devices, chosen, rest = fixed.rule, fixed.devices, fixed.chosen, fixed.rest

    def one(progress: Progress) -> Taken:
        clips = devices.divided(fixed.clips(progress.step))
        with shared_by(devices.mesh):
            return devices.whole(_stepped(rule, chosen, rest, clips, progress))

    return _repeated(one, progress, fixed.steps)


@functools.partial(eqx.filter_jit, donate="all-except-first")
def take_together(fixed: tuple[Fixed, ...], progress: tuple[Progress, ...]) -> tuple[Taken, ...]:
    """Take the steps of several trainings that differ in numbers only, each on its own data, with all numbers at once.

    Equal to `take_steps` of each, up to rounding.
    """
    rule, steps = fixed[0].rule, fixed[0].steps
    chosen, rest = _stacked([each.chosen for each in fixed]), _stacked([each.rest for each in fixed])

    def one(progress: Progress) -> Taken:
        # Data stay where they are: stacked, they would take their memory twice.
        clips = _stacked([each.clips(progress.step[k]) for k, each in enumerate(fixed)])
        return eqx.filter_vmap(functools.partial(_stepped, rule))(chosen, rest, clips, progress)

    current, terms = _repeated(one, _stacked(progress), steps)
    return tuple(
        (jax.tree.map(lambda leaf: leaf[k], current), {name: term[:, k] for name, term in terms.items()})  # noqa: B023
        for k in range(len(fixed))
    )


def _stacked(trees: Sequence[Any]) -> Any:
    """Return pytrees of the same structure as one, whose arrays have a new first axis."""
    return jax.tree.map(lambda *leaves: jnp.stack(leaves) if eqx.is_array(leaves[0]) else leaves[0], *trees)


def _repeated(one: Callable[[Progress], Taken], progress: Progress, steps: int) -> Taken:
    if steps == 1:
        progress, terms = one(progress)
        return progress, jax.tree.map(lambda term: term[None], terms)
    return jax.lax.scan(lambda carry, _: one(carry), progress, length=steps)


def _stepped(rule: Rule, chosen: Any, rest: Any, clips: Clip, progress: Progress) -> Taken:
    """Take one step of one training."""
    (_, loss_key), rates, (_, objective) = chosen
    key = jax.random.fold_in(loss_key, progress.step)
    (loss, (terms, memory)), gradient = _gradient(objective, rest, clips, key, progress)
    # The norm is finite only if every number is; a clipping optimiser computes it too, and XLA computes it once.
    finite = jnp.isfinite(loss) & jnp.isfinite(optax.tree.norm(gradient))
    allowed = finite
    if rule.skips:
        # The optimiser skips what is not finite, and counts.
        gradient = jax.tree.map(lambda each: jnp.where(finite, each, jnp.nan), gradient)
        memory = jax.tree.map(lambda new, old: jnp.where(finite, new, old), memory, progress.memory)
        allowed |= progress.optimiser.notfinite_count < rule.skips
    healthy = progress.healthy & allowed
    now = {name: rate[progress.step] for name, rate in rates.items()}
    transformation = rule.transformation(eqx.combine(progress.parameters, rest), now)
    updates, optimiser = transformation.update(gradient, progress.optimiser, progress.parameters)
    stepped = (optax.apply_updates(progress.parameters, updates), optimiser, memory, progress.step + 1)
    kept = jax.tree.map(lambda new, old: jnp.where(healthy, new, old), stepped, tuple(progress[:4]))
    parameters, optimiser, memory, number = kept
    return Progress(parameters, optimiser, memory, number, healthy), {"loss": loss, **terms}


def diagnose(stage: Stage, number: int, seed: int, progress: Progress, rest: Any, data: Resident) -> str:
    """Return which step, which loss terms and which parameters are not finite.

    Args:
        stage: the stage that failed.
        number: its number in the recipe.
        seed: of the run.
        progress: at the step that failed.
        rest: the part of the model that the stage does not train.
        data: the resident data.
    """
    clip_key, loss_key = step_keys(seed, number)
    clips = stage.sampler(data, clip_key, progress.step)
    key = jax.random.fold_in(loss_key, progress.step)
    compiled = eqx.filter_jit(functools.partial(_gradient, stage.loss))
    (loss, (terms, _)), gradient = compiled(rest, clips, key, progress)
    bad_terms = [name for name, value in ({"loss": loss} | terms).items() if not bool(jnp.isfinite(value))]
    leaves = jax.tree_util.tree_leaves_with_path(gradient)
    bad_leaves = [
        jax.tree_util.keystr(path).lstrip(".") for path, leaf in leaves if not bool(jnp.all(jnp.isfinite(leaf)))
    ]
    bad = []
    if bad_terms:
        # The loss is not finite because a term is not, if it has terms.
        named = bad_terms[1:] or bad_terms
        bad.append(f"loss term{'s' if len(named) > 1 else ''} {', '.join(named)}")
    if bad_leaves:
        more = f" and {len(bad_leaves) - 1} others" if len(bad_leaves) > 1 else ""
        bad.append(f"gradient of {bad_leaves[0]}{more}")
    found = "; ".join(bad) or "squares of the gradient, which overflow"
    return f"not a finite number at step {int(progress.step)}: {found}."


def step_keys(seed: int, stage: int) -> tuple[Array, Array]:
    """Return two keys of a stage, for its sampler and for its loss; each step folds its number into them."""
    key = jax.random.fold_in(jax.random.key(seed), stage + 1)
    clips, loss = jax.random.split(key)
    return clips, loss


def _gradient(
    loss: AbstractLoss | AbstractStatefulLoss, rest: Any, clips: Clip, key: Array, progress: Progress
) -> tuple[Any, Any]:
    """Return ((loss, (terms, next state of the loss)), gradient)."""

    def objective(parameters: Any) -> tuple[Array, tuple[dict[str, Array], Any]]:
        model = eqx.combine(parameters, rest)
        if isinstance(loss, AbstractStatefulLoss):
            value, terms, memory = loss(model, clips, key=key, step=progress.step, memory=progress.memory)
            return value, (terms, memory)
        value, terms = loss(model, clips, key=key, step=progress.step)
        return value, (terms, ())

    return jax.value_and_grad(objective, has_aux=True)(progress.parameters)
