"""Trained models that come with the package: weights in half precision, configuration, card."""

import dataclasses
import json
import shutil
import sys
from pathlib import Path

import numpy as np

from keycld._errors import KeycldError, unknown
from keycld._files import aside_of, copy_file
from keycld._lock import alone
from keycld.data import sha256
from keycld.models.base import AbstractModel
from keycld.training.checkpoints import (
    WEIGHTS,
    latest_checkpoint,
    load_arrays,
    named_arrays,
    read_position,
    save_arrays,
    save_checkpoint,
)
from keycld.training.run_files import RunConfig, open_run, read_config
from keycld.training.runs import blank_model, load_run

# Data of the package.
_SHELF = Path(__file__).parent.parent / "weights"


def pretrained() -> tuple[str, ...]:
    """Return the names of the trained models in the package."""
    return tuple(sorted(path.parent.name for path in _SHELF.glob(f"*/{WEIGHTS}")))


def load_model(run: str | Path) -> tuple[AbstractModel, RunConfig]:
    """Return a trained model and its configuration.

    Args:
        run: a run folder, or the name of a model in the package. A run folder of that name in the working directory
            comes first.

    Raises:
        KeycldError: it is neither, or a file is damaged.
    """
    if not _is_packaged(run):
        return load_run(run_folder(run))
    shelf = _SHELF / str(run)
    config = read_config(shelf)
    chosen = config.model_config()
    try:
        return load_arrays(shelf / WEIGHTS, blank_model(chosen, config), chosen.RENAMED, chosen.ADDED), config
    except KeycldError as error:
        raise KeycldError(f"the packaged model '{run}' is damaged ({error}): install keycld again.") from error


def data_folder(run: str | Path, named: str | Path) -> Path:
    """Return the folder of the data that a run was trained on.

    It is the one that the configuration names, seen from the working directory. Where that is missing, it is `data` in
    the run folder, where `keycld watch` puts them: a run may be renamed, or used from elsewhere.

    Args:
        run: a run folder, or the name of a model in the package.
        named: the folder that its configuration names.
    """
    inside = Path(run) / "data"
    return inside if inside.is_dir() and not Path(named).is_dir() else Path(named)


def run_folder(run: str | Path) -> Path:
    """Return the folder of a run; for a model in the package `runs/NAME-pretrained`, which is made if it is missing.

    Evaluations, reports and control results of a packaged model go there. If that folder belongs to another version of
    the model, it is renamed to `NAME-pretrained.HASH` first.

    Args:
        run: a run folder, or the name of a model in the package.

    Raises:
        KeycldError: it is neither.
    """
    if not _is_packaged(run):
        folder = Path(run)
        if folder.name == str(run) and not folder.exists():
            raise unknown("run folder or trained model", str(run), pretrained())
        return folder
    folder = Path("runs") / f"{run}-pretrained"
    with alone(folder.parent, "unpacks a model", f".{folder.name}.lock"):
        _unpack(str(run), folder)
    return folder


def _unpack(run: str, folder: Path) -> None:
    weights = sha256(_SHELF / run / WEIGHTS)
    checkpoint = latest_checkpoint(folder)
    before = None if checkpoint is None else read_position(checkpoint).get("weights", "")
    if before != weights:
        if before is None:
            shutil.rmtree(folder, ignore_errors=True)
        else:
            aside = aside_of(folder, before[:8])
            folder.rename(aside)
            print(f"{folder} holds results of another version of the model {run}: moved to {aside}", file=sys.stderr)
        model, config = load_model(run)
        open_run(folder, config)
        copy_file(_SHELF / run / "metrics.jsonl", folder / "metrics.jsonl")
        steps = json.loads((folder / "metrics.jsonl").read_text().splitlines()[-1])
        position = {"stage": 0, "stages": 1, "name": "packaged", "step": steps["step"], "done": True, "cached": 0}
        position["weights"] = weights
        position |= {name: steps[name] for name in ("seconds", "cpu_seconds", "frames")}
        save_checkpoint(folder, "00-packaged", model, {}, position)


def pack(run: str | Path, card: str, shelf: Path | None = None) -> Path:
    """Add a trained run to the models of the package, under the name of its system.

    The weights that `ModelConfig.HALF` names become half precision, which changes a frame by less than a grey level;
    the weights of the dynamics keep single precision.

    Args:
        run: run folder of a finished training.
        card: the model's card, Markdown.
        shelf: the folder to add to; by default that of the package.

    Returns:
        the new folder.
    """
    model, config = load_run(run)
    half, folder = config.model_config().HALF, (shelf or _SHELF) / config.system
    folder.mkdir(parents=True, exist_ok=True)
    weights = {
        name: value.astype(np.float16) if name.startswith(half) else value
        for name, value in named_arrays(model).items()
    }
    save_arrays(folder / WEIGHTS, weights)
    # The recorded command and data may name folders of the machine; this command trains the same model.
    command = f"keycld train {config.system} --model {config.model} --preset {config.preset} --seed {config.seed}"
    settings = config.model_config().matching(model).settings()
    plain = dataclasses.replace(config, data=f"data/{config.system}", command=command, settings=settings)
    (folder / "config.json").write_text(json.dumps(dataclasses.asdict(plain), indent=1) + "\n")
    (folder / "README.md").write_text(card)
    shutil.copy(Path(run) / "metrics.jsonl", folder / "metrics.jsonl")
    return folder


def _is_packaged(run: str | Path) -> bool:
    return str(run) in pretrained() and not (Path(run) / "config.json").exists()
