"""What the mechanisms of the zoo share: a model in the file of the class, and an accurate motion in few coordinates."""

import abc
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np

from keycld._errors import KeycldError
from keycld.systems.base import Conditions, Run, StateRenderer, SweepPath
from keycld.systems.mujoco import sweeping
from keycld.systems.mujoco.loading import import_mujoco, load_model
from keycld.systems.mujoco.mechanism import AbstractWatchedMechanism
from keycld.systems.mujoco.rendering import MujocoRenderer

_MOST_DRAWS = 10_000


@lru_cache(maxsize=16)
def _simulated(mjcf: str, clip: bool) -> Any:
    model = load_model(mjcf)
    model.actuator_ctrllimited[:] = clip
    return model


class AbstractZooSystem(AbstractWatchedMechanism):
    """A mechanism in MuJoCo with coordinates q `[n]` and velocities v `[n]`; its state is (q, v).

    M(q) q̈ + c(q, q̇) = τ(q, q̇) + G u: MuJoCo gives q̈ from the model, with its springs and dampers, and `force` adds
    what MuJoCo does not know. The motion is integrated by the classical Runge–Kutta method with `substeps` steps a
    frame. Frame k shows the state k + 1 frames after the initial one. Initial states are anywhere in motion: positions
    and velocities uniform in their ranges, sampled again until the energy is in its range.

    Attributes:
        mjcf: the model; camera 0 is the one that is rendered, and the geom that shows a keypoint has its name.
        substeps: Runge–Kutta steps a frame.
        position_ranges: of initial positions, one pair a coordinate; the sweeps follow them too.
        speed_limits: initial velocities are in ± these.
        energy_range: of kinetic plus potential energy of initial states, joules.
    """

    protocol: ClassVar[str] = "zoo"
    initial_states: ClassVar[tuple[str, ...]] = ("moving",)
    mjcf: ClassVar[str]
    substeps: ClassVar[int] = 5
    position_ranges: ClassVar[tuple[tuple[float, float], ...]]
    speed_limits: ClassVar[tuple[float, ...]]
    energy_range: ClassVar[tuple[float, float]]

    @abc.abstractmethod
    def places(self, q: np.ndarray) -> np.ndarray:
        """Return the positions (x, z) `[..., K, 2]` of the keypoints, metres, for coordinates `[..., n]`."""

    def landmarks(self, state: np.ndarray) -> np.ndarray:
        """Return the keypoints' positions `[..., K, 2]` in the image plane."""
        return self.to_image_plane(self.places(state[..., : state.shape[-1] // 2]))

    def force(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return generalised forces `[n]` that are not in the model; none by default."""
        return np.zeros_like(v)

    def potential(self, q: np.ndarray) -> float:
        """Return the potential energy of `force`, joules; 0 by default."""
        return 0.0

    def joints(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return positions and velocities of the model's joints for coordinates and velocities; these by default."""
        return q, v

    def acceleration(self, mujoco: Any, model: Any, data: Any, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return q̈ `[n]`, with MuJoCo's module; `data` holds the joints' positions, velocities and inputs."""
        data.qfrc_applied[:] = self.force(q, v)
        mujoco.mj_forward(model, data)
        return np.array(data.qacc)

    def simulate(self, state: np.ndarray, u: np.ndarray, frames: int, *, clip: bool = True) -> Run:
        """Simulate the motion from `state [d]` under `u`, `[l]` constant or `[frames, l]` held from frame to frame."""
        mujoco, model = import_mujoco(), _simulated(self.mjcf, clip)
        data = mujoco.MjData(model)
        n = len(self.state_names) // 2

        def derivative(y: np.ndarray) -> np.ndarray:
            q, v = y[:n], y[n:]
            data.qpos[:], data.qvel[:] = self.joints(q, v)
            return np.concatenate([v, self.acceleration(mujoco, model, data, q, v)])

        inputs = np.broadcast_to(u, (frames, len(self.input_names)))
        y, step = np.array(state, dtype=float), self.dt / self.substeps
        states, derivatives = np.empty((frames, 2 * n)), np.empty((frames, 2 * n))
        for k in range(frames):
            data.ctrl[:] = inputs[k]
            for _ in range(self.substeps):
                y = _runge_kutta(derivative, y, step)
            states[k], derivatives[k] = y, derivative(y)
        return Run(self.dt * np.arange(1, frames + 1), np.array(u, dtype=float), states, derivatives)

    def energies(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return kinetic and potential energy `[T]`, joules, of states `[T, d]`; height is zero at z = 0."""
        mujoco, model = import_mujoco(), _simulated(self.mjcf, True)
        data = mujoco.MjData(model)
        n = len(self.state_names) // 2
        kinetic, potential = np.empty(len(state)), np.empty(len(state))
        for k, (q, v) in enumerate(zip(state[:, :n], state[:, n:], strict=True)):
            data.qpos[:], data.qvel[:] = self.joints(q, v)
            mujoco.mj_forward(model, data)
            potential[k], kinetic[k] = data.energy[0] + self.potential(q), data.energy[1]
        return kinetic, potential

    def initial_values(self, random: np.random.RandomState, conditions: Conditions) -> tuple[np.ndarray, np.ndarray]:
        """Sample positions and velocities until their energy is in its range.

        Raises:
            KeycldError: it is out of it in ten thousand samples.
        """
        low, high = np.transpose(self.position_ranges)
        limits = np.array(self.speed_limits)
        for _ in range(_MOST_DRAWS):
            q, v = random.uniform(low, high), random.uniform(-limits, limits)
            kinetic, potential = self.energies(np.concatenate([q, v])[None])
            if self.energy_range[0] < kinetic[0] + potential[0] < self.energy_range[1]:
                return q, v
        raise KeycldError(f"no initial state of {self.name} has an energy in {self.energy_range}: widen the ranges.")

    def sweeps(self) -> tuple[SweepPath, ...]:
        """Return a path along each coordinate, the others in the middle of their ranges."""
        names = self.state_names[: len(self.position_ranges)]
        ranges = dict(zip(names, self.position_ranges, strict=True))
        middle = {name: (low + high) / 2 for name, (low, high) in ranges.items()}
        return tuple(
            sweeping.path(
                self.state_names, name, {name: ends}, {other: middle[other] for other in names if other != name}
            )
            for name, ends in ranges.items()
        )

    def open_renderer(self) -> AbstractContextManager[StateRenderer]:
        """Return a renderer that places the model's joints by the state's coordinates."""
        return _Renderer(self)


class _Renderer(MujocoRenderer):
    def __init__(self, system: AbstractZooSystem):
        super().__init__(system.mjcf, system.size, coarse=True)
        self._system = system

    def render(self, state: np.ndarray) -> np.ndarray:
        return super().render(self._system.joints(*np.split(state, 2))[0])


def _runge_kutta(derivative: Callable[[np.ndarray], np.ndarray], y: np.ndarray, step: float) -> np.ndarray:
    """Advance ẏ = f(y) by one step of the classical method of order 4."""
    first = derivative(y)
    second = derivative(y + step / 2 * first)
    third = derivative(y + step / 2 * second)
    fourth = derivative(y + step * third)
    return y + step / 6 * (first + 2 * second + 2 * third + fourth)
