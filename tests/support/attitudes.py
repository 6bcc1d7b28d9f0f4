"""Attitudes that tests ask for by angle."""

import math

import numpy as np

from cognitivedrone.types import FloatArray


def tilted(yaw: float, pitch: float, roll: float) -> FloatArray:
    """Attitude w, x, y, z; a positive pitch looks down."""
    (cy, sy), (cp, sp), (cr, sr) = ((math.cos(a / 2), math.sin(a / 2)) for a in (yaw, pitch, roll))
    return np.array(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )
