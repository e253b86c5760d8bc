"""Energy shaping: what it must not depend on, and that it swings up three systems with their true physics."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from true_physics import truth

from keycld import KeycldError
from keycld.control import (
    Belief,
    EnergyShaping,
    PaperShaping,
    PredictCorrect,
    advance,
    check_limit,
    upright,
)
from keycld.control.requirements import positions_of
from keycld.mechanics import ConstrainedLagrangian, PointMasses

NAMES = ("pendulum", "cartpole", "acrobot")


def everything(known):
    return tuple(range(len(known.system.input_names)))


@eqx.filter_jit
def act(controller, belief):
    return controller.act(belief, None)[0]


def shaping(known, law=None, kind=EnergyShaping, actuators=None):
    return kind(law or known.law, known.upright, everything(known) if actuators is None else actuators)


def belief(known, state, lacking=None):
    motion = known.motion(state)
    lacking = jnp.zeros_like(known.upright) if lacking is None else lacking
    return Belief(motion, lacking, jnp.asarray(9))


def a_state(known, seed):
    return np.random.default_rng(seed).normal(size=len(known.system.state_names))


class Along(eqx.Module):
    """A field plus DΦᵀα(x), which no motion can tell from the field alone."""

    law: ConstrainedLagrangian
    strength: jax.Array

    def alpha(self, x):
        return self.strength * (1 + jnp.sum(jnp.sin(3 * x)))


class BentInputs(Along):
    def __call__(self, x):
        alpha = jnp.outer(self.alpha(x), jnp.array([1.0, -0.7])[: self.law.input_matrix(x).shape[1]])
        return self.law.input_matrix(x) + jnp.matmul(self.law.jacobian(x).T, alpha)


class BentPotential(Along):
    """Its gradient on the constraints is that of V plus strength · ∇Φ(x)."""

    value: jax.Array

    def __call__(self, x):
        return self.law.potential(x) + jnp.sum(self.strength * (self.law.constraint(x) - self.value))


def changed(law, **parts):
    old = {"mass": law.mass, "potential": law.potential, "input_matrix": law.input_matrix}
    return ConstrainedLagrangian(**{**old, **parts}, constraint=law.constraint_function)


class Times(eqx.Module):
    field: eqx.Module
    factor: float = eqx.field(static=True)

    def __call__(self, x):
        return self.factor * self.field(x)


def variants(known, x):
    law = known.law
    strength = 3.0 * jnp.arange(1.0, law.count + 1)
    yield "g + DΦᵀα", changed(law, input_matrix=BentInputs(law, strength))
    yield "∇V + DΦᵀα", changed(law, potential=BentPotential(law, strength, law.constraint(x)))
    for factor in (0.01, 7.0):
        mass = PointMasses(jnp.sqrt(factor * law.masses))
        scaled = changed(
            law, mass=mass, potential=Times(law.potential, factor), input_matrix=Times(law.input_matrix, factor)
        )
        yield f"{factor} (M, V, g)", scaled


def inputs_of_variants(name, kind):
    """The input [seeds, l] of the true law and of each variant, for random states with a lacking acceleration."""
    known = truth(name)
    random = np.random.default_rng(0)
    states = random.normal(size=(3, len(known.system.state_names)))
    lacking = random.normal(size=(3, *known.upright.shape))

    @jax.jit
    @jax.vmap
    def inputs(state, lacking):
        now = belief(known, state, lacking)
        laws = {"": known.law, **dict(variants(known, now.state.coordinates.x))}
        return {change: shaping(known, law, kind).act(now, None)[0] for change, law in laws.items()}

    found = inputs(jnp.asarray(states, float), jnp.asarray(lacking, float))
    return found.pop(""), found


@pytest.mark.parametrize("name", NAMES)
def test_what_training_leaves_open_changes_no_input(name):
    expected, found = inputs_of_variants(name, EnergyShaping)
    assert len(found) == 4
    for change, u in found.items():
        np.testing.assert_allclose(u, expected, rtol=2e-3, atol=2e-3, err_msg=change)


def test_the_papers_law_depends_on_it_all():
    expected, found = inputs_of_variants("acrobot", PaperShaping)
    for change, u in found.items():
        assert np.abs(np.asarray(u - expected)).max() > 0.1, change


@pytest.mark.parametrize("name", NAMES)
def test_the_controlled_motion_is_that_of_a_ball_in_a_bowl(name):
    """With an input for every degree of freedom gravity is gone: a = −kp (x − x*) along the constraints, at rest."""
    known = truth(name)
    state = a_state(known, 4)
    state[len(state) // 2 :] = 0
    now = belief(known, state)
    x, v = now.state.coordinates
    u = act(shaping(known), now)
    expected = known.law.project_velocity(x, -5.0 * (x - known.upright))
    np.testing.assert_allclose(known.law.acceleration(x, v, u), expected, atol=0.02)


def test_a_lacking_acceleration_is_cancelled():
    known = truth("acrobot")
    state = np.array([0.3, -0.2, 0.0, 0.0])
    lacking = known.law.project_velocity(known.motion(state).coordinates.x, jnp.array([0.4, 0.1, -0.3, 0.2]))
    x, v = known.motion(state).coordinates
    plain = act(shaping(known), belief(known, state))
    told = act(shaping(known), belief(known, state, lacking))
    difference = known.law.acceleration(x, v, told) - known.law.acceleration(x, v, plain)
    np.testing.assert_allclose(difference, -lacking, atol=0.01)


def test_where_an_input_has_no_effect_it_stays_small():
    known = truth("pendulum")
    weak = changed(known.law, input_matrix=Weak(known.law))
    state = np.array([2.0, 0.0])
    there = act(shaping(known, weak), belief(known, state))
    usual = act(shaping(known), belief(known, state))
    assert np.isfinite(there).all() and np.abs(there).max() <= 10.1 * np.abs(usual).max()


class Weak(eqx.Module):
    """An input matrix that all but vanishes away from upright, as a learned one may where training never was."""

    law: ConstrainedLagrangian

    def __call__(self, x):
        return self.law.input_matrix(x) * jnp.where(x[1] > 0.2, 1.0, 1e-3)


@pytest.mark.parametrize("name", NAMES)
def test_energy_falls_along_the_loop(name):
    """Passivity: T + V_d never rises, though the input is renewed only once a frame."""
    known = truth(name)
    controller = shaping(known)

    def step(state, _):
        u = controller.act(Belief(state, 0 * known.upright, jnp.asarray(9)), None)[0]
        energies = controller.energies(*state.coordinates, u)
        return known.dynamics.step(state, u, known.system.dt), energies.kinetic + energies.desired

    initial = known.motion(a_state(known, 2))
    total = np.asarray(jax.jit(lambda s: jax.lax.scan(step, s, length=300)[1])(initial))
    assert np.all(np.diff(total) <= 2e-3 * total[0]) and total[-1] < 0.05 * total[0]


@pytest.mark.parametrize("name", NAMES)
def test_true_physics_and_states_swing_up_in_mujoco(name):
    """And T + V_d of MuJoCo's own motion falls in every frame, from the first to the last."""
    state, total = in_mujoco(name, seconds=10)
    assert np.all(upright(truth(name).system, state[-round(1 / truth(name).system.dt) :]))
    assert np.all(np.diff(total, axis=0) <= 1e-5 * total[0]) and np.all(total[-1] < 1e-3 * total[0])


def test_energy_falls_too_where_velocities_are_estimated():
    """Observations are exact: neither the unknown first velocity nor the correction of lacking forces raises it."""
    known = truth("acrobot")
    _, total = in_mujoco("acrobot", 4, PredictCorrect(known.law, known.dynamics, known.system.dt))
    assert np.all(np.diff(total, axis=0) <= 1e-4 * total[0]) and np.all(total[-1] < 0.2 * total[0])


def in_mujoco(name, seconds, estimator=None):
    """States [T, 3, d] after each frame of three trials, and the true T + V_d [T, 3] before it."""
    known = truth(name)
    system = known.system
    random = np.random.RandomState(0)
    positions = np.stack([system.positions(random, 1.0) for _ in range(3)])
    state = np.concatenate([positions, np.zeros_like(positions)], axis=1)
    controller = shaping(known)

    @jax.jit
    @jax.vmap
    def step(before, state, u):
        now = belief(known, state)
        x, v = now.state.coordinates
        if estimator is not None:
            now = estimator.update(before, x, jnp.asarray(True), u)
        energies = controller.energies(x, v, u)
        return now, controller.act(now, None)[0], energies.kinetic + energies.desired

    nothing = belief(known, state[0]) if estimator is None else estimator.initial_belief()
    now = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (3, *jnp.shape(leaf))), nothing)
    u = jnp.zeros((3, len(system.input_names)))
    states, totals = [], []
    for _ in range(round(seconds / system.dt)):
        now, u, total = step(now, jnp.asarray(state, float), u)
        state = advance(system, state, np.asarray(u))
        states.append(state)
        totals.append(total)
    return np.array(states), np.array(totals)


def test_inputs_that_do_not_act_stay_zero():
    known = truth("acrobot")
    u = shaping(known, actuators=(1,)).act(belief(known, a_state(known, 1)), None)[0]
    assert u[0] == 0 and u[1] != 0


def test_bad_names_and_numbers():
    assert positions_of(("a", "b"), ("b",)) == (1,) and positions_of(("a", "b"), None) == (0, 1)
    with pytest.raises(KeycldError, match="no input 'c': choose from a, b"):
        positions_of(("a", "b"), ("c",))
    with pytest.raises(KeycldError, match="positive number"):
        check_limit(0.0)
    assert check_limit(None) == np.inf
