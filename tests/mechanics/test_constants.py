"""Physical constants of mechanisms whose small oscillations are known."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mechanics_examples import on_circle

from keycld._errors import KeycldError
from keycld.mechanics import (
    ConstrainedLagrangian,
    Constraints,
    CoupledMasses,
    DistanceToPoint,
    FixedDistance,
    OnLine,
    PointMasses,
    Scale,
    Springs,
    SumDissipation,
    SumPotential,
    ViscousFriction,
    physical_constants,
    rest_pose,
)
from keycld.mechanics.forces.coulomb import CoulombFriction

GRAVITY = 9.81


def law(masses, items, names, weight, *, springs=None, friction=None):
    terms = {} if springs is None else {"springs": Springs(jnp.asarray(springs, float))}
    viscous = None if friction is None else SumDissipation({"viscous": ViscousFriction(jnp.asarray(friction, float))})
    potential = SumPotential(jnp.asarray(weight, float), terms)
    roots = PointMasses(jnp.sqrt(jnp.asarray(masses, float)))
    return ConstrainedLagrangian(roots, potential, None, Constraints(names, items), viscous)


def measured(chosen, observed, scale=None):
    with jax.enable_x64(True):
        double = jax.tree.map(lambda a: jnp.asarray(np.asarray(a), float) if eqx.is_array(a) else a, chosen)
        constants = double.constraint(jnp.asarray(np.asarray(observed), float))
        pose = rest_pose(double, constants, np.asarray(observed, float)[None])
        return {k: float(v) for k, v in physical_constants(double, constants, pose, scale).items()}


def test_period_of_a_simple_pendulum():
    """T = 2π √(l/g), γ = c/m, ζ = γ/(2ω): l = 0.7, m = 2, c = 0.3, in gravity tilted by 20°."""
    down = np.deg2rad(-70)
    weight = -2.0 * GRAVITY * np.array([np.cos(down), np.sin(down)])
    chosen = law([2.0], (DistanceToPoint("ball"),), ("ball",), weight, friction=[[0.3]])
    found = measured(chosen, 0.7 * on_circle([1.0]))
    rate = np.sqrt(GRAVITY / 0.7)
    assert found["period_1"] == pytest.approx(2 * np.pi / rate, rel=1e-6)
    assert found["viscous_rate"] == pytest.approx(0.15, rel=1e-6)
    assert found["damping_ratio_1"] == pytest.approx(0.15 / (2 * rate), rel=1e-6)
    assert found["gravity_direction"] == pytest.approx(-70, abs=1e-4)
    assert found["length_pivot_ball"] == pytest.approx(0.7, rel=1e-6)


def test_dry_friction_of_a_pendulum_and_of_two_carts():
    """c/m of a single part. Of two equal free carts of 2 kg on one rail, joined by a spring: 2c/2m as they part."""
    friction = SumDissipation({"coulomb": CoulombFriction(jnp.array([0.3]))})
    swing = law([2.0], (DistanceToPoint("ball"),), ("ball",), [0.0, 2.0 * GRAVITY])
    swing = eqx.tree_at(lambda each: each.dissipation, swing, friction, is_leaf=lambda leaf: leaf is None)
    assert measured(swing, 0.7 * on_circle([1.0]))["coulomb_deceleration_1"] == pytest.approx(0.15, rel=1e-6)
    carts = law([2.0, 2.0], (OnLine("a"), OnLine("b")), ("a", "b"), [0.0] * 4, springs=[[1.0, -1.0], [-1.0, 1.0]])
    friction = SumDissipation({"coulomb": CoulombFriction(jnp.array([0.3, 0.3]))})
    carts = eqx.tree_at(lambda each: each.dissipation, carts, friction, is_leaf=lambda leaf: leaf is None)
    found = measured(carts, jnp.array([0.1, 0.0, 0.4, 0.0]))
    assert found["coulomb_deceleration_1"] == pytest.approx(0.15, rel=1e-5) and "coulomb_deceleration_2" not in found


def test_periods_of_a_double_pendulum():
    """Equal masses and lengths: ω² = (2 ± √2) g/l. A mass ratio and both lengths follow the keypoints' names."""
    items = (DistanceToPoint("elbow"), FixedDistance("elbow", "tip"))
    chosen = law([1.0, 1.0], items, ("elbow", "tip"), [0, GRAVITY, 0, GRAVITY])
    found = measured(chosen, 0.5 * on_circle([0.5, -1.0]))
    squares = (2 + np.array([-1, 1]) * np.sqrt(2)) * GRAVITY / 0.5
    np.testing.assert_allclose([found["period_1"], found["period_2"]], 2 * np.pi / np.sqrt(squares), rtol=1e-6)
    assert found["mass_ratio_elbow_tip"] == pytest.approx(1.0)
    assert found["length_elbow_tip"] == pytest.approx(0.5)
    assert found["gravity"] == pytest.approx(GRAVITY)


@pytest.mark.parametrize("place", [1.0, 0.7, 1.2])
def test_the_ratio_of_masses_does_not_depend_on_where_the_last_keypoint_is(place):
    """Masses of 3, 2 and 1 on three links; the keypoint of the last one nearer to its joint, or beyond the mass."""
    items = (DistanceToPoint("a"), FixedDistance("c", "b"), FixedDistance("a", "b"))
    chosen = law([3.0, 2.0, 1.0], items, ("a", "b", "c"), [0, 3 * GRAVITY, 0, 2 * GRAVITY, 0, GRAVITY])
    # x_c = x_b + (x_keypoint − x_b) / place
    last = np.array([[1, 0, 0], [0, 1, 0], [0, 1 - 1 / place, 1 / place]])
    masses = CoupledMasses.ones(3).nearest(last.T @ np.diag([3.0, 2.0, 1.0]) @ last)
    moved = eqx.tree_at(lambda each: each.mass, chosen, masses)
    found = measured(moved, 0.5 * on_circle([0.5, -1.0, 0.2]))
    assert [found["mass_ratio_a_b"], found["mass_ratio_b_c"]] == pytest.approx([1.5, 2.0], rel=1e-5)


def test_other_masses_have_the_sums_of_the_mass_matrix():
    """A cart with a pole whose mass is spread along it: the rows of m have 2.4 and 0.5 kg."""
    chosen = law([2.0, 1.0], (OnLine("cart"), FixedDistance("cart", "tip")), ("cart", "tip"), [0, 0, 0, GRAVITY])
    masses = CoupledMasses.ones(2).nearest(np.array([[2.3, 0.1], [0.1, 0.4]]))
    moved = eqx.tree_at(lambda each: each.mass, chosen, masses)
    assert measured(moved, jnp.array([0.1, 0.0, 0.4, -0.3]))["mass_ratio_cart_tip"] == pytest.approx(2.4 / 0.5)


def test_a_free_direction_has_no_period():
    """A cart without a spring rolls anywhere; its pole swings with ω² = (1 + m/M) g/l."""
    chosen = law([2.0, 1.0], (OnLine("cart"), FixedDistance("cart", "tip")), ("cart", "tip"), [0, 0, 0, GRAVITY])
    found = measured(chosen, jnp.array([0.1, 0.0, 0.4, -0.3]))
    assert found["period_1"] == pytest.approx(2 * np.pi / np.sqrt(1.5 * GRAVITY / np.hypot(0.3, 0.3)), rel=1e-6)
    assert "period_2" not in found


def test_a_spring_cart_has_the_period_of_its_spring():
    """T = 2π √(m/k), and what looks like gravity may be the rest position of the spring."""
    chosen = law([1.0], (OnLine("cart"),), ("cart",), [-0.8, 0.0], springs=[[8.0]])
    found = measured(chosen, jnp.array([0.4, 0.0]))
    assert found["period_1"] == pytest.approx(2 * np.pi / np.sqrt(8), rel=1e-6)
    assert "gravity_direction" not in found


def test_error_bars_of_a_ball_on_a_spring_in_the_plane():
    """Both of its modes have one frequency: ζ = c/(2√(k m)) and a deceleration d/m all the same, with derivatives."""
    start = np.array([[0.4, 0.1]])
    with jax.enable_x64(True):
        numbers = jnp.array([2.0, 8.0, 0.4, 0.1])

        def of(numbers):
            mass, stiffness, viscous, dry = numbers
            springs = {"springs": Springs(stiffness.reshape(1, 1))}
            friction = {"viscous": ViscousFriction(viscous.reshape(1, 1)), "coulomb": CoulombFriction(dry.reshape(1))}
            masses, potential = PointMasses(jnp.sqrt(mass).reshape(1)), SumPotential(jnp.zeros(2), springs)
            return ConstrainedLagrangian(masses, potential, None, Constraints(["ball"]), SumDissipation(friction))

        pose = rest_pose(of(numbers), jnp.zeros(0), start)
        slopes = jax.jacfwd(lambda numbers: physical_constants(of(numbers), jnp.zeros(0), pose))(numbers)
    for k in (1, 2):
        # ζ = 0.4 / (2 √16), and its change with m, k and c.
        np.testing.assert_allclose(slopes[f"damping_ratio_{k}"], [-0.0125, -0.003125, 0.125, 0.0], atol=1e-9)
        np.testing.assert_allclose(slopes[f"coulomb_deceleration_{k}"], [-0.025, 0.0, 0.0, 0.5], atol=1e-9)


def test_nothing_depends_on_the_common_factor():
    items = (DistanceToPoint("elbow"), FixedDistance("elbow", "tip"))
    weight, friction = np.array([0, 2 * GRAVITY, 0, GRAVITY]), np.array([[0.2, 0.0], [0.05, 0.1]])
    once = law([2.0, 1.0], items, ("elbow", "tip"), weight, friction=friction)
    thrice = law([6.0, 3.0], items, ("elbow", "tip"), 3 * weight, friction=3 * friction)
    pose = on_circle([0.3, 0.6])
    first, second = measured(once, pose), measured(thrice, pose)
    assert first.keys() == second.keys()
    for name, value in first.items():
        assert second[name] == pytest.approx(value, rel=1e-6), name


def test_a_length_or_gravity_gives_metres():
    chosen = law([1.0], (DistanceToPoint("ball"),), ("ball",), [0, 20.0])
    by_length = measured(chosen, 0.5 * on_circle([0.4]), Scale(("pivot", "ball"), 0.25))
    assert by_length["metres_per_unit"] == pytest.approx(0.5)
    assert by_length["gravity_m"] == pytest.approx(10.0)
    by_gravity = measured(chosen, 0.5 * on_circle([0.4]), Scale(None, 10.0))
    assert by_gravity["length_pivot_ball_m"] == pytest.approx(0.25)
    with pytest.raises(KeycldError, match="choose from pivot–ball"):
        measured(chosen, 0.5 * on_circle([0.4]), Scale(("pivot", "bob"), 0.25))


def test_a_mechanism_that_never_rests_has_no_period():
    """Without gravity and springs."""
    chosen = law([1.0], (DistanceToPoint("ball"),), ("ball",), [0, 0.0])
    assert "period_1" not in measured(chosen, on_circle([0.4]))
