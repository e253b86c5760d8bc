"""Rooms with five objects: how they are drawn at random, and how MuJoCo shows them."""

import colorsys
import math
from typing import Any

import numpy as np
from jaxtyping import Float

from keycld.systems.mujoco.base import import_mujoco
from keycld.systems.mujoco.rendering import MujocoDrawer

OBJECTS = 5
SHAPES = ("sphere", "capsule", "cylinder", "box")
# Objects stand within this distance of the room's centre, so that the camera, at distance 1, never meets one.
_SPREAD = 0.65
_GAP = 0.03
_MOST_DRAWS = 10_000
# Of a scene as one vector: floor, wall, and for each object shape, place, yaw, three sizes, colour.
_COLOURS, _OBJECT = 6, 10


def draw_scene(random: np.random.RandomState) -> dict[str, np.ndarray]:
    """A random room; lengths in units of the camera's distance from the centre.

    Each object is a sphere, capsule, cylinder or box, all equally likely, upright, turned by any angle about the
    vertical, with a radius (half width) of 0.08 to 0.16 and a half height of 0.08 to 0.2, somewhere on the floor within
    0.65 of the centre; objects do not touch. Every colour has a random hue, floor and wall a saturation of 0.3 to 0.7,
    objects one of 0.7 to 1. Shapes and colours are the paper's, the numbers ours: it gives none.
    """
    size = np.empty((OBJECTS, 3))
    shape = random.randint(len(SHAPES), size=OBJECTS)
    for k, name in enumerate(SHAPES[i] for i in shape):
        radius, half = random.uniform(0.08, 0.16), random.uniform(0.08, 0.2)
        size[k] = {
            "sphere": (radius, radius, radius),
            "capsule": (radius, half / 2, half / 2),
            "cylinder": (radius, half, half),
            "box": (radius, random.uniform(0.08, 0.16), half),
        }[name]
    return {
        "shape": shape,
        "place": _places(random, np.where(shape == 3, np.hypot(size[:, 0], size[:, 1]), size[:, 0])),
        "yaw": random.uniform(-math.pi, math.pi, size=OBJECTS),
        "half_sizes": size,
        "color": np.stack([_colour(random, 0.7, 1.0) for _ in range(OBJECTS)]),
        "floor": _colour(random, 0.3, 0.7),
        "wall": _colour(random, 0.3, 0.7),
    }


def _colour(random: np.random.RandomState, dull: float, bright: float) -> np.ndarray:
    return np.array(colorsys.hsv_to_rgb(random.uniform(), random.uniform(dull, bright), random.uniform(0.6, 1.0)))


def _places(random: np.random.RandomState, reach: np.ndarray) -> np.ndarray:
    """Places on the floor, uniform over the disc, all of them drawn again until none touch."""
    needed = reach[:, None] + reach[None, :] + _GAP
    for _ in range(_MOST_DRAWS):
        distance, angle = _SPREAD * np.sqrt(random.uniform(size=OBJECTS)), random.uniform(0, 2 * math.pi, size=OBJECTS)
        place = np.stack([distance * np.cos(angle), distance * np.sin(angle)], axis=-1)
        gaps = np.linalg.norm(place[:, None] - place[None, :], axis=-1) + np.eye(OBJECTS)
        if np.all(gaps >= needed):
            return place
    raise RuntimeError(f"no room for objects of reach {reach}")


def scene_vector(scene: dict[str, np.ndarray]) -> Float[np.ndarray, "scene"]:
    """A scene as one vector, as the drawer takes it."""
    objects = [scene["shape"][:, None], scene["place"], scene["yaw"][:, None], scene["half_sizes"], scene["color"]]
    return np.concatenate([scene["floor"], scene["wall"], np.concatenate(objects, axis=1).reshape(-1)])


class RoomDrawer(MujocoDrawer):
    """Draws rooms: a "state" is the camera's place and its angle around the vertical, then a scene as one vector."""

    def __init__(self, size: int):
        """Draw on `size` × `size` pixels."""
        super().__init__("room", size)
        self._shown = np.empty(0)

    def __enter__(self) -> "RoomDrawer":
        super().__enter__()
        import_mujoco().mj_forward(self._model, self._data)
        return self

    def draw(self, state: np.ndarray) -> np.ndarray:
        """The picture, uint8 `[size, size, 3]`."""
        camera, angle, scene = state[:3], state[3], state[4:]
        if not np.array_equal(scene, self._shown):
            self._furnish(scene)
            self._shown = scene.copy()
        # The camera looks against `back`; its right hand points along the parallel, also at the pole.
        back = camera / np.linalg.norm(camera)
        right = np.array([-math.sin(angle), math.cos(angle), 0.0])
        self._data.cam_xpos[0] = camera
        self._data.cam_xmat[0] = np.stack([right, np.cross(back, right), back], axis=1).reshape(-1)
        self._renderer.update_scene(self._data, camera=0)
        return self._renderer.render()

    def _furnish(self, scene: np.ndarray) -> None:
        mujoco: Any = import_mujoco()
        types = [getattr(mujoco.mjtGeom, f"mjGEOM_{name.upper()}") for name in SHAPES]
        model, data = self._model, self._data
        model.geom_rgba[:, 3] = 1.0
        model.geom_rgba[0, :3] = scene[:3]
        model.geom_rgba[1:5, :3] = scene[3:6]
        for k, values in enumerate(scene[_COLOURS:].reshape(OBJECTS, _OBJECT), start=5):
            shape, (x, y), yaw, size, colour = int(values[0]), values[1:3], values[3], values[4:7], values[7:]
            height = size[0] + size[1] if SHAPES[shape] == "capsule" else size[2]
            model.geom_type[k], model.geom_size[k], model.geom_rgba[k, :3] = types[shape], size, colour
            if SHAPES[shape] == "cylinder" or SHAPES[shape] == "capsule":
                model.geom_size[k] = size[0], size[1], 0.0
            data.geom_xpos[k] = x, y, height
            turn = np.array([[math.cos(yaw), -math.sin(yaw), 0], [math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]])
            data.geom_xmat[k] = turn.reshape(-1)
