"""KeyCLD-NC, NODE2 and FC are KeyCLD with one part replaced, in every preset."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld import KeycldError
from keycld.data import Clip
from keycld.mechanics import Constraints, DistanceToPoint, Leapfrog
from keycld.models import Scene, config_for, models
from keycld.models.keycld.config import MODELS
from keycld.models.keycld.short_rollout_loss import ShortRolloutLoss, turned, turned_back

SCENE = Scene(height=16, width=16, inputs=1, frames=12, dt=0.05, trajectories=6)
DISC = Constraints(("disc",), (DistanceToPoint("disc"),))
DT = jnp.array(0.05)


def configured(model, preset="fast"):
    return config_for(model, preset, constraints=DISC, width=8)


@pytest.mark.parametrize("preset", ["fast", "control", "paper", "journal"])
@pytest.mark.parametrize("kind", MODELS)
def test_every_model_of_every_preset_infers_a_state_and_renders_it(preset, kind, getkey):
    assert preset in models()[kind].presets
    config = configured(kind, preset)
    model = config.build(SCENE, jax.random.key(0))
    frames = jax.random.uniform(getkey(), (12, 16, 16, 3))
    rendered = eqx.filter_jit(lambda model, frames: model.render(model.infer(frames, DT, jnp.ones(1))))
    assert rendered(model, frames[: model.context]).shape == (16, 16, 3)
    assert sum(stage.steps for stage in config.stages(SCENE)) > 0


@pytest.mark.parametrize("kind", ["node2", "fc"])
def test_every_part_of_an_ablation_has_a_first_gradient(kind, getkey):
    config = configured(kind)
    model, stage = config.build(SCENE, jax.random.key(0)), config.stages(SCENE)[-1]
    frames = jax.random.uniform(getkey(), (12, 16, 16, 3))
    clip = Clip(frames[None], None, jnp.arange(12)[None], jnp.ones((1, 1)), DT[None], 12)

    @eqx.filter_jit
    @eqx.filter_value_and_grad
    def loss(model):
        return stage.loss(model, clip, key=jax.random.key(1), step=jnp.array(0))[0]

    value, gradient = loss(model)
    assert np.isfinite(float(value))
    for name in ("estimator", "dynamics", "renderer"):
        assert any(bool(jnp.any(leaf != 0)) for leaf in jax.tree.leaves(getattr(gradient, name))), name


def test_without_constraints_the_integrator_is_stoermer_verlet(getkey):
    model = configured("keycld-nc").build(SCENE, getkey())
    model = eqx.tree_at(lambda m: m.dynamics.law.potential.weight, model, jnp.array([0.4, 3.0]))
    plain = eqx.tree_at(lambda m: m.dynamics.integrator, model, Leapfrog(substeps=4))
    frames = jax.random.uniform(getkey(), (2, 16, 16, 3))
    assert model.constraint(jnp.ones(2)).shape == (0,)
    predict = eqx.filter_jit(lambda m: m.predict(frames, DT, jnp.ones(1), 8).states.coordinates.x)
    x, y = predict(model), predict(plain)
    np.testing.assert_allclose(x, y, atol=1e-5)
    assert float(jnp.abs(jnp.linalg.norm(x, axis=1) - jnp.linalg.norm(x[0])).max()) > 1e-2


def test_node2_accelerates_by_position_velocity_and_input(getkey):
    law = configured("node2").build(SCENE, getkey()).moving_law
    x, v, u = (jax.random.normal(getkey(), (n,)) for n in (2, 2, 1))
    assert [k.shape for k in law.perceptron.kernels] == [(5, 64), (64, 64), (64, 64), (64, 2)]
    for k in range(3):
        jacobian = jax.jacfwd(law.acceleration, argnums=k)(x, v, u)
        assert bool(jnp.any(jacobian != 0))


def test_fully_connected_networks_have_coordinates_but_no_maps(getkey):
    model = configured("fc").build(SCENE, getkey())
    seen = model.observe(jax.random.uniform(getkey(), (16, 16, 3)))
    assert seen.heat_maps is None and seen.keypoints.shape == (1, 2)
    with pytest.raises(KeycldError, match="multiples of 8, not 18 × 16"):
        configured("fc").build(dataclasses.replace(SCENE, height=18), getkey())


@pytest.mark.parametrize("code", range(8))
def test_the_eight_symmetries_of_a_picture_are_undone(code, getkey):
    turn = jnp.array([bool(code & 1), bool(code & 2), bool(code & 4)])
    picture = jax.random.uniform(getkey(), (5, 5, 2))
    np.testing.assert_array_equal(turned_back(turned(picture, turn), turn), picture)
    others = [turned(picture, jnp.array([bool(k & 1), bool(k & 2), bool(k & 4)])) for k in range(8)]
    assert sum(bool(jnp.array_equal(turned(picture, turn), other)) for other in others) == 1


def test_the_2024_loss_is_the_published_one_written_out_by_hand(getkey):
    """Four explicit Euler steps from every frame that has them, central differences on ker DΦ, in plain NumPy."""
    model = configured("keycld", "journal").build(SCENE, jax.random.key(0))
    frames = jax.random.uniform(getkey(), (1, 10, 16, 16, 3))
    clip = Clip(frames, None, jnp.arange(10)[None], jnp.full((1, 1), 0.7), DT[None], 10)
    loss = eqx.filter_jit(ShortRolloutLoss(augment=False))
    total, terms = loss(model, clip, key=getkey(), step=jnp.array(0))

    observe = eqx.filter_jit(model.observe)
    seen = [observe(frame) for frame in frames[0]]
    x = np.array([np.ravel(s.keypoints) for s in seen], float)
    dt, law = float(DT), model.moving_law
    dynamics, accelerate = 0.0, eqx.filter_jit(law.acceleration)
    for k in range(1, 4):  # frames 1 ... 8 have a velocity; roll-outs from the first three of them
        v = (x[k + 1] - x[k - 1]) / (2 * dt)
        v = v - x[k] * (x[k] @ v) / (x[k] @ x[k])  # DΦ of a distance to the origin is along x
        y = x[k].copy()
        for j in range(4):
            a = np.asarray(accelerate(jnp.asarray(y, jnp.float32), jnp.asarray(v, jnp.float32), jnp.full(1, 0.7)))
            y, v = y + dt * v, v + dt * a
            dynamics += np.sum((y - x[k + j + 1]) ** 2)
    assert float(terms["dynamics"]) == pytest.approx(dynamics, rel=1e-3)

    entropy = []
    axis = np.linspace(-1, 1, 16)
    for s in seen:
        heat = np.asarray(s.heat_maps)[0] / np.asarray(s.heat_maps).max()
        px, py = np.asarray(s.keypoints)[0]
        blob = np.exp(-((axis[None, :] - px) ** 2 + (-axis[:, None] - py) ** 2) / (2 * 0.1**2))
        entropy.append(-np.mean(blob * np.log(heat + 1e-4) + (1 - blob) * np.log(1 - heat + 1e-4)))
    assert float(terms["heat_map"]) == pytest.approx(np.mean(entropy), rel=1e-3)

    renderer = eqx.filter_jit(model.renderer)
    rendered = np.array([renderer(s.keypoints) for s in seen])
    reconstruction = np.mean(np.sum((rendered - np.asarray(frames[0])) ** 2, axis=(1, 2, 3)))
    assert float(terms["reconstruction"]) == pytest.approx(reconstruction, rel=1e-4)
    assert float(total) == pytest.approx(reconstruction + dynamics + np.mean(entropy), rel=1e-4)


@pytest.mark.slow
def test_the_augmented_loss_is_random_and_finite(getkey):
    """With augmentation the loss is finite, and it differs between keys, because the network is not symmetric."""
    model = configured("keycld", "journal").build(SCENE, jax.random.key(0))
    clip = Clip(
        jax.random.uniform(getkey(), (1, 10, 16, 16, 3)), None, jnp.arange(10)[None], jnp.ones((1, 1)), DT[None], 10
    )
    loss = eqx.filter_jit(ShortRolloutLoss())
    first, second = (float(loss(model, clip, key=jax.random.key(k), step=jnp.array(0))[0]) for k in (1, 2))
    assert np.isfinite(first) and first != second
