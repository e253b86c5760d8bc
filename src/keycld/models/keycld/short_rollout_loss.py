"""The loss of the 2024 version: short roll-outs from every frame instead of collocation."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from keycld._errors import KeycldError
from keycld.data import Clip
from keycld.mechanics import Euler, MechanicalDynamics, Motion, State
from keycld.models.keycld.initial_state import allowed_velocity
from keycld.models.keycld.losses import squared_error
from keycld.models.keycld.model import AbstractKeypointModel
from keycld.stages import AbstractLoss, Terms
from keycld.vision import KeypointEstimator, Observation, gaussian_maps, image_grid


class ShortRolloutLoss(AbstractLoss):
    """reconstruction + `dynamics` · Σ |x̂ − x|² + `heat_map` · cross-entropy, on whole trajectories.

    From every frame a roll-out of a few explicit Euler steps starts, with the central difference of the keypoints,
    projected on ker DΦ, for a velocity; squared distances are summed over starts, steps and components. The
    cross-entropy compares each map, divided by its peak, with a constant Gaussian blob at its keypoint, mean over
    pixels. The estimator sees each frame turned by a random element of the square's symmetry group, and its maps are
    turned back.

    - `steps`: of a roll-out; 4 as published.
    - `sigma`: of the blobs, image-plane units.
    - `augment`: whether frames are turned; only for square pictures and estimators with maps.
    """

    steps: int = eqx.field(static=True, default=4)
    dynamics: float = 1.0
    heat_map: float = 1.0
    sigma: float = 0.1
    augment: bool = eqx.field(static=True, default=True)

    def __call__(
        self, model: AbstractKeypointModel, clips: Clip, *, key: PRNGKeyArray, step: Int[Array, ""]
    ) -> tuple[Float[Array, ""], Terms]:
        """Evaluates the loss on windows of at least `steps` + 4 consecutive frames."""
        assert clips.frames is not None
        batch, count, height, width, _ = clips.frames.shape
        starts = count - 3 - self.steps
        if starts < 1:
            raise KeycldError(f"roll-outs of {self.steps} steps need {self.steps + 4} frames, not {count}.")
        frames = clips.frames.reshape(-1, height, width, 3)
        seen = self._observe(model, frames, key)
        dynamics = MechanicalDynamics(model.moving_law, Euler())

        def one(x: Array, u: Array, dt: Array) -> Array:
            v = jax.vmap(lambda x, v: allowed_velocity(dynamics, x, v))(x[1:-1], (x[2:] - x[:-2]) / (2 * dt))

            def miss(k: Array) -> Array:
                inputs = u if u.ndim == 1 else jax.lax.dynamic_slice_in_dim(u, k, self.steps)
                state = State(Motion(x[k], v[k - 1]), {})
                path = dynamics.rollout(state, inputs, dt, self.steps).x
                return jnp.sum((path - jax.lax.dynamic_slice_in_dim(x, k, self.steps + 1)) ** 2)

            return jnp.sum(jax.vmap(miss)(jnp.arange(1, 1 + starts)))

        x = seen.keypoints.reshape(batch, count, -1)
        terms = {
            "reconstruction": squared_error(jax.vmap(model.renderer)(seen.keypoints), frames),
            "dynamics": jnp.mean(jax.vmap(one)(x, clips.u, clips.dt)),
            "heat_map": _cross_entropy(seen, (height, width), self.sigma),
        }
        total = terms["reconstruction"] + self.dynamics * terms["dynamics"] + self.heat_map * terms["heat_map"]
        return total, terms

    def _observe(self, model: AbstractKeypointModel, frames: Float[Array, "B H W 3"], key: PRNGKeyArray) -> Observation:
        estimator = model.estimator
        if not (self.augment and isinstance(estimator, KeypointEstimator)):
            return jax.vmap(model.observe)(frames)
        if frames.shape[1] != frames.shape[2]:
            raise KeycldError(
                f"pictures of {frames.shape[1]}×{frames.shape[2]} pixels cannot be turned: crop them square or set "
                "augment=false."
            )

        def one(frame: Array, turn: Array) -> Observation:
            return estimator.locate(turned_back(estimator.logits(turned(frame, turn)), turn))

        return jax.vmap(one)(frames, jax.random.bernoulli(key, shape=(frames.shape[0], 3)))


def turned(x: Float[Array, "side side c"], turn: Bool[Array, "3"]) -> Float[Array, "side side c"]:
    """One of the square's eight symmetries: transpose, then mirror rows, then columns, each if told."""
    x = jnp.where(turn[0], x.transpose(1, 0, 2), x)
    x = jnp.where(turn[1], x[::-1], x)
    return jnp.where(turn[2], x[:, ::-1], x)


def turned_back(x: Float[Array, "side side c"], turn: Bool[Array, "3"]) -> Float[Array, "side side c"]:
    """The inverse of `turned`."""
    x = jnp.where(turn[2], x[:, ::-1], x)
    x = jnp.where(turn[1], x[::-1], x)
    return jnp.where(turn[0], x.transpose(1, 0, 2), x)


def _cross_entropy(seen: Observation, size: tuple[int, int], sigma: float) -> Array:
    if seen.heat_maps is None:
        return jnp.zeros(())
    maps = seen.heat_maps / jnp.max(seen.heat_maps, axis=(-2, -1), keepdims=True)
    grid = image_grid(*size, size[0] // maps.shape[-2])
    blobs = jax.vmap(lambda x: gaussian_maps(x, grid, sigma))(jax.lax.stop_gradient(seen.keypoints))
    target = blobs.transpose(0, 3, 1, 2)
    tiny = 1e-4
    return -jnp.mean(target * jnp.log(maps + tiny) + (1 - target) * jnp.log(1 - maps + tiny))
