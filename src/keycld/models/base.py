"""What every model offers, so that any model runs on any data set and is scored by any protocol."""

from abc import abstractmethod
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from keycld._errors import KeycldError
from keycld.mechanics import State
from keycld.vision import Observation


class Prediction(NamedTuple):
    """Frames 0 … T−1 of a trajectory and the states that they were drawn from, stacked along time."""

    frames: Float[Array, "T H W 3"]
    states: State


class AbstractModel(eqx.Module):
    """Images → state → later states → images, for **one** trajectory; `jax.vmap` makes batches."""

    @property
    @abstractmethod
    def context(self) -> int:
        """The least number of consecutive frames that `infer` needs."""

    @property
    @abstractmethod
    def reversible(self) -> bool:
        """Whether `rollout` accepts a negative `dt`."""

    @abstractmethod
    def anchor(self, n: int) -> int:
        """The index of the frame that the state inferred from `n` frames belongs to."""

    @abstractmethod
    def infer(self, frames: Float[Array, "n H W 3"], dt: Float[Array, ""], u: Float[Array, "..."]) -> State:
        """The state at frame `anchor(n)` from `n` consecutive frames in [0, 1] and the inputs meanwhile."""

    @abstractmethod
    def rollout(self, state: State, dt: Float[Array, ""], u: Float[Array, "..."], steps: int) -> State:
        """The given state and the `steps` that follow it, stacked.

        `u` is `[l]`, constant, or `[steps, l]`; with negative `dt` the motion runs backward and the inputs,
        still given in the order of time, are read in reverse.
        """

    @abstractmethod
    def render(self, state: State) -> Float[Array, "H W 3"]:
        """The picture of a state."""

    @abstractmethod
    def observe(self, frame: Float[Array, "H W 3"]) -> Observation | None:
        """The keypoints seen in one frame; None for a model without keypoints."""

    @abstractmethod
    def keypoints(self, state: State) -> Float[Array, "K 2"] | None:
        """The keypoints of a state in image-plane units; None for a model without keypoints."""

    def predict(
        self, frames: Float[Array, "n H W 3"], dt: Float[Array, ""], u: Float[Array, "..."], length: int
    ) -> Prediction:
        """Frames 0 … `length` − 1 from the given ones and the inputs alone.

        The state inferred at the anchor is rolled out to the end and, for the frames before the anchor, back
        to the start; the given frames are reconstructed too.

        **Arguments:**

        - `frames`: the first `n ≥ context` frames.
        - `dt`: seconds between frames.
        - `u`: `[l]`, constant, or `[length, l]`, of which `u[k]` is held from frame k to k + 1.
        - `length`: how many frames to return.

        **Raises:** KeycldError for fewer frames than `context` and for a given frame that holds something not finite
        (outside of `jit`, where values can be read).
        """
        if frames.ndim != 4 or frames.shape[0] < self.context:
            raise KeycldError(
                f"a prediction starts from {self.context} frames or more, [n, H, W, 3], not from {list(frames.shape)}."
            )
        if not isinstance(frames, Tracer):
            # In NumPy: values known to the caller stay values inside of `jit` too.
            bad = np.flatnonzero(~np.isfinite(np.asarray(frames)).all(axis=(1, 2, 3)))
            if bad.size:
                raise KeycldError(f"given frame {bad[0]} holds NaN or infinity; give finite values in [0, 1].")
        states = self.unroll(self.infer(frames, dt, u), self.anchor(frames.shape[0]), dt, u, length)
        return Prediction(jax.vmap(self.render)(states), states)

    def unroll(self, state: State, anchor: int, dt: Float[Array, ""], u: Float[Array, "..."], length: int) -> State:
        """The states of frames 0 … `length` − 1, stacked, from the one at frame `anchor`.

        `u` is `[l]`, constant, or `[≥ length − 1, l]` from frame 0 on.
        """
        constant = u.ndim == 1
        states = self.rollout(state, dt, u if constant else u[anchor : length - 1], length - 1 - anchor)
        if anchor > 0:
            back = self.rollout(state, -dt, u if constant else u[:anchor], anchor)
            states = jax.tree.map(lambda past, future: jnp.concatenate([past[:0:-1], future]), back, states)
        return states
