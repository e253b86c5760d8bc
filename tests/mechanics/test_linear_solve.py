"""The unrolled solver of small positive systems."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from keycld.mechanics import solve_positive


def positive(n, rank, seed):
    factor = np.random.default_rng(seed).normal(size=(n, rank))
    return jnp.asarray(factor @ factor.T, jnp.float32)


@settings(max_examples=30, deadline=None)
@given(n=st.integers(1, 5), scale=st.integers(-12, 12), seed=st.integers(0, 1000))
def test_solves_at_every_scale(n, scale, seed):
    a = (positive(n, n + 3, seed) + jnp.eye(n)) * 10.0**scale
    z = jnp.asarray(np.random.default_rng(seed + 1).normal(size=n), jnp.float32)
    np.testing.assert_allclose(solve_positive(a, a @ z), z, atol=2e-4)


@settings(max_examples=30, deadline=None)
@given(n=st.integers(2, 5), seed=st.integers(0, 1000))
def test_singular_but_consistent(n, seed):
    """A redundant set of constraints: the solution is one of many, and a z = b holds."""
    a = positive(n, n - 1, seed)
    b = a @ jnp.asarray(np.random.default_rng(seed + 1).normal(size=n), jnp.float32)
    z = solve_positive(a, b)
    np.testing.assert_allclose(a @ z, b, atol=2e-3 * float(jnp.abs(b).max()))


def test_no_and_zero_equations():
    assert solve_positive(jnp.zeros((0, 0)), jnp.zeros(0)).shape == (0,)
    np.testing.assert_array_equal(solve_positive(jnp.zeros((3, 3)), jnp.ones(3)), np.zeros(3))
    # A row that says nothing does not disturb the others.
    a = jnp.zeros((3, 3)).at[0, 0].set(2.0).at[2, 2].set(4.0)
    np.testing.assert_allclose(solve_positive(a, jnp.ones(3)), [0.5, 0.0, 0.25])


@pytest.mark.parametrize("wrap", [jax.grad, lambda f: jax.grad(jax.grad(f)), lambda f: jax.jacfwd(jax.grad(f))])
def test_derivatives_of_every_order(wrap):
    with jax.enable_x64(True):
        a, b = jnp.array([[2.0, 0.5, 0.1], [0.5, 1.0, 0.2], [0.1, 0.2, 3.0]]), jnp.array([1.0, 2.0, -1.0])

        def through(solve):
            return wrap(lambda t: jnp.sum(solve(a * (1 + t) + t * t * jnp.eye(3), b * jnp.cos(t)) ** 2))(0.3)

        np.testing.assert_allclose(through(solve_positive), through(jnp.linalg.solve), rtol=1e-10)


def test_gradient_stays_finite_at_a_singular_matrix():
    def f(a):
        return jnp.sum(solve_positive(a, jnp.ones(3)))

    for a in (jnp.zeros((3, 3)), jnp.ones((3, 3)), positive(3, 1, 0)):
        assert np.isfinite(jax.grad(f)(a)).all()
