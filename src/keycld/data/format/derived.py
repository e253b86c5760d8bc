"""Pictures drawn from stored states: on reading, or on the device for the clips that a step asks for.

A state goes into the renderer and nowhere else.
"""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt8

from keycld._errors import KeycldError
from keycld.data.store import Trajectories
from keycld.systems import (
    AbstractDrawnSystem,
    AbstractSystem,
    Recording,
    get,
    in_single_precision,
    names,
    numbers_only,
    to_bytes,
)

# Whole files are drawn up to this size: 7,600 recordings of 256 frames at 32 × 32.
_MOST_BYTES = 6e9


class DrawnLater(eqx.Module):
    """Stands where pictures uint8 `[N, T, H, W, 3]` would, and draws those that are asked for.

    `drawn[rows, columns]`, `drawn[i]` and `drawn.shape` mean what they mean for an array; indices may be traced.
    It holds what a picture shows (places of discs, radii, colours), not the state.

    - `seen`: of each frame, as `AbstractDrawnSystem.seen` gives it.
    - `parameters`: of each trajectory.
    - `draw`: the system's own.
    - `size`: pixels of a side.
    """

    seen: Float[Array, "N T m"]
    parameters: dict[str, Array]
    draw: Callable = eqx.field(static=True)
    size: int = eqx.field(static=True)

    @property
    def shape(self) -> tuple[int, ...]:
        """That of the pictures, (N, T, H, W, 3)."""
        return (*self.seen.shape[:2], self.size, self.size, 3)

    def __len__(self) -> int:
        """N."""
        return len(self.seen)

    def __getitem__(self, index: Any) -> UInt8[Array, "*batch H W 3"]:
        """Pictures of a trajectory `[i]`, or of `[rows, columns]`, integers that broadcast against each other."""
        rows, columns = index if isinstance(index, tuple) else (index, jnp.arange(self.seen.shape[1]))
        rows, columns = jnp.broadcast_arrays(jnp.asarray(rows), jnp.asarray(columns))
        return _draw(self.draw, self.seen, self.parameters, rows, columns)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        """All pictures, for `numpy.asarray`.

        Raises:
            KeycldError: they would take too much memory.
        """
        _refuse_if_large(self.shape)
        image = np.stack([np.asarray(self[i]) for i in range(len(self))])
        return image if dtype is None else image.astype(dtype)


@partial(jax.jit, static_argnums=0)
def _draw(draw, seen, parameters, rows, columns):
    for _ in range(rows.ndim):
        draw = jax.vmap(draw)
    return to_bytes(draw(seen[rows, columns], {name: value[rows] for name, value in parameters.items()}))


def _refuse_if_large(shape: tuple[int, ...]) -> None:
    size = np.prod(shape, dtype=float)
    if size > _MOST_BYTES:
        raise KeycldError(
            f"the pictures of {shape[0]} recordings of {shape[1]} frames take {size / 1e9:.0f} GB: read fewer of them "
            "(rows=slice(0, 1000)), or sample clips from open_data(...).resident()."
        )


def known(trajectories: Trajectories) -> AbstractSystem | None:
    """The system of these trajectories, or None where it is none of ours."""
    name = trajectories.attributes["system"]
    return get(name) if name in names() else None


def renderer_of(trajectories: Trajectories) -> AbstractDrawnSystem | None:
    """The system that draws these states, or None where none of ours does.

    Raises:
        KeycldError: they are for another version of the renderer.
    """
    about, system = trajectories.attributes, known(trajectories)
    if not isinstance(system, AbstractDrawnSystem) or trajectories.state is None:
        return None
    if about.get("renderer") != system.renderer:
        return None
    if about.get("renderer_version") != system.renderer_version:
        raise KeycldError(
            f"these {about['system']} data are to be drawn by version {about.get('renderer_version')} of "
            f"'{system.renderer}', but this keycld has version {system.renderer_version}: make the data again."
        )
    return system


def with_pictures(trajectories: Trajectories) -> Trajectories:
    """The same trajectories with their pictures, drawn where only states are stored and the renderer is known.

    Raises:
        KeycldError: the pictures would take too much memory, or are for another version of the renderer.
    """
    if trajectories.image is not None:
        return trajectories
    system = renderer_of(trajectories)
    if system is None:
        return trajectories
    assert trajectories.state is not None
    _refuse_if_large((*trajectories.state.shape[:2], system.size, system.size, 3))
    parameters = numbers_only(trajectories.parameters)
    pictures = system.pictures(Recording(trajectories.time, trajectories.state, parameters))
    return dataclasses.replace(trajectories, image=pictures.image)


def with_derivative(trajectories: Trajectories) -> Trajectories:
    """The same trajectories with `state_derivative`, computed where it is not stored and the system is known.

    For evaluation only, as the state. All forces are in it, friction too.

    Raises:
        KeycldError: nothing of ours computes it.
    """
    if trajectories.state_derivative is not None:
        return trajectories
    system = known(trajectories)
    if not isinstance(system, AbstractDrawnSystem) or trajectories.state is None:
        raise KeycldError(f"no derivative of the state of '{trajectories.attributes['system']}' is known.")
    derivative = system.derivatives(trajectories.state, numbers_only(trajectories.parameters))
    return dataclasses.replace(trajectories, state_derivative=derivative)


def drawn_later(trajectories: Trajectories) -> DrawnLater | None:
    """What draws the pictures of these states on the device, or None where none of our renderers does."""
    system = renderer_of(trajectories)
    if system is None:
        return None
    parameters = trajectories.parameters
    seen = system.all_seen(np.asarray(trajectories.state), parameters)
    constants = {name: jnp.asarray(value) for name, value in in_single_precision(parameters).items()}
    return DrawnLater(jnp.asarray(seen), constants, system.draw, system.size)
