"""Simulators and their pictures, each with its suggested keypoints and constraints."""

from typing import TYPE_CHECKING

from keycld._lazy import lazily
from keycld.systems.base import AbstractMechanism as AbstractMechanism
from keycld.systems.base import AbstractSystem as AbstractSystem
from keycld.systems.base import Conditions as Conditions
from keycld.systems.base import Run as Run
from keycld.systems.base import SweepPath as SweepPath
from keycld.systems.mujoco.advancing import advance as advance
from keycld.systems.mujoco.advancing import advance_in_worker as advance_in_worker
from keycld.systems.mujoco.base import AbstractMujocoSystem as AbstractMujocoSystem
from keycld.systems.mujoco.mechanism import AbstractWatchedMechanism as AbstractWatchedMechanism
from keycld.systems.mujoco.rendering import is_software as is_software
from keycld.systems.mujoco.rendering import renderer_name as renderer_name
from keycld.systems.pictures import Pictures as Pictures
from keycld.systems.pictures import render as render
from keycld.systems.pictures import render_in_worker as render_in_worker
from keycld.systems.processes import Task as Task
from keycld.systems.processes import Workers as Workers
from keycld.systems.processes import check_workers as check_workers
from keycld.systems.processes import run_in_processes as run_in_processes
from keycld.systems.registry import get as get
from keycld.systems.registry import names as names
from keycld.systems.registry import register as register

if TYPE_CHECKING:
    # With JAX, which the processes that render would import for seconds.
    from keycld.systems.discs import soft_discs as soft_discs
    from keycld.systems.initial_values import AbstractInitialValueSystem as AbstractInitialValueSystem
    from keycld.systems.rendered import AbstractRenderedSystem as AbstractRenderedSystem
    from keycld.systems.rendered import to_bytes as to_bytes
    from keycld.systems.sampled import AbstractSampledSystem as AbstractSampledSystem
    from keycld.systems.sampled import Recording as Recording
    from keycld.systems.sampled import in_single_precision as in_single_precision
    from keycld.systems.sampled import numbers_only as numbers_only

__getattr__ = lazily(__name__)

__all__ = [
    "AbstractRenderedSystem",
    "AbstractInitialValueSystem",
    "AbstractMechanism",
    "AbstractMujocoSystem",
    "AbstractSampledSystem",
    "AbstractSystem",
    "AbstractWatchedMechanism",
    "Conditions",
    "Pictures",
    "Recording",
    "Run",
    "SweepPath",
    "Task",
    "Workers",
    "advance",
    "advance_in_worker",
    "check_workers",
    "render",
    "render_in_worker",
    "get",
    "in_single_precision",
    "is_software",
    "names",
    "numbers_only",
    "register",
    "renderer_name",
    "run_in_processes",
    "soft_discs",
    "to_bytes",
]
