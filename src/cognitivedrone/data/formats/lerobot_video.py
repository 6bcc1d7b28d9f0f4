"""H.264 videos with the frames of many episodes in sequence, as in LeRobot v3."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

from cognitivedrone.data.episode import decode_image
from cognitivedrone.data.formats.exchange import check_file
from cognitivedrone.errors import DataError
from cognitivedrone.pictures import MAX_SIDE
from cognitivedrone.types import CONTROL_HZ, IMAGE_SIZE, Image

CODEC, PIXELS = "libx264", "yuv420p"
CRF = 18
"""Constant quality factor; 18 is hard to tell from the original."""
KEYFRAME_EVERY = 2
"""Distance in frames; training reads at random, so a reader must decode little to reach one frame."""


class VideoWriter:
    """One MP4 file that grows episode by episode."""

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self.frames = 0
        self._container = av.open(str(path), "w")
        options = {"crf": str(CRF), "g": str(KEYFRAME_EVERY), "preset": "veryfast"}
        self._stream = self._container.add_stream(CODEC, rate=CONTROL_HZ, options=options)
        self._stream.width = self._stream.height = IMAGE_SIZE
        self._stream.pix_fmt = PIXELS
        self._stream.codec_context.time_base = Fraction(1, CONTROL_HZ)

    def add(self, images: Iterable[bytes]) -> None:
        """Append encoded frames."""
        for image in images:
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(decode_image(image)), format="rgb24")
            frame.pts = self.frames
            frame.time_base = Fraction(1, CONTROL_HZ)
            self._container.mux(self._stream.encode(frame))
            self.frames += 1

    def close(self) -> None:
        """Write the encoder's remaining frames, and the index."""
        self._container.mux(self._stream.encode(None))
        self._container.close()


def read_frames(path: Path) -> Iterator[Image]:
    """The frames of a file in order, (256, 256, 3) RGB; `DataError` if it cannot be decoded."""
    check_file(path)
    try:
        limit = {"max_pixels": str(MAX_SIDE**2)}  # also while FFmpeg looks for the size
        with av.open(str(path), options=limit) as container:
            size = container.streams.video[0].codec_context
            size.options = limit
            if max(size.width, size.height) > MAX_SIDE:
                raise DataError(
                    f"{path}: has {size.width} x {size.height} pixels; a frame has at most {MAX_SIDE} a side"
                )
            for frame in container.decode(video=0):
                yield frame.to_ndarray(format="rgb24")
    except (OSError, ValueError, IndexError) as error:
        raise DataError(f"{path}: not a whole video ({error}); copy or export it again") from None
