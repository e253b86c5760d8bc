"""The training loop: stages in order, checkpoints, metrics, resume."""

import contextlib
import dataclasses
import functools
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

from keycld._errors import KeycldError
from keycld._progress import Bar
from keycld.data import Resident, TrainingData
from keycld.models.base import AbstractModel
from keycld.stages import Stage
from keycld.training.checkpoints import STATE, WEIGHTS, latest_checkpoint, load_arrays, read_position, save_checkpoint
from keycld.training.devices import Devices
from keycld.training.run_files import Metrics, write_verdict
from keycld.training.step import Progress, diagnose, initial_progress, make_step, refreshed
from keycld.training.trackers import Tracker

# As many as between two lines of the log. With one program for a dispatch, its arguments and results pass once.
STEPS_PER_DISPATCH = 25
_NOTHING = contextlib.nullcontext()
# More than any stage tries: each attempt has random weights and steps of its own.
_MOST_CANDIDATES = 1000
_ATTEMPTS = 3
Validate = Callable[[AbstractModel], dict[str, float]]
# (rest, data), progress → progress, terms: several steps in one dispatch.
Run = Callable[[tuple[Any, Resident], Progress], tuple[Progress, dict[str, Any]]]


@dataclasses.dataclass
class _Clock:
    """Wall seconds, CPU seconds and frames of all processes that worked on this run."""

    seconds: float = 0.0
    cpu_seconds: float = 0.0
    frames: int = 0

    def __post_init__(self) -> None:
        self._wall, self._cpu = time.monotonic(), time.process_time()

    def tick(self) -> None:
        wall, cpu = time.monotonic(), time.process_time()
        self.seconds += wall - self._wall
        self.cpu_seconds += cpu - self._cpu
        self._wall, self._cpu = wall, cpu


class _Placed:
    """What a stage does not train, and the data, on all devices: copied there again only when they are others."""

    def __init__(self, devices: Devices):
        self._devices, self._of, self._copies = devices, (None, None), (None, None)

    def of(self, rest: Any, data: Resident) -> Any:
        if rest is not self._of[0] or data is not self._of[1]:
            self._of, self._copies = (rest, data), self._devices.everywhere((rest, data))
        return self._copies


def train_stages(
    fresh: Callable[[int, Mapping[str, Any]], AbstractModel],
    changes: Callable[[AbstractModel], dict[str, Any]],
    stages: tuple[Stage, ...],
    source: TrainingData,
    everything: Callable[[], Resident],
    folder: Path,
    *,
    devices: Devices,
    seed: int,
    steps_per_dispatch: int,
    checkpoint_seconds: float,
    log_every: int,
    keep: int,
    profile: bool,
    tracker: Tracker,
    validate: Validate,
    renamed: Mapping[str, str],
) -> AbstractModel:
    """Train all stages, with a checkpoint at the end of each; resume from the latest checkpoint in the folder.

    A checkpoint holds weights, the states of optimiser and loss, the cached values of a stage, and the step. The
    randomness of a step is a function of seed, stage and step number, and so is the resident part of the data: a
    resumed run takes the same steps, bit for bit.

    Args:
        fresh: `fresh(k, changes)` returns an untrained model with the k-th random weights and some settings changed.
        changes: returns the settings that training has changed in a model.
        stages: the recipe.
        source: training data.
        everything: returns the data of training and validation, for stages that are fitted to both.
        folder: run folder.
        devices: share the clips of each step.
        seed: of all randomness.
        steps_per_dispatch: optimiser steps in one compiled call.
        checkpoint_seconds: time between checkpoints.
        log_every: steps between lines of `metrics.jsonl`.
        keep: number of checkpoints to keep.
        profile: trace the second dispatch of each stage; the first one compiles.
        tracker: gets the metrics too.
        validate: returns the scores of a model on the validation set.
        renamed: as in `load_arrays`.

    Raises:
        KeycldError: a loss or gradient is not finite; a checkpoint is damaged or cannot be written; a stage has failed
            three times, each with other initial weights.
    """
    model, failures = fresh(0, {}), []
    before = [sum(stage.steps for stage in stages[:k]) for k in range(len(stages) + 1)]
    first, step, clock = 0, 0, _Clock()
    checkpoint = latest_checkpoint(folder)
    progress: Progress | None = None
    current: Progress
    rest: Any
    data: Resident = source.at(0)
    if checkpoint is not None:
        position = read_position(checkpoint)
        first, step = position["stage"], position["step"]
        clock = _Clock(position["seconds"], position["cpu_seconds"], position["frames"])
        failures = position.get("failures", [])
        model = load_arrays(checkpoint / WEIGHTS, fresh(0, position.get("changes", {})), renamed)
        data = source.at(before[first])
        if position["cached"]:
            data = _with_cached(data, jax.ShapeDtypeStruct((*data.image.shape[:2], position["cached"]), np.float32))
        started = None if position["done"] else initial_progress(stages[first], model)[0]
        state = load_arrays(checkpoint / STATE, _state(data, started), renamed)
        data = _with_cached(data, state["cached"])
        if started is None:
            first, step = first + 1, 0
        else:
            progress = started._replace(optimiser=state["optimiser"], memory=state["memory"], step=started.step + step)
    metrics = Metrics(folder, before[first] + step)

    def whole(progress: Progress, rest: Any) -> Any:
        """Return the model with the trained parameters of the first device."""
        return eqx.combine(devices.here(progress.parameters), rest)

    def save(number: int, progress: Progress | None, model: AbstractModel, step: int) -> None:
        clock.tick()
        position = {
            "stage": number,
            "stages": len(stages),
            "name": stages[number].name,
            "step": step,
            "done": progress is None,
            "cached": 0 if data.cached is None else data.cached.shape[-1],
            "changes": changes(model),
            "failures": failures,
            "seconds": clock.seconds,
            "cpu_seconds": clock.cpu_seconds,
            "frames": clock.frames,
        }
        name = f"{_attempt(failures)}{number:02d}-{stages[number].name}-{step:06d}"
        save_checkpoint(folder, name, model, _state(data, progress), position, keep)

    def record(number: int, done: int, values: dict[str, float]) -> None:
        """Write one line of the log, with the cost of the training so far."""
        step = before[number] + done
        cost = {"seconds": round(clock.seconds, 2), "cpu_seconds": round(clock.cpu_seconds, 2), "frames": clock.frames}
        metrics.write(step=step, stage=stages[number].name, **cost, **values)
        tracker.log(step, values)

    number = first
    while number < len(stages):
        stage, again = stages[number], _MOST_CANDIDATES * len(failures)
        compiled: Callable[[int], Run] = functools.cache(
            functools.partial(make_step, stage, number + again, seed, devices=devices)
        )
        models: list[AbstractModel] = []
        pinned, per_step = _clips(stage, data)
        if progress is not None:
            current, rest = progress, initial_progress(stage, model)[1]
        else:
            data = everything() if stage.with_validation else _moved(data, source.at(before[number]))
            models = [model, *(fresh(again + k, {}) for k in range(1, stage.candidates))]
            other: Callable[[int], Run] = compiled
            if stage.alternative is not None:
                differing = dataclasses.replace(stage, loss=stage.alternative)
                other = functools.cache(functools.partial(make_step, differing, number + again, seed, devices=devices))
            current, rest, data = _best(stage, models, data, (compiled, other), steps_per_dispatch, devices)
        placed = _Placed(devices)
        done = int(current.step)
        clock.frames += per_step * done * len(models)
        bar = Bar(stage.name, stage.steps)
        saved, dispatches = time.monotonic(), 0
        pending: list[dict[str, Any]] = []
        logged_at, logged_frames = time.monotonic(), clock.frames
        values: dict[str, float] = {}
        while done < stage.steps:
            chunk = min(steps_per_dispatch, stage.steps - done, log_every - done % log_every)
            if not pinned:
                here = before[number] + done
                data, end = _moved(data, source.at(here)), source.until(here)
                chunk = chunk if end is None else min(chunk, end - here)
            if stage.refresh is not None:
                chunk = min(chunk, stage.every - done % stage.every)
                # Before the step and not after the last one, so that a run which resumes here repeats it.
                if done and done % stage.every == 0:
                    model, data = stage.refresh(whole(current, rest), data)
                    current, rest = refreshed(stage, model, current)
            traced = profile and dispatches == 1
            with (
                jax.profiler.trace(folder / "profile" / stage.name, create_perfetto_trace=True) if traced else _NOTHING
            ):
                current, terms = compiled(chunk)(placed.of(rest, data), devices.everywhere(current))
                if traced:
                    jax.block_until_ready(current)
            dispatches += 1
            pending.append(terms)
            done += chunk
            clock.frames += per_step * chunk
            if done % log_every < chunk or done == stage.steps:
                values = {k: float(np.mean([np.mean(t[k]) for t in pending])) for k in terms}
                pending = []
                if not bool(current.healthy):
                    raise diagnose(stage, number + again, seed, devices.here(current), rest, data)
                clock.tick()
                now = time.monotonic()
                rate = (clock.frames - logged_frames) / max(now - logged_at, 1e-9)
                logged_at, logged_frames = now, clock.frames
                record(number, done, values)
                bar.show(done, rate, "  ".join(f"{name} {value:.4g}" for name, value in values.items()))
                if now - saved > checkpoint_seconds and done < stage.steps:
                    save(number, devices.here(current), whole(current, rest), done)
                    saved = time.monotonic()
        model = whole(current, rest)
        progress = None
        if stage.judge is not None and (failure := stage.judge(model, data, values)):
            # Not saved: a run that resumes here fails in the same way.
            failures.append(f"{stage.name}: {failure}")
            if len(failures) == _ATTEMPTS:
                write_verdict(folder, failures, passed=False)
                raise KeycldError(
                    f"training failed {_ATTEMPTS} times (`keycld report {folder}` shows each), the last time in stage "
                    f"{failures[-1]}"
                )
            print(f"restart      {failures[-1]}", file=sys.stderr, flush=True)
            model, data, number = fresh(_MOST_CANDIDATES * len(failures), {}), source.at(0), 0
            metrics = Metrics(folder, 0)
            continue
        if stage.validate:
            scores = validate(model)
            clock.tick()
            record(number, done, scores)
            print("validation   " + "  ".join(f"{k} {v:.3f}" for k, v in scores.items()), flush=True)
        save(number, None, model, done)
        number += 1
    write_verdict(folder, failures, passed=True)
    return model


def _attempt(failures: list[str]) -> str:
    """Return a prefix of the names of checkpoints: none at first."""
    return f"again{len(failures)}-" if failures else ""


def _best(
    stage: Stage,
    models: list[AbstractModel],
    data: Resident,
    compiled: tuple[Callable[[int], Run], Callable[[int], Run]],
    steps_per_dispatch: int,
    devices: Devices,
) -> tuple[Progress, Any, Resident]:
    """Return the initial state of the stage; of several models, the state of the best one after the stage's trial.

    The first of the two losses is for models with an even number, the second for the others.
    """
    found = []
    for number, model in enumerate(models):
        prepared, resident = (model, data) if stage.prepare is None else stage.prepare(model, data)
        progress, rest = initial_progress(stage, prepared)
        if len(models) == 1:
            return progress, rest, resident
        losses, trial = [], min(stage.trial, stage.steps)
        progress, fixed = devices.everywhere(progress), devices.everywhere((rest, resident))
        for done in range(0, trial, steps_per_dispatch):
            run = compiled[number % 2](min(steps_per_dispatch, trial - done))
            progress, terms = run(fixed, progress)
            losses.extend(np.asarray(terms["loss"]))
        # The mean over the last third, because the loss of one batch is noisy.
        score = float(np.mean(losses[-(trial // 3) :]))
        sound = bool(progress.healthy) and np.isfinite(score)
        found.append((score if sound else np.inf, progress, rest, resident))
    _, progress, rest, resident = min(found, key=lambda candidate: candidate[0])
    return progress, rest, resident


def _clips(stage: Stage, data: Resident) -> tuple[bool, int]:
    """Return whether the stage's clips hold cached values, and the number of frames that a step passes to networks.

    Cached values belong to the trajectories that are resident at the first step, so these stay for the whole stage.
    """
    clips = eqx.filter_eval_shape(stage.sampler, data, jax.random.key(0), jax.numpy.array(0))
    return clips.frames is None, 0 if clips.frames is None else int(np.prod(clips.frames.shape[:2]))


def _moved(old: Resident, new: Resident) -> Resident:
    """Return the new resident trajectories; the old ones with their cached values if they are the same."""
    return old if old.image is new.image else new


def _with_cached(data: Resident, cached: Any) -> Resident:
    return eqx.tree_at(lambda d: d.cached, data, cached, is_leaf=lambda x: x is None)


def _state(data: Resident, progress: Progress | None) -> dict[str, Any]:
    """Return the part of a checkpoint that is not weights."""
    inner = (None, ()) if progress is None else (progress.optimiser, progress.memory)
    return {"optimiser": inner[0], "memory": inner[1], "cached": data.cached}
