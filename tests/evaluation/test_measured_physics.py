"""Constants of a mechanism with error bars, from its tracks to `physics.json`."""

import json
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld._errors import KeycldError
from keycld.evaluation import (
    Evaluation,
    load_physics,
    measure_physics,
    physics,
    physics_table,
    pieces_note,
    restless,
    save_physics,
    with_fan,
)
from keycld.mechanics import (
    RK4,
    ConstrainedLagrangian,
    Constraints,
    DistanceToPoint,
    Estimate,
    MechanicalDynamics,
    Motion,
    PointMasses,
    Rattle,
    Scale,
    State,
    SumDissipation,
    SumPotential,
    ViscousFriction,
)
from keycld.models.keycld.selection import Tried
from keycld.models.keycld.tracks import Tracks

DT, FRAMES, NOISE, LENGTH = 1 / 30, 90, 0.003, 0.6


def pendulum(gravity, friction, integrator):
    constraints = Constraints(("ball",), (DistanceToPoint("ball", "unknown"),))
    viscous = SumDissipation({"viscous": ViscousFriction(jnp.array([[friction]]))})
    law = ConstrainedLagrangian(
        PointMasses.ones(1), SumPotential(jnp.array([0.0, gravity]), {}), None, constraints, viscous
    )
    return MechanicalDynamics(law, integrator)


@pytest.fixture(scope="module")
def measured():
    """Three recordings of a pendulum around the image centre, after a rough fit."""
    angles = np.array([[0.8], [1.3], [-1.0]])
    first = jnp.asarray(LENGTH * np.concatenate([np.sin(angles), -np.cos(angles)], axis=1), jnp.float32)
    true = pendulum(9.0, 0.2, RK4(8))
    roll = jax.vmap(lambda x: true.rollout(State(Motion(x, jnp.zeros(2)), {}), jnp.zeros(0), DT, FRAMES - 1).x)
    tracks = np.asarray(roll(first))
    tracks = tracks + NOISE * np.random.default_rng(0).standard_normal(tracks.shape)
    guess = pendulum(8.5, 0.25, Rattle(2))
    worth = {"drag": 0.01, "viscous": 5.0}
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(physics, "evidence", lambda *_, pixel, tried: worth)
        return measure_physics(
            guess,
            tracks,
            np.zeros((3, 0)),
            DT,
            mechanism="pendulum",
            scale=Scale(("pivot", "ball"), 0.3),
            tried=Tried(),
        )


def test_constants_are_true_within_their_error_bars(measured):
    constants = measured.physics["constants"]
    truth = {
        "pivot_x": 0.0,
        "pivot_y": 0.0,
        "length_pivot_ball": LENGTH,
        "period_1": 2 * np.pi / np.sqrt(9.0 / LENGTH),
        "viscous_rate": 0.2,
        "gravity_direction": -90.0,
        "gravity_m": 4.5,
        "length_pivot_ball_m": 0.3,
        "metres_per_unit": 0.5,
    }
    for name, value in truth.items():
        found = constants[name]
        assert found["identifiable"], name
        assert abs(found["value"] - value) <= 3.5 * (found["sigma"] or 0.0) + 1e-9, name
    assert constants["period_1"]["sigma"] < 0.01 * truth["period_1"]
    # A length that is given as exact has no error in metres.
    assert [name for name in truth if constants[name]["sigma"] is None] == ["length_pivot_ball_m"]


def test_friction_without_a_rest_pose_is_not_zero(measured, monkeypatch):
    monkeypatch.setattr(physics, "rest_pose", lambda *_: None)
    found = physics.constants_of(measured.estimate)["viscous_rate"]
    assert found["value"] is None and "no stable rest pose" in found["note"]


def test_a_keypoint_may_be_called_m():
    among = ("length_pivot_m", "length_pivot_m_m")
    assert [physics._unit(name, among) for name in among] == ["units", "m"]


def test_what_one_video_cannot_tell_is_no_number(measured):
    mass = measured.physics["constants"]["mass"]
    assert mass["value"] is None and mass["sigma"] is None and not mass["identifiable"]


def test_a_rejected_force_is_stored_with_its_evidence(measured):
    assert measured.physics["rejected"] == {"drag": {"worth": 0.01, "needed": 0.2}}
    assert measured.physics["fps"] == pytest.approx(30)


def test_the_result_says_what_was_fitted(measured):
    assert measured.physics["measured_on"] == {"pieces": 3, "frames": FRAMES, "whole": True}
    assert pieces_note(measured.physics) == ""
    in_pieces = measured.physics | {"measured_on": {"pieces": 6, "frames": 45, "whole": False}}
    assert "measured on 6 pieces of 45 frames: no motion" in pieces_note(in_pieces)
    assert pieces_note(in_pieces) in physics_table(in_pieces)


def test_physics_come_back_from_the_run_folder(measured, tmp_path):
    path = save_physics(tmp_path, measured.physics)
    assert path == tmp_path / "evaluation" / "physics.json"
    assert load_physics(tmp_path) == measured.physics


def test_missing_or_damaged_physics_say_so(measured, tmp_path):
    with pytest.raises(KeycldError, match="no physical constants"):
        load_physics(tmp_path)
    path = save_physics(tmp_path, measured.physics)
    stored = json.loads(path.read_text())
    stored["constants"]["period_1"]["value"] = "long"
    path.write_text(json.dumps(stored))
    with pytest.raises(KeycldError, match=r"constants.period_1.value"):
        load_physics(tmp_path)


def motion(seed):
    """A recording of the same pendulum that nothing was fitted to, and what a model with a rough law predicts of it."""
    angle = np.random.default_rng(seed).uniform(-1.2, 1.2)
    first = jnp.asarray([LENGTH * np.sin(angle), -LENGTH * np.cos(angle)], jnp.float32)
    found = []
    for law in (pendulum(9.0, 0.2, RK4(8)), pendulum(8.9, 0.2, RK4(8))):
        start = State(Motion(first, jnp.array([0.3 * np.cos(angle), 0.3 * np.sin(angle)])), {})
        found.append(np.asarray(law.rollout(start, jnp.zeros(0), DT, FRAMES - 1).x).reshape(-1, 1, 2))
    observed = found[0] + NOISE * np.random.default_rng(seed).standard_normal(found[0].shape)
    return Evaluation(
        {"given": 10, "dt": DT, "pixel": 0.03, "keypoints": ["ball"]}, {"observed": observed, "predicted": found[1]}
    )


@pytest.mark.slow
def test_a_new_motion_is_within_its_fan_as_often_as_it_says(measured):
    fans = [with_fan(motion(seed), measured.estimate, np.zeros(0)) for seed in range(12)]
    within = {share: np.mean([fan.scores["within"][share] for fan in fans]) for share in ("68", "95")}
    assert within == {"68": pytest.approx(0.68, abs=0.08), "95": pytest.approx(0.95, abs=0.04)}
    sigma = np.mean([fan.arrays["fan_sigma"] for fan in fans], axis=(0, 2, 3))
    assert np.all(sigma > 0.9 * NOISE) and sigma[10:].max() > sigma[5]
    assert fans[0].arrays["fan_off"].shape == (FRAMES, 1, 2)


def test_a_prediction_that_diverges_has_no_fan(measured, monkeypatch):
    def diverging(*arguments, **named):
        raise KeycldError("the prediction diverges, so that it has no error bars: predict fewer frames.")

    monkeypatch.setattr("keycld.evaluation.physics.predict_fan", diverging)
    found = with_fan(motion(0), measured.estimate, np.zeros(0))
    assert "within" not in found.scores and found.arrays.keys() == motion(0).arrays.keys()
    assert found.scores["noise"] == {"ball": pytest.approx(NOISE / 0.03, rel=0.15)}


def test_keypoints_far_from_the_fitted_motion_are_named():
    assert restless({"cart": 0.1, "tip": 0.45}) == ""
    assert "'tip' 0.84 pixels" in restless({"cart": 0.1, "tip": 0.84})


@pytest.mark.parametrize("misfit", [None, 0.5])
def test_halves_are_measured_where_the_motions_of_the_whole_diverge_or_miss_it(monkeypatch, misfit):
    """If no halves are followed either, the reason is said."""
    asked = []

    def estimate(dynamics, free, x, u, dt, *, initial):
        asked.append(x.shape)
        if x.shape[1] > follows and misfit is None:
            raise KeycldError("the fitted motions diverge")
        return Estimate(*[None] * 11, misfit=misfit if x.shape[1] > follows else 0.01)

    monkeypatch.setattr(physics, "climb", lambda *_: SimpleNamespace(dynamics=None, initial=None))
    monkeypatch.setattr(physics, "free_leaves", lambda *_: None)
    monkeypatch.setattr(physics, "estimate", estimate)
    angle = 0.3 * np.arange(128)
    x = jnp.asarray(np.stack([np.sin(angle), -np.cos(angle)], axis=-1), jnp.float32)[None]
    law, tracks = pendulum(9.0, 0.2, Rattle(2)), Tracks(x, jnp.zeros((1, 0)), jnp.float32(DT), None)
    follows = 64
    assert physics._estimated(law, tracks).misfit == 0.01 and asked == [(1, 128, 2), (2, 64, 2)]
    follows = 0
    if misfit is None:
        with pytest.raises(KeycldError, match="diverge"):
            physics._estimated(law, tracks)
    else:
        assert physics._estimated(law, tracks).misfit == misfit
