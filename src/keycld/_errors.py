"""The error for mistakes that a user can fix."""

import difflib
import math
from collections.abc import Iterable


class KeycldError(ValueError):
    """A mistake that the user can fix; the message is one sentence with the rule, the value found and the fix.

    The command line prints it without a traceback and exits with code 2.
    """


def unknown(kind: str, name: str, choices: Iterable[str]) -> KeycldError:
    """Return the error for an unknown name; it proposes the nearest valid one.

    Args:
        kind: what the name should name, such as "model".
        name: the unknown name.
        choices: the valid names.
    """
    names = sorted(choices)
    near = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    hint = f"did you mean '{near[0]}'? " if near else ""
    return KeycldError(f"unknown {kind} '{name}': {hint}choose from {', '.join(names)}.")


def check_seed(seed: int) -> None:
    """Refuse a number that is no seed of both NumPy's and JAX's generators.

    Raises:
        KeycldError: it is out of range.
    """
    if not 0 <= seed < 2**32:
        raise KeycldError(f"a seed is a number from 0 to {2**32 - 1}, not {seed}.")


def check_minutes(minutes: float | None) -> None:
    """Refuse a time that is not positive; None is no limit.

    Raises:
        KeycldError: names the option.
    """
    if minutes is not None and not (minutes > 0 and math.isfinite(minutes)):
        raise KeycldError(f"--minutes is a positive number, not {minutes:g}.")
