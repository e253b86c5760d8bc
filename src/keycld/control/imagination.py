"""The learned model as an environment: pure functions of states, without pictures and simulator."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from keycld._errors import KeycldError
from keycld.control.requirements import require
from keycld.mechanics import AbstractDynamics, ConstrainedLagrangian, Motion, State
from keycld.models.base import AbstractModel, HasLagrangian


class Imagined(NamedTuple):
    """Result of a step.

    Attributes:
        state: positions and velocities of the keypoints.
        reward: minus the mean squared distance of the keypoints to the goal, image-plane units².
        truncated: whether the episode is over.
    """

    state: State
    reward: Float[Array, ""]
    truncated: Bool[Array, ""]


class Imagination(eqx.Module):
    """Swing-up inside a trained model (Gymnasium's `FuncEnv` in spirit); `jax.vmap` runs thousands at once.

    ```python
    world = Imagination.of(model, dt, poses, goal)
    states = jax.vmap(world.reset)(jax.random.split(key, 10_000))
    states, reward, truncated = jax.vmap(world.step)(states, u, count)
    ```

    Attributes:
        law: learned law of motion.
        dynamics: the model's own.
        dt: seconds between frames.
        poses: [N, 2K], keypoints of observed frames; an initial state is one of them, at rest.
        goal: x* [2K].
        limit: the largest |u|.
        steps: frames until `truncated`.
    """

    law: ConstrainedLagrangian
    dynamics: AbstractDynamics
    dt: float
    poses: Float[Array, "N dim"]
    goal: Float[Array, "dim"]
    limit: float = jnp.inf
    steps: int = 1000

    @classmethod
    def of(
        cls,
        model: AbstractModel,
        dt: float,
        poses: Float[Array, "N dim"],
        goal: Float[Array, "dim"],
        limit: float = jnp.inf,
        steps: int = 1000,
    ) -> "Imagination":
        """Return the environment inside a model.

        Raises:
            KeycldError: the model has learned no Lagrangian, or there is no initial pose.
        """
        if not len(poses):
            raise KeycldError(
                "an imagined environment has observed initial poses: give the keypoints of a frame or more."
            )
        lagrangian = require(model, HasLagrangian)
        return cls(lagrangian.law, lagrangian.dynamics, dt, poses, goal, limit, steps)

    def reset(self, key: PRNGKeyArray) -> State:
        """Return one of the poses, at rest."""
        x = self.poses[jax.random.randint(key, (), 0, self.poses.shape[0])]
        return State(Motion(x, jnp.zeros_like(x)), {"constants": self.law.constraint(x)})

    def step(self, state: State, u: Float[Array, "l"], count: Int[Array, ""] | int = 0) -> Imagined:
        """Return the state one frame later; `count` frames have passed before."""
        state = self.dynamics.step(state, jnp.clip(u, -self.limit, self.limit), self.dt)
        reward = -jnp.mean((state.coordinates.x - self.goal) ** 2)
        return Imagined(state, reward, jnp.asarray(count + 1 >= self.steps))
