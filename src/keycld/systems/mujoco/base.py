"""Systems simulated by MuJoCo: the runs of KeyCLD's protocol, from seeds."""

import abc
import inspect
from contextlib import AbstractContextManager
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from keycld.systems.base import Conditions, Run, StateRenderer
from keycld.systems.mujoco.loading import import_mujoco, load_model
from keycld.systems.mujoco.mechanism import AbstractWatchedMechanism
from keycld.systems.mujoco.rendering import MujocoRenderer

# Initial states near upright: their share, and their deviation in radians and metres; that of velocities is 1 a second.
_UPRIGHT_PROBABILITY = 0.5
_UPRIGHT_SPREAD = 0.2


@lru_cache(maxsize=8)
def _simulated_model(file: Path, clip: bool) -> Any:
    model = load_model(file)
    model.actuator_ctrllimited[:] = clip
    return model


class AbstractMujocoSystem(AbstractWatchedMechanism):
    """A system whose state is MuJoCo's (qpos, qvel), seen by a camera that looks along +y with z up.

    M(q) q̈ + c(q, q̇) = τ(q) + G u, without damping: MuJoCo's own equations for the model file. Positions are
    metres and radians, energies joules. Source: KeyCLD (arXiv 2206.11030), appendix A.6, and dm_control's suite.
    """

    initial_states: ClassVar[tuple[str, ...]] = ("rest", "random", "upright", "released")

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

    def initial_values(self, random: np.random.RandomState, conditions: Conditions) -> tuple[np.ndarray, np.ndarray]:
        """Sample the initial state that the conditions name; `Conditions` describes them."""
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


def wrapped(angles: np.ndarray) -> np.ndarray:
    """Return the same angles in ±π, radians."""
    return (angles + np.pi) % (2 * np.pi) - np.pi


def uniform_angles(random: np.random.RandomState, count: int) -> np.ndarray:
    """Sample angles uniform in ±π, radians."""
    return random.uniform(-np.pi, np.pi, size=count)
