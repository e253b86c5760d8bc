"""Worker processes: an error in one is reported once, in the caller."""

import os
import sys
import time
from types import ModuleType

import pytest

from keycld import KeycldError
from keycld.systems import Task, get, is_software, render, renderer_name, run_in_processes


def double(x):
    return 2 * x


def refuse():
    raise KeycldError("fix this")


def break_down():
    raise ZeroDivisionError


def die(marker):
    """End the process the first time, answer the second."""
    if not os.path.exists(marker):
        open(marker, "w").close()
        os._exit(3)
    return "alive"


def die_always():
    os._exit(3)


def backend():
    import jax

    return jax.default_backend()


def hang():
    time.sleep(60)


def test_results_come_with_their_index():
    tasks = [Task(double, (i,)) for i in range(5)]
    assert dict(run_in_processes(tasks, workers=2)) == {i: 2 * i for i in range(5)}


def test_workers_leave_the_gpu_to_the_caller(monkeypatch):
    monkeypatch.setenv("JAX_PLATFORMS", "cuda")
    assert list(run_in_processes([Task(backend, ())])) == [(0, "cpu")]


def test_workers_import_what_their_caller_does(tmp_path, monkeypatch):
    """A folder `keycld` where the command runs is not the package, unless the caller looks there first."""
    (tmp_path / "keycld").mkdir()
    (tmp_path / "keycld" / "__init__.py").write_text("")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path])
    assert list(run_in_processes([Task(double, (1,))])) == [(0, 2)]


def test_a_system_of_a_script_is_not_blamed_on_the_renderer(monkeypatch):
    script = ModuleType("of_a_script")
    exec("def draw(): pass", script.__dict__)
    monkeypatch.setitem(sys.modules, "of_a_script", script)
    with pytest.raises(KeycldError, match="'of_a_script': a system must be in a module that other processes can"):
        list(run_in_processes([Task(script.draw, ())]))


def test_a_users_error_arrives_as_it_is():
    with pytest.raises(KeycldError, match="^fix this$"):
        list(run_in_processes([Task(refuse, ())]))


def test_a_programming_error_arrives_with_its_trace():
    with pytest.raises(RuntimeError, match="ZeroDivisionError"):
        list(run_in_processes([Task(break_down, ())]))


def test_a_dead_worker_gets_one_more_try(tmp_path):
    assert list(run_in_processes([Task(die, (str(tmp_path / "marker"),))])) == [(0, "alive")]
    with pytest.raises(KeycldError, match="failed twice"):
        list(run_in_processes([Task(die_always, ())]))


def test_a_hanging_worker_is_ended():
    with pytest.raises(KeycldError, match="failed twice"):
        list(run_in_processes([Task(hang, ())], time_out=0.3))


def test_workers_must_be_positive():
    with pytest.raises(KeycldError, match="at least 1"):
        list(run_in_processes([Task(double, (1,))], workers=0))


def test_the_renderer_has_a_name():
    assert renderer_name()


def test_software_renderers_are_known():
    assert is_software("llvmpipe (LLVM 15.0.6, 256 bits)")
    assert not is_software("NVIDIA H200/PCIe/SSE2")


@pytest.mark.parametrize(
    ("variable", "value"), [("__EGL_VENDOR_LIBRARY_FILENAMES", "/nonexistent"), ("MUJOCO_GL", "disable")]
)
def test_without_gl_one_sentence_names_the_packages(monkeypatch, variable, value):
    monkeypatch.setenv(variable, value)
    with pytest.raises(KeycldError, match="libegl1 libgl1"):
        renderer_name()


def test_one_process_draws_one_system():
    from keycld.systems.pictures import render_in_worker

    system = get("pendulum")
    other = get("acrobot")
    import numpy as np

    assert render(system, np.zeros((1, 2))).image.shape == (1, 64, 64, 3)
    tasks = [Task(render_in_worker, (each, np.zeros((1, len(each.state_names))))) for each in (system, other)]
    with pytest.raises(RuntimeError, match="cannot render"):
        list(run_in_processes(tasks, workers=1))
