"""MuJoCo, imported regardless of `MUJOCO_GL`: `from cognitivedrone.world.engine import mujoco`.

On import, MuJoCo loads the library that `MUJOCO_GL` names. If that is missing, PyOpenGL fails with errors
that name neither the cause nor a solution. Only rendering needs the library, so this module then imports MuJoCo without
it, and `sim.drawing.gl` explains the problem in one sentence when something renders.
"""

from __future__ import annotations

import importlib
import os
import sys

from cognitivedrone.system.processes import isolated


def _load() -> None:
    """Import MuJoCo, without OpenGL if that does not start."""
    try:
        importlib.import_module("mujoco")
    except ImportError:
        raise  # not installed, or built for another machine: the message explains it
    except Exception:  # ctypes, PyOpenGL and MuJoCo each fail in their own way
        wanted = os.environ.get("MUJOCO_GL")
        for name in [name for name in sys.modules if name.partition(".")[0] == "OpenGL"]:
            del sys.modules[name]
        os.environ["MUJOCO_GL"] = "disable"
        try:
            importlib.import_module("mujoco")
        finally:
            if wanted is None:
                del os.environ["MUJOCO_GL"]
            else:
                os.environ["MUJOCO_GL"] = wanted


with isolated():  # on import, glfw tries its libraries in Python processes of its own
    _load()
import mujoco as mujoco  # noqa: E402
from mujoco.batch import Batch as Batch  # noqa: E402
