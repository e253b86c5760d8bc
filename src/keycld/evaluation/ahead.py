"""The next frames of a motion that is being watched."""

from collections import deque
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt8

from keycld._errors import KeycldError
from keycld.evaluation.predicting import observe
from keycld.models.keycld.model import AbstractKeypointModel


class Ahead:
    """Observes each frame once, and predicts from the last ones.

    Attributes:
        errors: of the last frames for which a prediction was due, the largest distance between a predicted and the
            observed keypoint, image-plane units.
    """

    def __init__(self, model: AbstractKeypointModel, dt: float, steps: int, given: int = 10):
        """Take the model, seconds between frames, and how many frames to predict from how many.

        Args:
            model: one without inputs.
            dt: seconds between frames.
            steps: frames to predict.
            given: frames to predict from; ten average the errors of their keypoints.

        Raises:
            KeycldError: the motion depends on inputs, which a camera does not show.
        """
        if model.inputs:
            raise KeycldError(f"this model has {model.inputs} inputs, which a camera does not show.")
        self._model, self._dt, self._steps = model, jnp.float32(dt), steps
        self._seen: deque[np.ndarray] = deque(maxlen=max(given, model.context))
        self._due: deque[np.ndarray | None] = deque([None] * steps, maxlen=steps)
        self.errors: deque[float] = deque(maxlen=200)
        # Compiled before the first frame comes.
        observed, _ = observe(model, np.zeros((1, *model.renderer.size, 3), np.uint8))
        self._coming(np.repeat(observed, self._seen.maxlen or 0, axis=0))

    def see(self, frames: UInt8[np.ndarray, "n H W 3"]) -> tuple[Float[np.ndarray, "K 2"], Any]:
        """Take the frames since the last call; return the keypoints of the last one, and those to come.

        Returns:
            `[K, 2]`, and `[steps, K, 2]` or None as long as too few frames were seen; image-plane units.
        """
        # One at a time, of which there is one program: a camera brings one, or a few where this was late.
        for frame in frames:
            observed = observe(self._model, frame[None])[0][0]
            self._seen.append(observed)
            if (due := self._due.popleft()) is not None:
                self.errors.append(float(np.max(np.linalg.norm(due - observed, axis=-1))))
            self._due.append(None)
        if len(self._seen) < (self._seen.maxlen or 0):
            return self._seen[-1], None
        coming = self._coming(np.stack(self._seen))
        self._due[-1] = coming[-1]
        return self._seen[-1], coming

    def _coming(self, seen: Float[np.ndarray, "n K 2"]) -> Float[np.ndarray, "steps K 2"]:
        return np.asarray(_ahead(self._model, jnp.asarray(seen, jnp.float32), self._dt, self._steps))


@eqx.filter_jit
def _ahead(model: AbstractKeypointModel, seen: Array, dt: Array, steps: int) -> Array:
    none = jnp.zeros(0, jnp.float32)
    state = model.state_of(seen, dt, none)
    last = len(seen) - 1 - model.anchor(len(seen))
    states = model.rollout(state, dt, none, last + steps)
    return jax.vmap(model.keypoints)(states)[last + 1 :]
