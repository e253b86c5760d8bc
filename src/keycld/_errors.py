"""The error for mistakes that a user can fix."""

import difflib
import math
from collections.abc import Iterable

_MOST_NAMED, _FEW = 8, 3


class KeycldError(ValueError):
    """A mistake that the user can fix; the message is one sentence with the rule, the value found and the fix.

    The command line prints it without a traceback and exits with code 2.
    """


def unknown(kind: str, name: str, choices: Iterable[str], *, of: str = "", listed: str = "") -> KeycldError:
    """Return the error for an unknown name; it proposes the nearest valid one, or says which there are.

    Args:
        kind: what the name should name, such as "model".
        name: the unknown name.
        choices: the valid names. Those with dots, such as settings in groups, are also known by their last part.
        of: what the name should belong to, such as "preset 'fast'".
        listed: the command or page that lists all names, of which the sentence has a few where there are many.
    """
    names = sorted(choices)
    what = f"unknown {kind} '{name}'" + (f" of {of}" if of else "")
    if near := difflib.get_close_matches(name, names, n=1, cutoff=0.5):
        return KeycldError(f"{what}: did you mean '{near[0]}'?")
    last = {choice.rpartition(".")[2]: choice for choice in reversed(names)}
    if near := difflib.get_close_matches(name.rpartition(".")[2], last, n=1, cutoff=0.8):
        return KeycldError(f"{what}: did you mean '{last[near[0]]}'?")
    if listed and len(names) > _MOST_NAMED:
        return KeycldError(f"{what}: choose from {', '.join(names[:_FEW])}, … (all {len(names)}: {listed}).")
    return KeycldError(f"{what}: choose from {', '.join(names)}.")


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
