"""Training of a model on a data set, with its results in a run folder; loading of trained models."""

import contextlib
import dataclasses
import json
import math
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

from keycld._errors import KeycldError, check_minutes, check_seed
from keycld._files import remove_orphans
from keycld._lock import locked
from keycld.data import DataSet, before_test, open_data, resident, sha256
from keycld.evaluation import frame_errors, predict, valid_prediction_time, validation_epsilon
from keycld.models import ModelConfig, Scene, config_for
from keycld.models.base import AbstractModel
from keycld.training.budget import fitting_share
from keycld.training.checkpoints import WEIGHTS, latest_checkpoint, load_arrays, read_position
from keycld.training.devices import use_devices
from keycld.training.loop import STEPS_PER_DISPATCH, Training, train_stages
from keycld.training.memory import keep_freed_memory
from keycld.training.processes import agreed_number, check_equal, check_first, leads, own_folder
from keycld.training.run_files import RunConfig, open_run, read_config, refuse_failed
from keycld.training.step import take_steps
from keycld.training.together import Member
from keycld.training.trackers import check_tracker, make_tracker

# Largest number of trajectories in the validation score.
_VALIDATED = 100
_MOST_WEIGHTS = 10**9


def train(
    data: str | Path,
    out: str | Path,
    config: ModelConfig | None = None,
    *,
    seed: int = 0,
    devices: int = 1,
    minutes: float | None = None,
    track: str = "none",
    checkpoint_seconds: float = 60.0,
    log_every: int = 25,
    keep: int = 2,
    profile: bool = False,
    member: Member | None = None,
) -> AbstractModel:
    """Train a model and write all results to the folder `out`; the same call resumes a killed run.

    Processes that `jax.distributed` has joined make the same call and train one model; the first one writes the folder,
    which all must see.

    Args:
        data: name of a system whose data set is under `data/`, or the folder of any data set.
        out: run folder.
        config: the model and its training; by default `config_for("keycld", "fast")`.
        seed: of weights and data order. Same seed, machine and settings: same bits.
        devices: number of devices that share the clips of each step, of each process; another number may resume the
            run. The losses are those of one device up to rounding.
        minutes: shorten the recipe so that its steps take this time on this machine (`fitting_share`); the share is
            measured once and stays that of the run.
        track: `"none"`, `"wandb"`, `"trackio"` or `"tensorboard"`.
        checkpoint_seconds: time between checkpoints, and about the most that a killed run loses.
        log_every: steps between lines of `metrics.jsonl`.
        keep: number of checkpoints to keep.
        profile: write a trace of JAX's profiler for the second dispatch of each stage to `out/profile/STAGE`.
        member: of several trainings, each in a thread of its own, that take their steps together (`Together`).

    Returns:
        the trained model.

    Raises:
        KeycldError: anything that a user can fix, before the first step where possible.
    """
    check_seed(seed)
    check_minutes(minutes)
    check_tracker(track)
    if log_every < 1:
        raise KeycldError(f"--log-every is a number of steps, at least 1, not {log_every}.")
    if not checkpoint_seconds >= 0:
        raise KeycldError(f"--checkpoint-seconds is a number of at least 0, not {checkpoint_seconds:g}.")
    if member is not None and minutes is not None:
        raise KeycldError(
            "--minutes cannot be measured where several trainings take their steps together: leave it out."
        )
    keep_freed_memory()
    together = 1 if member is None else len(member.group.members)
    shared = use_devices(devices)
    folder, dataset = Path(out), open_data(data)
    if folder.resolve() == dataset.folder.resolve():
        raise KeycldError(f"{folder} holds the data: choose another --out for the run.")
    config = (config or config_for()).completed(dataset)
    source = dataset.training_data(seed)
    scene = make_scene(source.shape, dataset)
    share = 1.0
    if minutes is not None:
        share = _known_share(folder, minutes) or fitting_share(config, scene, source.at(0), minutes, shared)
        share = agreed_number(share)
        config = config.shortened(share)
    stages = config.stages(scene)
    for stage in stages:
        stage.sampler.check(source.at(0))
        shared.check(stage, source.at(0))
    # Errors of the recipe are raised before the folder is made.
    blank = _blank(config, scene)
    for stage in stages:
        stage.labels(blank)
    threshold = validation_epsilon(dataset)
    run = RunConfig(
        data=str(dataset.folder),
        data_hash=sha256(dataset.path("train")),
        system=dataset.system,
        model=config.model,
        preset=config.preset,
        settings=config.settings(),
        seed=seed,
        scene=dataclasses.asdict(scene),
        input_names=dataset.input_names,
        epsilon=threshold,
        steps_per_dispatch=STEPS_PER_DISPATCH,
        checkpoint_seconds=checkpoint_seconds,
        devices=devices,
        minutes=minutes,
        share=share,
        together=together,
        command=shlex.join(sys.argv),
    )
    check_equal(json.dumps(run.decides()), "settings or data")
    with contextlib.ExitStack() as held:
        problem = None
        if leads():
            try:
                if not held.enter_context(locked(folder / ".lock")):
                    raise KeycldError(f"another process is training in {folder}: wait for it, or choose another --out.")
                for each in (folder, folder / "checkpoints"):
                    if each.exists():
                        remove_orphans(each)
                open_run(folder, run)
            except KeycldError as error:
                problem = error
        check_first(problem)
        mine = held.enter_context(own_folder(folder))
        tracker = make_tracker(track if leads() else "none", folder, dataclasses.asdict(run))
        with contextlib.closing(tracker):
            return train_stages(
                Training(
                    fresh=lambda k: config.build(scene, jax.random.fold_in(jax.random.key(seed), k)),
                    blank=lambda changes: _blank(config.changed(changes), scene),
                    changes=lambda model: _changes(config, config.matching(model)),
                    stages=stages,
                    source=source,
                    everything=lambda: resident(before_test(dataset)),
                    validate=validation_score(dataset, threshold),
                    folder=mine,
                    devices=shared,
                    seed=seed,
                    checkpoint_seconds=checkpoint_seconds,
                    log_every=log_every,
                    keep=keep,
                    profile=profile,
                    tracker=tracker,
                    renamed=config.RENAMED,
                    added=config.ADDED,
                    take=take_steps if member is None else member.take,
                    turn=contextlib.nullcontext() if member is None else member.turn,
                    together=together,
                )
            )


def _known_share(folder: Path, minutes: float) -> float | None:
    """Return the share of a run that was shortened to the same time; None: there is none yet."""
    if not (folder / "config.json").exists():
        return None
    saved = read_config(folder)
    return saved.share if saved.minutes == minutes else None


def load_run(run: str | Path, **settings: Any) -> tuple[AbstractModel, RunConfig]:
    """Return the model of a run's newest checkpoint, and the run's configuration; needs no data.

    Args:
        run: run folder.
        settings: those that its `config.json` cannot hold, such as `constraints=` with a Python function.

    Raises:
        KeycldError: the folder is not that of a run, has no checkpoint yet, or is damaged.
    """
    folder = Path(run)
    config = read_config(folder)
    refuse_failed(folder)
    checkpoint = latest_checkpoint(folder)
    if checkpoint is None:
        raise KeycldError(f"{folder} has no checkpoint yet: wait for the first one, or train it again.")
    try:
        chosen = config.model_config().changed(read_position(checkpoint).get("changes", {})).changed(settings)
        return load_arrays(checkpoint / WEIGHTS, blank_model(chosen, config), chosen.RENAMED, chosen.ADDED), config
    except KeycldError:
        # Another process that trains this model may have replaced the checkpoint meanwhile.
        if latest_checkpoint(folder) in (None, checkpoint):
            raise
        return load_run(run, **settings)


def blank_model(chosen: ModelConfig, config: RunConfig) -> AbstractModel:
    """Return the model of a run with `jax.ShapeDtypeStruct`s in place of arrays; needs no data."""
    return _blank(chosen, Scene(**config.scene))


def _blank(config: ModelConfig, scene: Scene) -> AbstractModel:
    try:
        blank = eqx.filter_eval_shape(config.build, scene, jax.random.key(0))
    except (MemoryError, OverflowError) as error:
        raise KeycldError("a model of these settings does not fit into memory: make it smaller.") from error
    size = sum(math.prod(leaf.shape) for leaf in jax.tree.leaves(blank) if hasattr(leaf, "shape"))
    if size > _MOST_WEIGHTS:
        raise KeycldError(
            f"a model of these settings has {size:,} weights, more than {_MOST_WEIGHTS:,}: make it smaller."
        )
    return blank


def _changes(config: ModelConfig, trained: ModelConfig) -> dict[str, Any]:
    """Return the settings that training has changed."""
    before, after = config.settings(), trained.settings()
    # A setting that is left out where nothing needs it is None there.
    return {name: value for name, value in after.items() if value != before.get(name)}


def finished(run: str | Path) -> bool:
    """Return whether a run has reached the end of its last stage."""
    checkpoint = latest_checkpoint(Path(run))
    if checkpoint is None:
        return False
    position = read_position(checkpoint)
    return bool(position["done"]) and position["stage"] == position["stages"] - 1


def make_scene(shape: tuple[int, ...], dataset: DataSet) -> Scene:
    """Return what a model must know of training trajectories of a shape (N, T, H, W, 3).

    Raises:
        KeycldError: the validation trajectories have other inputs or pictures of another size.
    """
    count, length, height, width = shape[:4]
    one = slice(0, 1)
    inputs = dataset.split("train", images=False, rows=one).input.shape[-1]
    other = dataset.split("validation", rows=one)
    size = None if other.image is None else other.image.shape[2:4]
    if other.input.shape[-1] != inputs or size not in (None, (height, width)):
        raise KeycldError(
            f"train.h5 has {inputs} inputs and pictures of {height} × {width}, validation.h5 {other.input.shape[-1]} "
            f"inputs and pictures of {' × '.join(map(str, size or ('no size',)))}: make both alike."
        )
    return Scene(height, width, inputs, length, dataset.dt, count)


def validation_score(dataset: DataSet, threshold: float) -> Callable[[AbstractModel], dict[str, float]]:
    """Return a function that returns a model's VPT on the validation set, on 100 trajectories at most.

    Args:
        dataset: with the validation set.
        threshold: ε, of the squared error of a frame.
    """

    def score(model: AbstractModel) -> dict[str, float]:
        data = dataset.split("validation", rows=slice(0, _VALIDATED))
        image = np.asarray(data.image)
        parts = predict(model, image[:, : model.context], dataset.dt, data.input, data.frames)
        errors = np.concatenate([frame_errors(image[part], found.frames) for part, found in parts])
        vpt = valid_prediction_time(errors, threshold) / data.frames
        return {"validation_vpt": float(np.mean(vpt)), "validation_vpt_median": float(np.median(vpt))}

    return score
