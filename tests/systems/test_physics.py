"""The simulated motion is the one that the equations of motion give."""

import numpy as np
import pytest

from keycld.systems import AbstractMujocoSystem, Conditions, get, names

GRAVITY = 9.81


def test_the_pendulums_acceleration_is_its_equations():
    run = get("pendulum").record(np.random.RandomState(7), 50, Conditions())
    angle, acceleration = run.state[:, 0], run.state_derivative[:, 1]
    # m l² θ̈ = m g l sin θ + 2 u, m = 1, l = 0.5; MuJoCo's bob has a radius: 2/5 m r² is added to m l².
    inertia = 0.5**2 + 0.4 * 0.05**2
    np.testing.assert_allclose(acceleration, (GRAVITY * 0.5 * np.sin(angle) + 2.0 * run.input[0]) / inertia, atol=1e-9)


def test_the_cartpoles_momentum_follows_the_force():
    run = get("cartpole").record(np.random.RandomState(100), 50, Conditions())
    _, angle, velocity, turning = run.state.T
    # The horizontal momentum of cart and pole (centre at half a metre) grows by the slider's force, gear 4.
    momentum = (1.0 + 0.1) * velocity + 0.1 * 0.5 * turning * np.cos(angle)
    np.testing.assert_allclose(np.diff(momentum) / 0.01, 4.0 * run.input[0], atol=2e-5)


@pytest.mark.parametrize("name", ["cartpole", "acrobot"])
def test_energy_is_kept_without_input(name):
    system = get(name)
    run = system.record(np.random.RandomState(0), 500, Conditions(control="none", initial_state="released"))
    kinetic, potential = system.energies(run.state)
    total = kinetic + potential
    assert np.ptp(total) < 1e-3 * np.ptp(potential)


@pytest.mark.parametrize("name", names(AbstractMujocoSystem))
def test_the_derivative_is_the_states(name):
    system = get(name)
    run = system.record(np.random.RandomState(5), 50, Conditions(control="none"))
    half = len(system.state_names) // 2
    np.testing.assert_array_equal(run.state_derivative[:, :half], run.state[:, half:])
    central = (run.state[2:] - run.state[:-2]) / (2.0 * system.dt)
    scale = np.abs(run.state_derivative).max()
    assert np.abs(central - run.state_derivative[1:-1]).max() < 0.1 * scale


@pytest.mark.parametrize("name", names(AbstractMujocoSystem))
def test_steps_in_a_row_are_one_simulation(name):
    system = get(name)
    start, u = np.linspace(0.3, 0.6, len(system.state_names)), np.full(len(system.input_names), 0.7)
    whole = system.simulate(start, u, 20)
    state = start
    for k in range(20):
        state = system.simulate(state, u, 1).state[0]
        np.testing.assert_allclose(state, whole.state[k], atol=1e-12)
    varying = system.simulate(start, np.broadcast_to(u, (20, len(u))), 20)
    np.testing.assert_array_equal(varying.state, whole.state)


@pytest.mark.parametrize("name", names(AbstractMujocoSystem))
def test_motors_clip_only_where_they_should(name):
    system = get(name)
    start = np.full(len(system.state_names), 0.1)
    strong, limit = np.full(len(system.input_names), 5.0), np.full(len(system.input_names), system.input_range)
    np.testing.assert_array_equal(
        system.simulate(start, strong, 5, clip=True).state, system.simulate(start, limit, 5, clip=True).state
    )
    free = system.simulate(start, strong, 5, clip=False).state
    assert np.abs(free - system.simulate(start, limit, 5, clip=False).state).max() > 1e-3


@pytest.mark.parametrize("name", names(AbstractMujocoSystem))
def test_half_of_the_upright_runs_begin_close_to_upright(name):
    system = get(name)
    starts, random = (np.array([_start(system, seed, start) for seed in range(400)]) for start in ("upright", "random"))
    # Within three deviations: a fifth of random initial states with one angle, a twenty-fifth with two.
    close, by_chance = (_is_close(system, each) for each in (starts, random))
    assert 0.44 < close.mean() - 0.5 * by_chance.mean() < 0.56
    assert len(np.unique(starts, axis=0)) == len(starts)
    near = starts[close]
    half = near.shape[1] // 2
    # MuJoCo has moved one frame on.
    np.testing.assert_allclose(near[:, :half].std(axis=0), 0.2, atol=0.05)
    assert np.all(near[:, half:].std(axis=0) > 0.7)


def _start(system, seed, start):
    return system.record(np.random.RandomState(seed), 1, Conditions(control="none", initial_state=start)).state[0]


def _is_close(system, states):
    half = states.shape[1] // 2
    return np.all(np.abs(states[:, :half]) < 0.6, axis=1)
