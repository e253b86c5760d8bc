"""Lennard-Jones particles in a periodic square: many simulations side by side, in reduced units (ε = σ = m = 1).

Arrays are `[2, N, S]`: axis, particle, simulation. Run inside `jax.enable_x64(True)`.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from keycld._errors import KeycldError

TIME_STEP = 0.002
STEPS_A_FRAME = 5
DAMPING = 0.2
# Steps between two samples of the energy while its mean is taken.
_EVERY = 10
_DESCENT_STEPS, _DESCENT_LENGTH = 4000, 0.02


class Lengths(NamedTuple):
    """Durations of a simulation, in units of τ."""

    thermostat: float
    settling: float
    production: float


def separations(x: Float[Array, "2 N S"], box: float) -> Float[Array, "2 N N S"]:
    """Return difference vectors of all pairs to the nearest periodic images."""
    gap = x[:, :, None, :] - x[:, None, :, :]
    return gap - box * jnp.round(gap / box)


def _pairs(x: Array, box: float) -> tuple[Array, Array, Array]:
    """Return separations, r⁻² of pairs nearer than r_c = L/2 (0 for the others), and which those are."""
    gap = separations(x, box)
    square = jnp.sum(gap**2, axis=0)
    near = (square < (box / 2) ** 2) & (square > 0)
    return gap, jnp.where(near, 1 / jnp.where(near, square, 1.0), 0.0), near


def forces(x: Float[Array, "2 N S"], box: float) -> Float[Array, "2 N S"]:
    """Compute −∂U/∂x of the truncated potential; pairs beyond L/2 do not act."""
    gap, inverse, _ = _pairs(x, box)
    sixth = inverse**3
    return jnp.sum((24 * inverse * sixth * (2 * sixth - 1))[None] * gap, axis=2)


def potential_energy(x: Float[Array, "2 N S"], box: float) -> Float[Array, "S"]:
    """Compute U = Σ u(r) over pairs, u = 4 (r⁻¹² − r⁻⁶) below L/2 and 0 beyond: truncated, not shifted (eqs. 6, 7)."""
    _, inverse, _ = _pairs(x, box)
    return jnp.sum(4 * (inverse**6 - inverse**3), axis=(0, 1)) / 2


def shifted_energy(x: Float[Array, "2 N S"], v: Float[Array, "2 N S"], box: float) -> Float[Array, "S"]:
    """Compute kinetic energy + Σ (u(r) − u(L/2)), which the truncated forces keep constant. U itself jumps at L/2."""
    _, _, near = _pairs(x, box)
    at_cut = 4 * ((2 / box) ** 12 - (2 / box) ** 6)
    return kinetic_energy(v) + potential_energy(x, box) - at_cut * jnp.sum(near, axis=(0, 1)) / 2


def kinetic_energy(v: Float[Array, "2 N S"]) -> Float[Array, "S"]:
    """Compute Σ v²/2."""
    return jnp.sum(v**2, axis=(0, 1)) / 2


def _centred(a: Array) -> Array:
    return a - jnp.mean(a, axis=1, keepdims=True)


def _descend(x: Array, box: float) -> Array:
    """Move away from overlaps: steps along the force, none longer than a fiftieth of σ."""

    def step(_, x):
        force = forces(x, box)
        size = jnp.sqrt(jnp.sum(force**2, axis=0, keepdims=True))
        return x + _DESCENT_LENGTH * force / jnp.maximum(size, 20.0)

    return jax.lax.fori_loop(0, _DESCENT_STEPS, step, x)


def _verlet(state: tuple[Array, Array, Array], box: float) -> tuple[Array, Array, Array]:
    x, v, force = state
    v = v + TIME_STEP / 2 * force
    x = x + TIME_STEP * v
    force = forces(x, box)
    return x, v + TIME_STEP / 2 * force, force


def _noise(keys: Array, step: Array, particles: int) -> Array:
    """Sample uniform numbers of mean 0 and variance 1 whose sum over the particles of a simulation is 0."""

    def one(key):
        return jax.random.uniform(jax.random.fold_in(key, step), (2, particles), jnp.float32, -1.0, 1.0)

    sampled = jnp.moveaxis(jax.vmap(one)(keys), 0, -1).astype(float)
    return jnp.sqrt(3.0) * _centred(sampled)


@partial(jax.jit, static_argnums=(1, 2, 3, 4))
def _simulate(seeds, particles, box, temperature, steps):
    """Return x and v `[2, N, S]` after settling, their forces, and whether the energy can be reached `[S]`."""
    keys = jax.vmap(jax.random.key)(seeds)
    place, speed, bath = jnp.unstack(jax.vmap(lambda key: jax.random.split(key, 3))(keys), axis=1)
    shape = (2, particles)
    x = jax.vmap(lambda key: jax.random.uniform(key, shape, float, -box / 2, box / 2))(place)
    v = jax.vmap(lambda key: jax.random.normal(key, shape, float))(speed)
    x, v = _descend(jnp.moveaxis(x, 0, -1), box), jnp.sqrt(temperature) * _centred(jnp.moveaxis(v, 0, -1))
    keep = np.exp(-TIME_STEP / DAMPING)
    kick = np.sqrt(temperature * (1 - keep**2))

    def thermal(k, state):
        x, v, force = _verlet(state, box)
        return x, keep * v + kick * _noise(bath, k, particles), force

    def accumulate(k, carry):
        state, total = carry
        state = jax.lax.fori_loop(k * _EVERY, (k + 1) * _EVERY, thermal, state)
        return state, total + kinetic_energy(state[1]) + potential_energy(state[0], box)

    samples = steps[0] // _EVERY
    state, total = jax.lax.fori_loop(0, samples, accumulate, ((x, v, forces(x, box)), jnp.zeros(len(seeds))))
    x, v, force = state
    wanted = total / samples - potential_energy(x, box)
    v = v * jnp.sqrt(jnp.maximum(wanted, 0.0) / kinetic_energy(v))[None, None, :]
    state = jax.lax.fori_loop(0, steps[1], lambda _, state: _verlet(state, box), (x, v, force))
    return *state, wanted > 0


@partial(jax.jit, static_argnums=(1, 2, 3))
def _window(state, box, frames, between):
    """Return the state `between` steps later, and x and v of the first `frames` frames."""

    def frame(state, _):
        pictured = state[0] - box * jnp.round(state[0] / box), state[1]
        return jax.lax.fori_loop(0, STEPS_A_FRAME, lambda _, state: _verlet(state, box), state), pictured

    state, (x, v) = jax.lax.scan(frame, state, None, frames)
    rest = between - frames * STEPS_A_FRAME
    return jax.lax.fori_loop(0, rest, lambda _, state: _verlet(state, box), state), x, v


def simulate(
    seeds: np.ndarray, particles: int, density: float, temperature: float, lengths: Lengths, windows: int, frames: int
) -> Float[np.ndarray, "S W T d"]:
    """Simulate, and cut windows of `frames` frames, evenly spaced over the production run of each simulation.

    Protocol of "Which priors matter?", appendix A.1.3: random positions and velocities; descent; velocity Verlet with
    steps of 0.002 τ and a Langevin thermostat (damping time 0.2 τ, no net random force); momenta scaled so that the
    energy is the mean of that run; a run at constant energy to settle; production. A frame is five steps, 0.01 τ.
    The state is x₁, y₁, …, x_N, y_N, then the velocities; positions are in [−L/2, L/2].

    Args:
        seeds: one for each simulation, [S].
        particles: N.
        density: ρ* = N / L², in σ⁻².
        temperature: T*, in ε/k_B.
        lengths: durations, in τ.
        windows: W, cut from each simulation.
        frames: T, of each window.

    Raises:
        KeycldError: the windows do not fit into the production run, or in a simulation the potential energy at the end
            of the thermostat's run exceeds the mean energy.
    """
    box = float(np.sqrt(particles / density))
    steps = tuple(int(round(length / TIME_STEP)) for length in lengths)
    between = steps[2] // windows
    if between < frames * STEPS_A_FRAME:
        raise KeycldError(
            f"{windows} windows of {frames} frames do not fit into {lengths.production:g} τ: take fewer or longer runs."
        )
    *state, reached = _simulate(jnp.asarray(seeds), particles, box, temperature, steps[:2])
    if not np.all(reached):
        raise KeycldError(f"simulation {seeds[np.argmin(reached)]} cannot reach its mean energy: leave it out.")
    out = np.empty((len(seeds), windows, frames, 4 * particles))
    for w in range(windows):
        state, x, v = _window(tuple(state), box, frames, between)
        moved = np.concatenate([np.asarray(a).transpose(3, 0, 2, 1) for a in (x, v)], axis=2)  # [S, T, 2N, 2]
        out[:, w] = moved.reshape(len(seeds), frames, -1)
    return out
