"""One recorded flight in memory: the common type of every store, export and import."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from io import BytesIO
from typing import Any, Literal

import numpy as np
from jaxtyping import Float32, Float64
from PIL import Image as PillowImage

from cognitivedrone.choices import AppearanceName
from cognitivedrone.pictures import MAX_SIDE, open_picture
from cognitivedrone.types import ActionChunk, Float32Array, Float64Array, Image, Task

Encoding = Literal["jpeg", "png", "webp"]
"""`jpeg` is lossy; `png` and `webp` are lossless."""
Split = Literal["train", "val"]


@dataclass(frozen=True, slots=True)
class Conditions:
    """Initial conditions of a flight: with the commands that were sent, enough to repeat it bit for bit."""

    seed: int
    """Seed of its collection."""
    airframe: str
    look: AppearanceName | Literal["published"]
    """`published`: imported from a data set in the published layout, which does not record the appearance."""
    start_position: tuple[float, float, float]
    """World, m."""
    start_yaw: float
    """rad."""
    wind: tuple[float, float, float]
    """Steady, world, m/s."""
    place: str = ""
    """Where it was flown if `look` is "photo": a shipped place's name."""

    def facts(self) -> dict[str, Any]:
        """As JSON values; without a place if there is none, as in records of before."""
        return {name: value for name, value in asdict(self).items() if name != "place" or value}


@dataclass(frozen=True, slots=True)
class Episode:
    """T control steps of one stage, 0.1 s apart. Row t holds observation and command at time t."""

    index: int
    """Index of the task in its suite; unique in a store."""
    suite: str
    """Name of the suite, such as "open-v1:train"."""
    task: Task
    conditions: Conditions
    encoding: Encoding
    images: tuple[bytes, ...]
    """T encoded first-person frames, 256x256 RGB."""
    action: ActionChunk
    """(T, 4) the label: the clean expert action, heading frame, vx, vy, vz m/s and yaw rate rad/s."""
    sent: ActionChunk
    """(T, 4) the command sent; differs from `action` where the flight was perturbed."""
    velocity: Float32[Float32Array, "steps 3"]
    """(T, 3) heading frame, m/s."""
    height: Float32[Float32Array, " steps"]
    """(T,) above ground, m."""
    yaw_rate: Float32[Float32Array, " steps"]
    """(T,) rad/s."""
    position: Float64[Float64Array, "steps 3"]
    """(T, 3) ground truth, world, m. For scoring and conversion, never for a policy."""
    quaternion: Float64[Float64Array, "steps 4"]
    """(T, 4) ground truth, w, x, y, z, body to world."""
    final_position: Float64[Float64Array, 3]
    """(3,) world, m, after the last action."""
    down: tuple[bytes, ...] = ()
    """T encoded frames of the camera that looks down, 256x256 RGB, each of the same moment as its neighbour in `images`
    and encoded alike; empty where only the first-person view was recorded."""

    def __len__(self) -> int:
        return len(self.images)

    @property
    def state(self) -> Float32[Float32Array, "steps 5"]:
        """(T, 5) the drone's own state that a policy may know: heading-frame velocity, height, yaw rate."""
        return np.column_stack([self.velocity, self.height, self.yaw_rate]).astype(np.float32)


def encode_image(image: Image, encoding: Encoding, quality: int = 95) -> bytes:
    """The frame as JPEG of that quality, or losslessly as PNG or WebP."""
    buffer = BytesIO()
    picture = PillowImage.fromarray(image)
    if encoding == "jpeg":
        picture.save(buffer, "JPEG", quality=quality, subsampling=0 if quality >= 90 else 2)
    elif encoding == "png":
        picture.save(buffer, "PNG", compress_level=1)
    else:
        picture.save(buffer, "WEBP", lossless=True, quality=0, method=0)
    return buffer.getvalue()


def decode_image(data: bytes) -> Image:
    """(H, W, 3) uint8 RGB of an encoded frame.

    Raises `ValueError`, before it is decoded, for one of more than `MAX_SIDE` pixels a side; and `OSError`,
    `ValueError` or `SyntaxError` for what is no whole JPEG, PNG or WebP.
    """
    with open_picture(data, ("JPEG", "PNG", "WEBP"), max_side=MAX_SIDE) as picture:
        return np.asarray(picture.convert("RGB"))
