"""Sampled systems that solve an initial value problem: initial state and parameters decide everything."""

import abc
from collections.abc import Mapping
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from keycld._errors import KeycldError
from keycld.systems.rendered import AbstractRenderedSystem, in_lanes
from keycld.systems.sampled import Recording

_MOST_SAMPLES = 1000


class AbstractInitialValueSystem(AbstractRenderedSystem):
    """A system without input; trajectory n samples initial state and parameters from `numpy.random.RandomState(n)`."""

    @abc.abstractmethod
    def initial_state(
        self, random: np.random.RandomState, protocol: str
    ) -> tuple[Float[np.ndarray, "d"], dict[str, np.ndarray]]:
        """Sample an initial state and parameters."""

    @abc.abstractmethod
    def motion(
        self, initial: Float[Array, "d"], parameters: Mapping[str, Array], times: Float[Array, "T"]
    ) -> Float[Array, "T d"]:
        """Compute the states of one trajectory at `times`, the first of which is 0."""

    def accepts(self, state: Float[np.ndarray, "N T d"], parameters: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return which trajectories are kept, bool [N], by default all; the others are sampled again."""
        return np.ones(len(state), bool)

    def group(self, frames: int, size: str, images: bool) -> int:
        """Return as many as are some seconds of work."""
        return max(1, (32_000 if images else 256_000) // frames)

    def record(self, numbers: range, frames: int, protocol: str, size: str) -> Recording:
        """Sample, solve, and sample again those that are not accepted; the parameter `draws` counts the samples."""
        randoms = [np.random.RandomState(number) for number in numbers]
        time = self.dt * np.arange(frames)
        sampled = [self.initial_state(random, protocol) for random in randoms]
        initial = np.stack([state for state, _ in sampled])
        parameters = {name: np.stack([given[name] for _, given in sampled]) for name in sampled[0][1]}
        state = self.move(initial, parameters, time)
        draws = np.ones(len(randoms), int)
        again = np.flatnonzero(~self.accepts(state, parameters))
        while len(again):
            if draws.max() == _MOST_SAMPLES:
                raise KeycldError(
                    f"{self.name} accepts none of {_MOST_SAMPLES} samples: correct `initial_state` or `accepts`."
                )
            for i in again:
                initial[i], given = self.initial_state(randoms[i], protocol)
                for name, value in given.items():
                    parameters[name][i] = value
            resampled = {name: value[again] for name, value in parameters.items()}
            state[again] = self.move(initial[again], resampled, time)
            draws[again] += 1
            again = again[~self.accepts(state[again], resampled)]
        return Recording(time, state, {"seed": np.array(numbers), "draws": draws, **parameters})

    def move(
        self, initial: Float[np.ndarray, "N d"], parameters: Mapping[str, np.ndarray], time: Float[np.ndarray, "T"]
    ) -> Float[np.ndarray, "N T d"]:
        """Compute the motion from many initial states, in float64."""
        with jax.enable_x64(True):
            return in_lanes(partial(_move, self.motion, jnp.asarray(time)), initial, dict(parameters))


@partial(jax.jit, static_argnums=0)
def _move(motion, time, initial, parameters):
    return jax.vmap(motion, (0, 0, None))(initial, parameters, time)
