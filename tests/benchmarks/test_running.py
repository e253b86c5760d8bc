"""Kills, failures and two runs at once, in real processes with stubs for data, training and scores."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import bench_stub
import pytest

from keycld._lock import holder, locked
from keycld.benchmarks import AtOnce, Place, run_experiments, status_of, suite_named

STUB = [sys.executable, str(Path(__file__).with_name("bench_stub.py"))]
DRIVER = """
import sys
from pathlib import Path
from keycld.benchmarks import Place, run_experiments, suite_named
experiments = suite_named("keycld").select(systems=["pendulum"], models=["keycld"])
run_experiments(experiments, Place(Path(sys.argv[1]), Path(sys.argv[2])), child=sys.argv[3:])
"""


def experiments(**choice):
    return suite_named("keycld").select(systems=["pendulum"], models=["keycld"], **choice)


@pytest.fixture
def place(tmp_path):
    return Place(tmp_path, tmp_path / "results")


def behave(place, **fates):
    bench_stub.write(place.root / "behaviour.json", {name.replace("_", "-"): fate for name, fate in fates.items()})


def wait_until(condition):
    deadline = time.monotonic() + 300
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_what_is_named_twice_is_done_once():
    assert len(experiments(seeds=(1, 0, 1))) == 2


@pytest.mark.slow
def test_a_killed_bench_repeats_no_finished_work(place):
    """kill -9 of `bench run` while the second of three experiments trains."""
    behave(place, pendulum_keycld_1="hang")
    driver = [sys.executable, "-c", DRIVER, str(place.root), str(place.results), *STUB]
    process = subprocess.Popen(driver, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    wait_until((place.root / "hanging").exists)
    _, second, third = experiments()
    lock = holder(place.run(second) / "bench.lock")
    assert lock is not None and lock.pid != process.pid
    assert [status_of(each, place).word for each in experiments()] == ["done", "running", "missing"]
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    # The process of the experiment ends too.
    wait_until(lambda: holder(place.run(second) / "bench.lock") is None)
    assert status_of(second, place).word == "missing" and "interrupted" in status_of(second, place).detail

    behave(place)
    lines = []
    assert run_experiments(experiments(), place, child=STUB, say=lines.append) == {"done": 3}
    # Two trainings of a minute by the stub's log, and twice the seconds that the first evaluation really took.
    assert re.fullmatch(r"3 experiments, 1 done, 2 to do, about 2 min \d\d s left", lines[0]) and len(lines) == 3
    assert "VPT 0.900" in lines[1] and "left" in lines[1] and "left" not in lines[2]
    done = bench_stub.notes(place.root)
    expected = ["data pendulum"]
    for experiment in experiments():
        expected += [f"step {k} of {experiment.name}" for k in range(bench_stub.STEPS)]
        expected += [f"{protocol.name} of {experiment.name}" for protocol in experiment.protocols]
    assert done == expected  # each piece of work exactly once

    run_experiments(experiments(), place, child=STUB, say=lines.append)
    assert bench_stub.notes(place.root) == done
    # A result counts without its run folder.
    place.run(third).rename(place.root / "elsewhere")
    assert status_of(third, place).word == "done"


def test_a_failure_is_recorded_and_the_other_experiments_are_done(place):
    behave(place, pendulum_keycld_0="raise", pendulum_keycld_1="kill")
    assert run_experiments(experiments(), place, child=STUB, say=str) == {"failed": 2, "done": 1}
    raised, killed, _ = (status_of(each, place).detail for each in experiments())
    assert raised == "KeycldError during training: the lamp is out: switch it on."
    assert killed.startswith("SIGKILL") and "memory" in killed
    behave(place)
    assert run_experiments(experiments(seeds=[0, 1]), place, child=STUB, say=str) == {"done": 2}
    assert sum(line.startswith("step") for line in bench_stub.notes(place.root)) == 3 * bench_stub.STEPS
    assert not list(place.results.rglob("*.failed.json"))


@pytest.mark.slow
def test_experiments_that_train_together_succeed_fail_and_die_by_themselves(place):
    """Two at a time, in one process: one fails, the other does not care; a killed process is repeated."""
    behave(place, pendulum_keycld_0="raise", pendulum_keycld_2="kill")
    lines = []
    run = {"runner": AtOnce(2), "child": STUB, "say": lines.append}
    assert run_experiments(experiments(), place, **run) == {"failed": 2, "done": 1}
    assert [line.split()[1] for line in lines[1:]] == [each.name for each in experiments()]
    raised, _, killed = (status_of(each, place).detail for each in experiments())
    assert raised == "KeycldError during training: the lamp is out: switch it on."
    assert killed.startswith("SIGKILL")
    shared = [line for line in bench_stub.notes(place.root) if "one of" in line]
    assert sorted(shared) == [f"pendulum-keycld-{k} is one of 2" for k in range(2)]

    # Both are in the process that dies.
    behave(place, pendulum_keycld_0="hang", pendulum_keycld_2="kill")
    assert run_experiments(experiments(), place, **run) == {"failed": 2, "done": 1}
    assert all(status_of(experiments()[k], place).detail.startswith("SIGKILL") for k in (0, 2))
    behave(place)
    assert run_experiments(experiments(), place, **run) == {"done": 3}
    assert sum(line.startswith("step") for line in bench_stub.notes(place.root)) == 3 * bench_stub.STEPS


def test_two_at_once_do_not_take_the_same_experiment(place):
    first, *_ = experiments()
    lines = []
    with locked(place.run(first) / "bench.lock"):
        # First seen by `bench run`, then by its child, if the other process was faster by a moment.
        counts = run_experiments([first], place, child=STUB, say=lines.append)
        late = [*STUB, str(os.getpid()), str(place.root), str(place.results), first.to_json()]
        assert subprocess.run(late, check=False).returncode == 75
    assert counts == {"running": 1} and f"process {os.getpid()}" in lines[1]
    assert bench_stub.notes(place.root) == []


def test_a_run_of_other_settings_is_moved_aside(place):
    (changed,) = experiments(seeds=[0])
    folder = place.run(changed)
    (folder / "checkpoints").mkdir(parents=True)
    (folder / "bench.json").write_text(json.dumps({"config_hash": "0123", "seconds": {}}))
    (folder / "checkpoints" / "latest").write_text("00-old")
    (folder.with_name("pendulum-keycld-0.0123")).mkdir()  # of an earlier change
    run_experiments([changed], place, child=STUB, say=str)
    assert (folder.with_name("pendulum-keycld-0.0123.1") / "checkpoints" / "latest").read_text() == "00-old"
    assert status_of(changed, place).word == "done"


def test_a_lock_ends_with_its_holder(tmp_path):
    path = tmp_path / "a" / "lock"
    assert holder(path) is None
    with locked(path) as mine, locked(path) as second:
        assert mine and not second
        found = holder(path)
        assert found is not None and found.pid == os.getpid() and found.silent < 60
    assert holder(path) is None
    # A killed process leaves its number in the file, but no lock.
    path.write_text(json.dumps({"pid": 2**22 + 1, "host": os.uname().nodename, "since": 0.0}))
    assert holder(path) is None
    with locked(path) as mine:
        assert mine
