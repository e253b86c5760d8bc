"""The prior of the initial velocity."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld.data import Resident
from keycld.mechanics import Constraints, DistanceToPoint, MechanicalDynamics, Motion, State
from keycld.models import Scene, config_for
from keycld.models.keycld.initial_state import FittedInitialState
from keycld.models.keycld.prepare_priors import measure_velocity_prior
from keycld.models.keycld.velocity_prior import VelocityPrior
from keycld.vision import Observation

DT = jnp.array(0.05)
NOTHING = jnp.zeros(0)
ERROR = 0.002  # of an observed position; √2 ERROR / DT = 0.057 of a velocity
OBSERVATION = np.sqrt(2) * ERROR / float(DT)


def states(angle, rate):
    """Of a pendulum of length one."""
    x = jnp.stack([jnp.sin(angle), -jnp.cos(angle)], -1)
    v = rate[:, None] * jnp.stack([jnp.cos(angle), jnp.sin(angle)], -1)
    return State(Motion(x, v), {"constants": jnp.ones((len(angle), 1))})


def angles(count, seed=0):
    return jax.random.uniform(jax.random.key(seed), (count,), minval=-3.0, maxval=3.0)


def rates(state):
    x, v = state.coordinates
    return x[:, 0] * v[:, 1] - x[:, 1] * v[:, 0]


def recorded(pendulum, initial, frames=12):
    """Keypoints of motions, observed with white errors."""
    x = jax.jit(jax.vmap(lambda s: pendulum.rollout(s, NOTHING, DT, frames - 1).x))(initial)
    return x + ERROR * jax.random.normal(jax.random.key(5), x.shape)


class Observed(eqx.Module):
    """A model of one keypoint, whose pictures are the bits of its coordinates."""

    dynamics: MechanicalDynamics
    initial_state: FittedInitialState
    velocity_prior: VelocityPrior | None

    def observe_clips(self, frames):
        bits = jnp.round(255 * frames).astype(jnp.uint8).reshape(-1, 9)[:, :8].reshape(-1, 1, 2, 4)
        return Observation(jax.lax.bitcast_convert_type(bits, jnp.float32), None)


def pictures(x):
    bits = np.pad(np.asarray(x, np.float32).view(np.uint8), [(0, 0), (0, 0), (0, 1)])
    return Resident(jnp.asarray(bits.reshape(*x.shape[:2], 1, 3, 3)), jnp.zeros((len(x), 0)), DT)


def measured(pendulum, x, prior):
    return measure_velocity_prior(
        Observed(pendulum, FittedInitialState(jnp.ones(1), jnp.array([3e-3])), prior), pictures(x)
    )[0]


def test_inputs_that_change_are_taken_up_to_the_last_frame_but_one(pendulum):
    x = recorded(pendulum, after_rest(pendulum, angles(60), 1))
    model = Observed(pendulum, FittedInitialState(jnp.ones(1), jnp.array([3e-3])), VelocityPrior.unknown())
    changing = dataclasses.replace(pictures(x), u=jnp.zeros((*x.shape[:2], 0)))
    priors = [measure_velocity_prior(model, data)[0].velocity_prior for data in (pictures(x), changing)]
    assert float(priors[0].elapsed) == float(priors[1].elapsed)


def expected(prior, pendulum):
    """The prior as a function of observed states."""
    return jax.jit(jax.vmap(lambda s: prior(pendulum, s, NOTHING)))


def after_rest(pendulum, angle, frames):
    """Motions that were at rest so many frames before."""
    rest = states(angle, jnp.zeros_like(angle))
    moved = jax.jit(jax.vmap(lambda s: pendulum.rollout(s, NOTHING, DT, frames)))(rest)
    return State(Motion(moved.x[:, -1], moved.v[:, -1]), rest.parameters)


def test_both_kinds_of_motion_have_smaller_errors_than_under_either_rule(pendulum):
    """Half of the motions are released from rest. To trust only the observation, or only rest, is worse."""
    known = VelocityPrior(DT, jnp.array(0.01), jnp.array(OBSERVATION), jnp.array(2.0))
    true = jnp.concatenate(
        [rates(after_rest(pendulum, angles(400), 1)), 2.0 * jax.random.normal(jax.random.key(1), (400,))]
    )
    angle = jnp.concatenate([angles(400), angles(400, 3)])
    seen = states(angle, true + OBSERVATION * jax.random.normal(jax.random.key(2), (800,)))
    found = expected(known, pendulum)(seen)
    np.testing.assert_allclose(jnp.sum(found.coordinates.x * found.coordinates.v, -1), 0, atol=1e-5)  # on the circle

    def errors(rate):
        return [float(jnp.sqrt(jnp.mean((rate - true)[half] ** 2))) for half in (slice(400), slice(400, None))]

    released, moving = errors(rates(found))
    seen_released, seen_moving = errors(rates(seen))
    assert seen_released == pytest.approx(OBSERVATION, rel=0.1)
    assert released < 0.45 * seen_released
    assert moving < 1.25 * seen_moving
    assert errors(-float(DT) * 9.81 * jnp.sin(angle))[1] > 20 * moving


def test_a_fast_motion_against_gravity_keeps_its_observed_velocity(pendulum):
    """It cannot have begun at rest; a falling one may have."""
    known = VelocityPrior(DT, jnp.array(0.01), jnp.array(OBSERVATION), jnp.array(2.0))
    fast = states(angles(20), 3.0 * jnp.sign(angles(20)))
    found = expected(known, pendulum)(fast)
    np.testing.assert_allclose(found.coordinates.v, fast.coordinates.v, atol=2e-3)


@pytest.mark.parametrize("frames", [2, 5, 10, 16])
def test_a_motion_taken_up_after_rest_is_not_pulled_back_to_it(pendulum, frames):
    """Errors are not larger than those of the observed velocity, however long ago the rest was."""
    known = VelocityPrior(DT, jnp.array(0.01), jnp.array(OBSERVATION), jnp.array(2.0))
    taken = after_rest(pendulum, angles(400), frames)
    true = rates(taken)
    error = OBSERVATION * jax.random.normal(jax.random.key(2), (400,))
    x, v = taken.coordinates
    tangent = jnp.stack([-x[:, 1], x[:, 0]], -1)
    seen = State(Motion(x, v + error[:, None] * tangent), taken.parameters)
    found = expected(known, pendulum)(seen)
    off = rates(found) - true
    assert float(jnp.sqrt(jnp.mean(off**2))) < 1.15 * OBSERVATION
    assert abs(float(jnp.mean(off * jnp.sign(true)))) < 0.35 * OBSERVATION


def test_before_anything_is_measured_nothing_changes(pendulum):
    slow = states(angles(20), jnp.full(20, 0.1))
    found = expected(VelocityPrior.unknown(), pendulum)(slow)
    np.testing.assert_array_equal(found.coordinates.v, slow.coordinates.v)


def test_a_model_infers_the_expected_velocity(getkey):
    """`infer` is the initial state and then the prior, with the acceleration under the first input."""
    constraints = Constraints(("bob",), (DistanceToPoint("bob"),))
    config = config_for("keycld", "fast", constraints=constraints, width=8, substeps=1)
    model = config.build(Scene(16, 16, 1, 12, 0.05, 6), jax.random.key(0))
    # Keypoints that differ from picture to picture, and inputs that push.
    model = eqx.tree_at(lambda m: m.estimator.network.out.kernel, model, replace_fn=lambda kernel: 30 * kernel)
    model = eqx.tree_at(lambda m: m.dynamics.law.input_matrix.bias, model, jnp.array([50.0, 20.0]))
    frames, u = jax.random.uniform(getkey(), (2, 16, 16, 3)), jnp.array([[1.0], [-1.0]])
    known = VelocityPrior(*jnp.array([0.05, 1.0, 10.0, 20.0]))  # an untrained estimator has large errors
    infer = eqx.filter_jit(lambda model: model.infer(frames, DT, u))

    def inferred(prior):
        return infer(eqx.tree_at(lambda m: m.velocity_prior, model, prior, is_leaf=lambda leaf: leaf is None))

    @eqx.filter_jit
    def by_hand(model):
        seen = jnp.stack([model.observe(frame).keypoints[0] for frame in frames])
        observed = model.initial_state(model.dynamics, seen, DT, u)
        return observed, known(model.dynamics, observed, u[0])

    observed, expected = by_hand(model)
    assert float(jnp.max(jnp.abs(expected.coordinates.v - observed.coordinates.v))) > 1.0
    for prior, state in ((None, observed), (VelocityPrior.unknown(), observed), (known, expected)):
        for leaf, wanted in zip(jax.tree.leaves(inferred(prior)), jax.tree.leaves(state), strict=True):
            np.testing.assert_allclose(leaf, wanted, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("frames", [1, 2])
def test_rest_is_found_in_the_recordings(pendulum, frames):
    x = recorded(pendulum, after_rest(pendulum, angles(150), frames))
    prior = measured(pendulum, x, VelocityPrior.unknown()).velocity_prior
    assert float(prior.elapsed) == pytest.approx(frames * float(DT), rel=0.05)
    assert float(prior.observation) == pytest.approx(OBSERVATION, rel=0.2)
    assert float(prior.spread) < 0.6 * OBSERVATION


def test_recordings_from_the_middle_of_motions_give_no_prior(pendulum):
    """If initial velocities are arbitrary, the expected velocity is the observed one."""
    thrown = states(angles(150), 2.0 * jax.random.normal(jax.random.key(4), (150,)))
    x = recorded(pendulum, thrown)
    model = measured(pendulum, x, VelocityPrior.unknown())
    seen = jax.jit(jax.vmap(lambda x: model.initial_state(pendulum, x[:2], DT, NOTHING)))(x)
    found = expected(model.velocity_prior, pendulum)(seen)
    off = jnp.abs(rates(found) - rates(seen))
    assert float(jnp.max(off)) < 0.2 * OBSERVATION


def test_a_model_without_a_prior_is_not_changed(pendulum):
    assert measured(pendulum, recorded(pendulum, states(angles(2), jnp.zeros(2))), None).velocity_prior is None


def test_redundant_constraints_give_finite_numbers(pendulum):
    """Two constants for one rod: their count leaves no degree of freedom, their rank one."""
    rod = DistanceToPoint("bob")
    twice = eqx.tree_at(lambda d: d.law.constraint_function, pendulum, Constraints(("bob",), (rod, rod)))
    x = recorded(pendulum, after_rest(pendulum, angles(30), 1))
    unknown = Observed(twice, FittedInitialState(jnp.ones(2), jnp.array([3e-3])), VelocityPrior.unknown())
    model = measure_velocity_prior(unknown, pictures(x))[0]
    assert twice.law.freedom == 1
    assert float(model.velocity_prior.elapsed) == pytest.approx(float(DT), rel=0.2)
    seen = eqx.filter_jit(model.initial_state)(twice, x[0, :2], DT, NOTHING)
    state = eqx.filter_jit(model.velocity_prior)(twice, seen, NOTHING)
    assert bool(jnp.all(jnp.isfinite(state.coordinates.v)))
