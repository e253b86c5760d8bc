"""KeyCLD: keypoints are the Cartesian state of a constrained Lagrangian. Its ablations leave out one part each."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from keycld._errors import KeycldError
from keycld.mechanics import AbstractLaw, AdaptiveDynamics, ConstrainedLagrangian, MechanicalDynamics, State
from keycld.models.base import AbstractModel
from keycld.models.beginning import Beginning
from keycld.models.starts import AbstractStart
from keycld.vision import AbstractEstimator, AbstractRenderer, Observation


class KeyCLD(AbstractModel):
    """Keypoint estimator, dynamics and renderer (paper, sections 2 and 3).

    The state are the keypoints' positions and velocities in image-plane units together with the constants at
    which the constraints hold Φ along this trajectory; mass is known only up to a common factor.

    - `estimator`: frame → keypoints, eq. (8).
    - `dynamics`: (M, V, g, Φ) of eq. (6) and the integrator that moves them.
    - `renderer`: keypoints → frame, eq. (9).
    - `start`: how the given frames' keypoints become a state.
    - `beginning`: what recordings usually begin with, beside what those frames say. None: they say all.

    The paper's ablations are the same composition of other parts: KeyCLD-NC has a law without constraints, NODE2 a
    `SecondOrderNetwork` for a law, FC a `DenseEstimator` and a `DenseRenderer`.
    """

    estimator: AbstractEstimator
    dynamics: MechanicalDynamics | AdaptiveDynamics
    renderer: AbstractRenderer
    start: AbstractStart
    beginning: Beginning | None = None

    @property
    def context(self) -> int:
        """As many frames as the start takes."""
        return self.start.given

    @property
    def reversible(self) -> bool:
        """Mechanics runs backward too."""
        return True

    @property
    def law(self) -> AbstractLaw:
        """Masses, potential energy, input matrix and constraints; NODE2 has only accelerations."""
        return self.dynamics.law

    def anchor(self, n: int) -> int:
        """The frame that the start belongs to."""
        return self.start.anchor

    def constraint(self, x: Float[Array, " dim"]) -> Float[Array, " n"]:
        """Φ(x); empty for a law without constraints."""
        law = self.dynamics.law
        return law.constraint(x) if isinstance(law, ConstrainedLagrangian) else x[:0]

    def observe(self, frame: Float[Array, "H W 3"]) -> Observation:
        """The keypoints of one frame, and its heat maps where the estimator has any.

        **Raises:** KeycldError for a frame of another size than the model draws.
        """
        if frame.shape != (*self.renderer.size, 3):
            height, width = self.renderer.size
            raise KeycldError(
                f"this model sees frames of {height} × {width} pixels with three colours, not of shape "
                f"{list(frame.shape)}: give pictures of that size."
            )
        return self.estimator(frame)

    def keypoints(self, state: State) -> Float[Array, "K 2"]:
        """The positions in the state."""
        return state.coordinates.x.reshape(-1, 2)

    def render(self, state: State) -> Float[Array, "H W 3"]:
        """Draws the keypoints of the state."""
        return self.renderer(self.keypoints(state))

    def infer(self, frames: Float[Array, "n H W 3"], dt: Float[Array, ""], u: Float[Array, "..."]) -> State:
        """The state from the keypoints of the first `context` frames.

        **Raises:** KeycldError for frames of another size, or another number of inputs, than the model knows.
        """
        inputs = getattr(self.law, "inputs", None)
        if inputs not in (None, 0, u.shape[-1]):  # a law without an input matrix ignores u
            raise KeycldError(
                f"this model has {inputs} inputs, not {u.shape[-1]}: give data of the system that it was trained on."
            )
        x = jax.vmap(lambda frame: self.observe(frame).keypoints.reshape(-1))(frames[: self.context])
        state = self.start(self.dynamics, x, dt, u)
        if self.beginning is None:
            return state
        assert isinstance(self.dynamics, MechanicalDynamics)
        return self.beginning(self.dynamics, state, u if u.ndim == 1 else u[0])

    def rollout(self, state: State, dt: Float[Array, ""], u: Float[Array, "..."], steps: int) -> State:
        """Integrates the dynamics; the constraints' constants stay those of the given state."""
        motion = self.dynamics.rollout(state, u, dt, steps)
        parameters = jax.tree.map(lambda p: jnp.broadcast_to(p, (steps + 1, *p.shape)), state.parameters)
        return State(motion, parameters)
