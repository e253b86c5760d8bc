"""Optimisers that act on packed arrays make the updates of optax."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from optax import contrib

from keycld.mechanics import MLPPotential
from keycld.stages import adam, muon, warmup_cosine
from keycld.vision import LightUNet


@pytest.fixture(scope="module")
def parameters():
    keys = jax.random.split(jax.random.key(0))
    parts = (
        LightUNet(12, 4, 8, key=keys[0]),
        MLPPotential(4, 8, key=keys[1]),
        {"scale": jnp.ones(()), "none": None},
    )
    return eqx.filter(parts, eqx.is_inexact_array)


def plain_muon(schedule, dense):
    def of(leaf):
        if leaf.ndim == 4:
            return contrib.MuonDimensionNumbers((0, 1, 2), (3,))
        return contrib.MuonDimensionNumbers((1,), (0,)) if dense and leaf.ndim == 2 else None

    return contrib.muon(schedule, muon_weight_dimension_numbers=lambda tree: jax.tree.map(of, tree), consistent_rms=0.2)


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        (adam, optax.adam),
        (muon, lambda schedule: plain_muon(schedule, True)),
        (lambda schedule: muon(schedule, dense=False), lambda schedule: plain_muon(schedule, False)),
    ],
    ids=["adam", "muon", "muon of convolutions only"],
)
def test_updates_are_those_of_optax(parameters, ours, theirs):
    schedule = warmup_cosine(1e-2, 20)
    mine, expected = ours(schedule), theirs(schedule)
    states = mine.init(parameters), expected.init(parameters)
    for k in range(6):
        keys = iter(jax.random.split(jax.random.key(k), 100))
        gradient = jax.tree.map(lambda leaf, keys=keys: jax.random.normal(next(keys), leaf.shape), parameters)
        update, first = jax.jit(mine.update)(gradient, states[0], parameters)
        right, second = jax.jit(expected.update)(gradient, states[1], parameters)
        states = first, second
        assert jax.tree.structure(update) == jax.tree.structure(right)
        for one, other in zip(jax.tree.leaves(update), jax.tree.leaves(right), strict=True):
            # The iterations towards an orthogonal matrix enlarge rounding to a thousandth of an update.
            np.testing.assert_allclose(one, other, rtol=2e-3, atol=2e-6)


def test_few_arrays_replace_many(parameters):
    state = muon(optax.constant_schedule(1e-3)).init(parameters)
    sizes = [leaf.shape for leaf in jax.tree.leaves(state) if leaf.ndim == 3]
    shapes = {leaf.shape for leaf in jax.tree.leaves(parameters) if leaf.ndim in (2, 4)}
    assert 0 < len(sizes) <= len(shapes)
