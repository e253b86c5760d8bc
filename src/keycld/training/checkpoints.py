"""Checkpoints that survive a killed process: written under a temporary name, fsynced, renamed; arrays by name."""

import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NotRequired, TypedDict

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree
from safetensors import SafetensorError
from safetensors.numpy import load_file, save

from keycld._errors import KeycldError
from keycld._files import checked_name, make_folder, read_text, replacing, write_text
from keycld._records import Name, read_json

WEIGHTS, STATE, POSITION = "weights.safetensors", "state.safetensors", "position.json"


class _Position(TypedDict):
    stage: int
    stages: int
    name: str
    step: int
    done: bool
    cached: int
    changes: NotRequired[dict[str, Any]]
    failures: NotRequired[list[str]]
    seconds: float
    cpu_seconds: float
    frames: int
    weights: NotRequired[Name]


def save_checkpoint(
    folder: Path, name: str, weights: PyTree, state: PyTree, position: dict[str, Any], keep: int = 2
) -> Path:
    """Write `folder/checkpoints/NAME/` and then point `latest` at it.

    Args:
        folder: the run folder.
        name: name of the checkpoint.
        weights: the model; its arrays go to `weights.safetensors` by name.
        state: a pytree with the rest of the training's state, such as the optimiser's; its arrays go to
            `state.safetensors`.
        position: stage, step and so on, as JSON values.
        keep: number of checkpoints to keep; older ones are deleted after the new one is on the disk.

    Raises:
        KeycldError: the disk is full or the folder may not be written; the previous checkpoint is intact.
    """
    root = folder / "checkpoints"
    final = root / name
    make_folder(root)
    try:
        # A killed process may have written the checkpoint of this step already; it holds the same bits.
        if not final.exists():
            with replacing(final) as temporary:
                temporary.mkdir()
                save_arrays(temporary / WEIGHTS, weights)
                save_arrays(temporary / STATE, state)
                write_text(temporary / POSITION, json.dumps(position, indent=1))
        write_text(root / "latest", name)
    except KeycldError as error:
        raise KeycldError(f"{error} The previous checkpoint is intact.") from error
    remove_older(final, keep)
    return final


def remove_older(checkpoint: Path, keep: int) -> None:
    """Delete all checkpoints of a run but this one and the `keep` − 1 newest others."""
    # Hidden folders are what killed processes left.
    visible = [path for path in checkpoint.parent.iterdir() if path.is_dir() and not path.name.startswith(".")]
    others = sorted((path for path in visible if path != checkpoint), key=_written)
    for old in others[: max(0, len(others) - keep + 1)]:
        shutil.rmtree(old, ignore_errors=True)


def _written(checkpoint: Path) -> float:
    """Return when a checkpoint was written; its folder's own time changes where a killed process deleted a part."""
    position = checkpoint / POSITION
    return position.stat().st_mtime if position.exists() else 0.0


def latest_checkpoint(folder: Path) -> Path | None:
    """Return the folder of the newest complete checkpoint of a run, or None."""
    pointer = folder / "checkpoints" / "latest"
    try:
        return pointer.parent / checked_name(read_text(pointer).strip(), pointer)
    except FileNotFoundError:
        return None


def read_position(checkpoint: Path) -> dict[str, Any]:
    """Return the JSON part of a checkpoint.

    Raises:
        KeycldError: it is damaged.
    """
    path = checkpoint / POSITION
    try:
        return read_json(path, _Position, f"checkpoint {checkpoint.name} is lost, so train again into a new --out")
    except FileNotFoundError:
        raise KeycldError(f"{path} is missing: train again into a new --out.") from None


def named_arrays(tree: PyTree) -> dict[str, np.ndarray]:
    """Return all arrays of a pytree by their path in it, such as `dynamics.law.mass.root`."""
    return {name: np.asarray(leaf) for name, leaf in _named(tree) if _is_array(leaf)}


def save_arrays(path: Path, tree: PyTree) -> None:
    """Write all arrays of a pytree by name, and wait until they are on the disk."""
    contents = save({name: np.asarray(value, order="C") for name, value in named_arrays(tree).items()})
    with replacing(path) as temporary:
        temporary.write_bytes(contents)


def load_arrays(
    path: Path, like: PyTree, renamed: Mapping[str, str] | None = None, added: Mapping[str, float] | None = None
) -> PyTree:
    """Return `like` with the arrays of a file in place of its own.

    Args:
        path: a file that `save_arrays` wrote.
        like: a pytree whose arrays, or `jax.ShapeDtypeStruct`s, give names and shapes.
        renamed: prefixes of names in earlier versions, with the current ones.
        added: arrays that a file of an earlier version may lack, by name, with the value that they get.

    Raises:
        KeycldError: the file is missing or damaged, or lacks an array or holds one of another shape.
    """
    try:
        saved = load_file(path)
    except (OSError, SafetensorError, ValueError) as error:
        raise KeycldError(f"{path} is missing or damaged ({error}): train again into a new --out.") from error
    arrays = {_current(name, renamed or {}): value for name, value in saved.items()}
    wanted = {name: leaf for name, leaf in _named(like) if _is_array(leaf)}
    for name in (added or {}).keys() & wanted.keys() - arrays.keys():
        arrays[name] = np.full(wanted[name].shape, (added or {})[name], wanted[name].dtype)
    for name in {**wanted, **arrays}:
        if name not in arrays or name not in wanted:
            what = "is missing" if name not in arrays else "belongs to nothing"
            raise KeycldError(
                f"{path} does not fit this model: '{name}' {what}; use the keycld that wrote it, or train again."
            )
        if arrays[name].shape != wanted[name].shape:
            raise KeycldError(
                f"{path} does not fit this model: '{name}' has the shape {list(arrays[name].shape)}, not "
                f"{list(wanted[name].shape)}; train again into a new --out."
            )
    leaves = [jnp.asarray(arrays[name], leaf.dtype) if _is_array(leaf) else leaf for name, leaf in _named(like)]
    return jax.tree.unflatten(jax.tree.structure(like), leaves)


def _named(tree: PyTree) -> list[tuple[str, Any]]:
    leaves = jax.tree_util.tree_leaves_with_path(tree)
    return [(jax.tree_util.keystr(path, simple=True, separator="."), leaf) for path, leaf in leaves]


def _is_array(leaf: Any) -> bool:
    return isinstance(leaf, (jax.Array, np.ndarray, jax.ShapeDtypeStruct))


def _current(name: str, renamed: Mapping[str, str]) -> str:
    for old in sorted(renamed, key=len, reverse=True):
        if name.startswith(old):
            return renamed[old] + name.removeprefix(old)
    return name
