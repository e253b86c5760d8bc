"""Toy physics, games, molecular dynamics and rooms move as their equations say."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld import KeycldError
from keycld.systems import AbstractInitialValueSystem, Recording, Task, get, is_software, names, run_in_processes
from keycld.systems.hamiltonian.base import AbstractHamiltonianSystem
from keycld.systems.hamiltonian.kepler import kepler
from keycld.systems.molecular import simulation as molecular
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
    drawn = [system.start(np.random.RandomState(seed), "priors-released") for seed in range(4)]
    parameters = {key: np.stack([given[key] for _, given in drawn]) for key in drawn[0][1]}
    times = np.linspace(0.0, 3.0, 401)
    state = system.move(np.stack([start for start, _ in drawn]), parameters, times)
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
    """From straight fall over circle and parabola to hyperbola; energy, angular momentum, and the way back."""
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


def test_orbits_that_leave_the_canvas_are_drawn_again():
    recording = record("toy/two_body_colors", count=400, frames=256)
    assert np.abs(recording.state[..., :4]).max() <= 5.0
    draws = recording.parameters["draws"]
    # 78 % are accepted, so a trajectory takes 1.28 draws on average, with a deviation of 0.6.
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
    if not system.keypoints:
        assert "colors" in name and system.constraints is None
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


LIQUID = {"particles": 16, "density": 0.77, "temperature": 0.5}


@pytest.fixture(scope="module")
def liquid():
    """Windows [6, 5, 20, 64] of six short simulations."""
    with jax.enable_x64(True):
        lengths = molecular.Lengths(20.0, 5.0, 10.0)
        return molecular.simulate(np.arange(6), **LIQUID, lengths=lengths, windows=5, frames=20)


def energies(state):
    system = get("md/lj_16")
    return system.all_conserved(state.reshape(-1, *state.shape[-2:]), {}).reshape(state.shape[:3])


def test_molecular_dynamics_keeps_energy_and_momentum(liquid):
    energy = energies(liquid)
    assert np.abs(energy - energy.mean(axis=(1, 2), keepdims=True)).max() < 1e-3 * np.abs(energy).mean()
    momentum = liquid[..., 32:].reshape(*liquid.shape[:3], 16, 2).sum(axis=-2)
    assert np.abs(momentum).max() < 1e-10


def test_molecular_dynamics_has_its_temperature(liquid):
    kinetic = 0.5 * np.sum(liquid[..., 32:] ** 2, axis=-1)
    # 30 degrees of freedom: the net momentum is zero.
    assert kinetic.mean() / 15 == pytest.approx(0.5, rel=0.15)


def test_particles_stay_in_the_box_and_apart(liquid):
    place = liquid[..., :32].reshape(-1, 16, 2)
    box = np.sqrt(16 / 0.77)
    assert np.abs(place).max() <= box / 2
    gap = place[:, :, None] - place[:, None]
    gap -= box * np.round(gap / box)
    assert np.sqrt(np.sum(gap**2, axis=-1))[:, ~np.eye(16, dtype=bool)].min() > 0.8


def test_frames_of_a_window_follow_from_the_first(liquid):
    """Taylor's series to second order, over 0.01 τ, with the derivative's forces."""
    system = get("md/lj_16")
    state = liquid[0, 0]
    derivative = system.derivatives(state[None], {})[0]
    later = state[:-1, :32] + 0.01 * derivative[:-1, :32] + 0.5e-4 * derivative[:-1, 32:]
    moved = (state[1:, :32] - later + np.sqrt(16 / 0.77) / 2) % np.sqrt(16 / 0.77) - np.sqrt(16 / 0.77) / 2
    assert np.abs(moved).max() < 5e-4


def test_forces_are_the_slope_of_the_truncated_potential():
    box = 4.5
    x = np.random.RandomState(1).uniform(-2, 2, (2, 5, 1))
    with jax.enable_x64(True):
        force = molecular.forces(jnp.asarray(x), box)
        slope = jax.grad(lambda x: molecular.potential_energy(x, box)[0])(jnp.asarray(x))
        # A pair at three distances; 2.7 along one axis would be 1.8 to the nearest image.
        gaps = [(1.2, 0.0), (1.8, 1.8), (2.2499, 0.0)]
        pairs = jnp.asarray(np.array([np.zeros((3, 2)), gaps]).transpose(2, 0, 1))
        energy, beyond, edge = np.asarray(molecular.potential_energy(pairs, box))
    np.testing.assert_allclose(force, -slope, rtol=1e-9, atol=1e-9)
    assert energy == pytest.approx(4 * (1.2**-12 - 1.2**-6)) and beyond == 0.0
    # Not shifted: the energy jumps where the potential is cut.
    assert edge == pytest.approx(4 * (2.2499**-12 - 2.2499**-6)) and edge < -0.02


def test_a_simulation_does_not_depend_on_its_neighbours(liquid):
    with jax.enable_x64(True):
        lengths = molecular.Lengths(20.0, 5.0, 10.0)
        again = molecular.simulate(np.arange(2, 8), **LIQUID, lengths=lengths, windows=5, frames=20)
    np.testing.assert_array_equal(again[:4], liquid[2:])


def test_windows_must_fit():
    with pytest.raises(KeycldError, match="do not fit into 10 τ"):
        molecular.simulate(np.arange(2), **LIQUID, lengths=molecular.Lengths(1, 1, 10), windows=5, frames=250)


@pytest.mark.parametrize("name", ["room/circle", "room/spiral"])
def test_the_camera_stays_on_the_hemisphere(name):
    recording = get(name).record(range(20), 256, "priors-paper", "default")
    place, velocity = recording.state[..., :3], recording.state[..., 3:]
    np.testing.assert_allclose(np.linalg.norm(place, axis=-1), 1.0, atol=1e-12)
    np.testing.assert_allclose(np.diff(place, axis=1), 0.05 * velocity[:, :-1], atol=1e-12)
    angle = np.unwrap(np.arctan2(place[..., 1], place[..., 0]))
    np.testing.assert_allclose(np.diff(angle), np.radians(0.1), atol=1e-9)
    radius = np.hypot(place[..., 0], place[..., 1])
    growth = 1.0 if "circle" in name else 1.0053611**25.5
    np.testing.assert_allclose(radius[:, -1] / radius[:, 0], growth, rtol=1e-9)


def pictures_of(name, recording):
    """In a process of its own, as data are made."""
    [(_, pictures)] = run_in_processes([Task(get(name).pictures, (recording,))])
    return pictures


def test_rooms_look_as_they_are_furnished():
    recording = get("room/circle").record(range(6), 3, "priors-paper", "default")
    # From above, so that the places of the objects can be read off the picture.
    state = recording.state.copy()
    state[..., :3] = [0.0, 0.0, 1.0]
    overhead = Recording(recording.time, state, recording.parameters | {"angle": np.full(6, -np.pi / 2)})
    image, renderer = pictures_of("room/circle", overhead)
    assert image.shape == (6, 3, 32, 32, 3) and image.dtype == np.uint8
    p, checked = recording.parameters, 0
    for i in range(6):
        for k in range(5):
            height = p["half_sizes"][i, k, 2] + (p["half_sizes"][i, k, 0] if p["shape"][i, k] == 1 else 0.0)
            x, y = p["place"][i, k] / (1 - 2 * height) / np.tan(np.radians(37.5))
            column, row = round(15.5 + 15.5 * x), round(15.5 - 15.5 * y)
            if 1 <= row <= 30 and 1 <= column <= 30 and np.hypot(*p["place"][i, k]) < 0.35:
                seen, own = image[i, 0, row, column] / 255.0, p["color"][i, k]
                assert seen @ own / np.linalg.norm(seen) / np.linalg.norm(own) > 0.97
                checked += 1
    assert checked >= 5
    assert is_software(renderer) or renderer


def test_rooms_turn_slowly():
    recording = get("room/spiral").record(range(2), 4, "priors-paper", "default")
    image = pictures_of("room/spiral", recording).image.astype(float)
    assert 0 < np.abs(np.diff(image, axis=1)).mean() < 3.0
    assert np.abs(image[0] - image[1]).mean() > 20
