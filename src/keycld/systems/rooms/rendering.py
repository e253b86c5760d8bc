"""MuJoCo's pictures of rooms."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from keycld.systems.mujoco.loading import import_mujoco
from keycld.systems.mujoco.rendering import MujocoRenderer
from keycld.systems.rooms.scene import COLOURS, OBJECT, OBJECTS, SHAPES


class RoomRenderer(MujocoRenderer):
    """Renders rooms: a "state" is the camera's place and its angle around the vertical, then a scene as one vector."""

    def __init__(self, size: int):
        """Take the number of pixels of a side."""
        super().__init__(Path(__file__).with_name("room.xml"), size)
        self._shown = np.empty(0)

    def __enter__(self) -> "RoomRenderer":
        super().__enter__()
        import_mujoco().mj_forward(self._model, self._data)
        return self

    def render(self, state: np.ndarray) -> np.ndarray:
        """Return the picture, uint8 `[size, size, 3]`."""
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
        geom = mujoco.mjtGeom
        types = [
            geom.mjGEOM_SPHERE,
            geom.mjGEOM_CAPSULE,
            geom.mjGEOM_CYLINDER,
            geom.mjGEOM_BOX,
        ]  # in the order of SHAPES
        model, data = self._model, self._data
        model.geom_rgba[:, 3] = 1.0
        model.geom_rgba[0, :3] = scene[:3]
        model.geom_rgba[1:5, :3] = scene[3:6]
        for k, values in enumerate(scene[COLOURS:].reshape(OBJECTS, OBJECT), start=5):
            shape, (x, y), yaw, size, colour = int(values[0]), values[1:3], values[3], values[4:7], values[7:]
            height = size[0] + size[1] if SHAPES[shape] == "capsule" else size[2]
            model.geom_type[k], model.geom_size[k], model.geom_rgba[k, :3] = types[shape], size, colour
            if SHAPES[shape] == "cylinder" or SHAPES[shape] == "capsule":
                model.geom_size[k] = size[0], size[1], 0.0
            data.geom_xpos[k] = x, y, height
            turn = np.array([[math.cos(yaw), -math.sin(yaw), 0], [math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]])
            data.geom_xmat[k] = turn.reshape(-1)
