"""The config of a model: a frozen dataclass of settings that builds the model and its stages. Needs no JAX."""

import abc
import dataclasses
import json
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, get_type_hints

import tyro

from keycld._errors import KeycldError, unknown
from keycld._records import Unexpected, checked
from keycld.models.scene import Scene

if TYPE_CHECKING:
    from jaxtyping import PRNGKeyArray

    from keycld.models.base import AbstractModel
    from keycld.stages import Stage

_LARGEST, _LARGEST_COUNT = 1e12, 2**31 - 1


@dataclasses.dataclass(frozen=True)
class ModelConfig(abc.ABC):
    """All settings of a model and its training, except data and seed; saved as a whole in a run's `config.json`.

    Every field has a default and one line of documentation, which `keycld train --help` prints. A field is a number, a
    bool, a string, None, a tuple of these, or another frozen dataclass of such fields.
    """

    RENAMED: ClassVar[Mapping[str, str]] = {}
    """Old prefixes of weight names, with the current ones: each renamed field has an entry here."""
    ADDED: ClassVar[Mapping[str, float]] = {}
    """Arrays that earlier versions did not save, by name, with the value that they get."""
    HALF: ClassVar[tuple[str, ...]] = ()
    """Prefixes of the names of weights that a packaged model may hold in half precision."""

    model: Annotated[str, tyro.conf.Suppress]
    """Name of the model in the registry: see `keycld models`."""
    preset: Annotated[str, tyro.conf.Suppress]
    """Name of the recipe."""

    def __post_init__(self) -> None:
        """Refuse numbers that are negative or not finite; a subclass with more checks calls this first."""
        _check_numbers(self, "")

    @property
    @abc.abstractmethod
    def context(self) -> int:
        """How many given frames a prediction needs."""

    @abc.abstractmethod
    def build(self, scene: Scene, key: "PRNGKeyArray") -> "AbstractModel":
        """Build the model with random initial weights."""

    @abc.abstractmethod
    def stages(self, scene: Scene) -> "tuple[Stage, ...]":
        """Return the stages of the training, in order."""

    def completed(self, source: Any = None) -> "ModelConfig":
        """Return the config with what it takes from a data set or system, such as constraints.

        Args:
            source: the data set or system. None: an example, enough to build the model and count its parameters.
        """
        return self

    def shortened(self, share: float) -> "ModelConfig":
        """Return the config with a share of its optimiser steps: of each setting `steps` or `epochs`, at least one."""
        return _shortened(self, share)

    def refusal(self, source: Any) -> str | None:
        """Return in a few words what a data set or system lacks for this model, None where it has everything."""
        return None

    def matching(self, model: "AbstractModel") -> "ModelConfig":
        """Return the config that builds models of this one's structure, which a stage may have changed."""
        return self

    def migrated(self, settings: Mapping[str, Any], version: int) -> Mapping[str, Any]:
        """Return settings that were saved under an earlier `schema_version` in the current form."""
        return settings

    def settings(self) -> dict[str, Any]:
        """Return all fields except model and preset as JSON values."""
        fields = json.loads(json.dumps(dataclasses.asdict(self)))
        return {name: value for name, value in fields.items() if name not in ("model", "preset")}

    def changed(self, settings: Mapping[str, Any]) -> "ModelConfig":
        """Return the config with some settings replaced.

        Args:
            settings: values by field name; a mapping for a field that is itself a group of settings. A dotted name,
                such as `"vision.steps"`, reaches into a group.

        Raises:
            KeycldError: an unknown name, with the nearest valid one, or a value of another type.
        """
        return _changed(self, _nested(settings), f"preset '{self.preset}'", "")


def _shortened(config: Any, share: float) -> Any:
    fields = {field.name: getattr(config, field.name) for field in dataclasses.fields(config)}
    groups = {name: _shortened(value, share) for name, value in fields.items() if dataclasses.is_dataclass(value)}
    lengths = {name: max(1, round(share * fields[name])) for name in ("steps", "epochs") if fields.get(name)}
    return dataclasses.replace(config, **groups, **lengths)


def at_least_one(config: Any, *names: str) -> None:
    """Refuse a setting below 1.

    Raises:
        KeycldError: names the setting.
    """
    for name in names:
        if getattr(config, name) < 1:
            raise KeycldError(f"setting {name} is at least 1, not {getattr(config, name)}.")


def _nested(settings: Mapping[str, Any]) -> dict[str, Any]:
    nested: dict[str, Any] = {}
    for name, value in settings.items():
        head, dot, rest = name.partition(".")
        if dot:
            value = {rest: value}
        if isinstance(value, Mapping):
            value = {**nested.get(head, {}), **_nested(value)} if isinstance(nested.get(head, {}), dict) else value
        nested[head] = value
    return nested


def _changed(config: Any, settings: Mapping[str, Any], what: str, prefix: str) -> Any:
    fields = {field.name: getattr(config, field.name) for field in dataclasses.fields(config)}
    kinds = get_type_hints(type(config))
    values = {}
    for name, value in settings.items():
        if name not in fields:
            raise unknown("setting", prefix + name, _names(config, prefix), of=what, listed="docs/training.md")
        old = fields[name]
        if dataclasses.is_dataclass(old):
            if not isinstance(value, Mapping):
                raise KeycldError(f"setting {prefix}{name} of {what} is a group: set {prefix}{name}.NAME.")
            values[name] = _changed(old, value, what, f"{prefix}{name}.")
        else:
            values[name] = _checked(value, old, kinds[name], f"setting {prefix}{name} of {what}")
    return dataclasses.replace(config, **values)


def _names(config: Any, prefix: str) -> list[str]:
    found = []
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value):
            found += _names(value, f"{prefix}{field.name}.")
        else:
            found.append(prefix + field.name)
    return found


def _checked(value: Any, old: Any, kind: Any, what: str) -> Any:
    """Return the value as the type of its field; one number stands for a list of one."""
    wanted = tuple(value) if isinstance(value, list) else value
    if isinstance(old, tuple) and not isinstance(wanted, tuple):
        wanted = (wanted,)
    found, fits = None, True
    try:
        found = checked(wanted, kind)
    except Unexpected:
        fits = False
    if not fits or (found == () and old):
        words = f"takes a {type(old).__name__} such as {old}, not" if old not in (None, ()) else "does not take"
        raise KeycldError(f"{what} {words} {value!r}.")
    return found


def _check_numbers(config: Any, prefix: str) -> None:
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            _check_numbers(value, f"{prefix}{field.name}.")
            continue
        if value == () and isinstance(field.default, tuple) and field.default:
            raise KeycldError(f"setting {prefix}{field.name} is one value or more, such as {field.default}, not none.")
        for part in value if isinstance(value, tuple) else (value,):
            if not isinstance(part, (int, float)):
                continue
            if not (part >= 0 and math.isfinite(part)):
                raise KeycldError(f"setting {prefix}{field.name} is a finite number of at least 0, not {part}.")
            # Beyond these, squares and reciprocals in single precision, or counts in 32 bits, are lost.
            if part > (_LARGEST_COUNT if isinstance(part, int) else _LARGEST) or 0 < part < 1 / _LARGEST:
                raise KeycldError(
                    f"setting {prefix}{field.name} is 0 or between 1e-12 and 1e12, a count below 2^31, not {part}."
                )
