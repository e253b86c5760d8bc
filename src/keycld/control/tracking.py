"""Control with limited or missing inputs: plan a motion, track it, hold the goal, plan again when lost."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from keycld._errors import KeycldError
from keycld.control.base import AbstractController, Belief, spread
from keycld.control.lqr import stationary_gain
from keycld.control.planning import Plan, Planner
from keycld.mechanics import ConstrainedLagrangian, MechanicalDynamics, Motion, Rattle, State

_LOST = 0.25
"""Image-plane units (eight pixels of 64) between a keypoint and its place in the plan."""
_FIRST_LOOK = 8
"""Frames to find the velocity in before the first plan."""


class Tracked(NamedTuple):
    """What the controller remembers.

    Attributes:
        plan: the one that is followed.
        age: frames since it began.
        wait: frames until there may be another one.
        lost: whether one is needed.
    """

    plan: Plan
    age: Int[Array, ""]
    wait: Int[Array, ""]
    lost: Bool[Array, ""]


class PlanAndTrack(AbstractController):
    """Model-predictive control for inputs that are too few or too weak to shape the energy.

    From what is believed after the first frames a motion to the goal is planned in the learned dynamics (`Planner`);
    along it, time-varying linear–quadratic feedback keeps the system on the plan, and at its end stationary feedback
    (`stationary_gain`) holds the goal. A copy that is more than eight pixels from where it should be gets a new plan.

    Tracking is a matrix product a frame. Planning takes longer than a frame and is not counted as a step: in simulation
    the world waits for it.

    Attributes:
        planner: of motions.
        gain: [a, 4K], that holds the goal.
        ahead: [4K, 4K], its cost-to-go.
        rest: frames between two plans of one copy, at least.
    """

    planner: Planner
    gain: Float[Array, "a two_dim"]
    ahead: Float[Array, "two_dim two_dim"]
    rest: int = eqx.field(static=True)

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
            0.7 * limit,  # what is left is for feedback
            dt,
            round(seconds / dt),
        )
        weights = planner.hold._replace(input=planner.hold.input * limit)
        gain, ahead = stationary_gain(dynamics, goal, jnp.zeros(inputs), law.constraint(goal), actuators, dt, weights)
        return cls(planner, jnp.asarray(gain, goal.dtype), jnp.asarray(ahead, goal.dtype), round(0.5 / dt))

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
        return Tracked(nothing, zero, zero + _FIRST_LOOK, jnp.asarray(True))

    def act(self, belief: Belief, memory: Tracked) -> tuple[Float[Array, "l"], Tracked]:
        """Feedback about the plan, and about the goal after its end; nothing before the first plan."""
        plan, age = memory.plan, memory.age
        steps = self.planner.horizon
        z = jnp.concatenate(belief.state.coordinates)
        over = age >= steps
        k = jnp.minimum(age, steps - 1)
        wanted = jnp.where(over, self.planner.goal, plan.z[k])
        away = z - wanted
        gain = jnp.where(over, self.gain, plan.gain[k])
        known = jnp.isfinite(plan.cost)
        feedback = spread(-jnp.sum(gain * away[None, :], axis=1), self.planner.actuators, self.planner.inputs)
        u = jnp.where(known, jnp.where(over, 0.0, plan.u[k]) + feedback, 0.0)
        far = jnp.max(jnp.abs(away[: away.shape[0] // 2])) > _LOST
        return u, Tracked(plan, age + 1, jnp.maximum(memory.wait - 1, 0), far | ~known)

    def attend(self, beliefs: Belief, memories: Tracked, held: Float[np.ndarray, "n l"]) -> Tracked:
        """Plan for the copies that are lost, from where they will be at the next frame."""
        due = np.flatnonzero(np.asarray(memories.lost & (memories.wait == 0)))
        for i in due:
            belief = jax.tree.map(lambda leaf, i=i: leaf[i], beliefs)
            plan = self._plan(belief, jnp.asarray(held[i]))
            fresh = Tracked(plan, jnp.zeros((), jnp.int32), jnp.asarray(self.rest, jnp.int32), jnp.asarray(False))
            memories = jax.tree.map(lambda all, one, i=i: all.at[i].set(one), memories, fresh)
        return memories

    def _plan(self, belief: Belief, held: Float[Array, "l"]) -> Plan:
        constants = belief.state.parameters["constants"]
        next_state = self.planner.dynamics.step(
            State(Motion(*belief.state.coordinates), {"constants": constants}), held, self.planner.dt
        )
        return self.planner(jnp.concatenate(next_state.coordinates), constants, self.ahead)
