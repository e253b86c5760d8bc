"""A camera that circles above a room: the sets `room/circle` and `room/spiral`."""

import abc
import math
from contextlib import AbstractContextManager
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from keycld.systems.base import Drawer
from keycld.systems.pictures import Pictures, draw_in_worker
from keycld.systems.registry import register
from keycld.systems.sampled import PAPER, AbstractSampledSystem, Recording
from keycld.systems.rooms.scene import draw_scene, scene_vector

_STEP = math.radians(0.1)
# φ^(1/90°): the radius of a golden spiral grows by this factor a degree.
_GROWTH = 1.0053611


class AbstractRoom(AbstractSampledSystem, abc.ABC):
    """Five still objects in a room, seen from the unit hemisphere above its centre, which the camera always faces.

    A frame is 0.1° of angle. The state is the camera's place and its velocity by finite differences. Source: "Which
    priors matter?", section 4.4 and appendix A.1.4, which leave the room, its objects' sizes and places, lights, the
    field of view and dt open: those are ours. Where the text has z = 1 − r, the camera's height here is √(1 − r²),
    for the camera is to stay on the hemisphere.

    Attributes:
        largest_start: of the first radius, which is drawn uniformly from 0 on.
    """

    dt: ClassVar[float] = 0.05
    protocols: ClassVar[tuple[str, ...]] = (PAPER,)
    counts = {"default": {"train": 2_000, "test": 400}, "full": {"train": 50_000, "test": 20_000}}
    state_names = ("x", "y", "z", "vx", "vy", "vz")
    units = ("1", "1", "1", "1/s", "1/s", "1/s")
    largest_start: ClassVar[float]

    @abc.abstractmethod
    def radius(self, start: float, turned: Float[np.ndarray, "T"]) -> Float[np.ndarray, "T"]:
        """Distance of the camera from the vertical axis after turning by `turned` radians."""

    def group(self, frames: int, size: str, images: bool) -> int:
        """Some seconds of drawing on a CPU."""
        return max(1, 8192 // frames)

    def record(self, numbers: range, frames: int, protocol: str, size: str) -> Recording:
        """Each trajectory draws its room, then radius and angle of the camera, from `RandomState(number)`."""
        states, drawn = [], []
        for number in numbers:
            random = np.random.RandomState(number)
            scene = draw_scene(random)
            radius, angle = random.uniform(0.0, self.largest_start), random.uniform(0.0, 2 * math.pi)
            turned = _STEP * np.arange(frames + 1)
            r = self.radius(radius, turned)
            place = np.stack([r * np.cos(angle + turned), r * np.sin(angle + turned), np.sqrt(1 - r**2)], axis=-1)
            states.append(np.concatenate([place[:-1], np.diff(place, axis=0) / self.dt], axis=-1))
            drawn.append({"seed": np.array(number), "radius": np.array(radius), "angle": np.array(angle), **scene})
        parameters = {name: np.stack([each[name] for each in drawn]) for name in drawn[0]}
        return Recording(self.dt * np.arange(frames), np.stack(states), parameters)

    def pictures(self, recording: Recording) -> Pictures:
        """Drawn by MuJoCo; in a worker process only, which then draws nothing but this set."""
        count, frames = recording.state.shape[:2]
        seen = []
        for i in range(count):
            scene = scene_vector({name: value[i] for name, value in recording.parameters.items()})
            angle = recording.parameters["angle"][i] + _STEP * np.arange(frames)
            fixed = np.broadcast_to(scene, (frames, len(scene)))
            seen.append(np.concatenate([recording.state[i, :, :3], angle[:, None], fixed], axis=1))
        image, renderer = draw_in_worker(self, np.concatenate(seen))
        return Pictures(image.reshape(count, frames, *image.shape[1:]), renderer)

    def drawer(self) -> AbstractContextManager[Drawer]:
        """MuJoCo's renderer, with the room refurnished for each trajectory."""
        from keycld.systems.rooms.scene import RoomDrawer

        return RoomDrawer(self.size)


@register
class RoomCircle(AbstractRoom):
    """A camera on a parallel of the unit hemisphere: (r cos θ, r sin θ, √(1−r²)), θ growing by 0.1° a frame.

    It looks at the centre of a square room with five still objects: spheres, capsules, cylinders, boxes. Floor, wall
    and objects have random colours, the radius r is uniform in 0 to 0.9, the first angle uniform. State: the camera's
    place and velocity. 256 frames sweep 25.6°, so pictures turn slowly. Source: "Which priors matter?" (arXiv
    2111.05458), section 4.4 and appendix A.1.4. No code or scene was released: the room (3.2 × 3.2 × 1.5), the objects
    (radii 0.08 to 0.16, within 0.65 of the centre), a lamp without shadows and a light at the camera, a field of view
    of 75° and dt = 0.05 are choices of ours.
    """

    name = "room/circle"
    largest_start = 0.9

    def radius(self, start: float, turned: Float[np.ndarray, "T"]) -> Float[np.ndarray, "T"]:
        """Constant."""
        return np.full_like(turned, start)


@register
class RoomSpiral(AbstractRoom):
    """A camera on a golden spiral down the unit hemisphere: r = a c^θ, c = 1.0053611 a degree, 0.1° a frame.

    The same rooms as in `room/circle`; the first radius a is uniform in 0 to 0.6 and grows by 14.7 % in 256 frames.
    State: the camera's place and velocity. Source: "Which priors matter?" (arXiv 2111.05458), section 4.4 and
    appendix A.1.4; what these leave open is as in `room/circle`.
    """

    name = "room/spiral"
    largest_start = 0.6

    def radius(self, start: float, turned: Float[np.ndarray, "T"]) -> Float[np.ndarray, "T"]:
        """Grows exponentially."""
        return start * _GROWTH ** np.degrees(turned)
