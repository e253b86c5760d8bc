"""A set of "Which priors matter?" through the command line: made, checked, shown, and the original files imported."""

import shutil
from pathlib import Path

import pytest

from keycld.cli.main import main

ORIGINAL = Path(__file__).parent.parent / "data" / "golden" / "tfrecord" / "matching_pennies"


def test_make_check_show(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    name = "toy/mass_spring"
    assert main(["data", "make", name, "--train", "10", "--test", "2", "--long", "1", "--workers", "1"]) == 0
    assert main(["data", "make", name, "--train", "10", "--test", "2", "--long", "1"]) == 0
    assert "already there" in capsys.readouterr().out
    assert main(["data", "check", f"data/{name}"]) == 0
    assert main(["data", "show", name, "--split", "test_long", "--out", "a.gif", "--scale", "1"]) == 0
    assert (tmp_path / "a.gif").stat().st_size > 1000
    assert main(["data", "show", name, "--recording", "9"]) == 2
    assert "there is no recording 9: choose 0 to 8" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["toy/mass_spring", "--control", "none"], "no motors: leave out --control, --initial-state, --clip and"),
        (
            ["toy/mass_spring", "--train", "1"],
            "--train is a number of recordings, at least 2 and at most 1,000,000, not 1",
        ),
        (["pendulum", "--test", "99999999999"], "at most 1,000,000, not 99,999,999,999"),
        (["pendulum", "--long", "0"], "--long is a number of recordings, at least 1 and at most 1,000,000, not 0"),
        (["pendulum", "--initial-state", "moving"], "choose from rest, random, upright, released."),
        (["pendulum", "--workers", "0"], "--workers is at least 1, not 0"),
        (["toy/mass_spring", "--validation", "3"], "unknown split 'validation' of toy/mass_spring"),
        (["toy/mass_sprung"], "did you mean 'toy/mass_spring'"),
        (["cartpole", "--size", "full"], "one size"),
    ],
)
def test_mistakes_get_one_sentence_and_code_two(arguments, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["data", "make", *arguments]) == 2
    assert words in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_the_original_files(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(ORIGINAL, tmp_path / "matching_pennies")
    assert main(["data", "import", "matching_pennies", "--out", "data/games/matching_pennies"]) == 0
    assert main(["data", "check", "data/games/matching_pennies"]) == 0
