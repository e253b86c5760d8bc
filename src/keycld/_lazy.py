"""Names that a package imports when they are first used: a process that needs no JAX does not wait for it."""

import ast
import importlib
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any


def lazily(package: str) -> Callable[[str], Any]:
    """Return the `__getattr__` of a package's `__init__.py`.

    It finds the names that the file imports, under `if TYPE_CHECKING:` and so for readers and type checkers alone, and
    imports one when it is asked for.

    Args:
        package: its `__name__`.
    """
    file = sys.modules[package].__file__
    assert file is not None
    imports = [node for node in ast.walk(ast.parse(Path(file).read_text())) if isinstance(node, ast.ImportFrom)]
    homes = {alias.name: node.module for node in imports for alias in node.names}

    def find(name: str) -> Any:
        home = homes.get(name)
        if home is None or not home.startswith(f"{package}."):
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(importlib.import_module(home), name)
        setattr(sys.modules[package], name, value)
        return value

    return find
