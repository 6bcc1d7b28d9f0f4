"""MuJoCo, imported such that a broken OpenGL shows as one sentence: `from cognitivedrone.world.engine import mujoco`.

MuJoCo loads the library that `MUJOCO_GL` names as it is imported; where that is missing, PyOpenGL fails with errors of
its own that name neither the cause nor a way out.
"""

from __future__ import annotations

import os

from cognitivedrone.errors import RenderError

try:
    import mujoco as mujoco
    from mujoco.batch import Batch as Batch
except ImportError:
    raise  # not installed, or built for another machine: the message says so
except Exception as error:
    raise RenderError(
        f"MuJoCo does not start with MUJOCO_GL={os.environ.get('MUJOCO_GL', '')} ({error}). "
        "Unset it, or install what it names: apt-get install -y libegl1 libgl1-mesa-dri libopengl0, or libosmesa6"
    ) from None
