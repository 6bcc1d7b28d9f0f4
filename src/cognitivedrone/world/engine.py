"""MuJoCo, imported whatever `MUJOCO_GL` says: `from cognitivedrone.world.engine import mujoco`.

MuJoCo loads the library that `MUJOCO_GL` names as it is imported; where that is missing, PyOpenGL fails with errors of
its own that name neither the cause nor a way out. Nothing but rendering needs it: here MuJoCo is then imported without,
and `sim.gl` says in one sentence what is wrong, to whom renders.
"""

from __future__ import annotations

import importlib
import os
import sys


def _load() -> None:
    """Import MuJoCo, without OpenGL where that does not start."""
    try:
        importlib.import_module("mujoco")
    except ImportError:
        raise  # not installed, or built for another machine: the message says so
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


_load()
import mujoco as mujoco  # noqa: E402
from mujoco.batch import Batch as Batch  # noqa: E402
