"""A small, valid set of trajectories, for tests to write and to spoil."""

import numpy as np

from keycld.data import Trajectories


def sample(trajectories: int = 3, frames: int = 5, size: int = 8, *, varying_input: bool = False) -> Trajectories:
    random = np.random.RandomState(0)
    inputs = (trajectories, frames, 2) if varying_input else (trajectories, 2)
    return Trajectories(
        time=0.1 * np.arange(1, frames + 1),
        input=random.randn(*inputs).astype(np.float32),
        image=random.randint(0, 256, (trajectories, frames, size, size, 3)).astype(np.uint8),
        state=random.randn(trajectories, frames, 4),
        state_derivative=random.randn(trajectories, frames, 4),
        parameters={
            "seed": np.arange(trajectories),
            "colour": np.array(["red", "grün", "blue"] * trajectories)[:trajectories],
        },
        attributes={
            "system": "pendulum",
            "dt": 0.1,
            "state_names": ("a", "b", "c", "d"),
            "units": ("rad", "m", "rad/s", "m/s"),
            "seed": 7,
            "generator": "test",
            "protocol": "none",
        },
    )


def assert_equal(one: Trajectories, other: Trajectories) -> None:
    for name in ("time", "input", "image", "state", "state_derivative"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    assert set(one.parameters) == set(other.parameters)
    for name, value in one.parameters.items():
        np.testing.assert_array_equal(value, other.parameters[name], err_msg=name)
