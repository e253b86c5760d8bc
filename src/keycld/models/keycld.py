"""KeyCLD: keypoints are the Cartesian state of a constrained Lagrangian."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from keycld.mechanics import (
    AdaptiveDynamics,
    ConstrainedLagrangian,
    MechanicalDynamics,
    Motion,
    State,
    joining_velocity,
)
from keycld.models.base import AbstractModel
from keycld.vision import KeypointEstimator, Observation, Renderer


class KeyCLD(AbstractModel):
    """Keypoint estimator, constrained Lagrangian dynamics and renderer (paper, sections 2 and 3).

    The state are the keypoints' positions and velocities in image-plane units together with the constants at
    which the constraints hold Φ along this trajectory; mass is known only up to a common factor.

    - `estimator`: frame → keypoints, eq. (8).
    - `dynamics`: (M, V, g, Φ) of eq. (6) and the integrator that moves them.
    - `renderer`: keypoints → frame, eq. (9).
    - `joined`: solve for the velocity with which one step of the dynamics joins the two given frames, instead of
      the paper's backward difference.
    """

    estimator: KeypointEstimator
    dynamics: MechanicalDynamics | AdaptiveDynamics
    renderer: Renderer
    joined: bool = eqx.field(static=True, default=True)

    context: ClassVar[int] = 2
    reversible: ClassVar[bool] = True

    @property
    def law(self) -> ConstrainedLagrangian:
        """Masses, potential energy, input matrix and constraints."""
        return self.dynamics.law  # pyright: ignore[reportReturnType]

    def anchor(self, n: int) -> int:
        """The second frame, as in arXiv v1."""
        return 1

    def observe(self, frame: Float[Array, "H W 3"]) -> Observation:
        """The keypoints and heat maps of one frame."""
        return self.estimator(frame)

    def keypoints(self, state: State) -> Float[Array, "K 2"]:
        """The positions in the state."""
        return state.coordinates.x.reshape(-1, 2)

    def render(self, state: State) -> Float[Array, "H W 3"]:
        """Draws the keypoints of the state."""
        return self.renderer(self.keypoints(state))

    def infer(self, frames: Float[Array, "n H W 3"], dt: Float[Array, ""], u: Float[Array, "..."]) -> State:
        """The state at the second frame from the keypoints of the first two."""
        x = jax.vmap(lambda frame: self.estimator(frame).keypoints.reshape(-1))(frames[:2])
        if not self.joined:
            return State(Motion(x[1], (x[1] - x[0]) / dt), {"constants": self.law.constraint(x[1])})
        first = u if u.ndim == 1 else u[0]
        return self.dynamics.step(self.start(x[0], x[1], dt, first), first, dt)

    def start(
        self, x0: Float[Array, " dim"], x1: Float[Array, " dim"], dt: Float[Array, ""], u: Float[Array, " l"]
    ) -> State:
        """The state at frame 0 of the motion that passes through the keypoints of frames 0 and 1.

        Both are first brought to the mean of their constraint values, so that the motion can keep them; then
        the velocity is solved so that one step of the dynamics joins the two. A plain difference (x1 − x0)/dt
        would be wrong by the curvature of the path within a frame.
        """
        law = self.law
        constants = (law.constraint(x0) + law.constraint(x1)) / 2
        x0, x1 = law.project_position(x0, constants), law.project_position(x1, constants)
        parameters = {"constants": constants}
        v0 = joining_velocity(self.dynamics, x0, x1, parameters, u, dt)  # pyright: ignore[reportArgumentType]
        return State(Motion(x0, v0), parameters)

    def rollout(self, state: State, dt: Float[Array, ""], u: Float[Array, "..."], steps: int) -> State:
        """Integrates the dynamics; the constraints' constants stay those of the given state."""
        motion = self.dynamics.rollout(state, u, dt, steps)
        parameters = jax.tree.map(lambda p: jnp.broadcast_to(p, (steps + 1, *p.shape)), state.parameters)
        return State(motion, parameters)
