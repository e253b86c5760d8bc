"""Trained models that come with the package: weights in half precision, configuration, card."""

import dataclasses
import json
import shutil
import sys
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from keycld._errors import KeycldError, unknown
from keycld._files import aside_of
from keycld.data import sha256
from keycld.mechanics import load_constraints
from keycld.models import AbstractModel
from keycld.training.checkpoints import latest_checkpoint, read_position, save_checkpoint
from keycld.training.run_folder import RunConfig, open_run, read_config
from keycld.training.train import blank_model, load_run

_SHELF = Path(__file__).parent / "weights"
# Parts of a model that decide its motion: kept in single precision.
_EXACT = (".dynamics", ".start", ".beginning")


def pretrained() -> tuple[str, ...]:
    """Names of the trained models in the package."""
    return tuple(sorted(path.parent.name for path in _SHELF.glob("*/weights.npz")))


def load_model(run: str | Path) -> tuple[AbstractModel, RunConfig]:
    """A trained model and its configuration, by the name of one in the package or from a run folder.

    A run folder of that name in the working directory comes first.

    **Raises:** KeycldError for neither, or for damaged files.
    """
    if not _is_packaged(run):
        return load_run(run)
    shelf = _SHELF / str(run)
    config = read_config(shelf)
    blank = blank_model(config, load_constraints(shelf / "constraints.toml"))

    def fill(path: Any, leaf: Any) -> Any:
        return jnp.asarray(saved[jax.tree_util.keystr(path)], leaf.dtype) if eqx.is_inexact_array(leaf) else leaf

    try:
        with (shelf / "weights.npz").open("rb") as file, np.load(file) as saved:
            return jax.tree_util.tree_map_with_path(fill, blank), config
    except (KeyError, OSError, ValueError, BadZipFile) as error:
        raise KeycldError(f"the packaged model '{run}' is damaged ({error}): install keycld again.") from error


def run_folder(run: str | Path) -> Path:
    """The folder of a run; for the name of a model in the package, `runs/NAME-pretrained`, made where it is missing.

    So evaluations, reports and control have a place of their own for a model that was not trained here. What was made
    with another version of it is moved aside, to `NAME-pretrained.HASH`.
    """
    if not _is_packaged(run):
        folder = Path(run)
        if folder.name == str(run) and not folder.exists():
            raise unknown("run folder or trained model", str(run), pretrained())
        return folder
    folder, weights = Path("runs") / f"{run}-pretrained", sha256(_SHELF / str(run) / "weights.npz")
    checkpoint = latest_checkpoint(folder)
    before = None if checkpoint is None else read_position(checkpoint).get("weights", "")
    if before != weights:
        if before is None:
            shutil.rmtree(folder, ignore_errors=True)
        else:
            aside = aside_of(folder, before[:8])
            folder.rename(aside)
            print(f"another version of the model {run} was at work in {folder}: moved to {aside}", file=sys.stderr)
        model, config = load_model(run)
        open_run(folder, dataclasses.replace(config, constraints=(_SHELF / str(run) / "constraints.toml").read_text()))
        shutil.copy(_SHELF / str(run) / "metrics.jsonl", folder / "metrics.jsonl")
        steps = json.loads((folder / "metrics.jsonl").read_text().splitlines()[-1])
        position = {"stage": 0, "stages": 1, "name": "packaged", "step": steps["step"], "done": True, "cached": 0}
        position["weights"] = weights
        position |= {name: steps[name] for name in ("seconds", "cpu_seconds", "frames")}
        save_checkpoint(folder, "00-packaged", (model, None, None), position)
    return folder


def pack(run: str | Path, card: str, shelf: Path | None = None) -> Path:
    """Puts a trained run on the shelf under its system's name.

    Kernels and pictures become half precision, which changes a frame by less than a grey level; what decides the
    motion (masses, energies, inputs, lengths) stays as it is.

    **Arguments:**

    - `run`: run folder, trained to its end.
    - `card`: the model's card, Markdown.
    - `shelf`: where; the package's own unless told.
    """
    model, config = load_run(run)
    folder = (shelf or _SHELF) / config.system
    if config.constraints is None:
        raise KeycldError(f"{run} was trained with a Python function as constraint, which no file can hold.")
    folder.mkdir(parents=True, exist_ok=True)
    weights = {}
    for path, leaf in jax.tree_util.tree_leaves_with_path(model):
        if eqx.is_inexact_array(leaf):
            name = jax.tree_util.keystr(path)
            weights[name] = np.asarray(leaf, np.float32 if name.startswith(_EXACT) else np.float16)
    np.savez_compressed(folder / "weights.npz", **weights)
    (folder / "constraints.toml").write_text(config.constraints)
    # What was typed may name folders of the machine; this trains the same.
    command = f"keycld train {config.system} --model {config.model} --preset {config.preset} --seed {config.seed}"
    plain = dataclasses.replace(config, command=command)
    (folder / "config.json").write_text(json.dumps(dataclasses.asdict(plain), indent=1) + "\n")
    (folder / "README.md").write_text(card)
    shutil.copy(Path(run) / "metrics.jsonl", folder / "metrics.jsonl")
    return folder


def _is_packaged(run: str | Path) -> bool:
    return str(run) in pretrained() and not (Path(run) / "config.json").exists()
