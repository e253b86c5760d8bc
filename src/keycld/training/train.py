"""From a data set and a preset to a trained model in a run folder."""

import contextlib
import dataclasses
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

from keycld._errors import KeycldError, check_seed, unknown
from keycld._lock import locked
from keycld.data import DataSet, open_data, resident, sha256
from keycld.evaluation import epsilon, frame_errors, predict, valid_prediction_time
from keycld.mechanics import (
    AbstractConstraint,
    Constraints,
    FunctionConstraint,
    dump_constraints,
    load_constraints,
)
from keycld.models import AbstractModel
from keycld.training.checkpoints import latest_checkpoint, load_leaves, read_position
from keycld.training.loop import train_stages
from keycld.training.memory import keep_freed_memory
from keycld.training.presets import MODELS, AbstractRecipe, Scene, recipe_class
from keycld.training.run_folder import RunConfig, open_run, read_config
from keycld.training.trackers import make_tracker


def train(
    data: str | Path,
    out: str | Path,
    *,
    model: str = "keycld",
    preset: str = "fast",
    settings: dict[str, Any] | None = None,
    seed: int = 0,
    constraints: Constraints | Callable | None = None,
    track: str = "none",
    checkpoint_seconds: float = 60.0,
    log_every: int = 25,
    keep: int = 2,
) -> AbstractModel:
    """Trains a model and leaves everything in the folder `out`; the same call resumes a killed run.

    **Arguments:**

    - `data`: name of a system whose data set is under `data/`, or the folder of any data set.
    - `out`: run folder.
    - `model`: `"keycld"`, or an ablation of it: `"keycld-nc"`, `"node2"`, `"fc"`.
    - `preset`: `"fast"` (ours), `"control"` (the same for models that plan), `"paper"` (arXiv v1 as published) or
      `"journal"` (the 2024 version).
    - `settings`: fields of the preset's recipe to change, by name.
    - `seed`: of weights and data order. Same seed, machine and settings: same bits.
    - `constraints`: instead of those beside the data or of the system.
    - `track`: `"none"`, `"wandb"`, `"trackio"` or `"tensorboard"`.
    - `checkpoint_seconds`: a killed run loses at most about this much.
    - `log_every`: steps between lines of `metrics.jsonl`.
    - `keep`: how many checkpoints stay on disk.

    **Raises:** KeycldError for anything a user can mend, before the first step where possible.
    """
    if model not in MODELS:
        raise unknown("model", model, MODELS)
    check_seed(seed)
    keep_freed_memory()
    folder = Path(out)
    dataset = open_data(data)
    constraint = constraints if constraints is not None else dataset.constraints
    recipe = make_recipe(preset, settings or {})
    images = dataset.train()
    data_on_device = resident(images)
    keypoints = constraint.keypoints if isinstance(constraint, Constraints) else dataset.keypoints
    scene = make_scene(images, keypoints, constraint)
    steps_per_dispatch = 1 if jax.default_backend() == "cpu" else 25
    config = RunConfig(
        data=str(dataset.folder),
        system=dataset.system,
        model=model,
        preset=preset,
        settings=recipe.settings(),
        seed=seed,
        constraints=_as_toml(constraint),
        scene={k: v for k, v in dataclasses.asdict(scene).items() if k != "constraint"},
        dt=dataset.dt,
        steps_per_dispatch=steps_per_dispatch,
        checkpoint_seconds=checkpoint_seconds,
        command=shlex.join(sys.argv),
        data_hash=sha256(dataset.path("train")),
        moved_inputs=np.any(images.input != 0, axis=tuple(range(images.input.ndim - 1))).tolist(),
    )
    if log_every < 1:
        raise KeycldError(f"log_every is a number of steps of at least 1, not {log_every}.")
    stages = recipe.stages(scene, model)
    for stage in stages:
        stage.sampler.check(data_on_device)
    # What the recipe refuses, it refuses before the folder is claimed.
    eqx.filter_eval_shape(recipe.model, scene, jax.random.key(0), model)
    with locked(folder / ".lock") as mine:
        if not mine:
            raise KeycldError(f"another process is training in {folder}: wait for it, or choose another --out.")
        open_run(folder, config)
        with contextlib.closing(make_tracker(track, folder, dataclasses.asdict(config))) as tracker:
            return train_stages(
                lambda k: recipe.model(scene, jax.random.fold_in(jax.random.key(seed), k), model),
                stages,
                data_on_device,
                folder,
                seed=seed,
                steps_per_dispatch=steps_per_dispatch,
                checkpoint_seconds=checkpoint_seconds,
                log_every=log_every,
                keep=keep,
                tracker=tracker,
                validate=validation_score(dataset),
            )


def load_run(run: str | Path, constraint: Callable | None = None) -> tuple[AbstractModel, RunConfig]:
    """The model of a run's newest checkpoint, and the run's configuration; needs no data.

    **Arguments:**

    - `run`: run folder.
    - `constraint`: only for a run that was trained with a Python function as constraint.
    """
    folder = Path(run)
    config = read_config(folder)
    checkpoint = latest_checkpoint(folder)
    if checkpoint is None:
        raise KeycldError(f"{folder} has no checkpoint yet; wait for the first one or train it again.")
    if config.constraints is not None:
        constraint = load_constraints(folder / "constraints.toml")
    elif constraint is None:
        raise KeycldError(f"{folder} was trained with a Python function as constraint; pass that function again.")
    model = blank_model(config, constraint)
    # The model comes first among the leaves, so it can be read without the optimiser's state behind it.
    return load_leaves(checkpoint, (model,))[0], config


def blank_model(config: RunConfig, constraint: Callable) -> AbstractModel:
    """A model of a run's shape with fresh weights; needs no data.

    Settings that the recipe no longer has are passed over: a run of an older version says by them how it was trained.
    """
    scene = Scene(**{**config.scene, "keypoints": tuple(config.scene["keypoints"])}, constraint=constraint)
    known = {field.name for field in dataclasses.fields(recipe_class(config.preset))}
    settings = {name: value for name, value in config.settings.items() if name in known}
    return make_recipe(config.preset, settings).model(scene, jax.random.key(0), config.model)


def finished(run: str | Path) -> bool:
    """Whether a run has trained to the end of its last stage."""
    checkpoint = latest_checkpoint(Path(run))
    if checkpoint is None:
        return False
    position = read_position(checkpoint)
    return bool(position["done"]) and position["stage"] == position["stages"] - 1


def _as_toml(constraint: AbstractConstraint | Callable) -> str | None:
    """The constraints as text; None where a Python function is among them, which no file can hold."""
    if not isinstance(constraint, Constraints) or any(isinstance(i, FunctionConstraint) for i in constraint.items):
        return None
    return dump_constraints(constraint)


def make_recipe(preset: str, settings: dict[str, Any]) -> AbstractRecipe:
    """A recipe with some settings changed; KeycldError names the nearest valid field and the type it takes."""
    kind = recipe_class(preset)
    fields = {field.name: field for field in dataclasses.fields(kind)}
    values = {}
    for name, value in settings.items():
        if name not in fields:
            raise unknown(f"setting of preset '{preset}'", name, fields)
        default = fields[name].default
        if isinstance(default, tuple):
            value = tuple(value) if isinstance(value, (list, tuple)) else (value,)
        elif isinstance(default, float) and isinstance(value, int):
            value = float(value)
        parts = value if isinstance(value, tuple) and value else (value,)
        kinds = {type(part) for part in (default if isinstance(default, tuple) else (default,))}
        if {type(part) for part in parts} != kinds:
            raise KeycldError(
                f"setting {name} of preset '{preset}' takes a {type(default).__name__} "
                f"such as {default}, not {value!r}."
            )
        wrong = [part for part in parts if isinstance(part, (int, float)) and not 0 <= part < np.inf]
        if wrong:
            raise KeycldError(f"setting {name} of preset '{preset}' is a number of at least 0, not {wrong[0]}.")
        values[name] = value
    return kind(**values)


def make_scene(images: Any, keypoints: tuple[str, ...], constraint: AbstractConstraint | Callable) -> Scene:
    """What a recipe must know of the training trajectories."""
    count, length, height, width = images.image.shape[:4]
    return Scene(
        height=height,
        width=width,
        inputs=images.input.shape[-1],
        frames=length,
        trajectories=count,
        keypoints=tuple(keypoints),
        constraint=constraint,
    )


def validation_score(dataset: DataSet) -> Callable[[AbstractModel], dict[str, float]]:
    """A function that gives a model's VPT on the validation trajectories, to watch the training.

    The threshold is the mean validation image's error, as in the paper; test data is never touched.
    """
    data = dataset.validation()
    if data.image is None:
        raise KeycldError(f"{dataset.path('validation')} holds no '/image', which the validation score needs: add it.")
    image, threshold = data.image, epsilon(data.image)

    def score(model: AbstractModel) -> dict[str, float]:
        length = image.shape[1]
        given = image[:, : model.context]
        parts = predict(model, given, dataset.dt, data.input, length)
        errors = np.concatenate([frame_errors(image[part], found.frames) for part, found in parts])
        vpt = valid_prediction_time(errors, threshold) / length
        return {"validation_vpt": float(np.mean(vpt)), "validation_vpt_median": float(np.median(vpt))}

    return score


__all__ = ["finished", "load_run", "make_recipe", "make_scene", "train", "validation_score"]
