"""Sentences about names that do not exist."""

from keycld._errors import unknown

NAMES = [f"vision.number{k}" for k in range(36)]


def test_an_unknown_name_is_answered_by_the_nearest_one_alone():
    assert str(unknown("preset", "fats", ["fast", "paper"], of="model 'keycld'")) == (
        "unknown preset 'fats' of model 'keycld': did you mean 'fast'?"
    )
    assert str(unknown("setting", "number7", NAMES)) == "unknown setting 'number7': did you mean 'vision.number7'?"
    steps = unknown("setting", "tries", ["vision.tries", "constraints", "vision.candidates"])
    assert "did you mean 'vision.tries'?" in str(steps)


def test_without_a_near_name_the_sentence_has_few_of_many_and_all_of_few():
    assert str(unknown("model", "x", ["b", "a"], listed="`keycld models`")) == "unknown model 'x': choose from a, b."
    assert str(unknown("experiment", "nothing", NAMES, listed="`keycld bench status keycld`")) == (
        "unknown experiment 'nothing': choose from vision.number0, vision.number1, vision.number10, … "
        "(all 36: `keycld bench status keycld`)."
    )
