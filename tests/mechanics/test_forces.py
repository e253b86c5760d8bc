"""Terms of V and R against the forces that they stand for, and what friction does to motions."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mechanics_examples import double_pendulum, law, on_circle

from keycld import KeycldError
from keycld.mechanics import (
    Constraints,
    FixedDistance,
    MechanicalDynamics,
    Motion,
    OnLine,
    Rattle,
    State,
    SumDissipation,
    SumPotential,
    term_kinds,
    terms_of,
    with_kinds,
)
from keycld.mechanics.forces.anchors import Anchors
from keycld.mechanics.forces.coulomb import CoulombFriction
from keycld.mechanics.forces.drag import Drag
from keycld.mechanics.forces.joints import JointFriction
from keycld.mechanics.forces.pairs import PairForces
from keycld.mechanics.forces.springs import Springs

FREE = Constraints(("a", "b"))
KEY = jax.random.key(0)
X = jnp.array([0.1, -0.3, 0.7, 0.5])
V = jnp.array([0.4, 1.0, -0.8, 0.2])


def zero(kind, constraint=FREE):
    return term_kinds()[kind].zero(constraint, key=KEY)


@pytest.mark.parametrize("kind", sorted(set(term_kinds()) - {"perceptron", "perceptron-32"}))
def test_a_new_term_has_no_effect_and_a_slope_to_begin_with(kind):
    term = zero(kind, FREE if kind == "pairs" else double_pendulum().constraint_function)
    arguments = (X, V) if kind in ("viscous", "joints", "coulomb", "drag") else (X,)
    force = jax.grad(term, argnums=len(arguments) - 1)
    np.testing.assert_array_equal(force(*arguments), np.zeros(4))
    slopes = jax.jacrev(lambda term: jax.grad(lambda *a: term(*a), argnums=len(arguments) - 1)(*arguments))(term)
    assert max(float(jnp.abs(leaf).max()) for leaf in jax.tree.leaves(slopes)) > 0.01


def test_a_spring_between_two_keypoints_and_one_to_a_fixed_point():
    k, c, p = 3.0, 5.0, jnp.array([0.2, -0.4])
    stiffness = jnp.array([[k + c, 0.0], [-k, k]])
    potential = SumPotential(jnp.array([*(-c * p), 0.0, 0.0]), {"springs": Springs(stiffness)})
    a, b = X[:2], X[2:]
    expected = jnp.concatenate([k * (b - a) - c * (a - p), k * (a - b)])
    np.testing.assert_allclose(-jax.grad(potential)(X), expected, rtol=1e-5)


def test_a_spring_with_a_rest_length():
    k, length, p = 20.0, 0.6, jnp.array([0.0, 1.3])
    weight = -k * p
    terms = {"springs": Springs(jnp.array([[k]])), "anchors": Anchors(jnp.array([-k * length]), p[None])}
    x = jnp.array([0.5, 0.1])
    r = jnp.linalg.norm(x - p)
    expected = -k * (r - length) * (x - p) / r
    np.testing.assert_allclose(-jax.grad(SumPotential(weight, terms))(x), expected, rtol=2e-3)


def test_attraction_of_two_bodies():
    gravity = eqx.tree_at(lambda t: t.strength, zero("pairs"), jnp.array([[0.0, 0.0, -1.6]]))
    assert isinstance(gravity, PairForces)
    apart = X[2:] - X[:2]
    expected = 1.6 * apart / jnp.linalg.norm(apart) ** 3
    force = -jax.grad(gravity)(X)
    np.testing.assert_allclose(force, jnp.concatenate([expected, -expected]), rtol=2e-3)
    # Keypoints beside the centres, each by an amount of its own.
    aside = jnp.array([0.1, -0.05, -0.2, 0.03])
    offset = eqx.tree_at(lambda t: t.offset, gravity, (aside[:2] - aside[2:])[None])
    np.testing.assert_allclose(-jax.grad(offset)(X + aside), force, rtol=1e-5)


def test_forces_along_a_bar_are_none():
    """The bar takes them up, so no motion shows them; of three masses, one bar leaves two pairs."""
    bar = FixedDistance("c", "a")
    assert zero("pairs", Constraints(("a", "c"), (bar,))) is None
    inner = Constraints(("a", "b", "c"), (bar,))
    for constraint in (inner, Constraints(("a", "b", "c"), (inner,))):
        term = zero("pairs", constraint)
        assert isinstance(term, PairForces) and term.strength.shape == (2, 3)
        assert list(zip(term.first, term.second, strict=True)) == [(0, 1), (1, 2)]


def test_friction_of_hinges_is_a_torque_against_their_turning():
    """b (ω₂ − ω₁)² watts are lost in the elbow, and b ω₁² in the shoulder."""
    hung = double_pendulum()
    term = zero("joints", hung.constraint_function)
    assert isinstance(term, JointFriction) and term.strength.shape == (3,)
    angles, rates = np.array([0.4, 1.1]), np.array([2.0, -3.0])
    x, v = jax.jvp(lambda q: chain(q), (jnp.asarray(angles),), (jnp.asarray(rates),))
    for strength, lost in (([1, 0, 0], 4.0), ([0, 1, 0], 9.0), ([0, 0, 1], 25.0)):
        slowed = eqx.tree_at(lambda t: t.strength, term, 0.3 * jnp.array(strength, float))
        assert float(v @ jax.grad(slowed, argnums=1)(x, v)) == pytest.approx(0.3 * lost, rel=1e-4)


def chain(q):
    first = jnp.stack([jnp.sin(q[0]), -jnp.cos(q[0])])
    return jnp.concatenate([first, first + jnp.stack([jnp.sin(q[1]), -jnp.cos(q[1])])])


def test_dry_friction_and_drag_have_the_sizes_that_they_say():
    dry = CoulombFriction(jnp.array([0.7, 0.0]))
    drag = Drag(jnp.array([0.0, 2.0]))
    np.testing.assert_allclose(jax.grad(dry, argnums=1)(X, V)[:2], 0.7 * V[:2] / jnp.linalg.norm(V[:2]), rtol=2e-3)
    np.testing.assert_allclose(jax.grad(drag, argnums=1)(X, V)[2:], 2 * V[2:] * jnp.linalg.norm(V[2:]), rtol=1e-5)


def test_dry_friction_stops_a_block_on_a_rail():
    """It slides v²/2c far, in v/c seconds."""
    rail = Constraints(("block",), (OnLine("block"),))
    friction = SumDissipation({"coulomb": CoulombFriction(jnp.array([2.0]))})
    block = eqx.tree_at(lambda it: it.dissipation, law([1.0], rail), friction, is_leaf=lambda leaf: leaf is None)
    state = State(Motion(jnp.zeros(2), jnp.array([1.0, 0.0])), {"constants": jnp.zeros(1)})
    motion = MechanicalDynamics(block, Rattle(4)).rollout(state, jnp.zeros(0), 0.02, 50)
    assert float(motion.x[-1, 0]) == pytest.approx(0.25, rel=0.02)
    assert abs(float(motion.v[-1, 0])) < 0.01


def test_energy_falls_as_the_dissipation_function_says():
    """dE/dt = −v·∂R/∂v along a motion of a double pendulum with all kinds of friction."""
    kinds = ("viscous", "joints", "coulomb", "drag")
    slowed = with_kinds(
        eqx.tree_at(lambda it: it.potential, double_pendulum(), SumPotential(jnp.array([0.0, 9.8, 0.0, 6.9]), {})),
        kinds,
        key=KEY,
    )
    some = jax.tree.map(lambda a: a + 0.1 * (jnp.eye(*a.shape) if a.ndim == 2 else 1.0), slowed.dissipation)
    slowed = eqx.tree_at(lambda it: it.dissipation, slowed, some)
    assert set(terms_of(slowed)) == set(kinds)
    x = on_circle([1.0, 0.3])
    state = State(Motion(x, jnp.zeros(4)), {"constants": slowed.constraint(x)})
    motion = MechanicalDynamics(slowed, Rattle(4)).rollout(state, jnp.zeros(0), 0.01, 100)
    energy = jax.vmap(slowed.energy)(motion.x, motion.v)
    power = jax.vmap(lambda x, v: v @ slowed.friction(x, v))(motion.x, motion.v)
    lost = float(jnp.sum((power[1:] + power[:-1]) / 2) * 0.01)
    assert lost < -0.5
    assert float(energy[-1] - energy[0]) == pytest.approx(lost, rel=5e-3)


def test_an_unknown_kind_is_refused():
    with pytest.raises(KeycldError, match="springs"):
        with_kinds(double_pendulum(), ("spring",), key=KEY)
