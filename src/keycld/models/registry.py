"""The registry of models and presets: each folder of `keycld.models` and each entry point registers its own."""

import dataclasses
import functools
import importlib
import pkgutil
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from keycld._entry_points import import_modules, load_entry_points
from keycld._errors import KeycldError, unknown
from keycld.models.config import ModelConfig

ENTRY_POINTS = "keycld.models"
DEFAULT_PRESET = "fast"
C = TypeVar("C", bound=ModelConfig)


@dataclasses.dataclass
class ModelEntry:
    """A registered model.

    Attributes:
        name: such as `keycld` or `hgn`.
        family: the folder or the package that registers it.
        title: one line about what it is.
        presets: its configs by the name of the preset.
    """

    name: str
    family: str
    title: str
    presets: dict[str, ModelConfig] = dataclasses.field(default_factory=dict)

    @property
    def default(self) -> str:
        """The preset that is used where none is named: `fast` if there is one, else the first."""
        return DEFAULT_PRESET if DEFAULT_PRESET in self.presets else next(iter(self.presets))


_MODELS: dict[str, ModelEntry] = {}


def register_model(name: str, *, family: str, title: str) -> None:
    """Register a model; `register_preset` then adds its presets.

    Args:
        name: of the model.
        family: the folder or the package that it belongs to.
        title: one line about what it is.

    Raises:
        KeycldError: another family has taken the name.
    """
    if name in _MODELS and _MODELS[name].family != family:
        raise KeycldError(f"the model name '{name}' of {family} is taken by {_MODELS[name].family}: choose another.")
    _MODELS.setdefault(name, ModelEntry(name, family, title))


def register_preset(preset: str, *models: str) -> Callable[[type[C]], type[C]]:
    """Return a class decorator that registers a config class as the preset `preset` of some registered models."""

    def add(config: type[C]) -> type[C]:
        for model in models:
            _MODELS[model].presets[preset] = config(model=model, preset=preset)
        return config

    return add


def find_presets(package: str) -> None:
    """Import every module of a package, such as a family's `recipes`, so that each registers its presets."""
    import_modules(package)


@functools.cache
def _load() -> None:
    package = importlib.import_module("keycld.models")
    for module in pkgutil.iter_modules(package.__path__):
        if module.ispkg:
            importlib.import_module(f"{package.__name__}.{module.name}")
    load_entry_points(ENTRY_POINTS, "model family")


def models() -> Mapping[str, ModelEntry]:
    """Return all registered models by name."""
    _load()
    # By family: whoever imports one of them first must not change the order.
    known = sorted(_MODELS.values(), key=lambda entry: entry.family)
    return {entry.name: entry for entry in known if entry.presets}


def config_for(model: str = "keycld", preset: str | None = None, **settings: Any) -> ModelConfig:
    """Return the config of a model's preset, with some settings changed.

    ```python
    config_for("keycld", "fast", vision={"steps": 500}, width=24)
    ```

    Args:
        model: name of the model.
        preset: name of its preset; by default `fast`, or the first that the model has.
        settings: as for `ModelConfig.changed`.

    Raises:
        KeycldError: there is no such model, preset or setting; names the nearest one.
    """
    known = models()
    if model not in known:
        raise unknown("model", model, known, listed="`keycld models`")
    entry = known[model]
    name = preset or entry.default
    if name not in entry.presets:
        raise unknown("preset", name, entry.presets, of=f"model '{model}'")
    return entry.presets[name].changed(settings)
