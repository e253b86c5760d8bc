"""A camera that moves above a room with still objects."""

import abc
import math
from contextlib import AbstractContextManager
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from keycld.systems.base import StateRenderer
from keycld.systems.pictures import Pictures, render_in_worker
from keycld.systems.rooms.rendering import RoomRenderer
from keycld.systems.rooms.scene import sample_scene, scene_vector
from keycld.systems.sampled import PAPER, AbstractSampledSystem, Recording

_STEP = math.radians(0.1)


class AbstractRoom(AbstractSampledSystem, abc.ABC):
    """Five still objects in a room, seen from the unit hemisphere above its centre, which the camera always faces.

    (x, y, z) = (r cos θ, r sin θ, √(1 − r²)), θ growing by 0.1° a frame. State: the camera's place, in units of its
    distance from the centre, and its velocity by finite differences. Source: "Which priors matter?" (arXiv
    2111.05458), section 4.4 and appendix A.1.4, which leave the room, its objects' sizes and places, lights, the field
    of view and dt open: those are ours. The text has z = 1 − r, which is not on the hemisphere.

    Attributes:
        largest_radius: the largest first radius, which is sampled uniformly from 0 on.
    """

    dt: ClassVar[float] = 0.05
    protocols: ClassVar[tuple[str, ...]] = (PAPER,)
    counts = {"default": {"train": 2_000, "test": 400}, "full": {"train": 50_000, "test": 20_000}}
    state_names = ("x", "y", "z", "vx", "vy", "vz")
    units = ("1", "1", "1", "1/s", "1/s", "1/s")
    largest_radius: ClassVar[float]

    @abc.abstractmethod
    def radius(self, first: float, turned: Float[np.ndarray, "T"]) -> Float[np.ndarray, "T"]:
        """Return the camera's distance from the vertical axis after turning by `turned` radians."""

    def group(self, frames: int, size: str, images: bool) -> int:
        """Return as many as are some seconds of rendering on a CPU."""
        return max(1, 8192 // frames)

    def record(self, numbers: range, frames: int, protocol: str, size: str) -> Recording:
        """Sample for each trajectory its room, then radius and angle of the camera, from `RandomState(number)`."""
        states, parameters = [], []
        for number in numbers:
            random = np.random.RandomState(number)
            scene = sample_scene(random)
            radius, angle = random.uniform(0.0, self.largest_radius), random.uniform(0.0, 2 * math.pi)
            turned = _STEP * np.arange(frames + 1)
            r = self.radius(radius, turned)
            place = np.stack([r * np.cos(angle + turned), r * np.sin(angle + turned), np.sqrt(1 - r**2)], axis=-1)
            states.append(np.concatenate([place[:-1], np.diff(place, axis=0) / self.dt], axis=-1))
            parameters.append({"seed": np.array(number), "radius": np.array(radius), "angle": np.array(angle), **scene})
        stacked = {name: np.stack([each[name] for each in parameters]) for name in parameters[0]}
        return Recording(self.dt * np.arange(frames), np.stack(states), stacked)

    def pictures(self, recording: Recording) -> Pictures:
        """Render with MuJoCo; in a worker process only, which then renders nothing but this set."""
        count, frames = recording.state.shape[:2]
        views = []
        for i in range(count):
            scene = scene_vector({name: value[i] for name, value in recording.parameters.items()})
            angle = recording.parameters["angle"][i] + _STEP * np.arange(frames)
            fixed = np.broadcast_to(scene, (frames, len(scene)))
            views.append(np.concatenate([recording.state[i, :, :3], angle[:, None], fixed], axis=1))
        image, renderer = render_in_worker(self, np.concatenate(views))
        return Pictures(image.reshape(count, frames, *image.shape[1:]), renderer)

    def open_renderer(self) -> AbstractContextManager[StateRenderer]:
        """Return MuJoCo's renderer, with the room refurnished for each trajectory."""
        return RoomRenderer(self.size)
