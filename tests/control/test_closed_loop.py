"""The closed loop from pixels in MuJoCo, with a model that needs no training."""

import dataclasses
import json
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pendulum_model import PendulumModel, picture
from true_physics import truth

from keycld import KeycldError
from keycld.cli.control import _name, summary_of
from keycld.cli.main import main
from keycld.control import (
    Agent,
    ControlConfig,
    Disturbance,
    EnergyShaping,
    PredictCorrect,
    advance,
    closed_loop,
    goal_of,
    nearest_pose,
    swing_up,
    upright,
)
from keycld.control.requirements import plant_inputs, require
from keycld.evaluation import save_evaluation
from keycld.mechanics import ConstrainedLagrangian, MechanicalDynamics, Rattle
from keycld.models.base import AbstractModel, HasKeypoints, HasLagrangian
from keycld.reports import write_report
from keycld.systems import get

EPSILON = 0.01


@pytest.fixture(scope="module")
def model():
    return PendulumModel.make()


@pytest.fixture(scope="module")
def agent(model):
    goal = jnp.array([0.0, 0.49])
    return Agent(model, PredictCorrect(model.law, model.dynamics, 0.02), EnergyShaping(model.law, goal, (0,)), np.inf)


@pytest.fixture(scope="module")
def result(model):
    return swing_up(model, get("pendulum"), EPSILON, None, ControlConfig(trials=2, seconds=6.0), workers=2)


def test_the_pendulum_stands_up_from_pixels(result):
    scores, arrays = result.scores, result.arrays
    assert scores["successes"] == scores["n"] == 2
    assert arrays["state"].shape == (2, 301, 2) and arrays["input"].shape == (2, 300, 1)
    assert arrays["frames"].shape == (301, 64, 64, 3) and arrays["frames"].dtype == np.uint8
    assert max(scores["worst_tilt_last_second_degrees"]) < 10 and max(scores["settled_seconds"]) < 5
    assert 2 < scores["largest_input"][0] < 6
    stands = upright(get("pendulum"), arrays["state"])
    assert scores["settled_seconds"] == pytest.approx([0.02 * (1 + np.flatnonzero(~each)[-1]) for each in stands])
    np.testing.assert_array_equal(arrays["good"], stands[:, :-1])


def test_passivity_and_timing_are_reported(result):
    scores = result.scores
    assert scores["passivity"]["left_at_the_end_median"] < 0.05
    assert np.isfinite(scores["passivity"]["largest_rise_median"])
    assert scores["step"]["frames"] == 300 and 0 < scores["step"]["median_ms"] <= scores["step"]["p99_ms"]
    assert scores["mean_mass"] == pytest.approx(1.0, rel=0.01)


def test_passivity_is_that_of_the_true_motion(result):
    """The score knows keypoints, not states, yet gives the rises of T + V_d that the true law gives for MuJoCo's.

    They are small: they come from frames whose keypoints are off.
    """
    known, arrays = truth("pendulum"), result.arrays
    controller = EnergyShaping(known.law, jnp.asarray(arrays["goal"]), (0,))

    @jax.jit
    @jax.vmap
    @jax.vmap
    def total(state, u):
        energies = controller.energies(*known.motion(state).coordinates, u)
        return energies.kinetic + energies.desired

    expected = np.asarray(total(jnp.asarray(arrays["state"][:, :-1], float), jnp.asarray(arrays["input"])))
    np.testing.assert_allclose(arrays["kinetic"] + arrays["desired"], expected, atol=0.01 * expected.max())
    rise = np.max(expected - np.minimum.accumulate(expected, axis=1), axis=1)
    passivity = result.scores["passivity"]
    assert passivity["largest_rise_worst"] == pytest.approx(np.max(rise / expected.max(axis=1)), abs=0.01)
    assert passivity["largest_rise_median"] == pytest.approx(np.median(rise / expected.max(axis=1)), abs=0.01)
    # From hanging down the bowl is this deep.
    assert rise.max() < 0.01 * float(controller.desired_energy(-known.upright))
    assert 0 < passivity["keypoint_error"] < 0.01


def test_a_late_input_holds_the_last_one(agent, monkeypatch):
    """A clock of our own makes three steps of the first copy late; the second is never timed."""
    late, dt, known = [2, 3, 7], 0.02, []

    class Clock:
        now, readings = 0.0, 0

        @classmethod
        def perf_counter(cls):
            step, ends = divmod(cls.readings, 2)
            cls.readings += 1
            cls.now += ends * (1.5 * dt if step in late else 0.5 * dt)
            return cls.now

    def fakes(agent):
        chosen = iter(np.arange(-1.0, 10.0))  # the first call is for compiling only

        def alone(state, frame, arrived, held):
            known.append(float(held[0]))
            return state, jnp.array([next(chosen)])

        return alone, lambda state, frames, arrived, held: (state, held + 1.0)

    monkeypatch.setattr(closed_loop, "time", Clock)
    monkeypatch.setattr(closed_loop, "_compiled", fakes)
    run = closed_loop.run_closed_loop(agent, get("pendulum"), np.zeros((2, 2)), 10 * dt, workers=1)
    np.testing.assert_array_equal(np.flatnonzero(run.missed), late)
    np.testing.assert_allclose(run.step_seconds, np.where(run.missed, 1.5 * dt, 0.5 * dt))
    np.testing.assert_array_equal(run.input[0, :, 0], [0, 1, 1, 1, 4, 5, 6, 6, 8, 9])
    np.testing.assert_array_equal(run.input[1, :, 0], np.arange(1, 11))
    # The agent is given the input that acted, and MuJoCo got the same.
    np.testing.assert_array_equal(known[1:], [0, 0, 1, 1, 1, 4, 5, 6, 6, 8])
    state = np.zeros((1, 2))
    for u in run.input[0]:
        state = advance(get("pendulum"), state, u[None])
    np.testing.assert_allclose(run.state[0, -1], state[0])


def test_bad_pictures_degrade_and_do_not_break(model):
    disturbance = Disturbance(noise=0.1, dropped=0.2)
    config = ControlConfig(trials=2, seconds=1.0, disturbance=disturbance)
    found = swing_up(model, get("pendulum"), EPSILON, None, config, workers=1)
    assert 5 < found.scores["frames_not_arrived"] < 40
    assert np.isfinite(found.arrays["input"]).all()
    with pytest.raises(KeycldError, match="--noise is a share from 0 to 1, not -0.1"):
        Disturbance(noise=-0.1)
    with pytest.raises(KeycldError, match="--drop is a probability of at least 0 and below 1, not nan"):
        Disturbance(dropped=float("nan"))


def test_a_frame_with_nan_counts_as_not_arrived(agent):
    step = eqx.filter_jit(agent)
    state, _ = step(agent.initial_state(), picture(1.0), jnp.array(True), jnp.zeros(1))
    broken = np.full((64, 64, 3), np.nan, np.float32)
    after, u = step(state, broken, jnp.array(True), jnp.zeros(1))
    assert np.isfinite(u).all() and after.belief.observations == 1
    dropped, same = step(state, picture(0.0), jnp.array(False), jnp.zeros(1))
    np.testing.assert_array_equal(u, same)
    # Before anything is observed there is no input.
    assert step(agent.initial_state(), broken, jnp.array(True), jnp.zeros(1))[1] == 0


def test_goals_that_mean_nothing(model):
    np.testing.assert_allclose(goal_of(model, picture(), EPSILON), [0.0, 0.49], atol=0.01)
    noise = np.random.default_rng(0).integers(0, 255, (64, 64, 3), dtype=np.uint8)
    with pytest.raises(KeycldError, match="shows no pose that the model knows"):
        goal_of(model, noise, EPSILON)
    with pytest.raises(KeycldError, match="64 × 64"):
        goal_of(model, noise[:32], EPSILON)
    nearest_pose(model, jnp.array([0.49, 0.0]), jnp.array([0.49**2]))
    with pytest.raises(KeycldError, match="constraints do not allow"):
        nearest_pose(model, jnp.array([0.2, 0.0]), jnp.array([0.49**2]))


class Still(AbstractModel):
    """A model without any capability."""

    context = 1

    def anchor(self, n):
        return 0

    def infer(self, frames, dt, u):
        raise NotImplementedError

    def rollout(self, state, dt, u, steps):
        raise NotImplementedError

    def render(self, state):
        raise NotImplementedError


def test_a_model_without_a_capability_is_refused(model):
    assert require(model, HasLagrangian) is model
    with pytest.raises(KeycldError, match="a model with a learned Lagrangian, and Still has none"):
        swing_up(Still(), get("pendulum"), EPSILON)
    with pytest.raises(KeycldError, match="a model with keypoints, and Still has none"):
        require(Still(), HasKeypoints)


def test_a_goal_picture_of_another_pose(model):
    """Leaning 30° needs a lasting torque; the goal is known from its picture alone."""
    found = swing_up(model, get("pendulum"), EPSILON, picture(0.52), ControlConfig(seconds=6.0), workers=1)
    assert found.scores["goal"] == "image" and found.scores["successes"] == 1
    assert found.arrays["state"][0, -1, 0] == pytest.approx(0.52, abs=0.1)


def test_configs_out_of_range():
    for wrong, words in (
        ({"estimator": "predict"}, "did you mean 'predict-correct'"),
        ({"trials": 0}, "--trials is a number from 1 to 10000, not 0"),
        ({"trials": 10**12}, "--trials is a number from 1 to 10000, not 1000000000000"),
        ({"seconds": 0.0}, "--seconds is a number from 0.1 to 3600, not 0"),
        ({"seconds": math.inf}, "--seconds is a number from 0.1 to 3600, not inf"),
        ({"seconds": 1e30}, r"--seconds is a number from 0.1 to 3600, not 1e\+30"),
    ):
        with pytest.raises(KeycldError, match=words):
            ControlConfig(**wrong)


def with_inputs(model, columns):
    """The model with an input matrix of some of the pendulum's columns, each repeated as often as it is named."""
    law = model.law
    matrix = (lambda x: law.input_matrix(x)[:, jnp.asarray(columns)]) if columns else None
    changed = ConstrainedLagrangian(law.mass, law.potential, matrix, law.constraint_function)
    return PendulumModel(MechanicalDynamics(changed, Rattle(substeps=4)), model.background)


def test_only_the_inputs_of_the_training_data_are_the_models(model):
    acrobot = get("acrobot")
    assert plant_inputs(model, ("elbow_torque",), acrobot) == (1,)
    assert plant_inputs(with_inputs(model, (0, 0)), ("elbow_torque", "shoulder_torque"), acrobot) == (1, 0)
    with pytest.raises(KeycldError, match="takes 1 .* but 2 are named"):
        plant_inputs(model, acrobot.input_names, acrobot)
    with pytest.raises(KeycldError, match="no input 'wheel': choose from shoulder_torque, elbow_torque"):
        plant_inputs(model, ("wheel",), acrobot)


def test_a_model_without_inputs_is_refused(model):
    with pytest.raises(KeycldError, match="keycld data make pendulum --control full"):
        swing_up(with_inputs(model, ()), get("pendulum"), EPSILON, input_names=())


def test_inputs_that_the_model_does_not_know_stay_zero(agent):
    """The agent's one input is the acrobot's elbow; the plant gets zero at the shoulder."""
    states = np.zeros((2, 4))
    run = closed_loop.run_closed_loop(agent, get("acrobot"), states, 0.05, inputs=(1,), workers=1)
    assert run.input.shape == (2, 5, 2)
    assert not run.input[..., 0].any() and run.input[..., 1].any()
    expected = states[:1]
    for u in run.input[0]:
        expected = advance(get("acrobot"), expected, u[None])
    np.testing.assert_allclose(run.state[0, -1], expected[0])


def test_the_command_writes_what_it_promises(model, tmp_path, monkeypatch, capsys):
    import keycld.training as training

    @dataclasses.dataclass
    class Config:
        system: str = "pendulum"
        input_names: tuple[str, ...] = ("torque",)
        epsilon: float = EPSILON

    (tmp_path / "config.json").write_text(json.dumps({"system": "pendulum", "command": "keycld train pendulum"}))
    monkeypatch.setattr(training, "run_folder", lambda run: tmp_path)
    monkeypatch.setattr(training, "load_run", lambda folder: (model, Config()))
    words = ["control", str(tmp_path), "--seconds", "0.4", "--limit", "3", "--workers", "1", "--set", "kp=8", "--json"]
    assert main(words) == 0
    scores = json.loads(capsys.readouterr().out)
    assert scores["limit"] == 3 and scores["n"] == 1 and max(scores["largest_input"]) <= 3
    assert scores["law_settings"] == {"kp": 8, "kd": 2} and scores["trials"] == 1
    name = "control-upright-shaping-kp8-limit3-seconds0.4"
    assert json.loads((tmp_path / "evaluation" / f"{name}.json").read_text()) == scores
    for file in (f"{name}.mp4", f"{name}.png", f"{name}-strip.png"):
        assert (tmp_path / "media" / file).stat().st_size > 1000
    assert main(["control", str(tmp_path), "--goal", str(tmp_path / "no.png")]) == 2
    assert "takes upright or a picture" in capsys.readouterr().err
    assert main(["control", str(tmp_path), "--actuators", "elbow"]) == 2
    assert "no input 'elbow': choose from torque" in capsys.readouterr().err
    monkeypatch.setattr(training, "load_run", lambda folder: (model, Config(system="data")))
    assert main(["control", str(tmp_path)]) == 2
    assert "has learned the system 'data', which keycld does not simulate" in capsys.readouterr().err


def test_the_report_has_a_section_on_control(result, tmp_path):
    (tmp_path / "config.json").write_text(json.dumps({"system": "pendulum", "command": "keycld train pendulum"}))
    save_evaluation(tmp_path, "control-upright-shaping", result)
    page = write_report(tmp_path).read_text()
    assert '<section id="control">' in page and "2 of 2" in page and "energy shaping" in page
    assert (tmp_path / "media" / "control-upright-shaping.mp4").exists()


def test_the_summary_is_a_few_lines(result):
    lines = summary_of(result.scores).splitlines()
    assert lines[0] == "shaping: 2 of 2 trials keep the goal during the last second"
    assert "of 300 missed" in lines[2]
    assert "T + V_d falls in" in lines[3]


def test_a_picture_named_upright_is_another_goal_than_the_upright_pose():
    """Its result would replace the other one."""
    settings = ControlConfig()
    assert _name("poses/upright.png", settings) == "control-picture-upright-shaping"
    assert [_name(goal, settings) for goal in ("upright", "poses/left.png")] == [
        "control-upright-shaping", "control-left-shaping",
    ]  # fmt: skip


def test_a_setting_that_is_a_word_is_part_of_the_name():
    """A law of an installed package may have one; the name is made when the simulation has ended."""

    @dataclasses.dataclass(frozen=True)
    class Moody(type(ControlConfig().law)):
        mood: str = "calm"

    assert _name("upright", ControlConfig(law=Moody(mood="wild"))) == "control-upright-shaping-moodwild"
