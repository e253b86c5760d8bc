"""The one training loop: stages, presets, checkpoints, run folder, trackers."""

from keycld.training.presets import MODELS as MODELS
from keycld.training.presets import PRESETS as PRESETS
from keycld.training.presets import AbstractRecipe as AbstractRecipe
from keycld.training.presets import FastRecipe as FastRecipe
from keycld.training.presets import JournalRecipe as JournalRecipe
from keycld.training.presets import PaperRecipe as PaperRecipe
from keycld.training.presets import Scene as Scene
from keycld.training.pretrained import load_model as load_model
from keycld.training.pretrained import pack as pack
from keycld.training.pretrained import pretrained as pretrained
from keycld.training.pretrained import run_folder as run_folder
from keycld.training.progress import Bar as Bar
from keycld.training.progress import Counted as Counted
from keycld.training.run_folder import RunConfig as RunConfig
from keycld.training.run_folder import environment as environment
from keycld.training.run_folder import read_config as read_config
from keycld.training.stages import Stage as Stage
from keycld.training.train import finished as finished
from keycld.training.train import load_run as load_run
from keycld.training.train import make_recipe as make_recipe
from keycld.training.train import train as train

__all__ = [
    "MODELS",
    "PRESETS",
    "AbstractRecipe",
    "Bar",
    "Counted",
    "FastRecipe",
    "JournalRecipe",
    "PaperRecipe",
    "RunConfig",
    "Scene",
    "Stage",
    "environment",
    "finished",
    "load_model",
    "load_run",
    "make_recipe",
    "pack",
    "pretrained",
    "read_config",
    "run_folder",
    "train",
]
