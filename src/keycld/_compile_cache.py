"""Compiled programs kept between processes: half of the time of a short training is compilation.

Entries are machine code. They are kept for one user, host, kind of processor and version of jaxlib, because entries of
another processor can stop the process.
"""

import contextlib
import hashlib
import importlib.metadata
import os
import platform
import sys
import zlib
from pathlib import Path
from typing import NamedTuple

SWITCH = "KEYCLD_COMPILE_CACHE"
_FOLDER, _SECONDS = "JAX_COMPILATION_CACHE_DIR", "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"
# In seconds: all programs, because the two hundred small ones of a training take five seconds to compile, and 1 MB.
_LEAST = "0"
_LARGEST = 2 * 10**9
_CHECKED = "checked"


class CompileCache(NamedTuple):
    """Where compiled programs are kept.

    Attributes:
        folder: None: nowhere.
        note: why, in words.
    """

    folder: Path | None
    note: str = ""

    @property
    def bytes(self) -> int:
        """The size of its files; there may be thousands."""
        return 0 if self.folder is None else sum(status.st_size for status in _entries(self.folder).values())


def use_compile_cache() -> CompileCache:
    """Let JAX keep compiled programs in the user's cache folder, and read them from there.

    Call it before the first computation; the command line does. The environment variable `KEYCLD_COMPILE_CACHE` is
    `off` for none, or another folder. A folder that is set for JAX itself (`JAX_COMPILATION_CACHE_DIR`) stays. Entries
    that a killed process left incomplete are removed, and the oldest ones where all take more than 2 GB.

    Returns:
        the folder in use, or why there is none.
    """
    found = compile_cache()
    if found.folder is None:
        # JAX's own switch: a folder that is set for JAX is off too.
        os.environ["JAX_ENABLE_COMPILATION_CACHE"] = "false"
        return found
    if os.environ.get(_FOLDER):
        return found
    try:
        found.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = found.folder.stat()
        if status.st_uid != os.getuid() or status.st_mode & 0o022:
            return CompileCache(None, f"others can write to {found.folder}, and its files are programs")
        _tidy(found.folder)
    except OSError as error:
        return CompileCache(None, f"{found.folder} cannot be used: {error.strerror}")
    os.environ[_FOLDER] = str(found.folder)
    os.environ.setdefault(_SECONDS, _LEAST)
    if "jax" in sys.modules:
        config = sys.modules["jax"].config
        config.update("jax_compilation_cache_dir", str(found.folder))
        config.update("jax_persistent_cache_min_compile_time_secs", float(os.environ[_SECONDS]))
    return found


def compile_cache() -> CompileCache:
    """Return the folder that `use_compile_cache` takes, without touching it."""
    wanted = os.environ.get(SWITCH, "")
    if wanted.lower() in ("off", "0", "no", "false"):
        return CompileCache(None, f"switched off by {SWITCH}")
    if os.environ.get(_FOLDER):
        return CompileCache(Path(os.environ[_FOLDER]))
    if not hasattr(os, "getuid"):
        return CompileCache(None, "not on this operating system")
    root = Path(wanted) if wanted else _user_folder()
    return CompileCache(root / _machine())


def _entries(folder: Path) -> dict[Path, os.stat_result]:
    """Return the entries of a folder; another process may remove some meanwhile."""
    found = {}
    for path in folder.glob("*-cache"):
        with contextlib.suppress(OSError):
            found[path] = path.stat()
    return found


def _user_folder() -> Path:
    home = os.environ.get("XDG_CACHE_HOME")
    return (Path(home) if home else Path.home() / ".cache") / "keycld" / "compiled"


def _machine() -> str:
    """Return sixteen hexadecimal digits for host, processor features and version of jaxlib."""
    facts = [platform.node(), platform.machine(), importlib.metadata.version("jaxlib")]
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            facts += next(([line] for line in file if line.startswith(("flags", "Features"))), [])
    except OSError:
        facts.append(platform.processor())
    return hashlib.sha256("\n".join(facts).encode()).hexdigest()[:16]


def _tidy(folder: Path) -> None:
    """Remove entries that are incomplete, and the oldest ones beyond the largest size."""
    mark = folder / _CHECKED
    last = mark.stat().st_mtime if mark.exists() else 0.0
    mark.touch()
    entries = _entries(folder)
    for path, status in entries.items():
        # JAX does not write to a temporary name first. An incomplete entry would never be replaced.
        if status.st_mtime >= last - 1.0 and not _complete(path):
            path.unlink(missing_ok=True)
    room = _LARGEST
    for path, status in sorted(entries.items(), key=lambda entry: -entry[1].st_mtime):
        room -= status.st_size
        if room < 0:
            path.unlink(missing_ok=True)


def _complete(path: Path) -> bool:
    """Return whether a file is a whole zlib stream, as JAX writes it; files in another format count as complete."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return True
    if data[:1] != b"\x78":
        return bool(data)
    stream = zlib.decompressobj()
    try:
        while data:
            # In parts, because an entry grows fifteenfold.
            stream.decompress(data, 2**24)
            data = stream.unconsumed_tail
    except zlib.error:
        return False
    return stream.eof
