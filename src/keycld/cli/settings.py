"""Settings in the form NAME=VALUE, for verbs where they are not flags."""

from typing import Any

from keycld._errors import KeycldError


def parse_setting(text: str) -> tuple[str, Any]:
    """Return name and value of a setting such as `joint.horizons=8,16`.

    Raises:
        KeycldError: the text has no `=`.
    """
    name, equals, value = text.partition("=")
    if not equals:
        raise KeycldError(f"--set takes NAME=VALUE, not '{text}'.")
    values = [_number(part) for part in value.split(",") if part]
    return name.replace("-", "_"), values[0] if len(values) == 1 and "," not in value else values


def as_flag(text: str) -> str:
    """Return a setting such as `joint.horizons=8,16` as it is written where settings are flags."""
    name, _, value = text.partition("=")
    name = name.replace("_", "-")
    switch = {"true": f"--{name}", "false": f"--no-{name}"}
    return switch.get(value.lower(), " ".join(filter(None, [f"--{name}", *value.split(",")])))


def _number(text: str) -> Any:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return {"true": True, "false": False}.get(text.lower(), text)
