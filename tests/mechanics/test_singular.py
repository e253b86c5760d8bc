"""Constraints whose first derivative allows what they forbid."""

import jax.numpy as jnp
import numpy as np
import pytest

from keycld.mechanics import Constraints, DistanceToPoint, FixedDistance, OnLine, is_singular, turns_within, variation
from keycld.systems import AbstractMechanism, Conditions, get, names

RODS = (DistanceToPoint("a"), DistanceToPoint("b"), FixedDistance("a", "b"))


def turned(points, count=40):
    """Positions [count, 2K] of a rigid body that turns around the origin, off by a hundredth of a unit."""
    random = np.random.default_rng(0)
    angle = random.uniform(0, 2 * np.pi, count)
    turn = np.stack([np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)], -1).reshape(-1, 2, 2)
    x = np.einsum("nij,kj->nki", turn, np.asarray(points, float)).reshape(count, -1)
    return jnp.asarray(x + random.normal(0, 0.01, x.shape), jnp.float32)


def test_a_dumbbell_around_its_pivot_is_not_held_by_distances():
    """To first order both ends may turn by themselves, so forces on one of them would not reach the other."""
    assert is_singular(Constraints(("a", "b"), RODS), turned([(0.5, 0), (-0.35, 0)]))


def test_three_points_in_a_line_are_not_held_by_their_distances():
    names, pairs = ("a", "b", "c"), (("a", "b"), ("b", "c"), ("a", "c"))
    line = Constraints(names, tuple(FixedDistance(*pair) for pair in pairs))
    assert is_singular(line, turned([(-0.4, 0.1), (0, 0.1), (0.5, 0.1)]))
    assert not is_singular(line, turned([(-0.4, 0.1), (0, 0.5), (0.5, 0.1)]))


def test_constraints_that_repeat_others_pass():
    bent = Constraints(("a", "b"), (*RODS, FixedDistance("b", "a")))
    assert not is_singular(bent, turned([(0.5, 0), (0.1, 0.4)]))
    corners = [(0.3, 0.2), (-0.3, 0.25), (-0.2, -0.3), (0.35, -0.2)]
    all_sides = tuple(FixedDistance(p, q) for p in "abcd" for q in "abcd" if p < q)
    assert not is_singular(Constraints(tuple("abcd"), all_sides), turned(corners))


def test_one_line_is_what_the_dumbbell_needs():
    """`light + 0.7 · heavy` is constant, as docs/constraints.md says."""

    def on_line(x, parameters):
        return x[2:] + 0.7 * x[:2]

    assert not is_singular(Constraints(("a", "b"), (RODS[0], on_line)), turned([(0.5, 0), (-0.35, 0)]))


@pytest.mark.parametrize("name", names(AbstractMechanism))
def test_no_system_is_singular(name):
    system = get(name)
    start = Conditions(initial_state=system.initial_states[-1])
    runs = [system.record(np.random.RandomState(k), 20, start).state for k in range(6)]
    x = system.landmarks(np.concatenate(runs))[:, : len(system.keypoints)].astype(np.float32)
    assert not is_singular(system.constraints, jnp.asarray(x.reshape(len(x), -1)))


@pytest.mark.parametrize(("radius", "step", "expected"), [(0.03, 0.02, []), (0.03, 0.04, [1])])
def test_a_circle_turns_within_steps_longer_than_its_radius(radius, step, expected):
    angle = np.linspace(0, 2 * np.pi, 30)
    x = np.stack([angle, 0 * angle, 0.1 + radius * np.cos(angle), 0.2 + radius * np.sin(angle)], axis=-1)
    phi = Constraints(("cart", "bob"), (OnLine("cart"), DistanceToPoint("bob", (0.1, 0.2))))
    assert turns_within(phi, jnp.asarray(x), step) == expected


def test_two_keypoints_on_one_part_turn_within_an_error_of_each():
    x = turned([(0.5, 0.2), (0.5, 0.21)])
    rods = Constraints(("a", "b"), (DistanceToPoint("a"), FixedDistance("a", "b")))
    assert turns_within(rods, x, 0.03) == [1]
    assert turns_within(rods, x, 0.002) == []


@pytest.mark.parametrize("squared", [True, False])
def test_a_distance_varies_by_a_share_of_itself(squared):
    """Of three recordings with radii of their own; one of them is lost. A line keeps no distance that could vary."""
    angle = np.linspace(0, 20, 200)
    radius = np.array([[0.2], [0.3], [0.4]]) * (1 + 0.05 * np.sqrt(2) * np.sin(7 * angle))
    radius[2, ::3] = 0.1
    bob = np.stack([0.1 + radius * np.cos(angle), 0.2 + radius * np.sin(angle)], axis=-1)
    end = bob + 0.5 * np.array([1.0, 0.0])
    x = np.concatenate([np.stack([radius, 0 * radius], -1), bob, end], axis=-1)
    items = (OnLine("cart"), DistanceToPoint("bob", (0.1, 0.2)), FixedDistance("bob", "end"))
    shares = variation(Constraints(("cart", "bob", "end"), items, squared=squared), jnp.asarray(x))
    np.testing.assert_allclose(shares, [0, 0.05, 0], atol=0.002)
