"""Parameters that differ by trajectory: the law in another place, with other masses and another friction."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mechanics_examples import cartpole, law

from keycld import KeycldError
from keycld.mechanics import (
    AdaptiveDynamics,
    Constraints,
    CoupledMasses,
    DistanceToPoint,
    FixedDistance,
    MechanicalDynamics,
    Motion,
    OnLine,
    Own,
    PointMasses,
    Rattle,
    Springs,
    State,
    SumPotential,
    ViscousFriction,
    fit_motions,
    joining_velocity,
    own_law,
    own_parameters,
    rough_places,
    rough_states,
)
from keycld.mechanics.lagrangian import ConstrainedLagrangian
from keycld.mechanics.motion_cost import motion_cost
from keycld.mechanics.state import RESERVED

DT = jnp.float32(0.05)
NONE = jnp.zeros(0)


def springs(stiffness=2.0, constraint=None, damping=None):
    """A disc on a spring to the origin, free to move along y."""
    constraint = Constraints(("disc",), (OnLine("disc", direction=(0.0, 1.0)),)) if constraint is None else constraint
    potential = SumPotential(jnp.zeros(2), {"springs": Springs(jnp.array([[stiffness]]))})
    return law((1.0,), constraint, potential=potential, damping=damping)


def test_a_pivot_cannot_have_the_name_of_an_own_parameter():
    assert own_parameters(jnp.zeros(5)).keys() < set(RESERVED)


def test_the_law_of_a_trajectory_is_the_shifted_one_with_its_own_masses():
    """The acceleration is that of a law written for pivot p, masses μ m and friction φ C, at every state."""
    items = (DistanceToPoint("elbow"), FixedDistance("elbow", "tip"))
    damping = jnp.array([[0.3, 0.0], [0.1, 0.2]])
    potential = SumPotential(jnp.array([0.0, 2.0, 0.0, 1.0]), {})
    common = law((1.0, 0.7), Constraints(("elbow", "tip"), items), potential=potential, damping=damping)
    own = own_parameters(jnp.log(jnp.array([jnp.exp(0.3), jnp.exp(-0.2), 2.0, 0.5, 3.0])))
    np.testing.assert_allclose(own["place"], [0.3, -0.2], atol=1e-6)

    items = (DistanceToPoint("elbow", (0.3, -0.2)), FixedDistance("elbow", "tip"))
    explicit = ConstrainedLagrangian(
        PointMasses(jnp.sqrt(jnp.array([2.0, 0.35]))),
        SumPotential(jnp.array([0.0, 2.0, 0.0, 0.25]), {}),
        None,
        Constraints(("elbow", "tip"), items),
        ViscousFriction(3.0 * damping),
    )
    x, v = jnp.array([0.9, -0.5, 1.2, -1.1]), jnp.array([0.2, 0.4, -0.3, 0.1])
    here = own_law(common, own)
    np.testing.assert_allclose(here.acceleration(x, v, NONE), explicit.acceleration(x, v, NONE), rtol=1e-4)
    np.testing.assert_allclose(here.constraint(x), explicit.constraint(x), rtol=1e-5)
    np.testing.assert_allclose(here.kinetic_energy(x, v), explicit.kinetic_energy(x, v), rtol=1e-5)
    place = jnp.tile(own["place"], 2)
    np.testing.assert_allclose(here.potential_energy(x), explicit.potential_energy(x - place), rtol=1e-5)


def test_what_is_twice_as_heavy_weighs_twice_as_much():
    """Gravity, the same for both, is that of the first factor; a ratio of the masses does not change it."""
    common = ConstrainedLagrangian(PointMasses.ones(2), SumPotential(jnp.array([0.0, 3.0, 0.0, 3.0]), {}))
    own = own_parameters(jnp.log(jnp.array([1.0, 1.0, 2.0, 0.5, 1.0])))
    fall = own_law(common, own).acceleration(jnp.zeros(4), jnp.zeros(4), NONE)
    np.testing.assert_allclose(fall, [0, -1.5, 0, -1.5], atol=1e-6)


def test_own_coupled_masses_stay_inverse_to_each_other():
    own = own_parameters(jnp.array([0.0, 0.0, 0.4, -0.3, 0.0]))
    mass = CoupledMasses(jnp.array([[1.0, 0.0], [0.4, 0.8]]))
    here = own_law(ConstrainedLagrangian(mass, SumPotential(jnp.zeros(4), {})), own).mass
    np.testing.assert_allclose(here.matrix @ here.inverse, np.eye(2), atol=1e-5)


def test_a_rollout_takes_the_own_parameters_from_the_state():
    """A fourfold mass on the same spring swings half as fast, around its own place."""
    dynamics = MechanicalDynamics(springs(), Rattle(substeps=4))
    own = own_parameters(jnp.array([0.2, 0.1, jnp.log(4.0), 0.0]))
    state = State(Motion(jnp.array([0.2, 0.5]), jnp.zeros(2)), {"constants": jnp.zeros(1), **own})
    y = dynamics.rollout(state, NONE, DT, 60).x[:, 1]
    np.testing.assert_allclose(y, 0.1 + 0.4 * np.cos(np.sqrt(2 / 4) * 0.05 * np.arange(61)), atol=1e-3)


@pytest.fixture(scope="module")
def swing():
    """A law, and the state of a pendulum with its own pivot and a tenfold gravity."""
    weight = SumPotential(jnp.array([0.0, 1.0]), {})
    common = law((1.0,), Constraints(("ball",), (DistanceToPoint("ball"),)), potential=weight)
    own = own_parameters(jnp.array([0.6, 0.3, jnp.log(0.1), 0.0]))
    x, v = jnp.array([1.0, 0.0]), jnp.array([0.6, 0.8])
    return common, State(Motion(x, v), {"constants": own_law(common, own).constraint(x), **own})


def test_an_adaptive_rollout_takes_the_own_parameters_from_the_state_too(swing):
    common, state = swing
    fixed = MechanicalDynamics(common, Rattle(substeps=8)).rollout(state, NONE, DT, 20)
    for pull_back in (True, False):
        adaptive = AdaptiveDynamics(common, pull_back=pull_back).rollout(state, NONE, DT, 20)
        np.testing.assert_allclose(adaptive.x, fixed.x, atol=2e-3)


def test_the_velocity_that_joins_two_frames_turns_around_the_own_pivot(swing):
    """It is the one with which the second frame was reached."""
    common, state = swing
    dynamics, (x, v) = MechanicalDynamics(common, Rattle(substeps=4)), state.coordinates
    reached = dynamics.step(state, NONE, DT).coordinates.x
    np.testing.assert_allclose(joining_velocity(dynamics, x, reached, state.parameters, NONE, DT), v, atol=1e-4)


def test_without_a_place_in_the_state_the_law_is_the_same_object():
    common = cartpole()
    assert own_law(common, {"constants": jnp.zeros(2)}) is common and own_law(common, None) is common


@pytest.fixture(scope="module")
def oscillations():
    """Sixteen discs on springs: places, masses from 0.4 to 1.6 and amplitudes differ; friction 0.2; error 0.003."""
    random = np.random.default_rng(0)
    place = random.uniform(-0.3, 0.3, (16, 2))
    mass, size, phase = random.uniform(0.4, 1.6, 16), random.uniform(0.2, 0.6, 16), random.uniform(0, 6, 16)
    rate = 0.1 / mass
    speed = np.sqrt(2 / mass - rate**2)
    time = 0.05 * np.arange(80)
    y = size[:, None] * np.exp(-rate[:, None] * time) * np.cos(speed[:, None] * time + phase[:, None])
    paths = place[:, None] + np.stack([np.zeros_like(y), y], axis=-1)
    return place, mass, paths, paths + 0.003 * random.normal(size=paths.shape)


def guess(seen, dynamics):
    numbers = jnp.concatenate([rough_places(dynamics.law, seen), jnp.zeros((len(seen), 2))], axis=1)
    return Own(numbers, numbers, jnp.diag(jnp.array([0.003, 0.003, 0.002, 0.002]) ** 2))


@pytest.mark.slow
def test_a_fit_recovers_places_and_masses_from_noisy_tracks(oscillations):
    """Ratios of masses to a per cent in the median, places to an observation error or two; so is the stiffness."""
    place, mass, paths, seen = oscillations
    dynamics = MechanicalDynamics(springs(1.5, damping=[[0.05]]), Rattle(substeps=2))
    free = jax.tree_util.tree_map_with_path(lambda path, _: "terms" in jax.tree_util.keystr(path), dynamics)
    seen = jnp.asarray(seen, jnp.float32)
    inputs, own = jnp.zeros((16, 0)), guess(seen, dynamics)

    @jax.jit
    def fit(dynamics, initial, own, frames):
        return fit_motions(dynamics, free, seen, inputs, DT, frames=frames, initial=initial, own=own)

    fitted = fit(dynamics, rough_states(seen, DT), own, jnp.array(20))
    for frames in (40, 80):
        fitted = fit(fitted.dynamics, fitted.initial, own._replace(numbers=fitted.own), jnp.array(frames))
    own = np.asarray(fitted.own)
    ratio = own[:, 2] - np.log(mass)
    assert np.median(np.abs(ratio - ratio.mean())) < 0.01 and np.ptp(ratio) < 0.1
    assert np.sqrt(np.mean((own[:, :2] - place) ** 2)) < 0.005
    assert float(jnp.sqrt(jnp.mean((fitted.paths - paths) ** 2))) < 0.001
    stiffness = float(fitted.dynamics.law.potential.terms["springs"].stiffness[0, 0])
    assert stiffness / np.exp(ratio.mean()) == pytest.approx(2.0, rel=0.01)


def test_the_slopes_of_a_path_by_own_parameters_are_exact(oscillations):
    """Matrix and slope of the quadratic model, from the Jacobian of the whole path instead of one frame at a time."""
    seen = jnp.asarray(oscillations[3][0, :12], jnp.float32)
    turning = springs(constraint=Constraints(("disc",), (DistanceToPoint("disc"),)))
    dynamics = MechanicalDynamics(turning, Rattle(substeps=2))
    none = jax.tree.map(lambda leaf: False, dynamics)
    precision = jnp.diag(jnp.array([1.0, 2.0, 3.0, 4.0]))
    cost, theta = motion_cost(dynamics, none, seen[None], DT, None, 10.0, shared=False, precision=precision)
    z = jnp.array([*seen[0], 0.1, -0.2, 0.5, -0.4, 0.3, 0.1])
    expected = jnp.zeros(4)

    def weighted(z):
        path = cost.path(z, theta, cost.constants(z, theta, seen, NONE), NONE).x
        return jnp.concatenate([(path - seen).reshape(-1), jnp.sqrt(jnp.diagonal(precision)) * (z[4:] - expected)])

    jacobian, error = jax.jacfwd(weighted)(z), weighted(z)
    rows, left, value, _ = cost.squares(z, theta, seen, NONE, NONE, expected)
    matrix, slope = rows.T @ rows, rows.T @ left
    scale = float(jnp.abs(matrix).max())
    np.testing.assert_allclose(matrix, jacobian.T @ jacobian, atol=2e-3 * scale)
    np.testing.assert_allclose(slope, jacobian.T @ error, atol=2e-3 * float(jnp.abs(slope).max()))
    assert float(value) == pytest.approx(0.5 * float(error @ error), rel=5e-3)


def test_own_parameters_need_own_constants(oscillations):
    dynamics = MechanicalDynamics(springs(), Rattle(substeps=1))
    none, seen = jax.tree.map(lambda leaf: False, dynamics), jnp.asarray(oscillations[3], jnp.float32)
    with pytest.raises(KeycldError, match="own constants"):
        fit_motions(dynamics, none, seen, jnp.zeros((16, 0)), DT, constants=jnp.zeros(1), own=guess(seen, dynamics))


def test_a_first_guess_of_a_place_is_the_centre_of_the_circle():
    angles = jnp.linspace(0.0, 2.0, 20)
    seen = jnp.array([[0.3, -0.1]]) + 0.5 * jnp.stack([jnp.cos(angles), jnp.sin(angles)], axis=1)
    turning = springs(constraint=Constraints(("disc",), (DistanceToPoint("disc"),)))
    np.testing.assert_allclose(rough_places(turning, seen[None]), [[0.3, -0.1]], atol=1e-3)
    np.testing.assert_allclose(rough_places(springs(), seen[None])[0], seen.mean(axis=0), atol=1e-5)
