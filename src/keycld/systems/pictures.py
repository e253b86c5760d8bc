"""Pictures of states, from any process."""

import atexit
from contextlib import AbstractContextManager
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from keycld.systems.base import Drawer
from keycld.systems.processes import Task, run_in_processes

_OPEN: dict[type, Drawer] = {}


@runtime_checkable
class Drawable(Protocol):
    """A system that brings its own renderer."""

    def drawer(self) -> AbstractContextManager[Drawer]:
        """Draws its states."""
        ...


class Pictures(NamedTuple):
    """Pictures `image` uint8 `[n, size, size, 3]`, and the `renderer` that drew them."""

    image: np.ndarray
    renderer: str


def draw_in_worker(system: Drawable, states: np.ndarray) -> Pictures:
    """Pictures of `states [n, d]`; for worker processes, which keep the renderer and draw one system only.

    Making a renderer takes a third of a second, and those of several models in one process gave corrupted
    pictures.
    """
    if type(system) not in _OPEN:
        if _OPEN:
            raise RuntimeError(f"this process draws {next(iter(_OPEN))} and cannot draw {type(system)} as well")
        drawer = system.drawer()
        _OPEN[type(system)] = drawer.__enter__()
        atexit.register(drawer.__exit__, None, None, None)
    drawer = _OPEN[type(system)]
    return Pictures(np.stack([drawer.draw(state) for state in states]), drawer.description)


def draw(system: Drawable, states: np.ndarray) -> Pictures:
    """Pictures of `states [n, d]`, drawn in a process of its own.

    Raises:
        KeycldError: no GL context can be made.
    """
    [(_, pictures)] = run_in_processes([Task(draw_in_worker, (system, states))])
    return pictures


def renderer_name() -> str:
    """The GL renderer that MuJoCo's pictures come from, for example `"llvmpipe (LLVM 15.0.6, 256 bits)"`.

    Raises:
        KeycldError: MuJoCo is missing, or no GL context can be made.
    """
    from keycld.systems.mujoco.pendulum import Pendulum

    return draw(Pendulum(), np.zeros((1, 2))).renderer
