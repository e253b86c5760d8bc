"""The files of a run: configuration, environment, metrics."""

import dataclasses
import json
import os
import platform
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

from keycld._errors import KeycldError
from keycld._files import write_text


@dataclasses.dataclass(frozen=True)
class RunConfig:
    """Everything that decides a run; `config.json` holds it and `--config` reads it back.

    - `data`: folder of the data set. `data_hash`: checksum of its training file.
    - `model`, `preset`, `settings`: what is trained and how; `settings` are the recipe's fields.
    - `seed`: of weights, data order and everything else.
    - `constraints`: the constraints as TOML text, or None for a Python function given by the caller.
    - `scene`: sizes and keypoint names, so that a model can be rebuilt without the data.
    - `steps_per_dispatch`: optimiser steps in one compiled call (1 on a CPU).
    - `command`: what was typed.
    - `moved_inputs`: which inputs were ever other than zero in training; of the others the model knows no effect. None
      for a run of an older version.
    """

    data: str
    system: str
    model: str
    preset: str
    settings: dict[str, Any]
    seed: int
    constraints: str | None
    scene: dict[str, Any]
    dt: float
    steps_per_dispatch: int
    checkpoint_seconds: float
    command: str
    data_hash: str | None = None
    moved_inputs: list[bool] | None = None

    def decides(self) -> dict[str, Any]:
        """The part that must be equal for a run to be resumed."""
        fields = dataclasses.asdict(self)
        for name in ("command", "checkpoint_seconds", "data", "moved_inputs"):
            del fields[name]
        return json.loads(json.dumps(fields))


def open_run(folder: Path, config: RunConfig) -> None:
    """Makes the run folder, or checks that the one that is there belongs to the same configuration."""
    path = folder / "config.json"
    if path.exists():
        old, new = read_config(folder).decides(), config.decides()
        different = [name for name in new if old.get(name) != new[name]]
        if different:
            name = different[0]
            was, now = old.get(name), new[name]
            if isinstance(was, dict) and isinstance(now, dict):
                inner = next(key for key in {**was, **now} if was.get(key) != now.get(key))
                name, was, now = f"{name}.{inner}", was.get(inner), now.get(inner)
            raise KeycldError(
                f"{folder} holds another run ({name} was {_short(was)}, now {_short(now)}); "
                "choose another --out, or delete that folder."
            )
        return
    if config.constraints is not None:
        write_text(folder / "constraints.toml", config.constraints)
    write_text(folder / "environment.json", json.dumps(environment(), indent=1))
    # Last, because its presence says that the folder is a run's.
    write_text(path, json.dumps(dataclasses.asdict(config), indent=1))


def read_config(folder: Path) -> RunConfig:
    """The configuration of a run folder."""
    path = folder / "config.json"
    try:
        return RunConfig(**json.loads(path.read_text()))
    except FileNotFoundError:
        raise KeycldError(f"{folder} is not a run folder (no config.json); train one with `keycld train`.") from None
    except (TypeError, ValueError) as error:
        raise KeycldError(f"{path} is not a configuration of this version of keycld: {error}.") from error


def environment() -> dict[str, Any]:
    """Versions and the machine, for the record."""
    import jax

    packages = ("keycld", "jax", "jaxlib", "equinox", "optax", "diffrax", "numpy", "mujoco")
    versions = {}
    for package in packages:
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            versions[package] = None
    return {
        "python": sys.version.split()[0],
        "packages": versions,
        "platform": platform.platform(),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "devices": [f"{device.platform}: {device.device_kind}" for device in jax.devices()],
        "commit": _commit(),
    }


class Metrics:
    """`metrics.jsonl`: one JSON object a line, appended; lines beyond a checkpoint are dropped on resume."""

    def __init__(self, folder: Path, step: int):
        """Opens the file and drops lines after `step`, which the resumed run will write again."""
        self._path = folder / "metrics.jsonl"
        lines = []
        if self._path.exists():
            for line in self._path.read_text().splitlines():
                try:
                    if json.loads(line)["step"] <= step:
                        lines.append(line)
                except ValueError:
                    continue  # the line a kill cut in two
        write_text(self._path, "".join(line + "\n" for line in lines))

    def write(self, **values: Any) -> None:
        """Appends one line."""
        with self._path.open("a") as file:
            file.write(json.dumps(values) + "\n")


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 60 else text[:57] + "…"


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor()


def _commit() -> str | None:
    """Of the checkout that this file belongs to; None for an installed package, or without git."""
    here = Path(__file__).parent

    def git(*words: str) -> str:
        return subprocess.run(["git", *words], cwd=here, capture_output=True, text=True, check=False).stdout.strip()

    try:
        return git("rev-parse", "HEAD") or None if git("ls-files", Path(__file__).name) else None
    except OSError:
        return None
