"""The one training loop: stages, presets, checkpoints, run folder, trackers."""

from keycld.training.presets import PRESETS as PRESETS
from keycld.training.presets import AbstractRecipe as AbstractRecipe
from keycld.training.presets import FastRecipe as FastRecipe
from keycld.training.presets import PaperRecipe as PaperRecipe
from keycld.training.presets import Scene as Scene
from keycld.training.progress import Bar as Bar
from keycld.training.run_folder import RunConfig as RunConfig
from keycld.training.run_folder import environment as environment
from keycld.training.run_folder import read_config as read_config
from keycld.training.stages import Stage as Stage
from keycld.training.train import finished as finished
from keycld.training.train import load_run as load_run
from keycld.training.train import make_recipe as make_recipe
from keycld.training.train import train as train

__all__ = [
    "PRESETS",
    "AbstractRecipe",
    "Bar",
    "FastRecipe",
    "PaperRecipe",
    "RunConfig",
    "Scene",
    "Stage",
    "environment",
    "finished",
    "load_run",
    "make_recipe",
    "read_config",
    "train",
]
