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


def check_seed(seed: int) -> None:
    """Refuse a number that NumPy's or JAX's generators do not begin from."""
    if not 0 <= seed < 2**32:
        raise KeycldError(f"a seed is a number from 0 to {2**32 - 1}, not {seed}.")
