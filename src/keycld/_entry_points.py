"""Extensions, which register themselves when they are imported: modules of a folder, and packages of their own."""

import functools
import importlib
import pkgutil
from importlib import metadata

from keycld._errors import KeycldError


def import_modules(package: str) -> None:
    """Import every module of a package, such as `"keycld.control.laws"`."""
    for module in pkgutil.iter_modules(importlib.import_module(package).__path__, f"{package}."):
        importlib.import_module(module.name)


@functools.cache
def load_entry_points(group: str, what: str) -> None:
    """Import what installed packages announce as entry points of a group, once.

    Args:
        group: such as `"keycld.models"`.
        what: what each of them is, for the error.

    Raises:
        KeycldError: one of them cannot be imported.
    """
    for point in metadata.entry_points(group=group):
        try:
            point.load()
        except Exception as error:
            # A sentence of ours has a fix of its own, after a colon.
            reason = str(error).partition(": ")[0] if isinstance(error, KeycldError) else error
            raise KeycldError(
                f"the {what} '{point.name}' of {point.value} cannot be loaded ({reason}): fix or uninstall it."
            ) from error
