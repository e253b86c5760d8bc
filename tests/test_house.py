"""The house: rooms import only from rooms below, files stay small, and the core needs no simulator."""

import ast
import importlib
import statistics
import subprocess
import sys
from pathlib import Path

import pytest

import keycld

SOURCE = Path(keycld.__file__).parent
FLOORS = [
    "drawing", "mechanics", "systems", "data", "vision", "stages", "models",
    "evaluation", "training", "control", "benchmarks", "reports", "cli",
]  # fmt: skip
# Modules of the package itself: what all rooms may use, and the package's own page, which stands above them.
GROUND = (
    "_compile_cache", "_entry_points", "_errors", "_ffmpeg", "_files", "_lazy", "_lock", "_progress", "_records",
    "_shares", "_signals", "_version", "_xla_flags",
)  # fmt: skip


def modules() -> dict[str, Path]:
    """Every module by its dotted name."""
    found = {}
    for path in SOURCE.rglob("*.py"):
        parts = ["keycld", *path.relative_to(SOURCE).with_suffix("").parts]
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports(path: Path, known: set[str], *, lazy: bool = True) -> set[str]:
    """Modules of ours that a file imports; without `lazy` only those that are imported with it."""
    found = set()
    tree = ast.parse(path.read_text())
    inner = {id(n) for f in ast.walk(tree) if isinstance(f, ast.FunctionDef) for n in ast.walk(f)}
    inner |= {id(n) for f in ast.walk(tree) if isinstance(f, ast.If) and "TYPE_CHECKING" in ast.dump(f.test)
              for n in ast.walk(f)}  # fmt: skip
    for node in ast.walk(tree):
        if not lazy and id(node) in inner:
            continue
        if isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
            found |= {name if name in known else node.module for name in names}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return found & known


def floor(module: str) -> int:
    """The ground, then the rooms, then the package's own page."""
    parts = module.split(".")
    if len(parts) == 1:
        return len(FLOORS)
    return -1 if parts[1] in GROUND else FLOORS.index(parts[1])


def upward(module: str, path: Path, known: set[str]) -> set[str]:
    return {name for name in imports(path, known) if floor(name) > floor(module)}


@pytest.mark.parametrize("room", [*FLOORS, *GROUND, "keycld"])
def test_a_room_imports_only_from_rooms_below(room):
    found = modules()
    mine = {name: path for name, path in found.items() if room in (*name.split(".")[1:2], name)}
    assert mine
    for name, path in mine.items():
        assert not upward(name, path, set(found)), f"{name} imports upward: {upward(name, path, set(found))}"


def test_reading_imports_notices_an_upward_one(tmp_path):
    path, known = tmp_path / "x.py", {"keycld.cli.main", "keycld", "keycld.data"}
    path.write_text("def f():\n    from keycld.cli import main\n    from keycld import load\n    import keycld.data\n")
    assert imports(path, known) == known
    assert imports(path, known, lazy=False) == set()
    assert upward("keycld.data.x", path, known) == {"keycld.cli.main", "keycld"}


def test_no_module_imports_itself_in_a_circle():
    """Between files, packages' `__init__` files included; a package stands for its members' imports of it."""
    found = modules()
    graph = {name: imports(path, set(found), lazy=False) - {name} for name, path in found.items()}
    # Python runs a package's page before its modules, so what a page imports may not import the page.
    state: dict[str, int] = {}

    def visit(name: str, path: tuple[str, ...]) -> None:
        state[name] = 1
        for other in graph[name]:
            assert state.get(other) != 1, " → ".join([*path[path.index(other) :], other]) if other in path else other
            if other not in state:
                visit(other, (*path, other))
        state[name] = 2

    for name in graph:
        if name not in state:
            visit(name, (name,))


def test_every_folder_is_a_room():
    folders = {p.name for p in SOURCE.iterdir() if p.is_dir() and p.name != "__pycache__"}
    assert folders == {*FLOORS, "weights"}  # trained weights are data, no room
    assert {p.stem for p in SOURCE.glob("*.py")} == {*GROUND, "__init__"}


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


def test_processes_that_render_import_no_jax():
    """They live for seconds, of which JAX would take three."""
    code = (
        "import sys, keycld.data.generate.parts, keycld.systems.worker, keycld.systems.mujoco.pendulum\n"
        "assert 'jax' not in sys.modules"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr


def test_the_processes_around_an_experiment_import_no_models_and_no_plots():
    """`keycld bench` waits for, lists and tabulates what the process of an experiment does: half the time to start."""
    code = (
        "import sys, keycld.benchmarks as b, keycld.benchmarks.child\n"
        "b.run_experiments, b.OnRay, b.suite_named('keycld').select(), b.status_table, b.tables\n"
        "assert not {'equinox', 'matplotlib'} & set(sys.modules)"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr


@pytest.mark.parametrize("room", ["data", "systems", "evaluation", "training", "benchmarks"])
def test_a_page_has_the_names_that_it_promises(room):
    page = importlib.import_module(f"keycld.{room}")
    assert all(getattr(page, name).__name__ == name for name in page.__all__ if not name.isupper())
    with pytest.raises(AttributeError, match=f"'keycld.{room}' has no attribute 'TYPE'"):
        _ = page.TYPE
