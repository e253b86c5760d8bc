"""The Gymnasium environments, and the learned model as one."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pendulum_model import PendulumModel
from true_physics import truth

from keycld import KeycldError
from keycld.control import Imagination, register_environments
from keycld.systems import get, registry

gymnasium = pytest.importorskip("gymnasium")
register_environments()


@pytest.fixture
def make():
    made = []

    def build(name, **options):
        made.append(gymnasium.make(f"keycld/{name}-v0", **options))
        return made[-1]

    yield build
    for env in made:
        env.close()


def test_gymnasiums_own_checks_pass_without_a_warning(make):
    from gymnasium.utils.env_checker import check_env

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(make("Pendulum", render_mode="rgb_array").unwrapped)


@pytest.mark.parametrize("name", ["Pendulum", "Cartpole", "Acrobot"])
def test_every_system_can_be_stepped(make, name):
    env = make(name, render_mode="rgb_array")
    picture, info = env.reset(seed=3)
    assert picture.shape == (64, 64, 3) and picture.dtype == np.uint8 and picture.std() > 5
    for _ in range(3):
        picture, reward, terminated, truncated, info = env.step(env.action_space.sample())
    system = env.unwrapped.system
    assert 0 <= reward <= 1 and not terminated and not truncated
    np.testing.assert_allclose(info["landmarks"], system.landmarks(info["state"]))
    np.testing.assert_array_equal(env.render(), picture)
    assert env.spec.max_episode_steps * system.dt == pytest.approx(10.0)


def test_seeds_initial_states_limits_and_actuators(make):
    env = make("Acrobot", limit=2.0, actuators=("elbow_torque",), initial_state="random")
    first, other, again = (env.reset(seed=seed)[1]["state"] for seed in (1, 2, 1))
    assert not np.array_equal(first, other) and np.array_equal(first, again)
    given = [np.pi, 0.1, 0.0, 0.5]
    _, info = env.reset(options={"state": given})
    np.testing.assert_array_equal(info["state"], given)
    assert env.action_space.shape == (1,)
    _, _, _, _, info = env.step(np.array([-1.0], np.float32))
    np.testing.assert_array_equal(info["input"], [0.0, -2.0])
    expected = env.unwrapped.system.simulate(np.array(given), np.array([0.0, -2.0]), 1, clip=False).state[0]
    np.testing.assert_allclose(info["state"], expected)
    with pytest.raises(KeycldError, match="give 4 numbers"):
        env.reset(options={"state": [1.0]})


@pytest.mark.parametrize("limit", [None, np.inf])
def test_unlimited_inputs_are_the_inputs_themselves(make, limit):
    env = make("Pendulum", limit=limit)
    env.reset(seed=0)
    assert not env.action_space.is_bounded()
    _, _, _, _, info = env.step(np.array([7.5], np.float32))
    assert info["input"] == 7.5


def test_upright_is_the_best_reward(make):
    env = make("Cartpole")
    rewards = []
    for angle in (0.0, np.pi / 2, np.pi):
        env.reset(options={"state": [0.0, angle, 0.0, 0.0]})
        rewards.append(env.step(np.zeros(2, np.float32))[1])
    np.testing.assert_allclose(rewards, [1.0, 0.5, 0.0], atol=1e-2)


def test_wrong_options(monkeypatch):
    from keycld.control.environments import SwingUp

    monkeypatch.setitem(registry._SYSTEMS, "bead", get("pendulum"))
    with pytest.raises(KeycldError, match="toy/pendulum has no environment: choose from acrobot, bead, cartpole, pend"):
        SwingUp("toy/pendulum")
    with pytest.raises(KeycldError, match="is rest or random"):
        SwingUp("pendulum", initial_state="top")
    with pytest.raises(KeycldError, match="no input 'wheel'"):
        SwingUp("pendulum", actuators=("wheel",))
    with pytest.raises(KeycldError, match="call reset"):
        SwingUp("pendulum").step(np.zeros(1))


def test_imagination_steps_the_dynamics_and_vmaps():
    known = truth("acrobot")
    poses = jax.vmap(known.position)(jnp.array([[0.5, 1.0], [2.0, -1.0], [3.0, 0.1]]))
    dt = known.system.dt
    world = Imagination(known.law, known.dynamics, dt, poses, known.upright, limit=3.0, steps=2)
    states = jax.vmap(world.reset)(jax.random.split(jax.random.key(0), 50))
    assert states.coordinates.x.shape == (50, 4) and not np.any(states.coordinates.v)
    distances = np.abs(np.asarray(states.coordinates.x)[:, None] - np.asarray(poses)[None]).max(-1)
    assert np.all(distances.min(1) == 0) and len(np.unique(distances.argmin(1))) == 3
    u = jnp.broadcast_to(jnp.array([9.0, -0.5]), (50, 2))
    after = jax.jit(jax.vmap(world.step))(states, u)
    expected = jax.jit(jax.vmap(lambda s: known.dynamics.step(s, jnp.array([3.0, -0.5]), dt)))(states)
    np.testing.assert_allclose(after.state.coordinates.x, expected.coordinates.x, atol=1e-6)
    assert np.all(np.asarray(after.reward) < 0) and not np.any(after.truncated)
    still = world.reset(jax.random.key(1))
    assert world.step(still, u[0], 1).truncated
    with pytest.raises(KeycldError, match="observed initial poses"):
        Imagination.of(PendulumModel.make(), dt, poses[:0], known.upright)
