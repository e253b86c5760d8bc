"""MuJoCo itself: its import, its model files, and the message where OpenGL is missing."""

import ctypes
import os
import sys
from pathlib import Path
from typing import Any

from keycld._errors import KeycldError


def no_gl(error: Exception) -> KeycldError:
    """Return the error for a machine on which nothing can render."""
    reason = str(error).split(". ")[0].rstrip(".")  # some give a paragraph
    return KeycldError(
        f"nothing can be rendered here, because no OpenGL context could be made ({reason}): on Debian or Ubuntu "
        "install libegl1 libgl1 libgles2 libgl1-mesa-dri, on a machine with a GPU its driver's EGL library; MUJOCO_GL "
        "chooses another back end."
    )


def _choose_gl() -> None:
    """Choose EGL on Linux, which renders without a screen; none where it is missing, so that simulation still works."""
    if sys.platform.startswith("linux") and "MUJOCO_GL" not in os.environ:
        try:
            ctypes.CDLL("libEGL.so.1")
            os.environ["MUJOCO_GL"] = "egl"
        except OSError:
            os.environ["MUJOCO_GL"] = "disable"


def import_mujoco() -> Any:
    """Return the `mujoco` module.

    Raises:
        KeycldError: MuJoCo or its OpenGL libraries are missing; it says how to install them.
    """
    _choose_gl()  # MuJoCo reads the variable once, when it is imported
    try:
        import mujoco
    except ModuleNotFoundError as error:
        raise KeycldError("this system needs MuJoCo: install it with pip install 'keycld[envs]'.") from error
    except Exception as error:  # every GL library fails in its own way
        raise no_gl(error) from error
    return mujoco


def load_model(source: Path | str) -> Any:
    """Return a new `MjModel` of an MJCF file, or of MJCF itself where `source` is a string.

    Raises:
        KeycldError: there is no such file.
    """
    if isinstance(source, str):
        return import_mujoco().MjModel.from_xml_string(source)
    if not source.is_file():
        raise KeycldError(f"there is no model file {source}: put the system's MJCF there, next to its module.")
    return import_mujoco().MjModel.from_xml_path(str(source))
