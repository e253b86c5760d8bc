"""Finds systems by name: every module in `catalogue/` that registers one is known."""

import importlib
import pkgutil
from typing import TypeVar

from keycld._errors import unknown
from keycld.systems.base import AbstractSystem

_SYSTEMS: dict[str, AbstractSystem] = {}
S = TypeVar("S", bound=AbstractSystem)


def register(system: type[S]) -> type[S]:
    """Class decorator that makes a system known by its `name`.

    A file in `keycld/systems/catalogue/` with one decorated class is all that a new system needs. Your own
    code may use the decorator too, in a module that can be imported (the renderer processes import it
    again).
    """
    _SYSTEMS[system.name] = system()
    return system


def _load_catalogue() -> None:
    package = importlib.import_module("keycld.systems.catalogue")
    for module in pkgutil.iter_modules(package.__path__):
        importlib.import_module(f"{package.__name__}.{module.name}")


def names(kind: type[AbstractSystem] = AbstractSystem) -> tuple[str, ...]:
    """Names of all systems, or of one kind's, in alphabetical order."""
    _load_catalogue()
    return tuple(sorted(name for name, system in _SYSTEMS.items() if isinstance(system, kind)))


def get(name: str) -> AbstractSystem:
    """The system called `name`.

    Raises:
        KeycldError: there is none; it names the nearest.
    """
    if name not in names():
        raise unknown("system", name, names())
    return _SYSTEMS[name]
