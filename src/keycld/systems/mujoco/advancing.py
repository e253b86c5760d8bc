"""Several copies of a system, one frame further."""

from typing import NamedTuple

import numpy as np

from keycld.systems.mujoco.base import AbstractMujocoSystem
from keycld.systems.pictures import render_in_worker


class Advanced(NamedTuple):
    """States `[n, d]` and their pictures, uint8 `[n, H, W, 3]`."""

    state: np.ndarray
    frames: np.ndarray


def advance_in_worker(system: AbstractMujocoSystem, states: np.ndarray, inputs: np.ndarray) -> Advanced:
    """Return states `[n, d]` one frame later under `inputs [n, l]`, with their pictures; for worker processes."""
    after = advance(system, states, inputs)
    return Advanced(after, render_in_worker(system, after).image)


def advance(system: AbstractMujocoSystem, states: np.ndarray, inputs: np.ndarray) -> np.ndarray:
    """Return states `[n, d]` one frame later under `inputs [n, l]`, without pictures."""
    pairs = zip(states, inputs, strict=True)
    return np.stack([system.simulate(state, u, 1, clip=False).state[-1] for state, u in pairs])
