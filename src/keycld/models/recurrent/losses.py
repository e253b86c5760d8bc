"""What training the autoregressive model minimises."""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from keycld.data import Clip
from keycld.models.recurrent.model import AR
from keycld.stages import AbstractLoss, Terms
from keycld.vision import mean_in_chunks


class NextFrameLoss(AbstractLoss):
    """−log p of each frame given all earlier ones, a mean over all its values: teacher forcing.

    The model is fed the true frames 0 … L − 2 of a window and predicts frames 1 … L − 1. Every value of a picture is
    normal with variance 1/2 around the predicted one, so −log p = (x − μ)² + ½ ln π.

    Attributes:
        at_once: frames that are encoded and rendered in parallel, but at least one window.
    """

    at_once: int

    def __call__(
        self, model: AR, clips: Clip, *, key: PRNGKeyArray, step: Int[Array, ""]
    ) -> tuple[Float[Array, ""], Terms]:
        """Evaluate the loss on windows of two or more consecutive frames."""
        assert clips.frames is not None
        steps = clips.frames.shape[1] - 1

        def squared_error(model: AR, window: tuple[Array, Array]) -> Array:
            frames, u = window
            codes = jax.vmap(model.encoder)(frames[:-1])
            _, outputs = model.pass_on(model.stack.initial(), codes, u if u.ndim == 1 else u[:steps])
            return jnp.mean((jax.vmap(model.decoder)(outputs) - frames[1:]) ** 2)

        windows = (clips.frames, clips.u)
        error = mean_in_chunks(squared_error, model, windows, max(1, self.at_once // steps))
        loss = error + 0.5 * math.log(math.pi)
        return loss, {"log_likelihood": -loss, "squared_error": error}
