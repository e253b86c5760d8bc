"""A law is judged by how far its motions are from keypoints, in units of the keypoints' own errors."""

from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld.data import resident
from keycld.mechanics import Constraints, DistanceToPoint, OnLine
from keycld.models import Scene, config_for
from keycld.models.keycld import judge
from keycld.models.keycld.judge import judge_dynamics, observation_error
from scenes import DT, SIZE, disc_pendulum

FRAMES, PIXEL = 40, 2 / SIZE
TIME = DT * np.arange(FRAMES)


def observed(x, y, noise):
    """Tracks of one keypoint `[N, T, 2]` with independent errors."""
    return np.stack([x, y], axis=-1) + noise * np.random.default_rng(0).standard_normal((*x.shape, 2))


def cart(stiffness):
    """A model of a cart on a rail with x'' = −stiffness x."""
    config = config_for("keycld", "fast", width=8, terms=("springs",), constraints=Constraints(("c",), (OnLine("c"),)))
    model = config.build(Scene(SIZE, SIZE, 0, FRAMES, DT, 6), jax.random.key(0))
    nothing = jax.tree.map(lambda leaf: 0 * leaf if eqx.is_inexact_array(leaf) else leaf, model.law.potential)
    spring = stiffness * model.law.masses[:, None]
    potential = eqx.tree_at(lambda v: v.terms["springs"].stiffness, nothing, spring)
    moving = eqx.tree_at(lambda m: m.dynamics.law.potential, model, potential)
    return eqx.tree_at(lambda m: m.initial_state.constants, moving, jnp.zeros(1))


@pytest.fixture(scope="module")
def recordings():
    return resident(disc_pendulum(2, FRAMES, seed=0))


@pytest.fixture
def judged(monkeypatch, recordings):
    """A function (law's k/m, tracks) → what has failed."""

    def judge_tracks(stiffness, x):
        seen = jnp.asarray(x, jnp.float32), jnp.zeros((len(x), 0))
        monkeypatch.setattr(judge, "observed_keypoints", lambda *_, **__: seen)
        return judge_dynamics(cart(stiffness), recordings, worst=0.1)

    return judge_tracks


def swings(size, noise):
    """Recordings with x'' = −16 x, up to `size` pixels wide."""
    phase = np.arange(6)[:, None]
    x = PIXEL * size * (phase + 1) / 6 * np.sin(4 * TIME + phase)
    return observed(x, 0 * x, PIXEL * noise)


def test_a_right_law_passes_and_a_wrong_one_within_half_a_pixel_does_not(judged):
    small = swings(0.5, 0.003)
    assert judged(16.0, small) is None
    assert "no law was found that explains how keypoint 1 moves" in judged(0.0, small)
    assert "no law was found" in judged(8.0, small)


def test_a_right_law_passes_however_much_the_keypoints_err_and_however_little_they_move(judged):
    assert judged(16.0, swings(5.0, 0.4)) is None
    assert judged(16.0, swings(0.2, 0.3)) is None
    time = observed(0.1 * np.arange(6)[:, None] * TIME, np.zeros((6, FRAMES)), 0.2 * PIXEL)
    assert judged(0.0, time) is None


@pytest.mark.parametrize(("lost", "passes"), [(2, True), (6, False)])
def test_a_twentieth_of_the_recordings_may_be_lost(judged, lost, passes):
    many = np.tile(swings(5.0, 0.02), (7, 1, 1))
    many[:lost, FRAMES // 2 :, 0] += 0.5
    assert (judged(16.0, many) is None) == passes


def test_a_law_that_misses_the_motion_does_not_pass_because_keypoints_leave_their_parts(judged):
    """Keypoints 1.5 pixels (rms) away from their rail, where 5 of their errors are more than the motion."""
    away = np.stack([np.zeros((6, FRAMES)), 2 * PIXEL * np.sin(3 * TIME + np.arange(6)[:, None])], axis=-1)
    assert judged(16.0, swings(20.0, 0.02) + away) is None
    assert "no law was found" in judged(0.0, swings(20.0, 0.02) + away)


@pytest.mark.slow
def test_a_single_recording_with_a_push_in_the_middle_is_judged_in_halves(judged, capsys):
    """No initial state of the right law explains the whole, in which it stops and begins again elsewhere."""
    time = DT * np.arange(2 * FRAMES)
    x = np.where(time < DT * FRAMES, 0.3 * np.sin(4 * time), 0.6 * np.cos(4 * time))[None]
    assert judged(16.0, observed(x, 0 * x, 0.02 * PIXEL)) is None
    assert f"over {FRAMES} frames" in capsys.readouterr().out
    assert "no law was found" in judged(8.0, observed(x, 0 * x, 0.02 * PIXEL))


@pytest.mark.slow
def test_a_slow_motion_is_judged_on_longer_stretches(monkeypatch, recordings):
    """x'' = −x with errors of keypoints that last: 2 s are nearly a parabola, 6 s are not."""

    def observe(model, data, count, first):
        frames = FRAMES if count == judge.FITTED else 3 * FRAMES
        time, phase = DT * np.arange(frames), np.arange(6)[:, None]
        x = 0.6 * np.sin(time + phase) + 0.15 * PIXEL * np.sin(1.7 * time + 2 * phase)
        return jnp.asarray(observed(x, 0 * x, 0.0), jnp.float32), jnp.zeros((6, 0))

    monkeypatch.setattr(judge, "observed_keypoints", observe)
    assert judge_dynamics(cart(1.0), recordings, worst=0.1) is None
    assert "no law was found" in judge_dynamics(cart(0.5), recordings, worst=0.1)


@pytest.mark.parametrize(
    ("radius", "noise", "worst", "failure"),
    [
        (0.5, 0.01, 0.1, "keypoint 1 is within a pixel"),
        (0.5, 0.01, 1e9, None),
        (2, 0.01, 0.1, None),
        (2, 0.16, 0.1, None),
        (2, 0.3, 0.1, "constraint 1 does not hold: a distance that it keeps constant varies by"),
        (2, 0.3, 1e9, None),
    ],
)
def test_a_keypoint_on_its_pivot_or_at_no_constant_distance_from_it_fails(
    monkeypatch, recordings, radius, noise, worst, failure
):
    """It hardly moves, so any law is near. A training of a few steps may pass all."""
    angle, length = 0.5 * TIME + np.arange(6)[:, None], radius * PIXEL
    x = jnp.asarray(observed(length * np.sin(angle), -length * np.cos(angle), noise * PIXEL), jnp.float32)
    monkeypatch.setattr(judge, "observed_keypoints", lambda *_, **__: (x, jnp.zeros((6, 0))))
    rod = Constraints(("bob",), (DistanceToPoint("bob"),))
    model = eqx.tree_at(lambda m: m.dynamics.law.constraint_function, cart(0.0), rod)
    model = eqx.tree_at(lambda m: m.initial_state.constants, model, jnp.full(1, length**2))
    failed = judge_dynamics(model, recordings, worst=worst)
    assert failed is failure or failure in failed


@pytest.mark.parametrize(("size", "other", "failure"), [(0.3, 9.0, "keypoint 2 moves by 0.30"), (0.3, 0.5, None)])
def test_a_keypoint_that_stands_still_while_another_moves_fails(size, other, failure):
    """A clock in the picture is not a part; a mechanism that hardly moves as a whole may be one."""
    clock = size * np.stack([np.cos(3 * TIME), np.sin(3 * TIME)], axis=-1)
    part = other * np.stack([np.sin(4 * TIME), 0 * TIME], axis=-1)
    found = judge._still(jnp.asarray(PIXEL * np.concatenate([part, clock], axis=-1)[None]), PIXEL)
    assert found is failure or failure in found


def test_errors_of_keypoints_are_recognised_without_a_law():
    """Independent ones by their scatter, lasting ones along a pendulum's rod by its length; each to a tenth."""
    law = cart(1.0).law
    x = swings(5.0, 0.4)
    assert observation_error(law, x) == pytest.approx(0.4 * PIXEL, rel=0.1)
    phi = Constraints(("bob",), (DistanceToPoint("bob", (0.0, 0.0)),))
    pendulum = eqx.tree_at(lambda law: law.constraint_function, law, phi)
    angle = np.sin(3 * TIME + np.arange(6)[:, None])
    radius = 0.6 + 0.02 * np.sqrt(2) * np.sin(2 * TIME + np.arange(6)[:, None])
    bent = observed(radius * np.sin(angle), -radius * np.cos(angle), 0.0)
    assert observation_error(pendulum, bent) == pytest.approx(0.02, rel=0.1)


@pytest.mark.parametrize("terms", [None, ("viscous",)])
def test_a_law_that_was_chosen_is_judged_by_the_fit_it_was_chosen_with(monkeypatch, recordings, terms):
    """That fit has been compiled. Where the forces were given there is none."""

    class SeenError(Exception):
        pass

    def explain(dynamics, tracks):
        raise SeenError(set(tracks.among))

    monkeypatch.setattr(judge, "explain", explain)
    rod = Constraints(("bob",), (DistanceToPoint("bob"),))
    config = config_for("keycld", "clip", width=8, terms=terms, constraints=rod)
    stages = {stage.name: stage for stage in config.stages(Scene(SIZE, SIZE, 0, FRAMES, DT, 2))}
    x = swings(4, 0.0)
    monkeypatch.setattr(judge, "observed_keypoints", lambda *_, **__: (jnp.asarray(x), jnp.zeros((6, 0))))
    monkeypatch.setattr(judge, "judge_vision", lambda *_, **__: None)
    for name in ("dynamics", "prior"):
        with pytest.raises(SeenError) as seen:
            stages[name].judge(cart(1.0), recordings)
        assert seen.value.args[0] == (set(config.tried.kinds) if terms is None else set()), name


@pytest.mark.parametrize("name", ["keycld-nc", "fc"])
def test_the_law_of_an_ablation_is_scored_and_not_judged(name, recordings, monkeypatch):
    """Without its constraint no law explains a pendulum: how much worse it is, is what a table wants to know."""
    scene = Scene(SIZE, SIZE, 0, FRAMES, DT, 6)
    constraints = Constraints(("b",), (DistanceToPoint("b", (0.0, 0.0)),))
    config = config_for(name, "fast", width=8, constraints=constraints)
    model = config.build(scene, jax.random.key(0))
    monkeypatch.setattr(judge, "observed_keypoints", lambda *_, **__: pytest.fail("judged"))
    monkeypatch.setattr(judge, "squared_error", lambda *_: jnp.array(1e6))
    stages = {stage.name: stage for stage in config.stages(scene)}
    assert all(stages[name].judge(model, recordings) is None for name in ("dynamics", "prior"))
    assert "have not found" in stages["vision"].judge(model, recordings)


def test_a_keypoint_beside_the_part_that_stands_out_does_not_pass(recordings, monkeypatch):
    """Half-way from the pivot to the disc; on the disc, with another keypoint half-way, it does."""
    monkeypatch.setattr(judge, "judge_vision", lambda *_, **__: None)
    background = jnp.median(recordings.image.reshape(-1, SIZE, SIZE, 3) / 255.0, axis=0)
    y, x = jnp.meshgrid(jnp.linspace(1, -1, SIZE), jnp.linspace(-1, 1, SIZE), indexing="ij")

    def model(*shares):
        def observe(frame):
            bright = jnp.sum((frame - background) ** 2, axis=-1) ** 2
            disc = jnp.array([jnp.sum(bright * x), jnp.sum(bright * y)]) / jnp.sum(bright)
            return SimpleNamespace(keypoints=jnp.outer(jnp.array(shares), disc))

        standardise = SimpleNamespace(mean=background)
        return SimpleNamespace(observe=observe, estimator=SimpleNamespace(standardise=standardise))

    assert "no keypoint is on the part that stands out" in judge.judge_clip(model(0.4), recordings, worst=0.2)
    assert judge.judge_clip(model(1.0), recordings, worst=0.2) is None
    assert judge.judge_clip(model(0.4, 1.0), recordings, worst=0.2) is None
