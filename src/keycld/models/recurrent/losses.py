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
        rendered: how many random predicted frames of each window are rendered; 0 for all.
        at_once: frames that are encoded and rendered in parallel, but at least one window.
    """

    rendered: int
    at_once: int

    def __call__(
        self, model: AR, clips: Clip, *, key: PRNGKeyArray, step: Int[Array, ""]
    ) -> tuple[Float[Array, ""], Terms]:
        """Evaluate the loss on windows of two or more consecutive frames."""
        assert clips.frames is not None
        steps = clips.frames.shape[1] - 1

        some = self.rendered if 0 < self.rendered < steps else 0
        orders = jax.vmap(lambda k: jax.random.permutation(k, steps))(jax.random.split(key, clips.frames.shape[0]))

        def squared_error(model: AR, window: tuple[Array, Array, Array]) -> Array:
            frames, u, order = window
            codes = jax.vmap(model.encoder)(frames[:-1])
            _, outputs = model.pass_on(model.stack.initial(), codes, u if u.ndim == 1 else u[:steps])
            targets = frames[1:]
            if some:
                chosen = order[:some].astype(int)
                outputs, targets = outputs[chosen], targets[chosen]
            return jnp.mean((jax.vmap(model.decoder)(outputs) - targets) ** 2)

        # As floats, because chunks are differentiated in all that they hold.
        windows = (clips.frames, clips.u, orders.astype(jnp.float32))
        error = mean_in_chunks(squared_error, model, windows, max(1, self.at_once // steps))
        loss = error + 0.5 * math.log(math.pi)
        explained = 1.0 - jax.lax.stop_gradient(error) / jnp.mean(jnp.var(clips.frames[:, 1:], axis=(0, 1)))
        return loss, {"log_likelihood": -loss, "squared_error": error, "explained": explained}
