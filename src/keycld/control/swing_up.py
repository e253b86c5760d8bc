"""One call from a trained model to a controlled system: goal, state estimator, controller, closed loop, scores."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from keycld._errors import KeycldError, check_seed, unknown
from keycld.control.agent import Agent, AgentState
from keycld.control.closed_loop import Disturbance, run_closed_loop
from keycld.control.goal import goal_of, nearest_pose
from keycld.control.laws.energy_shaping import ShapingLaw
from keycld.control.outcome import outcome
from keycld.control.plant import Plant
from keycld.control.registry import AbstractControlLaw, Problem, Trust
from keycld.control.requirements import check_limit, plant_inputs, positions_of, require
from keycld.control.state_estimator import AbstractStateEstimator, BackwardDifference, PredictCorrect
from keycld.evaluation import Evaluation
from keycld.models.base import AbstractModel, HasKeypoints, HasLagrangian
from keycld.systems import AbstractMujocoSystem, AbstractSystem

ESTIMATORS = ("predict-correct", "differences")
# Seconds of a trial, and trials: all frames of all trials are kept in memory.
_LONGEST, _MOST = 3600, 10_000


@dataclasses.dataclass(frozen=True)
class ControlConfig:
    """Everything that decides a closed-loop run, apart from model, system and goal.

    Attributes:
        law: the control law with its settings, such as `ShapingLaw(kp=8.0)`; `law_named` finds one by name.
        limit: the largest |u|; None for none.
        actuators: names of the inputs that act; None for all that the model knows.
        seconds: duration.
        trials: how many initial states; all positions are random (slider in ±1 m), at rest.
        seed: of initial states, disturbances and random inputs.
        estimator: the state estimator, "predict-correct" or "differences".
        disturbance: of the pictures.

    Raises:
        KeycldError: a name or number is out of its range.
    """

    law: AbstractControlLaw = ShapingLaw()
    limit: float | None = None
    actuators: tuple[str, ...] | None = None
    seconds: float = 10.0
    trials: int = 1
    seed: int = 0
    estimator: str = "predict-correct"
    disturbance: Disturbance = Disturbance()

    def __post_init__(self):
        """Check names and numbers."""
        if self.estimator not in ESTIMATORS:
            raise unknown("state estimator", self.estimator, ESTIMATORS)
        if not 0.1 <= self.seconds <= _LONGEST:
            raise KeycldError(f"--seconds is a number from 0.1 to {_LONGEST}, not {self.seconds:g}.")
        if not 1 <= self.trials <= _MOST:
            raise KeycldError(f"--trials is a number from 1 to {_MOST}, not {self.trials}.")
        check_seed(self.seed)

    def as_dict(self) -> dict[str, Any]:
        """Return all fields for JSON; `law` is the name of the law."""
        fields = dataclasses.asdict(self)
        return {**fields, "law": self.law.name, "law_settings": fields["law"]}


def swing_up(
    model: AbstractModel,
    system: AbstractSystem,
    epsilon: float,
    picture: np.ndarray | None = None,
    config: ControlConfig = ControlConfig(),
    *,
    input_names: tuple[str, ...] | None = None,
    progress: Callable[[int, int], None] | None = None,
    workers: int | None = None,
) -> Evaluation:
    """Bring a system to the pose of a picture, from pixels alone, in MuJoCo.

    Args:
        model: trained on it, with keypoints and a Lagrangian.
        system: simulated by MuJoCo.
        epsilon: ε of the model's data: a goal image that the model renders worse than this is refused.
        picture: uint8 [H, W, 3], the goal; None for the system standing upright.
        config: law, limits, trials.
        input_names: of the inputs in the model's training data, which are those that the model knows; the system's
            other inputs stay zero. None: all inputs of the system.
        progress: called with the number of frames done and their total.
        workers: processes that simulate and render; by default one a core.

    Returns:
        Scores and arrays (`docs/control.md` lists them).

    Raises:
        KeycldError: the model has no Lagrangian, no keypoints or no inputs; the goal image shows no pose that it knows
            or that the system can reach; or the law cannot solve the problem.
    """
    if not isinstance(system, AbstractMujocoSystem):
        raise KeycldError(
            f"{system.name} cannot be controlled here: choose a system such as pendulum, cartpole or acrobot."
        )
    lagrangian, keypoint_model = require(model, HasLagrangian), require(model, HasKeypoints)
    names = system.input_names if input_names is None else input_names
    inputs = plant_inputs(lagrangian, names, system)
    actuators, limit = positions_of(names, config.actuators), check_limit(config.limit)
    goal_picture = upright_picture(system) if picture is None else picture
    goal = goal_of(model, goal_picture, epsilon)
    problem = Problem(lagrangian.law, goal, actuators, limit, system.dt, config.seed)
    estimator = _state_estimator(lagrangian, system.dt, config.estimator, config.law.trust)
    agent = Agent(keypoint_model, estimator, config.law.controller(problem), limit)

    def on_first(state: AgentState) -> None:
        """Refuse a goal out of reach of a copy with constants of its own; shared ones are known before."""
        if lagrangian.constants is not None:
            return
        for k in np.flatnonzero(np.asarray(state.belief.observations)):
            nearest_pose(lagrangian, goal, state.belief.state.parameters["constants"][k])

    random = np.random.RandomState(config.seed)
    positions = np.stack([system.positions(random, slider_limit=1.0) for _ in range(config.trials)])
    run = run_closed_loop(
        agent,
        system,
        np.concatenate([positions, np.zeros_like(positions)], axis=1),
        config.seconds,
        inputs=inputs,
        disturbance=config.disturbance,
        seed=config.seed,
        on_first=on_first,
        progress=progress,
        workers=workers,
    )
    settings = config.as_dict() | {
        "goal": "upright" if picture is None else "image",
        "inputs": system.input_names,
        "acting": [names[k] for k in actuators],
    }
    return outcome(
        run, system, agent, inputs, np.asarray(goal), goal_picture, to_upright=picture is None, settings=settings
    )


def upright_picture(system: AbstractMujocoSystem) -> np.ndarray:
    """Return the default goal image: all links upright, at rest, a slider in the middle; uint8 [H, W, 3]."""
    with Plant(system, np.zeros((1, len(system.state_names))), workers=1) as plant:
        return plant.look()[0]


def _state_estimator(lagrangian: HasLagrangian, dt: float, name: str, trust: Trust) -> AbstractStateEstimator:
    if name == "differences":
        return BackwardDifference(lagrangian.law, dt)
    return PredictCorrect(lagrangian.law, lagrangian.dynamics, dt, *trust, constants=lagrangian.constants)
