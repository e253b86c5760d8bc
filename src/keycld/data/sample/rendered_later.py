"""Pictures that are rendered on the device, for the clips of a step, from what a state shows.

A state goes into the renderer and nowhere else.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt8

from keycld.data.format.derived import refuse_if_large
from keycld.systems import to_bytes


class RenderedLater(eqx.Module):
    """Takes the place of pictures uint8 `[N, T, H, W, 3]` and renders those that are indexed.

    `later[rows, columns]`, `later[i]` and `later.shape` mean what they mean for an array; indices may be traced.
    It holds what a picture shows (positions of discs, radii, colours), not the state.

    Attributes:
        visible: what each picture shows, from `AbstractRenderedSystem.visible`.
        parameters: of each trajectory.
        render: the renderer of the system.
        size: pixels of a side.
    """

    visible: Float[Array, "N T m"]
    parameters: dict[str, Array]
    render: Callable = eqx.field(static=True)
    size: int = eqx.field(static=True)

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of the pictures, (N, T, H, W, 3)."""
        return (*self.visible.shape[:2], self.size, self.size, 3)

    def __len__(self) -> int:
        """Count the trajectories, N."""
        return len(self.visible)

    def __getitem__(self, index: Any) -> UInt8[Array, "*batch H W 3"]:
        """Render a trajectory `[i]`, or the frames `[rows, columns]`, integers that broadcast against each other."""
        rows, columns = index if isinstance(index, tuple) else (index, jnp.arange(self.visible.shape[1]))
        rows, columns = jnp.broadcast_arrays(jnp.asarray(rows), jnp.asarray(columns))
        return _render(self.render, self.visible, self.parameters, rows, columns)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        """Render all pictures, for `numpy.asarray`.

        Raises:
            KeycldError: they would take too much memory.
        """
        refuse_if_large(self.shape)
        image = np.stack([np.asarray(self[i]) for i in range(len(self))])
        return image if dtype is None else image.astype(dtype)


@partial(jax.jit, static_argnums=0)
def _render(render, visible, parameters, rows, columns):
    for _ in range(rows.ndim):
        render = jax.vmap(render)
    return to_bytes(render(visible[rows, columns], {name: value[rows] for name, value in parameters.items()}))
