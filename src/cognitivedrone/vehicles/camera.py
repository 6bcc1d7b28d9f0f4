"""Cameras: the newest frame with its age, cropped and resized to the policies' first-person view.

`open_camera` takes

| source | what it is |
|---|---|
| a folder | its images in the order of their names (2 before 10), at `rate_hz`, upright; hidden files are skipped |
| a video file | at its own pace, turned as its metadata says |
| `/dev/videoN` | a camera of this machine, on Linux (Video4Linux) |
| `avfoundation:N`, `dshow:video=NAME` | the same on macOS and on Windows; neither has been tried |
| `rtsp://`, `rtsps://`, `http://`, `https://`, `udp://`, `tcp://`, `srt://` | a stream |

All sources are read with PyAV, which is part of the base install; OpenCV is not needed. A thread reads the source and
keeps only the last frame, so that a slow policy never gets an old one.

Field of view: frames are cropped to their central square and resized to 256x256. The simulated camera sees 1.85 rad
(106 degrees) in both directions; `cropped_fov` computes what a camera has left after cropping. With a much narrower
view, gates look larger and nearer than in training: use a wide lens.
"""

from __future__ import annotations

import math
import threading
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any, Literal, Protocol

import av
import numpy as np
from PIL import Image as Pictures

from cognitivedrone import system
from cognitivedrone.errors import CameraError
from cognitivedrone.files import is_hidden, natural_order
from cognitivedrone.pictures import MAX_PICTURE_BYTES, MAX_PIXELS, OTHER_SUFFIXES, read_picture
from cognitivedrone.types import IMAGE_SIZE, Image

STREAMS = ("rtsp://", "rtsps://", "http://", "https://", "udp://", "tcp://", "srt://")
PICTURES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".webp"})
AtEnd = Literal["loop", "end"]
_OF_DECODERS = {"max_pixels": str(MAX_PIXELS)}
_LIMIT = f"at most {MAX_PIXELS / 1e6:.0f} million pixels are read"


@dataclass(frozen=True, slots=True)
class Shot:
    """A frame with its age."""

    image: Image
    """(256, 256, 3) uint8 RGB."""
    time: float
    """Time of reception, `time.monotonic`, s; latency of camera and network is unknown."""
    age_s: float
    """Age when it was read, s."""


class Camera(Protocol):
    """A camera."""

    def read(self) -> Shot:
        """The newest frame; raises `CameraError` if there is none, or no more will arrive."""

    def close(self) -> None:
        """Close the source."""


@dataclass(frozen=True, slots=True)
class CameraConfig:
    """Options for reading a source."""

    rate_hz: float = 10.0
    """Frame rate of a folder of images."""
    at_end: AtEnd = "end"
    """At the end of a folder or file: start again, or raise `CameraError`."""
    silence_s: float = 3.0
    """A stream or device without a frame for this long counts as broken."""
    open_s: float = 10.0
    """Time limit to open a source and get its first frame."""


class WatchedCamera:
    """A camera whose frames count as new only where they differ from the last one, and that remembers the last read.

    In flight a real camera never sees the same twice, to the bit: one that seems to has hung, and its frame grows old.
    Not so on the ground, through a codec, nor from a renderer without noise: until `active`, every frame counts as new.
    """

    def __init__(self, camera: Camera) -> None:
        self.active = False
        self.seen_at = time.monotonic()
        """When the last frame that was read had been received, of `time.monotonic`, s."""
        self._camera = camera
        self._changed: Shot | None = None

    def read(self) -> Shot:
        """The newest frame, as old as the first of those like it."""
        shot, changed = self._camera.read(), self._changed
        if not self.active or changed is None or not np.array_equal(shot.image, changed.image):
            changed = self._changed = shot
        self.seen_at = changed.time
        return Shot(shot.image, changed.time, shot.age_s + shot.time - changed.time)

    def close(self) -> None:
        """Let go of the source."""
        self._camera.close()


def open_camera(source: str, config: CameraConfig | None = None) -> Camera:
    """Open a source listed in this module's table; raises `CameraError`."""
    config = config or CameraConfig()
    if source.startswith(STREAMS):
        return VideoCamera(source, config, live=True)
    if source.startswith(system.DEVICES):
        if source.startswith("/") and not Path(source).exists():
            known = ", ".join(sorted(str(p) for p in Path("/dev").glob("video*"))) or "none"
            raise CameraError(f"there is no camera {source}; cameras of this machine: {known}")
        return VideoCamera(source, config, live=True, container=system.CAMERA_FORMAT)
    path = Path(source)
    if path.is_dir():
        return FolderCamera(path, config)
    if not path.is_file():
        raise CameraError(
            f"there is no camera {source!r}: expected a folder of images, a video file, {system.CAMERA}, or a URL such"
            " as rtsp://HOST/PATH"
        )
    return VideoCamera(source, config, live=False)


def fit(image: Image) -> Image:
    """The central square of an (H, W, 3) image, resized to (256, 256, 3)."""
    height, width = image.shape[:2]
    side = min(height, width)
    top, left = (height - side) // 2, (width - side) // 2
    square = image[top : top + side, left : left + side]
    if side == IMAGE_SIZE:
        return np.ascontiguousarray(square)
    resized = Pictures.fromarray(np.ascontiguousarray(square)).resize((IMAGE_SIZE, IMAGE_SIZE), Pictures.Resampling.BOX)
    return np.asarray(resized)


def cropped_fov(horizontal_fov: float, width: int, height: int) -> float:
    """Field of view, rad, of the central square of an undistorted image with `horizontal_fov` over its width."""
    return 2 * math.atan(math.tan(horizontal_fov / 2) * min(width, height) / width)


class FolderCamera:
    """The images of a folder in order of name; the first on the first read, the rest on schedule."""

    def __init__(self, folder: Path, config: CameraConfig) -> None:
        files = [file for file in folder.iterdir() if not is_hidden(PurePath(file.name))]
        self._files = sorted(
            (file for file in files if file.suffix.lower() in PICTURES), key=lambda file: natural_order(file.name)
        )
        others = sorted({file.suffix.lower() for file in files} & {*OTHER_SUFFIXES})
        unread = f"those there ({', '.join(others)}) are not read, save them as PNG or JPEG" if others else ""
        if not self._files:
            raise CameraError(f"{folder} has no image ({', '.join(sorted(PICTURES))}){unread and '; '}{unread}")
        if unread:
            warnings.warn(f"{folder} has pictures of other kinds: {unread}", stacklevel=2)
        self._config = config
        self._start: float | None = None
        self._shown: tuple[int, Image] = (0, _picture(self._files[0]))

    def read(self) -> Shot:
        """The image that is due."""
        now = time.monotonic()
        self._start = now if self._start is None else self._start
        turn = int((now - self._start) * self._config.rate_hz)
        if turn >= len(self._files) and self._config.at_end == "end":
            raise CameraError(f"the {len(self._files)} images of {self._files[0].parent} have all been shown")
        index = turn % len(self._files)
        if index != self._shown[0]:
            self._shown = (index, _picture(self._files[index]))
        since = self._start + turn / self._config.rate_hz
        return Shot(self._shown[1], since, now - since)

    def close(self) -> None:
        """Do nothing: no file is open."""


class VideoCamera:
    """A video file, a stream or a device, read by a thread that keeps the newest frame.

    `live` sources deliver frames as they arrive, and may stop; files are paced by their time stamps and end.
    """

    def __init__(self, source: str, config: CameraConfig, *, live: bool, container: str | None = None) -> None:
        self._source, self._config, self._live, self._container = source, config, live, container
        self._news = threading.Condition()
        self._stopping = threading.Event()
        self._newest: tuple[Image, float] | None = None
        self._over: str | None = None
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)
        self._thread.start()
        with self._news:
            self._news.wait_for(lambda: self._newest is not None or self._over is not None, config.open_s)
            newest, over = self._newest, self._over
        if newest is None:
            self._stopping.set()
            raise CameraError(over or f"{source} gave no frame within {config.open_s:g} s")

    def read(self) -> Shot:
        """The newest frame."""
        with self._news:
            newest, over = self._newest, self._over
        if over is not None or newest is None:
            raise CameraError(over or f"{self._source} gave no frame")
        image, received = newest
        age = time.monotonic() - received
        if self._live and age > self._config.silence_s:
            raise CameraError(f"{self._source} has given no frame for {age:.1f} s; is it still connected?")
        return Shot(image, received, age)

    def close(self) -> None:
        """Close the source; a blocking read ends at its own time limit."""
        self._stopping.set()
        self._thread.join(timeout=1.0)

    def _run(self) -> None:
        try:
            frames = self._frames()
            for image in frames:
                with self._news:
                    self._newest = (image, time.monotonic())
                    self._news.notify_all()
            why = f"{self._source} has ended" if not self._live else f"{self._source} was closed by the other side"
        except (av.error.FFmpegError, OSError, ValueError) as error:
            # What FFmpeg says of a frame beyond `max_pixels`, without a reason; broken frames are another error.
            too_large = isinstance(error, av.error.ArgumentError) and "avcodec_send_packet" in str(error)
            what = f"its frames are too large; {_LIMIT}" if too_large else str(error)
            if isinstance(error, av.error.ExitError):  # FFmpeg's word for a time limit of ours
                what = f"it sent nothing for {self._config.silence_s:g} s; is it still connected?"
            why = f"cannot read {self._source}: {what}"
        with self._news:
            self._over = why
            self._news.notify_all()

    def _frames(self) -> Iterator[Image]:
        """Yield frames when they are due, until the end or until closed."""
        while True:
            begin: float | None = None
            with self._open() as container:
                if not container.streams.video:
                    raise ValueError("it contains no video")
                container.streams.video[0].codec_context.options = _OF_DECODERS
                for frame in container.decode(video=0):
                    if not self._live:
                        now, due = time.monotonic(), float(frame.time or 0.0)
                        begin = now - due if begin is None else begin
                        if self._stopping.wait(max(0.0, begin + due - now)):
                            return
                    if self._stopping.is_set():
                        return
                    if frame.width * frame.height > MAX_PIXELS:
                        raise ValueError(f"its frame has {frame.width} x {frame.height} pixels; {_LIMIT}")
                    yield fit(upright(frame))
            if begin is None or self._config.at_end == "end":
                return

    def _open(self) -> Any:
        # Options of FFmpeg's demuxers: no queue of old frames, and TCP, which never delivers partial frames.
        options = {"fflags": "nobuffer", "rtsp_transport": "tcp"} if self._source.startswith("rtsp") else {}
        options |= _OF_DECODERS  # which run already while the size of the frames is looked for
        timeout = (self._config.open_s, self._config.silence_s) if self._live else None
        if self._container == "avfoundation":
            options["framerate"] = "30"  # its own default is none that cameras have
        name = self._source.removeprefix(f"{self._container}:")
        return av.open(name, format=self._container, options=options, timeout=timeout)


def upright(frame: av.VideoFrame) -> Image:
    """(H, W, 3) RGB of a frame, turned and mirrored as its display matrix says; telephones film lying on their side.

    The matrix is FFmpeg's `display_matrix`: rows (a, b, u), (c, d, v), (x, y, w) as whole numbers; a point (p, q) of
    the frame, p to the right and q down, is shown at (a p + c q, b p + d q).
    """
    image: Image = frame.to_ndarray(format="rgb24")
    try:
        data = frame.side_data.get("DISPLAYMATRIX")
    except (
        ValueError
    ):  # PyAV knows not all side data, such as EXIF (18.1): then only the rotation, in degrees, is known
        return np.ascontiguousarray(np.rot90(image, round(getattr(frame, "rotation", 0) / 90)))
    if data is None or data.buffer_size < 36:
        return image
    a, b, _, c, d, *_ = (int(each) for each in np.frombuffer(bytes(data)[:36], np.int32))
    if abs(b) + abs(c) > abs(a) + abs(d):
        image, a, d = image.transpose(1, 0, 2), c, b
    return np.ascontiguousarray(image[:: -1 if d < 0 else 1, :: -1 if a < 0 else 1])


def _picture(file: Path) -> Image:
    return fit(np.asarray(read_picture(file, "the image", CameraError, max_bytes=MAX_PICTURE_BYTES)))
