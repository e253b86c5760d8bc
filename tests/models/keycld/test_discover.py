"""Which of several mechanisms is chosen."""

import numpy as np
import pytest

from keycld.mechanics import Candidate, Constraints, DistanceToPoint, load_constraints
from keycld.models.keycld import discover
from keycld.models.keycld.discover import judge_candidates, pieces

X, SEEN = np.zeros((60, 2)), np.ones(60, bool)
PENDULUM = Candidate("pendulum", load_constraints("pendulum"), X, SEEN, {"distance_to_point ball": 0.01})
FREE = Candidate(None, Constraints(("part1",)), X, SEEN, {})
LINE = Candidate("spring", load_constraints("spring"), X, SEEN, {"on_line mass": 0.3})
HALF = Candidate(
    None, Constraints(("a", "b"), (DistanceToPoint("a"),)), np.zeros((60, 4)), SEEN, {"distance_to_point a": 0.01}
)


@pytest.mark.parametrize(
    ("first", "error", "second", "other", "chosen"),
    [
        (PENDULUM, 0.02, FREE, 0.016, PENDULUM),
        (PENDULUM, 0.2, FREE, 0.02, FREE),
        (PENDULUM, 0.2, FREE, 0.18, PENDULUM),
        (PENDULUM, 0.3, FREE, 0.18, None),
        (PENDULUM, 0.3, HALF, 0.2, None),
    ],
    ids=["as good with less freedom", "much better", "not good enough when free", "none predicts", "half free"],
)
def test_the_choice(monkeypatch, first, error, second, other, chosen):
    """A line that does not hold is not predicted, and comes last."""
    monkeypatch.setattr(discover, "_error", lambda candidate, fitted, dt: error if candidate is first else other)
    judged = judge_candidates([first, second, LINE], 40, 1 / 30)
    assert [each.candidate is chosen for each in judged if each.chosen] == ([] if chosen is None else [True])
    assert judged[-1].candidate is LINE and judged[-1].error is None
    assert chosen is None or judged[0].candidate is chosen


def test_a_fit_takes_only_frames_in_which_all_parts_are_seen():
    """Two runs of seen frames, 43 and 39 long: pieces of 39, one of each, and none across the gap."""
    seen = np.ones(120, bool)
    seen[43:66], seen[105:118] = False, False
    starts, length = pieces(seen, 60)
    assert (starts, length) == ([0, 66], 39)
    assert all(seen[start : start + length].all() for start in starts)
    assert pieces(np.ones(120, bool), 60) == ([0, 60], 60)


@pytest.mark.parametrize("part", ["validation", "training"])
def test_a_part_that_is_hardly_seen_predicts_nothing(part):
    """In no frame of the validation part; in the training part never for more than three frames in a row."""
    seen = np.ones(60, bool)
    if part == "validation":
        seen[40:] = False
    else:
        seen[:40] = np.arange(40) % 6 < 3
    judged = judge_candidates([Candidate("pendulum", PENDULUM.constraints, X, seen, PENDULUM.residuals)], 40, 1 / 30)
    assert judged[0].error == np.inf and not judged[0].chosen
