"""Parts that look different from recording to recording: what is seen in one frame renders the others."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld.data import Clip, RandomFrames, Resident
from keycld.models import Scene, config_for
from keycld.models.keycld.losses import PredictionLoss, VisionLoss
from keycld.systems import get

SCENE = Scene(height=16, width=16, inputs=0, frames=12, dt=0.05, trajectories=6)
DT = jnp.array(0.05)


def model_with_looks():
    config = config_for("keycld", "fast", width=8, shared_constants=False).completed(get("toy/double_pendulum"))
    return config.build(SCENE, jax.random.key(0))


def clip_of(frames):
    """One clip of all frames, consecutive."""
    count = len(frames)
    return Clip(frames[None], None, jnp.arange(count)[None], jnp.zeros((1, 0)), DT[None], count)


def test_the_system_says_that_its_recordings_differ():
    """The two colours of the double pendulum are in a random order, the pendulum is always red."""
    assert config_for("keycld", "fast").completed(get("toy/double_pendulum")).looks == 4
    pendulum = config_for("keycld", "fast").completed(get("toy/pendulum"))
    assert pendulum.looks is None and "looks" not in pendulum.settings()
    assert config_for("fc", "fast").completed(get("toy/double_pendulum")).looks is None


def test_parts_that_look_different_share_no_patches():
    for name, weights in (("toy/double_pendulum", (0.0, 0.0)), ("toy/pendulum", (2.0, 0.0))):
        vision = config_for("keycld", "fast").completed(get(name)).stages(SCENE)[0]
        assert vision.loss.patches == vision.alternative.patches == weights, name


@pytest.mark.slow
def test_a_prediction_keeps_the_mean_look_of_the_given_frames(getkey):
    model = model_with_looks()
    frames = jax.random.uniform(getkey(), (3, 16, 16, 3))
    state = eqx.filter_jit(lambda m: m.infer(frames, DT, jnp.zeros(0)))(model)
    seen = jax.vmap(model.observe)(frames).looks
    np.testing.assert_allclose(state.parameters["looks"], np.mean(seen, axis=0), atol=1e-6)
    rolled = eqx.filter_jit(lambda m: m.rollout(state, -DT, jnp.zeros(0), 2))(model)
    np.testing.assert_array_equal(rolled.parameters["looks"][2], state.parameters["looks"])
    other = eqx.tree_at(lambda s: s.parameters["looks"], state, -state.parameters["looks"])
    assert np.abs(model.render(other) - model.render(state)).max() > 1e-5


def test_a_frame_is_rendered_with_the_looks_of_the_other(getkey):
    """So the reconstruction error by hand has them exchanged."""
    model = model_with_looks()
    frames = jax.random.uniform(getkey(), (2, 16, 16, 3))
    loss = eqx.filter_jit(lambda m: VisionLoss()(m, clip_of(frames), key=getkey(), step=jnp.array(0)))
    _, terms = loss(model)
    seen = [model.observe(frame) for frame in frames]
    rendered = [model.renderer(seen[k].keypoints, seen[1 - k].looks) for k in (0, 1)]
    expected = np.mean([np.sum((np.asarray(r) - f) ** 2) for r, f in zip(rendered, frames, strict=True)])
    np.testing.assert_allclose(terms["reconstruction"], expected, rtol=1e-5)


@pytest.mark.slow
def test_looks_are_learned_in_all_stages(getkey):
    model = model_with_looks()
    clip = clip_of(jax.random.uniform(getkey(), (4, 16, 16, 3)))
    for loss in (VisionLoss(), PredictionLoss()):
        slope = eqx.filter_jit(
            eqx.filter_grad(lambda m, loss=loss: loss(m, clip, key=jax.random.key(1), step=jnp.array(0))[0])
        )(model)
        assert np.abs(slope.estimator.network.out.kernel[..., 2:]).max() > 0
        assert np.abs(slope.renderer.network.down[0].conv.kernel[:, :, -8:]).max() > 0


def test_frames_of_a_clip_are_of_one_trajectory(getkey):
    """Six trajectories of constant pictures, each of its own shade."""
    shade = np.broadcast_to(np.arange(6, dtype=np.uint8)[:, None, None, None, None], (6, 12, 16, 16, 3))
    data = Resident(jnp.asarray(shade), jnp.zeros((6, 0)), DT)
    clips = RandomFrames(8, 2)(data, getkey(), jnp.array(0))
    assert clips.frames.shape == (8, 2, 16, 16, 3) and len(np.unique(clips.frames[:, 0])) > 1
    np.testing.assert_array_equal(clips.frames[:, 0], clips.frames[:, 1])
    assert np.any(clips.index[:, 0] != clips.index[:, 1])
