"""From pixels to inputs: control laws, state estimators, the closed loop, environments.

`keycld.control.environments` registers the Gymnasium environments when it is imported; it alone needs Gymnasium.
"""

from keycld.control.agent import Agent as Agent
from keycld.control.agent import AgentState as AgentState
from keycld.control.base import AbstractController as AbstractController
from keycld.control.base import Belief as Belief
from keycld.control.closed_loop import ClosedLoopRun as ClosedLoopRun
from keycld.control.closed_loop import Disturbance as Disturbance
from keycld.control.closed_loop import run_closed_loop as run_closed_loop
from keycld.control.goal import goal_of as goal_of
from keycld.control.goal import nearest_pose as nearest_pose
from keycld.control.imagination import Imagination as Imagination
from keycld.control.imagination import Imagined as Imagined
from keycld.control.laws.energy_shaping import EnergyShaping as EnergyShaping
from keycld.control.laws.energy_shaping import ShapingLaw as ShapingLaw
from keycld.control.laws.paper import PaperLaw as PaperLaw
from keycld.control.laws.paper import PaperShaping as PaperShaping
from keycld.control.laws.plan_and_track import PlanAndTrack as PlanAndTrack
from keycld.control.laws.plan_and_track import PlanAndTrackLaw as PlanAndTrackLaw
from keycld.control.laws.random import RandomInput as RandomInput
from keycld.control.laws.random import RandomLaw as RandomLaw
from keycld.control.laws.zero import ZeroInput as ZeroInput
from keycld.control.laws.zero import ZeroLaw as ZeroLaw
from keycld.control.lqr import Weights as Weights
from keycld.control.lqr import stationary_gain as stationary_gain
from keycld.control.outcome import outcome as outcome
from keycld.control.outcome import upright as upright
from keycld.control.planning import Plan as Plan
from keycld.control.planning import Planner as Planner
from keycld.control.plant import Plant as Plant
from keycld.control.registration import register_environments as register_environments
from keycld.control.registry import AbstractControlLaw as AbstractControlLaw
from keycld.control.registry import Problem as Problem
from keycld.control.registry import Trust as Trust
from keycld.control.registry import control_laws as control_laws
from keycld.control.registry import law_named as law_named
from keycld.control.registry import register_law as register_law
from keycld.control.requirements import check_limit as check_limit
from keycld.control.shaping import AbstractShaping as AbstractShaping
from keycld.control.state_estimator import AbstractStateEstimator as AbstractStateEstimator
from keycld.control.state_estimator import BackwardDifference as BackwardDifference
from keycld.control.state_estimator import PredictCorrect as PredictCorrect
from keycld.control.swing_up import ControlConfig as ControlConfig
from keycld.control.swing_up import swing_up as swing_up
from keycld.control.swing_up import upright_picture as upright_picture
from keycld.systems import advance as advance

__all__ = [
    "AbstractControlLaw",
    "AbstractController",
    "AbstractShaping",
    "AbstractStateEstimator",
    "Agent",
    "AgentState",
    "BackwardDifference",
    "Belief",
    "ClosedLoopRun",
    "ControlConfig",
    "Disturbance",
    "EnergyShaping",
    "Imagination",
    "Imagined",
    "PaperLaw",
    "PaperShaping",
    "Plan",
    "PlanAndTrack",
    "PlanAndTrackLaw",
    "Planner",
    "Plant",
    "PredictCorrect",
    "Problem",
    "RandomInput",
    "RandomLaw",
    "ShapingLaw",
    "Trust",
    "Weights",
    "ZeroInput",
    "ZeroLaw",
    "advance",
    "check_limit",
    "control_laws",
    "goal_of",
    "law_named",
    "nearest_pose",
    "outcome",
    "register_environments",
    "register_law",
    "run_closed_loop",
    "stationary_gain",
    "swing_up",
    "upright",
    "upright_picture",
]
