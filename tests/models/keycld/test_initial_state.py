"""Initial states from the keypoints of a few frames."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld.mechanics import Motion, State
from keycld.models.keycld.initial_state import CentralInitialState, DifferenceInitialState, FittedInitialState

DT = jnp.array(0.05)
NOTHING, ERROR = jnp.zeros(0), jnp.array([1e-3])


@pytest.fixture(scope="module")
def swing(pendulum):
    """A pendulum of length one, thrown at 3 rad/s from 1 rad."""
    x = jnp.array([jnp.sin(1.0), -jnp.cos(1.0)])
    state = State(Motion(x, 3.0 * jnp.array([jnp.cos(1.0), jnp.sin(1.0)])), {"constants": jnp.ones(1)})
    return state, pendulum.rollout(state, NOTHING, DT, 5).x


@pytest.mark.parametrize("given", [2, 3, 4])
def test_a_fitted_initial_state_recovers_the_observed_motion(pendulum, swing, given):
    state, seen = swing
    found = FittedInitialState(None, ERROR).smooth(pendulum, seen[:given], DT, NOTHING)[0].coordinates
    np.testing.assert_allclose(found.x, state.coordinates.x, atol=2e-4)
    np.testing.assert_allclose(found.v, state.coordinates.v, atol=5e-3)


def test_a_third_frame_halves_the_error_of_the_velocity(pendulum, swing):
    """The error of a difference over one frame is σ√2/dt, over two frames σ/(√2 dt)."""
    state, seen = swing
    noisy = seen[None, :3] + 1e-3 * jax.random.normal(jax.random.key(0), (200, 3, 2))
    initial = jax.jit(jax.vmap(lambda x: FittedInitialState(None, ERROR).smooth(pendulum, x, DT, NOTHING)[0]))(noisy)
    error = float(jnp.sqrt(jnp.mean(jnp.sum((initial.coordinates.v - state.coordinates.v[None]) ** 2, axis=-1))))
    assert error == pytest.approx(1e-3 / (np.sqrt(2) * float(DT)), rel=0.2)


def test_the_covariance_of_ten_frames_is_that_of_their_errors(pendulum, swing):
    """Errors of 400 initial states along the motion, against the stated standard deviation; one frame is an outlier."""
    state, seen = swing
    seen = pendulum.rollout(state, NOTHING, DT, 9).x
    noisy = seen[None] + 1e-3 * jax.random.normal(jax.random.key(1), (400, 10, 2))
    noisy = noisy.at[:, 4].add(0.1)
    smooth = jax.jit(jax.vmap(lambda x: FittedInitialState(jnp.ones(1), ERROR).smooth(pendulum, x, DT, NOTHING)))
    found, covariance = smooth(noisy)
    along = jnp.array([jnp.cos(1.0), jnp.sin(1.0)])
    for coordinate, truth, stated in (
        (found.coordinates.x, state.coordinates.x, covariance[:, :2, :2]),
        (found.coordinates.v, state.coordinates.v, covariance[:, 2:, 2:]),
    ):
        error = jnp.std((coordinate - truth[None]) @ along)
        assert float(error) == pytest.approx(float(jnp.sqrt(jnp.mean(along @ stated @ along))), rel=0.25)


def test_shared_constants_are_those_of_the_motion(pendulum, swing):
    """Keypoints observed 2 % too far from the pivot do not make the pendulum longer."""
    _, seen = swing
    own, shared = (
        FittedInitialState(constants, ERROR)(pendulum, 1.02 * seen[:2], DT, NOTHING)
        for constants in (None, jnp.ones(1))
    )
    assert float(jnp.linalg.norm(own.coordinates.x)) == pytest.approx(1.02, rel=1e-3)
    assert float(jnp.linalg.norm(shared.coordinates.x)) == pytest.approx(1.0, rel=1e-5)
    np.testing.assert_array_equal(shared.parameters["constants"], [1.0])


def test_a_backward_difference_belongs_to_the_second_frame(pendulum, swing):
    _, seen = swing
    initial_state = DifferenceInitialState()
    found = initial_state(pendulum, seen[:2], DT, NOTHING).coordinates
    assert (initial_state.given, initial_state.anchor) == (2, 1)
    np.testing.assert_allclose(found.v, (seen[1] - seen[0]) / DT)


def test_a_central_difference_keeps_to_the_constraint(pendulum, swing):
    _, seen = swing
    initial_state = CentralInitialState()
    found = initial_state(pendulum, seen[:3] + jnp.array([[0.02], [0.0], [-0.01]]), DT, NOTHING).coordinates
    assert (initial_state.given, initial_state.anchor) == (3, 1)
    np.testing.assert_array_equal(found.x, seen[1])
    assert abs(float(jnp.sum(found.x * found.v))) < 1e-5
    # The component along the circle is unchanged.
    plain = (seen[2] - seen[0] - 0.03) / (2 * DT)
    tangent = jnp.array([-seen[1, 1], seen[1, 0]])
    np.testing.assert_allclose(jnp.sum(found.v * tangent), jnp.sum(plain * tangent), rtol=1e-5)
