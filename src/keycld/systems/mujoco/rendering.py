"""Headless rendering of MuJoCo models, and what to do where it fails."""

from pathlib import Path
from typing import Any

import numpy as np

from keycld.systems.mujoco.loading import import_mujoco, load_model, no_gl
from keycld.systems.processes import Task, run_in_processes

# dm_control renders shadows from a map of 2048 x 2048, which takes two thirds of a software renderer's time.
# With 512 fewer than 5 of 10,000 pixels change by more than two levels (measured in docs/systems.md).
_SHADOW_MAP = 512
# A software renderer's time goes into triangles: MuJoCo makes a ball of 28 slices and 16 stacks, and draws it three
# times where a light casts shadows. Pictures that nobody else has made can do with fewer.
_COARSE_SHADOW_MAP, _COARSE_SLICES, _COARSE_STACKS = 256, 16, 8
_SOFTWARE = ("llvmpipe", "softpipe", "swrast", "software rasterizer")


def is_software(description: str) -> bool:
    """Return whether the named OpenGL renderer works on the CPU, which is 40 to 400 times slower than a GPU."""
    return any(word in description.lower() for word in _SOFTWARE)


class MujocoRenderer:
    """Renders one model with `mujoco.Renderer`, camera 0. A context manager.

    On llvmpipe, renderers of several models in one process gave corrupted pictures: one system a process.
    """

    def __init__(self, source: Path | str, size: int, *, coarse: bool = False):
        """Take a model, the size of its pictures, and how exactly they are drawn.

        Args:
            source: the MJCF file of the model, or MJCF as a string.
            size: pixels of a side.
            coarse: whether round bodies and shadows have half the fineness, in half the time.
        """
        self.source, self.size, self.coarse = source, size, coarse

    def __enter__(self) -> "MujocoRenderer":
        mujoco = import_mujoco()
        self._model = load_model(self.source)
        quality = self._model.vis.quality
        quality.shadowsize = _SHADOW_MAP
        if self.coarse:
            quality.shadowsize = _COARSE_SHADOW_MAP
            quality.numslices, quality.numstacks = _COARSE_SLICES, _COARSE_STACKS
        # A buffer no larger than the picture: the default of 640 x 480 is cleared for nothing in every frame.
        self._model.vis.global_.offwidth = self._model.vis.global_.offheight = self.size
        self._data = mujoco.MjData(self._model)
        try:
            self._renderer = mujoco.Renderer(self._model, self.size, self.size)
            self.description = _gl_renderer()
        except Exception as error:  # every GL library fails in its own way
            raise no_gl(error) from error
        return self

    def __exit__(self, *_: Any) -> None:
        self._renderer.close()

    def render(self, state: np.ndarray) -> np.ndarray:
        """Return the picture, uint8 `[size, size, 3]`, of one state, whose first components are qpos."""
        mujoco = import_mujoco()
        self._data.qpos[:] = state[: self._model.nq]
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        mujoco.mj_tendon(self._model, self._data)
        self._renderer.update_scene(self._data, camera=0)
        return self._renderer.render()


def _gl_renderer() -> str:
    from OpenGL import GL

    name: Any = GL.glGetString(GL.GL_RENDERER)
    return name.decode()


def renderer_name() -> str:
    """Return the OpenGL renderer of MuJoCo's pictures, for example `"llvmpipe (LLVM 15.0.6, 256 bits)"`.

    Raises:
        KeycldError: MuJoCo is missing, or no OpenGL context can be made.
    """
    [(_, name)] = run_in_processes([Task(_renderer_of_this_process, ())])
    return name


def _renderer_of_this_process() -> str:
    with MujocoRenderer(Path(__file__).with_name("pendulum.xml"), 64) as renderer:
        return renderer.description
