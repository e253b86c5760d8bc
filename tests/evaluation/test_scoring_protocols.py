import pytest

from keycld import KeycldError
from keycld.evaluation import Protocol, protocol_named, standard_protocols


def test_the_standard_list():
    found = {p.name: (p.split, p.horizon, p.given) for p in standard_protocols()}
    assert found == {
        "test@50": ("test", 50, 2),
        "validation@50": ("validation", 50, 2),
        "test_long@200": ("test_long", 200, 2),
        "test_long@500": ("test_long", 500, 2),
    }
    assert all(p.factors == (1.0, 0.25) for p in standard_protocols())


def test_a_wrong_name_gets_the_nearest():
    with pytest.raises(KeycldError, match="did you mean 'test@50'"):
        protocol_named("test@5O")


def test_something_must_be_left_to_predict():
    with pytest.raises(KeycldError, match="fewer than all"):
        Protocol("x", "test", horizon=2, given=2)
