"""`keycld train`."""

import inspect
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import tyro

from keycld._errors import KeycldError
from keycld.models import ModelConfig, config_for


def train(
    data: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="DATA")] = "",
    /,
    *,
    model: str = "keycld",
    preset: str | None = None,
    settings: ModelConfig,
    seed: int | None = None,
    out: Path | None = None,
    constraints: Path | None = None,
    config: Path | None = None,
    track: str = "none",
    log_every: int = 25,
    checkpoint_seconds: float = 60.0,
) -> None:
    """Train a model from pictures; the same command resumes a run that was killed.

    Settings of the preset are flags too: `keycld train cartpole --vision.steps 500`. The list below belongs to the
    model and the preset that are named: `keycld train --model node2 --preset paper --help` lists others.

    Args:
        data: A system (pendulum, cartpole, acrobot), whose data are made first if they are not there, or the folder of
            a data set.
        model: What to train; `keycld models` lists all.
        preset: The whole recipe; by default fast.
        settings: Fields of the preset.
        seed: Decides weights and data order; by default 0. Same seed, machine and settings: same bits.
        out: Run folder; by default runs/DATA-MODEL-PRESET-SEED.
        constraints: TOML file with keypoints and constraints, instead of the data's own; for models that have some.
        config: A run's config.json: trains the same again. What is given besides it changes that part.
        track: Where metrics go besides metrics.jsonl: none, wandb, trackio or tensorboard.
        log_every: Steps between lines of metrics.jsonl; checkpoints are taken at such steps too.
        checkpoint_seconds: A killed run loses at most about this much, and the steps to the next line.
    """
    from keycld.cli.making import data_for
    from keycld.data import open_data
    from keycld.training import parse_config
    from keycld.training import train as train_model

    saved = None if config is None else parse_config(config)
    if saved is not None:
        data, seed = data or saved.data, saved.seed if seed is None else seed
    if not data:
        raise KeycldError("name what to train on: `keycld train pendulum`, or the folder of a data set.")
    if constraints is not None:
        settings = settings.changed({"constraints": _text(constraints)})
    folder = data_for(data)
    seed = seed or 0
    run = out or Path("runs") / f"{open_data(folder).folder.name}-{settings.model}-{settings.preset}-{seed}"
    train_model(
        folder,
        run,
        settings,
        seed=seed,
        track=track,
        log_every=log_every,
        checkpoint_seconds=checkpoint_seconds,
    )
    print(f"trained: {run}\nnext: keycld eval {run}, keycld report {run}")


def with_settings(words: Sequence[str]) -> Callable[..., None]:
    """Return `train` with the settings of the preset that the words of a command line name, so that they are flags.

    Raises:
        KeycldError: no such model or preset; `--config` names no configuration.
    """
    model, preset, path = (_value(words, name) for name in ("--model", "--preset", "--config"))
    if path is None:
        default = config_for(model or "keycld", preset)
    else:
        from keycld.training import parse_config

        saved = parse_config(Path(path))
        same = model in (None, saved.model) and preset in (None, saved.preset)
        chosen = config_for(model or saved.model, preset or saved.preset)
        default = chosen.changed(saved.settings) if same else chosen

    def verb(*arguments: Any, **options: Any) -> None:
        train(*arguments, **options)

    kind = Annotated[type(default), tyro.conf.arg(name="")]
    verb.__doc__ = train.__doc__
    verb.__annotations__ = train.__annotations__ | {"settings": kind}
    parameters = dict(inspect.signature(train).parameters)
    parameters["settings"] = parameters["settings"].replace(default=default, annotation=kind)
    verb.__signature__ = inspect.Signature(list(parameters.values()))  # pyright: ignore[reportFunctionMemberAccess]
    return verb


def _value(words: Sequence[str], flag: str) -> str | None:
    """Return what follows a flag, as `--flag value` or `--flag=value`."""
    for word, following in zip(words, [*words[1:], ""], strict=True):
        if word == flag:
            return following
        if word.startswith(f"{flag}="):
            return word.partition("=")[2]
    return None


def _text(path: Path) -> str:
    from keycld.mechanics import dump_constraints, load_constraints

    return dump_constraints(load_constraints(path))
