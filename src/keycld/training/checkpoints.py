"""Checkpoints that survive a killed process: written under a temporary name, fsynced, renamed."""

import json
import os
import shutil
from pathlib import Path
from typing import Any

import equinox as eqx

from keycld._errors import KeycldError
from keycld._files import sync, write_text


def save_checkpoint(folder: Path, name: str, tree: Any, position: dict[str, Any], keep: int = 2) -> Path:
    """Writes `folder/checkpoints/NAME/{leaves.eqx, position.json}` and then points `latest` at it.

    **Arguments:**

    - `folder`: the run folder.
    - `tree`: any pytree of arrays: weights, optimiser state, cached keypoints.
    - `position`: what else the run needs to go on (stage, step, …), as JSON.
    - `keep`: how many checkpoints stay; older ones are deleted after the new one is safe.
    """
    root = folder / "checkpoints"
    temporary, final = root / f".{name}.partial", root / name
    try:
        root.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(temporary, ignore_errors=True)
        temporary.mkdir()
        with (temporary / "leaves.eqx").open("wb") as file:
            eqx.tree_serialise_leaves(file, tree)
            file.flush()
            os.fsync(file.fileno())
        write_text(temporary / "position.json", json.dumps(position, indent=1))
        # A killed process may have written this very step already; it holds the same bits.
        if final.exists():
            shutil.rmtree(temporary)
        else:
            os.replace(temporary, final)
        sync(root)
        write_text(root / "latest", name)
    except OSError as error:
        raise KeycldError(
            f"cannot write the checkpoint {final}: {error.strerror}; free some space or choose another --out. "
            "The previous checkpoint is intact."
        ) from error
    others = sorted((p for p in root.iterdir() if p.is_dir() and p != final), key=lambda p: p.stat().st_mtime)
    for old in others[: max(0, len(others) - keep + 1)]:
        shutil.rmtree(old, ignore_errors=True)
    return final


def latest_checkpoint(folder: Path) -> Path | None:
    """The folder of the newest complete checkpoint of a run, or None."""
    pointer = folder / "checkpoints" / "latest"
    return pointer.parent / pointer.read_text().strip() if pointer.exists() else None


def read_position(checkpoint: Path) -> dict[str, Any]:
    """The JSON part of a checkpoint."""
    try:
        return json.loads((checkpoint / "position.json").read_text())
    except (OSError, ValueError) as error:
        raise KeycldError(f"checkpoint {checkpoint} is damaged ({error}); delete it and train again.") from error


def load_leaves(checkpoint: Path, like: Any) -> Any:
    """The arrays of a checkpoint in the shape of `like`."""
    try:
        return eqx.tree_deserialise_leaves(checkpoint / "leaves.eqx", like)
    except (OSError, ValueError, RuntimeError, EOFError) as error:
        first = str(error).splitlines()[0]
        raise KeycldError(
            f"checkpoint {checkpoint} does not fit this recipe or is damaged ({first}); train again into a new --out."
        ) from error
