"""The house: rooms import only from rooms below, files stay small, and the core needs no simulator."""

import ast
import statistics
import subprocess
import sys
from pathlib import Path

import pytest

import keycld

SOURCE = Path(keycld.__file__).parent
FLOORS = [
    "drawing", "mechanics", "systems", "data", "vision", "models",
    "evaluation", "training", "control", "benchmarks", "reports", "cli",
]  # fmt: skip


def imported_rooms(path: Path) -> set[str]:
    rooms = set()
    for node in ast.walk(ast.parse(path.read_text())):
        names = []
        if isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module] if node.level == 0 else []
            names += [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        rooms |= {n.split(".")[1] for n in names if n.startswith("keycld.") and n.split(".")[1] in FLOORS}
    return rooms


@pytest.mark.parametrize("room", FLOORS)
def test_a_room_imports_only_from_rooms_below(room):
    allowed = set(FLOORS[: FLOORS.index(room) + 1])
    for path in (SOURCE / room).rglob("*.py"):
        upward = imported_rooms(path) - allowed
        assert not upward, f"{path.relative_to(SOURCE)} imports upward from {upward}"


def test_reading_imports_notices_an_upward_one(tmp_path):
    path = tmp_path / "x.py"
    path.write_text("def f():\n    from keycld.cli import main\n")
    assert imported_rooms(path) == {"cli"}


def test_every_folder_is_a_room():
    assert {p.name for p in SOURCE.iterdir() if p.is_dir() and p.name != "__pycache__"} == set(FLOORS)


def test_files_are_small():
    lengths = {path: len(path.read_text().splitlines()) for path in SOURCE.rglob("*.py")}
    assert max(lengths.values()) <= 600, max(lengths, key=lengths.__getitem__)
    assert statistics.median(lengths.values()) < 200


def test_every_room_imports_without_mujoco_and_gymnasium():
    """In a fresh process where importing either fails."""
    code = (
        "import sys\n"
        "sys.modules['mujoco'] = sys.modules['gymnasium'] = None\n"
        "import importlib\n"
        f"for room in {FLOORS!r}: importlib.import_module('keycld.' + room)\n"
        "import keycld.cli.main\n"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr


def test_help_imports_no_jax():
    """Half a second for `keycld --help` leaves no room for JAX, which alone takes longer."""
    code = "import sys, keycld.cli.main\nassert not {'jax', 'matplotlib', 'mujoco'} & set(sys.modules)"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr
