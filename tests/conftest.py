"""Strict settings for every test: silent broadcasting and silent warnings are failures."""

import jax
import pytest

jax.config.update("jax_numpy_rank_promotion", "raise")


@pytest.fixture
def getkey():
    """A function that gives a fresh random key at each call, the same ones in every run."""
    keys = iter(jax.random.split(jax.random.key(20220622), 1000))
    return lambda: next(keys)
