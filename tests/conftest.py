"""Strict settings for every test: silent broadcasting and silent warnings are failures."""

import fcntl
import gc
import os
import sys
from pathlib import Path

import pytest

# Most of a test's time is compilation, of programs that run once: half of it with fewer passes of LLVM and without
# MLIR's fusions, a seventh less in one piece, because all cores are busy, and half again at level 0. jaxlib 0.10 to
# 0.12 know these flags; one that does not dies.
QUICK = (
    "--xla_backend_optimization_level=0 --xla_llvm_disable_expensive_passes=true "
    "--xla_cpu_use_fusion_emitters=false --xla_cpu_parallel_codegen_split_count=1"
)

# As variables, for the child processes too; and the process that only hands out tests need not import JAX.
assert "jax" not in sys.modules
os.environ |= {
    # Compiled programs are shared between processes and runs.
    "JAX_COMPILATION_CACHE_DIR": str(Path(__file__).parent.parent / ".pytest_cache" / "jax"),
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    # Ten lines of Python for each operation of a program, which nobody reads, are a tenth of the time.
    "JAX_TRACEBACK_IN_LOCATIONS_LIMIT": "0",
    "JAX_NUMPY_RANK_PROMOTION": "raise",
    "XLA_FLAGS": f"{os.environ.get('XLA_FLAGS', '')} {QUICK}",
}

# Tracing makes so many small objects that looking for garbage after every 700 of them costs a twentieth of the time.
gc.set_threshold(200_000, 20, 20)

# They come first, or one core would have nothing to do while the other ends with one of them. The very first one makes
# what the fixture `trained` gives, for which a process that needs it too would wait.
LONGEST_FILES = (
    "test_resume.py",
    "test_zoo.py",
    "test_ray.py",
    "test_every_preset.py",
    "test_pipeline.py",
    "test_watch.py",
    "test_several_processes.py",
    "test_devices.py",
    "test_identify.py",
    "test_closed_loop.py",
    "test_bench_cli.py",
    "test_walk_through.py",
    "test_faults.py",
)


def pytest_collection_modifyitems(items):
    """The longest files first, the others in the order of the folders."""
    place = {name: k for k, name in enumerate(LONGEST_FILES)}
    items.sort(key=lambda item: place.get(item.path.name, len(place)))


@pytest.fixture(autouse=True, scope="module")
def few_programs():
    """Compiled programs take several memory maps each, and a process may have 65,530: beyond that it dies."""
    yield
    maps = Path("/proc/self/maps")
    if maps.exists() and len(maps.read_bytes().splitlines()) > 15_000:
        import jax

        jax.clear_caches()


@pytest.fixture
def getkey():
    """A function that gives a fresh random key at each call, the same ones in every run."""
    import jax

    keys = iter(jax.random.split(jax.random.key(20220622), 1000))
    return lambda: next(keys)


@pytest.fixture(scope="session")
def trained(tmp_path_factory):
    """A folder to copy: the data set `mine` and a tiny run `whole` of all stages with every checkpoint.

    Made once for all processes of a session: the first one that asks trains, another one waits.
    """
    from keycld.models import config_for
    from keycld.training import finished, train
    from scenes import TINY, write_data

    base = tmp_path_factory.getbasetemp()
    root = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "trained"
    root.mkdir(exist_ok=True)
    with (root.parent / "trained.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not finished(root / "whole"):
            data = write_data(root / "mine")
            train(
                data,
                root / "whole",
                config_for("keycld", "fast", **TINY),
                checkpoint_seconds=0.0,
                log_every=2,
                keep=100,
            )
    return root
