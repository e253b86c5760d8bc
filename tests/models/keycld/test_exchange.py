"""Parts that exchange their looks from recording to recording: the constraints tell which keypoint is which part."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld._errors import KeycldError
from keycld.data import Clip
from keycld.mechanics import (
    ConstrainedLagrangian,
    Constraints,
    DistanceToPoint,
    FixedDistance,
    MechanicalDynamics,
    Motion,
    PointMasses,
    Rattle,
    State,
    SumPotential,
    own_law,
    own_parameters,
    rough_places,
)
from keycld.models import Scene, config_for
from keycld.models.keycld.exchange import arranged, fitting_order, nearest_order, orders, shared_constants, shuffled
from keycld.models.keycld.losses import PredictionLoss, VisionLoss
from keycld.systems import get
from keycld.vision import Observation

SCENE = Scene(height=16, width=16, inputs=0, frames=12, dt=0.05, trajectories=6)
PHI = Constraints(("inner", "outer"), (DistanceToPoint("inner"), FixedDistance("inner", "outer")))
LENGTHS = np.array([0.4, 0.5])
DT, NONE = jnp.float32(0.05), jnp.zeros(0)


def swings(count, frames=12, seed=0):
    """Positions [count, frames, 2, 2] of the inner and outer end of two rods that swing without any law."""
    random = np.random.default_rng(seed)
    phase, rate = random.uniform(0, 2 * np.pi, (2, count, 1, 2)), random.uniform(1.0, 3.0, (count, 1, 2))
    angle = phase[0] + np.sin(phase[1] + 0.2 * rate * np.arange(frames)[None, :, None])
    links = LENGTHS[:, None] * np.stack([np.sin(angle), -np.cos(angle)], axis=-1)
    return np.cumsum(links, axis=2).astype(np.float32)


def model_of(**changes):
    config = config_for("keycld", "fast", width=8, **changes).completed(get("toy/double_pendulum"))
    return config.build(SCENE, jax.random.key(0))


def test_the_default_is_where_constraints_tell_several_parts_of_different_looks_apart():
    fast = config_for("keycld", "fast")
    double = fast.completed(get("toy/double_pendulum"))
    assert double.exchange and double.settings()["exchange"] and model_of().exchange
    for name in ("toy/pendulum", "toy/pendulum_colors"):
        config = fast.completed(get(name))
        assert config.exchange is None and "exchange" not in config.settings(), name
    for model in ("keycld-nc", "node2", "fc"):
        assert config_for(model, "fast").completed(get("toy/double_pendulum")).exchange is None
    assert not model_of(exchange=False).exchange
    assert double.stages(SCENE)[0].loss.free and not fast.completed(get("toy/pendulum")).stages(SCENE)[0].loss.free


@pytest.mark.parametrize(
    ("model", "changes"),
    [("keycld-nc", {}), ("keycld", {"shared_constants": False}), ("keycld", {"looks": 0})],
)
def test_it_is_refused_where_nothing_tells_the_parts_apart(model, changes):
    config = config_for(model, "fast", exchange=True, **changes)
    with pytest.raises(KeycldError, match="exchange needs the model keycld with looks"):
        config.completed(get("toy/double_pendulum"))


def test_seven_keypoints_have_too_many_orders():
    names = tuple("abcdefg")
    links = tuple(FixedDistance(*pair) for pair in zip(names[:-1], names[1:], strict=True))
    chain = Constraints(names, (DistanceToPoint("a"), *links))
    config = config_for("keycld", "fast", constraints=chain, looks=4)
    assert config.completed().exchange is None
    with pytest.raises(KeycldError, match="2 to 6 keypoints"):
        dataclasses.replace(config, exchange=True).completed()


def test_constraints_tell_the_parts_of_each_recording():
    """Also without constants, where the motion shows what stays; these are the lengths."""
    x = swings(20)
    swapped = np.arange(20) % 3 == 0
    mixed = np.where(swapped[:, None, None, None], x[:, :, ::-1], x)
    constants = shared_constants(PHI, mixed)
    np.testing.assert_allclose(constants, PHI(jnp.asarray(x[0, 0].reshape(-1))), atol=1e-5)
    for given in (constants, None):
        found = jax.vmap(lambda x, given=given: fitting_order(PHI, given, x)[0])(jnp.asarray(mixed))
        np.testing.assert_array_equal(found[:, 0] == 1, swapped)


def test_noise_of_a_pixel_does_not_exchange_five_given_frames():
    x = swings(50, 5, seed=1)
    seen = x + np.random.default_rng(2).normal(0, 2 / 64, x.shape).astype(np.float32)
    constants = PHI(jnp.asarray(x[0, 0].reshape(-1)))
    found = jax.vmap(lambda x: fitting_order(PHI, constants, x)[0])(jnp.asarray(seen))
    # Where the outer end is as far from the pivot as the inner one is, either order fits.
    away = np.abs(np.linalg.norm(x[:, :, 1], axis=-1) - LENGTHS[0]).min(axis=1) > 0.1
    assert away.sum() > 20
    np.testing.assert_array_equal(np.asarray(found)[away, 0], 0)


def test_all_orders_are_compared_and_the_given_one_first():
    np.testing.assert_array_equal(orders(3)[0], [0, 1, 2])
    assert len({tuple(order) for order in orders(3).tolist()}) == 6


def test_keypoints_move_with_their_heat_maps_and_looks(getkey):
    observed = Observation(*(jax.random.normal(getkey(), (4, 2, *shape)) for shape in ((2,), (8, 8), (3,))))
    turned = arranged(observed, jnp.array([[0, 1], [1, 0], [1, 0], [0, 1]]))
    for part, whole in zip(turned, observed, strict=True):
        np.testing.assert_array_equal(part[1], whole[1, ::-1])
        np.testing.assert_array_equal(part[3], whole[3])
    drawn = shuffled(Observation(observed.keypoints.repeat(16, axis=0), None), 2, getkey())
    kept = np.all(np.asarray(drawn.keypoints) == np.asarray(observed.keypoints.repeat(16, axis=0)), axis=(1, 2))
    np.testing.assert_array_equal(kept[::2], kept[1::2])  # both frames of a clip alike
    assert 0.2 < kept.mean() < 0.8


def test_parts_around_places_of_their_own():
    """No constants are known, and every recording hangs from another place."""
    x = swings(20, frames=40)
    swapped = np.arange(20) % 3 == 0
    moved = x + np.random.default_rng(1).uniform(-0.2, 0.2, (20, 1, 1, 2)).astype(np.float32)
    mixed = np.where(swapped[:, None, None, None], moved[:, :, ::-1], moved)
    law = ConstrainedLagrangian(PointMasses.ones(2), SumPotential(jnp.zeros(4), {}), None, PHI)

    def found(x):
        return fitting_order(PHI, None, x, lambda flat: rough_places(law, flat[None])[0])[0]

    np.testing.assert_array_equal(jax.jit(jax.vmap(found))(jnp.asarray(mixed))[:, 0] == 1, swapped)


def test_the_nearest_order_is_that_of_fitted_positions(getkey):
    wanted = jax.random.normal(getkey(), (6, 3, 2))
    order = jnp.array([[0, 1, 2], [2, 0, 1], [1, 2, 0]] * 2)
    seen = Observation(wanted + 0.01 * jax.random.normal(getkey(), wanted.shape), None)
    mixed = arranged(seen, order)
    back = arranged(mixed, nearest_order(mixed.keypoints, wanted))
    np.testing.assert_array_equal(back.keypoints, seen.keypoints)


@pytest.mark.slow
def test_five_frames_tell_by_the_law_which_part_is_which():
    """Of a double pendulum that hangs from a place of its own, both orders keep all lengths for five frames."""
    config = config_for("keycld", "fast", width=8).completed(get("toy/double_pendulum_colors"))
    assert config.exchange and config.own_parameters
    model = config.build(SCENE, jax.random.key(0))
    law = ConstrainedLagrangian(
        PointMasses.ones(2), SumPotential(jnp.array([0.0, 3.0, 0.0, 3.0]), {}), None, model.law.constraint_function
    )
    dynamics = MechanicalDynamics(law, Rattle(substeps=4))
    prior = model.initial_state.prior
    prior = eqx.tree_at(lambda p: (p.factor_root, p.place_root), prior, (0.1 * jnp.eye(3), 0.2 * jnp.eye(2)))
    model = eqx.tree_at(
        lambda m: (m.dynamics, m.initial_state.prior, m.initial_state.error, m.estimator),
        model,
        (dynamics, prior, jnp.full(2, 2e-4), FirstRow()),
    )
    random = np.random.default_rng(0)
    x, places = swings(8, 1)[:, 0].reshape(8, 4), random.uniform(-0.2, 0.2, (8, 2))
    x = jnp.asarray(x + np.tile(places, 2), jnp.float32)
    own = own_parameters(jnp.zeros(5))

    def path(x, place):
        own["place"] = place
        here = own_law(law, own)
        state = State(Motion(x, jnp.zeros(4)), {"constants": here.constraint(x), **own})
        return dynamics.rollout(state, NONE, DT, 8).x[4:]

    paths = np.asarray(jax.jit(jax.vmap(path))(x, jnp.asarray(places, jnp.float32)))
    seen = paths + random.normal(0, 1e-4, paths.shape)
    frames = np.zeros((2, 8, 5, 16, 16, 3), np.float32)
    frames[0, :, :, 0, :4, 0] = seen + 0.5
    frames[1, :, :, 0, :4, 0] = seen[..., [2, 3, 0, 1]] + 0.5
    infer = eqx.filter_jit(lambda frames: jax.lax.map(lambda each: model.infer(each, DT, NONE), frames))
    for order in range(2):
        state = infer(jnp.asarray(frames[order]))
        right = np.abs(np.asarray(state.coordinates.x) - paths[:, 0]).max(axis=1) < 0.01
        assert right.sum() >= 7
        looks = np.asarray(state.parameters["looks"])[right]
        np.testing.assert_array_equal(looks, np.broadcast_to(np.eye(2, 4)[:: 1 - 2 * order], looks.shape))


class FirstRow(eqx.Module):
    """An estimator that reads the keypoints in the first row of a frame."""

    def __call__(self, frame):
        keypoints = frame[0, :4, 0].reshape(2, 2) - 0.5
        return Observation(keypoints, None, jnp.eye(2, 4) + 0 * keypoints[:, :1])


@pytest.fixture
def blobs(monkeypatch):
    """A model whose estimator sees the brightest red and cyan pixel, in this order, and frames of two recordings."""
    model = model_of()
    x = swings(2)
    constants = PHI(jnp.asarray(x[0, 0].reshape(-1)))
    model = eqx.tree_at(lambda m: m.initial_state.constants, model, constants)
    model = eqx.tree_at(lambda m: m.dynamics.law.constraint_function, model, PHI)

    def seen(self, frame):
        """The first row of a frame holds its keypoints."""
        keypoints = frame[0, :4, 0].reshape(2, 2) - 0.5
        return Observation(keypoints, None, jnp.eye(2, 4) + 0 * keypoints[:, :1])

    monkeypatch.setattr(type(model.estimator), "__call__", seen)
    frames = np.zeros((2, 12, 16, 16, 3), np.float32)
    frames[0, :, 0, :4, 0] = x[0].reshape(12, 4) + 0.5
    frames[1, :, 0, :4, 0] = x[1, :, ::-1].reshape(12, 4) + 0.5
    return model, jnp.asarray(frames), x


@pytest.mark.slow
def test_the_frames_of_a_recording_are_named_together(blobs):
    """In the second recording the first keypoint is the outer part; its looks stay with it."""
    model, frames, x = blobs
    observed = eqx.filter_jit(model.observe_clips)(frames)
    np.testing.assert_allclose(observed.keypoints.reshape(x.shape), x, atol=1e-6)
    np.testing.assert_array_equal(observed.looks[0], jnp.eye(2, 4))
    np.testing.assert_array_equal(observed.looks[-1], jnp.eye(2, 4)[::-1])
    one = model.observe(frames[1, 0])
    np.testing.assert_allclose(one.keypoints, x[1, 0], atol=1e-6)
    for k in (0, 1):
        state = eqx.filter_jit(model.infer)(frames[k, :3], jnp.array(0.05), jnp.zeros(0))
        np.testing.assert_allclose(model.keypoints(state), x[k, model.initial_state.anchor], atol=0.01)
        np.testing.assert_array_equal(state.parameters["looks"], observed.looks[12 * k])


def test_the_vision_stage_does_not_ask_which_part_is_which(blobs):
    """No constraint acts, and the order of the keypoints is drawn for each clip."""
    model, frames, _ = blobs
    clip = Clip(frames[:, :2], None, jnp.arange(2)[None].repeat(2, 0), jnp.zeros((2, 0)), jnp.full(2, 0.05), 2)
    loss = eqx.filter_jit(VisionLoss(constraint=(1e6, 1e6), coupling=1e6, patches=(0.0, 0.0), centre=0.0, free=True))
    totals = [loss(model, clip, key=jax.random.key(k), step=jnp.array(50)) for k in range(6)]
    assert max(float(total) for total, _ in totals) < 1e4
    assert len({round(float(terms["reconstruction"]), 3) for _, terms in totals}) > 1


def test_predictions_begin_from_named_keypoints(blobs):
    model, frames, _ = blobs
    clip = Clip(frames[:, :4], None, jnp.arange(4)[None].repeat(2, 0), jnp.zeros((2, 0)), jnp.full(2, 0.05), 4)
    _, terms = eqx.filter_jit(PredictionLoss())(model, clip, key=jax.random.key(0), step=jnp.array(0))
    assert float(terms["constraint"]) < 1e-8  # the lengths are those of the swings in every frame
