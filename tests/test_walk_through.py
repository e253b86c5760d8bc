"""The walk-through of a trained model runs as a notebook, shows the right physics, and is committed as it is."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parent.parent
EXAMPLE = ROOT / "examples" / "inside_a_model.py"


def script():
    spec = importlib.util.spec_from_file_location("notebook", ROOT / "scripts" / "notebook.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    """The notebook made anew, and the names that its cells define."""
    names = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("walk"))
        return script().notebook(EXAMPLE.read_text(), names), names


def outputs(notebook):
    return [[output["output_type"] for output in cell.get("outputs", [])] for cell in notebook["cells"]]


@pytest.mark.slow
def test_the_committed_notebook_is_that_of_the_example(walk):
    committed = json.loads(EXAMPLE.with_suffix(".ipynb").read_text())
    told = "the notebook is out of date: python scripts/notebook.py examples/inside_a_model.py"
    assert [cell["source"] for cell in committed["cells"]] == [cell["source"] for cell in walk[0]["cells"]], told
    assert outputs(committed) == outputs(walk[0]), told
    assert sum(kinds.count("display_data") for kinds in outputs(committed)) == 3
    assert EXAMPLE.with_suffix(".ipynb").stat().st_size < 300_000


@pytest.mark.slow
def test_what_it_shows_is_true(walk):
    names = walk[1]
    # V of the stretched arm that turns once is that of gravity, V(π) (1 − cos) / 2.
    energy, angles = np.asarray(names["energy"]), np.asarray(names["angles"])
    np.testing.assert_allclose(energy, energy[4] * (1 - np.cos(angles)) / 2, atol=0.01 * energy[4])
    assert names["error"] < 1e-5  # there and back
    assert names["variation"] < 1e-5  # of the welded arm's reach
    assert np.all(np.asarray(names["lengths"]).std(0) < 0.02)
    # Predicted pictures are nearer to the true ones than the first frame is.
    truth, predicted = np.asarray(names["frames"]), np.asarray(names["predicted"].frames)
    assert np.mean((predicted - truth) ** 2) < 0.2 * np.mean((truth[0] - truth) ** 2)


def test_a_cell_prints_and_returns_like_in_jupyter():
    made = script().notebook(
        '"""Head."""\n\n# %% [markdown]\n# A *text*\n#\n# here.\n\n# %%\nx = 2\nprint(x)\nx + 1\n', {}
    )
    text, code = made["cells"]
    assert text["cell_type"] == "markdown" and "".join(text["source"]) == "A *text*\n\nhere."
    printed, value = code["outputs"]
    assert printed["text"] == ["2\n"] and value["data"] == {"text/plain": ["3"]}
