"""One call from a trained model to a controlled system: goal, observer, controller, loop, outcome."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from keycld._errors import KeycldError, check_seed, unknown
from keycld.control.base import (
    AbstractController,
    Idle,
    RandomInput,
    actuators_of,
    check_limit,
    lagrangian_of,
)
from keycld.control.energy_shaping import EnergyShaping, PaperLaw
from keycld.control.goal import goal_of, nearest_pose
from keycld.control.loop import Disturbance, fly
from keycld.control.observer import AbstractObserver, BackwardDifference, PredictCorrect
from keycld.control.outcome import outcome
from keycld.control.pilot import Aboard, Pilot
from keycld.control.plant import Plant
from keycld.control.tracking import PlanAndTrack
from keycld.evaluation import Evaluation
from keycld.models.base import AbstractModel
from keycld.systems import AbstractMujocoSystem, AbstractSystem

LAWS = ("shaping", "paper", "mpc", "zero", "random")
OBSERVERS = ("predict-correct", "differences")


@dataclass(frozen=True)
class Assignment:
    """What is to be done and how.

    Attributes:
        law: "shaping" (energy shaping, scale-free), "paper" (eq. 15 to the letter), "mpc" (plan and track), or for
            comparison "zero" and "random".
        kp: stiffness by mass, 1/s².
        kd: damping by mass, 1/s.
        limit: the largest |u|; None for none.
        actuators: names of the inputs that act; None for all.
        seconds: of each flight.
        starts: how many; all positions random (slider in ±1 m), at rest.
        seed: of starts and disturbances.
        observer: "predict-correct" or "differences".
        disturbance: of the pictures.
    """

    law: str = "shaping"
    kp: float = 5.0
    kd: float = 2.0
    limit: float | None = None
    actuators: tuple[str, ...] | None = None
    seconds: float = 10.0
    starts: int = 1
    seed: int = 0
    observer: str = "predict-correct"
    disturbance: Disturbance = field(default_factory=Disturbance)

    def __post_init__(self):
        """Names and numbers within their ranges."""
        if self.law not in LAWS:
            raise unknown("control law", self.law, LAWS)
        if self.observer not in OBSERVERS:
            raise unknown("observer", self.observer, OBSERVERS)
        if not (self.kp > 0 and self.kd > 0):
            raise KeycldError(f"kp and kd are positive numbers, not {self.kp} and {self.kd}.")
        if not (self.seconds >= 0.1 and self.starts >= 1):
            raise KeycldError(f"give at least 0.1 s and one start, not {self.seconds} s and {self.starts}.")
        check_seed(self.seed)


def swing_up(
    model: AbstractModel,
    system: AbstractSystem,
    epsilon: float,
    picture: np.ndarray | None = None,
    assignment: Assignment = Assignment(),
    *,
    progress: Callable[[int, int], None] | None = None,
    workers: int | None = None,
) -> Evaluation:
    """Bring a system to the pose of a picture, from pixels alone, in MuJoCo.

    Args:
        model: trained on it.
        system: simulated by MuJoCo.
        epsilon: ε of the model's data: a goal image that is drawn worse than this shows nothing known.
        picture: uint8 [H, W, 3], the goal; None for the system standing upright.
        assignment: law, gains, limits, starts.
        progress: called with the number of frames done and their total.
        workers: processes that simulate and draw; by default one a core.

    Returns:
        Scores and arrays (`docs/control.md` lists them).

    Raises:
        KeycldError: the model has no Lagrangian, the goal image shows no pose that it knows or that the system can
            reach, or the assignment is not possible.
    """
    if not isinstance(system, AbstractMujocoSystem):
        raise KeycldError(f"{system.name} is not simulated by MuJoCo, so it cannot be controlled here.")
    law = lagrangian_of(model)
    limit = check_limit(assignment.limit)
    actuators = actuators_of(system.input_names, assignment.actuators)
    wanted = upright_picture(system) if picture is None else picture
    goal = goal_of(model, wanted, epsilon)
    pilot = Pilot(model, _observer(model, system.dt, assignment), _controller(law, goal, system, assignment), limit)

    def on_first(aboard: Aboard) -> None:
        """Refuse a goal out of reach; one with shared constants was refused before."""
        for k in np.flatnonzero(np.asarray(aboard.belief.sightings)):
            nearest_pose(model, goal, aboard.belief.state.parameters["constants"][k])

    random = np.random.RandomState(assignment.seed)
    positions = np.stack([system.positions(random, slider_limit=1.0) for _ in range(assignment.starts)])
    flight = fly(
        pilot,
        system,
        np.concatenate([positions, np.zeros_like(positions)], axis=1),
        assignment.seconds,
        disturbance=assignment.disturbance,
        seed=assignment.seed,
        on_first=on_first,
        progress=progress,
        workers=workers,
    )
    settings: dict[str, Any] = asdict(assignment)
    settings |= {
        "goal": "upright" if picture is None else "image",
        "inputs": system.input_names,
        "acting": [system.input_names[k] for k in actuators],
    }
    return outcome(flight, system, pilot, np.asarray(goal), wanted, stands=picture is None, settings=settings)


def upright_picture(system: AbstractMujocoSystem) -> np.ndarray:
    """The goal image of `picture=None`: all links upright, at rest, a slider in the middle."""
    with Plant(system, np.zeros((1, len(system.state_names))), workers=1) as plant:
        return plant.look()[0]


def _observer(model: AbstractModel, dt: float, assignment: Assignment) -> AbstractObserver:
    law = lagrangian_of(model)
    if assignment.observer == "differences":
        return BackwardDifference(law, dt)
    dynamics, constants = model.dynamics, model.constants  # pyright: ignore[reportAttributeAccessIssue]
    if assignment.law == "mpc":
        # A plan trusts the dynamics, and errors of velocity are what it cannot mend.
        return PredictCorrect(law, dynamics, dt, acceleration_error=1.0, adaptation=0.0, constants=constants)
    return PredictCorrect(law, dynamics, dt, constants=constants)


def _controller(law: Any, goal: Any, system: AbstractMujocoSystem, assignment: Assignment) -> AbstractController:
    actuators, inputs = actuators_of(system.input_names, assignment.actuators), len(system.input_names)
    limit = check_limit(assignment.limit)
    if assignment.law == "mpc":
        return PlanAndTrack.towards(law, goal, actuators, limit, system.dt)
    if assignment.law == "zero":
        return Idle(inputs)
    if assignment.law == "random":
        if not np.isfinite(limit):
            raise KeycldError("random inputs need a limit: give one, such as --limit 3.")
        return RandomInput(inputs, actuators, limit, assignment.seed)
    kind = EnergyShaping if assignment.law == "shaping" else PaperLaw
    return kind(law, goal, actuators, assignment.kp, assignment.kd)
