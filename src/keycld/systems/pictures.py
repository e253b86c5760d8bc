"""Pictures of states, from any process."""

import atexit
from contextlib import AbstractContextManager
from typing import NamedTuple, Protocol, runtime_checkable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt8

from keycld.systems.base import Drawer
from keycld.systems.processes import Task, run_in_processes

_OPEN: dict[type, Drawer] = {}


@runtime_checkable
class Drawable(Protocol):
    """A system that brings its own renderer."""

    def drawer(self) -> AbstractContextManager[Drawer]:
        """Return a context in which this process renders the system's states."""
        ...


class Pictures(NamedTuple):
    """Pictures `image` uint8 `[n, size, size, 3]`, and the name of the `renderer` that made them."""

    image: np.ndarray
    renderer: str


def draw_in_worker(system: Drawable, states: np.ndarray) -> Pictures:
    """Render `states [n, d]`; for worker processes, which keep the renderer and serve one system only.

    Making a renderer takes a third of a second, and those of several models in one process gave corrupted
    pictures.
    """
    if type(system) not in _OPEN:
        if _OPEN:
            raise RuntimeError(f"this process renders {next(iter(_OPEN))} and cannot render {type(system)} as well")
        drawer = system.drawer()
        _OPEN[type(system)] = drawer.__enter__()
        atexit.register(drawer.__exit__, None, None, None)
    drawer = _OPEN[type(system)]
    return Pictures(np.stack([drawer.draw(state) for state in states]), drawer.description)


def draw(system: Drawable, states: np.ndarray) -> Pictures:
    """Render `states [n, d]` in a process of its own.

    Raises:
        KeycldError: no OpenGL context can be made.
    """
    [(_, pictures)] = run_in_processes([Task(draw_in_worker, (system, states))])
    return pictures


def to_bytes(picture: Float[Array, "*any"]) -> UInt8[Array, "*any"]:
    """Return the grey levels 0 to 255 of values in [0, 1], cut off and not rounded, as the suite stores them."""
    return (255.0 * picture).astype(jnp.uint8)
