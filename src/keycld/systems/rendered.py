"""Systems whose pictures may be rendered from the state at any time, and what computes them for many states."""

import abc
import math
from collections.abc import Mapping
from functools import partial
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt8

from keycld.systems.pictures import Pictures
from keycld.systems.sampled import AbstractSampledSystem, Recording, in_single_precision, numbers_only

_LANES = 1024


class AbstractRenderedSystem(AbstractSampledSystem):
    """A system whose picture is a pure JAX function of state and parameters, and whose state has a derivative.

    `visible`, `render` and `derivative` act on one state; parameters are those of one trajectory, without `N`.

    Attributes:
        renderer: name of what renders its pictures.
        renderer_version: changes when the same state would give another picture.
    """

    renderer: ClassVar[str]
    renderer_version: ClassVar[int]

    @abc.abstractmethod
    def visible(self, state: Float[Array, "d"], parameters: Mapping[str, Array]) -> Float[Array, "m"]:
        """Return what a picture shows of the state, for example the centres of discs; m ≤ d."""

    @abc.abstractmethod
    def render(self, visible: Float[Array, "m"], parameters: Mapping[str, Array]) -> Float[Array, "size size 3"]:
        """Render what is visible, values in [0, 1]."""

    @abc.abstractmethod
    def derivative(self, state: Float[Array, "d"], parameters: Mapping[str, Array]) -> Float[Array, "d"]:
        """Return the derivative of the state in time, all forces included."""

    @abc.abstractmethod
    def conserved(self, state: Float[Array, "d"], parameters: Mapping[str, Array]) -> Float[Array, ""]:
        """Return what would stay constant along a trajectory without friction, for example the energy."""

    def picture(self, state: Float[Array, "d"], parameters: Mapping[str, Array]) -> Float[Array, "size size 3"]:
        """Render a state."""
        return self.render(self.visible(state, parameters), parameters)

    def pictures(self, recording: Recording) -> Pictures:
        """Render a recording: what is visible is computed in float64, its pictures in float32."""
        visible = self.all_visible(recording.state, recording.parameters)
        constants = in_single_precision(recording.parameters)
        image = np.empty((*visible.shape[:2], self.size, self.size, 3), np.uint8)
        for i in range(len(visible)):
            image[i] = _render_frames(self.render, visible[i], {name: value[i] for name, value in constants.items()})
        return Pictures(image, self.renderer)

    def all_visible(
        self, state: Float[np.ndarray, "N T d"], parameters: Mapping[str, np.ndarray]
    ) -> Float[np.ndarray, "N T m"]:
        """Return `visible` of all states, computed in float64, as float32."""
        return map_states(self.visible, state, parameters).astype(np.float32)

    def derivatives(
        self, state: Float[np.ndarray, "N T d"], parameters: Mapping[str, np.ndarray]
    ) -> Float[np.ndarray, "N T d"]:
        """Return `derivative` of all states, in float64."""
        return map_states(self.derivative, state, parameters)

    def all_conserved(
        self, state: Float[np.ndarray, "N T d"], parameters: Mapping[str, np.ndarray]
    ) -> Float[np.ndarray, "N T"]:
        """Return `conserved` of all states, in float64."""
        return map_states(self.conserved, state, parameters)


def to_bytes(picture: Float[Array, "*any"]) -> UInt8[Array, "*any"]:
    """Return the grey levels 0 to 255 of values in [0, 1], cut off and not rounded, as the suite stores them."""
    return (255.0 * picture).astype(jnp.uint8)


@partial(jax.jit, static_argnums=0)
def _render_frames(render, visible, parameters):
    return jax.vmap(lambda one: to_bytes(render(one, parameters)))(visible)


@partial(jax.jit, static_argnums=0)
def _map_states(function, state, parameters):
    return jax.vmap(jax.vmap(function, (0, None)))(state, parameters)


def map_states(
    function: Any, state: Float[np.ndarray, "N T d"], parameters: Mapping[str, np.ndarray]
) -> Float[np.ndarray, "N T *m"]:
    """Apply a function of one state and the parameters of its trajectory to all, in float64."""
    with jax.enable_x64(True):
        return in_lanes(partial(_map_states, function), state, numbers_only(parameters))


def in_lanes(function: Any, *arrays: Any, lanes: int = _LANES) -> np.ndarray:
    """Apply `function` to arrays with a common first axis, `lanes` rows at a time, the last ones filled up.

    So one compiled program serves every number of rows up to a power of two.
    """
    rows = len(jax.tree.leaves(arrays)[0])
    lanes = min(lanes, 2 ** math.ceil(math.log2(max(rows, 1))))
    done = []
    for first in range(0, rows, lanes):
        block = jax.tree.map(lambda array, first=first: _filled(array[first : first + lanes], lanes), arrays)
        done.append(np.asarray(function(*block))[: rows - first])
    return np.concatenate(done)


def _filled(block: np.ndarray, lanes: int) -> np.ndarray:
    missing = lanes - len(block)
    return np.concatenate([block, np.repeat(block[-1:], missing, axis=0)]) if missing else block
