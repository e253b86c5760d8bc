"""From pixels to inputs: energy shaping, planning, observers, the closed loop, environments.

`keycld.control.environments` registers the Gymnasium environments when it is imported; it alone needs Gymnasium.
"""

from keycld.control.base import AbstractController as AbstractController
from keycld.control.base import Belief as Belief
from keycld.control.base import Idle as Idle
from keycld.control.base import RandomInput as RandomInput
from keycld.control.base import actuators_of as actuators_of
from keycld.control.base import check_limit as check_limit
from keycld.control.base import known_inputs as known_inputs
from keycld.control.base import lagrangian_of as lagrangian_of
from keycld.control.energy_shaping import AbstractShaping as AbstractShaping
from keycld.control.energy_shaping import EnergyShaping as EnergyShaping
from keycld.control.energy_shaping import PaperLaw as PaperLaw
from keycld.control.goal import goal_of as goal_of
from keycld.control.goal import nearest_pose as nearest_pose
from keycld.control.imagination import Imagination as Imagination
from keycld.control.imagination import Imagined as Imagined
from keycld.control.loop import Disturbance as Disturbance
from keycld.control.loop import Flight as Flight
from keycld.control.loop import fly as fly
from keycld.control.lqr import Weights as Weights
from keycld.control.lqr import stationary_gain as stationary_gain
from keycld.control.observer import AbstractObserver as AbstractObserver
from keycld.control.observer import BackwardDifference as BackwardDifference
from keycld.control.observer import PredictCorrect as PredictCorrect
from keycld.control.outcome import outcome as outcome
from keycld.control.outcome import upright as upright
from keycld.control.pilot import Aboard as Aboard
from keycld.control.pilot import Pilot as Pilot
from keycld.control.planning import Plan as Plan
from keycld.control.planning import Planner as Planner
from keycld.control.plant import Plant as Plant
from keycld.control.plant import advance as advance
from keycld.control.registration import register_environments as register_environments
from keycld.control.swing_up import Assignment as Assignment
from keycld.control.swing_up import swing_up as swing_up
from keycld.control.tracking import PlanAndTrack as PlanAndTrack

__all__ = [
    "Aboard",
    "AbstractController",
    "AbstractObserver",
    "AbstractShaping",
    "Assignment",
    "BackwardDifference",
    "Belief",
    "Disturbance",
    "EnergyShaping",
    "Flight",
    "Idle",
    "Imagination",
    "Imagined",
    "PaperLaw",
    "Pilot",
    "Plan",
    "PlanAndTrack",
    "Planner",
    "Plant",
    "PredictCorrect",
    "RandomInput",
    "Weights",
    "actuators_of",
    "advance",
    "check_limit",
    "nearest_pose",
    "fly",
    "goal_of",
    "known_inputs",
    "lagrangian_of",
    "outcome",
    "register_environments",
    "stationary_gain",
    "swing_up",
    "upright",
]
