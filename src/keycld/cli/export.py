"""The verb `keycld export`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from keycld._errors import KeycldError, unknown

if TYPE_CHECKING:
    from keycld.data import DataSet
    from keycld.models.base import HasKeypoints, HasLagrangian

_ENDINGS = {"mjcf": ".xml", "csv": ".csv"}
"""Of the targets that are files; the others are folders."""


def export(
    run: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="RUN")],
    /,
    *,
    to: Literal["mjcf", "mujoco-sysid", "csv", "lerobot"],
    data: str | None = None,
    split: str = "train",
    out: Path | None = None,
    metres: float | None = None,
) -> None:
    """Export what a run has learned: a MuJoCo model, or the observed keypoint tracks in a format of other programs.

    Args:
        run: Run folder, or a trained model of the package: pendulum, cartpole, acrobot.
        to: mjcf: a MuJoCo model with the learned lengths, masses, gravity, springs and friction. mujoco-sysid: that
            model, and the tracks as time series of mujoco.sysid. csv: a table with a row a frame. lerobot: a LeRobot
            data set, v3.0 (extra lerobot).
        data: Data set whose recordings are observed; by default that of the training. mjcf needs none.
        split: Which of its files: train, validation, test or test_long.
        out: File (mjcf, csv) or folder; by default RUN/export.xml, .csv, or RUN/export-mujoco-sysid, -lerobot; of
            another split than train, RUN/export-SPLIT.csv and so on.
        metres: Metres in one image-plane unit, for mjcf and mujoco-sysid; by default metres_per_unit of
            RUN/evaluation/physics.json, or 1 without it.
    """
    from keycld.cli.unfinished import say_if_unfinished
    from keycld.models.base import HasKeypoints, HasLagrangian
    from keycld.training import data_folder, load_run, run_folder

    folder = run_folder(run)
    model, config = load_run(folder)
    say_if_unfinished(folder, "exporting")
    if not isinstance(model, HasKeypoints):
        raise KeycldError(f"the model of {folder} has no keypoints to export: train one with --model keycld.")
    size = _metres(folder) if metres is None else metres
    if not 0 < size < float("inf"):
        raise KeycldError(f"--metres of one image-plane unit is above 0, not {size}.")
    file = "export" if split == "train" or to == "mjcf" else f"export-{split}"
    target = out or folder / f"{file}{_ENDINGS.get(to, f'-{to}')}"
    dataset = None if to == "mjcf" else _opened(data or str(data_folder(folder, config.data)), split)
    _check_target(target, to, [folder] if dataset is None else [folder, dataset.folder])
    if to in ("mjcf", "mujoco-sysid"):
        if not isinstance(model, HasLagrangian) or model.constants is None:
            raise KeycldError(f"the model of {folder} has no law with constant lengths: train with the preset fast.")
        _write_model(model, target if to == "mjcf" else target / "model.xml", size)
    if dataset is not None:
        _write_tracks(model, dataset, split, to, target, size)
    print(f"exported: {target}")


def _check_target(target: Path, to: str, folders: list[Path]) -> None:
    """Refuse a folder in the way of a file and the reverse, before the work, and files of the run or of the data.

    A file with the ending of an export is one of an earlier export.
    """
    ending = _ENDINGS.get(to)
    if target.exists() and target.is_dir() is not (ending is None):
        kinds = ("a file", "folder") if ending is None else ("a folder", "file")
        raise KeycldError(f"{target} is {kinds[0]}, and stays as it is: name a {kinds[1]} with --out.")
    within = any(folder.resolve() in target.resolve().parents for folder in folders)
    if target.is_file() and target.suffix != ending and within:
        raise KeycldError(f"{target} belongs to what is exported, and stays as it is: choose another --out.")


def _opened(data: str, split: str) -> "DataSet":
    from keycld.data import open_data

    dataset = open_data(data)
    if split not in dataset.splits:
        raise unknown("split", split, dataset.splits, of=str(dataset.folder))
    return dataset


def _write_model(model: "HasLagrangian", path: Path, metres: float) -> None:
    import numpy as np

    from keycld._files import write_text
    from keycld.mechanics import to_mjcf

    write_text(path, to_mjcf(model.law, np.asarray(model.constants), metres=metres))


def _write_tracks(model: "HasKeypoints", dataset: "DataSet", split: str, to: str, target: Path, metres: float) -> None:
    from keycld.data.export.lerobot import write_lerobot
    from keycld.data.export.tracks import write_csv, write_time_series
    from keycld.evaluation import observed_tracks

    tracks = observed_tracks(model, dataset, split)
    if to == "csv":
        write_csv(target, tracks)
    elif to == "lerobot":
        write_lerobot(target, tracks, f"{dataset.system} moves")
    else:
        write_time_series(target, tracks, metres)


def _metres(folder: Path) -> float:
    """Return metres per image-plane unit as measured, or 1."""
    from keycld.evaluation import PHYSICS, load_physics

    if not (folder / "evaluation" / f"{PHYSICS}.json").exists():
        return 1.0
    return load_physics(folder)["constants"].get("metres_per_unit", {}).get("value") or 1.0
