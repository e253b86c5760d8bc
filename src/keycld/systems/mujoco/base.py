"""Systems simulated by MuJoCo: the runs of KeyCLD's protocol, from seeds."""

import abc
import inspect
import math
from contextlib import AbstractContextManager
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from keycld.systems.base import AbstractMechanism, Conditions, Run, StateRenderer
from keycld.systems.mujoco.loading import import_mujoco, load_model
from keycld.systems.mujoco.rendering import MujocoRenderer

# Half of MuJoCo's default vertical field of view, 45 degrees.
_HALF_VIEW = math.radians(22.5)
_ZERO_INPUT_PROBABILITY = 0.2
# Initial states near upright: their share, and their deviation in radians and metres; that of velocities is 1 a second.
_UPRIGHT_PROBABILITY = 0.5
_UPRIGHT_SPREAD = 0.2
# Step of the random walk as a part of the limit: it crosses its range in about 50 frames.
_WALK = 0.15


@lru_cache(maxsize=8)
def _simulated_model(file: Path, clip: bool) -> Any:
    model = load_model(file)
    model.actuator_ctrllimited[:] = clip
    return model


class AbstractMujocoSystem(AbstractMechanism):
    """A system whose state is MuJoCo's (qpos, qvel), seen by a camera that looks along +y with z up.

    M(q) q̈ + c(q, q̇) = τ(q) + G u, without damping: MuJoCo's own equations for the model file. Positions are
    metres and radians, energies joules. Source: KeyCLD (arXiv 2206.11030), appendix A.6, and dm_control's suite.

    Attributes:
        camera_height: of the fixed camera, metres.
        camera_distance: of the fixed camera from the plane of motion, metres.
    """

    initial_states: ClassVar[tuple[str, ...]] = ("rest", "random", "upright", "released")
    input_range: ClassVar[float] = 3.0
    camera_height: ClassVar[float]
    camera_distance: ClassVar[float]

    @property
    def model_file(self) -> Path:
        """The MJCF file: NAME.xml next to the module of the class; camera 0 is the one that is rendered."""
        return Path(inspect.getfile(type(self))).with_name(f"{self.name}.xml")

    @abc.abstractmethod
    def rest(self, random: np.random.RandomState) -> tuple[np.ndarray, np.ndarray]:
        """Sample positions and velocities as dm_control's reset of the swing-up task does."""

    @abc.abstractmethod
    def positions(self, random: np.random.RandomState, slider_limit: float) -> np.ndarray:
        """Sample positions anywhere: angles uniform in ±π, a slider in ± its limit (metres)."""

    @property
    def control_modes(self) -> tuple[str, ...]:
        """All modes; `"under"` and the names of single motors exist where there are two."""
        return ("none", "full") if len(self.input_names) == 1 else ("none", "under", "full", *self.input_names)

    def to_image_plane(self, points: np.ndarray) -> np.ndarray:
        """Return the image-plane coordinates of world points `[..., 2]` = (x, z) in the plane y = 0, metres."""
        half_height = self.camera_distance * math.tan(_HALF_VIEW)
        # The edges of the picture are at ±1 of the view, the centres of its outermost pixels half a pixel
        # inside.
        scale = self.size / (self.size - 1) / half_height
        return (points - np.array([0.0, self.camera_height])) * scale

    def _input(self, random: np.random.RandomState, conditions: Conditions) -> np.ndarray:
        limit = conditions.input_limit
        u = random.uniform(-limit, limit, size=len(self.input_names))
        chosen = {"none": (), "under": self.input_names[:1], "full": self.input_names}
        acting = chosen.get(conditions.control, (conditions.control,))
        idle = (acting or conditions.idle_number) and random.uniform() < _ZERO_INPUT_PROBABILITY
        u[[idle or name not in acting for name in self.input_names]] = 0.0
        return u

    def _initial_state(self, random: np.random.RandomState, conditions: Conditions) -> tuple[np.ndarray, np.ndarray]:
        if conditions.initial_state == "released":
            position = self.positions(random, slider_limit=0.5)
            return position, np.zeros_like(position)
        position, velocity = self.rest(random)
        if conditions.initial_state == "upright" and random.uniform() < _UPRIGHT_PROBABILITY:
            return _UPRIGHT_SPREAD * random.randn(len(position)), random.randn(len(velocity))
        if conditions.initial_state in ("random", "upright"):
            position = self.positions(random, slider_limit=1.0)
            velocity = random.uniform(-0.1, 0.1, size=velocity.shape)
        return position, velocity

    def record(self, random: np.random.RandomState, frames: int, conditions: Conditions) -> Run:
        """Simulate one run from random numbers that are taken in a fixed order.

        The order: the input; one number that sets it to zero below 0.2 (not where no input acts and `idle_number` is
        False); the initial state; the steps of a random walk.
        """
        self.check(conditions)
        u = self._input(random, conditions)
        state = np.concatenate(self._initial_state(random, conditions))
        if conditions.input == "constant":
            return self.simulate(state, u, frames, clip=conditions.clip)
        # Frame 0 is seen after the first step, so the input from frame k to k + 1 is the one of step k + 2.
        walk = random_walk(random, u, frames + 1, conditions.input_limit)
        run = self.simulate(state, walk[:-1], frames, clip=conditions.clip)
        return run._replace(input=walk[1:])

    def simulate(self, state: np.ndarray, u: np.ndarray, frames: int, *, clip: bool = True) -> Run:
        """Simulate the motion from `state [d]` under `u`, `[l]` constant or `[frames, l]` held from frame to frame.

        One physics step a frame, as in the paper; the first frame is the state **after** the first step.
        """
        mujoco = import_mujoco()
        model = _simulated_model(self.model_file, clip)
        data, probe = mujoco.MjData(model), mujoco.MjData(model)
        n = model.nq
        data.qpos[:], data.qvel[:] = state[:n], state[n:]
        inputs = np.broadcast_to(u, (frames, model.nu))
        time, states, derivatives = np.empty(frames), np.empty((frames, 2 * n)), np.empty((frames, 2 * n))
        for k in range(frames):
            data.ctrl[:] = inputs[k]
            mujoco.mj_step(model, data)
            time[k], states[k] = data.time, np.concatenate([data.qpos, data.qvel])
            # After a step qacc still belongs to the state before it, so a second MjData evaluates it afresh.
            probe.qpos[:], probe.qvel[:], probe.ctrl[:] = data.qpos, data.qvel, data.ctrl
            mujoco.mj_forward(model, probe)
            derivatives[k] = np.concatenate([probe.qvel, probe.qacc])
        return Run(time, np.array(u, dtype=float), states, derivatives)

    @abc.abstractmethod
    def tilts(self, state: np.ndarray) -> np.ndarray:
        """Return the angle of each link from upright `[..., links]`, radians in ±π, for states `[..., d]`.

        Angles are absolute: a second link's is not counted from the first. The state of zeros stands upright.
        """

    def energies(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return kinetic and potential energy `[T]`, joules, of states `[T, d]`; height is zero at z = 0."""
        mujoco = import_mujoco()
        model = _simulated_model(self.model_file, True)
        data = mujoco.MjData(model)
        n = model.nq
        kinetic, potential = np.empty(len(state)), np.empty(len(state))
        for k in range(len(state)):
            data.qpos[:], data.qvel[:] = state[k, :n], state[k, n:]
            mujoco.mj_forward(model, data)
            potential[k], kinetic[k] = data.energy
        return kinetic, potential

    def open_renderer(self) -> AbstractContextManager[StateRenderer]:
        """Return MuJoCo's own renderer for the model file."""
        return MujocoRenderer(self.model_file, self.size)


def random_walk(random: np.random.RandomState, start: np.ndarray, steps: int, limit: float) -> np.ndarray:
    """Sample inputs `[steps, l]` that wander within ± `limit` from `start [l]`; those that are 0 at first stay 0."""
    walk = start + np.concatenate(
        [np.zeros((1, len(start))), np.cumsum(_WALK * limit * random.randn(steps - 1, len(start)), axis=0)]
    )
    # Reflected at the limits: a triangle wave of the free walk.
    folded = limit - np.abs((walk + limit) % max(4 * limit, 1e-12) - 2 * limit)
    return np.where(start == 0.0, 0.0, folded)


def wrapped(angles: np.ndarray) -> np.ndarray:
    """Return the same angles in ±π, radians."""
    return (angles + np.pi) % (2 * np.pi) - np.pi


def uniform_angles(random: np.random.RandomState, count: int) -> np.ndarray:
    """Sample angles uniform in ±π, radians."""
    return random.uniform(-np.pi, np.pi, size=count)
