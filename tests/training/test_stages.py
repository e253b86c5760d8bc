import dataclasses
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from keycld._errors import KeycldError
from keycld.data import FrameGroups, RandomFrames, Resident, WholeTrajectories
from keycld.models.keycld.judge import judge_trained, judge_vision
from keycld.stages import AbstractLoss, AbstractStatefulLoss, Group, Stage, forgetful, part, warmup_cosine
from keycld.training.loop import _mean
from keycld.training.step import diagnose, initial_progress, make_step
from keycld.vision import Observation


@pytest.fixture
def data():
    """Four trajectories of ten frames whose pixels all have the value 10 n + t."""
    number = (10 * np.arange(4)[:, None] + np.arange(10)[None, :]).astype(np.uint8)
    image = np.broadcast_to(number[:, :, None, None, None], (4, 10, 8, 8, 3))
    return Resident(jnp.asarray(image), jnp.arange(4.0)[:, None], jnp.array(0.1))


def numbers(clip):
    return np.round(np.asarray(clip.frames[..., 0, 0, 0]) * 255).astype(int)


def test_groups_are_of_consecutive_frames_anywhere_in_the_window(data):
    sampler = FrameGroups(batch=256, groups=2, windows=(6,), steps=10.0)
    clip = sampler(data, jax.random.key(0), jnp.array(3))
    index = np.asarray(clip.index)
    assert clip.span == 6
    np.testing.assert_array_equal(index[:, 1::2] - index[:, ::2], 1)
    assert (index[:, 2] - index[:, 0] >= 2).all()
    assert set(index[:, 0]) == {0, 1, 2} and set(index[:, 2]) == {2, 3, 4}  # odd places too, and the last ones
    seen = numbers(clip)
    np.testing.assert_array_equal(seen - seen[:, :1], index - index[:, :1])
    np.testing.assert_array_equal(np.asarray(clip.u)[:, 0], seen[:, 0] // 10)
    assert set(seen[:, 0] % 10 - index[:, 0]) == set(range(5))  # every place that leaves room for the window


def test_a_share_of_the_clips_begins_where_a_trajectory_does(data):
    clip = FrameGroups(batch=1000, groups=2, windows=(6,), steps=10.0, first_frames=0.5)(
        data, jax.random.key(0), jnp.array(3)
    )
    first = numbers(clip)[:, 0] % 10 == 0
    # Of the other half a fifth of the windows start there, and the first of their groups two times out of six.
    assert 0.5 < first.mean() < 0.65
    assert (np.asarray(clip.index)[first][:, :2] == [0, 1]).all()
    assert set(np.asarray(clip.index)[first][:, 2]) == {2, 4}


def test_the_window_grows_with_the_steps(data):
    sampler = FrameGroups(batch=64, groups=2, windows=(4, 7, 10), steps=9.0)
    last = [int(sampler(data, jax.random.key(0), jnp.array(k)).index.max()) for k in range(9)]
    assert last == [3, 3, 3, 6, 6, 6, 9, 9, 9]
    late = sampler(data, jax.random.key(0), jnp.array(20))
    assert int(late.index.max()) == 9
    np.testing.assert_array_equal(numbers(late) % 10, late.index)  # only one place is left


def test_cached_keypoints_take_the_place_of_pictures(data):
    tracks = jnp.arange(40.0).reshape(4, 10, 1) * jnp.ones(2)[None, None, :]
    cached = eqx.tree_at(lambda d: d.cached, data, tracks, is_leaf=lambda x: x is None)
    clip = FrameGroups(8, 2, (6,), 10.0, cached=True)(cached, jax.random.key(0), jnp.array(0))
    assert clip.frames is None
    offset = clip.cached[:, :1, 0] - clip.index[:, :1]
    np.testing.assert_array_equal(clip.cached[..., 0] - offset, clip.index)


def test_an_epoch_visits_every_trajectory_once(data):
    sampler = WholeTrajectories(10)
    order = [int(numbers(sampler(data, jax.random.key(1), jnp.array(k)))[0, 0]) // 10 for k in range(8)]
    assert sorted(order[:4]) == sorted(order[4:]) == [0, 1, 2, 3]


def test_a_step_number_decides_its_clips(data):
    sampler = RandomFrames(32)
    samples = [numbers(sampler(data, jax.random.key(0), jnp.array(k))) for k in (5, 5, 6)]
    np.testing.assert_array_equal(samples[0], samples[1])
    assert (samples[0] != samples[2]).any()


def test_too_short_trajectories_are_named(data):
    with pytest.raises(KeycldError, match="10 frames but this recipe samples clips of 12"):
        FrameGroups(2, 3, (6, 12), 10.0).check(data)
    with pytest.raises(KeycldError, match="no room"):
        FrameGroups(2, 4, (6, 12), 10.0)


class Model(eqx.Module):
    """Two groups of parameters."""

    moving: jax.Array
    still: jax.Array


class Squares(AbstractLoss):
    def __call__(self, model, clips, *, key, step):
        loss = jnp.sum((model.moving - 3.0) ** 2) + jnp.sum(model.still**2)
        return loss, {"squares": loss}


MOVING = Group("moving", lambda m: m.moving, 0.1)
STILL = Group("still", lambda m: m.still, 0.1)


def stage(**changes):
    settings = {"name": "s", "steps": 20, "sampler": RandomFrames(2), "loss": Squares(), "groups": (MOVING,)}
    return Stage(**(settings | changes))


def test_a_group_that_matches_nothing_is_an_error():
    model = Model(jnp.zeros(2), jnp.ones(3))
    for where in (lambda m: m.no_such_field, lambda m: ()):
        with pytest.raises(KeycldError, match="stage 's': group 'lost' matches no parameter"):
            stage(groups=(MOVING, Group("lost", where, 0.1))).trainable(model)


def test_of_two_groups_the_later_one_counts_and_a_rate_of_zero_freezes():
    everything = Group("all", lambda m: m, 0.1)
    model = Model(jnp.zeros(2), jnp.ones(3))
    assert stage(groups=(everything, Group("frozen", lambda m: m.still, 0.0))).labels(model) == ["all", None]
    assert stage(groups=(MOVING, everything)).labels(model) == ["all", "all"]


def test_stages_that_differ_in_numbers_share_a_program_also_after_the_first_step(data):
    """A fresh model may hold weakly typed numbers; those that a step returns are not."""
    traced = []

    class Counted(AbstractLoss):
        weight: float

        def __call__(self, model, clips, *, key, step):
            traced.append(self.weight)
            loss = self.weight * jnp.sum((model.moving - 3.0) ** 2)
            return loss, {"squares": loss}

    for number, (weight, rate) in enumerate([(1.0, 0.1), (2.0, 0.3)]):
        model = Model(jnp.full(2, 0.0), jnp.full(3, 1.0))
        chosen = stage(name=str(number), loss=Counted(weight), groups=(Group("moving", part("moving"), rate),))
        progress, rest = initial_progress(chosen, model)
        run = make_step(chosen, number, number, 5)
        for _ in range(3):
            progress, terms = run((rest, data), progress)
        assert float(terms["loss"][-1]) < 18 * weight
    assert len(traced) == 1


class Ascending(AbstractStatefulLoss):
    """min over θ, max over λ of λ (θ₀² − 1): a multiplier that no gradient trains."""

    def initial(self):
        return {"multiplier": jnp.ones(())}

    def __call__(self, model, clips, *, key, step, memory):
        excess = model.moving[0] ** 2 - 1.0
        loss = memory["multiplier"] * excess
        return loss, {"excess": excess}, {"multiplier": memory["multiplier"] + 0.5 * jax.lax.stop_gradient(excess)}


def test_a_losses_own_state_changes_with_the_steps_and_takes_no_gradient(data):
    model = Model(jnp.array([3.0, 0.0]), jnp.ones(3))
    geco = stage(loss=Ascending(), optimiser=optax.sgd)
    progress, rest = initial_progress(geco, model)
    run = make_step(geco, 0, 0, 1)
    theta, multiplier = 3.0, 1.0
    for _ in range(4):
        progress, terms = run((rest, data), progress)
        assert float(terms["excess"][0]) == pytest.approx(theta**2 - 1, rel=1e-5)
        theta, multiplier = theta - 0.1 * multiplier * 2 * theta, multiplier + 0.5 * (theta**2 - 1)
        assert float(progress.memory["multiplier"]) == pytest.approx(multiplier, rel=1e-5)
        assert float(progress.parameters.moving[0]) == pytest.approx(theta, rel=1e-5, abs=1e-5)


def test_only_named_groups_move(data):
    model = Model(jnp.zeros(2), jnp.ones(3))
    progress, rest = initial_progress(stage(), model)
    run = make_step(stage(), 0, 0, 20)
    progress, terms = run((rest, data), progress)
    trained = eqx.combine(progress.parameters, rest)
    assert float(jnp.abs(trained.moving).min()) > 1.0
    np.testing.assert_array_equal(trained.still, 1.0)
    assert terms["loss"].shape == (20,) and int(progress.step) == 20


def test_several_steps_a_dispatch_are_the_same_steps(data):
    model = Model(jnp.zeros(2), jnp.ones(3))
    ends = []
    for chunk in (1, 5):
        progress, rest = initial_progress(stage(), model)
        run = make_step(stage(), 0, 0, chunk)
        for _ in range(20 // chunk):
            progress, _ = run((rest, data), progress)
        ends.append(progress.parameters.moving)
    np.testing.assert_allclose(ends[0], ends[1], rtol=1e-6)


class Scaled(AbstractLoss):
    weight: float = 1.0

    def __call__(self, model, clips, *, key, step):
        loss = self.weight * jnp.sum((model.moving - 3.0) ** 2)
        return loss, {"scaled": loss}


def test_stages_that_differ_in_numbers_share_a_program(data):
    """Steps, rates and weights are arguments: nothing new is compiled, and they act."""
    model = Model(jnp.zeros(2), jnp.ones(3))
    events, ends = [], []
    jax.monitoring.register_event_listener(lambda name, **_: events.append(name))
    for weight, rate, steps in ((1.0, 0.1, 20), (2.0, 0.3, 30)):
        group = Group("moving", lambda m: m.moving, rate, optax.sgd)
        this = stage(steps=steps, loss=Scaled(weight), groups=(group,), schedule=warmup_cosine)
        progress, rest = initial_progress(this, model)
        events.clear()
        progress, _ = make_step(this, 0, 0, 4)((rest, data), progress)
        ends.append((this, np.asarray(progress.parameters.moving)))
    assert "/jax/compilation_cache/cache_hits" in events and "/jax/compilation_cache/cache_misses" not in events
    for this, end in ends:
        theta, schedule = 0.0, this.schedule(this.groups[0].rate, this.steps)
        for step in range(4):
            theta -= float(schedule(step)) * this.loss.weight * 2 * (theta - 3)
        np.testing.assert_allclose(end, theta, rtol=1e-4)


def test_forgetful_adam_is_sign_descent(data):
    """The released code's fault: every step has the size of the rate, whatever the gradient's."""
    model = Model(jnp.array([0.0, -500.0]), jnp.ones(3))
    faulty = stage(optimiser=forgetful(optax.adam))
    progress, rest = initial_progress(faulty, model)
    run = make_step(faulty, 0, 0, 10)
    progress, _ = run((rest, data), progress)
    np.testing.assert_allclose(progress.parameters.moving - model.moving, 1.0, rtol=1e-4)


def test_something_not_finite_is_named_and_not_trained_on(data):
    class Breaks(AbstractLoss):
        def __call__(self, model, clips, *, key, step):
            loss = jnp.sum(model.moving**2) + jnp.sum(jnp.sqrt(model.still - 1.0))
            return loss, {"fine": jnp.sum(model.moving**2), "root": loss}

    model = Model(jnp.full(2, 3.0), jnp.ones(3))  # the root's slope at zero is infinite
    broken = stage(loss=Breaks(), groups=(MOVING, STILL))
    progress, rest = initial_progress(broken, model)
    run = make_step(broken, 0, 0, 5)
    progress, _ = run((rest, data), progress)
    assert not bool(progress.healthy)
    np.testing.assert_array_equal(progress.parameters.moving, 3.0)
    error = diagnose(broken, 0, 0, progress, rest, data)
    assert error == "not a finite number at step 0: gradient of still."


def test_a_gradient_whose_norm_overflows_is_named(data):
    class Steep(AbstractLoss):
        def __call__(self, model, clips, *, key, step):
            return 1e25 * jnp.sum(model.moving), {}

    steep = stage(loss=Steep())
    progress, rest = initial_progress(steep, Model(jnp.full(2, 3.0), jnp.ones(3)))
    progress, _ = make_step(steep, 0, 0, 1)((rest, data), progress)
    assert not bool(progress.healthy)
    assert diagnose(steep, 0, 0, progress, rest, data).endswith("squares of the gradient, which overflow.")


class Smooth(AbstractLoss):
    """Stumbles where it is finite."""

    def __call__(self, model, clips, *, key, step):
        return jnp.sum(model.moving**2) + jnp.sum(jnp.sqrt(jnp.abs(model.moving))), {}


class Stumbles(AbstractLoss):
    """A loss whose gradient is not finite at steps 2 to 4, and whose value is not at step 7."""

    def __call__(self, model, clips, *, key, step):
        hurdle = jnp.where((step >= 2) & (step < 5), 0.0, 1.0)
        loss = jnp.sum(model.moving**2) + jnp.sum(jnp.sqrt(hurdle * jnp.abs(model.moving)))
        return loss + jnp.where(step == 7, jnp.inf, 0.0), {"moving": model.moving[0]}


def test_steps_that_are_not_finite_are_skipped_where_a_stage_allows_it(data):
    """They change nothing: the parameters, and the moments of Adam, are those of the other steps alone."""
    model = Model(jnp.full(2, 3.0), jnp.ones(3))
    lenient, strict = stage(loss=Stumbles(), skips=3), stage(loss=Stumbles())
    progress, rest = initial_progress(lenient, model)
    progress, terms = make_step(lenient, 0, 0, 10)((rest, data), progress)
    assert bool(progress.healthy) and int(progress.step) == 10
    assert lenient.skipped(progress.optimiser) == 4
    moved = np.diff(np.asarray(terms["moving"]))
    np.testing.assert_array_equal(moved[[2, 3, 4, 7]], 0.0)
    assert np.all(moved[[0, 1, 5, 6, 8]] < 0)

    expected, rest = initial_progress(strict, model)
    whole = make_step(stage(loss=Smooth()), 0, 0, 6)
    expected, _ = whole((rest, data), expected)
    np.testing.assert_allclose(progress.parameters.moving, expected.parameters.moving, rtol=1e-6)


def test_one_step_more_than_may_be_skipped_ends_the_stage(data):
    model = Model(jnp.full(2, 3.0), jnp.ones(3))
    lenient = stage(loss=Stumbles(), skips=2)
    progress, rest = initial_progress(lenient, model)
    progress, _ = make_step(lenient, 0, 0, 10)((rest, data), progress)
    assert not bool(progress.healthy) and int(progress.step) == 4
    assert "at step 4:" in diagnose(lenient, 0, 0, progress, rest, data)


def test_the_broken_loss_term_is_named(data):
    class Breaks(AbstractLoss):
        def __call__(self, model, clips, *, key, step):
            bad = jnp.log(model.moving[0])
            return bad, {"logarithm": bad, "fine": jnp.array(0.0)}

    broken = stage(loss=Breaks())
    progress, rest = initial_progress(broken, Model(jnp.zeros(2), jnp.ones(3)))
    assert "loss term logarithm" in diagnose(broken, 0, 0, progress, rest, data)


def test_terms_are_means_over_steps_however_many_a_dispatch_took():
    assert _mean([np.ones(25), np.full(15, 3.0)], skipping=False) == pytest.approx(1.75)
    skipped = [np.array([np.nan, np.nan, 101.0]), np.array([0.0, 1.0, 0.0])]
    assert _mean(skipped, skipping=True) == pytest.approx(25.5)
    assert np.isnan(_mean([np.full(2, np.nan)], skipping=True)) and np.isnan(_mean(skipped, skipping=False))


def test_schedule_rises_then_falls():
    schedule = warmup_cosine(1.0, 100, warmup=0.1, final=0.02)
    rates = [float(schedule(k)) for k in (0, 10, 55, 100)]
    assert rates[0] == 0 and rates[1] == pytest.approx(1) and 0.4 < rates[2] < 0.6
    assert rates[3] == pytest.approx(0.02)


class Grey(eqx.Module):
    """Renders a grey frame, as bright as its one keypoint is far right, on a black background."""

    background: jax.Array
    gain: float

    def __call__(self, keypoints, looks=None):
        return self.background + self.gain * keypoints[0, 0]


class SeesGrey(eqx.Module):
    """A model whose keypoint is as far right as the frame is bright."""

    estimator: object = eqx.field(static=True)
    renderer: Grey

    def observe_clips(self, frames):
        right = jnp.mean(frames.reshape(-1, 8 * 8 * 3), axis=1)
        return Observation(jnp.stack([right, 0 * right], axis=-1)[:, None], None)


@pytest.mark.parametrize(("gain", "share"), [(0.7, 0.09), (0.48, 0.27)])
def test_a_vision_stage_that_left_a_fifth_of_the_mean_pictures_error_has_failed(data, gain, share, capsys):
    """Frames of one brightness g, rendered as gain · g, are wrong by (1 − gain)² of the mean frame's error."""
    grey = dataclasses.replace(data, image=jnp.full(data.image.shape, 200, jnp.uint8))
    seeing = SimpleNamespace(standardise=SimpleNamespace(deviation=np.float32(200 / 255)))
    judged = judge_vision(SeesGrey(seeing, Grey(jnp.zeros((8, 8, 3)), gain)), grey, worst=0.2)
    assert (judged is None) == (share < 0.2)
    assert f"is {share:.2f} of the mean picture's error" in capsys.readouterr().out
    assert judged is None or f"is {share:.2f} of the mean picture's error" in judged


@pytest.mark.slow
@pytest.mark.parametrize("gain", [1.0, 0.0])
def test_keypoints_that_left_their_parts_fail_in_the_final_judgement(data, gain):
    whole = np.sqrt(np.mean((np.asarray(data.image) / 255.0) ** 2))

    class Seeing:
        standardise = SimpleNamespace(deviation=whole)

    model = SeesGrey(Seeing(), Grey(jnp.zeros((8, 8, 3)), gain))
    judged = judge_trained(model, data, reconstruction=0.2, law=0.25)
    assert (judged is None) == (gain == 1.0)
    assert judged is None or "is 1.00 of the mean picture's error" in judged
