"""Position and velocity from noisy or missing observations of a known motion."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from true_physics import truth

from keycld import KeycldError
from keycld.control import BackwardDifference, PredictCorrect
from keycld.mechanics import ConstrainedLagrangian, MechanicalDynamics, Rattle

FRAMES = 200


@pytest.fixture(scope="module")
def swing():
    """An acrobot that swings under a constant input: x and v [T, 2K]."""
    known = truth("acrobot")
    u = jnp.array([0.5, -0.2])
    motion = jax.jit(lambda s: known.dynamics.rollout(s, u, known.system.dt, FRAMES - 1))
    return known, u, motion(known.motion(np.array([2.0, 0.6, 0.0, 0.0])))


@eqx.filter_jit
def estimate(estimator, observed, arrived, u):
    def step(belief, each):
        belief = estimator.update(belief, *each, u)
        return belief, (belief.state.coordinates, belief.unmodelled)

    return jax.lax.scan(step, estimator.initial_belief(), (observed, arrived))[1]


def noisy(x, size=0.005, seed=0):
    return x + size * jnp.asarray(np.random.default_rng(seed).normal(size=x.shape), x.dtype)


def velocity_error(motion, found, since=20):
    return float(jnp.sqrt(jnp.mean((found.v - motion.v)[since:] ** 2)))


def predictor(known, **options):
    return PredictCorrect(known.law, known.dynamics, known.system.dt, **options)


def test_exact_observations_give_the_exact_motion(swing):
    known, u, motion = swing
    found, lacking = estimate(predictor(known), motion.x, jnp.ones(FRAMES, bool), u)
    np.testing.assert_allclose(found.x, motion.x, atol=1e-4)
    assert velocity_error(motion, found, since=5) < 0.01 and np.abs(lacking).max() < 0.1


def test_learned_dynamics_beat_plain_differences(swing):
    known, u, motion = swing
    observed, all_of_them = noisy(motion.x), jnp.ones(FRAMES, bool)
    predicted, _ = estimate(predictor(known, adaptation=0.0), observed, all_of_them, u)
    plain, _ = estimate(BackwardDifference(known.law, known.system.dt), observed, all_of_them, u)
    assert velocity_error(motion, predicted) < velocity_error(motion, plain) / 4
    # A plain difference has the noise that it should: σ √2/dt along the two directions that the constraints leave.
    assert velocity_error(motion, plain) == pytest.approx(0.005 * np.sqrt(2) / 0.01 / np.sqrt(2), rel=0.25)


def test_dropped_frames_are_predicted(swing):
    known, u, motion = swing
    arrived = np.random.default_rng(1).random(FRAMES) > 0.3
    arrived[100:130] = False
    nothing = jnp.where(jnp.asarray(arrived)[:, None], noisy(motion.x, 0.001), jnp.nan)
    found, _ = estimate(predictor(known), nothing, jnp.asarray(arrived), u)
    assert np.isfinite(np.asarray(found.x)).all()
    assert np.abs(np.asarray(found.x - motion.x))[30:].max() < 0.05


@pytest.mark.parametrize("dropped", [1, 2])
def test_a_velocity_is_divided_by_the_time_since_the_last_observation(swing, dropped):
    """Frames are dropped between the first two observations."""
    known, u, motion = swing
    arrived = jnp.arange(dropped + 2) % (dropped + 1) == 0
    at = slice(60, 60 + dropped + 2)
    for estimator in (predictor(known), BackwardDifference(known.law, known.system.dt)):
        found, _ = estimate(estimator, motion.x[at], arrived, u)
        np.testing.assert_allclose(found.v[-1], motion.v[61 + dropped], atol=0.1)


def test_nothing_is_estimated_before_the_first_observation(swing):
    known, u, motion = swing
    estimator = predictor(known)
    belief = estimator.update(estimator.initial_belief(), motion.x[0], jnp.asarray(False), u)
    assert belief.observations == 0
    belief = estimator.update(belief, motion.x[0], jnp.asarray(True), u)
    assert belief.observations == 1
    np.testing.assert_allclose(belief.state.coordinates.x, motion.x[0], atol=1e-5)
    assert not np.any(belief.state.coordinates.v)


def test_a_lacking_gravity_is_noticed(swing):
    """The estimator's law has 80 % of the gravity; where the arm is held still, the rest must be what is lacking."""
    known, u, _ = swing
    weak = ConstrainedLagrangian(
        known.law.mass, lambda x: 0.8 * known.law.potential(x), known.law.input_matrix, known.law.constraint_function
    )
    still = known.motion(np.array([2.0, 0.0, 0.0, 0.0]))
    hold = jnp.linalg.lstsq(
        jnp.concatenate([known.law.input_matrix(still.coordinates.x), known.law.jacobian(still.coordinates.x).T], 1),
        jax.grad(known.law.potential)(still.coordinates.x),
    )[0][:2]
    estimator = PredictCorrect(weak, MechanicalDynamics(weak, Rattle()), known.system.dt)
    observed = jnp.broadcast_to(still.coordinates.x, (FRAMES, 4))
    found, lacking = estimate(estimator, observed, jnp.ones(FRAMES, bool), hold)
    expected = -weak.acceleration(still.coordinates.x, jnp.zeros(4), hold)
    np.testing.assert_allclose(lacking[-1], expected, atol=0.05 * np.abs(expected).max())
    np.testing.assert_allclose(found.v[-1], 0.0, atol=0.01)


def test_gains_follow_the_noise():
    known = truth("pendulum")
    trusting = predictor(known, observation_error=1e-6).gains
    assert trusting[0] == pytest.approx(1.0, abs=0.01)
    wary = predictor(known, observation_error=10.0).gains
    assert 0 < wary[1] < wary[0] < 0.1
    with pytest.raises(KeycldError, match="positive"):
        predictor(known, observation_error=0.0)
