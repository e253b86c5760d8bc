"""The documentation is true: commands parse, links lead somewhere, tables are up to date, examples run."""

import ast
import dataclasses
import importlib
import json
import os
import re
import runpy
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from keycld._entry_points import load_entry_points
from keycld.data import open_data
from keycld.evaluation import evaluate, protocol_named
from keycld.models import config_for, models, registry
from keycld.training import finished, load_run, train
from scenes import write_data

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
EXTENDING = ROOT / "docs" / "extending.md"
TABLES = runpy.run_path(str(ROOT / "scripts" / "docs_tables.py"))
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```", re.DOTALL | re.MULTILINE)

# In a process of its own, with verbs that do nothing: shape checks of the tests hide the verbs' types from the parser.
PARSE = """
import contextlib, functools, io, json, sys
import wide
from keycld.cli import main as line

def idle(verb):
    return functools.wraps(verb)(lambda *_, **__: None)

line.VERBS = {name: idle(verb) for name, verb in line.VERBS.items()}
line.GROUPS = {name: ({n: idle(v) for n, v in verbs.items()}, text) for name, (verbs, text) in line.GROUPS.items()}
line.train.train = idle(line.train.train)
wrong = []
for words in json.load(sys.stdin):
    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
        try:
            code = line.main(words)
        except SystemExit as stop:
            code = stop.code
    if code:
        wrong.append([words, said.getvalue()])
print(json.dumps(wrong))
"""


def commands(page):
    """Words of all `keycld …` lines in a page's code blocks, and of those in its text.

    In the text a verb alone asks for help, and what it acts on may be left out.
    """
    text = page.read_text()
    blocks = [line.split("  #")[0] for _, block in BLOCK.findall(text) for line in block.splitlines()]
    inline = re.findall(r"`(keycld [^`…|]+)`", BLOCK.sub("", text).replace("\n", " "))
    for line in (*blocks, *inline):
        if not line.startswith("keycld "):
            continue
        words = shlex.split(line)[1:]
        if "--config" in words:  # the file is a run's
            del words[words.index("--config") : words.index("--config") + 2]
        if line in inline:
            verbs = 1 + (words[0] in ("data", "bench"))
            words = words[:verbs] + (["X"] if words[verbs:] and words[verbs][0] == "-" else []) + words[verbs:]
            words += ["--help"] if len(words) == verbs else []
        yield words


def named_blocks(page):
    """Code blocks by the name of the file that they belong to."""
    return dict(re.findall(r"^`([\w./]+)`:\n\n```\w+\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE))


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A folder of installed packages that holds the preset and the family of docs/extending.md."""
    folder, blocks = tmp_path_factory.mktemp("site"), named_blocks(EXTENDING)
    for name in ("keycld_koopman/__init__.py", "keycld_koopman/model.py"):
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(blocks[name])
    (folder / "wide.py").write_text(blocks["src/keycld/models/keycld/recipes/wide.py"])
    facts = tomllib.loads(blocks["pyproject.toml"])["project"]
    installed = folder / f"keycld_koopman-{facts['version']}.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {facts['name']}\nVersion: {facts['version']}\n")
    points = [f"{name} = {value}" for name, value in facts["entry-points"]["keycld.models"].items()]
    (installed / "entry_points.txt").write_text("\n".join(["[keycld.models]", *points, ""]))
    return folder


@pytest.fixture
def own_models(monkeypatch):
    """Models and presets that a test registers are unknown afterwards."""
    known = {name: dataclasses.replace(entry, presets=dict(entry.presets)) for name, entry in models().items()}
    monkeypatch.setattr(registry, "_MODELS", known)


def parsed(lines, site):
    """Return the command lines that do not parse, each with the answer."""
    paths = os.pathsep.join([str(site), str(ROOT / "src")])
    answer = subprocess.run(
        [sys.executable, "-c", PARSE],
        input=json.dumps(lines), capture_output=True, text=True, check=False, env=os.environ | {"PYTHONPATH": paths},
    )  # fmt: skip
    assert answer.returncode == 0, answer.stderr
    return json.loads(answer.stdout)


def test_every_command_parses(site):
    wrong = parsed([words for page in PAGES for words in commands(page)], site)
    assert not wrong, "\n".join(f"keycld {shlex.join(words)}\n{said}" for words, said in wrong)


def test_commands_that_do_not_parse_are_found(site):
    lines = [["fly", "pendulum"], ["train", "pendulum", "--vision.step", "3"], ["data", "make"], ["eval"]]
    assert [words for words, _ in parsed(lines, site)] == lines


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_lead_to_files_and_headings(page):
    for target, anchor in re.findall(r"\]\((?!https?:)([^)#\s]*)(?:#([^)\s]*))?\)", page.read_text()):
        path = page.parent / target if target else page
        assert path.exists(), f"{page.name}: {target}"
        if anchor:
            headings = re.findall(r"^#+ (.*)$", path.read_text(), re.MULTILINE)
            known = [re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings]
            assert anchor in known, f"{page.name}: {target}#{anchor}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_names_that_pages_import_exist(page):
    for language, block in BLOCK.findall(page.read_text()):
        for node in ast.walk(ast.parse(block)) if language == "python" else ():
            if isinstance(node, ast.ImportFrom) and str(node.module).partition(".")[0] == "keycld":
                module = importlib.import_module(str(node.module))
                for name in node.names:
                    if not hasattr(module, name.name):
                        importlib.import_module(f"{node.module}.{name.name}")


@pytest.mark.parametrize("name", TABLES["TABLES"])
def test_tables_are_up_to_date(name):
    file, content = TABLES["TABLES"][name]
    _, table, _ = TABLES["split"]((ROOT / "docs" / file).read_text(), name)
    assert table == content(), f"docs/{file} is out of date: run `{TABLES['COMMAND']}`"


def test_the_pages_preset(site, own_models, monkeypatch):
    monkeypatch.syspath_prepend(site)
    monkeypatch.delitem(sys.modules, "wide", raising=False)
    importlib.import_module("wide")
    assert config_for("keycld", "wide").settings()["width"] == 32
    assert config_for("keycld-nc", "wide").settings()["vision"]["steps"] == 2000


def test_the_pages_family_in_a_package_of_its_own(site, own_models, tmp_path, monkeypatch):
    """Found by its entry point alone; trains, resumes, is scored, and beats the mean image."""
    monkeypatch.syspath_prepend(site)
    registry._load.cache_clear()
    load_entry_points.cache_clear()
    assert models()["koopman"].family == "keycld_koopman"
    data, run = write_data(tmp_path / "disc"), tmp_path / "run"
    config = config_for("koopman", latent=6, window=4, rate=1e-3, steps=200)
    train(data, run, config)
    assert finished(run)
    again, model = train(data, run, config), load_run(run)[0]
    assert (again.transition == model.transition).all()
    scores = evaluate(model, open_data(data), protocol_named("validation@12")).scores
    assert scores["mse"] < scores["epsilon"]


def pins(lock):
    """Return names and versions of a lock file, each with its hashes, and no index."""
    text = (ROOT / lock).read_text()
    assert "://" not in text
    entries = re.findall(r"^([\w.-]+)==(\S+)( \\\n +--hash=sha256:[0-9a-f]{64})+$", text, re.MULTILINE)
    return {name.lower().replace("_", "-"): version for name, version, _ in entries}


def test_the_lock_files_pin_every_dependency_with_hashes_and_name_no_index():
    needed, all_ = pins("requirements.lock"), pins("requirements-dev.lock")
    assert needed.items() <= all_.items()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    extras = project["project"]["optional-dependencies"]
    package = [*project["build-system"]["requires"], *project["project"]["dependencies"], *extras["envs"]]
    for lock, pinned, wanted in (
        ("requirements.lock", needed, package),
        ("requirements-dev.lock", all_, [*extras["ray"], *extras["symetric"], *extras["lerobot"], *extras["dev"]]),
    ):
        names = {re.match(r"[\w.-]+", each).group().lower().replace("_", "-") for each in wanted}
        assert names <= pinned.keys(), f"not in {lock}: {names - pinned.keys()}; CONTRIBUTING.md has the command for it"
