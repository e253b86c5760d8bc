"""The loss of the 2024 version: short roll-outs from each frame instead of collocation."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from keycld._errors import KeycldError
from keycld._shares import over_clips
from keycld.data import Clip
from keycld.mechanics import Euler, MechanicalDynamics, Motion, Scalar, State
from keycld.models.keycld.initial_state import allowed_velocity
from keycld.models.keycld.losses import squared_error
from keycld.models.keycld.model import AbstractKeypointModel
from keycld.stages import AbstractLoss, Terms
from keycld.vision import KeypointEstimator, Observation, gaussian_maps, image_grid


class ShortRolloutLoss(AbstractLoss):
    """The loss of the 2024 version: L = L_r + w_d L_d + w_h L_h.

        L_r = mean over frames of |z' − z|²                                       reconstruction, sum over pixels
        L_d = mean over clips of Σ_{k=1}^{n−S−3} Σ_{j=1}^{S} |x̂_{k+j} − x_{k+j}|²   roll-outs
        L_h = mean over pixels of −b log(s + 10⁻⁴) − (1 − b) log(1 − s + 10⁻⁴)    heat maps

    x̂ are S explicit Euler steps of eq. (6) from x_k with the velocity (x_{k+1} − x_{k−1})/2h, projected on ker DΦ(x_k);
    x are the observed keypoints, h = dt. s is a heat map divided by its maximum, b the Gaussian exp(−|x_p − x|²/2σ²) at
    its keypoint, without gradient. The estimator gets each frame transformed by a random element of the symmetry group
    of the square, and its heat maps are transformed back.

    Source: Neurocomputing 573:127175 (2024) and its released code; the equation numbers are those of arXiv v1.

    Attributes:
        steps: S, steps of a roll-out; 4 as published.
        dynamics: w_d, for squared distances in image-plane units; 1 as published.
        heat_map: w_h; 1 as published.
        sigma: σ of the Gaussians, image-plane units; 0.1 as published.
        augment: whether frames are transformed; only for square frames, and only estimators with heat maps do it.
    """

    steps: int = eqx.field(static=True, default=4)
    dynamics: float = 1.0
    heat_map: float = 1.0
    sigma: float = 0.1
    augment: bool = eqx.field(static=True, default=True)

    def __call__(
        self, model: AbstractKeypointModel, clips: Clip, *, key: PRNGKeyArray, step: Int[Array, ""]
    ) -> tuple[Float[Array, ""], Terms]:
        """Evaluate the loss.

        Args:
            model: with a law of accelerations.
            clips: n ≥ S + 4 consecutive frames each, `[B, n, H, W, 3]` in [0, 1].
            key: for the random transformations.
            step: not used.

        Raises:
            KeycldError: fewer frames; frames that are not square, with `augment`.
        """
        assert clips.frames is not None
        batch, count, height, width, _ = clips.frames.shape
        rollouts = count - 3 - self.steps
        if rollouts < 1:
            raise KeycldError(
                f"roll-outs of {self.steps} steps need {self.steps + 4} frames, not {count}: lower the setting "
                "predicted, or make longer trajectories."
            )
        frames = clips.frames.reshape(-1, height, width, 3)
        observed = self._observe(model, frames, key)
        dynamics = MechanicalDynamics(model.moving_law, Euler())

        def one(dynamics: MechanicalDynamics, x: Array, u: Array, dt: Array) -> Array:
            v = jax.vmap(lambda x, v: allowed_velocity(dynamics, x, v))(x[1:-1], (x[2:] - x[:-2]) / (2 * dt))

            def squared_distance(k: Array) -> Array:
                inputs = u if u.ndim == 1 else jax.lax.dynamic_slice_in_dim(u, k, self.steps)
                state = State(Motion(x[k], v[k - 1]), {})
                path = dynamics.rollout(state, inputs, dt, self.steps).x
                return jnp.sum((path - jax.lax.dynamic_slice_in_dim(x, k, self.steps + 1)) ** 2)

            return jnp.sum(jax.vmap(squared_distance)(jnp.arange(1, 1 + rollouts)))

        x = observed.keypoints.reshape(batch, count, -1)
        terms = {
            "reconstruction": squared_error(jax.vmap(model.renderer)(observed.keypoints), frames),
            "dynamics": jnp.mean(over_clips(one, dynamics, x, clips.u, clips.dt)),
            "heat_map": _cross_entropy(observed, (height, width), self.sigma),
        }
        total = terms["reconstruction"] + self.dynamics * terms["dynamics"] + self.heat_map * terms["heat_map"]
        return total, terms

    def _observe(self, model: AbstractKeypointModel, frames: Float[Array, "B H W 3"], key: PRNGKeyArray) -> Observation:
        estimator = model.estimator
        if not (self.augment and isinstance(estimator, KeypointEstimator)):
            return jax.vmap(model.observe)(frames)
        if frames.shape[1] != frames.shape[2]:
            raise KeycldError(
                f"augmentation needs square frames, not {frames.shape[1]} × {frames.shape[2]} pixels: crop them or set "
                "augment=false."
            )

        def one(frame: Array, turn: Array) -> Observation:
            return estimator.locate(turned_back(estimator.logits(turned(frame, turn)), turn))

        return jax.vmap(one)(frames, jax.random.bernoulli(key, shape=(frames.shape[0], 3)))


def turned(x: Float[Array, "side side c"], turn: Bool[Array, "3"]) -> Float[Array, "side side c"]:
    """Apply one of the eight symmetries of the square: transpose, reverse rows, reverse columns.

    Args:
        x: a frame or heat maps.
        turn: which of the three are applied, in this order.
    """
    x = jnp.where(turn[0], x.transpose(1, 0, 2), x)
    x = jnp.where(turn[1], x[::-1], x)
    return jnp.where(turn[2], x[:, ::-1], x)


def turned_back(x: Float[Array, "side side c"], turn: Bool[Array, "3"]) -> Float[Array, "side side c"]:
    """Apply the inverse of `turned`."""
    x = jnp.where(turn[2], x[:, ::-1], x)
    x = jnp.where(turn[1], x[::-1], x)
    return jnp.where(turn[0], x.transpose(1, 0, 2), x)


def _cross_entropy(observed: Observation, size: tuple[int, int], sigma: Scalar) -> Array:
    if observed.heat_maps is None:
        return jnp.zeros(())
    maps = observed.heat_maps / jnp.max(observed.heat_maps, axis=(-2, -1), keepdims=True)
    grid = image_grid(*size, size[0] // maps.shape[-2])
    blobs = jax.vmap(lambda x: gaussian_maps(x, grid, sigma))(jax.lax.stop_gradient(observed.keypoints))
    target = blobs.transpose(0, 3, 1, 2)
    tiny = 1e-4
    return -jnp.mean(target * jnp.log(maps + tiny) + (1 - target) * jnp.log(1 - maps + tiny))
