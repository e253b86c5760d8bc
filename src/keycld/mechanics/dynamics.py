"""A law of motion with an integrator: steps, roll-outs, and the velocity that joins two frames."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from keycld._errors import KeycldError
from keycld.mechanics.integrators import AbstractIntegrator
from keycld.mechanics.lagrangian import AbstractLaw
from keycld.mechanics.state import AbstractDynamics, Motion, Scalar, State


class MechanicalDynamics(AbstractDynamics):
    """A law, integrated.

    Attributes:
        law: for instance a `ConstrainedLagrangian`.
        integrator: for instance `Rattle(substeps=4)`.
    """

    law: AbstractLaw
    integrator: AbstractIntegrator

    def step(self, state: State, u: Float[Array, "l"], dt: Scalar) -> State:
        """The state one frame later (earlier for negative dt)."""
        return self.integrator.step(self.law, state, u, dt)

    def rollout(self, state: State, u: Float[Array, "l"] | Float[Array, "steps l"], dt: Scalar, steps: int) -> Motion:
        """The motion at `steps` + 1 frames, the given one first.

        Args:
            state: the start.
            u: the input, constant [l] or one for each frame interval [steps, l]. For negative dt the latter
                is read in reverse, so a roll-out back over the same frames takes the same array.
            dt: seconds between frames.
            steps: how many frames to go.

        Returns:
            `Motion` with a leading axis of steps + 1.

        Raises:
            KeycldError: if `u` does not fit.
        """
        parameters = state.parameters
        start = state.coordinates
        memory = self.integrator.begin(self.law, start, parameters, dt / self.integrator.substeps)

        def body(carry, u):
            motion, memory = self.integrator.frame(self.law, carry[0], carry[1], parameters, u, dt)
            return (motion, memory), motion

        _, motions = jax.lax.scan(body, (start, memory), frame_inputs(u, dt, steps))
        return stack_first(start, motions)


def frame_inputs(u: Float[Array, "l"] | Float[Array, "steps l"], dt: Scalar, steps: int) -> Float[Array, "steps l"]:
    """The input of each frame interval in the order of integration: read in reverse for negative dt.

    Raises:
        KeycldError: if there are not as many as steps.
    """
    if u.ndim == 1:
        return jnp.broadcast_to(u[None, :], (steps, u.shape[0]))
    if u.shape[0] != steps:
        raise KeycldError(f"a roll-out of {steps} steps needs {steps} inputs, not {u.shape[0]}: cut or extend u.")
    return jnp.where(jnp.asarray(dt) < 0, u[::-1], u)


def stack_first(first: Motion, rest: Motion) -> Motion:
    """A motion and the stacked ones after it as one stack."""
    return jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, rest)


def joining_velocity(
    dynamics: MechanicalDynamics,
    x0: Float[Array, "dim"],
    x1: Float[Array, "dim"],
    parameters: dict[str, Array],
    u: Float[Array, "l"],
    dt: Scalar,
    iterations: int = 3,
) -> Float[Array, "dim"]:
    """The velocity at x0 with which one frame step, sub-steps included, arrives at x1.

    A fixed point: v ← v + R(x1 − x̂(v))/dt from v = P₀(x1 − x0)/dt, where x̂(v) is the end of the step, P₀ and P₁
    project on the velocities that the constraints allow at x0 and at x̂, and R = P₀(3 − P₁P₀)P₁/2 carries the
    miss from x̂ back to x0 nearly without shrinking it. A backward difference, in contrast, is half a frame old
    and has the length of the chord.

    Args:
        dynamics: a law of point masses with its integrator.
        x0: positions at a frame.
        x1: positions at the next one; noise off the constraints is projected away.
        parameters: of the state, with `constants`.
        u: the input between them.
        dt: seconds between them.
        iterations: each multiplies the error by about θ⁴/3, θ the angle turned in the frame: 3 are enough
            for float32 up to 0.5 rad.

    Returns:
        v at x0. The state at the second frame is the end of the step from (x0, v).
    """

    def project(x, v):
        return dynamics.law.project_velocity(x, v, parameters)  # pyright: ignore[reportAttributeAccessIssue]

    def better(v: Array, _: None) -> tuple[Array, None]:
        reached = dynamics.step(State(Motion(x0, v), parameters), u, dt).coordinates.x
        miss = project(reached, (x1 - reached) / dt)
        shrunk = project(reached, project(x0, miss))
        return v + project(x0, 1.5 * miss - 0.5 * shrunk), None

    # Unrolled: as fast as a loop in Python, but traced once.
    return jax.lax.scan(better, project(x0, (x1 - x0) / dt), length=iterations, unroll=iterations)[0]
