"""Integrators: order, symplectic behaviour, reversal, sub-steps, and golden trajectories."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mechanics_examples import GOLDEN, cartpole, double_pendulum, end, initial_state, last, law, on_circle, rollout

from keycld import KeycldError
from keycld.mechanics import (
    RK2,
    RK4,
    Euler,
    GeneralizedLagrangian,
    Leapfrog,
    MechanicalDynamics,
    Motion,
    Rattle,
    Shake,
    State,
)


def push(x):
    """An input matrix that depends on the positions."""
    return jnp.stack([x[1], -x[0], jnp.ones_like(x[0]), x[2]])[:, None]


def springs(x):
    """A smooth potential without symmetry."""
    return 2.0 * jnp.sum(x * x) + jnp.sum(jnp.cos(3 * x)) + x[0] * x[2]


FREE = dict(input_matrix=push, potential=springs)
CASES = {
    "Euler": (Euler, "constrained", 1),
    "RK2": (RK2, "constrained", 2),
    "RK4": (RK4, "constrained", 4),
    "Leapfrog": (Leapfrog, "free", 2),
    "Shake": (Shake, "constrained", 2),
    "Rattle": (Rattle, "constrained", 2),
    "Rattle, damped": (Rattle, "damped", 2),
    "Rattle, free": (Rattle, "free", 2),
}


def errors(make, kind, counts, exact_steps):
    if kind == "free":
        system = law([1.0, 0.5], None, **FREE)
        state = initial_state(system, jnp.array([0.3, -0.4, 0.5, 0.1]), jnp.array([1.0, 0.0, -0.5, 0.2]))
    else:
        lower = jnp.array([[0.64, 0.0], [0.24, 0.45]]) if kind == "damped" else None
        system = double_pendulum(input_matrix=push, damping=lower)
        state = initial_state(system, on_circle([1.0, 0.3]), jnp.array([1.0, 0.5, -0.5, 0.2]))
    u, time = jnp.array([0.7]), 0.8
    exact = end(MechanicalDynamics(system, RK4()), state, u, time / exact_steps, exact_steps).coordinates
    found = []
    for count in counts:
        motion = end(MechanicalDynamics(system, make()), state, u, time / count, count).coordinates
        error = float(jnp.abs(motion.x - exact.x).max())
        if make is not Shake:  # whose velocity is not tangential
            error = max(error, float(jnp.abs(motion.v - exact.v).max()))
        found.append(error)
    return np.array(found)


@pytest.mark.parametrize("case", CASES)
def test_order_of_convergence_in_float64(case):
    make, kind, order = CASES[case]
    with jax.enable_x64(True):
        found = errors(make, kind, (80, 160, 320), 2000)
    np.testing.assert_allclose(np.log2(found[:-1] / found[1:]), order, atol=0.15)


@pytest.mark.parametrize("case", ["Euler", "RK2", "Rattle", "Leapfrog"])
def test_order_of_convergence_in_float32(case):
    make, kind, order = CASES[case]
    found = errors(make, kind, (20, 40, 80), 400)
    np.testing.assert_allclose(np.log2(found[:-1] / found[1:]), order, atol=0.35)


@pytest.mark.parametrize(
    ("name", "integrator"), [("euler", Euler()), ("rk2", RK2()), ("rk4", RK4()), ("leap_frog", Leapfrog())]
)
def test_golden_pendulum(name, integrator):
    """H = p²/2 − cos q as a free mass whose second coordinate rests."""
    golden = np.load(GOLDEN / f"{name}.npz")
    with jax.enable_x64(True):
        system = law([1.0], None, potential=lambda x: -jnp.cos(x[0]))
        state = initial_state(system, jnp.array([golden["q0"], 0.0]), jnp.array([golden["p0"], 0.0]))
        dynamics = MechanicalDynamics(system, integrator)
        motion = rollout(dynamics, state, jnp.zeros(0), float(golden["dt"]), int(golden["num_steps"]))
        np.testing.assert_allclose(motion.x[:, 0], golden["q"], atol=1e-13)
        np.testing.assert_allclose(motion.v[:, 0], golden["p"], atol=1e-13)


def energies(system, state, integrator, dt, steps=10_000):
    @eqx.filter_jit
    def run(system):
        motion = MechanicalDynamics(system, integrator).rollout(state, jnp.zeros(0), dt, steps)
        v = jax.vmap(system.project_velocity)(motion.x, motion.v)
        return motion, jax.vmap(system.energy)(motion.x, v), jax.vmap(system.constraint)(motion.x)

    return run(system)


@pytest.mark.parametrize("integrator", [Rattle(), Shake()], ids=lambda i: type(i).__name__)
def test_energy_stays_bounded_and_the_constraint_holds_over_10000_steps(integrator):
    """A swinging unit-size double pendulum in float32; 10,000 steps are 100 s."""
    system = double_pendulum()
    state = initial_state(system, on_circle([1.2, 1.8]))
    motion, energy, constraint = energies(system, state, integrator, 0.01)
    assert motion.x.dtype == jnp.float32
    assert float(jnp.abs(constraint - constraint[:1]).max()) < 1e-6
    scale = float(energy[0] + 2 * 9.81 * 1.7)  # above the lowest potential energy, about
    drift = np.abs(np.asarray(energy - energy[0])) / scale
    assert drift.max() < 5e-3
    # No trend: the last tenth is as far off as the first.
    assert drift[-1000:].mean() < 2 * drift[:1000].mean() + 1e-3


def test_leapfrog_energy_stays_bounded_over_10000_steps_and_eulers_does_not():
    system = law([1.0, 0.5], None, potential=springs)
    state = initial_state(system, jnp.array([0.3, -0.4, 0.5, 0.1]), jnp.array([1.0, 0.0, -0.5, 0.2]))
    _, energy, _ = energies(system, state, Leapfrog(), 0.02)
    assert float(jnp.abs(energy - energy[0]).max()) < 0.01 * abs(float(energy[0]))
    _, energy, _ = energies(system, state, Euler(), 0.02, 1000)
    assert float(jnp.abs(energy[-1] - energy[0])) > abs(float(energy[0]))


def test_without_constraints_rattle_is_velocity_verlet_to_the_bit():
    system = law([1.0, 0.5], None, **FREE)
    state = initial_state(system, jnp.array([0.3, -0.4, 0.5, 0.1]), jnp.ones(4))
    u = jnp.array([0.3])
    one, other = (rollout(MechanicalDynamics(system, i), state, u, 0.05, 20) for i in (Rattle(2), Leapfrog(2)))
    np.testing.assert_array_equal(one.x, other.x)
    np.testing.assert_array_equal(one.v, other.v)


def test_shake_goes_through_the_positions_of_rattle():
    system = double_pendulum(input_matrix=push)
    state = initial_state(system, on_circle([1.0, 0.3]), jnp.array([1.0, 0.5, -0.5, 0.2]))
    u = jnp.array([0.5])
    with jax.enable_x64(True):
        state, u = jax.tree.map(lambda a: a.astype(jnp.float64), (state, u))
        shake, rattle = (
            rollout(MechanicalDynamics(system, i), state, u, 0.01, 100) for i in (Shake(2, 5), Rattle(2, 5))
        )
        np.testing.assert_allclose(shake.x, rattle.x, atol=1e-12)
        projected = jax.vmap(system.project_velocity)(shake.x, shake.v)
        np.testing.assert_allclose(projected[1:], rattle.v[1:], atol=1e-10)


@pytest.mark.parametrize(
    ("integrator", "damping"),
    [(Rattle(2), None), (Rattle(2), 0.09 * np.eye(2)), (Shake(2), None), (RK4(4), None)],
    ids=["Rattle", "Rattle damped", "Shake", "RK4"],
)
def test_forward_then_backward_returns_to_the_start(integrator, damping):
    """Also with inputs that change from frame to frame: the way back reads the same array in reverse."""
    system = cartpole(input_matrix=push, damping=None if damping is None else jnp.asarray(damping, float))
    state = initial_state(system, jnp.array([0.1, 0.0, 0.7, 0.8]), jnp.array([0.4, 0.0, 1.0, 0.0]))
    u = jnp.asarray(np.random.default_rng(0).normal(size=(20, 1)), float)
    dynamics = MechanicalDynamics(system, integrator)
    dt = jnp.asarray(0.02)
    there = last(rollout(dynamics, state, u, dt, 20))
    back = last(rollout(dynamics, State(there, state.parameters), u, -dt, 20))
    np.testing.assert_allclose(back.x, state.coordinates.x, atol=2e-5)
    v = back.v if not isinstance(integrator, Shake) else system.project_velocity(back.x, back.v)
    np.testing.assert_allclose(v, state.coordinates.v, atol=1e-4)


@pytest.mark.parametrize("make", [Euler, RK2, RK4, Shake, Rattle], ids=lambda m: m.__name__)
def test_sub_steps_are_shorter_steps(make):
    system = double_pendulum(input_matrix=push)
    state = initial_state(system, on_circle([1.0, 0.3]), jnp.ones(4))
    u = jnp.array([0.5])
    coarse = end(MechanicalDynamics(system, make(4)), state, u, 0.08, 1).coordinates
    fine = end(MechanicalDynamics(system, make(1)), state, u, 0.02, 4).coordinates
    np.testing.assert_allclose(coarse.x, fine.x, atol=1e-6)
    np.testing.assert_allclose(coarse.v, fine.v, atol=1e-5)


def test_roll_out_is_step_after_step():
    system = double_pendulum(input_matrix=push)
    state = initial_state(system, on_circle([1.0, 0.3]), jnp.ones(4))
    u = jnp.array([[0.5], [-3.0], [2.0]])
    dynamics = MechanicalDynamics(system, Rattle(2))
    rolled = rollout(dynamics, state, u, 0.05, 3)
    assert rolled.x.shape == (4, 4)
    for k in range(3):
        np.testing.assert_allclose(rolled.x[k], state.coordinates.x, atol=1e-5)
        state = end(dynamics, state, u[k], 0.05, 1)
    np.testing.assert_allclose(rolled.x[3], state.coordinates.x, atol=1e-5)
    np.testing.assert_allclose(rolled.v[3], state.coordinates.v, atol=1e-4)


def test_fast_rotation_of_a_third_of_a_radian_a_step():
    system = double_pendulum()
    state = initial_state(system, on_circle([0.0, 0.0]), jnp.array([15.0, 0.0, -15.0, 0.0]))
    motion = rollout(MechanicalDynamics(system, Rattle()), state, jnp.zeros(0), 0.01, 2000)
    x = np.asarray(motion.x)
    link = np.unwrap(np.arctan2(x[:, 2] - x[:, 0], x[:, 1] - x[:, 3]))
    assert 0.28 < np.abs(np.diff(link)).max() < 0.5
    constraint = jax.vmap(system.constraint)(motion.x)
    assert float(jnp.abs(constraint - constraint[:1]).max()) < 1e-6


def test_batches():
    system = double_pendulum(input_matrix=push)
    states = [initial_state(system, on_circle([a, 0.3]), jnp.ones(4)) for a in (0.2, 1.0)]
    batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *states)
    u = jnp.array([[0.5], [-1.0]])
    dynamics = MechanicalDynamics(system, Rattle(2))
    rolled = jax.vmap(lambda state, u: rollout(dynamics, state, u, 0.02, 5))(batch, u)
    np.testing.assert_allclose(rolled.x[1], rollout(dynamics, states[1], u[1], 0.02, 5).x, atol=1e-6)


def test_mistakes():
    system = double_pendulum()
    state = initial_state(system, on_circle([1.0, 0.3]))
    u = jnp.zeros(0)
    damped = double_pendulum(damping=jnp.eye(2))
    with pytest.raises(KeycldError, match="SHAKE .* cannot damp"):
        Shake().step(damped, state, u, 0.1)
    for law_, words in ((system, "without constraints"), (damped, "or damping")):
        with pytest.raises(KeycldError, match=words):
            Leapfrog().step(law_, state, u, 0.1)
    with pytest.raises(KeycldError, match="have no 'constants'"):
        Rattle().step(system, State(state.coordinates, {}), u, 0.1)
    general = GeneralizedLagrangian(lambda q: jnp.eye(1), lambda q: q[0])
    for integrator in (Rattle(), Shake()):
        with pytest.raises(KeycldError, match="not a GeneralizedLagrangian"):
            integrator.step(general, State(Motion(jnp.zeros(1), jnp.zeros(1)), {}), u, 0.1)
    with pytest.raises(KeycldError, match="1 or more sub-steps"):
        Rattle(0)
    with pytest.raises(KeycldError, match="3 steps needs 3 inputs, not 2"):
        MechanicalDynamics(system, Rattle()).rollout(state, jnp.zeros((2, 0)), 0.1, 3)
