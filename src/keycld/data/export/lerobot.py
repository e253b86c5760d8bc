"""Keypoint tracks as a LeRobot data set, format v3.0."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from keycld._errors import KeycldError
from keycld._files import make_folder, replacing, write_text
from keycld._records import read_json
from keycld.data.export.tracks import KeypointTracks

_PARQUET = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_DATA, _EPISODES = (f"{name}/{_PARQUET.format(chunk_index=0, file_index=0)}" for name in ("data", "meta/episodes"))
_TASKS, _STATISTICS, _INFO = "meta/tasks.parquet", "meta/stats.json", "meta/info.json"
_PLACES = ("data/chunk_index", "data/file_index", "meta/episodes/chunk_index", "meta/episodes/file_index")
_INDICES = ("frame_index", "episode_index", "index", "task_index")


def write_lerobot(folder: Path, tracks: KeypointTracks, task: str) -> None:
    """Write a data set that `LeRobotDataset` v3.0 reads: `observation.state` is the keypoints, `action` the inputs.

    Pictures are left out: a data set of keycld has them.

    Args:
        folder: made; `data/` and `meta/` go there.
        tracks: the recordings, one episode each.
        task: one sentence on what is seen.

    Raises:
        KeycldError: pyarrow is missing, which writes Parquet files, the rate is no whole number, or the folder holds
            other files or a data set of something else.
    """
    arrow = _pyarrow()
    fps = 1 / tracks.dt
    if abs(fps - round(fps)) > 1e-3 * fps:
        raise KeycldError(
            f"LeRobot takes a whole number of frames a second, not {fps:.4g}: import the video with --fps."
        )
    count, length, *_ = tracks.x.shape
    state = tracks.x.reshape(count * length, -1).astype(np.float32)
    columns: dict[str, np.ndarray] = {"observation.state": state}
    names = {"observation.state": [f"{name}_{axis}" for name in tracks.names for axis in "xy"]}
    if tracks.u.shape[2]:
        columns["action"] = tracks.u.reshape(count * length, -1).astype(np.float32)
        names["action"] = list(tracks.inputs)
    frame = np.tile(np.arange(length), count)
    episode = np.repeat(np.arange(count), length)
    columns |= {"timestamp": (frame / round(fps)).astype(np.float32)}
    columns |= dict(zip(_INDICES, (frame, episode, np.arange(count * length), np.zeros_like(frame)), strict=True))
    info = _info(columns, names, count, length, round(fps))
    _refuse_other(folder, info["features"])
    _write(arrow, folder / _DATA, _table(arrow, columns))
    _write(arrow, folder / _TASKS, _tasks(arrow, task))
    episodes = {
        "episode_index": np.arange(count),
        "tasks": [[task]] * count,
        "length": np.full(count, length),
        "dataset_from_index": length * np.arange(count),
        "dataset_to_index": length * np.arange(1, count + 1),
        **dict.fromkeys(_PLACES, np.zeros(count, int)),
    }
    for name, values in columns.items():
        parts = [_statistics(part) for part in np.split(values, count)]
        episodes |= {f"stats/{name}/{key}": [part[key] for part in parts] for key in parts[0]}
    _write(arrow, folder / _EPISODES, arrow.table(episodes))
    statistics = {name: _statistics(values) for name, values in columns.items()}
    write_text(folder / _STATISTICS, json.dumps(statistics, indent=1) + "\n")
    # Last: a folder without it is that of an export that was interrupted.
    write_text(folder / _INFO, json.dumps(info, indent=1) + "\n")


def _refuse_other(folder: Path, features: dict[str, Any]) -> None:
    """Refuse a folder with other files or a data set of other features: they would be mixed with these."""
    path = folder / _INFO
    if not path.exists() and _foreign(folder):
        raise KeycldError(f"{folder} holds other files, and stays as it is: choose another --out.")
    if path.exists() and read_json(path, dict[str, Any], f"delete {folder}").get("features") != features:
        raise KeycldError(f"{folder} holds another LeRobot data set, and stays as it is: choose another --out.")


def _foreign(folder: Path) -> bool:
    """Return whether a folder holds anything that an interrupted export has not left there."""
    left = {folder / name for name in (_DATA, _EPISODES, _TASKS, _STATISTICS)}
    left |= {above for path in left for above in path.parents}
    hidden = {path for path in folder.rglob(".*.partial") if path.parent in left}
    return any(path not in left and hidden.isdisjoint((path, *path.parents)) for path in folder.rglob("*"))


def _info(
    columns: dict[str, np.ndarray], names: dict[str, list[str]], count: int, length: int, fps: int
) -> dict[str, Any]:
    features = {
        name: {
            "dtype": str(values.dtype),
            "shape": [values.shape[1] if values.ndim > 1 else 1],
            "names": names.get(name),
            "fps": fps,
        }
        for name, values in columns.items()
    }
    return {
        "codebase_version": "v3.0",
        "robot_type": None,
        "total_episodes": count,
        "total_frames": count * length,
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": fps,
        "splits": {"train": f"0:{count}"},
        "data_path": f"data/{_PARQUET}",
        "video_path": None,
        "features": features,
    }


def _statistics(values: np.ndarray) -> dict[str, list[Any]]:
    flat = values.reshape(len(values), -1).astype(float)
    found = {"min": flat.min(0), "max": flat.max(0), "mean": flat.mean(0), "std": flat.std(0)}
    return {name: each.tolist() for name, each in found.items()} | {"count": [len(values)]}


def _table(arrow: Any, columns: dict[str, np.ndarray]) -> Any:
    arrays = {}
    for name, values in columns.items():
        flat = arrow.array(values.reshape(-1))
        arrays[name] = flat if values.ndim == 1 else arrow.FixedSizeListArray.from_arrays(flat, values.shape[1])
    return arrow.table(arrays)


def _tasks(arrow: Any, task: str) -> Any:
    """Return the table of tasks as pandas writes a frame whose index is the task."""
    table = arrow.table({"task_index": arrow.array([0]), "task": arrow.array([task])})
    kinds = {"task_index": ("int64", "int64"), "task": ("unicode", "object")}
    described = [
        {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": array, "metadata": None}
        for name, (kind, array) in kinds.items()
    ]
    about = {"index_columns": ["task"], "column_indexes": [], "columns": described, "pandas_version": "2.2.0"}
    return table.replace_schema_metadata({"pandas": json.dumps(about)})


def _write(arrow: Any, path: Path, table: Any) -> None:
    import pyarrow.parquet as parquet

    make_folder(path.parent)
    with replacing(path) as temporary:
        parquet.write_table(table, temporary)


def _pyarrow() -> Any:
    try:
        import pyarrow
    except ImportError:
        raise KeycldError("a LeRobot data set needs pyarrow: pip install 'keycld[lerobot]'.") from None
    return pyarrow
