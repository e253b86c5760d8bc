"""Which pixels show which body: runs in a renderer process, by MuJoCo's own segmentation."""

from pathlib import Path
from typing import Any

import numpy as np

from keycld.systems import get, render_in_worker
from keycld.systems.mujoco.loading import import_mujoco, load_model
from keycld.systems.zoo.base import AbstractZooSystem


def masks(name: str, positions: np.ndarray, size: int) -> list[dict[str, np.ndarray]]:
    """For each of the positions, the pixels [size, size] of every named geom."""
    return _masks(get(name).model_file, positions, size)


def zoo_masks(name: str, states: np.ndarray, size: int) -> tuple[np.ndarray, list[dict[str, np.ndarray]]]:
    """For each of the states, the picture, and the pixels [size, size] of every named geom."""
    system = get(name)
    assert isinstance(system, AbstractZooSystem)
    joints = np.stack([system.joints(*np.split(state, 2))[0] for state in states])
    return render_in_worker(system, states).image, _masks(system.mjcf, joints, size)


def _masks(source: Path | str, joints: Any, size: int) -> list[dict[str, np.ndarray]]:
    mujoco = import_mujoco()
    model = load_model(source)
    model.vis.global_.offwidth = model.vis.global_.offheight = size
    data = mujoco.MjData(model)
    found = []
    with mujoco.Renderer(model, size, size) as renderer:
        renderer.enable_segmentation_rendering()
        for position in joints:
            data.qpos[:] = position
            mujoco.mj_kinematics(model, data)
            mujoco.mj_camlight(model, data)
            renderer.update_scene(data, camera=0)
            # A tendon's number may be a geom's.
            shown, kind = np.moveaxis(renderer.render(), -1, 0)
            shown = np.where(kind == mujoco.mjtObj.mjOBJ_GEOM, shown, -1)
            found.append({model.geom(i).name: shown == i for i in range(model.ngeom)})
    return found
