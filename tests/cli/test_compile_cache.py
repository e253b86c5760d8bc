"""Compiled programs are kept between processes, and damaged ones do no harm."""

import os
import subprocess
import sys
import zlib
from pathlib import Path

import pytest

from keycld._compile_cache import compile_cache, use_compile_cache

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
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    monkeypatch.setenv("KEYCLD_COMPILE_CACHE", str(tmp_path))
    return tmp_path


def test_a_second_process_reads_what_the_first_compiled(tmp_path):
    first = run(tmp_path)
    assert first.returncode == 0, first.stderr
    kept = {path: path.stat().st_mtime_ns for path in entries(tmp_path)}
    assert kept and run(tmp_path).stdout == first.stdout
    assert {path: path.stat().st_mtime_ns for path in entries(tmp_path)} == kept
    assert entries(tmp_path)[0].parent.stat().st_mode & 0o077 == 0


@pytest.mark.parametrize(
    "damage", [lambda data: data[:-40], lambda data: b"", lambda data: data[:50] + b"x" + data[51:]]
)
def test_a_damaged_entry_is_removed_and_compiled_again(tmp_path, damage):
    first = run(tmp_path)
    for path in entries(tmp_path):
        path.write_bytes(damage(path.read_bytes()))
    again = run(tmp_path)
    # Warnings are errors in that process: JAX would warn of an entry that it cannot read.
    assert again.returncode == 0 and again.stdout == first.stdout, again.stderr
    for path in entries(tmp_path):
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


def test_info_shows_the_folder_and_the_switch_works(tmp_path):
    free = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    free["KEYCLD_COMPILE_CACHE"] = str(tmp_path)
    command = [sys.executable, "-m", "keycld.cli.main", "info"]
    shown = subprocess.run(command, env=free, capture_output=True, text=True, timeout=120).stdout
    assert f"programs    {tmp_path}" in shown
    without = subprocess.run([*command, "--no-compile-cache"], env=free, capture_output=True, text=True, timeout=120)
    assert "programs    none: switched off" in without.stdout
