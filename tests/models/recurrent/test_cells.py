"""Recurrent cells against a transcription of Haiku's equations in NumPy."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld.models.recurrent.cells import GRUCell, LSTMCell, Stack, VanillaCell


def f64(array):
    return np.asarray(array, np.float64)


def sigmoid(x):
    return 1 / (1 + np.exp(-x))


@pytest.fixture
def x(getkey):
    return jax.random.normal(getkey(), (3,))


@pytest.fixture
def h(getkey):
    return jax.random.normal(getkey(), (4,))


def random_biases(cell, key):
    """The same cell with every bias at random, for at first they are zero."""
    leaves, structure = jax.tree.flatten(cell)
    keys = jax.random.split(key, len(leaves))
    leaves = [
        jax.random.normal(k, leaf.shape) if leaf.ndim == 1 else leaf for k, leaf in zip(keys, leaves, strict=True)
    ]
    return jax.tree.unflatten(structure, leaves)


def test_vanilla(getkey, x, h):
    cell = random_biases(VanillaCell(3, 4, key=getkey()), getkey())
    memory, output = cell(h, x)
    w, b, u, c = (
        f64(a) for a in (cell.from_input.kernel, cell.from_input.bias, cell.from_memory.kernel, cell.from_memory.bias)
    )
    np.testing.assert_allclose(output, np.maximum(f64(x) @ w + b + f64(h) @ u + c, 0), rtol=1e-5, atol=1e-6)
    np.testing.assert_array_equal(memory, output)


def test_lstm(getkey, x, h):
    """Gates in the order input, candidate, forget, output; the forget gate opens by one."""
    cell = random_biases(LSTMCell(3, 4, key=getkey()), getkey())
    c = jax.random.normal(getkey(), (4,))
    (h_after, c_after), output = cell((h, c), x)
    gates = np.concatenate([f64(x), f64(h)]) @ f64(cell.gates.kernel) + f64(cell.gates.bias)
    i, g, f, o = gates[:4], gates[4:8], gates[8:12], gates[12:]
    expected = sigmoid(f + 1) * f64(c) + sigmoid(i) * np.tanh(g)
    np.testing.assert_allclose(c_after, expected, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(output, sigmoid(o) * np.tanh(expected), rtol=1e-5, atol=1e-6)
    np.testing.assert_array_equal(h_after, output)


def test_gru(getkey, x, h):
    """Update and reset gate; the reset acts on the memory before the candidate's product."""
    cell = random_biases(GRUCell(3, 4, key=getkey()), getkey())
    memory, output = cell(h, x)
    w, u, b = f64(cell.from_input), f64(cell.from_memory), f64(cell.bias)
    z = sigmoid(f64(x) @ w[:, :4] + f64(h) @ u[:, :4] + b[:4])
    r = sigmoid(f64(x) @ w[:, 4:8] + f64(h) @ u[:, 4:8] + b[4:8])
    a = np.tanh(f64(x) @ w[:, 8:] + (r * f64(h)) @ u[:, 8:] + b[8:])
    np.testing.assert_allclose(output, (1 - z) * f64(h) + z * a, rtol=1e-5, atol=1e-6)
    np.testing.assert_array_equal(memory, output)


def test_an_lstm_that_forgets_nothing_integrates_its_candidates(getkey):
    """With the forget and input gates wide open and the candidate saturated, c counts the steps."""
    cell = LSTMCell(1, 1, key=getkey())
    cell = eqx.tree_at(lambda c: c.gates.bias, cell, jnp.array([30.0, 30.0, 30.0, 0.0]))
    memory = cell.initial()
    for _ in range(7):
        memory, _ = cell(memory, jnp.zeros(1))
    assert float(memory[1][0]) == pytest.approx(7.0, abs=1e-3)


@pytest.mark.parametrize(("kind", "expected"), [("vanilla", 456_588), ("lstm", 1_822_224), ("gru", 1_366_668)])
def test_the_benchmarks_stack_has_its_number_of_weights(kind, expected, getkey):
    stack = Stack(kind, 32, (250, 250, 250, 250, 32), key=getkey())
    assert sum(leaf.size for leaf in jax.tree.leaves(stack)) == expected


def test_swish_stands_between_cells_and_not_behind_the_last(getkey, x):
    stack = Stack("vanilla", 3, (5, 4), key=getkey())
    _, output = stack(stack.initial(), x)
    _, middle = stack.cells[0](stack.cells[0].initial(), x)
    _, expected = stack.cells[1](stack.cells[1].initial(), middle * jax.nn.sigmoid(middle))
    np.testing.assert_allclose(output, expected, rtol=1e-6)
