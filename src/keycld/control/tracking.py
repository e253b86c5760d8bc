"""Control with limited or missing inputs: plan a motion, track it, hold the goal, plan again when lost."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from keycld._errors import KeycldError
from keycld.control.base import AbstractController, Belief
from keycld.control.lqr import frame_step, stationary_gain
from keycld.control.planning import Plan, Planner
from keycld.mechanics import ConstrainedLagrangian, MechanicalDynamics, Rattle

_LOST = 0.25
"""Image-plane units (eight pixels of 64) between a keypoint and where it should be."""
_MISSES = 0.15
"""The same at the end of a refined plan, which then does not reach the goal."""
_LATE = 25
"""Frames after the arrival in which the goal has to be near."""
_FIRST_LOOK = 8
"""Frames to find the velocity in before the first plan."""


class Tracked(NamedTuple):
    """What the controller remembers.

    Attributes:
        plan: the one that is followed.
        age: its frame that is next.
        clock: frames since the last plan from nothing.
        lost: whether another one is needed.
    """

    plan: Plan
    age: Int[Array, ""]
    clock: Int[Array, ""]
    lost: Bool[Array, ""]


class PlanAndTrack(AbstractController):
    """Model-predictive control for inputs that are too few or too weak to shape the energy.

    From what is believed after the first frames a motion to the goal is planned in the learned dynamics (`Planner`);
    along it, time-varying linear–quadratic feedback keeps the system on the plan, and at its end stationary feedback
    (`stationary_gain`) holds the goal. On the way the plan is refined every fifth of a second from where the system is:
    near the upright acrobot errors grow e-fold in less than half a second, and feedback under a limit mends small ones
    only. A copy that is eight pixels from where it should be, or whose refined plan misses the goal, gets a new plan.

    Tracking is a matrix product a frame. Planning takes longer than a frame and is not counted as a step: in simulation
    the world waits for it.

    Attributes:
        planner: of motions.
        gain: [a, 4K], that holds the goal.
        ahead: [4K, 4K], its cost-to-go.
        rest: frames between two plans of one copy from nothing, at least.
        refresh: frames between two refinements.
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
        """A controller for a goal.

        Args:
            law: learned masses, potential energy, input matrix, constraints.
            goal: x* [2K].
            actuators: numbers of the inputs that act.
            limit: the largest |u|, finite.
            dt: seconds between frames.
            seconds: of a plan.

        Raises:
            KeycldError: there is no limit, or the inputs cannot hold the goal.
        """
        if not np.isfinite(limit):
            raise KeycldError("a planned motion needs an input limit: give one, such as --limit 3.")
        # One step a frame is enough for a plan that feedback follows.
        dynamics = MechanicalDynamics(law, Rattle(substeps=1))
        inputs = law.fields(goal)[1].shape[1]  # pyright: ignore[reportOptionalMemberAccess]
        planner = Planner(
            dynamics,
            jnp.concatenate([goal, 0 * goal]),
            actuators,
            inputs,
            limit,
            dt,
            round(seconds / dt),
            round(0.5 / dt),
        )
        weights = planner.hold._replace(input=planner.hold.input * limit)
        gain, ahead = stationary_gain(dynamics, goal, jnp.zeros(inputs), law.constraint(goal), actuators, dt, weights)
        matrices = jnp.asarray(gain, goal.dtype), jnp.asarray(ahead, goal.dtype)
        return cls(planner, *matrices, rest=round(0.5 / dt), refresh=round(0.2 / dt))

    def begin(self) -> Tracked:
        """No plan yet."""
        steps, size = self.planner.horizon, self.planner.goal.shape[0]
        nothing = Plan(
            jnp.zeros((steps + 1, size)),
            jnp.zeros((steps, self.planner.inputs)),
            jnp.zeros((steps, len(self.planner.actuators), size)),
            jnp.asarray(jnp.inf),
        )
        zero = jnp.zeros((), jnp.int32)
        return Tracked(nothing, zero, zero + self.rest - _FIRST_LOOK, jnp.asarray(True))

    def act(self, belief: Belief, memory: Tracked) -> tuple[Float[Array, "l"], Tracked]:
        """Feedback about the plan, and about the goal after its end; nothing before the first plan."""
        plan, age, clock = memory.plan, memory.age, memory.clock
        z, goal, last = jnp.concatenate(belief.state.coordinates), self.planner.goal, self.planner.horizon
        known = jnp.isfinite(plan.cost)
        u = jnp.where(known, self.planner.follow(plan, self.gain, z, age), 0.0)
        late = clock > self.planner.arrival + _LATE
        off_plan = _distance(z, plan.z[jnp.minimum(age, last)]) > _LOST
        lost = ~known | off_plan | (late & (_distance(z, goal) > _LOST))
        return u, Tracked(plan, age + 1, clock + 1, lost)

    def attend(self, beliefs: Belief, memories: Tracked, held: Float[np.ndarray, "n l"]) -> Tracked:
        """Plan for the copies that are lost and refine the others' plans, from where they will be at the next frame."""
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
        z = frame_step(
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
    """The largest difference of a keypoint's coordinate."""
    return jnp.max(jnp.abs(z - other)[: z.shape[0] // 2])
