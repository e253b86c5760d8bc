"""Finds systems by name: each module in a folder of this package, or of another package's entry points, adds some."""

import importlib
import pkgutil
from typing import TypeVar

from keycld._entry_points import import_modules, load_entry_points
from keycld._errors import KeycldError, unknown
from keycld.systems.base import AbstractSystem

ENTRY_POINTS = "keycld.systems"
_SYSTEMS: dict[str, AbstractSystem] = {}
S = TypeVar("S", bound=AbstractSystem)


def register(system: type[S]) -> type[S]:
    """Make a system known by its `name`; a class decorator.

    A file with one decorated class, in one of the folders of `keycld/systems/` or in a new one, is all that a new
    system needs. Your own code may use the decorator too, in a module that can be imported: the renderer processes
    import it again.

    Raises:
        KeycldError: the class lacks a method.
    """
    if missing := sorted(getattr(system, "__abstractmethods__", ())):
        raise KeycldError(
            f"the system {system.__name__} in {system.__module__} lacks {', '.join(missing)}: write what is missing as "
            "docs/systems.md shows, or remove the file."
        )
    _SYSTEMS[system.name] = system()
    return system


def _import_systems() -> None:
    """Import every module of every folder, and what installed packages announce; each registers its systems."""
    package = importlib.import_module("keycld.systems")
    for kind in pkgutil.iter_modules(package.__path__, f"{package.__name__}."):
        if kind.ispkg:
            import_modules(kind.name)
    load_entry_points(ENTRY_POINTS, "system")


def names(kind: type[AbstractSystem] = AbstractSystem) -> tuple[str, ...]:
    """Return the names of all systems, or of one kind's, in alphabetical order."""
    _import_systems()
    return tuple(sorted(name for name, system in _SYSTEMS.items() if isinstance(system, kind)))


def get(name: str) -> AbstractSystem:
    """Return the system called `name`.

    Raises:
        KeycldError: there is none; it names the nearest.
    """
    if name not in names():
        raise unknown("system", name, names(), listed="docs/systems.md and docs/datasets.md")
    return _SYSTEMS[name]
