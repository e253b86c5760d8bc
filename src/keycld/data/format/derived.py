"""Pictures and derivatives that a file does not store, computed from the states it stores."""

import dataclasses
from pathlib import Path

import numpy as np

from keycld._errors import KeycldError
from keycld.data.format.hdf5 import open_file
from keycld.data.format.reading import read, recordings
from keycld.data.format.rules import EVERY
from keycld.data.format.trajectories import Trajectories
from keycld.systems import AbstractRenderedSystem, AbstractSystem, Recording, get, names, numbers_only

# The most that pictures may take in memory: 7,600 recordings of 256 frames at 32 × 32.
MOST_BYTES = 6e9


def refuse_if_large(shape: tuple[int, ...]) -> None:
    """Refuse pictures `shape` [N, T, H, W, 3] that would take too much memory.

    Raises:
        KeycldError: they take more than `MOST_BYTES`.
    """
    size = np.prod(shape, dtype=float)
    if size > MOST_BYTES:
        raise KeycldError(
            f"the pictures of {shape[0]} recordings of {shape[1]} frames take {size / 1e9:.0f} GB: read fewer of them "
            "(rows=slice(0, 1000)), or block by block with open_data(...).blocks(...)."
        )


def known(trajectories: Trajectories) -> AbstractSystem | None:
    """Find the system of these trajectories; None if it is not registered."""
    name = trajectories.attributes["system"]
    return get(name) if name in names() else None


def renderer_of(trajectories: Trajectories) -> AbstractRenderedSystem | None:
    """Find the system that renders these states; None if no registered system does.

    Raises:
        KeycldError: they are for another version of the renderer, or not what it renders.
    """
    about, system = trajectories.attributes, known(trajectories)
    if not isinstance(system, AbstractRenderedSystem) or trajectories.state is None:
        return None
    if about.get("renderer") != system.renderer:
        return None
    if about.get("renderer_version") != system.renderer_version:
        raise KeycldError(
            f"these {about['system']} data are to be rendered by version {about.get('renderer_version')} of "
            f"'{system.renderer}', but this keycld has version {system.renderer_version}: make the data again."
        )
    _refuse_other_fields(system, trajectories)
    return system


def _refuse_other_fields(system: AbstractRenderedSystem, trajectories: Trajectories) -> None:
    """Refuse a state or parameters of which the system makes no picture or derivative; only shapes are computed."""
    import jax  # only here: commands that make or check other data do not wait for it

    assert trajectories.state is not None
    if len(trajectories.state) == 0:
        return
    state = trajectories.state[0, 0]
    parameters = {name: value[0] for name, value in numbers_only(trajectories.parameters).items()}
    try:
        picture = jax.eval_shape(system.picture, state, parameters).shape
        derivative = jax.eval_shape(system.derivative, state, parameters).shape
        fits = picture == (system.size, system.size, 3) and derivative == state.shape
    except (KeyError, IndexError, TypeError, ValueError):
        fits = False
    if not fits:
        raise KeycldError(
            f"the states or the parameters of these {system.name} data are not those from which their pictures are "
            f"rendered (states of {state.shape[0]} numbers; parameters {', '.join(sorted(parameters)) or 'none'}): "
            "make the data again."
        )


def with_pictures(trajectories: Trajectories) -> Trajectories:
    """Add the pictures, rendered from the states, where they are not stored and the renderer is known.

    Raises:
        KeycldError: the pictures would take too much memory, or are for another version of the renderer.
    """
    if trajectories.image is not None:
        return trajectories
    system = renderer_of(trajectories)
    if system is None:
        return trajectories
    assert trajectories.state is not None
    refuse_if_large((*trajectories.state.shape[:2], system.size, system.size, 3))
    parameters = numbers_only(trajectories.parameters)
    pictures = system.pictures(Recording(trajectories.time, trajectories.state, parameters))
    return dataclasses.replace(trajectories, image=pictures.image)


def with_derivative(trajectories: Trajectories) -> Trajectories:
    """Add `state_derivative`, computed from the states, where it is not stored.

    For evaluation only, as the state. It includes all forces, also friction.

    Raises:
        KeycldError: the system is not registered, or has no formula for it.
    """
    if trajectories.state_derivative is not None:
        return trajectories
    system = known(trajectories)
    if not isinstance(system, AbstractRenderedSystem) or trajectories.state is None:
        raise KeycldError(f"no derivative of the state of '{trajectories.attributes['system']}' is known.")
    derivative = system.derivatives(trajectories.state, numbers_only(trajectories.parameters))
    return dataclasses.replace(trajectories, state_derivative=derivative)


def picture_shape(path: Path, rows: slice = EVERY) -> tuple[int, ...] | None:
    """Tell the shape [N, T, H, W, 3] of the pictures of a file, stored or rendered; None if it has none."""
    count = len(range(recordings(path))[rows])
    with open_file(path) as file:
        if "image" in file:
            return (count, *file["image"].shape[1:])
    first = read(path, images=False, rows=slice(0, 1))
    system = renderer_of(first)
    return None if system is None else (count, first.frames, system.size, system.size, 3)
