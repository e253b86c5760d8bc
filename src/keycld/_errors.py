"""The one kind of error that a user can mend."""

import difflib
from collections.abc import Iterable


class KeycldError(ValueError):
    """A mistake that the user can mend: one sentence with the rule, the value found and the mend.

    The command line prints it without a traceback and exits with code 2.
    """


def unknown(kind: str, name: str, choices: Iterable[str]) -> KeycldError:
    """The error for a name that no registry holds; it proposes the nearest valid one."""
    names = sorted(choices)
    near = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    hint = f"did you mean '{near[0]}'? " if near else ""
    return KeycldError(f"unknown {kind} '{name}': {hint}choose from {', '.join(names)}.")
