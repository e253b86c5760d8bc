"""Constrained Cartesian mechanics against what is known: MuJoCo, angles, a linkage with a bar too many."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mechanics_examples import GOLDEN, GRAVITY, double_pendulum, initial_state, last, law, on_circle, pendulum, rollout

from keycld.mechanics import (
    RK4,
    ConstrainedLagrangian,
    Constraints,
    CoupledMasses,
    DistanceToPoint,
    FixedDistance,
    GeneralizedLagrangian,
    MechanicalDynamics,
    Motion,
    OnLine,
    PointMasses,
    Rattle,
    RigidBody,
    State,
    pulled_back,
    two_point_masses,
)


def body(golden, index):
    centre = np.array([0.0, float(golden["body_centre"][index])])
    return RigidBody(float(golden["body_mass"][index]), float(golden["body_inertia"][index]), centre)


def turned(arm):
    """Per unit of clockwise angle, how a point at the end of an arm moves: MuJoCo's angles grow from +z to +x."""
    return jnp.stack([arm[1], -arm[0]])


def mujoco_cartpole(golden):
    pole = two_point_masses(body(golden, 1), np.zeros(2))
    masses = np.array([golden["body_mass"][0] + pole.masses[0], pole.masses[1]])
    length = float(np.linalg.norm(pole.points[1]))

    def input_matrix(x):
        arm = x[2:] - x[:2]
        couple = turned(arm) / jnp.sum(arm * arm)
        slide = jnp.array([4.0, 0.0, 0.0, 0.0])
        return jnp.stack([slide, jnp.concatenate([-couple, couple])], axis=1)

    system = ConstrainedLagrangian(
        PointMasses(jnp.sqrt(jnp.asarray(masses, float))),
        lambda x: GRAVITY * jnp.sum(jnp.asarray(masses, x.dtype) * x[1::2]),
        input_matrix,
        Constraints(("cart", "pole"), (OnLine("cart"), FixedDistance("cart", "pole"))),
    )

    def position(q):
        return jnp.stack([q[0], 0 * q[0], q[0] + length * jnp.sin(q[1]), length * jnp.cos(q[1])])

    def angles(x):
        return np.stack([x[:, 0], np.unwrap(np.arctan2(x[:, 2] - x[:, 0], x[:, 3] - x[:, 1]))], axis=1)

    return system, position, angles


def mujoco_acrobot(golden):
    upper, lower = body(golden, 0), body(golden, 1)
    # The upper arm only turns about the shoulder, so one mass at the elbow has its kinetic energy; its weight
    # acts at its own centre. The lower arm is two point masses, one of them at the elbow.
    moment = upper.inertia + upper.mass * upper.centre[1] ** 2
    pair = two_point_masses(lower, np.zeros(2))
    masses = np.array([moment + pair.masses[0], pair.masses[1]])
    weights = GRAVITY * np.array([upper.mass * upper.centre[1] + pair.masses[0], pair.masses[1]])
    length = float(np.linalg.norm(pair.points[1]))

    def input_matrix(x):
        arm = x[2:] - x[:2]
        shoulder = turned(x[:2])
        elbow = turned(arm) / jnp.sum(arm * arm)
        none = jnp.zeros(2)
        first = jnp.concatenate([2 * shoulder, none])
        second = 2 * jnp.concatenate([-elbow - shoulder, elbow])
        return jnp.stack([first, second], axis=1)

    system = ConstrainedLagrangian(
        PointMasses(jnp.sqrt(jnp.asarray(masses, float))),
        lambda x: jnp.sum(jnp.asarray(weights, x.dtype) * x[1::2]),
        input_matrix,
        Constraints(("elbow", "tip"), (DistanceToPoint("elbow"), FixedDistance("elbow", "tip"))),
    )

    def position(q):
        elbow = jnp.stack([jnp.sin(q[0]), jnp.cos(q[0])])
        return jnp.concatenate([elbow, elbow + length * jnp.stack([jnp.sin(q[0] + q[1]), jnp.cos(q[0] + q[1])])])

    def angles(x):
        first = np.unwrap(np.arctan2(x[:, 0], x[:, 1]))
        return np.stack([first, np.unwrap(np.arctan2(x[:, 2] - x[:, 0], x[:, 3] - x[:, 1])) - first], axis=1)

    return system, position, angles


def mujoco_cartpole_by_its_tip(golden):
    """The pole's end as keypoint, which is no centre of percussion: its mass must couple the two keypoints."""
    pole, tip = body(golden, 1), 1.0
    # A point at the share s of the way to the tip moves as (1 - s) v1 + s v2; these are the moments of 1 - s and s.
    share = float(pole.centre[1]) / tip
    square = pole.inertia / tip**2 + pole.mass * share**2
    mixed = pole.mass * share - square
    rest = pole.mass - 2 * mixed - square
    matrix = np.array([[golden["body_mass"][0] + rest, mixed], [mixed, square]])
    weights = GRAVITY * matrix.sum(axis=1)

    def input_matrix(x):
        arm = x[2:] - x[:2]
        couple = turned(arm) / jnp.sum(arm * arm)
        slide = jnp.array([4.0, 0.0, 0.0, 0.0])
        return jnp.stack([slide, jnp.concatenate([-couple, couple])], axis=1)

    system = ConstrainedLagrangian(
        CoupledMasses(jnp.asarray(np.linalg.cholesky(np.linalg.inv(matrix)), float)),
        lambda x: jnp.sum(jnp.asarray(weights, x.dtype) * x[1::2]),
        input_matrix,
        Constraints(("cart", "tip"), (OnLine("cart"), FixedDistance("cart", "tip"))),
    )

    def position(q):
        return jnp.stack([q[0], 0 * q[0], q[0] + tip * jnp.sin(q[1]), tip * jnp.cos(q[1])])

    def angles(x):
        return np.stack([x[:, 0], np.unwrap(np.arctan2(x[:, 2] - x[:, 0], x[:, 3] - x[:, 1]))], axis=1)

    return system, position, angles


@pytest.mark.parametrize(
    ("name", "build"),
    [("cartpole", mujoco_cartpole), ("cartpole", mujoco_cartpole_by_its_tip), ("acrobot", mujoco_acrobot)],
)
def test_true_masses_follow_mujoco_for_50_frames(name, build):
    """MuJoCo's mass and inertia as point masses (A.3), its own runs with inputs, float32, RATTLE."""
    golden = np.load(GOLDEN / f"{name}.npz")
    system, position, angles = build(golden)
    dynamics = MechanicalDynamics(system, Rattle(substeps=16))

    @jax.jit
    @jax.vmap
    def run_all(q, qdot, u):
        x, v = jax.jvp(position, (q,), (qdot,))
        state = State(Motion(x, v), {"constants": system.constraint(x)})
        return dynamics.rollout(state, u, float(golden["dt"]), 50).x

    runs = run_all(*(jnp.asarray(golden[key], float) for key in ("qpos0", "qvel0", "action")))
    for run, qpos0, qpos in zip(np.asarray(runs), golden["qpos0"], golden["qpos"], strict=True):
        found = angles(run)
        turns = np.round((qpos0 - found[0]) / (2 * np.pi)) * 2 * np.pi
        if name == "cartpole":
            turns[0] = 0
        np.testing.assert_allclose(found[1:] + turns, qpos, atol=1e-3)


def swing(factor, potential, angle, speed, dt, steps):
    """The same motion in generalised coordinates by RK4 in float64."""
    general = GeneralizedLagrangian(factor, potential)
    state = State(Motion(jnp.asarray(angle, float), jnp.asarray(speed, float)), {})
    return np.asarray(rollout(MechanicalDynamics(general, RK4(8)), state, jnp.zeros(0), dt, steps).x)


def test_constrained_pendulum_is_the_pendulum_of_one_angle():
    angle = 2.5
    with jax.enable_x64(True):
        expected = swing(lambda q: jnp.eye(1), lambda q: -GRAVITY * jnp.cos(q[0]), [angle], [0.0], 0.02, 100)
        system = pendulum()
        dynamics = MechanicalDynamics(system, Rattle(32))
        motion = rollout(dynamics, initial_state(system, on_circle([angle])), jnp.zeros(0), 0.02, 100)
        np.testing.assert_allclose(motion.x[:, 0], np.sin(expected[:, 0]), atol=1e-4)
        np.testing.assert_allclose(motion.x[:, 1], -np.cos(expected[:, 0]), atol=1e-4)


def test_constrained_double_pendulum_is_its_pull_back():
    def chain(q):
        first = jnp.stack([jnp.sin(q[0]), -jnp.cos(q[0])])
        return jnp.concatenate([first, first + jnp.stack([jnp.sin(q[1]), -jnp.cos(q[1])])])

    with jax.enable_x64(True):
        system = double_pendulum(input_matrix=lambda x: jnp.stack([x[3], x[0], x[1], -x[2]])[:, None])
        angles = jnp.array([2.0, 1.0])
        u = jnp.array([0.4])
        general = pulled_back(system, chain)
        state = State(Motion(angles, jnp.array([0.5, -0.3])), {})
        q, qdot = rollout(MechanicalDynamics(general, RK4(4)), state, u, 0.02, 50)
        x, v = jax.jvp(chain, (angles,), (state.coordinates.v,))
        motion = rollout(MechanicalDynamics(system, RK4(4)), initial_state(system, x, v), u, 0.02, 50)
        np.testing.assert_allclose(motion.x, jax.vmap(chain)(q), atol=1e-6)
        energy = jax.vmap(general.energy)(q, qdot)
        np.testing.assert_allclose(energy, jax.vmap(system.energy)(*motion), rtol=1e-5)


def test_four_bar_linkage_with_a_redundant_bar():
    """A rigid plate on parallel bars swings like a pendulum; the third bar constrains nothing new."""
    feet = np.array([[0.0, 0.0], [1.0, 0.0], [0.4, 0.3]])
    names = ("a", "b", "c")
    items = [DistanceToPoint(name, tuple(foot)) for name, foot in zip(names, feet, strict=True)]
    items += [FixedDistance("a", "b"), FixedDistance("b", "c"), FixedDistance("a", "c")]
    system = law([1.0, 2.0, 0.5], Constraints(names, items))
    angle = 1.3
    bar = np.array([np.sin(angle), -np.cos(angle)])
    state = initial_state(system, (feet + bar).reshape(-1))
    x = state.coordinates.x
    jacobian = system.jacobian(x)
    assert np.linalg.matrix_rank(np.asarray(jacobian), tol=1e-4) == 5 and len(jacobian) == 6
    motion = rollout(MechanicalDynamics(system, Rattle(8)), state, jnp.zeros(0), 0.02, 150)
    with jax.enable_x64(True):
        expected = swing(lambda q: jnp.eye(1), lambda q: -GRAVITY * jnp.cos(q[0]), [angle], [0.0], 0.02, 150)
    found = np.unwrap(np.arctan2(np.asarray(motion.x[:, 0]), -np.asarray(motion.x[:, 1])))
    # The redundant bar makes the linear systems singular; single precision then leaves a milliradian or two in 3 s.
    np.testing.assert_allclose(found, expected[:, 0], atol=3e-3)
    constraint = jax.vmap(system.constraint)(motion.x)
    # The bar too many follows from the others, whose rounding the linkage magnifies.
    assert float(jnp.abs(constraint - constraint[:1]).max()) < 2e-5


def test_period_of_a_small_swing():
    system = pendulum()
    state = initial_state(system, on_circle([0.01]))
    period = 2 * np.pi / np.sqrt(GRAVITY)
    half = last(rollout(MechanicalDynamics(system, Rattle(4)), state, jnp.zeros(0), period / 200, 100))
    np.testing.assert_allclose(half.x[0], -state.coordinates.x[0], rtol=1e-3)


def test_damped_free_mass_comes_to_rest_as_an_exponential():
    damping, time = 0.6, 2.0
    system = law([0.5], None, damping=[[damping]], potential=lambda x: 0.0 * x[0])
    state = initial_state(system, jnp.zeros(2), jnp.array([1.0, -2.0]))
    moved = last(rollout(MechanicalDynamics(system, Rattle()), state, jnp.zeros(0), time / 50, 50))
    # The mid-point rule is exact to the third order of the 2.4 % that a half step takes.
    np.testing.assert_allclose(moved.v, np.exp(-damping / 0.5 * time) * np.array([1.0, -2.0]), rtol=3e-4)
