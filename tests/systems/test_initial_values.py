"""Toy physics and games move as their equations say."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld.systems import AbstractInitialValueSystem, get, names
from keycld.systems.hamiltonian.base import AbstractHamiltonianSystem
from keycld.systems.hamiltonian.kepler import kepler
from keycld.systems.solving import solve

NAMES = names(AbstractInitialValueSystem)


def record(name, count=4, frames=64, protocol="priors-released"):
    return get(name).record(range(count), frames, protocol, "default")


@pytest.mark.parametrize("name", [name for name in NAMES if "friction" not in name])
def test_without_friction_something_is_conserved(name):
    recording = record(name)
    conserved = get(name).all_conserved(recording.state, recording.parameters)
    assert np.abs(conserved - conserved[:, :1]).max() < 1e-7


@pytest.mark.parametrize("name", [name for name in NAMES if "friction" in name])
def test_friction_takes_its_share_of_energy(name):
    """dH/dt = −λ |∂H/∂p|², by Simpson's rule over three seconds."""
    system = get(name)
    sampled = [system.initial_state(np.random.RandomState(seed), "priors-released") for seed in range(4)]
    parameters = {key: np.stack([given[key] for _, given in sampled]) for key in sampled[0][1]}
    times = np.linspace(0.0, 3.0, 401)
    state = system.move(np.stack([start for start, _ in sampled]), parameters, times)
    energy = system.all_conserved(state, parameters)
    velocity = system.derivatives(state, parameters)[..., : state.shape[-1] // 2]
    power = -system.friction * np.sum(velocity**2, axis=-1)
    weights = np.array([1, *[4, 2] * 199, 4, 1]) * times[1] / 3
    np.testing.assert_allclose(energy[:, -1] - energy[:, 0], power @ weights, rtol=1e-3)


@pytest.mark.parametrize("name", ["toy/mass_spring_colors_friction", "toy/two_body_colors"])
def test_closed_forms_solve_the_equations(name):
    system, recording = get(name), record(name)
    with jax.enable_x64(True):
        first = {key: jnp.asarray(value[0]) for key, value in recording.parameters.items()}
        solved = jax.jit(lambda y, t: solve(lambda y: system.derivative(y, first), y, t, 1e-12))(
            jnp.asarray(recording.state[0, 0]), jnp.asarray(recording.time)
        )
    np.testing.assert_allclose(recording.state[0], solved, atol=1e-9)


@pytest.mark.parametrize("speed", [0.0, 0.5, 1.0, np.sqrt(2.0), 2.0])
def test_kepler_on_every_conic(speed):
    """From straight fall over circle and parabola to hyperbola; energy, angular momentum, and the motion backward."""
    start, velocity = np.array([1.0, 0.0]), np.array([0.0, speed])
    with jax.enable_x64(True):
        times = jnp.array([0.0, 1e-6, 0.7, 1.0 if speed == 0 else 30.0])
        there = jax.jit(jax.vmap(lambda t: kepler(jnp.asarray(start), jnp.asarray(velocity), jnp.array(1.0), t)))
        x, v = there(times)
        back, _ = kepler(x[3], -v[3], jnp.array(1.0), times[3])
    np.testing.assert_array_equal(x[0], start)
    energy = np.sum(np.square(v), axis=1) / 2 - 1 / np.linalg.norm(x, axis=1)
    np.testing.assert_allclose(energy, speed**2 / 2 - 1, atol=1e-11)
    np.testing.assert_allclose(x[:, 0] * v[:, 1] - x[:, 1] * v[:, 0], speed, atol=1e-12)
    np.testing.assert_allclose(back, start, atol=1e-9)
    if speed == 1.0:
        np.testing.assert_allclose(x[:, 0], np.cos(times), atol=1e-12)


def test_two_bodies_without_colours_go_in_circles():
    recording = record("toy/two_body", frames=256)
    radius = np.linalg.norm(recording.state[..., :2], axis=-1)
    np.testing.assert_allclose(radius, np.broadcast_to(radius[:, :1], radius.shape), rtol=1e-12)


def test_orbits_that_leave_the_canvas_are_sampled_again():
    recording = record("toy/two_body_colors", count=400, frames=256)
    assert np.abs(recording.state[..., :4]).max() <= 5.0
    draws = recording.parameters["draws"]
    # 78 % are accepted, so a trajectory takes 1.28 samples on average, with a deviation of 0.6.
    assert draws.mean() == pytest.approx(1.28, abs=4 * 0.6 / 20) and draws.max() > 1
    alone = get("toy/two_body_colors").record(range(7, 9), 256, "priors-released", "default")
    np.testing.assert_allclose(alone.state, recording.state[7:9], atol=1e-12)


def test_small_swings_and_games_have_their_periods():
    times, small = 0.05 * np.arange(400), 1e-3
    pendulum = get("toy/pendulum").move(np.array([[small, 0.0]]), {k: np.array([v]) for k, v in
        {"m": 0.5, "g": 3.0, "l": 1.0}.items()}, times)[0, :, 0]  # fmt: skip
    np.testing.assert_allclose(pendulum, small * np.cos(np.sqrt(3.0) * times), atol=1e-8)
    pennies = get("games/matching_pennies").move(np.array([[0.5 + small, 0.5 - small, 0.5, 0.5]]), {}, times)[0, :, 0]
    np.testing.assert_allclose(pennies - 0.5, small * np.cos(times), atol=1e-7)


def test_strategies_stay_shares():
    for name in ("games/matching_pennies", "games/rock_paper_scissors"):
        state = record(name).state
        n = state.shape[-1] // 2
        np.testing.assert_allclose(state[..., :n].sum(axis=-1), 1.0, atol=1e-10)
        assert state.min() > 0


def test_a_trajectory_does_not_depend_on_its_neighbours():
    whole, part = (
        record("toy/mass_spring_colors", count=5),
        get("toy/mass_spring_colors").record(range(3, 5), 64, "priors-released", "default"),
    )
    np.testing.assert_array_equal(part.state, whole.state[3:])
    np.testing.assert_array_equal(part.parameters["offset"], whole.parameters["offset"][3:])


@pytest.mark.parametrize("name", names(AbstractHamiltonianSystem))
def test_landmarks_lie_on_the_discs(name):
    system = get(name)
    if system.parameters_differ or not system.keypoints:  # the state does not tell where the discs are
        assert "colors" in name and (system.constraints is None) == (not system.keypoints)
        assert system.landmarks(record(name).state).shape == (4, 64, 0, 2)
        return
    assert system.constraints.keypoints == system.keypoints
    recording = record(name)
    pictures = system.pictures(recording).image / 255.0
    points = system.landmarks(recording.state)
    axis = np.linspace(-1.0, 1.0, 32)
    coloured = pictures.max(axis=-1) > 0.6
    for i in range(3):
        row, column = np.nonzero(coloured[i, 0])
        middle = np.array([axis[column].mean(), -axis[row].mean()])
        np.testing.assert_allclose(points[i, 0].mean(axis=0), middle, atol=0.12 if len(system.keypoints) > 1 else 0.02)
