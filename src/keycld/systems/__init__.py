"""Simulators and their pictures, each with its suggested keypoints and constraints."""

from keycld.systems.base import AbstractSystem as AbstractSystem
from keycld.systems.base import Conditions as Conditions
from keycld.systems.base import Run as Run
from keycld.systems.base import SweepPath as SweepPath
from keycld.systems.drawing import Pictures as Pictures
from keycld.systems.drawing import draw as draw
from keycld.systems.drawing import draw_in_worker as draw_in_worker
from keycld.systems.drawing import renderer_name as renderer_name
from keycld.systems.mujoco_system import AbstractMujocoSystem as AbstractMujocoSystem
from keycld.systems.processes import Task as Task
from keycld.systems.processes import run_in_processes as run_in_processes
from keycld.systems.registry import get as get
from keycld.systems.registry import names as names
from keycld.systems.registry import register as register
from keycld.systems.rendering import is_software as is_software

__all__ = [
    "AbstractMujocoSystem",
    "AbstractSystem",
    "Conditions",
    "Pictures",
    "Run",
    "SweepPath",
    "Task",
    "draw",
    "draw_in_worker",
    "get",
    "is_software",
    "names",
    "register",
    "renderer_name",
    "run_in_processes",
]
