"""Extensions in packages of their own, which register themselves when they are imported."""

from importlib import metadata

from keycld._errors import KeycldError


def load_entry_points(group: str, what: str) -> None:
    """Import what installed packages announce as entry points of a group.

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
