"""The training loop: stages in order, checkpoints, metrics, resume."""

import contextlib
import dataclasses
import functools
import math
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
from keycld.training.checkpoints import (
    STATE,
    WEIGHTS,
    latest_checkpoint,
    load_arrays,
    read_position,
    remove_older,
    save_checkpoint,
)
from keycld.training.devices import Devices
from keycld.training.processes import agreed, agreed_number
from keycld.training.run_files import Metrics, write_verdict
from keycld.training.step import Progress, Take, diagnose, initial_progress, make_step, refreshed
from keycld.training.trackers import Tracker

# As many as between two lines of the log. With one program for a dispatch, its arguments and results pass once.
STEPS_PER_DISPATCH = 25
_NOTHING = contextlib.nullcontext()
# More than any stage tries: each attempt has random weights and steps of its own.
_MOST_CANDIDATES = 1000
_ATTEMPTS = 3
# (rest, data), progress → progress, terms: several steps in one dispatch.
Run = Callable[[tuple[Any, Resident], Progress], tuple[Progress, dict[str, Any]]]


@dataclasses.dataclass(frozen=True)
class Training:
    """What a training is given.

    Attributes:
        fresh: `fresh(k)` returns an untrained model with the k-th random weights.
        blank: `blank(changes)` returns a model with some settings changed, and shapes in place of arrays.
        changes: returns the settings that training has changed in a model.
        stages: the recipe.
        source: training data.
        everything: returns the data of training and validation, for stages that are fitted to both.
        validate: returns the scores of a model on the validation set.
        folder: run folder.
        devices: share the clips of each step.
        seed: of all randomness.
        checkpoint_seconds: time between checkpoints.
        log_every: steps between lines of `metrics.jsonl`.
        keep: number of checkpoints to keep.
        profile: trace the second dispatch of each stage; the first one compiles.
        tracker: gets the metrics too.
        renamed: as in `load_arrays`.
        added: likewise.
        take: takes the steps.
        turn: held while something happens between steps.
        together: how many trainings share the work of this process.
    """

    fresh: Callable[[int], AbstractModel]
    blank: Callable[[Mapping[str, Any]], AbstractModel]
    changes: Callable[[AbstractModel], dict[str, Any]]
    stages: tuple[Stage, ...]
    source: TrainingData
    everything: Callable[[], Resident]
    validate: Callable[[AbstractModel], dict[str, float]]
    folder: Path
    devices: Devices
    seed: int
    checkpoint_seconds: float
    log_every: int
    keep: int
    profile: bool
    tracker: Tracker
    renamed: Mapping[str, str]
    added: Mapping[str, float]
    take: Take
    turn: contextlib.AbstractContextManager[Any]
    together: int

    @functools.cached_property
    def before(self) -> list[int]:
        """The number of steps before each stage, and of all stages."""
        return [sum(stage.steps for stage in self.stages[:k]) for k in range(len(self.stages) + 1)]


def train_stages(training: Training) -> AbstractModel:
    """Train all stages, with a checkpoint at the end of each; resume from the latest checkpoint in the folder.

    A checkpoint holds weights, the states of optimiser and loss, the cached values of a stage, and the step. The
    randomness of a step is a function of seed, stage and step number, and so is the resident part of the data: a
    resumed run takes the same steps, bit for bit.

    Raises:
        KeycldError: a loss or gradient is not finite; a checkpoint is damaged or cannot be written; a stage has failed
            three times, each with other initial weights.
    """
    return _Trainer(training).run()


@dataclasses.dataclass
class _Clock:
    """Wall seconds, CPU seconds and frames of all processes that worked on this run.

    Trainings that share the work of a process share its CPU seconds.
    """

    together: int
    seconds: float = 0.0
    cpu_seconds: float = 0.0
    frames: int = 0

    def __post_init__(self) -> None:
        self._wall, self._cpu = time.monotonic(), time.process_time()

    def tick(self) -> None:
        wall, cpu = time.monotonic(), time.process_time()
        self.seconds += wall - self._wall
        self.cpu_seconds += (cpu - self._cpu) / self.together
        self._wall, self._cpu = wall, cpu


class _Placed:
    """What a stage does not train, and the data, on all devices: copied there again only when they are others."""

    def __init__(self, devices: Devices):
        self._devices, self._of, self._copies = devices, (None, None), (None, None)

    def of(self, rest: Any, data: Resident) -> Any:
        if rest is not self._of[0] or data is not self._of[1]:
            self._of, self._copies = (rest, data), self._devices.everywhere((rest, data))
        return self._copies


class _Trainer:
    """A training under way: its model, its data, its stage."""

    def __init__(self, training: Training):
        self.training = training
        self.number, self.clock = 0, _Clock(training.together)
        # What each attempt before this one has failed in.
        self.failures: list[str] = []
        self.data = training.source.at(0)
        # Of a stage that begins in its middle: progress, and what it does not train.
        self.resumed: tuple[Progress, Any] | None = None
        checkpoint, step = latest_checkpoint(training.folder), 0
        if checkpoint is None:
            self.model = training.fresh(0)
        else:
            step = self._resume(checkpoint)
            # A process that was killed may have left some.
            remove_older(checkpoint, training.keep)
        begun = [stage.name for stage in training.stages[: self.number + (step > 0)]]
        self.metrics = Metrics(training.folder, training.before[self.number] + step, self.clock.frames, begun)

    def _resume(self, checkpoint: Path) -> int:
        """Continue from a checkpoint, and return the step of the stage."""
        training, position = self.training, read_position(checkpoint)
        self.number, step = position["stage"], position["step"]
        self.clock = _Clock(training.together, position["seconds"], position["cpu_seconds"], position["frames"])
        self.failures = position.get("failures", [])
        blank = training.blank(position.get("changes", {}))
        self.model = load_arrays(checkpoint / WEIGHTS, blank, training.renamed, training.added)
        data = self._resident(training.stages[self.number])
        if position["cached"]:
            data = _with_cached(data, jax.ShapeDtypeStruct((*data.image.shape[:2], position["cached"]), np.float32))
        started = None if position["done"] else initial_progress(training.stages[self.number], self.model)
        state = load_arrays(checkpoint / STATE, _state(data, started and started[0]))
        self.data = _with_cached(data, state["cached"])
        if started is None:
            self.number += 1
            return 0
        progress, rest = started
        self.resumed = (
            progress._replace(optimiser=state["optimiser"], memory=state["memory"], step=progress.step + step),
            rest,
        )
        return step

    def run(self) -> AbstractModel:
        """Train the stages that are left."""
        training = self.training
        while self.number < len(training.stages):
            stage = training.stages[self.number]
            failure = self._train(stage)
            if failure is None and stage.judge is not None:
                with training.turn:
                    failure = stage.judge(self.model, self.data)
            # The first process decides for all: next to a threshold, fits of others may end on its other side.
            if agreed_number(float(failure is not None)):
                failure = failure or "the first process has found a failure"
                # Not saved: a run that resumes here fails in the same way.
                self._restart(f"{stage.name}: {failure}")
                continue
            if stage.validate:
                with training.turn:
                    scores = training.validate(self.model)
                self.clock.tick()
                self._record(stage.steps, scores)
                print("validation   " + "  ".join(f"{k} {v:.3f}" for k, v in scores.items()), flush=True)
            self._save(None, self.model, stage.steps)
            self.number += 1
        write_verdict(training.folder, self.failures, passed=True)
        return self.model

    def _train(self, stage: Stage) -> str | None:
        """Take the steps of a stage, and return what has failed in them, or None.

        Raises:
            KeycldError: something was not finite, in a stage that does not skip such steps.
        """
        training = self.training
        devices, log_every, first = training.devices, training.log_every, training.before[self.number]
        # The number of the random keys of this stage in this attempt.
        drawn = self.number + self._again
        compiled = _compiled(stage, drawn, training)
        pinned, per_step = _clips(stage, self.data)
        if self.resumed is not None:
            (current, rest), self.resumed = self.resumed, None
        else:
            current, rest = self._begin(stage, drawn, compiled, per_step)
        placed = _Placed(devices)
        done, dispatches = int(current.step), 0
        bar = Bar(stage.name, stage.steps)
        saved = logged_at = time.monotonic()
        logged_frames = self.clock.frames
        pending: list[dict[str, Any]] = []
        while done < stage.steps:
            chunk = min(STEPS_PER_DISPATCH, stage.steps - done, log_every - done % log_every)
            if not (pinned or stage.with_validation):
                self.data = _moved(self.data, training.source.at(first + done))
                end = training.source.until(first + done)
                chunk = chunk if end is None else min(chunk, end - first - done)
            if stage.refresh is not None:
                chunk = min(chunk, stage.every - done % stage.every)
                # Before the step and not after the last one, so that a run which resumes here repeats it.
                if done and done % stage.every == 0:
                    with training.turn:
                        self.model, self.data = _changed(stage.refresh, self._whole(current, rest), self.data)
                    current, rest = refreshed(stage, self.model, current)
            traced = training.profile and dispatches == 1
            with self._profiler(stage) if traced else _NOTHING:
                current, terms = compiled(chunk)(placed.of(rest, self.data), devices.everywhere(current))
                if traced:
                    jax.block_until_ready(current)
            dispatches += 1
            pending.append(terms)
            done += chunk
            self.clock.frames += per_step * chunk
            if done % log_every < chunk or done == stage.steps:
                values = {k: _mean([t[k] for t in pending], skipping=stage.skips > 0) for k in terms}
                pending = []
                if not bool(current.healthy):
                    found = diagnose(stage, drawn, training.seed, devices.here(current), rest, self.data)
                    if stage.skips:
                        return f"{found} {stage.skips} such steps in a row may be skipped. Lower the learning rate."
                    raise KeycldError(
                        f"stage '{stage.name}': {found} The last checkpoint is intact; lower the learning rate or "
                        "check the data."
                    )
                if skipped := stage.skipped(current.optimiser):
                    values["skipped"] = float(skipped)
                self.clock.tick()
                now = time.monotonic()
                rate = (self.clock.frames - logged_frames) / max(now - logged_at, 1e-9)
                logged_at, logged_frames = now, self.clock.frames
                self._record(done, values)
                bar.show(done, rate, "  ".join(f"{name} {value:.4g}" for name, value in values.items()))
                if now - saved > training.checkpoint_seconds and done < stage.steps:
                    self._save(devices.here(current), self._whole(current, rest), done)
                    saved = time.monotonic()
        self.model = self._whole(current, rest)
        return None

    def _begin(self, stage: Stage, drawn: int, compiled: Callable[[int], Run], per_step: int) -> tuple[Progress, Any]:
        """Return the progress at the first step, or after the trials of several initial weights, and the rest."""
        training = self.training
        self.data = _moved(self.data, self._resident(stage))
        models = [self.model, *(training.fresh(self._again + k) for k in range(1, stage.candidates))]
        alternative = compiled
        if stage.alternative is not None:
            alternative = _compiled(dataclasses.replace(stage, loss=stage.alternative), drawn, training)
        current, rest, self.data = _best(stage, models, self.data, (compiled, alternative), training)
        self.clock.frames += per_step * int(current.step) * len(models)
        return current, rest

    def _resident(self, stage: Stage) -> Resident:
        """Return the data at the first step of the present stage."""
        training = self.training
        return training.everything() if stage.with_validation else training.source.at(training.before[self.number])

    def _restart(self, failure: str) -> None:
        """Begin again with other weights, or end the training after the last attempt."""
        folder = self.training.folder
        self.failures.append(failure)
        if len(self.failures) == _ATTEMPTS:
            write_verdict(folder, self.failures, passed=False)
            raise KeycldError(
                f"training failed {_ATTEMPTS} times (`keycld report {folder}` shows each), the last time in stage "
                f"{failure}"
            )
        print(f"restart      {failure}", file=sys.stderr, flush=True)
        self.model = self.training.fresh(self._again)
        self.data, self.number = self.training.source.at(0), 0
        self.metrics = Metrics(folder, 0, 0, [])

    @property
    def _again(self) -> int:
        """The number of the first random weights of this attempt."""
        return _MOST_CANDIDATES * len(self.failures)

    def _whole(self, progress: Progress, rest: Any) -> Any:
        """Return the model with the trained parameters of the first device."""
        return eqx.combine(self.training.devices.here(progress.parameters), rest)

    def _profiler(self, stage: Stage) -> contextlib.AbstractContextManager[Any]:
        return jax.profiler.trace(self.training.folder / "profile" / stage.name, create_perfetto_trace=True)

    def _save(self, progress: Progress | None, model: AbstractModel, step: int) -> None:
        """Write a checkpoint: of a stage under way, or without progress of a completed one."""
        training, stages = self.training, self.training.stages
        self.clock.tick()
        position = {
            "stage": self.number,
            "stages": len(stages),
            "name": stages[self.number].name,
            "step": step,
            "done": progress is None,
            "cached": 0 if self.data.cached is None else self.data.cached.shape[-1],
            "changes": training.changes(model),
            "failures": self.failures,
            "seconds": self.clock.seconds,
            "cpu_seconds": self.clock.cpu_seconds,
            "frames": self.clock.frames,
        }
        name = f"{_attempt(self.failures)}{self.number:02d}-{stages[self.number].name}-{step:06d}"
        save_checkpoint(training.folder, name, model, _state(self.data, progress), position, training.keep)

    def _record(self, done: int, values: dict[str, float]) -> None:
        """Write one line of the log, with the cost of the training so far."""
        step, clock = self.training.before[self.number] + done, self.clock
        cost = {"seconds": round(clock.seconds, 2), "cpu_seconds": round(clock.cpu_seconds, 2), "frames": clock.frames}
        self.metrics.write(step=step, stage=self.training.stages[self.number].name, **cost, **values)
        # A dashboard drops steps that it has passed, so that those of a further attempt come after all others.
        self.training.tracker.log(len(self.failures) * self.training.before[-1] + step, values)


def _compiled(stage: Stage, drawn: int, training: Training) -> Callable[[int], Run]:
    """Return what gives the compiled function of a number of steps."""
    return functools.cache(
        functools.partial(make_step, stage, drawn, training.seed, devices=training.devices, take=training.take)
    )


def _attempt(failures: list[str]) -> str:
    """Return a prefix of the names of checkpoints: none at first."""
    return f"again{len(failures)}-" if failures else ""


def _best(
    stage: Stage,
    models: list[AbstractModel],
    data: Resident,
    compiled: tuple[Callable[[int], Run], Callable[[int], Run]],
    training: Training,
) -> tuple[Progress, Any, Resident]:
    """Return the initial state of the stage; of several models, the state of the best one after the stage's trial.

    The first of the two losses is for models with an even number, the second for the others.
    """
    found, devices = [], training.devices
    for number, model in enumerate(models):
        with training.turn:
            prepared, resident = (model, data) if stage.prepare is None else _changed(stage.prepare, model, data)
        progress, rest = initial_progress(stage, prepared)
        # The last step is in no trial, so that the log has a line of the stage.
        losses, trial = [], min(stage.trial, stage.steps - 1)
        if len(models) == 1 or trial == 0:
            return progress, rest, resident
        progress, fixed = devices.everywhere(progress), devices.everywhere((rest, resident))
        for done in range(0, trial, STEPS_PER_DISPATCH):
            run = compiled[number % 2](min(STEPS_PER_DISPATCH, trial - done))
            progress, terms = run(fixed, progress)
            losses.extend(np.asarray(terms["loss"]))
        # The mean over the last third, because the loss of one batch is noisy.
        score = float(np.mean(losses[-(trial // 3) :]))
        sound = bool(progress.healthy) and np.isfinite(score)
        found.append((score if sound else np.inf, progress, rest, resident))
    _, progress, rest, resident = min(found, key=lambda candidate: candidate[0])
    return progress, rest, resident


def _mean(chunks: list[Any], *, skipping: bool) -> float:
    """Return the mean of a term over the steps of some dispatches; without those that were skipped."""
    steps = np.concatenate([np.asarray(chunk) for chunk in chunks])
    if skipping:
        steps = steps[np.isfinite(steps)]
    return float(np.mean(steps)) if len(steps) else math.nan


def _changed(
    change: Callable[[Any, Resident], tuple[Any, Resident]], model: Any, data: Resident
) -> tuple[Any, Resident]:
    """Change model and data between steps, in all processes to the same bits."""
    model, data = change(model, data)
    model, cached = agreed((model, data.cached))
    return model, _with_cached(data, cached)


def _clips(stage: Stage, data: Resident) -> tuple[bool, int]:
    """Return whether the stage's clips hold cached values, and the number of frames that a step passes to networks.

    Cached values belong to the trajectories that are resident at the first step, so these stay for the whole stage.
    """
    clips = eqx.filter_eval_shape(stage.sampler, data, jax.random.key(0), jax.numpy.array(0))
    pinned = clips.frames is None or getattr(stage.sampler, "cached", False)
    return pinned, 0 if clips.frames is None else int(np.prod(clips.frames.shape[:2]))


def _moved(old: Resident, new: Resident) -> Resident:
    """Return the new resident trajectories; the old ones with their cached values if they are the same."""
    return old if old.image is new.image else new


def _with_cached(data: Resident, cached: Any) -> Resident:
    return eqx.tree_at(lambda d: d.cached, data, cached, is_leaf=lambda x: x is None)


def _state(data: Resident, progress: Progress | None) -> dict[str, Any]:
    """Return the part of a checkpoint that is not weights."""
    inner = (None, ()) if progress is None else (progress.optimiser, progress.memory)
    return {"optimiser": inner[0], "memory": inner[1], "cached": data.cached}
