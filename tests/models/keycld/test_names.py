"""Keypoints that have found their parts under each other's names exchange them."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld.data import Resident
from keycld.mechanics import Constraints, DistanceToPoint, FixedDistance
from keycld.models import Scene, config_for
from keycld.models.keycld.prepare_vision import name_keypoints
from keycld.vision import AbstractEstimator, Observation

CHAIN = Constraints(
    ("first", "second", "third"),
    (DistanceToPoint("first", (0.0, 0.0)), FixedDistance("first", "second"), FixedDistance("second", "third")),
)
SCENE = Scene(16, 16, 0, 5, 0.05, 8)


class Written(AbstractEstimator):
    """Reads keypoints that stand in the first row of a frame, row `order[k]` as keypoint k."""

    order: jax.Array

    def __call__(self, frame):
        return Observation(2 * frame[0, :3, :2][self.order] - 1, None)

    def reordered(self, order):
        return Written(self.order[order])


def chain(order):
    """Data of a triple pendulum in random poses, and a model that observes its bobs in this order."""
    angles = np.random.default_rng(0).uniform(-np.pi, np.pi, (8, 5, 3))
    bobs = 0.3 * np.cumsum(np.stack([np.sin(angles), np.cos(angles)], axis=-1), axis=2)
    image = np.zeros((8, 5, 16, 16, 3), np.uint8)
    image[:, :, 0, :3, :2] = np.round((bobs + 1) / 2 * 255)
    model = config_for("keycld", "fast", width=8, constraints=CHAIN).build(SCENE, jax.random.key(0))
    model = eqx.tree_at(lambda m: m.estimator, model, Written(jnp.array(order)))
    return model, Resident(jnp.asarray(image), jnp.zeros((8, 0)), jnp.float32(0.05)), bobs


@pytest.mark.parametrize("order", [(0, 1, 2), (1, 0, 2), (2, 0, 1), (1, 2, 0)])
def test_bobs_of_a_chain_get_their_own_names(order):
    model, data, bobs = chain(order)
    named, same = name_keypoints(model, data)
    assert same is data and (named is model) == (order == (0, 1, 2))
    np.testing.assert_array_equal(named.estimator.order, (0, 1, 2))
    np.testing.assert_allclose(named.observe(data.image[0, 0] / 255).keypoints, bobs[0, 0], atol=0.005)


def test_symmetric_keypoints_keep_their_names():
    model, data, _ = chain((1, 0, 2))
    free = config_for("keycld-nc", "fast", width=8, constraints=CHAIN).build(SCENE, jax.random.key(0))
    free = eqx.tree_at(lambda m: m.estimator, free, model.estimator)
    assert name_keypoints(free, data)[0] is free


@pytest.mark.parametrize(("kind", "looks"), [("keycld", None), ("keycld", 4), ("fc", None)])
def test_networks_in_another_order_render_the_same_frame(kind, looks, getkey):
    model = config_for(kind, "fast", width=8, constraints=CHAIN, looks=looks).build(SCENE, getkey())
    frame, order = jax.random.uniform(getkey(), (16, 16, 3)), jnp.array([2, 0, 1])
    before = model.estimator(frame)
    after = model.estimator.reordered(order)(frame)
    np.testing.assert_allclose(after.keypoints, before.keypoints[order], atol=1e-6)
    assert np.ptp(before.keypoints) > 1e-4
    if looks is not None:
        np.testing.assert_allclose(after.looks, before.looks[order], atol=1e-6)
        assert np.ptp(before.looks) > 1e-4
    rendered = model.renderer.reordered(order)(after.keypoints, after.looks)
    np.testing.assert_allclose(rendered, model.renderer(before.keypoints, before.looks), atol=1e-5)
    assert np.abs(model.renderer(after.keypoints, after.looks) - rendered).max() > 1e-5
