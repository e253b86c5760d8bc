"""Dynamics of second order: a law of motion with an integrator, and the velocity that joins two frames."""

import abc

import equinox as eqx
import jax
from jaxtyping import Array, Float

from keycld._errors import KeycldError
from keycld.mechanics.integrators import AbstractIntegrator
from keycld.mechanics.lagrangian import AbstractLaw, ConstrainedLagrangian
from keycld.mechanics.own_parameters import own_law
from keycld.mechanics.state import AbstractDynamics, Motion, Scalar, State


class AbstractMechanicalDynamics(AbstractDynamics):
    """Dynamics that integrate a law of second order; the coordinates of their states are a `Motion`."""

    law: eqx.AbstractVar[AbstractLaw]

    @abc.abstractmethod
    def rollout(self, state: State, u: Float[Array, "l"] | Float[Array, "steps l"], dt: Scalar, steps: int) -> Motion:
        """Return the motion at `steps` + 1 frames, the given one first.

        Args:
            state: the initial state.
            u: the input, constant [l] or one for each frame interval [steps, l]. For negative dt the latter
                is read in reverse, so a roll-out back over the same frames takes the same array.
            dt: seconds between frames.
            steps: number of frame intervals.

        Returns:
            `Motion` with a leading axis of steps + 1.

        Raises:
            KeycldError: if `u` does not fit.
        """


class MechanicalDynamics(AbstractMechanicalDynamics):
    """A law, integrated with fixed steps.

    Attributes:
        law: for instance a `ConstrainedLagrangian`.
        integrator: for instance `Rattle(substeps=4)`.
    """

    law: AbstractLaw
    integrator: AbstractIntegrator

    def step(self, state: State, u: Float[Array, "l"], dt: Scalar) -> State:
        """Return the state one frame later (earlier for negative dt)."""
        return self.integrator.step(own_law(self.law, state.parameters), state, u, dt)

    def rollout(self, state: State, u: Float[Array, "l"] | Float[Array, "steps l"], dt: Scalar, steps: int) -> Motion:
        """Return the motion at `steps` + 1 frames; see `AbstractMechanicalDynamics.rollout`."""
        return self.integrator.rollout(own_law(self.law, state.parameters), state, u, dt, steps)


def joining_velocity(
    dynamics: AbstractMechanicalDynamics,
    x0: Float[Array, "dim"],
    x1: Float[Array, "dim"],
    parameters: dict[str, Array],
    u: Float[Array, "l"],
    dt: Scalar,
    iterations: int = 3,
) -> Float[Array, "dim"]:
    """Compute the velocity at x0 with which one frame step, sub-steps included, arrives at x1.

    It is a fixed point: v ← v + R(x1 − x̂(v))/dt from v = P₀(x1 − x0)/dt, where x̂(v) is the end of the step, P₀ and P₁
    project on the velocities that the constraints allow at x0 and at x̂, and R = P₀(3 − P₁P₀)P₁/2 carries the
    error at x̂ back to x0 and nearly keeps its length. A backward difference, in contrast, belongs to the middle of
    the frame interval and has the length of the chord.

    Args:
        dynamics: a `ConstrainedLagrangian` with its integrator.
        x0: positions at a frame.
        x1: positions at the next one; a part of it off the constraints is projected away.
        parameters: of the state, with `constants`.
        u: the input between them.
        dt: seconds between them.
        iterations: each multiplies the error by about θ⁴/3, θ the angle turned in the frame: 3 are enough
            for float32 up to 0.5 rad.

    Returns:
        v at x0. The state at the second frame is the end of the step from (x0, v).

    Raises:
        KeycldError: for another kind of law.
    """
    law = own_law(dynamics.law, parameters)
    if not isinstance(law, ConstrainedLagrangian):
        raise KeycldError(f"two frames are joined through a ConstrainedLagrangian, not a {type(law).__name__}.")

    def project(x, v):
        return law.project_velocity(x, v, parameters)

    def better(v: Array, _: None) -> tuple[Array, None]:
        reached = dynamics.step(State(Motion(x0, v), parameters), u, dt).coordinates.x
        miss = project(reached, (x1 - reached) / dt)
        shrunk = project(reached, project(x0, miss))
        return v + project(x0, 1.5 * miss - 0.5 * shrunk), None

    # Unrolled: as fast as a loop in Python, but traced once.
    return jax.lax.scan(better, project(x0, (x1 - x0) / dt), length=iterations, unroll=iterations)[0]
