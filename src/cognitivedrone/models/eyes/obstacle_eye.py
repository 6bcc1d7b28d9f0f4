"""A network that sees what is in the way: for each part of a frame whether an obstacle is there, and how far away.

Gates are no obstacles: a policy flies through them. Policies that avoid obstacles (`cognitivedrone.policies.avoidance`)
ask it about every frame.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.errors import PolicyError
from cognitivedrone.models.onnx_file import beside, check_graph, numbers_of, open_model
from cognitivedrone.types import IMAGE_SIZE

EYE_FILE: Final = "obstacles.onnx"
EYE: Final = "obstacle-eye"
PARTS: Final = 16
"""Parts of a frame's height, and of its width."""
DEPTHS_M: Final = (0.4, 0.6, 0.85, 1.2, 1.7, 2.4, 3.4, 4.8)
"""The distances along the camera's axis between which it distinguishes."""
FARTHEST_M: Final = 5.7
"""What is farther away does not count."""

Floats = NDArray[np.float32]


class ObstacleEye:
    """The network, run by ONNX Runtime on the CPU."""

    def __init__(self, session: Any) -> None:
        self._session = session

    @classmethod
    def load(cls, path: Path, *, threads: int = 1) -> ObstacleEye:
        """Load a file; raises `ModelError` where it is missing, broken or of another kind."""
        session, _ = open_model(path, EYE, threads=threads, optimise=True)
        parts = ("tensor(float)", (PARTS, PARTS))
        image = ("tensor(uint8)", (IMAGE_SIZE, IMAGE_SIZE, 3))
        check_graph(session, {"image": image}, {"occupied": parts, "depth": parts}, str(path))
        return cls(session)

    def look(self, images: NDArray[np.uint8]) -> tuple[Floats, Floats]:
        """Of images (n, 256, 256, 3), for each part (n, PARTS, PARTS), rows from the top: the probability that an
        obstacle is there, and the distance of the nearest one along the camera's axis, m, if so.

        Raises `PolicyError` for other shapes or types.
        """
        if images.dtype != np.uint8 or images.shape[1:] != (IMAGE_SIZE, IMAGE_SIZE, 3):
            raise PolicyError(f"images must be uint8 (n, 256, 256, 3), not {images.dtype} {images.shape}")
        occupied, depth = numbers_of(self._session, ("occupied", "depth"), {"image": images}, "the obstacle eye")
        return occupied, depth


def eye_of(model: Path) -> Path:
    """The obstacle eye of a policy's file: the one beside it, or the packaged one."""
    return beside(model, EYE_FILE)
