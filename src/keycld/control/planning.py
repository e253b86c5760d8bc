"""Trajectory optimisation inside the learned dynamics: the iterative linear–quadratic regulator."""

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from keycld.control.base import spread
from keycld.control.lqr import Weights, frame_step
from keycld.mechanics import AbstractDynamics, matmul, solve_positive

_GUESSES = ((0.4, 0.0), (0.6, math.pi), (0.9, 0.0), (1.2, math.pi))
"""Frequencies (Hz) and phases of the oscillating inputs that the search is initialised with."""
_NEW = 0.7
"""Share of the limit that a new plan may use."""
_REFINED = 0.95
"""Share of the limit that a refined plan may use."""
_STEPS = (1.0, 0.5, 0.25, 0.1, 0.03, 0.01, 0.003)
"""Step lengths of the line search."""


class Plan(NamedTuple):
    """A motion to the goal, with the feedback gains that keep the system on it.

    Attributes:
        z: [H + 1, 4K], positions and velocities at each frame.
        u: [H, l], inputs.
        gain: [H, a, 4K]: u = u_k − K_k (z − z_k) for the inputs that act.
        cost: of the motion.
    """

    z: Float[Array, "frames two_dim"]
    u: Float[Array, "steps l"]
    gain: Float[Array, "steps a two_dim"]
    cost: Float[Array, ""]


class Planner(eqx.Module):
    """Finds motions to a goal under limited inputs by iLQR (Li and Todorov 2004) on the learned dynamics.

    It minimises

        Σ_k dt (q_k ‖z_k − z*‖² + r w_k²) + 10 ‖z_H − z*‖²,   u = share · limit · tanh w,

    over w, so the limit holds by construction; q = 0.05 before the arrival at the goal and 1 from then on. Each
    iteration linearises the dynamics along the motion, solves the linear–quadratic problem backward in time, and
    searches forward along its feedback law. Finally the Riccati equation along the motion gives the tracking gains.

    A new plan is the best of four searches, initialised with oscillations. It uses only a share of the limit: a motion
    that needs the whole input cannot be corrected on the way. `refine` corrects it and may use more.

    Attributes:
        dynamics: learned, or true.
        goal: z* [4K], image-plane units and units/s.
        actuators: positions of the inputs that act.
        inputs: l, the number of all inputs.
        limit: the largest |u|.
        dt: seconds between frames.
        horizon: H, frames of a plan.
        stay: the last of them, in which the goal is to be held.
        iterations: of the search for a new plan.
        refinements: iterations of the search from an older plan.
        effort: r. A high value gives slow motions with inputs far from the limit: the learned accelerations of fast
            motions are less accurate, and feedback needs what the plan leaves of the input.
        reach: deviations of equal cost in ‖z − z*‖².
        hold: deviations of equal cost in tracking.

    Good values: 4 s, half a second of which are to hold the goal; 80 iterations, 6 refinements.
    """

    dynamics: AbstractDynamics
    goal: Float[Array, "two_dim"]
    actuators: tuple[int, ...] = eqx.field(static=True)
    inputs: int = eqx.field(static=True)
    limit: float
    dt: float
    horizon: int = eqx.field(static=True)
    stay: int = eqx.field(static=True)
    iterations: int = eqx.field(static=True, default=80)
    refinements: int = eqx.field(static=True, default=6)
    effort: float = 0.3
    reach: Weights = Weights(0.2, 0.25, 1.0)
    hold: Weights = Weights(0.1, 1.0, 0.3)

    @eqx.filter_jit
    def __call__(self, z: Float[Array, "two_dim"], constants: Float[Array, "n"], ahead: Float[Array, "s s"]) -> Plan:
        """Return a new plan.

        Args:
            z: (x, v) [4K] at the first frame of the plan.
            constants: of the constraints, [n].
            ahead: cost-to-go [4K, 4K] at the goal, from which the tracking gains are computed backward.
        """
        time = self.dt * jnp.arange(self.horizon)
        guesses = jnp.stack([0.5 * jnp.sin(2 * math.pi * f * time + phase) for f, phase in _GUESSES])
        w = jnp.broadcast_to(guesses[:, :, None], (*guesses.shape, len(self.actuators)))
        search = lambda w: self._search(z, w, constants, _NEW, self.arrival, self.iterations)  # noqa: E731
        motions, us, costs = jax.vmap(search)(w)
        best = jnp.argmin(costs)
        return Plan(motions[best], us[best], self._tracking(motions[best], us[best], constants, ahead), costs[best])

    @eqx.filter_jit
    def refine(
        self,
        z: Float[Array, "two_dim"],
        plan: Plan,
        age: Int[Array, ""],
        left: Int[Array, ""],
        hold: Float[Array, "a two_dim"],
        constants: Float[Array, "n"],
        ahead: Float[Array, "s s"],
    ) -> Plan:
        """Return a plan near the motion that the feedback of an older plan would cause.

        Args:
            z: (x, v) [4K] at the first frame of the plan.
            plan: the older one.
            age: the frame of the older plan that `z` belongs to.
            left: frames until the goal is to be reached.
            hold: stationary gain [a, 4K], used after the older plan's end.
            constants: of the constraints, [n].
            ahead: as for a new plan.
        """
        act = jnp.asarray(self.actuators)

        def move(z, k):
            u = self.follow(plan, hold, z, k)[act]
            w = jnp.arctanh(jnp.clip(u / (_REFINED * self.limit), -0.97, 0.97))
            return self._step(z, w, constants, _REFINED), w

        _, w = jax.lax.scan(move, z, age + jnp.arange(self.horizon))
        motion, u, cost = self._search(z, w, constants, _REFINED, left, self.refinements)
        return Plan(motion, u, self._tracking(motion, u, constants, ahead), cost)

    def follow(
        self, plan: Plan, hold: Float[Array, "a two_dim"], z: Float[Array, "two_dim"], k: Int[Array, ""]
    ) -> Float[Array, "l"]:
        """Return the input at the plan's frame `k`: feedback about the plan, after its end about the goal by `hold`."""
        over, k = k >= self.horizon, jnp.minimum(k, self.horizon - 1)
        away = z - jnp.where(over, self.goal, plan.z[k])
        feedback = spread(-_times(jnp.where(over, hold, plan.gain[k]), away), self.actuators, self.inputs)
        return jnp.where(over, 0.0, plan.u[k]) + feedback

    @property
    def arrival(self) -> int:
        """The frame of a plan at which the goal is to be reached."""
        return self.horizon - self.stay

    def _input(self, w: Array, share: float) -> Array:
        return spread(share * self.limit * jnp.tanh(w), self.actuators, self.inputs)

    def _step(self, z: Array, w: Array, constants: Array, share: float) -> Array:
        return frame_step(self.dynamics, z, self._input(w, share), constants, self.dt)

    def _search(
        self, initial: Array, w: Array, constants: Array, share: float, left: int | Array, iterations: int
    ) -> tuple[Array, Array, Array]:
        weight = jnp.diagonal(self.reach.state_cost(self.goal.shape[0] // 2))
        urgency = jnp.where(jnp.arange(self.horizon) < left, 0.05, 1.0)
        running, final, effort = self.dt * urgency[:, None] * weight[None, :], 10 * weight, self.effort * self.dt

        def step(z, w):
            return self._step(z, w, constants, share)

        def cost(z, w):
            away = (z - self.goal[None, :]) ** 2
            return 0.5 * (jnp.sum(away[:-1] * running) + jnp.sum(away[-1] * final) + effort * jnp.sum(w * w))

        def forward(length, z, w, feed, gain):
            def body(now, each):
                z, w, feed, gain = each
                w = jnp.clip(w + length * feed + _times(gain, now - z), -3.0, 3.0)
                return step(now, w), (now, w)

            last, (path, w) = jax.lax.scan(body, z[0], (z[:-1], w, feed, gain))
            path = jnp.concatenate([path, last[None]])
            return path, w, cost(path, w)

        def iterate(carry, _):
            z, w, best, damping = carry
            a, b = jax.vmap(jax.jacfwd(step, argnums=(0, 1)))(z[:-1], w)

            def backward(carry, each):
                slope, bend = carry
                a, b, z, w, running = each
                qz = running * (z - self.goal) + _times(a.T, slope)
                qw = effort * w + _times(b.T, slope)
                ba = matmul(b.T, bend)
                qww = matmul(ba, b) + (effort + damping) * jnp.eye(w.shape[0])
                qwz = matmul(ba, a)
                feed = -solve_positive(qww, qw)
                gain = -jax.vmap(solve_positive, in_axes=(None, 1), out_axes=1)(qww, qwz)
                slope = qz + _times(gain.T, _times(qww, feed) + qw) + _times(qwz.T, feed)
                bend = jnp.diag(running) + matmul(a.T, matmul(bend, a))
                bend = bend + matmul(gain.T, matmul(qww, gain) + qwz) + matmul(qwz.T, gain)
                return (slope, 0.5 * (bend + bend.T)), (feed, gain)

            end = (final * (z[-1] - self.goal), jnp.diag(final))
            _, (feed, gain) = jax.lax.scan(backward, end, (a, b, z[:-1], w, running), reverse=True)
            paths, ws, costs = jax.vmap(lambda s: forward(s, z, w, feed, gain))(jnp.array(_STEPS))
            costs = jnp.where(jnp.isfinite(costs), costs, jnp.inf)
            chosen = jnp.argmin(costs)
            better = costs[chosen] < best
            damping = jnp.where(better, jnp.maximum(0.5 * damping, 1e-6), jnp.minimum(4 * damping, 1e4))
            z = jnp.where(better, paths[chosen], z)
            w = jnp.where(better, ws[chosen], w)
            return (z, w, jnp.where(better, costs[chosen], best), damping), None

        still = jnp.zeros((self.horizon, w.shape[1]))
        still_gain = jnp.zeros((self.horizon, w.shape[1], initial.shape[0]))
        z0 = jnp.broadcast_to(initial[None, :], (self.horizon + 1, initial.shape[0]))
        z, w, first = forward(0.0, z0, w, still, still_gain)
        # A guess that diverges is the worst one, not one that no other can be compared with.
        first = jnp.where(jnp.isfinite(first), first, jnp.inf)
        carry, _ = jax.lax.scan(iterate, (z, w, first, jnp.float32(1e-2)), length=iterations)
        z, w, best, _ = carry
        return z, jax.vmap(lambda w: self._input(w, share))(w), best

    def _tracking(self, z: Array, u: Array, constants: Array, ahead: Array) -> Array:
        act = jnp.asarray(self.actuators)

        def step(z, u):
            return frame_step(self.dynamics, z, u, constants, self.dt)

        a, b = jax.vmap(jax.jacfwd(step, argnums=(0, 1)))(z[:-1], u)
        cost = jnp.asarray(self.hold.state_cost(z.shape[1] // 2), z.dtype)
        effort = jnp.eye(len(self.actuators)) / (self.hold.input * self.limit) ** 2

        def backward(bend, each):
            a, b = each
            ba = matmul(b.T, bend)
            gain = jax.vmap(solve_positive, in_axes=(None, 1), out_axes=1)(effort + matmul(ba, b), matmul(ba, a))
            bend = cost + matmul(a.T, matmul(bend, a)) - matmul(matmul(ba, a).T, gain)
            return 0.5 * (bend + bend.T), gain

        return jax.lax.scan(backward, ahead, (a, b[:, :, act]), reverse=True)[1]


def _times(a: Array, b: Array) -> Array:
    return jnp.sum(a * b[None, :], axis=1)
