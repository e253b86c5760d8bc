"""`keycld watch SOURCE --live RUN`: a camera's picture with keypoints and where they will be."""

import math
import time
from collections import deque
from pathlib import Path

import numpy as np

from keycld._errors import KeycldError


def live(source: Path, run: Path, *, seconds: float, given: int, port: int) -> None:
    """Show a camera, or a video played as one, with the keypoints and their predicted paths on a page of this machine.

    Args:
        source: a video, or a camera such as /dev/video0, in the place of the clips that the run has learned.
        run: run folder of `keycld watch`.
        seconds: how far to predict.
        given: frames to predict from.
        port: of the page.

    Raises:
        KeycldError: as `camera_frames`, `Ahead` and `live_page`; the run is not of keypoints, seconds are none.
    """
    from keycld.data import camera_frames, open_data, usual_for
    from keycld.drawing import overlay_future
    from keycld.evaluation import Ahead
    from keycld.models.keycld.model import AbstractKeypointModel
    from keycld.reports import live_page
    from keycld.training import data_folder, load_model

    model, config = load_model(run)
    if not isinstance(model, AbstractKeypointModel):
        raise KeycldError(f"{run} is not a model with keypoints: give the run folder of a keycld watch.")
    data = open_data(data_folder(run, config.data))
    steps = round(seconds / data.dt) if math.isfinite(seconds) else 0
    if not 1 <= steps <= 1000:
        raise KeycldError(f"--ahead is a time of 1 to 1000 frames of {data.dt:.4g} s, not {seconds} s.")
    if not model.context <= given <= 1000:
        raise KeycldError(f"--given is a number of frames from {model.context} to 1000, not {given}.")
    ahead = Ahead(model, data.dt, steps, given)
    count, shown, late, began = 0, 0, deque[float](maxlen=1000), time.monotonic()
    told = began
    with live_page(port) as page:
        print(f"open {page.address} in a browser; Ctrl-C ends it", flush=True)
        usual = usual_for(data)
        for seen in camera_frames(source, data.attributes, int(config.scene["height"]), usual=usual):
            came = time.monotonic()
            began = began if count else came
            keypoints, coming = ahead.see(np.stack([each.frame for each in seen]))
            nothing = keypoints[None][:0]
            page.show(overlay_future(seen[-1].view, keypoints, nothing if coming is None else coming))
            count, shown = count + len(seen), shown + 1
            now = time.monotonic()
            late.append(now - came)
            if now - told > 5:
                told = now
                print(_state(count, shown, now - began, late, ahead.errors, seconds), flush=True)
    print(_state(count, shown, time.monotonic() - began, late, ahead.errors, seconds))


def _state(count: int, shown: int, took: float, late: deque[float], errors: deque[float], seconds: float) -> str:
    """Return how fast and how right it is."""
    text = f"{count} frames, {shown} shown, {count / max(took, 1e-9):.1f} a second, {1e3 * np.median(late):.0f} ms each"
    if errors:
        text += f"; predictions {seconds:g} s ahead were off by {100 * np.mean(errors) / 2:.1f} % of the picture's side"
    return text
