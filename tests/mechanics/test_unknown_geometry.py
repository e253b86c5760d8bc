"""Unknown pivots and directions of rails: found from noisy observations, with the dynamics."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mechanics_examples import law

from keycld.mechanics import (
    Constraints,
    DistanceToPoint,
    FixedDistance,
    MechanicalDynamics,
    Motion,
    OnLine,
    Rattle,
    State,
    SumPotential,
    fit_motions,
    nearest_circle,
    parse_constraints,
)

DT, FRAMES, NOISE = 1 / 30, 60, 0.003
TEXT = """keypoints = ["cart", "tip"]

[[constraint]]
kind = "on_line"
keypoint = "cart"
direction = "unknown"

[[constraint]]
kind = "distance_to_point"
keypoint = "tip"
point = "unknown"
"""


def test_unknown_is_a_word_of_the_file():
    constraints = parse_constraints(TEXT, "a test")
    assert list(constraints.unknowns) == ["angle_cart", "pivot_tip"]
    assert parse_constraints(TEXT.replace('"unknown"', "[1.0, 2.0]"), "a test").unknowns == {}
    np.testing.assert_allclose(constraints(jnp.array([1.0, 2.0, 3.0, 4.0])), [2.0, 25.0])


@pytest.mark.parametrize(
    ("centre", "radius", "angles"),
    [((0.2, 0.1), 0.5, (-2.0, 2.0)), ((0.1, 2.4), 2.7, (-0.3, 0.3)), ((-3.0, 0.0), 2.5, (1.3, 1.8))],
)
def test_the_circle_of_an_arc(centre, radius, angles):
    """Also far outside of the picture, with an outlier, and 0.3 % of noise on half a radian."""
    turn = np.linspace(*angles, 200)
    points = np.stack([np.sin(turn), -np.cos(turn)], 1) * radius + np.array(centre)
    noise = 1e-3 * np.random.default_rng(0).normal(size=points.shape)
    points = (points + noise).astype(np.float32)
    points[7] += 0.2
    found, size = nearest_circle(jnp.asarray(points))
    assert float(jnp.linalg.norm(found - jnp.array(centre))) < 0.02 * radius
    assert float(size) == pytest.approx(radius, rel=0.02)


def test_points_without_a_circle_give_finite_numbers():
    for points in (np.zeros((5, 2)), np.stack([np.linspace(-1, 1, 9)] * 2, 1)):
        found, radius = nearest_circle(jnp.asarray(points, jnp.float32))
        assert np.all(np.isfinite(found)) and np.isfinite(radius)


def paths_of(constraints, potential, first, masses):
    truth = MechanicalDynamics(law(masses, constraints, potential=potential), Rattle(substeps=4))
    states = jax.vmap(lambda x: State(Motion(x, jnp.zeros_like(x)), {"constants": constraints(x)}))(first)
    paths = jax.jit(jax.vmap(lambda s: truth.rollout(s, jnp.zeros(0), DT, FRAMES - 1).x))(states)
    return paths, paths + NOISE * jax.random.normal(jax.random.key(0), paths.shape)


def test_a_pendulum_shows_where_its_pivot_is_and_how_it_is_tilted():
    """Two short swings from a pivot above the picture, camera tilted by 10°.

    The centre of the circle alone is 2 % off: the law of motion tells more.
    """
    pivot, length, tilt = np.array([0.3, 1.4]), 1.9, np.deg2rad(10.0)
    down = np.array([np.sin(tilt), -np.cos(tilt)])
    first = [pivot + length * np.array([np.sin(tilt + a), -np.cos(tilt + a)]) for a in (0.35, -0.2)]
    pull = 20.0
    paths, seen = paths_of(
        Constraints(("bob",), (DistanceToPoint("bob", tuple(pivot)),)),
        SumPotential(jnp.asarray(-pull * down, jnp.float32), {}),
        jnp.asarray(np.stack(first), jnp.float32),
        (1.0,),
    )
    constraints = Constraints(("bob",), (DistanceToPoint("bob", "unknown"),)).located(seen.reshape(-1, 2))
    guess = MechanicalDynamics(
        law((1.0,), constraints, potential=SumPotential(jnp.array([0.0, 15.0]), {})), Rattle(substeps=4)
    )
    free = jax.tree_util.tree_map_with_path(lambda path, leaf: ".mass" not in jax.tree_util.keystr(path), guess)
    for shared in (jnp.zeros(1), None):
        fitted = jax.jit(lambda x, c: fit_motions(guess, free, x, jnp.zeros((2, 0)), DT, constants=c))(seen, shared)
        found = fitted.dynamics.law
        error = np.asarray(found.constraint_function.unknowns["pivot_bob"]) - pivot
        assert np.linalg.norm(error) < 0.01 * length
        weight = np.asarray(found.potential.weight)
        assert np.rad2deg(np.arctan2(-weight[0], weight[1])) == pytest.approx(10.0, abs=0.5)
        # What a clock sees: ω² = g / length.
        radius = float(np.sqrt(np.mean(jax.vmap(found.constraint)(seen.reshape(-1, 2)))))
        assert np.hypot(*weight) / radius == pytest.approx(pull / length, rel=0.01)
        assert float(jnp.sqrt(jnp.mean((fitted.paths - paths) ** 2))) < 0.5 * NOISE


@pytest.mark.slow
def test_a_cart_on_a_tilted_rail_that_carries_a_pendulum():
    """The rail falls by 15°, and nobody says so; its direction is found within half a degree."""
    tilt = np.deg2rad(-15.0)
    along = np.array([np.cos(tilt), np.sin(tilt)])
    cart = np.stack([-0.7 * along + 0.1, -0.6 * along + 0.1])
    first = np.concatenate([cart, cart + 0.5 * np.array([[np.sin(2.0), -np.cos(2.0)], [np.sin(0.5), -np.cos(0.5)]])], 1)
    links = FixedDistance("cart", "tip")
    paths, seen = paths_of(
        Constraints(("cart", "tip"), (OnLine("cart", tuple(along)), links)),
        SumPotential(jnp.array([0.0, 1.0, 0.0, 0.5]), {}),
        jnp.asarray(first, jnp.float32),
        (1.0, 0.5),
    )
    constraints = Constraints(("cart", "tip"), (OnLine("cart", "unknown"), links)).located(seen.reshape(-1, 4))
    guess = MechanicalDynamics(
        law((1.0, 0.7), constraints, potential=SumPotential(jnp.array([0.0, 0.8, 0.0, 0.6]), {})), Rattle(substeps=4)
    )
    free = jax.tree.map(lambda _: True, guess)
    fitted = jax.jit(lambda x: fit_motions(guess, free, x, jnp.zeros((2, 0)), DT, constants=jnp.zeros(2)))(seen)
    angle = float(fitted.dynamics.law.constraint_function.unknowns["angle_cart"])
    assert np.rad2deg(angle) == pytest.approx(-15.0, abs=0.5)
    assert float(jnp.sqrt(jnp.mean((fitted.paths - paths) ** 2))) < 0.5 * NOISE
