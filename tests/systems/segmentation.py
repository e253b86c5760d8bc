"""Which pixels show which body: runs in a renderer process, by MuJoCo's own segmentation."""

import numpy as np

from keycld.systems import get
from keycld.systems.mujoco.loading import import_mujoco, load_model


def masks(name: str, positions: np.ndarray, size: int) -> list[dict[str, np.ndarray]]:
    """For each of the positions, the pixels [size, size] of every named geom."""
    mujoco = import_mujoco()
    model = load_model(get(name).model_file)
    model.vis.global_.offwidth = model.vis.global_.offheight = size
    data = mujoco.MjData(model)
    found = []
    with mujoco.Renderer(model, size, size) as renderer:
        renderer.enable_segmentation_rendering()
        for position in positions:
            data.qpos[:] = position
            mujoco.mj_kinematics(model, data)
            mujoco.mj_camlight(model, data)
            renderer.update_scene(data, camera=0)
            geoms = renderer.render()[..., 0]
            found.append({model.geom(i).name: geoms == i for i in range(model.ngeom)})
    return found
