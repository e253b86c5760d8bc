"""Motions as functions of what is not known of them: initial states on the constraints, parameters of the law."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, PyTree

from keycld.mechanics.dynamics import MechanicalDynamics
from keycld.mechanics.integrators import RK4
from keycld.mechanics.lagrangian import ConstrainedLagrangian
from keycld.mechanics.state import Motion, State

# Rotation in a sub-step of the classical Runge–Kutta method: a frequency is wrong by about 1e-6 of it.
_TURN = 0.12
# Recordings that are differentiated at a time.
_CHUNK = 8


class Unknowns(eqx.Module):
    """η = (θ, c): the free parameters of the dynamics, and the constants of Φ that all recordings share.

    Attributes:
        rest: the dynamics without θ.
        unravel: θ → the free parameters of the dynamics.
        size: how many numbers θ has.
    """

    rest: PyTree
    unravel: Callable = eqx.field(static=True)
    size: int = eqx.field(static=True)

    @classmethod
    def of(
        cls, dynamics: MechanicalDynamics, free: PyTree, observed: Float[np.ndarray, "N T dim"]
    ) -> "tuple[Unknowns, np.ndarray]":
        """Return the unknowns of dynamics in float64, integrated exactly, and η with the mean of Φ over observations.

        Call it inside `jax.enable_x64(True)`.
        """
        double = jax.tree.map(
            lambda leaf: jnp.asarray(np.asarray(leaf), float) if eqx.is_inexact_array(leaf) else leaf, dynamics
        )
        exact, spec = (eqx.tree_at(lambda d: d.integrator, d, RK4(_substeps(observed))) for d in (double, free))
        theta, rest = eqx.partition(exact, spec)
        flat, unravel = ravel_pytree(theta)
        every = jnp.asarray(observed.reshape(-1, observed.shape[-1]))
        c = np.mean(np.asarray(jax.vmap(_lagrangian(exact).constraint)(every)), axis=0)
        return cls(rest, unravel, flat.size), np.concatenate([np.asarray(flat), c])

    def __call__(self, eta: Float[Array, "P"]) -> tuple[MechanicalDynamics, Float[Array, "n"]]:
        """Return the dynamics and the constants of Φ that η stands for."""
        return eqx.combine(self.unravel(eta[: self.size]), self.rest), eta[self.size :]

    def law(self, eta: Float[Array, "P"]) -> tuple[ConstrainedLagrangian, Float[Array, "n"]]:
        """Return the law and the constants of Φ that η stands for."""
        dynamics, constants = self(eta)
        return _lagrangian(dynamics), constants


class Sensitivity(eqx.Module):
    """Motions near a reference and their derivatives.

    Attributes:
        initial: initial states of the reference, on the constraints, `[N, dim]` each.
        basis: orthonormal columns `[N, dim, m]` of ker DΦ at the initial positions: local coordinates.
        x: positions of the reference `[N, T, dim]`.
        slopes: ∂x / ∂(local coordinates of position and of velocity, η) `[N, T, dim, 2m + P]`; those of the velocity
            are in units of 1 / `clock`.
        clock: seconds.
    """

    initial: Motion
    basis: np.ndarray
    x: np.ndarray
    slopes: np.ndarray
    clock: float

    @property
    def local(self) -> int:
        """2m, the number of local coordinates of an initial state."""
        return 2 * self.basis.shape[-1]

    def moved(self, moves: Float[np.ndarray, "N m2"]) -> Motion:
        """Return the initial states with other local coordinates, to first order."""
        along, rate = np.split(moves, 2, axis=1)
        return Motion(
            self.initial.x + jnp.asarray(np.einsum("ndm,nm->nd", self.basis, along)),
            self.initial.v + jnp.asarray(np.einsum("ndm,nm->nd", self.basis, rate) / self.clock),
        )


def sensitivity(unknowns: Unknowns, eta: Any, initial: Motion, u: Any, dt: Any, frames: int) -> Sensitivity:
    """Integrate motions over some frames together with their exact derivatives, in float64.

    Args:
        unknowns: what η means.
        eta: its value `[P]`.
        initial: initial states `[N, dim]` each; they are projected on the constraints.
        u: inputs `[N, l]` or `[N, ≥ frames − 1, l]`.
        dt: seconds between frames.
        frames: T.
    """
    on, jacobian = _projected(unknowns, jnp.asarray(eta), Motion(*map(jnp.asarray, initial)))
    basis = _kernels(np.asarray(jacobian))
    clock = float(dt) * frames / 2
    x, slopes = _differentiated(
        unknowns, jnp.asarray(eta), on, jnp.asarray(basis), jnp.asarray(clock), u, jnp.asarray(dt), frames
    )
    return Sensitivity(on, basis, np.asarray(x), np.asarray(slopes), clock)


@eqx.filter_jit
def paths(unknowns: Unknowns, eta: Array, initial: Motion, u: Array, dt: Array, frames: int) -> Array:
    """Return the positions `[N, T, dim]` of motions whose initial states are projected on the constraints first."""
    dynamics, constants = unknowns(eta)

    def one(start: Motion, u: Array) -> Array:
        return _path(dynamics, constants, _on(_lagrangian(dynamics), constants, start), u, dt, frames)

    return jax.vmap(one)(initial, u)


@eqx.filter_jit
def _differentiated(
    unknowns: Unknowns, eta: Array, initial: Motion, basis: Array, clock: Array, u: Array, dt: Array, frames: int
) -> tuple[Array, Array]:
    half = basis.shape[-1]

    def one(arguments: tuple) -> tuple[Array, Array]:
        start, basis, u = arguments

        def path(both: Array) -> tuple[Array, Array]:
            dynamics, constants = unknowns(both[2 * half :])
            near = Motion(
                start.x + jnp.sum(basis * both[None, :half], axis=1),
                start.v + jnp.sum(basis * both[None, half : 2 * half], axis=1) / clock,
            )
            x = _path(dynamics, constants, _on(_lagrangian(dynamics), constants, near), u, dt, frames)
            return x, x

        slopes, x = jax.jacfwd(path, has_aux=True)(jnp.concatenate([jnp.zeros(2 * half), eta]))
        return x, slopes

    return jax.lax.map(one, (initial, basis, u), batch_size=min(_CHUNK, len(basis)))


@eqx.filter_jit
def _projected(unknowns: Unknowns, eta: Array, initial: Motion) -> tuple[Motion, Array]:
    law, constants = unknowns.law(eta)

    def one(start: Motion) -> tuple[Motion, Array]:
        on = _on(law, constants, start)
        return on, law.jacobian(on.x)

    return jax.vmap(one)(initial)


def _on(law: ConstrainedLagrangian, constants: Array, start: Motion) -> Motion:
    x = law.project_position(start.x, constants)
    return Motion(x, law.project_velocity(x, start.v))


def _path(dynamics: MechanicalDynamics, constants: Array, start: Motion, u: Array, dt: Array, frames: int) -> Array:
    state = State(start, {"constants": constants})
    return dynamics.rollout(state, u if u.ndim == 1 else u[: frames - 1], dt, frames - 1).x


def _kernels(jacobian: Float[np.ndarray, "N n dim"]) -> np.ndarray:
    """Return orthonormal bases of the kernels; all have the size of the most frequent one."""
    count, rows, dim = jacobian.shape
    if not rows:
        return np.tile(np.eye(dim), (count, 1, 1))
    _, values, vectors = np.linalg.svd(jacobian, full_matrices=True)
    rank = int(np.median(np.sum(values > 1e-8 * values[:, :1], axis=1)))
    return np.swapaxes(vectors[:, rank:], 1, 2)


def _substeps(observed: np.ndarray) -> int:
    """Return so many sub-steps that the fastest keypoint turns little in each: 1, 4 or 16, to compile few programs."""
    moved = np.percentile(np.abs(np.diff(observed, axis=1)), 99, axis=(0, 1))
    spread = np.std(observed, axis=(0, 1))
    # A sine of amplitude A has the deviation A/√2, and moves by up to A ω dt in a frame.
    turn = float(np.max(moved / (np.sqrt(2) * spread + 1e-12), initial=0.0))
    return 4 ** int(np.clip(np.ceil(np.log(max(turn / _TURN, 1e-3)) / np.log(4)), 0, 2))


def _lagrangian(dynamics: MechanicalDynamics) -> ConstrainedLagrangian:
    assert isinstance(dynamics.law, ConstrainedLagrangian)
    return dynamics.law
