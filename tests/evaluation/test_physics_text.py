"""Physical constants as text: the same on the command line and on the page."""

from keycld.evaluation import Physics, constants_table, value_text
from keycld.evaluation.physics_file import constant, unknown_constant
from keycld.reports import clip_sections

CONSTANTS = {
    "period_1": constant(1.20437, 0.0123, "s", positive=True),
    "mass_ratio": constant(2.0, 0.0, "1", positive=True),
    "mass": unknown_constant("units", "one video does not tell it"),
}


def test_a_constant_has_the_decimals_of_its_error():
    assert [value_text(each) for each in CONSTANTS.values()] == ["1.204 ± 0.012", "2", "not identifiable"]


def test_the_table_says_why_there_is_no_value():
    physics = Physics(mechanism=None, fps=None, constants=CONSTANTS, rejected={}, prediction={})
    assert constants_table(physics).split("\n") == [
        "period_1    1.204 ± 0.012 s",
        "mass_ratio  2",
        "mass        not identifiable: one video does not tell it",
    ]


def test_the_page_shows_the_same():
    assert clip_sections._constant("period_1", CONSTANTS["period_1"], None)[1] == "1.204 ± 0.012"
