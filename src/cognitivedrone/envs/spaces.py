"""The observation and action spaces that both environments share."""

from __future__ import annotations

import string
from typing import Any

import numpy as np
from gymnasium import spaces

from cognitivedrone.types import ACTION_LIMITS, IMAGE_SIZE

MAX_INSTRUCTION = 400
"""Characters."""
CHARSET = string.ascii_letters + string.digits + string.punctuation + " "


def action_space() -> spaces.Box:
    """(4,): vx, vy, vz in m/s and yaw rate in rad/s, heading frame."""
    limit = np.array(ACTION_LIMITS, dtype=np.float32)
    return spaces.Box(-limit, limit, dtype=np.float32)


def observation_space() -> spaces.Dict:
    """What a policy may see, as in `Observation`, for one world."""
    far = np.float32(np.inf)
    return spaces.Dict(
        {
            "image": spaces.Box(0, 255, (IMAGE_SIZE, IMAGE_SIZE, 3), np.uint8),
            "instruction": spaces.Text(max_length=MAX_INSTRUCTION, charset=CHARSET),
            "velocity": spaces.Box(-far, far, (3,), np.float32),
            "height": spaces.Box(-far, far, (1,), np.float32),
            "yaw_rate": spaces.Box(-far, far, (1,), np.float32),
        }
    )


Info = dict[str, Any]
