"""Experiment trackers, which are optional; `metrics.jsonl` is always written."""

import importlib
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from keycld._errors import KeycldError, unknown

_PACKAGES = {"wandb": "wandb", "trackio": "trackio", "tensorboard": "tensorboardX"}
TRACKERS = ("none", *_PACKAGES)


@runtime_checkable
class Tracker(Protocol):
    """Receives scalars by name."""

    def log(self, step: int, values: dict[str, float]) -> None:
        """Record values at an optimiser step, counted over all stages, and over all attempts; it never falls."""

    def close(self) -> None:
        """End the recording."""


def check_tracker(name: str) -> None:
    """Refuse a tracker that does not work here.

    Raises:
        KeycldError: there is no tracker of this name, or its package is not installed.
    """
    if name not in TRACKERS:
        raise unknown("tracker", name, TRACKERS)
    try:
        if name != "none":
            importlib.import_module(_PACKAGES[name])
    except ImportError:
        raise KeycldError(f"--track {name} needs its package: pip install 'keycld[{name}]'.") from None


def make_tracker(name: str, folder: Path, config: dict[str, Any]) -> Tracker:
    """Return a tracker that `check_tracker` allows.

    Args:
        name: one of `TRACKERS`.
        folder: run folder; its name is that of the run.
        config: for the tracker's record.
    """
    if name == "none":
        return _Silent()
    return _TensorBoard(folder) if name == "tensorboard" else _Dashboard(name, folder, config)


class _Silent:
    def log(self, step: int, values: dict[str, float]) -> None:
        pass

    def close(self) -> None:
        pass


class _Dashboard:
    """The trackers wandb and trackio, which have the same functions."""

    def __init__(self, name: str, folder: Path, config: dict[str, Any]):
        self._module = importlib.import_module(name)
        self._module.init(project="keycld", name=folder.name, config=config)

    def log(self, step: int, values: dict[str, float]) -> None:
        self._module.log(values, step=step)

    def close(self) -> None:
        self._module.finish()


class _TensorBoard:
    def __init__(self, folder: Path):
        from tensorboardX import SummaryWriter  # pyright: ignore[reportMissingImports]

        self._folder, self._open, self._writer = folder / "tensorboard", SummaryWriter, None

    def log(self, step: int, values: dict[str, float]) -> None:
        if self._writer is None:
            # Of a killed training TensorBoard hides the steps that the resumed one takes again: these and later ones.
            self._writer = self._open(str(self._folder), purge_step=step)
        for name, value in values.items():
            self._writer.add_scalar(name, value, step)

    def close(self) -> None:
        if self._writer is not None:
            self._writer.close()
