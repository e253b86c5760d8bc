"""The loss of the preset `paper`: collocated accelerations."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from keycld.data import Clip
from keycld.models.keycld.losses import squared_error
from keycld.models.keycld.model import AbstractKeypointModel
from keycld.stages import AbstractLoss, Terms


class CollocationLoss(AbstractLoss):
    """The paper's loss: L = L_r + λ L_d, reconstruction and accelerations without integration.

        L_r = 1/n Σ_i |z'_i − z_i|²                                        eq. (10)
        L_d = 1/n Σ_i |(x_{i+2} − 2x_i + x_{i−2}) / 4h² − ẍ(x_i, v_i, u_i)|²     eqs. (11) to (13)
        v_i = (x_{i+1} − x_{i−1}) / 2h

    over the n frames of a trajectory, the n − 4 interior ones in L_d, with h = dt and ẍ of eq. (6). The paper prints
    sums over frames; λ belongs to the means over all n frames of the released code.

    Source: arXiv 2206.11030v1, eqs. (10) to (13).

    Attributes:
        weight: λ; 5e-4 as published.
    """

    weight: float = 5e-4

    def __call__(
        self, model: AbstractKeypointModel, clips: Clip, *, key: PRNGKeyArray, step: Int[Array, ""]
    ) -> tuple[Float[Array, ""], Terms]:
        """Evaluate the loss.

        Args:
            model: with a law of accelerations.
            clips: n ≥ 5 consecutive frames each, `[B, n, H, W, 3]` in [0, 1].
            key: not used.
            step: not used.
        """
        assert clips.frames is not None
        batch, count = clips.frames.shape[:2]
        frames = clips.frames.reshape(-1, *clips.frames.shape[2:])
        keypoints = jax.vmap(model.observe)(frames).keypoints
        law = model.moving_law

        def one(x: Array, u: Array, dt: Array) -> Array:
            velocity = (x[2:] - x[:-2]) / (2 * dt)
            acceleration = (velocity[2:] - velocity[:-2]) / (2 * dt)
            inputs = jnp.broadcast_to(u[None, :], (count - 4, u.shape[0])) if u.ndim == 1 else u[2 : count - 2]
            return acceleration - jax.vmap(law.acceleration)(x[2:-2], velocity[1:-1], inputs)

        defect = jax.vmap(one)(keypoints.reshape(batch, count, -1), clips.u, clips.dt)
        terms = {
            "reconstruction": squared_error(jax.vmap(model.renderer)(keypoints), frames),
            # As released: the interior frames' sum over the number of all frames.
            "dynamics": jnp.sum(defect**2) / (batch * count),
        }
        return terms["reconstruction"] + self.weight * terms["dynamics"], terms
