"""Pictures of states, from any process."""

import atexit
from contextlib import AbstractContextManager
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from keycld.systems.base import StateRenderer
from keycld.systems.processes import Task, run_in_processes

_OPEN: dict[type, StateRenderer] = {}


@runtime_checkable
class Renderable(Protocol):
    """A system that brings its own renderer."""

    def open_renderer(self) -> AbstractContextManager[StateRenderer]:
        """Return a context in which this process renders the system's states."""
        ...


class Pictures(NamedTuple):
    """Pictures `image` uint8 `[n, size, size, 3]`, and the name of the `renderer` that made them."""

    image: np.ndarray
    renderer: str


def render_in_worker(system: Renderable, states: np.ndarray) -> Pictures:
    """Render `states [n, d]`; for worker processes, which keep the renderer and serve one system only.

    Making a renderer takes a third of a second, and those of several models in one process gave corrupted
    pictures.
    """
    if type(system) not in _OPEN:
        if _OPEN:
            raise RuntimeError(f"this process renders {next(iter(_OPEN))} and cannot render {type(system)} as well")
        renderer = system.open_renderer()
        _OPEN[type(system)] = renderer.__enter__()
        atexit.register(renderer.__exit__, None, None, None)
    renderer = _OPEN[type(system)]
    return Pictures(np.stack([renderer.render(state) for state in states]), renderer.description)


def render(system: Renderable, states: np.ndarray) -> Pictures:
    """Render `states [n, d]` in a process of its own.

    Raises:
        KeycldError: no OpenGL context can be made.
    """
    [(_, pictures)] = run_in_processes([Task(render_in_worker, (system, states))])
    return pictures
