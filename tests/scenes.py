"""Small worlds for tests: a bright disc on a dark plate that moves as a pendulum, drawn without any simulator."""

import dataclasses
from pathlib import Path

import numpy as np

from keycld.data import Trajectories, write

SIZE = 16
DT = 0.05


def disc_pendulum(count: int, frames: int, seed: int, inputs: int = 1) -> Trajectories:
    """Trajectories of a disc that swings at 0.6 around the image centre, pushed by a constant torque."""
    random = np.random.default_rng(seed)
    angle, rate = random.uniform(-3, 3, count), np.zeros(count)
    u = random.uniform(-1, 1, (count, inputs)).astype(np.float32)
    u[::3] = 0
    states = []
    for _ in range(frames):
        states.append(np.stack([angle, rate], -1))
        rate = rate + DT * (-9.0 * np.sin(angle) + 6.0 * u[:, 0])
        angle = angle + DT * rate
    state = np.stack(states, 1)
    return Trajectories(
        image=draw(0.6 * np.sin(state[..., 0]), -0.6 * np.cos(state[..., 0])),
        time=DT * np.arange(frames),
        input=u,
        state=state,
        attributes={
            "schema_version": 1,
            "system": "disc",
            "dt": DT,
            "state_names": ["angle", "rate"],
            "units": ["rad", "rad/s"],
            "seed": seed,
            "generator": "tests",
            "protocol": "tests",
        },
    )


def draw(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A soft disc at (x, y) in image-plane units, uint8 `[..., SIZE, SIZE, 3]`."""
    axis = np.linspace(-1, 1, SIZE)
    distance = np.hypot(axis[None, :] - x[..., None, None], axis[::-1, None] - y[..., None, None])
    shape = 1 / (1 + np.exp(12 * (distance - 0.25)))
    colour = np.array([0.9, 0.6, 0.2])
    return np.round(255 * (0.1 + 0.8 * shape[..., None] * colour)).astype(np.uint8)


def write_data(folder: Path, *, count: int = 6, frames: int = 12) -> Path:
    """A foreign data set: HDF5 files and a constraints.toml beside them."""
    folder.mkdir(parents=True, exist_ok=True)
    for k, split in enumerate(("train", "validation", "test")):
        write(folder / f"{split}.h5", disc_pendulum(count, frames, seed=k))
    (folder / "constraints.toml").write_text(
        'keypoints = ["disc"]\n\n[[constraint]]\nkind = "distance_to_point"\nkeypoint = "disc"\npoint = [0.0, 0.0]\n'
    )
    return folder


TINY = {
    "width": 8,
    "terms": ["viscous"],
    "groups": 2,
    "vision": {"steps": 6, "candidates": 2, "trial": 2, "batch": 4, "worst": 1e9},
    "dynamics": {"steps": 6, "batch": 4, "horizons": [5, 6], "worst": 1e9},
    "joint": {"steps": 6, "horizons": [6, 8], "fit_every": 4},
}
"""Settings of the `fast` preset that train in seconds."""


def without_images(trajectories: Trajectories) -> Trajectories:
    """The same without pictures."""
    return dataclasses.replace(trajectories, image=None)
