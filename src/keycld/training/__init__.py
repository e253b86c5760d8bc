"""Training: the loop, checkpoints, run folder, trackers. It uses configs, scenes and stages, and knows no family."""

from keycld._progress import Bar as Bar
from keycld._progress import Counted as Counted
from keycld.training.pretrained import load_model as load_model
from keycld.training.pretrained import pack as pack
from keycld.training.pretrained import pretrained as pretrained
from keycld.training.pretrained import run_folder as run_folder
from keycld.training.run_folder import RunConfig as RunConfig
from keycld.training.run_folder import environment as environment
from keycld.training.run_folder import parse_config as parse_config
from keycld.training.run_folder import read_config as read_config
from keycld.training.run_folder import read_verdict as read_verdict
from keycld.training.train import finished as finished
from keycld.training.train import load_run as load_run
from keycld.training.train import train as train

__all__ = [
    "Bar",
    "Counted",
    "RunConfig",
    "environment",
    "finished",
    "load_model",
    "load_run",
    "pack",
    "parse_config",
    "pretrained",
    "read_config",
    "read_verdict",
    "run_folder",
    "train",
]
