"""Predict every trajectory of a file from its given frames and inputs: what `keycld predict` does."""

from pathlib import Path

import h5py
import numpy as np
from jaxtyping import UInt8

from keycld._errors import KeycldError
from keycld.data import open_file, read, with_pictures
from keycld.data.format.hdf5 import create_file
from keycld.data.generate.make import provide
from keycld.evaluation.predicting import Progress, batch_size, predict, refuse_too_few
from keycld.evaluation.reading import cut
from keycld.models.base import AbstractModel, Reversible

_CHUNK = 16


def predict_file(
    model: AbstractModel,
    data_file: str | Path,
    out: str | Path,
    *,
    given: int | None = None,
    first: int = 0,
    progress: Progress | None = None,
) -> Path:
    """Write predictions for each trajectory of `data_file` to the HDF5 file `out`.

    `out` holds `/image` float32 `[N, T, H, W, 3]` in [0, 1], `/keypoints` float32 `[N, T, K, 2]` in image-plane units
    where the model has keypoints, a copy of `/time` and `/input`, and the source's attributes with `given_frames` and
    `first_given_frame`. Only the given frames and the inputs are read; a file with nothing else than those is enough.
    Where a file has states and a renderer of ours instead of pictures, the given frames are rendered. Trajectories pass
    in chunks, so memory does not grow with their number; an interrupted call leaves no file.

    Args:
        model: any model.
        data_file: in the format of a data set; made now if it is a `test_long.h5` that keycld left for later.
        out: replaced if it holds predictions.
        given: frames to give; as many as the model needs by default.
        first: number of the first given frame. The motion before it is predicted too, by a `Reversible` model.
        progress: called with the number of frames predicted and their total.

    Raises:
        KeycldError: the file is not valid, has no pictures or fewer frames than are given; the model needs more, or
            cannot run backward; `out` cannot be written, or is something else than predictions.
    """
    given = model.context if given is None else given
    refuse_too_few(model, given)
    provide(Path(data_file))
    about = read(data_file, images=False)
    count, length, dt = len(about), about.frames, about.dt
    if Path(out).resolve() == Path(data_file).resolve():
        raise KeycldError(f"'{out}' is the data itself: give another file for the predictions.")
    if Path(out).is_file() and not _holds_predictions(out):
        raise KeycldError(f"{out} is no file of predictions, and stays as it is: choose another --out.")
    if not 0 <= first <= length - given:
        raise KeycldError(
            f"frames {first} to {first + given - 1} are to be given, but the recordings of {data_file} have "
            f"frames 0 to {length - 1}: give frames among these."
        )
    if first > 0 and not isinstance(model, Reversible):
        raise KeycldError(f"this model cannot run backward, so the first given frame is 0, not {first}.")
    with open_file(data_file) as file:
        attributes = dict(file.attrs)
    with create_file(out) as target:
        target.attrs.update(attributes)
        target.attrs["given_frames"], target.attrs["first_given_frame"] = given, first
        target["time"], target["input"] = about.time, about.input
        batch = min(count, batch_size(length))
        for begun in range(0, count, batch * _CHUNK):
            rows = slice(begun, min(begun + batch * _CHUNK, count))
            frames = _given_frames(data_file, rows, first, given)
            parts = predict(model, frames, dt, about.input[rows], length, first=first, batch=batch)
            for part, found in parts:
                at = slice(begun + part.start, begun + part.stop)
                for name, value in (("image", found.frames), ("keypoints", found.keypoints)):
                    if value is not None:
                        _dataset(target, name, count, value)[at] = value
                if progress is not None:
                    progress(at.stop * length, count * length)
    return Path(out)


def _holds_predictions(path: str | Path) -> bool:
    try:
        with open_file(path) as file:
            return "given_frames" in file.attrs
    except KeycldError:
        return False


def _given_frames(path: str | Path, rows: slice, first: int, given: int) -> UInt8[np.ndarray, "N n H W 3"]:
    """Return the given frames of some trajectories, stored or rendered from states, which reach the renderer only."""
    with open_file(path) as file:
        if "image" in file:
            return file["image"][rows, first : first + given]
    image = with_pictures(cut(read(path, images=False, rows=rows), first, first + given)).image
    if image is None:
        raise KeycldError(f"'{path}' has no /image, and nothing of ours renders its states: add the pictures.")
    return image


def _dataset(target: h5py.File, name: str, count: int, part: np.ndarray) -> h5py.Dataset:
    """Return the data set of that name, made at its first use, one compressed chunk a trajectory."""
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
