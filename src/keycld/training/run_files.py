"""The files of a run: configuration, environment, metrics."""

import dataclasses
import json
import os
import platform
import subprocess
import sys
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any, TypedDict

from keycld._errors import KeycldError
from keycld._files import read_text, write_text, writing_error
from keycld._records import Name, checked, read_json
from keycld.models import ModelConfig, Scene, config_for

SCHEMA_VERSION = 8


class _Verdict(TypedDict):
    passed: bool
    failures: list[str]


@dataclasses.dataclass(frozen=True)
class RunConfig:
    """The whole configuration of a run; `config.json` holds it and `--config` reads it back.

    Attributes:
        data: folder of the data set.
        data_hash: checksum of its training file.
        system: name of the system.
        model: name of the model.
        preset: name of its preset.
        settings: all fields of the preset's config.
        seed: of weights, data order and all other randomness.
        scene: sizes of the data, so that the model can be built without them.
        input_names: names of the inputs, if the data name them.
        epsilon: ε, the threshold of the validation set, eq. (16).
        steps_per_dispatch: optimiser steps in one compiled call.
        checkpoint_seconds: time between checkpoints.
        command: the command line of the run.
        devices: number of devices that shared each batch.
        minutes: time that the steps were shortened to; None: they were not.
        share: of the recipe's steps; `settings` has what is left of them.
        together: number of trainings that took their steps in one program, this one included.
        schema_version: version of this file's format; earlier ones are migrated on reading.
    """

    data: str
    data_hash: str | None
    system: str
    model: str
    preset: str
    settings: dict[str, Any]
    seed: int
    scene: dict[str, Any]
    input_names: tuple[str, ...]
    epsilon: float
    steps_per_dispatch: int
    checkpoint_seconds: float
    command: str
    devices: int = 1
    minutes: float | None = None
    share: float = 1.0
    together: int = 1
    schema_version: int = SCHEMA_VERSION

    def decides(self) -> dict[str, Any]:
        """Return the part that must be equal for a run to be resumed."""
        fields = dataclasses.asdict(self)
        for name in (
            "command",
            "checkpoint_seconds",
            "devices",
            "together",
            "data",
            "input_names",
            "epsilon",
            "schema_version",
        ):
            del fields[name]
        return json.loads(json.dumps(fields))

    def model_config(self) -> ModelConfig:
        """Return the config of the model.

        Raises:
            KeycldError: this keycld knows no such model, preset or setting.
        """
        return config_for(self.model, self.preset, **self.settings)


def open_run(folder: Path, config: RunConfig) -> None:
    """Make the run folder, or check that an existing one has the same configuration.

    Raises:
        KeycldError: it has another configuration, or cannot be written.
    """
    path = folder / "config.json"
    if path.exists():
        old, new = read_config(folder).decides(), config.decides()
        different = [name for name in new if old.get(name) != new[name]]
        if different:
            name = different[0]
            was, now = old.get(name), new[name]
            while isinstance(was, dict) and isinstance(now, dict):
                inner = next(key for key in {**was, **now} if was.get(key) != now.get(key))
                name, was, now = f"{name}.{inner}", was.get(inner), now.get(inner)
            raise KeycldError(
                f"{folder} holds another run ({name} was {_short(was)}, now {_short(now)}); "
                "choose another --out, or delete that folder."
            )
        return
    write_text(folder / "environment.json", json.dumps(environment(), indent=1))
    # Last, because this file marks the folder as that of a run.
    write_text(path, json.dumps(dataclasses.asdict(config), indent=1))


def read_config(folder: Path) -> RunConfig:
    """Return the configuration of a run folder.

    Raises:
        KeycldError: the folder is not a run's, or the file is damaged or of a later version.
    """
    path = folder / "config.json"
    if not path.exists():
        raise KeycldError(f"{folder} is not a run folder (no config.json): train one with `keycld train`.")
    return parse_config(path)


def parse_config(path: Path) -> RunConfig:
    """Return the configuration in a run's `config.json`, migrated to the current schema.

    Raises:
        KeycldError: the file is missing, damaged or of a later version.
    """
    try:
        saved = checked(json.loads(read_text(path)), dict[str, Any])
        version = checked(saved.get("schema_version", 1), int, "schema_version")
        if version > SCHEMA_VERSION:
            raise ValueError(f"schema_version {version} is later than {SCHEMA_VERSION}: use the keycld that wrote it")
        if version == 1:
            saved = _from_schema_1(saved)
        if version < SCHEMA_VERSION:
            config = config_for(saved["model"], saved["preset"])
            settings = config.changed(config.migrated(saved["settings"], version)).settings()
            saved = {**saved, "settings": settings, "schema_version": SCHEMA_VERSION}
        scene = checked(saved["scene"], Scene, "scene")
        for name in ("height", "width", "frames", "trajectories"):
            if getattr(scene, name) < 1:
                raise ValueError(f"'scene.{name}' is {getattr(scene, name)}, but must be at least 1")
        return checked({**saved, "input_names": tuple(saved["input_names"])}, RunConfig)
    except FileNotFoundError:
        raise KeycldError(f"there is no file {path}: check the path.") from None
    except KeycldError:
        raise
    except (AttributeError, KeyError, TypeError, ValueError, RecursionError) as error:
        raise KeycldError(
            f"{path} is not a configuration of this version of keycld ({error}): restore it or train again."
        ) from error


def _from_schema_1(saved: dict[str, Any]) -> dict[str, Any]:
    """Return a configuration of schema 1, which had constraints and keypoints outside of the settings."""
    known = {name: saved[name] for name in (f.name for f in dataclasses.fields(RunConfig)) if name in saved}
    scene = {name: value for name, value in saved["scene"].items() if name != "keypoints"} | {"dt": saved["dt"]}
    settings = {**saved["settings"], "constraints": saved["constraints"]}
    return {**known, "settings": settings, "scene": scene, "input_names": (), "epsilon": float("nan")}


def environment() -> dict[str, Any]:
    """Return versions, machine and commit, for the record."""
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


def write_verdict(folder: Path, failures: list[str], *, passed: bool) -> None:
    """Write `verdict.json`: whether a finished training has passed, and what failed in each attempt before."""
    write_text(folder / "verdict.json", json.dumps({"passed": passed, "failures": failures}, indent=1))


def read_verdict(folder: Path) -> dict[str, Any] | None:
    """Return the verdict on a training, None while it is not finished or if it is damaged."""
    try:
        return read_json(folder / "verdict.json", _Verdict, "delete it")
    except (FileNotFoundError, KeycldError):
        return None


def refuse_failed(folder: Path) -> None:
    """Raise KeycldError for a run whose training has failed: what it left is no model."""
    verdict = read_verdict(folder)
    if verdict is not None and not verdict["passed"]:
        raise KeycldError(
            f"there is no model in {folder}, because its training has failed {len(verdict['failures'])} times (`keycld "
            f"report {folder}` shows each), the last time in stage "
            f"{'; '.join(verdict['failures'][-1:])}"
        )


class _Line(TypedDict):
    step: int
    stage: Name
    frames: int


class Metrics:
    """The file `metrics.jsonl`: one JSON object on each line; lines after a checkpoint are dropped on resume."""

    def __init__(self, folder: Path, step: int, frames: int, stages: Sequence[str]):
        """Open the file and drop the lines that the resumed run writes again.

        Args:
            folder: the run folder.
            step: lines after this one are dropped.
            frames: also those after so many frames: of a later attempt, which counts its steps from zero.
            stages: also those of other stages.
        """
        self._path = folder / "metrics.jsonl"
        lines = []
        for line in read_text(self._path).splitlines() if self._path.exists() else ():
            try:
                known = checked(json.loads(line), _Line)
                if known["step"] <= step and known["frames"] <= frames and known["stage"] in stages:
                    lines.append(line)
            except (ValueError, RecursionError):
                continue  # an incomplete line of a killed process
        write_text(self._path, "".join(line + "\n" for line in lines))

    def write(self, **values: Any) -> None:
        """Append one line."""
        try:
            with self._path.open("a") as file:
                file.write(json.dumps(values) + "\n")
        except OSError as error:
            raise writing_error(self._path, error) from error


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
    """Return the commit of the checkout that this file belongs to; None for an installed package or without git."""
    here = Path(__file__).parent

    def git(*words: str) -> str:
        return subprocess.run(["git", *words], cwd=here, capture_output=True, text=True, check=False).stdout.strip()

    try:
        return git("rev-parse", "HEAD") or None if git("ls-files", Path(__file__).name) else None
    except OSError:
        return None
