"""Execute an example and write it as a notebook: python scripts/notebook.py examples/inside_a_model.py.

The example is a Python file in the percent format: `# %%` begins a cell of code, `# %% [markdown]` one of text. Its
cells hold plain Python, so this needs no Jupyter: what they print and what a last expression returns is their output.
"""

import ast
import base64
import contextlib
import io
import json
import sys
from pathlib import Path
from typing import Any, NamedTuple

from PIL import Image


class Cell(NamedTuple):
    """A cell of a notebook."""

    kind: str
    source: str


def cells(text: str) -> list[Cell]:
    """Split a file in the percent format into its cells; what precedes the first one is left out."""
    found = []
    for part in ("\n" + text).split("\n# %%")[1:]:
        head, _, body = part.partition("\n")
        if head.strip() == "[markdown]":
            body = "\n".join(line.removeprefix("#").removeprefix(" ") for line in body.strip().splitlines())
            found.append(Cell("markdown", body))
        else:
            found.append(Cell("code", body.strip()))
    return found


def execute(source: str, namespace: dict[str, Any]) -> list[dict[str, Any]]:
    """Execute a cell of code and return its outputs: what it prints, and the value of a last expression."""
    body = ast.parse(source).body
    last = body.pop() if isinstance(body[-1], ast.Expr) else None
    value = None
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(compile(ast.Module(body, type_ignores=[]), "<cell>", "exec"), namespace)
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), "<cell>", "eval"), namespace)
    outputs = []
    if printed.getvalue():
        outputs.append(
            {"output_type": "stream", "name": "stdout", "text": printed.getvalue().splitlines(keepends=True)}
        )
    if value is not None:
        outputs.append({"output_type": "display_data", "data": _shown(value), "metadata": {}})
    return outputs


def _shown(value: Any) -> dict[str, Any]:
    if not isinstance(value, Image.Image):
        return {"text/plain": [repr(value)]}
    with io.BytesIO() as buffer:
        value.save(buffer, "png", optimize=True)
        return {"image/png": base64.b64encode(buffer.getvalue()).decode()}


def notebook(text: str, namespace: dict[str, Any]) -> dict[str, Any]:
    """Execute all cells of an example in `namespace`, and return them with their outputs in the format of Jupyter."""
    written = []
    for number, cell in enumerate(cells(text)):
        entry = {"cell_type": cell.kind, "id": f"cell-{number}", "metadata": {}}
        if cell.kind == "code":
            outputs = execute(cell.source, namespace)
            entry |= {"execution_count": None, "outputs": outputs}
        written.append(entry | {"source": cell.source.splitlines(keepends=True)})
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    metadata = {"kernelspec": kernel, "language_info": {"name": "python"}}
    return {"cells": written, "metadata": metadata, "nbformat": 4, "nbformat_minor": 5}


if __name__ == "__main__":
    path = Path(sys.argv[1])
    made = notebook(path.read_text(), {})
    path.with_suffix(".ipynb").write_text(json.dumps(made, indent=1, ensure_ascii=False) + "\n")
