"""Optional experiment trackers; `metrics.jsonl` is always written."""

from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from keycld._errors import KeycldError, unknown

TRACKERS = ("none", "wandb", "trackio", "tensorboard")


@runtime_checkable
class Tracker(Protocol):
    """Receives scalars by name."""

    def log(self, step: int, values: dict[str, float]) -> None:
        """Values at an optimiser step, counted over all stages."""

    def close(self) -> None:
        """The run has ended."""


def make_tracker(name: str, folder: Path, config: dict[str, Any]) -> Tracker:
    """A tracker by name; KeycldError when its package is not installed."""
    if name not in TRACKERS:
        raise unknown("tracker", name, TRACKERS)
    if name == "none":
        return _Silent()
    try:
        return _TensorBoard(folder) if name == "tensorboard" else _Dashboard(name, folder, config)
    except ImportError:
        package = "tensorboardX" if name == "tensorboard" else name
        raise KeycldError(f"--track {name} needs its package: pip install {package}.") from None


class _Silent:
    def log(self, step: int, values: dict[str, float]) -> None:
        pass

    def close(self) -> None:
        pass


class _Dashboard:
    """wandb, or trackio, which offers the same calls."""

    def __init__(self, name: str, folder: Path, config: dict[str, Any]):
        import importlib

        self._module = importlib.import_module(name)
        self._run = self._module.init(project="keycld", name=folder.name, config=config)

    def log(self, step: int, values: dict[str, float]) -> None:
        self._module.log(values, step=step)

    def close(self) -> None:
        self._module.finish()


class _TensorBoard:
    def __init__(self, folder: Path):
        from tensorboardX import SummaryWriter  # pyright: ignore[reportMissingImports]

        self._writer = SummaryWriter(str(folder / "tensorboard"))

    def log(self, step: int, values: dict[str, float]) -> None:
        for name, value in values.items():
            self._writer.add_scalar(name, value, step)

    def close(self) -> None:
        self._writer.close()
