"""Experiments on a local Ray cluster: a worker and then the driver are killed in the middle."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import bench_stub
import pytest
from test_running import STUB, behave, experiments, place, wait_until  # noqa: F401

from keycld import KeycldError
from keycld._lock import holder
from keycld.benchmarks import OnRay, run_experiments, status_of

DRIVER = """
import sys
from pathlib import Path
import ray
from keycld.benchmarks import OnRay, Place, run_experiments, suite_named

ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="ERROR")
experiments = suite_named("keycld").select(systems=["pendulum"], models=["keycld"])
place = Place(Path(sys.argv[1]), Path(sys.argv[2]))
print(run_experiments(experiments, place, runner=OnRay(), child=sys.argv[3:]))
"""


def started(place):  # noqa: F811
    command = [sys.executable, "-c", DRIVER, str(place.root), str(place.results), *STUB]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def wait_for(driver, condition):
    """Wait until it is true; a driver that has ended would let it wait for ever."""
    wait_until(lambda: condition() or driver.poll() is not None)
    assert condition(), driver.communicate()[0]


def parent(pid):
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])


@pytest.mark.slow
def test_only_the_rest_is_run_after_a_worker_and_the_driver_are_killed(place):  # noqa: F811
    pytest.importorskip("ray")
    behave(place, pendulum_keycld_1="hang", pendulum_keycld_2="raise")
    driver = started(place)
    first, second, third = experiments()
    hanging, lock = place.root / "hanging", place.run(second) / "bench.lock"
    wait_for(driver, hanging.exists)
    worker = parent(holder(lock).pid)
    assert worker != driver.pid
    hanging.unlink()
    os.kill(worker, signal.SIGKILL)
    wait_for(driver, hanging.exists)  # another worker has resumed it
    wait_for(driver, lambda: status_of(first, place).word == "done" and status_of(third, place).word == "failed")
    driver.kill()
    driver.communicate()
    wait_until(lambda: holder(lock) is None)
    assert "interrupted" in status_of(second, place).detail

    behave(place)
    driver = started(place)
    printed, _ = driver.communicate(timeout=120)
    assert driver.returncode == 0 and "3 experiments, 1 done, 2 to do" in printed and "{'done': 3}" in printed
    done = bench_stub.notes(place.root)
    expected = ["data pendulum"]
    for experiment in (first, second, third):
        expected += [f"step {k} of {experiment.name}" for k in range(bench_stub.STEPS)]
        expected += [f"{protocol.name} of {experiment.name}" for protocol in experiment.protocols]
    assert sorted(done) == sorted(expected)  # each piece of work exactly once


def test_without_ray_one_sentence_says_what_to_install(place, monkeypatch):  # noqa: F811
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(KeycldError, match=r"--on ray needs its package: pip install 'keycld\[ray\]'"):
        run_experiments(experiments(), place, runner=OnRay(), child=STUB, say=str)


@pytest.mark.parametrize(
    ("cpus", "gpus", "words"),
    [
        (-1.0, 0.0, "above 0, not -1 and 0"),
        (float("nan"), 0.0, "above 0, not nan and 0"),
        (1.0, float("inf"), "above 0, not 1 and inf"),
        (0.0, 0.0, "above 0, not 0 and 0"),
        (1.0, 1.5, "--gpus is a share of one GPU or a whole number, not 1.5"),
    ],
)
def test_resources_that_ray_does_not_know_are_refused(cpus, gpus, words):
    with pytest.raises(KeycldError, match=words):
        OnRay(cpus, gpus)
