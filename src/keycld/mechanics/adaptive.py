"""Adaptive roll-outs by Diffrax, as in the paper's evaluation (appendix A.9)."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

from keycld.mechanics.dynamics import AbstractMechanicalDynamics
from keycld.mechanics.integrators import AbstractIntegrator, Parameters, frame_inputs, stack_first
from keycld.mechanics.lagrangian import AbstractLaw, ConstrainedLagrangian
from keycld.mechanics.own_parameters import own_law
from keycld.mechanics.state import AbstractField, Motion, Scalar, State


def adaptive_rollout(
    law: AbstractField,
    state: State,
    u: Float[Array, "l"] | Float[Array, "steps l"],
    dt: Scalar,
    steps: int,
    rtol: float = 1e-6,
    atol: float = 1e-6,
    pull_back: bool = True,
) -> PyTree:
    """Return the coordinates at `steps` + 1 frames by Dormand–Prince 5(4), the given ones first.

    Eq. (6) keeps only Φ̇ at zero, so rounding and truncation make Φ drift. With `pull_back` the vector field first
    pulls x back to Φ(x) = constants of the state and evaluates the acceleration there, as the released code of arXiv v1
    does; `project_position` takes the place of its BFGS. The 2024 version does not pull back. Inputs are constant in a
    frame interval, so each interval is integrated by itself. Not symplectic, and much slower than `Rattle`: for the
    `paper` preset and for checks. Where the solver cannot follow a motion, because it diverges, the rest of that motion
    is NaN; other motions of a batch are unaffected.

    Args:
        law: a law of motion, or any other field.
        state: the initial state, with `constants` among its parameters where constraints are pulled back.
        u: the input, constant [l] or [steps, l], read in reverse for negative dt.
        dt: seconds between frames.
        steps: number of frame intervals.
        rtol: relative tolerance of a step.
        atol: absolute tolerance of a step. 1e-6 is about the best that float32 can do.
        pull_back: whether the field of a `ConstrainedLagrangian` pulls Φ back to its constants.

    Raises:
        KeycldError: if `u` does not fit.
    """
    parameters = state.parameters
    pulled = law if pull_back and isinstance(law, ConstrainedLagrangian) and "constants" in parameters else None

    def field(_, coordinates, u):
        if pulled is not None:
            x = pulled.project_position(coordinates.x, parameters["constants"], parameters)
            coordinates = Motion(x, coordinates.v)
        return law.derivative(coordinates, u, parameters)

    def frame(coordinates, u):
        end = _across(field, coordinates, u, dt, rtol, atol)
        return end, end

    _, rest = jax.lax.scan(frame, state.coordinates, frame_inputs(u, dt, steps))
    return stack_first(state.coordinates, rest)


def _across(field: Callable, coordinates: PyTree, u: Float[Array, "l"], dt: Scalar, rtol: float, atol: float) -> PyTree:
    """Return the coordinates after one frame interval; NaN where the solver cannot follow."""
    import diffrax  # not at every start: it takes half a second, and few use it

    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        diffrax.Dopri5(),
        t0=0.0,
        t1=dt,
        dt0=None,
        y0=coordinates,
        args=u,
        stepsize_controller=diffrax.PIDController(rtol=rtol, atol=atol),
        throw=False,
    )
    arrived = solution.result == diffrax.RESULTS.successful
    return jax.tree.map(lambda y: jnp.where(arrived, y[-1], jnp.nan), solution.ys)


class DormandPrince(AbstractIntegrator):
    """Dormand–Prince 5(4) with as many steps a frame as the tolerances ask for, for any `AbstractField`.

    Where it cannot follow a motion, the rest of that motion is NaN. Its derivative is that of the steps taken, as
    everywhere here; the adjoint equation is not solved.

    Attributes:
        rtol: relative tolerance of a step.
        atol: absolute tolerance of a step. 1e-6 is about the best that float32 can do.
        substeps: parts of a frame that are integrated one after the other; 1 is enough.
    """

    rtol: float = eqx.field(static=True, default=1e-6)
    atol: float = eqx.field(static=True, default=1e-6)
    substeps: int = eqx.field(static=True, default=1)

    def initial_memory(self, field: AbstractField, coordinates: PyTree, parameters: Parameters, h: Scalar) -> None:
        """Return None: each frame begins with a first step of its own."""

    def advance(
        self,
        field: AbstractField,
        coordinates: PyTree,
        memory: None,
        parameters: Parameters,
        u: Float[Array, "l"],
        h: Scalar,
    ) -> tuple[PyTree, None]:
        """Integrate over h."""
        return _across(
            lambda _, s, u: field.derivative(s, u, parameters), coordinates, u, h, self.rtol, self.atol
        ), None


class AdaptiveDynamics(AbstractMechanicalDynamics):
    """A law, integrated by `adaptive_rollout` (paper, appendix A.9).

    Attributes:
        law: as for `adaptive_rollout`.
        rtol: relative tolerance of a step.
        atol: absolute tolerance of a step.
        pull_back: whether the field pulls Φ back to its constants: True is arXiv v1, False the 2024 version.
    """

    law: AbstractLaw
    rtol: float = eqx.field(static=True, default=1e-6)
    atol: float = eqx.field(static=True, default=1e-6)
    pull_back: bool = eqx.field(static=True, default=True)

    def step(self, state: State, u: Float[Array, "l"], dt: Scalar) -> State:
        """Return the state one frame later (earlier for negative dt)."""
        motion = self.rollout(state, u, dt, 1)
        return State(jax.tree.map(lambda y: y[-1], motion), state.parameters)

    def rollout(self, state: State, u: Float[Array, "l"] | Float[Array, "steps l"], dt: Scalar, steps: int) -> Motion:
        """Return the motion at `steps` + 1 frames; see `adaptive_rollout`."""
        law = own_law(self.law, state.parameters)
        return adaptive_rollout(law, state, u, dt, steps, self.rtol, self.atol, self.pull_back)
