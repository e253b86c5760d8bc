"""Configs by name: every setting is typed, documented, checked, saved and read back."""

import ast
import dataclasses
import inspect
import json
import subprocess
import sys

import pytest

from keycld import KeycldError
from keycld.mechanics import Constraints, DistanceToPoint, FixedDistance
from keycld.models import config_for, models
from keycld.models.registry import register_model


def test_settings_are_changed_by_name_and_checked():
    config = config_for("keycld", "fast", joint={"horizons": [8]}, sigma=1)
    assert config.settings()["sigma"] == 1.0 and config.settings()["joint"]["horizons"] == [8]
    assert config_for("keycld", "fast", **{"vision.steps": 7}).settings()["vision"]["steps"] == 7
    for settings, words in (
        ({"vision": {"step": 3}}, "did you mean 'vision.steps'"),
        ({"first_frame": 3}, "did you mean 'first_frames'"),
        ({"vision": 3}, "setting vision of preset 'fast' is a group"),
        ({"groups": 0}, "groups is at least 1, not 0"),
        ({"vision": {"batch": 0}}, "batch is at least 1, not 0"),
        ({"joint": {"rate": -1.0}}, "joint.rate is a finite number of at least 0, not -1"),
        ({"joint": {"rate": float("nan")}}, "joint.rate is a finite number of at least 0, not nan"),
        ({"vision": {"steps": "many"}}, "setting vision.steps of preset 'fast' takes a int"),
    ):
        with pytest.raises(KeycldError, match=words):
            config_for("keycld", "fast", **settings)


@pytest.mark.parametrize(
    ("model", "preset", "name"), [("hgn", "released", "steps"), ("ar", "fast", "steps"), ("keycld", "paper", "epochs")]
)
def test_no_training_at_all_is_refused(model, preset, name):
    with pytest.raises(KeycldError, match=f"{name} is at least 1, not 0"):
        config_for(model, preset, **{name: 0})


def test_a_name_belongs_to_one_family():
    with pytest.raises(KeycldError, match="'keycld' of mine is taken by keycld: choose another"):
        register_model("keycld", family="mine", title="another one")


def test_a_flag_without_a_value_is_refused():
    """The command line sets fields without `changed`."""
    config = config_for("keycld", "fast")
    with pytest.raises(KeycldError, match=r"joint.horizons is one value or more, such as \(8, 16.*\), not none"):
        dataclasses.replace(config, joint=dataclasses.replace(config.joint, horizons=()))


def test_unknown_models_and_presets_are_refused_with_the_nearest_name():
    with pytest.raises(KeycldError, match="unknown preset 'fsat' of model 'keycld': did you mean 'fast'"):
        config_for("keycld", "fsat")
    with pytest.raises(KeycldError, match="unknown model 'keycdl'.*did you mean 'keycld'"):
        config_for("keycdl")


EVERY = [(name, preset) for name, entry in models().items() for preset in entry.presets]


@pytest.mark.parametrize(("name", "preset"), EVERY)
def test_every_config_survives_json(name, preset):
    config = config_for(name, preset).completed()
    assert (config.model, config.preset) == (name, preset)
    assert config_for(name, preset, **json.loads(json.dumps(config.settings()))) == config


@pytest.mark.parametrize(("name", "preset"), EVERY)
def test_every_setting_is_documented(name, preset):
    """Each field is followed by its line of documentation, in its own class or in the one it comes from."""

    def check(kind):
        documented = set()
        for base in kind.__mro__:
            if dataclasses.is_dataclass(base):
                body = ast.parse(inspect.getsource(base).lstrip()).body[0].body
                for field, text in zip(body, body[1:], strict=False):
                    if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr):
                        documented.add(field.target.id)
        for field in dataclasses.fields(kind):
            assert field.name in documented, f"{kind.__name__}.{field.name}"
            if dataclasses.is_dataclass(field.default):
                check(type(field.default))

    check(type(config_for(name, preset)))


def test_configs_import_without_jax():
    code = (
        "import sys; from keycld.models import config_for, models\n"
        "for name, entry in models().items():\n"
        "    for preset in entry.presets: config_for(name, preset)\n"
        "assert 'jax' not in sys.modules"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr


def test_constraints_that_no_text_can_hold_stay_in_python():
    chain = Constraints(("elbow", "tip"), (DistanceToPoint("elbow"), FixedDistance("elbow", "tip")))
    joined = Constraints(("elbow", "tip"), (chain,))
    assert isinstance(config_for("keycld", "fast", constraints=joined).completed().constraints, str)
    for kept in (chain.distances(), Constraints(("elbow", "tip"), (chain, lambda x, _: x[:1]))):
        assert config_for("keycld", "fast", constraints=kept).completed().constraints is kept


@pytest.mark.parametrize("preset", ["fast", "paper"])
def test_constraints_that_read_parameters_are_refused_before_training(preset):
    hook = Constraints(("bob",), (DistanceToPoint("bob", "hook"),))
    with pytest.raises(KeycldError, match="the parameter 'hook'.*give them a point of two numbers"):
        config_for("keycld", preset, constraints=hook).completed()
    function = Constraints(("bob",), (lambda x, parameters: x[:1] - parameters["hook"],))
    with pytest.raises(KeycldError, match="read the parameter 'hook' of the state"):
        config_for("keycld", preset, constraints=function).completed()
    assert config_for("keycld-nc", preset, constraints=hook).completed().constraints
