"""Keypoint tracks: as CSV, and as time series of `mujoco.sysid`."""

import csv
import dataclasses
import io
import json
from pathlib import Path

import numpy as np
from jaxtyping import Float

from keycld._files import make_folder, replacing, write_text


@dataclasses.dataclass(frozen=True)
class KeypointTracks:
    """Observed keypoints of recordings.

    Attributes:
        names: of the keypoints.
        x: positions `[N, T, K, 2]`, image-plane units.
        u: inputs `[N, T, l]`.
        dt: seconds between frames.
        inputs: names of the inputs.
    """

    names: tuple[str, ...]
    x: Float[np.ndarray, "N T K 2"]
    u: Float[np.ndarray, "N T l"]
    dt: float
    inputs: tuple[str, ...]

    @property
    def time(self) -> Float[np.ndarray, "T"]:
        """Seconds from the first frame."""
        return self.dt * np.arange(self.x.shape[1])


def write_csv(path: Path, tracks: KeypointTracks) -> None:
    """Write one row a frame: recording, time, NAME_x and NAME_y of each keypoint, the inputs."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    keypoints = [f"{name}_{axis}" for name in tracks.names for axis in "xy"]
    writer.writerow(["recording", "time", *keypoints, *tracks.inputs])
    for n, (x, u) in enumerate(zip(tracks.x, tracks.u, strict=True)):
        for time, row, push in zip(tracks.time, x.reshape(len(x), -1), u, strict=True):
            writer.writerow([n, f"{time:.9g}", *(f"{number:.9g}" for number in (*row, *push))])
    write_text(path, text.getvalue())


def write_time_series(folder: Path, tracks: KeypointTracks, metres: float = 1.0) -> list[Path]:
    """Write recordings as files that `mujoco.sysid.TimeSeries.load_from_disk` reads, and return their paths.

    The signals are the position sensors of the exported model, (x, 0, y) in metres, under the names of the keypoints.

    Args:
        folder: where recording_000.npz and so on go.
        tracks: the recordings.
        metres: of one image-plane unit.
    """
    make_folder(folder)
    count, length, keypoints, _ = tracks.x.shape
    # 0 is the number of sensors among the kinds of signals.
    mapping = json.dumps({name: [0, [3 * k, 3 * k + 1, 3 * k + 2]] for k, name in enumerate(tracks.names)})
    paths = []
    for n in range(count):
        data = np.zeros((length, keypoints, 3))
        data[:, :, ::2] = metres * tracks.x[n]
        path = folder / f"recording_{n:03d}.npz"
        with replacing(path) as temporary:
            np.savez(
                temporary,
                allow_pickle=False,
                times=tracks.time,
                data=data.reshape(length, -1),
                signal_mapping=np.asarray(mapping),
            )
        paths.append(path)
    for path in set(folder.glob("recording_*.npz")) - set(paths):
        if path.stem.removeprefix("recording_").isdecimal():
            path.unlink()  # of an earlier export of more recordings
    return paths
