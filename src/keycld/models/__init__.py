"""Configs of models, and the registry that finds them by name. Needs no JAX; `keycld.models.base` has the contract."""

from keycld.models.config import ModelConfig as ModelConfig
from keycld.models.registry import ModelEntry as ModelEntry
from keycld.models.registry import config_for as config_for
from keycld.models.registry import find_presets as find_presets
from keycld.models.registry import models as models
from keycld.models.registry import register_model as register_model
from keycld.models.registry import register_preset as register_preset
from keycld.models.scene import Scene as Scene

__all__ = [
    "ModelConfig",
    "ModelEntry",
    "Scene",
    "config_for",
    "find_presets",
    "models",
    "register_model",
    "register_preset",
]
