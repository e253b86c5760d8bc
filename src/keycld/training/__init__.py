"""Training: the loop, checkpoints, run folder, trackers. It uses configs, scenes and stages, and knows no family."""

from typing import TYPE_CHECKING

from keycld._lazy import lazily
from keycld._progress import Bar as Bar
from keycld._progress import Counted as Counted

if TYPE_CHECKING:
    # Commands that only read run folders import what they need of this, without models.
    from keycld.training.packaged import data_folder as data_folder
    from keycld.training.packaged import load_model as load_model
    from keycld.training.packaged import pack as pack
    from keycld.training.packaged import pretrained as pretrained
    from keycld.training.packaged import run_folder as run_folder
    from keycld.training.processes import join as join
    from keycld.training.run_files import RunConfig as RunConfig
    from keycld.training.run_files import environment as environment
    from keycld.training.run_files import parse_config as parse_config
    from keycld.training.run_files import read_config as read_config
    from keycld.training.run_files import read_verdict as read_verdict
    from keycld.training.runs import finished as finished
    from keycld.training.runs import load_run as load_run
    from keycld.training.runs import train as train
    from keycld.training.together import Member as Member
    from keycld.training.together import Together as Together

__getattr__ = lazily(__name__)

__all__ = [
    "Bar",
    "Counted",
    "Member",
    "RunConfig",
    "Together",
    "data_folder",
    "environment",
    "finished",
    "join",
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
