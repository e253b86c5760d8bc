"""The verb `keycld export`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from keycld._errors import KeycldError

if TYPE_CHECKING:
    from keycld.models.base import HasKeypoints, HasLagrangian


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
    from keycld.models.base import HasKeypoints, HasLagrangian
    from keycld.training import data_folder, load_run, run_folder

    folder = run_folder(run)
    model, config = load_run(folder)
    if not isinstance(model, HasKeypoints):
        raise KeycldError(f"the model of {folder} has no keypoints to export: train one with --model keycld.")
    size = _metres(folder) if metres is None else metres
    if not 0 < size < float("inf"):
        raise KeycldError(f"--metres of one image-plane unit is above 0, not {size}.")
    file = "export" if split == "train" or to == "mjcf" else f"export-{split}"
    ending = {"mjcf": ".xml", "csv": ".csv"}.get(to, f"-{to}")
    target = out or folder / f"{file}{ending}"
    if to in ("mjcf", "mujoco-sysid"):
        if not isinstance(model, HasLagrangian) or model.constants is None:
            raise KeycldError(f"the model of {folder} has no law with constant lengths: train with the preset fast.")
        _write_model(model, target if to == "mjcf" else target / "model.xml", size)
    if to != "mjcf":
        _write_tracks(model, data or str(data_folder(folder, config.data)), split, to, target, size)
    print(f"exported: {target}")


def _write_model(model: "HasLagrangian", path: Path, metres: float) -> None:
    import numpy as np

    from keycld._files import write_text
    from keycld.mechanics import to_mjcf

    write_text(path, to_mjcf(model.law, np.asarray(model.constants), metres=metres))


def _write_tracks(model: "HasKeypoints", data: str, split: str, to: str, target: Path, metres: float) -> None:
    from keycld.data import open_data
    from keycld.data.export.lerobot import write_lerobot
    from keycld.data.export.tracks import write_csv, write_time_series
    from keycld.evaluation import observed_tracks

    dataset = open_data(data)
    if split not in dataset.splits:
        raise KeycldError(f"{dataset.folder} has no {split}.h5: choose from {', '.join(dataset.splits)}.")
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
