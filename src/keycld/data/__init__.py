"""Trajectories on disk: format, validator, the papers' protocols, import of videos."""

from keycld.data.check import check as check
from keycld.data.clips import AbstractSampler as AbstractSampler
from keycld.data.clips import Clip as Clip
from keycld.data.clips import RandomFrames as RandomFrames
from keycld.data.clips import Resident as Resident
from keycld.data.clips import StartGroups as StartGroups
from keycld.data.clips import TrainingData as TrainingData
from keycld.data.clips import WholeTrajectories as WholeTrajectories
from keycld.data.clips import resident as resident
from keycld.data.dataset import DataSet as DataSet
from keycld.data.dataset import open_data as open_data
from keycld.data.dataset import unfinished as unfinished
from keycld.data.drawn import DrawnLater as DrawnLater
from keycld.data.drawn import with_derivative as with_derivative
from keycld.data.drawn import with_pictures as with_pictures
from keycld.data.import_suite import import_suite as import_suite
from keycld.data.importing import import_video as import_video
from keycld.data.make import Made as Made
from keycld.data.make import Progress as Progress
from keycld.data.make import make_data as make_data
from keycld.data.movies import show as show
from keycld.data.protocols import PROTOCOLS as PROTOCOLS
from keycld.data.statistics import image_statistics as image_statistics
from keycld.data.statistics import sha256 as sha256
from keycld.data.store import Trajectories as Trajectories
from keycld.data.store import open_file as open_file
from keycld.data.store import read as read
from keycld.data.store import write as write
from keycld.data.sweeps import Sweep as Sweep

__all__ = [
    "PROTOCOLS",
    "AbstractSampler",
    "Clip",
    "DataSet",
    "DrawnLater",
    "Made",
    "Progress",
    "RandomFrames",
    "Resident",
    "StartGroups",
    "Sweep",
    "Trajectories",
    "TrainingData",
    "WholeTrajectories",
    "check",
    "image_statistics",
    "import_suite",
    "import_video",
    "make_data",
    "open_data",
    "open_file",
    "read",
    "resident",
    "sha256",
    "show",
    "unfinished",
    "with_derivative",
    "with_pictures",
    "write",
]
