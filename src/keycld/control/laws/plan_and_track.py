"""Control with weak or missing inputs: plan a motion, track it, hold the goal, replan when the plan has failed."""

import math
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from keycld._errors import KeycldError
from keycld.control.base import AbstractController, Belief
from keycld.control.lqr import frame_step, stationary_gain
from keycld.control.planning import Plan, Planner
from keycld.control.registry import AbstractControlLaw, Problem, Trust, register_law
from keycld.control.requirements import check_finite_limit
from keycld.mechanics import ConstrainedLagrangian, MechanicalDynamics, Rattle

_LOST = 0.25
"""Image-plane units (eight pixels of 64): farther than this from the plan, a copy needs a new plan."""
_MISSES = 0.15
"""Image-plane units: a refined plan that ends farther than this from the goal does not reach it."""
_LATE = 25
"""Frames after the planned arrival until the goal has to be near."""
_STAY = 0.5
"""Seconds at the end of a plan in which the goal is to be held."""
_FIRST_FRAMES = 8
"""Frames that the velocity is estimated from before the first plan."""
_frame_step = eqx.filter_jit(frame_step)


class Tracked(NamedTuple):
    """Memory of the controller.

    Attributes:
        plan: the plan that is followed.
        age: number of its next frame.
        clock: frames since the last new plan; refinements do not count.
        lost: whether a new plan is needed.
    """

    plan: Plan
    age: Int[Array, ""]
    clock: Int[Array, ""]
    lost: Bool[Array, ""]


class PlanAndTrack(AbstractController):
    """Model-predictive control for inputs that are too few or too weak to shape the energy.

    After the first frames a motion to the goal is planned in the learned dynamics (`Planner`). Along it, time-varying
    linear–quadratic feedback u = u_k − K_k (z − z_k) keeps the system on the plan, with z = (x, v); at its end,
    stationary feedback (`stationary_gain`) holds the goal. On the way the plan is refined every fifth of a second from
    the estimated state: near the upright pose errors of the acrobot grow e-fold in less than half a second, and
    feedback under a limit corrects only small ones. A copy whose keypoints are more than eight pixels off the plan, or
    whose refined plan misses the goal, gets a new plan.

    Tracking is one matrix product a frame. Planning takes longer than a frame and is not counted as a step: in
    simulation the world waits for it.

    Attributes:
        planner: of motions.
        gain: [a, 4K], the stationary gain that holds the goal.
        ahead: [4K, 4K], the cost-to-go at the goal.
        rest: the least number of frames between two new plans of one copy.
        refresh: frames between two refinements.

    Good values: plans of 4 s, refined every 0.2 s, at most one new plan every 0.5 s.
    """

    planner: Planner
    gain: Float[Array, "a two_dim"]
    ahead: Float[Array, "two_dim two_dim"]
    rest: int = eqx.field(static=True)
    refresh: int = eqx.field(static=True)

    @classmethod
    def towards(
        cls,
        law: ConstrainedLagrangian,
        goal: Float[Array, "dim"],
        actuators: tuple[int, ...],
        limit: float,
        dt: float,
        seconds: float = 4.0,
    ) -> "PlanAndTrack":
        """Return a controller for a goal.

        Args:
            law: learned masses, potential energy, input matrix, constraints.
            goal: x* [2K], image-plane units.
            actuators: positions of the inputs that act.
            limit: the largest |u|, finite.
            dt: seconds between frames.
            seconds: length of a plan.

        Raises:
            KeycldError: there is no limit, or the inputs cannot hold the goal.
        """
        check_finite_limit(limit, "a planned motion needs")
        # One step a frame is enough for a plan that feedback follows.
        dynamics = MechanicalDynamics(law, Rattle(substeps=1))
        inputs = law.inputs
        planner = Planner(
            dynamics,
            jnp.concatenate([goal, 0 * goal]),
            actuators,
            inputs,
            limit,
            dt,
            round(seconds / dt),
            round(_STAY / dt),
        )
        weights = planner.hold._replace(input=planner.hold.input * limit)
        gain, ahead = stationary_gain(dynamics, goal, jnp.zeros(inputs), law.constraint(goal), actuators, dt, weights)
        matrices = jnp.asarray(gain, goal.dtype), jnp.asarray(ahead, goal.dtype)
        return cls(planner, *matrices, rest=round(0.5 / dt), refresh=round(0.2 / dt))

    def initial_memory(self) -> Tracked:
        """Return a memory without a plan."""
        steps, size = self.planner.horizon, self.planner.goal.shape[0]
        nothing = Plan(
            jnp.zeros((steps + 1, size)),
            jnp.zeros((steps, self.planner.inputs)),
            jnp.zeros((steps, len(self.planner.actuators), size)),
            jnp.asarray(jnp.inf),
        )
        zero = jnp.zeros((), jnp.int32)
        return Tracked(nothing, zero, zero + self.rest - _FIRST_FRAMES, jnp.asarray(True))

    def act(self, belief: Belief, memory: Tracked) -> tuple[Float[Array, "l"], Tracked]:
        """Return feedback about the plan, about the goal after its end, and zero before the first plan."""
        plan, age, clock = memory.plan, memory.age, memory.clock
        z, goal, last = jnp.concatenate(belief.state.coordinates), self.planner.goal, self.planner.horizon
        known = jnp.isfinite(plan.cost)
        u = jnp.where(known, self.planner.follow(plan, self.gain, z, age), 0.0)
        late = clock > self.planner.arrival + _LATE
        off_plan = _distance(z, plan.z[jnp.minimum(age, last)]) > _LOST
        lost = ~known | off_plan | (late & (_distance(z, goal) > _LOST))
        return u, Tracked(plan, age + 1, clock + 1, lost)

    def replan(self, beliefs: Belief, memories: Tracked, held: Float[np.ndarray, "n l"]) -> Tracked:
        """Plan for the copies that are lost and refine the others' plans, from their state at the next frame."""
        clock, lost = np.asarray(memories.clock), np.asarray(memories.lost)
        known = np.isfinite(np.asarray(memories.plan.cost))
        on_the_way = known & ~lost & (clock % self.refresh == 0) & (clock < self.planner.arrival)
        for i in np.flatnonzero(on_the_way | (lost & (clock >= self.rest))):
            belief, memory = jax.tree.map(lambda leaf, i=i: leaf[i], (beliefs, memories))
            memory = self._plan(belief, memory, jnp.asarray(held[i]))
            memories = jax.tree.map(lambda all, one, i=i: all.at[i].set(one), memories, memory)
        return memories

    def _plan(self, belief: Belief, memory: Tracked, held: Float[Array, "l"]) -> Tracked:
        constants = belief.state.parameters["constants"]
        z = _frame_step(
            self.planner.dynamics, jnp.concatenate(belief.state.coordinates), held, constants, self.planner.dt
        )
        if not memory.lost:
            left = self.planner.arrival - memory.clock
            plan = self.planner.refine(z, memory.plan, memory.age, left, self.gain, constants, self.ahead)
            arrives = jnp.isfinite(plan.cost) & (_distance(plan.z[-1], self.planner.goal) < _MISSES)
            if arrives:
                return memory._replace(plan=plan, age=jnp.zeros((), jnp.int32))
            if memory.clock < self.rest:
                return memory
        zero = jnp.zeros((), jnp.int32)
        return Tracked(self.planner(z, constants, self.ahead), zero, zero, jnp.asarray(False))


def _distance(z: Array, other: Array) -> Array:
    """Return the largest difference of a keypoint's coordinate."""
    return jnp.max(jnp.abs(z - other)[: z.shape[0] // 2])


@register_law
@dataclass(frozen=True)
class PlanAndTrackLaw(AbstractControlLaw):
    """Model-predictive control: plan a motion, track it, replan; for weak or missing inputs. Needs --limit.

    Attributes:
        horizon: length of a plan, seconds.
    """

    name: ClassVar[str] = "mpc"
    # A plan relies on the learned dynamics and needs accurate velocities more than the missing acceleration.
    trust: ClassVar[Trust] = Trust(acceleration_error=1.0, adaptation=0.0)
    horizon: float = 4.0

    def __post_init__(self):
        """Check that a plan has time to reach the goal before it holds it."""
        if not _STAY < self.horizon < math.inf:
            raise KeycldError(
                f"setting horizon is longer than {_STAY} s, in which it holds the goal, and finite, not {self.horizon}."
            )

    def controller(self, problem: Problem) -> PlanAndTrack:
        """Return the controller for a problem.

        Raises:
            KeycldError: there is no limit, or the inputs cannot hold the goal.
        """
        law, goal, actuators, limit, dt, _ = problem
        return PlanAndTrack.towards(law, goal, actuators, limit, dt, self.horizon)
