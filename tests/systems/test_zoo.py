"""The zoo: each recording is a motion of the stated equation, and each picture shows it."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from segmentation import zoo_masks

from keycld.cli.main import main
from keycld.data import check, open_data
from keycld.systems import Conditions, Task, get, names, run_in_processes
from keycld.systems.zoo.base import AbstractZooSystem

NAMES = names(AbstractZooSystem)
SEEDS, FRAMES, G = 20, 200, 9.81
MOVING = Conditions(control="none", initial_state="moving")
SIZE = 256


@cache
def recording(name, seed):
    return get(name).record(np.random.RandomState(seed), FRAMES, MOVING)


def recorded(name, count=SEEDS):
    """Undriven recordings of so many seeds."""
    return [recording(name, seed) for seed in range(count)]


def driven(name):
    """Recordings of other seeds with an input, where there is one."""
    conditions = Conditions(initial_state="moving")
    seeds = range(100, 100 + SEEDS) if get(name).input_names else ()
    return [get(name).record(np.random.RandomState(seed), 50, conditions) for seed in seeds]


def ball(mass, radius):
    return 0.4 * mass * radius**2


def lagrangian(function, force=None):
    """q̈ of L(q, v) with generalised forces τ(q, v, u)."""

    def acceleration(q, v, u):
        mass = jax.hessian(function, 1)(q, v)
        right = jax.grad(function)(q, v) - jax.jacobian(jax.grad(function, 1))(q, v) @ v
        return jnp.linalg.solve(mass, right + (0.0 if force is None else force(q, v, u)))

    return acceleration


def chain(masses, lengths, radii):
    """L of bobs on massless rods, by absolute angles from upright."""
    masses, lengths, radii = map(np.array, (masses, lengths, radii))

    def places(q):
        angle = jnp.cumsum(q)
        return jnp.cumsum(lengths[:, None] * jnp.stack([jnp.sin(angle), jnp.cos(angle)], axis=1), axis=0)

    def function(q, v):
        _, speed = jax.jvp(places, (q,), (v,))
        kinetic = masses @ jnp.sum(speed**2, axis=1) / 2 + ball(masses, radii) @ jnp.cumsum(v) ** 2 / 2
        return kinetic - G * masses @ places(q)[:, 1]

    return function


def linkage(places, masses, angles, inertias):
    """L of point masses and turning links, all functions of one angle."""

    def function(q, v):
        at, speed = jax.jvp(places, (q[0],), (v[0],))
        _, turning = jax.jvp(angles, (q[0],), (v[0],))
        kinetic = jnp.array(masses) @ jnp.sum(speed**2, axis=1) + jnp.array(inertias) @ turning**2
        return kinetic / 2 - G * jnp.array(masses) @ at[:, 1]

    return function


def tip(length, angle):
    return length * jnp.stack([jnp.sin(angle), jnp.cos(angle)])


def slider_crank():
    def rod(angle):
        return jnp.pi / 2 + jnp.arcsin(0.35 / 0.9 * jnp.cos(angle))

    def places(angle):
        pin = tip(0.35, angle)
        return jnp.stack([pin, pin + tip(0.45, rod(angle)), pin + tip(0.9, rod(angle))])

    return linkage(places, [0.5, 0.2, 1.0], lambda a: jnp.stack([a, rod(a)]), [0.0024, 0.0135])


def four_bar():
    """By the law of cosines in the triangle of crank's end, rocker's end and rocker's pivot."""

    def angles(crank):
        end = tip(0.35, crank) - jnp.array([0.5, 0.0])
        gap = jnp.array([0.5, 0.0]) - end
        distance = jnp.linalg.norm(gap)
        lean = jnp.arctan2(gap[0], gap[1])
        coupler = lean - jnp.arccos((1.0 + distance**2 - 0.49) / (2 * distance))
        rocker = lean + jnp.arccos((0.49 + distance**2 - 1.0) / (2 * 0.7 * distance)) - jnp.pi
        return jnp.stack([crank, coupler, rocker])

    def places(crank):
        _, coupler, rocker = angles(crank)
        end = tip(0.35, crank) - jnp.array([0.5, 0.0])
        point = end + tip(0.5, coupler) + tip(0.35, coupler - jnp.pi / 2)
        return jnp.stack([end, point, jnp.array([0.5, 0.0]) + tip(0.7, rocker)])

    inertias = [ball(0.5, 0.12), ball(0.3, 0.12), ball(0.5, 0.12)]
    return linkage(places, [0.5, 0.3, 0.5], angles, inertias)


def cart_pendulum(q, v):
    (s, angle), (speed, turning) = q, v
    kinetic = 1.3 * speed**2 / 2 + 0.3 * 0.55 * speed * turning * jnp.cos(angle)
    kinetic += (0.3 * 0.55**2 + ball(0.3, 0.13)) * turning**2 / 2
    return kinetic - 5.0 * s**2 - 0.3 * G * 0.55 * jnp.cos(angle)


def elastic(q, v, u):
    length = jnp.linalg.norm(q)
    return -25.0 / 0.8 * (length - 0.6) * q / length - jnp.array([0.0, G])


def attraction(q, v, u):
    gap = q[2:] - q[:2]
    pull = 1.6 * gap / (gap @ gap + 0.25**2) ** 1.5
    return jnp.concatenate([pull / 1.0, -pull / 0.6])


def damped_pendulum(q, v, u):
    return (0.8 * G * jnp.sin(q) - 0.1 * v) / (0.8**2 + ball(1.0, 0.14))


def tilted_bead(q, v, u):
    return G * jnp.sin(jnp.radians(20.0)) - (6.0 * q + 0.08 * v + 0.06 * jnp.tanh(v / 0.05)) / 0.5


double = chain([1.0, 0.6], [0.6, 0.5], [0.13, 0.11])
EQUATIONS = {
    "zoo/spring_cart": lambda q, v, u: -8.0 * q + 0.5 * u,
    "zoo/coupled_carts": lambda q, v, u: (jnp.array([[-20.0, 8.0], [8.0, -20.0]]) @ q) / jnp.array([1.0, 0.7]),
    "zoo/spring_bob": lambda q, v, u: -G - 20.0 / 0.8 * q,
    "zoo/elastic_pendulum": elastic,
    "zoo/damped_pendulum": damped_pendulum,
    "zoo/damped_double_pendulum": lagrangian(double, lambda q, v, u: jnp.array([0.5, 0.0]) * u - 0.04 * v),
    "zoo/triple_pendulum": lagrangian(chain([0.5] * 3, [0.42] * 3, [0.13] * 3)),
    "zoo/slider_crank": lagrangian(slider_crank()),
    "zoo/four_bar": lagrangian(four_bar()),
    "zoo/spring_cart_pendulum": lagrangian(cart_pendulum),
    "zoo/tilted_bead": tilted_bead,
    "zoo/two_bodies": attraction,
}
# What friction takes, in watts.
LOSSES = {
    "zoo/damped_pendulum": lambda v: 0.1 * v[:, 0] ** 2,
    "zoo/damped_double_pendulum": lambda v: 0.04 * np.sum(v**2, axis=1),
    "zoo/tilted_bead": lambda v: 0.08 * v[:, 0] ** 2 + 0.06 * v[:, 0] * np.tanh(v[:, 0] / 0.05),
}


def test_there_are_twelve_and_two_have_motors():
    assert len(NAMES) == 12 and set(EQUATIONS) == set(NAMES)
    assert [name for name in NAMES if get(name).input_names] == ["zoo/damped_double_pendulum", "zoo/spring_cart"]


@pytest.mark.parametrize("name", NAMES)
def test_accelerations_are_those_of_the_equation(name):
    system = get(name)
    run = system.record(np.random.RandomState(3), 60, Conditions(initial_state="moving"))
    half = len(system.units) // 2
    with jax.enable_x64(True):
        q, v = jnp.asarray(run.state[:, :half]), jnp.asarray(run.state[:, half:])
        expected = jax.jit(jax.vmap(EQUATIONS[name], (0, 0, None)))(q, v, jnp.asarray(run.input))
        np.testing.assert_allclose(run.state_derivative[:, half:], expected, rtol=1e-7, atol=1e-6)
    np.testing.assert_array_equal(run.state_derivative[:, :half], run.state[:, half:])
    assert np.all(run.input != 0.0)


@pytest.mark.parametrize("name", NAMES)
def test_states_are_integrals_of_their_derivatives(name, monkeypatch):
    system = get(name)
    run = system.record(np.random.RandomState(4), 50, Conditions(initial_state="moving"))
    # Simpson's rule over two frames.
    derivative = run.state_derivative
    change = system.dt / 3 * (derivative[:-2] + 4 * derivative[1:-1] + derivative[2:])
    scale = system.dt * np.abs(derivative).max(axis=0)
    assert np.all(np.abs(run.state[2:] - run.state[:-2] - change) < 0.05 * scale)
    monkeypatch.setattr(type(system), "substeps", 4 * system.substeps)
    finer = system.record(np.random.RandomState(4), 50, Conditions(initial_state="moving"))
    np.testing.assert_allclose(run.state, finer.state, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_motions_stay_in_the_picture_and_can_be_followed(name):
    system = get(name)
    half = len(system.units) // 2
    angles = [unit == "rad" for unit in system.units[:half]]
    for run in [*recorded(name), *driven(name)]:
        places = system.landmarks(run.state)
        # In pixels; the largest disc has a radius of five.
        assert np.all(31.5 * (1.0 - np.abs(places)) > 2.0)
        assert 31.5 * np.linalg.norm(np.diff(places, axis=0), axis=-1).max() < 4.0
        assert np.all(np.abs(np.diff(run.state[:, :half][:, angles], axis=0)) < 0.5)
    first = np.stack([run.state[0, half:] for run in recorded(name)])
    assert np.all(np.linalg.norm(first, axis=1) > 1e-2) and np.all(first.std(axis=0) > 0.1)


@pytest.mark.parametrize("name", NAMES)
def test_energy_is_kept_or_lost_at_the_stated_rate(name):
    system = get(name)
    half = len(system.units) // 2
    for run in recorded(name, 3):
        kinetic, potential = system.energies(run.state[:-1])
        energy = kinetic + potential
        if name not in LOSSES:
            assert np.ptp(energy) < 1e-5 * max(np.ptp(kinetic), np.ptp(potential))
            continue
        power = -LOSSES[name](run.state[:-1, half:])
        weights = np.array([1, *[4, 2] * (FRAMES // 2 - 2), 4, 1]) * system.dt / 3
        np.testing.assert_allclose(energy[-1] - energy[0], power @ weights, rtol=5e-3)
        assert energy[-1] < energy[0]


@pytest.mark.parametrize("name", NAMES)
def test_suggested_constraints_are_constant(name):
    system = get(name)
    constraints = system.constraints
    assert constraints.keypoints == system.keypoints
    for run in recorded(name, 2):
        x = system.landmarks(run.state).reshape(FRAMES, -1).astype(np.float32)
        values = np.asarray(jax.jit(jax.vmap(lambda x: constraints(x, {})))(x))
        assert values.shape == (FRAMES, constraints.count)
        assert np.all(np.ptp(values, axis=0) < 1e-5)
        # All of them together leave as many directions as there are coordinates.
        jacobian = np.asarray(jax.jacobian(lambda x: constraints(x, {}))(x[FRAMES // 2]))
        rank = np.linalg.matrix_rank(jacobian, tol=1e-4) if constraints.count else 0
        assert x.shape[1] - rank == len(system.units) // 2


@pytest.mark.parametrize("name", NAMES)
def test_pictures_show_the_keypoints_where_they_are(name):
    system = get(name)
    random = np.random.RandomState(0)
    states = np.stack([system.record(random, 1, MOVING).state[0] for _ in range(12)])
    [(_, (pictures, found))] = run_in_processes([Task(zoo_masks, (name, states, SIZE))])
    axis = np.linspace(-1.0, 1.0, SIZE) * (64 / 63) / (SIZE / (SIZE - 1))
    for k, keypoint in enumerate(system.keypoints):
        masks = np.stack([each[keypoint] for each in found])
        pixels = masks.sum(axis=(1, 2))
        # At least five pixels across at 64 × 64.
        assert pixels.max() > np.pi / 4 * (4 * 5.0) ** 2
        whole = pixels > 0.9 * pixels.max()
        assert whole.sum() >= 6
        for mask, place, picture in zip(masks[whole], system.landmarks(states)[whole, k], pictures[whole], strict=True):
            row, column = np.nonzero(mask)
            centre = np.array([axis[column].mean(), -axis[row].mean()])
            assert np.linalg.norm(centre - place) < 0.5 / 31.5
            # Its colour differs from what surrounds it.
            share = mask.reshape(64, 4, 64, 4).mean(axis=(1, 3))
            near = np.hypot(*np.meshgrid(np.linspace(-1, 1, 64) - place[0], -np.linspace(-1, 1, 64) - place[1])) < 0.35
            inside, around = picture[share == 1.0].mean(axis=0), picture[near & (share == 0.0)].mean(axis=0)
            assert np.abs(inside - around).max() > 40


def test_the_command_makes_a_set(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    runs = ["--train", "2", "--validation", "1", "--test", "1", "--long", "1"]
    assert main(["data", "make", "zoo/spring_cart", *runs]) == 0
    data = open_data("zoo/spring_cart")
    assert str(data.folder) == "data/zoo/spring_cart" and check(data.folder) == []
    assert data.attributes["protocol"] == "zoo" and data.input_names == ("force",)
    assert data.train().image.shape == (2, 50, 64, 64, 3)
    assert [sweep.vary for sweep in data.sweeps()] == [("position",)]
    assert data.test().state_derivative.shape == (1, 50, 2)
    assert data.keypoints == ("cart",) and "test_long" in data.splits


def test_other_protocols_are_refused(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["data", "make", "zoo/four_bar", "--protocol", "keycld-2022"]) == 2
    told = "protocol keycld-2022 begins with the initial state 'rest', which zoo/four_bar does not have: leave out"
    assert told in capsys.readouterr().err
    assert main(["data", "make", "pendulum", "--protocol", "zoo"]) == 2
    assert "'moving', which pendulum does not have: leave out --protocol, or choose" in capsys.readouterr().err
    assert main(["data", "make", "pendulum", "--initial-state", "moving"]) == 2
    assert "pendulum has no initial state 'moving': choose from rest" in capsys.readouterr().err
