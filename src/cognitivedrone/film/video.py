"""Writing and reading H.264 in MP4, which every browser plays."""

from __future__ import annotations

import io
import itertools
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

import av
import numpy as np

from cognitivedrone.types import CONTROL_HZ, Image

CLIP: Final = {"crf": "30", "preset": "veryfast", "threads": "1"}
"""x264 settings: about 10 kB per second of a clip. One thread, because the output depends on the number of threads."""
FILM: Final = {"crf": "23", "preset": "veryfast", "movflags": "+faststart", "threads": "1"}


def write_mp4(frames: Iterable[Image], out: Path | io.BytesIO, fps: int, settings: dict[str, str]) -> int:
    """Encode frames (H, W, 3) uint8 RGB, H and W even; returns their number. Nothing is written for no frames."""
    rest = iter(frames)
    first = next(rest, None)
    if first is None:
        return 0
    coding = {key: value for key, value in settings.items() if key != "movflags"}
    options = {key: value for key, value in settings.items() if key == "movflags"}
    with av.open(out if isinstance(out, io.BytesIO) else str(out), "w", format="mp4", options=options) as container:
        stream = container.add_stream("libx264", rate=fps, options=coding)
        stream.height, stream.width = first.shape[:2]
        stream.pix_fmt = "yuv420p"
        count = 0
        for frame in itertools.chain([first], rest):
            picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="rgb24")
            container.mux(stream.encode(picture))
            count += 1
        container.mux(stream.encode())
    return count


def encode_mp4(frames: Iterable[Image], fps: int = CONTROL_HZ) -> bytes:
    """A small clip; empty for no frames. Frames are (H, W, 3) uint8 RGB, H and W even."""
    buffer = io.BytesIO()
    write_mp4(frames, buffer, fps, CLIP)
    return buffer.getvalue()


def read_mp4(path: Path) -> Iterator[Image]:
    """The frames (H, W, 3) uint8 RGB of a film, one by one."""
    with av.open(str(path)) as container:
        for frame in container.decode(video=0):
            yield frame.to_ndarray(format="rgb24")
