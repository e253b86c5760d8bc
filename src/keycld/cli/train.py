"""`keycld train`."""

import json
from pathlib import Path
from typing import Annotated, Any

import tyro

from keycld import KeycldError


def train(
    data: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="DATA")] = "",
    /,
    *,
    model: str | None = None,
    preset: str | None = None,
    seed: int | None = None,
    out: Path | None = None,
    set: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE ...")] = (),
    constraints: Path | None = None,
    config: Path | None = None,
    track: str = "none",
    log_every: int = 25,
    checkpoint_seconds: float = 60.0,
) -> None:
    """Train a model from pictures; the same command resumes a run that was killed.

    Args:
        data: A system (pendulum, cartpole, acrobot), whose data are made first if they are not there, or the folder of
            a data set; your own needs a constraints.toml beside it, or --constraints.
        model: What to train: keycld (unless told), or an ablation: keycld-nc (no constraints), node2 (second-order
            neural ODE), fc (fully connected networks).
        preset: The whole recipe: fast (unless told; minutes on two cores), control (longer, for models
            that plan), paper (arXiv v1 as published) or journal (the 2024 version); the last two need a GPU.
        seed: Decides weights and data order; 0 unless told. Same seed, machine and settings: same bits.
        out: Run folder; runs/DATA-MODEL-PRESET-SEED unless told.
        set: Settings of the preset to change, such as vision_steps=500 joint_horizons=8,16 width=24.
        constraints: TOML file with the constraints, instead of the data's own.
        config: A run's config.json: trains the same again. What is given beside it changes that part.
        track: Where metrics go besides metrics.jsonl: none, wandb, trackio or tensorboard.
        log_every: Steps between lines of metrics.jsonl; checkpoints are taken at such steps too.
        checkpoint_seconds: A killed run loses at most about this much, and the steps to the next line.
    """
    from keycld.cli.making import data_for
    from keycld.data import open_data
    from keycld.mechanics import load_constraints, parse_constraints
    from keycld.training import train as train_model

    settings: dict[str, Any] = {}
    chosen = None if constraints is None else load_constraints(constraints)
    if config is not None:
        saved = _read_config(config)
        data = data or saved["data"]
        model, seed = model or saved["model"], saved["seed"] if seed is None else seed
        # Settings belong to their preset.
        settings = saved["settings"] if preset in (None, saved["preset"]) else {}
        preset = preset or saved["preset"]
        if chosen is None and saved["constraints"] is None:
            raise KeycldError(
                f"the run of {config} had a Python function as constraint, which no file can hold: give --constraints, "
                "or train it from Python."
            )
        if chosen is None:
            chosen = parse_constraints(saved["constraints"], f"the constraints in {config}")
    model, preset, seed = model or "keycld", preset or "fast", seed or 0
    if not data:
        raise KeycldError("name what to train on: `keycld train pendulum`, or the folder of a data set.")
    settings |= dict(parse_setting(text) for text in set)
    folder = data_for(data)
    run = out or Path("runs") / f"{open_data(folder).folder.name}-{model}-{preset}-{seed}"
    train_model(
        folder,
        run,
        model=model,
        preset=preset,
        settings=settings,
        seed=seed,
        constraints=chosen,
        track=track,
        log_every=log_every,
        checkpoint_seconds=checkpoint_seconds,
    )
    print(f"trained: {run}\nnext: keycld eval {run}, keycld report {run}")


def parse_setting(text: str) -> tuple[str, Any]:
    """Name and value of a setting such as `joint_horizons=8,16`."""
    name, equals, value = text.partition("=")
    if not equals:
        raise KeycldError(f"--set takes NAME=VALUE, not '{text}'.")
    values = [_number(part) for part in value.split(",") if part]
    return name.replace("-", "_"), values[0] if len(values) == 1 and "," not in value else values


def _number(text: str) -> Any:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return {"true": True, "false": False}.get(text.lower(), text)


def _read_config(path: Path) -> dict[str, Any]:
    try:
        saved = json.loads(path.read_text())
        return {name: saved[name] for name in ("data", "model", "preset", "seed", "settings", "constraints")}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise KeycldError(f"--config {path} is not a run's config.json ({error}).") from None
