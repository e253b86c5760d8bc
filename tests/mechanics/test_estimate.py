"""Error bars of fitted parameters: where the answer is known in closed form, and where there is none."""

from itertools import accumulate

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mechanics_examples import on_circle

from keycld.mechanics import (
    RK4,
    ConstrainedLagrangian,
    Constraints,
    DistanceToPoint,
    MechanicalDynamics,
    Motion,
    PointMasses,
    State,
    SumDissipation,
    SumPotential,
    ViscousFriction,
    derive,
    estimate,
    predict_fan,
)
from keycld.mechanics.residuals import autocovariance, lagged_products, likely_size, places

NOISE, DT, FRAMES = 0.003, 1 / 30, 150
GRAVITY, FRICTION, LENGTH, PIVOT = 9.81, 0.1, 0.6, (0.05, 0.4)


def falling():
    return MechanicalDynamics(
        ConstrainedLagrangian(PointMasses.ones(1), SumPotential(jnp.array([0.0, 1.0]), {})), RK4()
    )


def pendulum(gravity=GRAVITY, friction=FRICTION, pivot=PIVOT):
    constraint = Constraints(("ball",), (DistanceToPoint("ball", "unknown"),))
    constraint = eqx.tree_at(lambda c: c.items[0].learned, constraint, jnp.array(pivot))
    viscous = SumDissipation({"viscous": ViscousFriction(jnp.array([[friction]]))})
    potential = SumPotential(jnp.array([0.0, gravity]), {})
    return MechanicalDynamics(ConstrainedLagrangian(PointMasses.ones(1), potential, None, constraint, viscous), RK4(8))


def free(dynamics, found=lambda name: True):
    return jax.tree_util.tree_map_with_path(
        lambda path, leaf: eqx.is_inexact_array(leaf) and found(jax.tree_util.keystr(path)), dynamics
    )


@pytest.fixture(scope="module")
def swing():
    with jax.enable_x64(True):
        first = jnp.asarray(PIVOT) + LENGTH * jnp.asarray(on_circle([1.2]), float)
        return np.asarray(pendulum().rollout(State(Motion(first, jnp.zeros(2)), {}), jnp.zeros(0), DT, FRAMES - 1).x)


def seen(path, seed=0):
    return path + NOISE * np.random.default_rng(seed).standard_normal(path.shape)


def fitted(observed):
    guess = pendulum(9.0, 0.2, (0.04, 0.42))
    still = Motion(observed[None, 0], np.zeros((1, 2)))
    return estimate(guess, free(guess), observed[None], np.zeros((1, 0)), DT, initial=still)


def constants(found):
    return derive(found, numbers)


def numbers(law, constants):
    friction = law.dissipation.terms["viscous"].coefficients[0, 0] / law.masses[0]
    length, pivot = jnp.sqrt(constants[0]), law.constraint_function.items[0].learned
    squared = law.potential.weight[1] / law.masses[0] / length
    return {"mass": law.masses[0], "length": length, "x": pivot[0], "gamma": friction, "ω²": squared}


def test_covariance_of_a_linear_fit_is_the_textbook_one():
    """A free fall is linear in x₀, v₀ and w: cov = s² (XᵀX)⁻¹, s² = Σe²/(n − p), p the number of unknowns."""
    time = DT * np.arange(40)
    design = np.stack([np.ones(40), time, -(time**2) / 2], axis=1)
    observed = design @ np.array([[0.1, 0.2], [0.5, 2.0], [0.0, 1.5]])
    observed = observed + NOISE * np.random.default_rng(1).standard_normal(observed.shape)
    dynamics = falling()
    spec = free(dynamics, lambda name: name.endswith("weight"))
    guess = Motion(observed[None, 0], np.array([[0.4, 2.1]]))
    found = estimate(dynamics, spec, observed[None], np.zeros((1, 0)), DT, initial=guess)
    solution, squares, *_ = np.linalg.lstsq(design, observed, rcond=None)
    # Robust weights change the estimate by little of its error, and the variance by a few per cent.
    sigma = np.sqrt(squares.sum() / (80 - 6) * np.linalg.inv(design.T @ design)[2, 2])
    np.testing.assert_allclose(found.eta, solution[2], atol=0.3 * sigma)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), sigma, rtol=0.08)
    assert found.flat.shape == (2, 0)


def test_a_pendulum_is_measured_within_its_error_bars(swing):
    found = constants(fitted(seen(swing)))
    truth = {"length": LENGTH, "x": PIVOT[0], "gamma": FRICTION, "ω²": GRAVITY / LENGTH}
    for name, value in truth.items():
        assert abs(found[name].value - value) < 3 * found[name].sigma, name
        assert found[name].sigma < 0.02 * max(abs(value), 0.1), name
        assert found[name].determined


def test_the_common_factor_of_masses_and_forces_is_not_determined(swing):
    found = fitted(seen(swing))
    assert found.flat.shape[1] == 1
    assert not constants(found)["mass"].determined


def test_error_bars_agree_with_a_block_bootstrap(swing):
    """Errors drawn again in blocks from those of the fit, forty times: the spread of ω² and γ is their sigma."""
    first = fitted(seen(swing))
    error = seen(swing) - first.paths[0]
    rng, block, again = np.random.default_rng(0), 5, []
    for _ in range(40):
        begin = rng.integers(0, FRAMES - block, FRAMES // block)
        drawn = np.concatenate([error[b : b + block] for b in begin])
        again.append({name: each.value for name, each in constants(fitted(first.paths[0] + drawn)).items()})
    for name in ("ω²", "gamma", "length"):
        spread = np.std([each[name] for each in again])
        # Forty draws know a deviation to 11 %.
        assert constants(first)[name].sigma == pytest.approx(spread, rel=0.4), name


def test_errors_that_last_make_error_bars_larger(swing):
    """AR(1) noise of the same size with ρ = 0.8: slow parameters such as the pivot are known worse."""
    rng, noise = np.random.default_rng(0), np.zeros((FRAMES, 2))
    for t in range(1, FRAMES):
        noise[t] = 0.8 * noise[t - 1] + 0.6 * NOISE * rng.standard_normal(2)
    white, lasting = fitted(seen(swing)), fitted(swing + noise)
    assert constants(lasting)["x"].sigma > 1.5 * constants(white)["x"].sigma
    assert lasting.inefficiency[0] > 3 > 1.5 > white.inefficiency[0]


def test_errors_that_return_with_the_place_make_error_bars_larger(swing):
    """A pendulum seen too large on its right side: every swing repeats the error, so that more of them do not help."""
    around = swing - np.asarray(PIVOT)
    bent = swing + 0.04 * around[:, :1] * np.abs(around)
    even, uneven = fitted(seen(swing)), fitted(seen(bent))
    assert np.all(even.uneven == 0.0)
    measured = constants(uneven)["ω²"]
    wrong = abs(measured.value - GRAVITY / LENGTH)
    # What the errors would be if they only lasted for some frames.
    assert wrong > 4 * constants(even)["ω²"].sigma
    assert wrong < 2 * measured.sigma


def test_the_size_of_uneven_errors_is_found_and_chance_is_not():
    random = np.random.default_rng(0)
    x = np.cumsum(0.1 * random.standard_normal((2, 400, 4)), axis=1)
    basis = places(x)
    np.testing.assert_allclose(np.mean(basis**2, axis=(0, 1, 2)), 1 / 4, rtol=1e-6)
    sizes = []
    for size in (0.0, 0.02):
        for _ in range(40):
            error = 0.05 * random.standard_normal(x.shape) + basis @ (size * random.standard_normal(basis.shape[-1]))
            matrix = np.einsum("ntdi,ntdj->ij", basis, basis)
            sizes.append(likely_size(np.einsum("ntdi,ntd->i", basis, error), 0.05**2 * matrix, matrix))
    assert np.mean(np.array(sizes[:40]) > 0) < 0.1
    assert np.mean(sizes[40:]) == pytest.approx(0.02, rel=0.1)


def test_autocovariance_of_independent_errors_is_their_variance():
    errors = np.random.default_rng(3).standard_normal((1, 4000))
    np.testing.assert_allclose(autocovariance(errors), [1.0], rtol=0.1)


@pytest.mark.parametrize("kept", [0.5, 0.8])
def test_autocovariance_tells_how_far_a_sum_of_correlated_errors_spreads(kept):
    """Of e(t) = φ e(t−1) + ε, the sum over n frames has about the variance n/(1 − φ)²."""
    spread, frames = [], 300
    for seed in range(200):
        fresh = np.random.default_rng(seed).standard_normal(frames + 100)
        errors = np.stack(list(accumulate(fresh, lambda before, new: kept * before + new)))[None, 100:]
        spread.append(lagged_products(np.ones((1, frames, 1)), autocovariance(errors)).item())
    assert np.sqrt(np.mean(spread) / frames) == pytest.approx(1 / (1 - kept), rel=0.06)


def test_an_autocovariance_has_no_negative_variance():
    """Errors that swing: of weights that swing as they do or not, all sums have a variance."""
    time = np.arange(200)
    noise = np.random.default_rng(0).standard_normal((1, 200))
    covariance = autocovariance(np.sin(2 * np.pi * time / 20)[None] + 0.3 * noise)
    swings = np.stack([np.cos(np.pi * time * k / 100) for k in range(100)], axis=-1)
    assert np.linalg.eigvalsh(lagged_products(swings[None], covariance)).min() > -1e-6 * covariance[0]


def test_predictions_spread_by_as_much_as_their_error_bars(swing):
    """Sixty predictions from ten noisy frames each: their errors in units of sigma have a deviation of one."""
    found = fitted(seen(swing))
    off = []
    for seed in range(1, 21):
        given = seen(swing[:10], seed)
        guess = Motion(given[0], (given[4] - given[0]) / (4 * DT))
        fan = predict_fan(found, given, np.zeros(0), 100, initial=guess)
        off.append((fan.keypoints.reshape(100, 2) - swing[:100]) / fan.sigma.reshape(100, 2))
    spread = np.sqrt(np.mean(np.square(off)))
    assert spread == pytest.approx(1.0, abs=0.3)


def test_a_fit_that_ended_in_another_minimum_says_so(swing):
    """From half of g the pendulum falls behind by periods, which no small step makes good."""
    # Noise is no misfit.
    assert fitted(seen(swing)).misfit < 0.3 * NOISE / np.sqrt(np.mean(np.var(swing, axis=0)))
    guess = pendulum(0.4 * GRAVITY, 0.1)
    still = Motion(swing[None, 0], np.zeros((1, 2)))
    far = estimate(guess, free(guess), seen(swing)[None], np.zeros((1, 0)), DT, initial=still)
    assert far.misfit > 0.2
