"""Trajectories on disk: format, generation, import, description, and sampling of clips."""

from typing import TYPE_CHECKING

from keycld._lazy import lazily

if TYPE_CHECKING:
    # The processes that make data import what they need of this, without JAX.
    from keycld.data.dataset import DataSet as DataSet
    from keycld.data.dataset import open_data as open_data
    from keycld.data.describe.movies import show as show
    from keycld.data.describe.normalised_error import normalised_errors as normalised_errors
    from keycld.data.describe.statistics import image_statistics as image_statistics
    from keycld.data.format.check import check as check
    from keycld.data.format.derived import with_derivative as with_derivative
    from keycld.data.format.derived import with_pictures as with_pictures
    from keycld.data.format.folder import finished as finished
    from keycld.data.format.folder import read_statistics as read_statistics
    from keycld.data.format.folder import sha256 as sha256
    from keycld.data.format.hdf5 import open_file as open_file
    from keycld.data.format.reading import read as read
    from keycld.data.format.trajectories import Trajectories as Trajectories
    from keycld.data.format.writing import write as write
    from keycld.data.generate.job import Made as Made
    from keycld.data.generate.job import Progress as Progress
    from keycld.data.generate.make import ProgressBar as ProgressBar
    from keycld.data.generate.make import make_data as make_data
    from keycld.data.generate.protocols import PROTOCOLS as PROTOCOLS
    from keycld.data.generate.sweeps import Sweep as Sweep
    from keycld.data.imports.camera import Seen as Seen
    from keycld.data.imports.camera import camera_frames as camera_frames
    from keycld.data.imports.clip import ImportedClip as ImportedClip
    from keycld.data.imports.clip import before_test as before_test
    from keycld.data.imports.clip import changes_of as changes_of
    from keycld.data.imports.clip import import_clip as import_clip
    from keycld.data.imports.clip import is_clip as is_clip
    from keycld.data.imports.exposure import Usual as Usual
    from keycld.data.imports.exposure import usual_for as usual_for
    from keycld.data.imports.same_camera import clip_file as clip_file
    from keycld.data.imports.suite import import_suite as import_suite
    from keycld.data.imports.video import import_video as import_video
    from keycld.data.sample.clips import Clip as Clip
    from keycld.data.sample.rendered_later import RenderedLater as RenderedLater
    from keycld.data.sample.resident import Resident as Resident
    from keycld.data.sample.resident import resident as resident
    from keycld.data.sample.samplers import AbstractSampler as AbstractSampler
    from keycld.data.sample.samplers import FrameGroups as FrameGroups
    from keycld.data.sample.samplers import RandomFrames as RandomFrames
    from keycld.data.sample.samplers import WholeTrajectories as WholeTrajectories
    from keycld.data.sample.samplers import Windows as Windows
    from keycld.data.sample.training_data import TrainingData as TrainingData

__getattr__ = lazily(__name__)

__all__ = [
    "PROTOCOLS",
    "AbstractSampler",
    "Clip",
    "DataSet",
    "RenderedLater",
    "Made",
    "Progress",
    "ProgressBar",
    "RandomFrames",
    "Resident",
    "Seen",
    "FrameGroups",
    "ImportedClip",
    "Sweep",
    "TrainingData",
    "Trajectories",
    "Usual",
    "WholeTrajectories",
    "Windows",
    "before_test",
    "camera_frames",
    "changes_of",
    "check",
    "clip_file",
    "finished",
    "image_statistics",
    "import_clip",
    "import_suite",
    "import_video",
    "is_clip",
    "make_data",
    "normalised_errors",
    "open_data",
    "open_file",
    "read",
    "resident",
    "sha256",
    "show",
    "usual_for",
    "with_derivative",
    "with_pictures",
    "write",
]
