"""Integrators of phase space: golden trajectories, order, reversal, energy, gradients, and agreement with laws."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mechanics_examples import GOLDEN, GRAVITY, initial_state, law

from keycld import KeycldError
from keycld.mechanics import (
    AbstractField,
    Composition,
    FirstOrderDynamics,
    GeneralizedLagrangian,
    Hamiltonian,
    HamiltonianDynamics,
    Leapfrog,
    MechanicalDynamics,
    Motion,
    PhasePoint,
    RungeKutta,
    SeparableHamiltonian,
    State,
    integrator_named,
    momentum,
    to_hamiltonian,
)
from keycld.mechanics.named import INTEGRATORS

ORDERS = {
    "euler": 1,
    "rk2": 2,
    "rk4": 4,
    "rk38": 4,
    "symp_euler": 1,
    "leap_frog": 2,
    "ruth4": 4,
    "sym4": 4,
    "so4": 4,
    "sym6": 6,
    "so6": 6,
    "so8": 8,
}
SYMMETRIC = [name for name in ORDERS if isinstance(INTEGRATORS[name], Composition) and name != "symp_euler"]


def half_square(p):
    return 0.5 * jnp.sum(p * p)


def kinetic(p):
    """Not a quadratic form: relativistic, so that no coefficient hides behind a vanishing derivative."""
    return jnp.sqrt(1 + p[0] ** 2 + 2 * p[1] ** 2)


def potential(q):
    return jnp.sum(jnp.cos(q)) * -1.0 + 0.3 * q[0] * q[1] + 0.1 * q[0] ** 4


def push(q):
    return jnp.stack([jnp.sin(q[1]), jnp.ones_like(q[0])])[:, None]


def coupled():
    return SeparableHamiltonian(kinetic, potential, push)


def point(*values):
    q, p = jnp.split(jnp.asarray(values, float), 2)
    return State(PhasePoint(q, p), {})


@eqx.filter_jit
def rollout(dynamics, state, u, dt, steps):
    return dynamics.rollout(state, u, dt, steps)


@eqx.filter_jit
def end(dynamics, state, u, dt, steps):
    return jax.lax.fori_loop(0, steps, lambda _, s: dynamics.step(s, u, dt), state).coordinates


def test_every_named_integrator_is_tested_here():
    assert set(ORDERS) == set(INTEGRATORS)


@pytest.mark.parametrize("name", ORDERS)
def test_golden_pendulum(name):
    """H = p²/2 − cos q, with the benchmark's own code."""
    golden = np.load(GOLDEN / f"{name}.npz")
    with jax.enable_x64(True):
        system = SeparableHamiltonian(half_square, lambda q: -jnp.cos(q[0]))
        dynamics = HamiltonianDynamics(system, integrator_named(name))
        state = point(float(golden["q0"]), float(golden["p0"]))
        q, p = rollout(dynamics, state, jnp.zeros(0), float(golden["dt"]), int(golden["num_steps"]))
    np.testing.assert_allclose(q[:, 0], golden["q"], atol=1e-13)
    np.testing.assert_allclose(p[:, 0], golden["p"], atol=1e-13)


# Few steps for high orders: the error must stay above rounding.
COUNTS = {1: (160, 320), 2: (80, 160), 4: (24, 48), 6: (14, 28), 8: (10, 20)}


@pytest.mark.parametrize("name", ORDERS)
def test_order_of_convergence(name):
    order, time = ORDERS[name], 2.0
    with jax.enable_x64(True):
        state, u = point(0.4, -0.7, 0.5, 0.3), jnp.array([0.6])
        exact = end(HamiltonianDynamics(coupled(), integrator_named("so8")), state, u, time / 256, 256)
        found = []
        for count in COUNTS[order]:
            reached = end(HamiltonianDynamics(coupled(), integrator_named(name)), state, u, time / count, count)
            found.append(max(float(jnp.abs(a - b).max()) for a, b in zip(reached, exact, strict=True)))
    assert np.log2(found[0] / found[1]) == pytest.approx(order, abs=0.35)


@pytest.mark.parametrize("name", ORDERS)
def test_forward_then_backward(name):
    """Also with an input that changes: the way back takes the same array. Palindromes return exactly."""
    with jax.enable_x64(True):
        state = point(0.4, -0.7, 0.5, 0.3)
        u = jnp.asarray(np.random.default_rng(0).normal(size=(10, 1)))

        def defect(dt, substeps):
            dynamics = HamiltonianDynamics(coupled(), integrator_named(name, substeps))
            there = jax.tree.map(lambda y: y[-1], rollout(dynamics, state, u, jnp.asarray(dt), 10))
            back = jax.tree.map(lambda y: y[-1], rollout(dynamics, State(there, {}), u, jnp.asarray(-dt), 10))
            return max(float(jnp.abs(a - b).max()) for a, b in zip(back, state.coordinates, strict=True))

        if name in SYMMETRIC:
            assert defect(0.1, 1) < 1e-13
        else:
            # What is not symmetric comes back as well as its order says.
            assert defect(0.1, 4) < 0.55 ** ORDERS[name] * defect(0.1, 2) < 0.1


@pytest.mark.parametrize("name", ["euler", "rk4", "symp_euler", "leap_frog", "ruth4"])
def test_sub_steps_are_shorter_steps(name):
    state, u = point(0.4, -0.7, 0.5, 0.3), jnp.array([0.6])
    coarse = end(HamiltonianDynamics(coupled(), integrator_named(name, 4)), state, u, 0.4, 2)
    fine = end(HamiltonianDynamics(coupled(), integrator_named(name)), state, u, 0.1, 8)
    for a, b in zip(coarse, fine, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-6)


@pytest.mark.parametrize("name", ["symp_euler", "leap_frog", "ruth4", "so4"])
def test_symplectic_steps_keep_the_energy_bounded(name):
    """A pendulum for 10,000 steps of a tenth of a period's radian; the error does not grow."""
    with jax.enable_x64(True):
        system = SeparableHamiltonian(half_square, lambda q: -jnp.cos(q[0]))
        motion = rollout(
            HamiltonianDynamics(system, integrator_named(name)), point(1.0, 0.3), jnp.zeros(0), 0.1, 10_000
        )
        energy = np.asarray(jax.vmap(system.energy)(*motion))
    error = np.abs(energy - energy[0])
    assert error.max() < 0.06
    assert error[-1000:].max() < 1.1 * error[:1000].max() + 1e-9


@pytest.mark.parametrize("name", ["leap_frog", "so4", "ruth4"])
def test_steps_preserve_the_symplectic_form(name):
    """JᵀΩJ = Ω for the Jacobian J of a step without input; a push that is no gradient would break it."""
    dynamics = HamiltonianDynamics(coupled(), integrator_named(name, 2))
    with jax.enable_x64(True):

        def step(z):
            state = State(PhasePoint(z[:2], z[2:]), {})
            return jnp.concatenate(dynamics.step(state, jnp.zeros(1), 0.3).coordinates)

        jacobian = jax.jacfwd(step)(jnp.array([0.4, -0.7, 0.5, 0.3]))
        omega = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.eye(2), np.zeros((2, 2))]])
        np.testing.assert_allclose(jacobian.T @ omega @ jacobian, omega, atol=1e-13)


class Springs(eqx.Module):
    """A potential with parameters to differentiate by."""

    stiffness: jax.Array

    def __call__(self, q):
        return jnp.sum(self.stiffness * q**4)


@pytest.mark.parametrize("name", ORDERS)
def test_gradients_of_a_roll_out_are_finite_and_right(name):
    """By parameters, the initial state and the input, compared with differences."""
    with jax.enable_x64(True):
        values = (jnp.array([1.5, 0.5]), jnp.array([0.4, -0.7]), jnp.array([0.5, 0.3]), jnp.array([[0.6], [-0.2]]))
        values = jax.tree.map(lambda a: a.astype(jnp.float64), values)

        def loss(values):
            stiffness, q, p, u = values
            system = SeparableHamiltonian(kinetic, Springs(stiffness), push)
            path = HamiltonianDynamics(system, integrator_named(name)).rollout(State(PhasePoint(q, p), {}), u, 0.3, 2)
            return jnp.sum(path.q**3) + jnp.sum(path.p[1] * path.q[2])

        both = jax.jit(jax.value_and_grad(loss))
        gradient = both(values)[1]
        for leaf in jax.tree.leaves(gradient):
            assert np.isfinite(leaf).all() and np.abs(leaf).max() > 0
        ahead = jax.tree.map(lambda a: a + 1e-6 * (1 + a), values)
        behind = jax.tree.map(lambda a: a - 1e-6 * (1 + a), values)
        slope = sum(jnp.sum(g * (1 + a)) for g, a in zip(gradient, values, strict=True))
        np.testing.assert_allclose(slope, (both(ahead)[0] - both(behind)[0]) / 2e-6, rtol=1e-6)


def test_phase_space_leapfrog_is_velocity_verlet():
    """With unit masses p = v: the two forms of leapfrog give the same path."""
    system = law([1.0], None, input_matrix=push, potential=potential)
    state, u = initial_state(system, jnp.array([0.4, -0.7]), jnp.array([0.5, 0.3])), jnp.array([0.6])
    motion = rollout(MechanicalDynamics(system, Leapfrog()), state, u, 0.1, 20)
    hamiltonian = SeparableHamiltonian(half_square, potential, push)
    q, p = rollout(
        HamiltonianDynamics(hamiltonian, integrator_named("leap_frog")), point(0.4, -0.7, 0.5, 0.3), u, 0.1, 20
    )
    np.testing.assert_allclose(q, motion.x, atol=1e-6)
    np.testing.assert_allclose(p, motion.v, atol=1e-6)


def double_pendulum_in_angles():
    def factor(q):
        # M = [[2, cos(q₁ − q₂)], [·, 1]] for unit masses and lengths.
        c = jnp.cos(q[0] - q[1])
        return jnp.stack([jnp.stack([jnp.sqrt(2 - c * c), c]), jnp.stack([jnp.zeros_like(c), jnp.ones_like(c)])])

    return GeneralizedLagrangian(factor, lambda q: -GRAVITY * (2 * jnp.cos(q[0]) + jnp.cos(q[1])))


def test_a_double_pendulum_moves_alike_by_hamilton_and_by_lagrange():
    """A Hamiltonian that is not separable, and a law of second order as a field, both by the 3/8 rule."""
    lagrangian = double_pendulum_in_angles()
    q, v = jnp.array([1.0, 0.3]), jnp.array([0.5, -0.3])
    with jax.enable_x64(True):
        q, v = q.astype(jnp.float64), v.astype(jnp.float64)
        integrator = integrator_named("rk38", 8)
        motion = rollout(MechanicalDynamics(lagrangian, integrator), State(Motion(q, v), {}), jnp.zeros(0), 0.05, 40)
        first = State(PhasePoint(q, momentum(lagrangian, q, v)), {})
        path = rollout(HamiltonianDynamics(to_hamiltonian(lagrangian), integrator), first, jnp.zeros(0), 0.05, 40)
        np.testing.assert_allclose(path.q, motion.x, atol=1e-6)


class Spiral(AbstractField):
    """ds/dt = A s with eigenvalues −0.1 ± i, on a state of two leaves."""

    def derivative(self, coordinates, u, parameters=None):
        return {"a": -0.1 * coordinates["a"] - coordinates["b"], "b": coordinates["a"] - 0.1 * coordinates["b"] + u}


def test_any_field_of_first_order():
    dynamics = FirstOrderDynamics(Spiral(), integrator_named("rk4"))
    state = State({"a": jnp.ones(1), "b": jnp.zeros(1)}, {})
    path = rollout(dynamics, state, jnp.zeros(1), 0.1, 30)
    t = 0.1 * np.arange(31)
    np.testing.assert_allclose(path["a"][:, 0], np.exp(-0.1 * t) * np.cos(t), atol=1e-5)
    np.testing.assert_allclose(path["b"][:, 0], np.exp(-0.1 * t) * np.sin(t), atol=1e-5)
    stepped = dynamics.step(state, jnp.zeros(1), 0.1).coordinates
    np.testing.assert_allclose(stepped["a"], path["a"][1], atol=1e-7)


def test_mistakes():
    state = point(0.4, -0.7, 0.5, 0.3)
    general = Hamiltonian(lambda q, p: kinetic(p) + potential(q))
    for field in (general, Spiral()):
        with pytest.raises(KeycldError, match=f"not a {type(field).__name__}: use a Runge–Kutta method such as rk4"):
            integrator_named("leap_frog").step(field, state, jnp.zeros(0), 0.1)
    with pytest.raises(KeycldError, match="did you mean 'leap_frog'"):
        integrator_named("leapfrog")
    with pytest.raises(KeycldError, match="1 or more sub-steps"):
        integrator_named("so4", 0)
    with pytest.raises(KeycldError, match="alternates between kicks and drifts"):
        Composition((1.0,), (0.5,), kick_first=True)
    with pytest.raises(KeycldError, match="explicit Runge–Kutta method"):
        RungeKutta(((), (0.5, 0.5)), (0.0, 1.0))
    with pytest.raises(KeycldError, match="3 steps needs 3 inputs, not 2"):
        HamiltonianDynamics(coupled(), integrator_named("so4")).rollout(state, jnp.zeros((2, 1)), 0.1, 3)
