"""Adaptive roll-outs by Diffrax, as in the paper's evaluation (appendix A.9)."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from keycld.mechanics.dynamics import frame_inputs, stack_first
from keycld.mechanics.lagrangian import AbstractLaw
from keycld.mechanics.state import AbstractDynamics, Motion, Scalar, State


def adaptive_rollout(
    law: AbstractLaw,
    state: State,
    u: Float[Array, "l"] | Float[Array, "steps l"],
    dt: Scalar,
    steps: int,
    rtol: float = 1e-6,
    atol: float = 1e-6,
) -> Motion:
    """The motion at `steps` + 1 frames by Dormand–Prince 5(4), the given frame first.

    Eq. (6) keeps Φ̇ only, so Φ would drift. As in the released code, the vector field therefore pulls x back
    to Φ(x) = constants of the state before it evaluates the acceleration; `project_position` does here what
    BFGS did there. Inputs are constant in a frame, so each frame is integrated by itself. Not symplectic, and
    much slower than `Rattle`: for the `paper` preset and for checks. A motion that the steps cannot follow, because it
    diverges, is NaN from there on; the other motions of a batch are not touched.

    Args:
        law: point masses with constraints, or any law without `constants` in its states.
        state: the start, with `constants` among its parameters where there are constraints.
        u: the input, constant [l] or [steps, l], read in reverse for negative dt.
        dt: seconds between frames.
        steps: how many frames to go.
        rtol: relative tolerance of a step.
        atol: absolute tolerance of a step. 1e-6 is about the best that float32 can do.

    Raises:
        KeycldError: if `u` does not fit.
    """
    parameters = state.parameters

    def field(_, motion, u):
        x = motion.x
        if "constants" in parameters:
            x = law.project_position(x, parameters["constants"], parameters)  # pyright: ignore[reportAttributeAccessIssue]
        return Motion(motion.v, law.acceleration(x, motion.v, u, parameters))

    def frame(motion, u):
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(field),
            diffrax.Dopri5(),
            t0=0.0,
            t1=dt,
            dt0=None,
            y0=motion,
            args=u,
            stepsize_controller=diffrax.PIDController(rtol=rtol, atol=atol),
            throw=False,
        )
        arrived = solution.result == diffrax.RESULTS.successful
        end = jax.tree.map(lambda y: jnp.where(arrived, y[-1], jnp.nan), solution.ys)
        return end, end

    _, motions = jax.lax.scan(frame, state.coordinates, frame_inputs(u, dt, steps))
    return stack_first(state.coordinates, motions)


class AdaptiveDynamics(AbstractDynamics):
    """A law, integrated by `adaptive_rollout`.

    Attributes:
        law: as for `adaptive_rollout`.
        rtol, atol: tolerances of a step.
    """

    law: AbstractLaw
    rtol: float = eqx.field(static=True, default=1e-6)
    atol: float = eqx.field(static=True, default=1e-6)

    def step(self, state: State, u: Float[Array, "l"], dt: Scalar) -> State:
        """The state one frame later (earlier for negative dt)."""
        motion = self.rollout(state, u, dt, 1)
        return State(jax.tree.map(lambda y: y[-1], motion), state.parameters)

    def rollout(self, state: State, u: Float[Array, "l"] | Float[Array, "steps l"], dt: Scalar, steps: int) -> Motion:
        """The motion at `steps` + 1 frames; see `adaptive_rollout`."""
        return adaptive_rollout(self.law, state, u, dt, steps, self.rtol, self.atol)
