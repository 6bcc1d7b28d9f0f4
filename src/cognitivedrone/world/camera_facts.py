"""The published first-person camera in numbers, for whoever renders with it or measures in its images."""

from __future__ import annotations

import math
from typing import Final

IMAGE_SIZE: Final = 256
"""Pixels a side of the square image."""
FIELD_OF_VIEW: Final = 1.85
"""Horizontal and, as the image is square, vertical, rad."""
FOCAL_PX: Final = IMAGE_SIZE / 2 / math.tan(FIELD_OF_VIEW / 2)
"""Focal length in pixels: a point at depth d and lateral offset y is y / d of this from the image's middle."""
CAMERA_AHEAD_M: Final = 0.1
"""How far the camera sits ahead of the vehicle's origin, body frame, m. It looks along the body's x axis."""
CAMERA_ABOVE_M: Final = 0.3
"""How far it sits above the vehicle's origin, body frame, m."""
