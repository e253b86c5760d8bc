"""What an installed package adds is known to every command: a kind of constraint, a force and a control law."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
CONSTRAINTS = """
keypoints = ["left", "right"]
[[constraint]]
kind = "rope"
between = ["left", "right"]
pulleys = [[-0.5, 0.8], [0.5, 0.8]]
"""


def block(page, start):
    """Return the first block of code of a page that has this text."""
    return next(
        found for found in re.findall(r"```python\n(.*?)```", (DOCS / page).read_text(), re.DOTALL) if start in found
    )


@pytest.fixture
def site(tmp_path):
    (tmp_path / "rope.py").write_text(block("constraints.md", "class Rope"))
    (tmp_path / "wind.py").write_text(block("mechanics.md", "class Wind"))
    (tmp_path / "push.py").write_text(block("control.md", "class PushLaw"))
    installed = tmp_path / "mine-0.1.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 0.1\n")
    groups = {"relations": "rope", "forces": "wind", "laws": "push"}
    lines = [f"[keycld.{group}]\n{module} = {module}\n" for group, module in groups.items()]
    (installed / "entry_points.txt").write_text("\n".join(lines))
    return tmp_path


def run(site, code):
    paths = os.pathsep.join([str(site), *sys.path])
    command = [sys.executable, "-c", code]
    return subprocess.run(command, env={**os.environ, "PYTHONPATH": paths}, capture_output=True, text=True, check=False)


def test_they_are_known(site):
    (site / "weights.toml").write_text(CONSTRAINTS)
    answer = run(
        site,
        "from keycld.control import control_laws\n"
        "from keycld.mechanics import load_constraints, term_kinds\n"
        f"assert load_constraints({str(site / 'weights.toml')!r}).keypoints == ('left', 'right')\n"
        "assert 'wind' in term_kinds() and 'push' in control_laws()",
    )
    assert answer.returncode == 0, answer.stderr


def test_help_lists_a_law_of_a_package_without_importing_it(site):
    (site / "push.py").write_text("import nothing_of")
    answer = run(site, "from keycld.cli.control import law_titles; print(law_titles())")
    assert answer.stdout.splitlines()[-1] == "push: In the installed module push.", answer


@pytest.mark.slow
def test_a_law_is_an_option_and_a_module_that_cannot_be_imported_is_named(site):
    start = "import sys; sys.argv[1:] = ['control', 'pendulum', '--law', {!r}]; "
    start += "from keycld.cli.start import entry; entry()"
    unknown = run(site, start.format("pusch"))
    assert unknown.returncode == 2 and "did you mean 'push'" in unknown.stderr, unknown
    (site / "push.py").write_text("import nothing_of")
    broken = run(site, start.format("push"))
    assert broken.returncode == 2
    assert "the control law 'push' of push cannot be loaded (No module named 'nothing_of')" in broken.stderr, broken
