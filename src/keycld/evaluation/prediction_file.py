"""Predict every trajectory of a file from its first frames and inputs: what `keycld predict` does."""

from pathlib import Path

import h5py
import numpy as np

from keycld._errors import KeycldError
from keycld._files import replacing
from keycld.data import open_file, read
from keycld.evaluation.predicting import Progress, batch_size, predict
from keycld.models.base import AbstractModel

_CHUNK = 16


def predict_file(
    model: AbstractModel,
    data_file: str | Path,
    out: str | Path,
    *,
    given: int | None = None,
    progress: Progress | None = None,
) -> Path:
    """Write predictions for each trajectory of `data_file` to the HDF5 file `out`.

    `out` holds `/image` float32 `[N, T, H, W, 3]` in [0, 1], `/keypoints` float32 `[N, T, K, 2]` in
    image-plane units where the model has keypoints, a copy of `/time` and `/input`, and the source's
    attributes with `given_frames`. Only the first frames and the inputs are read; a file with nothing else
    than those is enough. Trajectories pass in chunks, so memory does not grow with their number; an
    interrupted call leaves no file.

    Args:
        model: any model.
        data_file: in the format of a data set, with pictures.
        out: replaced if it exists.
        given: frames to give; as many as the model needs by default.
        progress: called with the number of frames predicted and their total.

    Raises:
        KeycldError: the file is not valid or has no pictures or fewer frames than the model needs; `out`
            cannot be written.
    """
    given = model.context if given is None else given
    source = read(data_file, images=False)
    count, length, dt = len(source.input), len(source.time), float(source.attributes["dt"])
    if Path(out).resolve() == Path(data_file).resolve():
        raise KeycldError(f"'{out}' is the data itself: give another file for the predictions.")
    with open_file(data_file) as file:
        if "image" not in file:
            raise KeycldError(f"'{data_file}' has no /image, so there is nothing to predict from: draw it first.")
        attributes = dict(file.attrs)
    with replacing(out) as temporary, h5py.File(temporary, "w") as target:
        target.attrs.update(attributes)
        target.attrs["given_frames"] = given
        target["time"], target["input"] = source.time, source.input
        chunk = batch_size(length) * _CHUNK
        for start in range(0, count, chunk):
            rows = slice(start, min(start + chunk, count))
            parts = predict(model, _first_frames(data_file, rows, given), dt, source.input[rows], length)
            for part, found in parts:
                at = slice(start + part.start, start + part.stop)
                for name, value in (("image", found.frames), ("keypoints", found.keypoints)):
                    if value is not None:
                        _dataset(target, name, count, value)[at] = value
                if progress is not None:
                    progress(at.stop * length, count * length)
    return Path(out)


def _first_frames(path: str | Path, rows: slice, given: int) -> np.ndarray:
    with open_file(path) as file:
        return file["image"][rows, :given]


def _dataset(target: h5py.File, name: str, count: int, part: np.ndarray) -> h5py.Dataset:
    """The data set of that name, made at its first use, one compressed chunk a trajectory."""
    if name not in target:
        shape = (count, *part.shape[1:])
        options = {
            "chunks": (1, *part.shape[1:]),
            "compression": "gzip",
            "compression_opts": 1,
            "shuffle": True,
        }
        target.create_dataset(name, shape, np.float32, **options)
    dataset = target[name]
    assert isinstance(dataset, h5py.Dataset)
    return dataset
