"""The verb `keycld predict`."""

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import tyro

from keycld._errors import KeycldError

_HDF5 = (".h5", ".hdf5")
_MOST = 10**9
"""More frames than any recording has."""


def predict(
    run: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="RUN")],
    /,
    *,
    data: Path,
    out: Path,
    given: int | None = None,
    first: Annotated[str, tyro.conf.arg(aliases=["--from"])] = "0",
) -> None:
    """Predict all frames of every trajectory in a file from its given frames and its inputs alone.

    Args:
        run: Run folder, or a trained model of the package: pendulum, cartpole, acrobot.
        data: HDF5 file in keycld's format, with pictures or with states that keycld renders; or a video from the camera
            and place of the clips that the run has learned.
        out: HDF5 file to write: /image float32 [N, T, H, W, 3] and /keypoints [N, T, K, 2]. Of what is there
            already, only a file of predictions is replaced.
        given: Number of given frames; by default as many as the model needs. More make a better initial state.
        first: The first given frame: its number, or its time such as 12.5s. A reversible model predicts the frames
            before it backward.
    """
    from keycld.cli.unfinished import say_if_unfinished
    from keycld.data import clip_file, open_data, read, usual_for
    from keycld.data.generate.make import provide
    from keycld.evaluation import predict_file
    from keycld.training import Counted, data_folder, load_model

    if out.exists() and data.exists() and out.samefile(data):
        raise KeycldError(f"'{out}' is the data itself: give another file for the predictions.")
    if data.is_dir():
        raise KeycldError(f"{data} is a folder: name a file in it, such as {data / 'test.h5'}.")
    model, config = load_model(run)
    say_if_unfinished(run, "predicting with")
    if given is not None and given < model.context:
        raise KeycldError(f"--given is at least {model.context}, the frames that this model needs, not {given}.")
    with tempfile.TemporaryDirectory() as folder:
        file = data
        if data.suffix.lower() not in _HDF5:
            if not data.is_file():
                raise KeycldError(f"there is no file {data}: check the path.")
            size = int(config.scene["height"])
            known = data_folder(run, config.data)
            if not known.is_dir():
                raise KeycldError(
                    f"{data} is no HDF5 file, and the data of {run} in {known}, which say how to cut a video, are "
                    f"missing: give a file of the data set that `keycld data import {data} --out FOLDER` makes."
                )
            learned = open_data(known)
            out_file = Path(folder) / f"{data.stem}.h5"
            file = clip_file(data, out_file, learned.attributes, size, usual=usual_for(learned))
        provide(file)
        number = _frame(first, lambda: read(file, images=False, rows=slice(0, 1)).dt)
        if file is not data:
            frames = read(file, images=False).frames
            last = frames - (given or model.context)
            if last < 0:
                raise KeycldError(
                    f"{data} gives {frames} frames, but {given or model.context} are to be given to the model: choose "
                    "a longer video, or a smaller --given."
                )
            if not 0 <= number <= last:
                raise KeycldError(f"--from {first} is frame {number}, but in {data} 0 to {last} can be given.")
        predict_file(model, file, out, given=given, first=number, progress=Counted("predict"))
    print(f"predictions: {out}")


def _frame(first: str, dt: Callable[[], float]) -> int:
    """Return the number of a frame that is given as a number, or as a time in seconds at the frame interval dt."""
    timed = first.endswith("s")
    # Not below: an error of the file is none of the number.
    interval = dt() if timed else 1.0
    try:
        number = round(float(first[:-1]) / interval) if timed else int(first)
    except (ValueError, OverflowError):
        number = _MOST
    if abs(number) >= _MOST:
        raise KeycldError(f"--from is the number of a frame, or a time such as 12.5s, not '{first}'.")
    return number
