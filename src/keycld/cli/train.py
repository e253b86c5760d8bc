"""The verb `keycld train`."""

import inspect
from collections.abc import Callable, Sequence
from pathlib import Path
from shlex import quote
from typing import Annotated, Any

import tyro

from keycld._errors import KeycldError
from keycld.cli.settings import as_flag
from keycld.models import ModelConfig, config_for


def train(
    data: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="DATA")] = "",
    /,
    *,
    model: str = "keycld",
    preset: str | None = None,
    settings: ModelConfig,
    seed: int | None = None,
    devices: int | None = None,
    coordinator: str | None = None,
    processes: int | None = None,
    process: int | None = None,
    minutes: float | None = None,
    out: Path | None = None,
    constraints: Annotated[str | None, tyro.conf.arg(aliases=["--mechanism"])] = None,
    config: Path | None = None,
    track: str = "none",
    log_every: int = 25,
    checkpoint_seconds: float = 60.0,
    profile: bool = False,
) -> None:
    """Train a model from pictures; the same command resumes a run that was killed.

    Settings of the preset are flags too: `keycld train cartpole --vision.steps 500`. The list below is that of the
    given model and preset: `keycld train --model node2 --preset paper --help` shows another one.

    Args:
        data: A system such as pendulum or zoo/four_bar, whose data are made first if they are missing, or the folder of
            a data set.
        model: Model to train; `keycld models` lists all.
        preset: The whole recipe; by default fast.
        settings: Fields of the preset.
        seed: Seed of weights and data order; by default 0. Same seed, machine and settings: same bits.
        devices: Devices that share the clips of each step, of each process; by default 1.
        coordinator: ADDRESS:PORT of the first of several processes that train one model, also on several machines;
            auto: Slurm, Open MPI or Kubernetes say it. Start the same command in all of them.
        processes: How many processes there are.
        process: The number of this process, from 0.
        minutes: Shorten the recipe so that its steps take this time on this machine; by default it is taken whole.
        out: Run folder; by default runs/DATA-MODEL-PRESET-SEED.
        constraints: TOML file with keypoints and constraints, or the name of a mechanism (pendulum, double-pendulum,
            cart-pole, spring), instead of those of the data; for models that have some.
        config: The config.json of a run, to train the same again. Other options change their part of it.
        track: Where metrics go in addition to metrics.jsonl: none, wandb, trackio or tensorboard.
        log_every: Steps between lines of metrics.jsonl; checkpoints are written at such steps too.
        checkpoint_seconds: Time between checkpoints, and about the most that a killed run loses.
        profile: Write a trace of JAX's profiler for the second dispatch of each stage to RUN/profile/STAGE.
    """
    from keycld.cli.making import data_for, name_of
    from keycld.data import open_data
    from keycld.training import join, parse_config
    from keycld.training import train as train_model

    if coordinator is not None:
        join(coordinator, processes, process)
    elif processes is not None or process is not None:
        raise KeycldError("--processes and --process need --coordinator ADDRESS:PORT, where the processes meet.")
    saved = None if config is None else parse_config(config)
    if saved is not None:
        data, seed = data or saved.data, saved.seed if seed is None else seed
        devices = saved.devices if devices is None else devices
    if not data:
        raise KeycldError("name what to train on: a system, `keycld train pendulum`, or the folder of a data set.")
    if constraints is not None:
        if "constraints" not in settings.settings():
            raise KeycldError(f"the model {settings.model} takes no constraints: leave out --mechanism, --constraints.")
        settings = settings.changed({"constraints": _text(constraints)})
    folder = data_for(data)
    seed = seed or 0
    run = out or Path("runs") / f"{name_of(open_data(folder).folder)}-{settings.model}-{settings.preset}-{seed}"
    train_model(
        folder,
        run,
        settings,
        seed=seed,
        devices=1 if devices is None else devices,
        minutes=minutes,
        track=track,
        log_every=log_every,
        checkpoint_seconds=checkpoint_seconds,
        profile=profile,
    )
    if profile:
        print(f"traces: {run}/profile; open a perfetto_trace.json.gz at https://ui.perfetto.dev, or all in XProf")
    print(f"trained: {run}\nnext: keycld eval {quote(str(run))}, keycld report {quote(str(run))}")


def with_settings(words: Sequence[str]) -> Callable[..., None]:
    """Return `train` with the settings of the chosen preset as flags.

    Args:
        words: of the command line, which name model and preset or a configuration.

    Raises:
        KeycldError: there is no such model, preset or configuration, or settings are given as for other verbs.
    """
    if (setting := _value(words, "--set")) is not None:
        raise KeycldError(f"settings of keycld train are flags: write {as_flag(setting)} in place of --set {setting}.")
    model, preset, path = (_value(words, name) for name in ("--model", "--preset", "--config"))
    if not path:
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
    # Run-time type checks wrap functions; tyro reads the innermost one.
    plain, verb = inspect.unwrap(train), inspect.unwrap(verb)
    verb.__doc__ = plain.__doc__
    verb.__annotations__ = plain.__annotations__ | {"settings": kind}
    parameters = dict(inspect.signature(plain).parameters)
    parameters["settings"] = parameters["settings"].replace(default=default, annotation=kind)
    verb.__signature__ = inspect.Signature(list(parameters.values()))  # pyright: ignore[reportFunctionMemberAccess]
    return verb


def _value(words: Sequence[str], flag: str) -> str | None:
    """Return the value of a flag, from `--flag value` or `--flag=value`; the last one, as for all other flags."""
    value = None
    for word, following in zip(words, [*words[1:], ""], strict=True):
        if word == flag:
            value = following
        elif word.startswith(f"{flag}="):
            value = word.partition("=")[2]
    return value


def _text(path: str) -> str:
    from keycld.mechanics import dump_constraints, load_constraints

    return dump_constraints(load_constraints(path))
