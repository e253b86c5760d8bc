"""Losses of latent models against formulas written out in NumPy."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld.data import Clip, resident
from keycld.models import Scene, config_for
from keycld.models.base import Gaussian
from keycld.models.latent import losses
from keycld.models.latent.losses import ELBOLoss, GECOLoss, Targets, divergence, posterior_statistics
from keycld.training.step import initial_progress, make_step
from scenes import disc_pendulum

TINY = {"channels": 4, "hidden": 8, "depth": 1, "latent": 4}
LENGTH = 9
# Compiled: its two hundred operations one by one take three times as long.
reconstruct = eqx.filter_jit(losses.reconstruct)
FORWARD, BOTH = Targets(False, False, 0, 100), Targets(True, True, 0, 100)


def built(key, **settings):
    return config_for("hgn", "released", **TINY, **settings).build(Scene(16, 16, 0, LENGTH, 0.05, 3), key)


@pytest.fixture
def clips(getkey):
    """Four windows of nine frames."""
    return Clip(
        frames=jax.random.uniform(getkey(), (4, LENGTH, 16, 16, 3)),
        cached=None,
        index=jnp.broadcast_to(jnp.arange(LENGTH)[None], (4, LENGTH)),
        u=jnp.zeros((4, 0)),
        dt=jnp.full(4, 0.05),
        span=LENGTH,
    )


@eqx.filter_jit
def predictions(model, clips):
    """Frames predicted from the first five of each window."""
    return jax.vmap(lambda f: model.predict(f, jnp.array(0.05), jnp.zeros(0), LENGTH).frames)(clips.frames[:, :5])


def certain(model):
    """The same model with posterior deviations of e⁻²⁰: a sample is the mean."""
    bias = model.encoder.out.bias.at[4:].set(-20.0)
    model = eqx.tree_at(lambda m: m.encoder.out.bias, model, bias)
    return eqx.tree_at(lambda m: m.encoder.out.kernel, model, model.encoder.out.kernel.at[:, 4:].set(0.0))


def test_divergence_is_that_of_two_normal_distributions():
    """∫ q ln(q / p) on a fine grid, for each number of z."""
    mean, deviation = np.array([0.0, 1.5, -0.3]), np.array([1.0, 0.2, 1.7])
    z = np.linspace(-15, 15, 200_001)
    expected = 0.0
    for m, s in zip(mean, deviation, strict=True):
        log_q, log_p = -((z - m) ** 2) / (2 * s**2) - np.log(s), -(z**2) / 2
        q = np.exp(log_q) / np.sqrt(2 * np.pi)
        expected += np.sum(q * (log_q - log_p)) * (z[1] - z[0])
    found = divergence(Gaussian(jnp.asarray(mean, jnp.float32), jnp.asarray(deviation, jnp.float32)))
    assert float(found) == pytest.approx(expected, rel=1e-4)


def test_training_samples_the_latent_vector(getkey, clips):
    """Three keys, three errors; one error where the posterior is as narrow as a point."""
    model, keys = built(getkey()), jax.random.split(getkey(), 3)

    def errors(model):
        return [float(reconstruct(model, clips, key, FORWARD).squared_error) for key in keys]

    assert len(set(errors(model))) == 3
    np.testing.assert_allclose(errors(certain(model)), errors(certain(model))[0], rtol=1e-6)


def test_a_picture_that_is_wrong_and_saturated_is_left_through_the_cross_entropy(getkey, clips):
    """Values rendered as 1 − 2e−9: no gradient of the squared error, (1 − x) w / 3 by the bias of a colour."""
    model = certain(built(getkey()))
    at = lambda m: (m.decoder.convolutions[-1].bias, m.decoder.convolutions[-1].kernel)  # noqa: E731
    model = eqx.tree_at(at, model, (jnp.full(3, 20.0), jnp.zeros_like(at(model)[1])))

    @eqx.filter_jit
    def slope(model, weight):
        loss = ELBOLoss(0.0, False, FORWARD._replace(cross_entropy=weight))
        with_model = eqx.filter_value_and_grad(lambda m: loss(m, clips, key=jax.random.key(0), step=jnp.array(0))[0])
        value, gradient = with_model(model)
        return value, at(gradient)[0]

    (value, unmoved), (same, moved) = slope(model, None), slope(model, 0.3)
    assert float(value) == float(same)
    np.testing.assert_allclose(unmoved, 0.0, atol=1e-7)
    np.testing.assert_allclose(moved, 0.1 * np.mean(1.0 - clips.frames[:, 4:], axis=(0, 1, 2, 3)), rtol=1e-4)


def test_cross_entropy_is_of_the_stage_for_pictures():
    stages = config_for("hgn", "fast").stages(Scene(32, 32, 0, 256, 0.05, 100))
    assert [stage.loss.targets.cross_entropy for stage in stages] == [0.1, None, None, None]


def test_forward_targets_begin_with_the_last_given_frame(getkey, clips):
    model = certain(built(getkey()))
    found = reconstruct(model, clips, getkey(), FORWARD)
    assert found.frames == LENGTH - 4 and found.values == found.frames * 16 * 16 * 3
    predicted = predictions(model, clips)
    expected = np.mean((np.asarray(predicted) - np.asarray(clips.frames))[:, 4:] ** 2)
    assert float(found.squared_error) == pytest.approx(expected, rel=1e-5)


def test_both_ways_half_of_the_windows_are_seen_from_their_end(getkey, clips):
    """The second half: the encoder sees the last five frames in the order of time, and the state is at their middle."""
    model = certain(built(getkey(), regime="forward_backward"))
    found = reconstruct(model, clips, getkey(), BOTH)
    assert found.frames == LENGTH
    errors = []
    for k, frames in enumerate(clips.frames):
        first = 0 if k < 2 else LENGTH - 5
        state = eqx.filter_jit(model.infer)(frames[first : first + 5], jnp.array(0.05), jnp.zeros(0))
        states = eqx.filter_jit(model.unroll)(state, first + 2, jnp.array(0.05), jnp.zeros(0), LENGTH)
        errors.append(np.mean((np.asarray(jax.jit(jax.vmap(model.render))(states)) - np.asarray(frames)) ** 2))
    assert float(found.squared_error) == pytest.approx(np.mean(errors), rel=1e-5)


def test_given_frames_alone_are_targets_of_the_original(getkey, clips):
    """The state belongs to the last of the given frames, and the motion is rolled back over them."""
    model = certain(built(getkey(), given=LENGTH, regime="given"))
    found = reconstruct(model, clips, getkey(), Targets(False, True, 0, 100))
    assert found.frames == LENGTH
    errors = []
    for frames in clips.frames:
        last = model.infer(frames, jnp.array(0.05), jnp.zeros(0))
        back = model.rollout(last, jnp.array(-0.05), jnp.zeros(0), LENGTH - 1)
        errors.append(np.mean((np.asarray(jax.vmap(model.render)(back))[::-1] - np.asarray(frames)) ** 2))
    assert float(found.squared_error) == pytest.approx(np.mean(errors), rel=1e-5)


@pytest.mark.parametrize("both_ways", [False, True])
def test_motions_are_compared_with_the_states_that_the_encoder_sees(getkey, clips, both_ways):
    """On average over places: |z(t) − μ(t)|² over the variance of μ, both by the model's own methods."""
    model = certain(built(getkey(), regime="forward_backward" if both_ways else "forward"))
    anchor, places = (2 if both_ways else 4), LENGTH - 4
    targets = BOTH if both_ways else FORWARD
    infer = eqx.filter_jit(model.infer)
    seen, off = np.zeros((places, 4, 4)), np.zeros((places, 4))
    for k, frames in enumerate(clips.frames):
        first = LENGTH - 5 if both_ways and k >= 2 else 0
        state = infer(frames[first : first + 5], jnp.array(0.05), jnp.zeros(0))
        states = eqx.filter_jit(model.unroll)(state, first + anchor, jnp.array(0.05), jnp.zeros(0), LENGTH)
        reached = np.concatenate(jax.tree.leaves(states.coordinates), axis=1)
        for place in range(places):
            there = infer(frames[place : place + 5], jnp.array(0.05), jnp.zeros(0))
            seen[place, k] = np.concatenate(jax.tree.leaves(there.coordinates))
            off[place, k] = np.sum((reached[place + anchor] - seen[place, k]) ** 2)
    # One key, whose places are found by comparing with all combinations.
    found = float(reconstruct(model, clips, getkey(), targets, True).strayed)
    choices = np.array(np.meshgrid(*[range(places)] * 4)).reshape(4, -1).T
    each = np.arange(4)
    expected = [off[at, each].mean() / seen[at, each].var(axis=0).sum() for at in choices]
    assert np.min(np.abs(np.array(expected) / found - 1)) < 1e-5
    assert reconstruct(model, clips, getkey(), targets).strayed is None


def test_what_an_untrained_encoder_sees_is_not_infinitely_far_away(getkey, clips):
    """Almost the same state in all pictures: in units of their variance alone this would be a huge number."""
    model = built(getkey())
    means = jax.vmap(model.posterior)(clips.frames[:, :5]).mean
    assert float(jnp.sum(jnp.var(means, axis=0))) < 1e-2
    assert 10 < float(reconstruct(model, clips, getkey(), FORWARD, True).strayed) < 200


def test_consistency_is_a_term_of_both_losses(getkey, clips):
    model, key = built(getkey()), getkey()

    def value(loss):
        memory = {"memory": loss.initial()} if isinstance(loss, GECOLoss) else {}
        return eqx.filter_jit(loss)(model, clips, key=key, step=jnp.array(0), **memory)[:2]

    for loss in (ELBOLoss(0.1, False, FORWARD), GECOLoss(1e-3, 0.01, FORWARD)):
        plain, without = value(loss)
        weighed, terms = value(dataclasses.replace(loss, consistency=0.5))
        assert "strayed" not in without
        assert float(weighed - plain) == pytest.approx(0.5 * float(terms["strayed"]), rel=1e-3)


def test_a_few_random_frames_estimate_the_error_of_all(getkey, clips):
    """Two of five targets: other ones with each key, on average the same error, and S is still that of all."""
    model = certain(built(getkey()))
    # A frame that differs from all others shows which ones were taken.
    clips = dataclasses.replace(clips, frames=clips.frames.at[:, -1].set(5.0))
    whole = reconstruct(model, clips, getkey(), FORWARD)
    few = jax.jit(lambda key: reconstruct(model, clips, key, FORWARD._replace(rendered=2)).squared_error)
    errors = np.asarray([few(key) for key in jax.random.split(getkey(), 200)])
    assert errors.std() > 0.1 * errors.mean()
    assert errors.mean() == pytest.approx(float(whole.squared_error), rel=0.1)
    assert reconstruct(model, clips, getkey(), FORWARD._replace(rendered=2)).values == whole.values


def test_explained_is_zero_for_the_mean_picture(getkey, clips):
    """A decoder of one colour, the mean of all targets, explains nothing of frames of other colours."""
    model = built(getkey())
    last = model.decoder.convolutions[-1]
    dull = (jnp.zeros_like(last.kernel), jnp.full(3, np.log(0.3 / 0.7)))
    model = eqx.tree_at(lambda m: (m.decoder.convolutions[-1].kernel, m.decoder.convolutions[-1].bias), model, dull)
    shade = jax.random.uniform(getkey(), (4, LENGTH, 1, 1, 1), minval=-0.2, maxval=0.2)
    frames = jnp.broadcast_to(0.3 + shade - jnp.mean(shade[:, 4:]), (4, LENGTH, 16, 16, 3))
    found = reconstruct(model, dataclasses.replace(clips, frames=frames), getkey(), FORWARD)
    assert float(found.statistics["explained"]) == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize("per_frame", [False, True])
def test_elbo_is_the_likelihood_and_the_weighed_divergence(getkey, clips, per_frame):
    """Summed −ln N(x; μ, ½) and β KL, over the number S of values; with eq. (3)'s weight, T times the latter."""
    model = certain(built(getkey()))
    key = getkey()
    loss, terms = eqx.filter_jit(ELBOLoss(0.7, per_frame, FORWARD))(model, clips, key=key, step=jnp.array(0))
    targets = np.asarray(clips.frames, np.float64)[:, 4:]
    predicted = predictions(model, clips)
    error = targets - np.asarray(predicted, np.float64)[:, 4:]
    density = np.exp(-(error**2) / (2 * 0.5)) / np.sqrt(2 * np.pi * 0.5)
    likelihood = np.sum(np.log(density), axis=(1, 2, 3, 4))
    mean = np.asarray(jax.vmap(model.posterior)(clips.frames[:, :5]).mean, np.float64)
    kl = np.sum(0.5 * (mean**2 + np.exp(-40) - 1) + 20, axis=1)
    values = 5 * 16 * 16 * 3
    weight = 0.7 * (5 if per_frame else 1)
    assert float(loss) == pytest.approx(np.mean(-likelihood + weight * kl) / values, rel=1e-5)
    assert float(terms["log_likelihood"]) == pytest.approx(np.mean(likelihood) / values, rel=1e-5)
    assert float(terms["kl"]) == pytest.approx(np.mean(kl), rel=1e-5)


def test_statistics_tell_which_numbers_of_the_latent_vector_are_used():
    mean = jnp.array([[2.0, 0.0], [-2.0, 0.0]])
    found = posterior_statistics(Gaussian(mean, jnp.array([[0.1, 1.0], [0.1, 1.0]])))
    assert {name: float(value) for name, value in found.items()} == pytest.approx(
        {"posterior_deviation": 0.55, "posterior_spread": 1.0, "informative": 1.0}
    )


def test_geco_raises_the_multiplier_while_the_error_is_too_large(getkey, clips):
    model, key, rate = built(getkey()), getkey(), 0.01
    ends = {}
    for kappa in (1e-3, 1.0):
        loss = GECOLoss(kappa, rate, FORWARD)
        memory = loss.initial()
        assert float(jax.nn.softplus(memory["raw"])) == pytest.approx(1.0)
        total, terms, memory = eqx.filter_jit(loss)(model, clips, key=key, step=jnp.array(0), memory=memory)
        values = 5 * 16 * 16 * 3
        expected = float(terms["squared_error"]) - kappa + float(terms["kl"]) / values
        assert float(total) == pytest.approx(expected, rel=1e-4)
        assert float(terms["multiplier"]) == pytest.approx(1.0)
        ends[kappa] = float(memory["raw"])
    begin_at = float(np.log(np.e - 1))
    assert ends[1e-3] == pytest.approx(begin_at + rate, abs=1e-5)  # the first step of Adam has the size of its rate
    assert ends[1.0] == pytest.approx(begin_at - rate, abs=1e-5)


def test_geco_weighs_the_error_by_the_multiplier(getkey, clips):
    model, key = built(getkey()), getkey()
    loss = GECOLoss(1e-3, 0.01, FORWARD)
    memory = loss.initial() | {"raw": jnp.array(3.0)}
    total, terms, _ = eqx.filter_jit(loss)(model, clips, key=key, step=jnp.array(0), memory=memory)
    constraint, kl = float(terms["squared_error"]) - 1e-3, float(terms["kl"]) / (5 * 16 * 16 * 3)
    assert float(total) == pytest.approx(np.log1p(np.exp(3.0)) * constraint + kl, rel=1e-4)


@pytest.mark.parametrize("both_ways", [False, True])
def test_frames_in_chunks_give_the_same_loss_and_gradient(getkey, clips, both_ways):
    """Rendered three at a time, which does not divide their number, and all at once."""
    model, key = built(getkey(), regime="forward_backward" if both_ways else "forward"), getkey()

    def loss(model, at_once):
        return ELBOLoss(1.0, False, Targets(both_ways, both_ways, 0, at_once))(
            model, clips, key=key, step=jnp.array(0)
        )[0]

    whole, parts = (eqx.filter_jit(eqx.filter_value_and_grad(lambda m, n=n: loss(m, n)))(model) for n in (100, 3))
    for one, other in zip(jax.tree.leaves(whole), jax.tree.leaves(parts), strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-3, atol=1e-6)


def test_a_step_of_the_published_size_fits_into_memory():
    """128 windows of 64 frames: the layers of all rendered frames together would take 15 GB, of a chunk 2 GB."""
    config, scene = config_for("hgn", "released"), Scene(32, 32, 0, 256, 0.05, 100)
    model = eqx.filter_eval_shape(config.build, scene, jax.random.key(0))
    (stage,) = config.stages(scene)
    frames = jax.ShapeDtypeStruct((128, 64, 32, 32, 3), jnp.float32)

    def loss(model, frames):
        index = jnp.broadcast_to(jnp.arange(64)[None], (128, 64))
        windows = Clip(frames, None, index, jnp.zeros((128, 0)), jnp.full(128, 0.05), 64)
        return stage.loss(model, windows, key=jax.random.key(0), step=jnp.array(0))[0]

    compiled = jax.jit(jax.grad(loss)).lower(model, frames).compile()
    assert compiled.memory_analysis().temp_size_in_bytes < 2.5e9


def test_a_few_steps_of_training_lower_the_loss(getkey):
    data = resident(disc_pendulum(4, 12, seed=0))
    data = eqx.tree_at(lambda d: d.u, data, data.u[:, :0])
    config = config_for("hgn", "released", **TINY, batch=4, steps=40, rate=3e-3)
    scene = Scene(16, 16, 0, 12, 0.05, 4)
    (stage,) = config.stages(scene)
    model = config.build(scene, getkey())
    progress, rest = initial_progress(stage, model)
    _, terms = make_step(stage, 0, 0, 40)((rest, data), progress)
    errors = np.asarray(terms["squared_error"])
    assert errors[-5:].mean() < 0.5 * errors[:5].mean()
