import dataclasses
import re
from pathlib import Path

import pytest

import scenes
from keycld import KeycldError
from keycld.data import DataSet, write
from keycld.evaluation import PROTOCOLS, Protocol, make_protocol, protocol_named, protocols_for
from swing import Still, Swing

PAGE = Path(__file__).parents[2] / "docs" / "evaluation.md"


def recorded(folder, *, plan="tests", **frames):
    """A data set with files of these lengths."""
    for name, length in frames.items():
        recordings = scenes.disc_pendulum(1, length, seed=0)
        write(
            folder / f"{name}.h5",
            dataclasses.replace(recordings, attributes={**recordings.attributes, "protocol": plan}),
        )
    return DataSet(folder, None)


class Slow(Swing):
    """Needs three frames."""

    context = 3


def test_the_keycld_papers_protocols():
    for name, split, horizon in (
        ("test@50", "test", 50), ("validation@50", "validation", 50),
        ("test_long@200", "test_long", 200), ("test_long@500", "test_long", 500),
    ):  # fmt: skip
        found = PROTOCOLS[name]
        assert (found.split, found.horizon, found.given, found.start) == (split, horizon, 2, 0)
        assert (found.metric, found.thresholds, found.part) == ("squared", (1.0, 0.25), (0, horizon))
        assert dataclasses.replace(found, given=3, name=f"{name}-given-3") == PROTOCOLS[f"{name}-given-3"]


def test_the_second_papers_protocols():
    """256 frames, 5 given, 0.025 of the normalised error from frame 64 on, 20 trajectories."""
    forward, backward = PROTOCOLS["test@256-priors"], PROTOCOLS["test@256-priors-backward"]
    for found in (forward, backward):
        assert (found.given, found.metric, found.thresholds, found.trajectories) == (5, "normalised", (0.025,), 20)
    assert (forward.part, forward.first_given, forward.train_part) == ((64, 256), 0, (4, 64))
    assert (backward.part, backward.first_given, backward.train_part) == ((0, 192), 251, (192, 252))


def test_a_name_says_the_whole_protocol():
    found = protocol_named("test_long@300-priors-given-7-from-10-backward")
    assert (found.split, found.horizon, found.given, found.start) == ("test_long", 300, 7, 10)
    assert found.backward and found.metric == "normalised" and found.needs == 310
    assert all(protocol_named(name) == protocol for name, protocol in PROTOCOLS.items())
    assert protocol_named("test@50-given-2").name == "test@50"


@pytest.mark.parametrize(
    ("name", "nearest"),
    [("test@5O", "test@50"), ("test_long@50-form-30", "test_long@50-from-30"), ("test@256-prior", "test@256-priors")],
)
def test_a_wrong_name_gets_the_nearest(name, nearest):
    with pytest.raises(KeycldError, match=f"did you mean '{nearest}'"):
        protocol_named(name)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"horizon": 2}, "gives 2 of 2 frames: give at least 1 and fewer than all"),
        ({"given": 0}, "gives 0 of 20 frames"),
        ({"start": -1}, "the first frame is 0"),
        ({"scored_from": 20}, "is scored from frame 20 on, but its window has 20 frames"),
        ({"thresholds": ()}, "one positive number or more"),
        ({"thresholds": (float("nan"),)}, "one positive number or more"),
        ({"trajectories": 0}, "score at least 1"),
        ({"shown": -1}, "keep 0 or more"),
        ({"metric": "square"}, "did you mean 'squared'"),
        ({"direction": "back"}, "did you mean 'backward'"),
    ],
)
def test_nonsense_is_named(values, words):
    with pytest.raises(KeycldError, match=re.escape(words)):
        Protocol(**{"name": "x", "split": "test", "horizon": 20, **values})


def test_the_window_of_priors_must_be_longer_than_the_training():
    with pytest.raises(KeycldError, match="'test@50-priors' is scored from frame 64 on"):
        protocol_named("test@50-priors")


def test_data_of_the_journal_version_give_three_frames(tmp_path):
    (found,) = protocols_for(recorded(tmp_path, plan="keycld-2024", test=12), Swing.right())
    assert (found.name, found.given, found.horizon) == ("test@12-given-3", 3, 12)


def test_a_model_that_needs_three_frames_gets_three(tmp_path):
    data = recorded(tmp_path, test=12, test_long=80)
    found = {p.name: p.given for p in protocols_for(data, Slow.right())}
    assert found == {"test@12-given-3": 3, "test_long@80-given-3": 3, "test_long@50-given-3-from-30": 3}


def test_shorter_recordings_are_scored_to_their_end(tmp_path):
    data = recorded(tmp_path, test=12, validation=60, test_long=250)
    found = {p.name: (p.split, p.horizon, p.start) for p in protocols_for(data, Swing.right())}
    assert found == {
        "test@12": ("test", 12, 0),
        "validation@50": ("validation", 50, 0),
        "test_long@200": ("test_long", 200, 0),
        "test_long@250": ("test_long", 250, 0),
        "test_long@50-from-30": ("test_long", 50, 30),
    }


def test_the_default_list_has_a_motion_that_is_taken_up(tmp_path):
    """Long recordings are released from rest; a model that relies on it must not hide it."""
    names = [p.name for p in protocols_for(recorded(tmp_path, test_long=500), Swing.right())]
    assert names == ["test_long@200", "test_long@500", "test_long@50-from-30"]


def test_recordings_that_end_before_the_scored_part_are_left_out(tmp_path):
    assert protocols_for(recorded(tmp_path, plan="priors-released", test=64, test_long=32), Swing.right()) == ()


def test_the_suites_data_are_scored_both_ways_if_the_model_can(tmp_path):
    data = recorded(tmp_path, plan="priors-released", test=200)
    assert [p.name for p in protocols_for(data, Swing.right())] == ["test@200-priors", "test@200-priors-backward"]
    assert [p.name for p in protocols_for(data, Still())] == ["test@200-priors"]


def test_the_page_lists_every_protocol_as_the_code_has_it():
    """| `name` | `file.h5` | window | given | scored | metric | trajectories |."""
    rows = {}
    for line in PAGE.read_text().splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) == 7 and cells[0].startswith("`"):
            rows[cells[0].strip("`")] = cells[1:]
    assert set(rows) == set(PROTOCOLS)
    for name, protocol in PROTOCOLS.items():
        last = "last " if protocol.backward else ""

        assert rows[name] == [
            f"`{protocol.split}.h5`",
            f"{protocol.start} to {protocol.needs - 1}",
            f"{last}{protocol.given}",
            f"{protocol.start + protocol.part[0]} to {protocol.start + protocol.part[1] - 1}",
            protocol.metric,
            "all" if protocol.trajectories is None else str(protocol.trajectories),
        ]


def test_names_are_made_in_one_place():
    assert make_protocol("test", 50, given=3).name == "test@50-given-3"
    assert make_protocol("test_long", 200, start=5, backward=True).name == "test_long@200-from-5-backward"
