"""The progress bar."""

import io

import pytest

from keycld import _progress as progress
from keycld.training import Bar


@pytest.fixture
def clock(monkeypatch):
    """A clock that the test advances."""
    passed = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: passed[0])
    return passed


def test_time_left_does_not_count_what_compiled(clock):
    """A minute compiles with the first 25 steps of 100; the next 25 take a second, so two are left."""
    stream = io.StringIO()
    bar = Bar("joint", 100, every=0.0, stream=stream)
    for seconds, done in ((60.0, 25), (1.0, 50), (2.0, 100)):
        clock[0] += seconds
        bar.show(done, 16.0, "loss 1")
    compiled, later, last = stream.getvalue().splitlines()
    assert "25/100" in compiled and "left" not in compiled
    assert "50/100" in later and "0:02 left" in later
    assert "100/100" in last and "0:00 left" in last


def test_a_file_gets_a_line_every_few_seconds(clock):
    """The first call, one every `every` seconds, and the last."""
    stream = io.StringIO()
    bar = Bar("joint", 100, every=15.0, stream=stream)
    for done in range(1, 101):
        clock[0] += 1.0
        bar.show(done, 16.0, "")
    shown = [int(line.split("/")[0].split()[-1]) for line in stream.getvalue().splitlines()]
    assert shown == [1, 16, 31, 46, 61, 76, 91, 100]
