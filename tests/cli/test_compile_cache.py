"""Compiled programs are kept between processes, and damaged ones do no harm."""

import os
import shutil
import subprocess
import sys
import zlib
from pathlib import Path

import pytest

from keycld._compile_cache import compile_cache, use_compile_cache
from keycld.cli.main import main

COMPILES = """
import sys, time
from keycld._compile_cache import use_compile_cache
found = use_compile_cache()
import jax, jax.numpy as jnp
print(float(jax.jit(lambda x: jnp.linalg.cholesky(x @ x.T + jnp.eye(3)).sum())(jnp.ones((3, 3)))), found.folder)
"""


def run(cache, code=COMPILES):
    free = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    settings = {"KEYCLD_COMPILE_CACHE": str(cache), "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    return subprocess.run(
        [sys.executable, "-W", "error", "-c", code], env=free | settings, capture_output=True, text=True, timeout=120
    )


def entries(cache):
    return sorted(cache.glob("*/*-cache"))


@pytest.fixture
def alone(monkeypatch, tmp_path):
    # Else JAX in this process would take the folder too, and keep nothing for the other tests.
    monkeypatch.delitem(sys.modules, "jax", raising=False)
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    monkeypatch.setenv("KEYCLD_COMPILE_CACHE", str(tmp_path))
    return tmp_path


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    """A process that compiled, and the cache that it left."""
    cache = tmp_path_factory.mktemp("cache")
    answer = run(cache)
    assert answer.returncode == 0, answer.stderr
    return answer, cache


@pytest.fixture
def cache(first, tmp_path):
    """A copy of that cache."""
    return shutil.copytree(first[1], tmp_path / "cache")


def test_a_second_process_reads_what_the_first_compiled(first):
    answer, cache = first
    kept = {path: path.stat().st_mtime_ns for path in entries(cache)}
    assert kept and run(cache).stdout == answer.stdout
    assert {path: path.stat().st_mtime_ns for path in entries(cache)} == kept
    assert entries(cache)[0].parent.stat().st_mode & 0o077 == 0


@pytest.mark.parametrize(
    "damage", [lambda data: data[:-40], lambda data: b"", lambda data: data[:50] + b"x" + data[51:]]
)
def test_a_damaged_entry_is_removed_and_compiled_again(first, cache, damage):
    assert entries(cache)
    for path in entries(cache):
        path.write_bytes(damage(path.read_bytes()))
    again = run(cache)
    # Warnings are errors in that process: JAX would warn of an entry that it cannot read.
    assert again.returncode == 0 and again.stdout.split()[0] == first[0].stdout.split()[0], again.stderr
    for path in entries(cache):
        zlib.decompress(path.read_bytes())


def test_the_oldest_entries_go_first(alone, monkeypatch):
    monkeypatch.setattr("keycld._compile_cache._LARGEST", 250)
    folder = compile_cache().folder
    folder.mkdir(mode=0o700)
    for k in range(4):
        (folder / f"{k}-cache").write_bytes(bytes([1]) * 100)
        os.utime(folder / f"{k}-cache", (1e9 + k, 1e9 + k))
    monkeypatch.setattr("os.environ", dict(os.environ))
    use_compile_cache()
    assert [path.name for path in sorted(folder.glob("*-cache"))] == ["2-cache", "3-cache"]


def test_a_folder_that_others_can_write_to_is_not_used(alone):
    folder = compile_cache().folder
    folder.mkdir()
    folder.chmod(0o777)
    assert use_compile_cache().folder is None and "others can write" in use_compile_cache().note


def test_an_entry_that_another_process_removes_meanwhile_does_no_harm(alone):
    """A link without a target is listed but cannot be read, like a file removed after the listing."""
    folder = compile_cache().folder
    folder.mkdir(mode=0o700)
    (folder / "gone-cache").symlink_to(folder / "nothing")
    assert compile_cache().bytes == 0


def test_off_and_jaxs_own_setting(alone, monkeypatch):
    monkeypatch.setenv("KEYCLD_COMPILE_CACHE", "off")
    assert compile_cache().folder is None
    monkeypatch.setenv("KEYCLD_COMPILE_CACHE", str(alone))
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", "/somewhere")
    assert compile_cache().folder == Path("/somewhere")


def test_info_shows_the_folder_and_the_switch_works(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr("os.environ", {**os.environ, "JAX_COMPILATION_CACHE_DIR": str(tmp_path)})
    assert main(["info"]) == 0
    assert f"programs    {tmp_path}" in capsys.readouterr().out
    assert main(["info", "--no-compile-cache"]) == 0
    assert "programs    none: switched off" in capsys.readouterr().out
