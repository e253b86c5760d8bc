"""Systems whose trajectories follow from a number, and whose pictures may be rendered from the state at any time."""

import abc
import math
from collections.abc import Mapping
from functools import partial
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt8

from keycld.systems.base import AbstractSystem
from keycld.systems.pictures import Pictures

# The protocols of "Which priors matter?": the released configurations, and the text of the paper where it differs.
RELEASED, PAPER = "priors-released", "priors-paper"
# Trajectories of each file, the same for both sizes of a set: as published, and with a long test of our own.
_TRAIN_AND_TEST = {"train": 50_000, "test": 20_000}
PUBLISHED_COUNTS = {size: _TRAIN_AND_TEST for size in ("default", "full")}
COUNTS_WITH_LONG = {size: {**_TRAIN_AND_TEST, "test_long": 200} for size in ("default", "full")}
_LANES = 1024


class Recording(NamedTuple):
    """N trajectories of T frames, without their pictures; arrays are float64 unless they count something.

    Attributes:
        time: [T], seconds; 0 at the first frame, which shows the initial state.
        state: [N, T, d].
        parameters: arrays [N, ...], constant along a trajectory.
    """

    time: np.ndarray
    state: np.ndarray
    parameters: dict[str, np.ndarray]


class AbstractSampledSystem(AbstractSystem):
    """A system whose trajectories follow from their numbers, without input.

    Attributes:
        protocols: the ways to sample trajectories that it knows, the default first. `"priors-released"`: the
            released configurations; `"priors-paper"`: the text of the paper where the two differ.
        counts: trajectories of each file by size: `{"default": {"train": ..., "test": ...}, "full": ...}`; "train"
            counts those of validation too.
    """

    size: ClassVar[int] = 32
    protocols: ClassVar[tuple[str, ...]]
    counts: ClassVar[Mapping[str, Mapping[str, int]]]

    @abc.abstractmethod
    def record(self, numbers: range, frames: int, protocol: str, size: str) -> Recording:
        """Compute the trajectories of these numbers; each depends on its number, the protocol and the size only."""

    @abc.abstractmethod
    def group(self, frames: int, size: str, images: bool) -> int:
        """Return how many consecutive numbers are best recorded at once, with their pictures or without."""

    def related(self, size: str) -> int:
        """Return how many consecutive numbers, counted from a multiple, are parts of one simulation.

        Such trajectories are correlated, so they never lie in two files; 1 where all are independent.
        """
        return 1

    @abc.abstractmethod
    def pictures(self, recording: Recording) -> Pictures:
        """Render a recording: `image` uint8 `[N, T, size, size, 3]`."""


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


def numbers_only(parameters: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the parameters without texts."""
    return {name: value for name, value in parameters.items() if value.dtype.kind in "fiu"}


def in_single_precision(parameters: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the parameters without texts, with 32 bits a number."""
    kinds: dict[str, Any] = {"f": np.float32, "i": np.int32, "u": np.int32}
    return {name: value.astype(kinds[value.dtype.kind]) for name, value in numbers_only(parameters).items()}


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
