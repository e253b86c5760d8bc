"""Every system with motors, in every control mode and with all kinds of initial states."""

import numpy as np
import pytest

from keycld import KeycldError
from keycld.systems import AbstractMechanism, Conditions, get, names, render

MECHANISMS = names(AbstractMechanism)
CASES = [
    (name, control, start)
    for name in MECHANISMS
    for control in get(name).control_modes
    for start in get(name).initial_states
]


def test_the_papers_systems_are_there():
    assert {"pendulum", "cartpole", "acrobot"} <= set(MECHANISMS) <= set(names())


@pytest.mark.parametrize(("name", "control", "start"), CASES)
def test_two_frames_under_all_conditions(name, control, start):
    system = get(name)
    run = system.record(np.random.RandomState(100), 2, Conditions(control=control, initial_state=start))
    d, inputs = len(system.state_names), len(system.input_names)
    assert run.state.shape == run.state_derivative.shape == (2, d)
    assert run.time.shape == (2,) and run.input.shape == (inputs,)
    assert np.all(np.isfinite(run.state)) and np.all(np.isfinite(run.state_derivative))
    np.testing.assert_allclose(np.diff(run.time), system.dt)
    acting = {"none": [], "under": [0], "full": [*range(inputs)]}.get(control)
    assert list(np.flatnonzero(run.input)) == ([system.input_names.index(control)] if acting is None else acting)
    assert len(system.units) == d
    assert system.landmarks(run.state).shape == (2, len(system.keypoints), 2)


@pytest.mark.parametrize("name", MECHANISMS)
def test_two_pictures(name):
    system = get(name)
    run = system.record(np.random.RandomState(0), 2, Conditions(initial_state=system.initial_states[0]))
    image = render(system, run.state).image
    assert image.shape == (2, system.size, system.size, 3) and image.dtype == np.uint8
    assert image.std() > 10


@pytest.mark.parametrize("name", MECHANISMS)
def test_the_seed_decides(name):
    system = get(name)

    def state(seed):
        conditions = Conditions(initial_state=system.initial_states[0])
        return system.record(np.random.RandomState(seed), 5, conditions).state

    np.testing.assert_array_equal(state(3), state(3))
    assert np.any(state(3) != state(4))


@pytest.mark.parametrize("name", [name for name in MECHANISMS if "released" in get(name).initial_states])
def test_released_runs_begin_at_rest(name):
    system = get(name)
    conditions = Conditions(control="none", initial_state="released")
    run = system.record(np.random.RandomState(0), 2, conditions)
    half = len(system.state_names) // 2
    # After one step from rest the velocities are still one acceleration times dt.
    assert np.all(np.abs(run.state[0, half:]) < 2.0 * system.dt * np.abs(run.state_derivative[0, half:]) + 1e-9)


@pytest.mark.parametrize("name", MECHANISMS)
def test_sweeps_are_at_rest_and_in_the_picture(name):
    system = get(name)
    half = len(system.state_names) // 2
    for sweep in system.sweeps():
        assert len(sweep.state) == np.prod(sweep.shape)
        assert len(sweep.vary) == len(sweep.shape)
        assert not np.any(sweep.state[:, half:])
        assert np.all(np.abs(system.landmarks(sweep.state)) <= 1.0)


def test_an_unknown_name_is_answered_by_the_nearest():
    with pytest.raises(KeycldError, match="did you mean 'pendulum'"):
        get("pendulm")


def test_conditions_that_a_system_does_not_know():
    with pytest.raises(KeycldError, match="pendulum has no control mode 'under': choose from none, full"):
        get("pendulum").check(Conditions(control="under"))
    with pytest.raises(KeycldError, match="no initial state 'upside-down'"):
        get("acrobot").check(Conditions(initial_state="upside-down"))
    with pytest.raises(KeycldError, match="input_limit"):
        get("acrobot").check(Conditions(input_limit=float("nan")))
