"""Control laws are found by name; a new one is one file."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from pendulum_model import PendulumModel
from true_physics import truth

import keycld
from keycld import KeycldError
from keycld.cli.control import law_titles
from keycld.control import Belief, ControlConfig, Problem, closed_loop, control_laws, law_named, registry, swing_up
from keycld.systems import get

PAGE = Path(__file__).parents[2] / "docs" / "control.md"


@pytest.fixture
def push(tmp_path, monkeypatch):
    """The example law of docs/control.md, imported from a file of its own; forgotten afterwards."""
    monkeypatch.setattr(registry, "_LAWS", dict(control_laws()))
    code = next(
        block for block in re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.S) if "register_law" in block
    )
    path = tmp_path / "push.py"
    path.write_text(code)
    spec = importlib.util.spec_from_file_location("push", path)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "push", module)
    spec.loader.exec_module(module)
    return path


def test_a_law_in_a_file_of_its_own_closes_the_loop(push, monkeypatch):
    # A clock that stands still: on a busy machine the first step may be late, and then holds no input at all.
    monkeypatch.setattr(closed_loop, "time", SimpleNamespace(perf_counter=lambda: 0.0))
    config = ControlConfig(law=law_named("push", {"strength": 0.4}), seconds=0.2, trials=2)
    found = swing_up(PendulumModel.make(), get("pendulum"), 0.01, config=config, workers=1)
    np.testing.assert_allclose(np.abs(found.arrays["input"]), 0.4, rtol=1e-6)
    # It pushes each pendulum towards the side that the goal is on.
    angle = (found.arrays["state"][:, 0, 0] + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_array_equal(np.sign(found.arrays["input"][:, 0, 0]), -np.sign(angle))
    assert found.scores["law"] == "push" and found.scores["law_settings"] == {"strength": 0.4}


def test_help_lists_a_law_that_is_one_more_file(push, monkeypatch):
    assert [line.partition(":")[0] for line in law_titles().splitlines()] == list(control_laws())[:-1]
    monkeypatch.setattr("keycld.cli.control.LAWS", push.parent)
    assert law_titles() == "push: Constant push towards the goal. Settings: strength=1.0."


def test_help_lists_the_laws_without_jax():
    code = (
        "import sys, keycld.cli.main\n"
        "try: keycld.cli.main.main(['control', '--help'])\n"
        "except SystemExit: pass\n"
        "assert 'jax' not in sys.modules"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr
    assert all(f"{name}: " in answer.stdout for name in control_laws())


def test_every_law_has_a_file_in_the_folder():
    folder = Path(keycld.__file__).parent / "control" / "laws"
    assert {law.__module__ for law in control_laws().values()} == {
        f"keycld.control.laws.{path.stem}" for path in folder.glob("*.py") if path.stem != "__init__"
    }


def test_wrong_names_and_settings():
    for name, settings, words in (
        ("shapin", {}, "unknown control law 'shapin': did you mean 'shaping'"),
        ("shaping", {"kq": 1.0}, "unknown setting 'kq' of the control law 'shaping': did you mean"),
        ("shaping", {"kp": "high"}, "kp of the control law 'shaping' is a number, not 'high'"),
        ("shaping", {"kp": 0.0}, "kp is a positive number, not 0.0"),
        ("zero", {"kp": 1.0}, "'zero' has no settings: leave out kp"),
        ("mpc", {"horizon": 0.2}, "horizon is longer than 0.5 s"),
        ("mpc", {"horizon": np.inf}, "and finite, not inf"),
    ):
        with pytest.raises(KeycldError, match=words):
            law_named(name, settings)


def test_random_inputs_need_a_limit():
    known = truth("pendulum")
    problem = Problem(known.law, known.upright, (0,), np.inf, 0.02, seed=0)
    with pytest.raises(KeycldError, match="random inputs need an input limit"):
        law_named("random").controller(problem)
    controller = law_named("random").controller(problem._replace(limit=2.0))
    belief = Belief(known.motion(np.zeros(2)), 0 * known.upright, jnp.asarray(9))
    memory, inputs = controller.initial_memory(), []
    for _ in range(20):
        u, memory = controller.act(belief, memory)
        inputs.append(u)
    assert 1.0 < np.abs(inputs).max() <= 2.0 and len(np.unique(inputs)) == 20
