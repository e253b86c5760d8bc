"""An identified chain moves in MuJoCo as it does here."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mechanics_examples import on_circle

from keycld._errors import KeycldError
from keycld.mechanics import (
    RK4,
    ConstrainedLagrangian,
    Constraints,
    CoupledMasses,
    DistanceToPoint,
    FixedDistance,
    FunctionConstraint,
    MechanicalDynamics,
    Motion,
    OnLine,
    Springs,
    State,
    SumDissipation,
    SumPotential,
    ViscousFriction,
    to_mjcf,
    with_kinds,
)

mujoco = pytest.importorskip("mujoco")
DT, FRAMES = 1 / 50, 150
CHAIN = (DistanceToPoint("elbow"), FixedDistance("elbow", "tip"))


def law(matrix, items, names, weight, *, springs=None, friction=None, kinds=()):
    terms = {} if springs is None else {"springs": Springs(jnp.asarray(springs, float))}
    viscous = None if friction is None else SumDissipation({"viscous": ViscousFriction(jnp.asarray(friction, float))})
    mass = CoupledMasses.ones(len(names)).nearest(np.asarray(matrix, float))
    potential = SumPotential(jnp.asarray(weight, float), terms)
    return with_kinds(
        ConstrainedLagrangian(mass, potential, None, Constraints(names, items), viscous), kinds, key=jax.random.key(0)
    )


def moved(chosen, x):
    """Keypoints of the law's own motion from rest."""
    roll = MechanicalDynamics(chosen, RK4(20))
    return np.asarray(roll.rollout(State(Motion(x, jnp.zeros_like(x)), {}), jnp.zeros(0), DT, FRAMES - 1).x)


def simulated(chosen, x, q, metres=1.0):
    """Keypoints of the exported model from rest, by its sensors, in image-plane units."""
    model = mujoco.MjModel.from_xml_string(to_mjcf(chosen, np.asarray(chosen.constraint(x)), metres=metres))
    data = mujoco.MjData(model)
    data.qpos[:] = q
    found = []
    for k in range(FRAMES):
        while data.time < k * DT - 1e-9:
            mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        found.append(data.sensordata.reshape(-1, 3)[:, ::2].reshape(-1) / metres)
    return np.array(found)


def test_a_damped_pendulum_about_a_pivot_in_tilted_gravity():
    chosen = law([[2.0]], (DistanceToPoint("ball", (0.1, 0.3)),), ("ball",), [3.0, 18.0], friction=[[0.4]])
    x = jnp.array([0.1, 0.3]) + 0.6 * on_circle([1.1])
    np.testing.assert_allclose(simulated(chosen, x, [1.1]), moved(chosen, x), atol=3e-3)


def test_a_length_in_metres_keeps_the_period():
    """The same picture of a mechanism of another size: gravity grows with the lengths."""
    chosen = law([[1.0]], (DistanceToPoint("ball"),), ("ball",), [0.0, 12.0])
    x = 0.6 * on_circle([0.7])
    np.testing.assert_allclose(simulated(chosen, x, [0.7], metres=0.5), moved(chosen, x), atol=3e-3)


def with_friction(chosen, strength):
    """The law with its one friction term of this strength."""
    return eqx.tree_at(lambda law: law.dissipation, chosen, jax.tree.map(lambda b: b + strength, chosen.dissipation))


@pytest.mark.parametrize(("kind", "strength"), [("viscous", 0.4), ("joints", 0.2), ("coulomb", 0.5)])
def test_a_length_in_metres_keeps_the_friction_of_a_pendulum(kind, strength):
    """R grows as the energies do, with the square of the length, so the same picture shows the same motion."""
    chosen = law([[2.0]], (DistanceToPoint("ball"),), ("ball",), [0.0, 24.0], kinds=(kind,))
    chosen, x = with_friction(chosen, strength), 0.6 * on_circle([0.7])
    np.testing.assert_allclose(simulated(chosen, x, [0.7], metres=0.3), moved(chosen, x), atol=6e-3)


def test_a_length_in_metres_keeps_the_dry_friction_of_a_cart():
    chosen = law([[2.0]], (OnLine("cart"),), ("cart",), [0.0, 0.0], springs=[[30.0]], kinds=("coulomb",))
    chosen, x = with_friction(chosen, 0.5), jnp.array([0.4, 0.1])
    np.testing.assert_allclose(simulated(chosen, x, [0.4 * 0.3], metres=0.3), moved(chosen, x), atol=6e-3)


def test_a_double_pendulum_with_links_of_spread_mass():
    """A mass matrix with coupling, and the weights that gravity of 10 gives these rigid bodies."""
    items = (DistanceToPoint("elbow"), FixedDistance("elbow", "tip"))
    matrix = [[1.6, 0.2], [0.2, 0.7]]
    chosen = law(matrix, items, ("elbow", "tip"), [0, 17.0, 0, 9.0], friction=[[0.3, 0.0], [-0.1, 0.25]])
    x = 0.5 * on_circle([0.6, -0.4])
    np.testing.assert_allclose(simulated(chosen, x, [0.6, -1.0]), moved(chosen, x), atol=5e-3)


@pytest.mark.parametrize("beside", [-0.3, -0.15, 0.1])
def test_friction_that_couples_both_ends_of_a_link(beside):
    """More than the friction of a turning link, as much, and of the other sign: always that of points on its line."""
    matrix = [[1.6, 0.2], [0.2, 0.7]]
    chosen = law(matrix, CHAIN, ("elbow", "tip"), [0, 17.0, 0, 9.0], friction=[[0.8, 0.0], [beside, 0.15]])
    x = 0.5 * on_circle([0.6, -0.4])
    np.testing.assert_allclose(simulated(chosen, x, [0.6, -1.0]), moved(chosen, x), atol=5e-3)


def test_friction_of_three_links():
    """The couplings of one link add to what is left for the links before it."""
    items = (*CHAIN, FixedDistance("tip", "end"))
    friction = [[0.6, 0, 0], [-0.3, 0.5, 0], [0, 0.1, 0.1]]
    chosen = law(np.diag([1.0, 0.6, 0.3]), items, ("elbow", "tip", "end"), [0, 9.0, 0, 5.4, 0, 2.7], friction=friction)
    x = 0.5 * on_circle([0.6, -0.4, 0.2])
    np.testing.assert_allclose(simulated(chosen, x, [0.6, -1.0, 0.6]), moved(chosen, x), atol=5e-3)


def test_friction_that_gives_energy_is_refused():
    chosen = law(np.eye(2), CHAIN, ("elbow", "tip"), [0, 9.0, 0, 9.0], friction=[[0.1, 0], [0.3, 0.2]])
    with pytest.raises(KeycldError, match="the friction of this law gives energy"):
        to_mjcf(chosen, np.ones(2))


def test_hinge_friction_of_a_cart_and_pole():
    items = (OnLine("cart"), FixedDistance("cart", "tip"))
    chosen = law([[1.0, 0.0], [0.0, 0.4]], items, ("cart", "tip"), [0, 0, 0, 4.0], kinds=("joints",))
    chosen = eqx.tree_at(lambda law: law.dissipation.terms["joints"].strength, chosen, replace_fn=lambda b: b + 0.02)
    x = jnp.array([0.1, -0.2, 0.1 + 0.5 * np.sin(0.8), -0.2 - 0.5 * np.cos(0.8)])
    np.testing.assert_allclose(simulated(chosen, x, [0.1, 0.8]), moved(chosen, x), atol=3e-3)


def test_a_cart_on_a_spring():
    chosen = law([[2.0]], (OnLine("cart", (1.0, 0.5)),), ("cart",), [1.0, 0.3], springs=[[30.0]], friction=[[0.6]])
    along = np.array([1.0, 0.5]) / np.hypot(1.0, 0.5)
    x = jnp.asarray(0.4 * along + 0.1 * np.array([-along[1], along[0]]))
    np.testing.assert_allclose(simulated(chosen, x, [0.4]), moved(chosen, x), atol=3e-3)


@pytest.mark.parametrize(("first", "second"), [(-1.0, 9.0), (-17.0, 9.0), (17.0, -9.0)])
def test_links_with_counterweights(first, second):
    """They pull an end of their link upward; gravity may then point against the sum of all weights."""
    chosen = law([[1.6, 0.2], [0.2, 0.7]], CHAIN, ("elbow", "tip"), [0, first, 0, second])
    x = 0.5 * on_circle([0.6, -0.4])
    np.testing.assert_allclose(simulated(chosen, x, [0.6, -1.0])[:30], moved(chosen, x)[:30], atol=5e-3)


def test_hinge_friction_beyond_a_pivot_that_was_not_known():
    """The hinge at the pivot has none of its own: friction of the elbow is the same."""
    items = (DistanceToPoint("elbow", "unknown"), FixedDistance("elbow", "tip"))
    chosen = law([[1.6, 0.2], [0.2, 0.7]], items, ("elbow", "tip"), [0, 17.0, 0, 9.0], kinds=("joints",))
    chosen = eqx.tree_at(lambda law: law.dissipation.terms["joints"].strength, chosen, replace_fn=lambda b: b + 0.05)
    x = 0.5 * on_circle([0.6, -0.4])
    np.testing.assert_allclose(simulated(chosen, x, [0.6, -1.0]), moved(chosen, x), atol=5e-3)


def test_lengths_of_constraints_that_are_no_squares():
    chosen = law([[1.0]], (DistanceToPoint("ball"),), ("ball",), [0.0, 12.0])
    chosen = eqx.tree_at(lambda law: law.constraint_function, chosen, chosen.constraint_function.distances())
    x = 0.6 * on_circle([0.7])
    np.testing.assert_allclose(simulated(chosen, x, [0.7]), moved(chosen, x), atol=3e-3)


@pytest.mark.parametrize("what", ["masses", "friction"])
def test_couplings_without_a_link_are_refused(what):
    matrix = {"masses": np.diag([1.0, 0.6, 0.3]), "friction": np.diag([0.5, 0.4, 0.3])}
    matrix[what][2, 0] = matrix[what][0, 2] = -0.08
    items = (*CHAIN, FixedDistance("tip", "end"))
    chosen = law(
        matrix["masses"], items, ("elbow", "tip", "end"), [0, 9.0, 0, 5.4, 0, 2.7], friction=matrix["friction"]
    )
    with pytest.raises(KeycldError, match=f"the {what}.* couple keypoints without a link between them"):
        to_mjcf(chosen, np.ones(3))


@pytest.mark.parametrize("weight", [[0, 27, 0, 30, 0, 9], [0, 27, 5, 18, 0, 9], [-3, 27, 3, 18, 0, 9]])
def test_weights_of_no_gravity_are_refused(weight):
    """Of point masses 1, 0.6 and 0.3: the middle one too heavy, or some of them pulled sideways."""
    items = (*CHAIN, FixedDistance("tip", "end"))
    to_mjcf(law(np.diag([1.0, 0.6, 0.3]), items, ("elbow", "tip", "end"), [0, 30.0, 0.2, 18, 0, 9]), np.ones(3))
    chosen = law(np.diag([1.0, 0.6, 0.3]), items, ("elbow", "tip", "end"), np.array(weight, float))
    with pytest.raises(KeycldError, match=r"% of the weights are not those of bodies in one gravity, at most 5% may"):
        to_mjcf(chosen, np.ones(3))


def test_a_force_along_a_level_rail_is_refused():
    """No gravity of the pole explains it; any force at a right angle to the rail is the rail's."""

    def cart(along, across):
        items = (OnLine("cart"), FixedDistance("cart", "tip"))
        return law([[1.0, 0.0], [0.0, 0.4]], items, ("cart", "tip"), [along, across, 0.0, 4.0])

    to_mjcf(cart(0.05, 70.0), np.ones(2))
    with pytest.raises(KeycldError, match="are not those of bodies in one gravity"):
        to_mjcf(cart(2.0, 0.0), np.ones(2))


def test_a_constraint_that_is_no_joint_is_refused():
    level = FunctionConstraint(function=lambda x: x[1:2], dimension=4)
    chosen = law(np.eye(2), (*CHAIN, level), ("elbow", "tip"), [0, 9.0, 0, 9.0])
    with pytest.raises(KeycldError, match=r"FunctionConstraint is no joint\): export the keypoints with --to csv"):
        to_mjcf(chosen, np.ones(3))


def test_a_force_that_cannot_be_exported_is_refused():
    items = (DistanceToPoint("elbow"), FixedDistance("elbow", "tip"))
    chosen = law(np.eye(2), items, ("elbow", "tip"), [0, 9.0, 0, 9.0], kinds=("anchors",))
    with pytest.raises(KeycldError, match="'anchors' cannot be exported .*: train with .*--terms springs viscous"):
        to_mjcf(chosen, np.ones(2))


@pytest.mark.parametrize("names", [("x_resisted", "x"), ("world", "world_"), ('a "b"', "<ü> & c"), ("t_above", "t")])
def test_names_of_keypoints_that_a_model_or_its_file_uses(names):
    """Links with drag have further sites, MuJoCo has a body of its own, and XML has marks of its own."""
    items = (DistanceToPoint(names[0]), FixedDistance(*names))
    chosen = law([[1.6, 0.2], [0.2, 0.7]], items, names, [0, 17.0, 0, 9.0], friction=[[0.3, 0.0], [-0.1, 0.25]])
    model = mujoco.MjModel.from_xml_string(to_mjcf(chosen, np.array([0.25, 0.25])))
    assert tuple(model.sensor(k).name for k in range(2)) == names


def test_a_name_that_xml_cannot_hold_is_refused():
    chosen = law([[1.0]], (DistanceToPoint("b\x01"),), ("b\x01",), [0.0, 12.0])
    with pytest.raises(KeycldError, match=r"all characters of the keypoint 'b\\x01': rename it, or export"):
        to_mjcf(chosen, np.ones(1))
