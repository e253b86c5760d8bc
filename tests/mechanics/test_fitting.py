import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mechanics_examples import double_pendulum, law, on_circle

from keycld.mechanics import (
    Constraints,
    DistanceToPoint,
    MechanicalDynamics,
    Motion,
    Rattle,
    State,
    SumPotential,
    fit_motions,
)
from keycld.mechanics.motion_cost import motion_cost
from keycld.mechanics.networks import AffineMLPInputMatrix

DT, FRAMES = 0.05, 30


@pytest.fixture(scope="module")
def pendulums():
    """Twelve swings of a unit pendulum from rest, each observed with an error of 0.01."""
    truth = swinging(9.81)
    first = jnp.stack([on_circle([angle]) for angle in np.linspace(0.3, 2.9, 12)])
    states = jax.vmap(lambda x: State(Motion(x, jnp.zeros(2)), {"constants": jnp.ones(1)}))(first)
    paths = jax.jit(jax.vmap(lambda s: truth.rollout(s, jnp.zeros(0), DT, FRAMES - 1).x))(states)
    return paths, paths + 0.01 * jax.random.normal(jax.random.key(0), paths.shape)


def swinging(gravity):
    potential = SumPotential(jnp.array([0.0, gravity]), {})
    constraints = Constraints(("bob",), (DistanceToPoint("bob"),))
    return MechanicalDynamics(law((1.0,), constraints, potential=potential), Rattle(substeps=2))


def free_leaves(dynamics, found):
    return jax.tree_util.tree_map_with_path(lambda path, leaf: found(jax.tree_util.keystr(path)), dynamics)


@pytest.mark.parametrize("gravity", [7.0, 2.0])
def test_gravity_is_found_from_noisy_observations_of_whole_swings(pendulums, gravity):
    """Thirty noisy frames of twelve swings hold it to better than one per cent, from a guess that is 30 % off.

    So they do from one five times too weak, though the first steps go too far and gain nothing. A fit that ended there
    left swings at 0.05 from the observations.
    """
    paths, seen = pendulums
    guess = swinging(gravity)
    free = free_leaves(guess, lambda name: name.endswith("potential.weight"))
    fitted = jax.jit(lambda x: fit_motions(guess, free, x, jnp.zeros((12, 0)), DT))(seen)
    assert np.asarray(fitted.dynamics.law.potential.weight)[1] == pytest.approx(9.81, rel=0.01)
    # The fitted paths are nearer to the truth than the observations, and differ from these by their error.
    error = float(jnp.sqrt(jnp.mean((fitted.paths - paths) ** 2)))
    assert error < 0.005
    assert float(fitted.rms) == pytest.approx(0.01, rel=0.1)


def test_exact_observations_are_followed_to_rounding(pendulums):
    """The cost of an error of 1e-6 is not lost in that of the others."""
    paths, _ = pendulums
    guess = swinging(9.0)
    free = free_leaves(guess, lambda name: name.endswith("potential.weight"))
    fitted = jax.jit(lambda x: fit_motions(guess, free, x, jnp.zeros((12, 0)), DT))(paths)
    assert float(fitted.cost) > 0 and float(fitted.rms) < 5e-7


def test_with_nothing_free_only_initial_states_are_fitted(pendulums):
    paths, seen = pendulums
    truth = swinging(9.81)
    free = free_leaves(truth, lambda name: False)
    fitted = jax.jit(lambda x: fit_motions(truth, free, x, jnp.zeros((12, 0)), DT))(seen)
    np.testing.assert_array_equal(fitted.dynamics.law.potential.weight, truth.law.potential.weight)
    assert float(jnp.sqrt(jnp.mean((fitted.paths - paths) ** 2))) < 0.004


def test_the_law_does_not_hear_of_motions_that_are_lost(pendulums):
    """Two of twelve observations are of nothing; they count like the worst of the others."""
    paths, seen = pendulums
    seen = seen.at[3].set(0.3).at[7].set(seen[7][::-1, ::-1])
    lost = np.isin(np.arange(12), (3, 7))
    guess = swinging(9.0)
    free = free_leaves(guess, lambda name: name.endswith("potential.weight"))
    fit = jax.jit(lambda followed: fit_motions(guess, free, seen, jnp.zeros((12, 0)), DT, followed=followed))
    fitted, heard = fit(jnp.asarray(~lost)), fit(jnp.ones(12, bool))
    off = [abs(float(each.dynamics.law.potential.weight[1]) - 9.81) for each in (fitted, heard)]
    assert off[0] < 0.05 and off[1] > 0.08
    assert float(fitted.rms) == pytest.approx(0.01, rel=0.1) and float(heard.rms) > 0.03
    alone = jax.jit(lambda x: fit_motions(guess, free, x, jnp.zeros((10, 0)), DT))(seen[~lost])
    assert 1.0 < float(fitted.cost / alone.cost) < 1.6


@pytest.mark.parametrize("held", [True, False])
def test_slopes_of_the_cost_are_its_derivatives_for_inputs_of_any_kind(held):
    """A frame of (ω dt)² = 0.03 ends with the input that it began with, not with that of the next frame."""
    pushed = eqx.tree_at(
        lambda d: d.law.input_matrix,
        swinging(9.81),
        AffineMLPInputMatrix(2, 1, 0, key=jax.random.key(0)),
        is_leaf=lambda part: part is None,
    )
    pushed = eqx.tree_at(lambda d: d.law.input_matrix.bias, pushed, jnp.array([2.0, 0.5]))
    free = free_leaves(pushed, lambda name: "input_matrix.bias" in name)
    u = 3 * jax.random.normal(jax.random.key(1), (1,) if held else (FRAMES, 1))
    x = jnp.tile(on_circle([0.5]), (FRAMES, 1)) + 0.3 * jnp.sin(jnp.arange(FRAMES))[:, None]
    cost, theta = motion_cost(pushed, free, x[None], DT, None, 0.05, shared=False)
    z, constants = jnp.concatenate([on_circle([0.5]), jnp.zeros(2)]), jnp.ones(1)
    rows, left, _, _ = jax.jit(cost.squares)(z, theta, x, constants, u)
    slope = rows.T @ left
    exact = jax.grad(lambda theta: cost(cost.path(z, theta, constants, u).x - x))(theta)
    np.testing.assert_allclose(slope[4:], exact, atol=0.01 * float(jnp.linalg.norm(exact)))


@pytest.mark.slow
def test_a_common_factor_of_masses_and_forces_has_no_curvature_in_a_chaotic_motion():
    """What θ changes of a double pendulum's motion, next to its initial state, is a small part of the sums of squares.

    Eliminating the initial state by differences of such sums left 1e-3 here.
    """
    truth = MechanicalDynamics(double_pendulum(damping=0.05 * np.eye(2)), Rattle(substeps=2))
    x = jnp.array([1.0, 0.0, 1.5, 0.9])
    start = State(Motion(x, jnp.zeros(4)), {"constants": truth.law.constraint(x)})
    seen = truth.rollout(start, jnp.zeros(0), DT, 199).x
    seen = seen + 0.003 * jax.random.normal(jax.random.key(0), seen.shape)
    free = free_leaves(truth, lambda name: "mass" in name or "potential" in name or "dissipation" in name)
    fitted = jax.jit(lambda x: fit_motions(truth, free, x, jnp.zeros((1, 0)), DT, iterations=1))(seen[None])
    curvature = np.asarray(fitted.curvature, float)
    scale = np.sqrt(np.maximum(np.diag(curvature), 1e-12 * curvature.max()))
    values = np.linalg.eigvalsh(curvature / scale[:, None] / scale)
    # The other one is a number that friction does not use, above the diagonal.
    assert np.sum(np.abs(values) < 1e-4) == 2 and values[2] > 1e-3
