"""Whole recipes by name."""

from keycld._errors import unknown
from keycld.training.presets.base import MODELS as MODELS
from keycld.training.presets.base import AbstractRecipe as AbstractRecipe
from keycld.training.presets.base import Scene as Scene
from keycld.training.presets.control import ControlRecipe as ControlRecipe
from keycld.training.presets.fast import FastRecipe as FastRecipe
from keycld.training.presets.journal import JournalRecipe as JournalRecipe
from keycld.training.presets.paper import PaperRecipe as PaperRecipe

PRESETS: dict[str, type[AbstractRecipe]] = {
    "fast": FastRecipe,
    "control": ControlRecipe,
    "paper": PaperRecipe,
    "journal": JournalRecipe,
}


def recipe_class(name: str) -> type[AbstractRecipe]:
    """The recipe of a preset, whose fields are its settings."""
    if name not in PRESETS:
        raise unknown("preset", name, PRESETS)
    return PRESETS[name]


__all__ = [
    "MODELS",
    "PRESETS",
    "AbstractRecipe",
    "ControlRecipe",
    "FastRecipe",
    "JournalRecipe",
    "PaperRecipe",
    "Scene",
    "recipe_class",
]
