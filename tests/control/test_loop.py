"""The closed loop from pixels in MuJoCo, with a model that sees and knows without training."""

import dataclasses
import json

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from true_physics import truth
from watching import Watcher, picture

from keycld import KeycldError
from keycld.cli.main import main
from keycld.control import (
    Assignment,
    Disturbance,
    EnergyShaping,
    Pilot,
    PredictCorrect,
    advance,
    goal_of,
    known_inputs,
    lagrangian_of,
    loop,
    nearest_pose,
    swing_up,
)
from keycld.evaluation import save_evaluation
from keycld.reports import write_report
from keycld.systems import get
from swing import Still

EPSILON = 0.01


@pytest.fixture(scope="module")
def model():
    return Watcher.pendulum()


@pytest.fixture(scope="module")
def pilot(model):
    goal = jnp.array([0.0, 0.49])
    return Pilot(model, PredictCorrect(model.law, model.dynamics, 0.02), EnergyShaping(model.law, goal, (0,)), np.inf)


@pytest.fixture(scope="module")
def result(model):
    return swing_up(model, get("pendulum"), EPSILON, None, Assignment(starts=2, seconds=6.0), workers=2)


def test_the_pendulum_stands_up_from_pixels(result):
    scores, arrays = result.scores, result.arrays
    assert scores["successes"] == scores["n"] == 2
    assert arrays["state"].shape == (2, 301, 2) and arrays["input"].shape == (2, 300, 1)
    assert arrays["frames"].shape == (301, 64, 64, 3) and arrays["frames"].dtype == np.uint8
    assert max(scores["worst_tilt_last_second_degrees"]) < 10 and max(scores["settled_seconds"]) < 5
    assert 2 < scores["largest_input"][0] < 6


def test_passivity_and_timing_are_reported(result):
    scores = result.scores
    assert scores["passivity"]["left_at_the_end_median"] < 0.05
    assert np.isfinite(scores["passivity"]["largest_rise_median"])
    assert scores["step"]["frames"] == 300 and 0 < scores["step"]["median_ms"] <= scores["step"]["p99_ms"]
    assert scores["mean_mass"] == pytest.approx(1.0, rel=0.01)


def test_passivity_is_that_of_the_true_motion(result):
    """The score knows keypoints, not states, yet gives the rises of T + V_d that the true law gives for MuJoCo's.

    They are small: where one frame is seen wrongly, by what the controller makes of it.
    """
    known, flown = truth("pendulum"), result.arrays
    controller = EnergyShaping(known.law, jnp.asarray(flown["goal"]), (0,))

    @jax.jit
    @jax.vmap
    @jax.vmap
    def total(state, u):
        energies = controller.energies(*known.motion(state).coordinates, u)
        return energies.kinetic + energies.desired

    expected = np.asarray(total(jnp.asarray(flown["state"][:, :-1], float), jnp.asarray(flown["input"])))
    np.testing.assert_allclose(flown["kinetic"] + flown["desired"], expected, atol=0.01 * expected.max())
    rise = np.max(expected - np.minimum.accumulate(expected, axis=1), axis=1)
    passivity = result.scores["passivity"]
    assert passivity["largest_rise_worst"] == pytest.approx(np.max(rise / expected.max(axis=1)), abs=0.01)
    assert passivity["largest_rise_median"] == pytest.approx(np.median(rise / expected.max(axis=1)), abs=0.01)
    # From hanging down the bowl is this deep.
    assert rise.max() < 0.01 * float(controller.desired_energy(-known.upright))
    assert 0 < passivity["keypoint_error"] < 0.01


def test_a_late_input_holds_the_last_one(pilot, monkeypatch):
    """A clock of our own makes three steps of the first copy late; the second is never timed."""
    late, dt, told = [2, 3, 7], 0.02, []

    class Clock:
        now, readings = 0.0, 0

        @classmethod
        def perf_counter(cls):
            step, ends = divmod(cls.readings, 2)
            cls.readings += 1
            cls.now += ends * (1.5 * dt if step in late else 0.5 * dt)
            return cls.now

    def fakes(pilot):
        chosen = iter(np.arange(-1.0, 10.0))  # the first call is for compiling only

        def alone(aboard, frame, arrived, held):
            told.append(float(held[0]))
            return aboard, jnp.array([next(chosen)])

        return alone, lambda aboard, frames, arrived, held: (aboard, held + 1.0)

    monkeypatch.setattr(loop, "time", Clock)
    monkeypatch.setattr(loop, "_compiled", fakes)
    flight = loop.fly(pilot, get("pendulum"), np.zeros((2, 2)), 10 * dt, workers=1)
    np.testing.assert_array_equal(np.flatnonzero(flight.missed), late)
    np.testing.assert_allclose(flight.step_seconds, np.where(flight.missed, 1.5 * dt, 0.5 * dt))
    np.testing.assert_array_equal(flight.input[0, :, 0], [0, 1, 1, 1, 4, 5, 6, 6, 8, 9])
    np.testing.assert_array_equal(flight.input[1, :, 0], np.arange(1, 11))
    # The pilot learns which input really acted, and MuJoCo got that one.
    np.testing.assert_array_equal(told[1:], [0, 0, 1, 1, 1, 4, 5, 6, 6, 8])
    state = np.zeros((1, 2))
    for u in flight.input[0]:
        state = advance(get("pendulum"), state, u[None])
    np.testing.assert_allclose(flight.state[0, -1], state[0])


def test_bad_pictures_degrade_and_do_not_break(model):
    disturbance = Disturbance(noise=0.1, dropped=0.2)
    told = Assignment(starts=2, seconds=1.0, disturbance=disturbance)
    found = swing_up(model, get("pendulum"), EPSILON, None, told, workers=1)
    assert 5 < found.scores["frames_not_arrived"] < 40
    assert np.isfinite(found.arrays["input"]).all()
    with pytest.raises(KeycldError, match="parts of 1"):
        Disturbance(noise=-0.1)


def test_a_frame_with_nan_counts_as_not_arrived(pilot):
    step = eqx.filter_jit(pilot)
    aboard, _ = step(pilot.begin(), picture(1.0), jnp.array(True), jnp.zeros(1))
    broken = np.full((64, 64, 3), np.nan, np.float32)
    after, u = step(aboard, broken, jnp.array(True), jnp.zeros(1))
    assert np.isfinite(u).all() and after.belief.sightings == 1
    dropped, same = step(aboard, picture(0.0), jnp.array(False), jnp.zeros(1))
    np.testing.assert_array_equal(u, same)
    # Before anything was seen there is no input.
    assert step(pilot.begin(), broken, jnp.array(True), jnp.zeros(1))[1] == 0


def test_goals_that_mean_nothing(model, pilot):
    np.testing.assert_allclose(goal_of(model, picture(), EPSILON), [0.0, 0.49], atol=0.01)
    noise = np.random.default_rng(0).integers(0, 255, (64, 64, 3), dtype=np.uint8)
    with pytest.raises(KeycldError, match="shows no pose that the model knows"):
        goal_of(model, noise, EPSILON)
    with pytest.raises(KeycldError, match="64 × 64"):
        goal_of(model, noise[:32], EPSILON)
    nearest_pose(model, jnp.array([0.49, 0.0]), jnp.array([0.49**2]))
    with pytest.raises(KeycldError, match="constraints keep the system from"):
        nearest_pose(model, jnp.array([0.2, 0.0]), jnp.array([0.49**2]))


def test_a_model_without_energies_is_refused():
    with pytest.raises(KeycldError, match="a potential energy and an input matrix, and Still has learned none"):
        lagrangian_of(Still())


def test_a_goal_picture_of_another_pose(model):
    """Leaning 30° needs a lasting torque; the goal is known from its picture alone."""
    found = swing_up(model, get("pendulum"), EPSILON, picture(0.52), Assignment(seconds=6.0), workers=1)
    assert found.scores["goal"] == "image" and found.scores["successes"] == 1
    assert found.arrays["state"][0, -1, 0] == pytest.approx(0.52, abs=0.1)


def test_assignments_that_make_no_sense():
    for wrong, words in (
        ({"law": "shapin"}, "did you mean 'shaping'"),
        ({"observer": "eyes"}, "unknown observer"),
        ({"kp": 0.0}, "kp and kd"),
        ({"starts": 0}, "one start"),
    ):
        with pytest.raises(KeycldError, match=words):
            Assignment(**wrong)


def test_inputs_that_never_moved_in_training_do_not_act():
    names = ("shoulder_torque", "elbow_torque")
    assert known_inputs(names, None, ()) is None and known_inputs(names, [True, True], ()) is None
    assert known_inputs(names, [False, True], ()) == ("elbow_torque",)
    assert known_inputs(names, [True, True], ("elbow_torque",)) == ("elbow_torque",)
    with pytest.raises(KeycldError, match="shoulder_torque never moved"):
        known_inputs(names, [False, True], ("shoulder_torque",))
    with pytest.raises(KeycldError, match="no input ever moved"):
        known_inputs(names, [False, False], ())


def test_the_command_writes_what_it_promises(model, tmp_path, monkeypatch, capsys):
    import keycld.training as training

    @dataclasses.dataclass
    class Config:
        system: str = "pendulum"
        dt: float = 0.02
        data: str = "nowhere"
        moved_inputs: None = None

    (tmp_path / "config.json").write_text(json.dumps({"system": "pendulum", "command": "keycld train pendulum"}))
    monkeypatch.setattr(training, "run_folder", lambda run: tmp_path)
    monkeypatch.setattr(training, "load_run", lambda folder: (model, Config()))
    monkeypatch.setattr("keycld.cli.control.threshold_of", lambda model, config: EPSILON)
    assert main(["control", str(tmp_path), "--seconds", "0.4", "--limit", "3", "--workers", "1"]) == 0
    assert "0 of 1 starts keep the goal" in capsys.readouterr().out
    name = "control-upright-shaping-limit3-seconds0.4"
    scores = json.loads((tmp_path / "evaluation" / f"{name}.json").read_text())
    assert scores["limit"] == 3 and scores["n"] == 1 and max(scores["largest_input"]) <= 3
    for file in (f"{name}.mp4", f"{name}.png", f"{name}-strip.png"):
        assert (tmp_path / "media" / file).stat().st_size > 1000
    assert main(["control", str(tmp_path), "--goal", str(tmp_path / "no.png")]) == 2
    assert "takes upright or a picture" in capsys.readouterr().err
    assert main(["control", str(tmp_path), "--actuators", "elbow"]) == 2
    assert "no input 'elbow': choose from torque" in capsys.readouterr().err


def test_the_report_has_a_section_on_control(result, tmp_path):
    (tmp_path / "config.json").write_text(json.dumps({"system": "pendulum", "command": "keycld train pendulum"}))
    save_evaluation(tmp_path, "control-upright-shaping", result)
    page = write_report(tmp_path).read_text()
    assert '<section id="control">' in page and "2 of 2" in page and "energy shaping" in page
    assert (tmp_path / "media" / "control-upright-shaping.mp4").exists()
