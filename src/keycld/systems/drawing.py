"""Pictures of states, from any process."""

from collections.abc import Sequence

import numpy as np

from keycld.systems.base import AbstractSystem
from keycld.systems.processes import run_in_processes


def draw_here(system: AbstractSystem, states: np.ndarray) -> tuple[np.ndarray, str]:
    """Pictures uint8 `[n, size, size, 3]` of `states [n, d]`, and what drew them, in this very process."""
    with system.drawer() as drawer:
        return np.stack([drawer.draw(state) for state in states]), drawer.description


def draw(system: AbstractSystem, states: np.ndarray) -> np.ndarray:
    """Pictures uint8 `[n, size, size, 3]` of `states [n, d]`, drawn in a process of its own.

    **Raises:** `KeycldError` where no GL context can be made.
    """
    [(_, (frames, _))] = run_in_processes(draw_here, [(system, states)])
    return frames


def renderer_name() -> str:
    """The GL renderer that MuJoCo's pictures come from, for example `"llvmpipe (LLVM 15.0.6, 256 bits)"`.

    **Raises:** `KeycldError` where MuJoCo is missing or no GL context can be made.
    """
    from keycld.systems.registry import get

    system = get("pendulum")
    [(_, (_, description))] = run_in_processes(draw_here, [(system, np.zeros((1, len(system.state_names))))])
    return description
