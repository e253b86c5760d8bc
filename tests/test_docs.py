"""The documentation is true: commands parse, links lead somewhere, tables are up to date, examples run."""

import ast
import dataclasses
import functools
import importlib
import re
import runpy
import shlex
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from keycld.cli import main as command_line
from keycld.models import config_for, models, registry
from keycld.training import load_run
from scenes import write_data

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
EXTENDING = (ROOT / "docs" / "extending.md").read_text()
TABLES = runpy.run_path(str(ROOT / "scripts" / "docs_tables.py"))
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```", re.DOTALL | re.MULTILINE)


def commands(page):
    """All `keycld …` lines of a page's code blocks, and those in its text that name more than a verb."""
    text = page.read_text()
    lines = [line.split("  #")[0] for _, block in BLOCK.findall(text) for line in block.splitlines()]
    inline = re.findall(r"`(keycld [^`…|]+)`", BLOCK.sub("", text).replace("\n", " "))
    return [line for line in (*lines, *inline) if line.startswith("keycld ")]


@pytest.fixture
def parse(monkeypatch, tmp_path):
    """The command line, which parses and then does nothing."""

    def idle(function):
        return functools.wraps(function)(lambda *_, **__: None)

    def stubs(verbs):
        return {name: idle(verb) for name, verb in verbs.items()}

    monkeypatch.setattr(command_line, "VERBS", stubs(command_line.VERBS))
    groups = {name: (stubs(verbs), text) for name, (verbs, text) in command_line.GROUPS.items()}
    monkeypatch.setattr(command_line, "GROUPS", groups)
    monkeypatch.setattr(command_line.train, "train", idle(command_line.train.train))
    monkeypatch.chdir(tmp_path)
    return lambda words: command_line.main(words)


@pytest.fixture
def own_models(monkeypatch):
    """Models and presets that a test registers are unknown afterwards."""
    known = {name: dataclasses.replace(entry, presets=dict(entry.presets)) for name, entry in models().items()}
    monkeypatch.setattr(registry, "_MODELS", known)
    yield
    for name in [name for name in sys.modules if name.partition(".")[0] == "keycld_koopman"]:
        del sys.modules[name]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_command_parses(page, parse, monkeypatch, capsys):
    for line in commands(page):
        words = shlex.split(line)[1:]
        if "--config" in words:  # its file is that of a run
            at = words.index("--config")
            words = words[:at] + words[at + 2 :]
        if "koopman" in words:  # of docs/extending.md, with settings of its own: trained below
            continue
        try:
            code = parse(words)
        except SystemExit as stop:
            code = stop.code
        assert not code, f"{page.name}: {line}\n{''.join(capsys.readouterr())}"


def test_a_command_that_does_not_parse_is_found(parse, capsys):
    assert parse(["fly", "pendulum"]) == 2
    for words in (["train", "pendulum", "--vision.step", "3"], ["data", "make"], ["eval"]):
        with pytest.raises(SystemExit) as stop:
            parse(words)
        assert stop.value.code == 2, words


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_lead_to_files_and_headings(page):
    for target in re.findall(r"\]\(([^)#\s]*)(?:#[^)\s]*)?\)", page.read_text()):
        if target and not target.startswith(("http:", "https:")):
            assert (page.parent / target).exists(), f"{page.name}: {target}"
    for target, anchor in re.findall(r"\]\(([^)#\s]*)#([^)\s]*)\)", page.read_text()):
        text = (page.parent / target).read_text() if target else page.read_text()
        headings = [re.sub(r"[^\w -]", "", h.lower()).replace(" ", "-") for h in re.findall(r"^#+ (.*)$", text, re.M)]
        assert anchor in headings, f"{page.name}: {target}#{anchor}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_names_that_pages_import_exist(page):
    for language, block in BLOCK.findall(page.read_text()):
        if language != "python" or "keycld_koopman" in block:
            continue
        for node in ast.walk(ast.parse(block)):
            if isinstance(node, ast.ImportFrom) and node.module.partition(".")[0] == "keycld":
                module = importlib.import_module(node.module)
                for alias in node.names:
                    found = hasattr(module, alias.name) or importlib.import_module(f"{node.module}.{alias.name}")
                    assert found, f"{page.name}: {node.module}.{alias.name}"


@pytest.mark.parametrize("name", TABLES["TABLES"])
def test_tables_are_up_to_date(name):
    file, content = TABLES["TABLES"][name]
    _, table, _ = TABLES["split"]((ROOT / "docs" / file).read_text(), name)
    assert table == content(), f"docs/{file} is out of date: run `{TABLES['COMMAND']}`"


def named_blocks(text):
    """Code blocks by the name of the file that they belong to."""
    return dict(re.findall(r"^`([\w./]+)`:\n\n```\w+\n(.*?)^```", text, re.DOTALL | re.MULTILINE))


def test_the_pages_preset(own_models, tmp_path, monkeypatch):
    (tmp_path / "wide.py").write_text(named_blocks(EXTENDING)["src/keycld/models/keycld/recipes/wide.py"])
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "wide", raising=False)
    importlib.import_module("wide")
    assert config_for("keycld", "wide").settings()["width"] == 32
    assert config_for("keycld-nc", "wide").settings()["vision"]["steps"] == 2000


def test_the_pages_family_in_a_package_of_its_own(own_models, tmp_path, monkeypatch, capsys):
    """Found by its entry point alone; trained, resumed, loaded, and predicting better than its mean frame."""
    blocks = named_blocks(EXTENDING)
    package, facts = tmp_path / "site" / "keycld_koopman", tomllib.loads(blocks["pyproject.toml"])
    package.mkdir(parents=True)
    for name in ("__init__.py", "model.py"):
        (package / name).write_text(blocks[f"keycld_koopman/{name}"])
    installed = tmp_path / "site" / "keycld_koopman-0.1.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: keycld-koopman\nVersion: 0.1\n")
    points = facts["project"]["entry-points"]["keycld.models"]
    (installed / "entry_points.txt").write_text(
        "[keycld.models]\n" + "".join(f"{name} = {value}\n" for name, value in points.items())
    )
    monkeypatch.syspath_prepend(tmp_path / "site")
    monkeypatch.chdir(tmp_path)
    registry._load.cache_clear()

    data = write_data(tmp_path / "disc")
    words = ["train", "disc", "--model", "koopman", "--latent", "4", "--window", "6", "--steps", "60"]
    assert command_line.main(words) == 0
    assert command_line.main(words) == 0  # trained already
    model, config = load_run("runs/disc-koopman-plain-0")
    assert config.settings["latent"] == 4 and models()["koopman"].family == "keycld_koopman"
    lines = (tmp_path / "runs" / "disc-koopman-plain-0" / "metrics.jsonl").read_text().splitlines()
    assert len(lines) >= 2

    assert command_line.main(["eval", "runs/disc-koopman-plain-0"]) == 0, capsys.readouterr().err
    assert (tmp_path / "runs" / "disc-koopman-plain-0" / "evaluation" / "test@50.json").exists() or list(
        (tmp_path / "runs" / "disc-koopman-plain-0" / "evaluation").glob("*.json")
    )
    assert np.isfinite(model.mean).all() and data.exists()
