"""Which of several mechanisms is chosen."""

import numpy as np
import pytest

from keycld.mechanics import Candidate, Constraints, DistanceToPoint, load_constraints
from keycld.models.keycld import discover
from keycld.models.keycld.discover import judge_candidates

X = np.zeros((60, 2))
PENDULUM = Candidate("pendulum", load_constraints("pendulum"), X, {"distance_to_point ball": 0.01})
FREE = Candidate(None, Constraints(("part1",)), X, {})
LINE = Candidate("spring", load_constraints("spring"), X, {"on_line mass": 0.3})
HALF = Candidate(
    None, Constraints(("a", "b"), (DistanceToPoint("a"),)), np.zeros((60, 4)), {"distance_to_point a": 0.01}
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
