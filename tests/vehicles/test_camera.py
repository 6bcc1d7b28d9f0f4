"""Cameras: the newest frame with its age, from folders, files and streams; and clear words about the rest."""

import contextlib
import math
import os
import resource
import socket
import struct
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from io import BytesIO
from pathlib import Path

import av
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import ExifTags
from PIL import Image as Pictures
from waiting import soon

from cognitivedrone.errors import CameraError
from cognitivedrone.pictures import MAX_PICTURE_BYTES
from cognitivedrone.vehicles.camera import CameraConfig, Shot, WatchedCamera, cropped_fov, fit, open_camera


def write_video(path: Path, pictures: list[np.ndarray], rate: int = 20, **options) -> Path:
    with av.open(str(path), "w", **options) as container:
        stream = container.add_stream("mpeg4", rate=rate)
        stream.height, stream.width, stream.pix_fmt = *pictures[0].shape[:2], "yuv420p"
        stream.bit_rate = 8_000_000
        for picture in pictures:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())
    return path


def brighter(count: int) -> list[np.ndarray]:
    """Frames that get brighter by 20 each."""
    return [np.full((240, 320, 3), 20 * (index + 1), np.uint8) for index in range(count)]


@pytest.fixture(scope="module")
def video(tmp_path_factory) -> Path:
    return write_video(tmp_path_factory.mktemp("video") / "flight.mp4", brighter(10))


def wait(holds):
    """What it gives, as soon as that is true."""
    found = None

    def look():
        nonlocal found
        found = holds()
        return found

    soon(look)
    return found


def write_lying(path: Path, matrix: tuple[int, int, int, int], picture: np.ndarray) -> Path:
    """A video of one still picture, whose display matrix a player has to follow."""
    content = bytearray(write_video(path, [picture] * 3, rate=10, format="mp4").read_bytes())
    place = content.index(b"tkhd") + 4 + 40
    assert struct.unpack_from(">9i", content, place) == (1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30)
    a, b, c, d = (65536 * value for value in matrix)
    struct.pack_into(">9i", content, place, a, b, 0, c, d, 0, 0, 0, 1 << 30)
    path.write_bytes(content)
    return path


def over(camera) -> str:
    """What a camera says when it has come to its end."""
    return wait(lambda: shot_or_end(camera)[1])


def shot_or_end(camera) -> tuple[Shot | None, str]:
    try:
        return camera.read(), ""
    except CameraError as error:
        return None, str(error)


@pytest.fixture(scope="module")
def huge() -> bytes:
    """A JPEG of 12,000 x 12,000 pixels in 1.7 MB."""
    coded = BytesIO()
    Pictures.new("L", (12_000, 12_000)).save(coded, "JPEG", quality=1)
    return coded.getvalue()


def test_huge_images_pipes_and_sparse_files_in_a_folder_are_refused_before_they_are_read(tmp_path, huge):
    file = tmp_path / "1.png"
    file.write_bytes(huge)
    with pytest.raises(CameraError, match=r"1\.png has 12000x12000 pixels; at most 40 million are read"):
        open_camera(str(tmp_path))
    with file.open("wb") as opened:
        opened.truncate(MAX_PICTURE_BYTES + 1)
    with pytest.raises(CameraError, match=rf"1\.png cannot be read: it has {MAX_PICTURE_BYTES + 1:,} bytes"):
        open_camera(str(tmp_path))
    file.unlink()
    os.mkfifo(file)
    with pytest.raises(CameraError, match=r"1\.png cannot be read: it is a pipe"):
        open_camera(str(tmp_path))


def test_huge_frames_of_a_video_are_refused_before_they_are_decoded(tmp_path, huge):
    (tmp_path / "camera.mjpeg").write_bytes(2 * huge)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(CameraError, match="its frames are too large; at most 40 million pixels are read"):
        open_camera(str(tmp_path / "camera.mjpeg"))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # kB; one such frame has 144 MB


def test_frames_that_become_huge_end_the_camera(tmp_path, huge):
    small = BytesIO()
    Pictures.new("RGB", (320, 240), (200, 0, 0)).save(small, "JPEG")
    (tmp_path / "camera.mjpeg").write_bytes(small.getvalue() + 2 * huge)
    camera = open_camera(str(tmp_path / "camera.mjpeg"))
    assert "its frames are too large" in over(camera)
    camera.close()


@given(st.integers(1, 700), st.integers(1, 700))
def test_any_image_fits(height, width):
    image = np.zeros((height, width, 3), np.uint8)
    image[..., 1] = 200
    fitted = fit(image)
    assert (fitted.shape, fitted.dtype) == ((256, 256, 3), np.uint8)
    assert (fitted == [0, 200, 0]).all()


def test_the_middle_square_is_what_is_seen():
    image = np.zeros((480, 640, 3), np.uint8)
    image[:, 80:560] = 255
    assert fit(image).min() == 255
    image[:, 320:] = 0
    assert fit(image)[:, :127].min() == 255
    assert fit(image)[:, 129:].max() == 0


def test_what_cropping_leaves_of_the_field_of_view():
    assert cropped_fov(1.85, 256, 256) == pytest.approx(1.85)
    assert cropped_fov(math.radians(90), 200, 100) == pytest.approx(2 * math.atan(0.5))
    assert cropped_fov(1.0, 480, 640) == pytest.approx(1.0)


def write_folder(folder: Path, count: int = 3) -> Path:
    for index in range(count):
        Pictures.new("RGB", (300, 200), (60 * (index + 1), 0, 0)).save(folder / f"{index:02}.png")
    (folder / "notes.txt").write_text("not an image")
    return folder


def test_a_folder_is_shown_in_order_and_ends(tmp_path):
    camera = open_camera(str(write_folder(tmp_path)), CameraConfig(rate_hz=5))
    reds, began = [], time.monotonic()

    def ended() -> str:
        shot, end = shot_or_end(camera)
        if shot:
            assert 0 <= shot.age_s <= 0.2 + 1e-6
            reds.append(int(shot.image[0, 0, 0]))
        return end

    assert wait(ended) == f"the 3 images of {tmp_path} have all been shown"
    assert time.monotonic() - began > 0.5
    assert reds == sorted(reds)
    assert set(reds) == {60, 120, 180}


def test_a_folder_begins_again(tmp_path):
    camera = open_camera(str(write_folder(tmp_path, 2)), CameraConfig(rate_hz=50, at_end="loop"))
    seen = [60]
    while len(seen) < 5:
        if (red := int(camera.read().image[0, 0, 0])) != seen[-1]:
            seen.append(red)
    assert seen == [60, 120, 60, 120, 60]
    camera.close()


def test_a_video_is_shown_at_its_own_pace_and_ends(video):
    opened = time.monotonic()
    camera = open_camera(str(video))
    shown: dict[int, float] = {}

    def ended() -> str:
        before, (shot, end) = time.monotonic(), shot_or_end(camera)
        if shot:
            assert shot.image.shape == (256, 256, 3)
            assert before <= shot.time + shot.age_s <= time.monotonic()
            shown.setdefault(round(shot.image.mean() / 20) - 1, shot.time)
        return end

    assert wait(ended) == f"{video} has ended"
    assert list(shown) == sorted(shown)
    assert set(shown) <= set(range(10))
    assert all(at >= opened + number / 20 for number, at in shown.items())  # on a busy machine it may be later
    camera.close()


def test_a_video_begins_again(video):
    camera = open_camera(str(video), CameraConfig(at_end="loop"))
    wait(lambda: camera.read().image.mean() > 180)
    wait(lambda: camera.read().image.mean() < 60)
    camera.close()


def test_a_slow_reader_sees_the_newest_frame(video):
    camera = open_camera(str(video), CameraConfig(at_end="loop"))
    first = camera.read()
    came = wait(lambda: camera._newest[1] if camera._newest[1] > first.time + 0.15 else None)
    assert camera.read().time >= came
    camera.close()


def quarters() -> np.ndarray:
    """A square of red, green, blue and white quarters, clockwise from the upper left."""
    picture = np.full((128, 128, 3), 255, np.uint8)
    picture[:64, :64], picture[:64, 64:], picture[64:, 64:] = (255, 0, 0), (0, 255, 0), (0, 0, 255)
    return picture


def order_of(image: np.ndarray) -> str:
    """The colours of the quarters, clockwise from the upper left."""
    picked = (image[y, x].astype(int) for y, x in ((60, 60), (60, 196), (196, 196), (196, 60)))
    return "".join("w" if each.min() > 127 else "rgb"[int(each.argmax())] for each in picked)


TURNS = {
    (1, 0, 0, 1): lambda stored: stored,
    (0, 1, -1, 0): lambda stored: np.rot90(stored, 1),  # a telephone held upright
    (-1, 0, 0, -1): lambda stored: np.rot90(stored, 2),
    (0, -1, 1, 0): lambda stored: np.rot90(stored, 3),
    (-1, 0, 0, 1): lambda stored: stored[:, ::-1],  # its camera at the front
    (1, 0, 0, -1): lambda stored: stored[::-1],
    (0, 1, 1, 0): lambda stored: stored.transpose(1, 0, 2),
    (0, -1, -1, 0): lambda stored: np.rot90(stored.transpose(1, 0, 2), 2),
}
"""Display matrix (a, b, c, d), and how a picture is stored that it shows upright."""


@pytest.mark.parametrize("wide", [False, True])
@pytest.mark.parametrize("matrix", TURNS)
def test_a_video_is_shown_upright_and_cropped_after_it_is_turned(tmp_path, matrix, wide):
    shown = np.pad(quarters(), ((32, 32), (0, 0), (0, 0))) if wide else quarters()
    stored = np.ascontiguousarray(TURNS[matrix](shown))
    video = write_lying(tmp_path / ("a.mov" if wide else "phone.mp4"), matrix, stored)
    camera = open_camera(str(video), CameraConfig(at_end="loop"))
    assert order_of(camera.read().image) == "rgbw"
    camera.close()


def test_a_picture_is_shown_upright_in_a_folder_and_as_a_video(tmp_path):
    exif = Pictures.Exif()
    exif[ExifTags.Base.Orientation] = 6
    Pictures.fromarray(np.rot90(quarters(), 1)).save(tmp_path / "a.jpg", exif=exif)
    assert order_of(open_camera(str(tmp_path)).read().image) == "rgbw"
    # By PyAV.
    assert order_of(open_camera(str(tmp_path / "a.jpg"), CameraConfig(at_end="loop")).read().image) == "rgbw"


def frames_in_order(folder: Path) -> list[int]:
    """The red of every frame of a folder, by a clock that runs as it is told."""
    camera = open_camera(str(folder), CameraConfig(rate_hz=1.0))
    seen = []
    with pytest.MonkeyPatch.context() as patch, contextlib.suppress(CameraError):
        for second in range(1000):
            patch.setattr(time, "monotonic", lambda now=second + 0.5: now)
            seen.append(int(camera.read().image[0, 0, 0]))
    return seen


def test_frames_are_sorted_as_people_count_and_hidden_ones_are_none(tmp_path):
    for number in (0, 1, 2, 9, 10, 11, 100):
        Pictures.new("RGB", (64, 64), (number, 0, 0)).save(tmp_path / f"{'F' if number % 2 else 'f'}rame{number}.png")
    (tmp_path / ".hidden.png").write_bytes((tmp_path / "Frame9.png").read_bytes())
    (tmp_path / "._frame0.png").write_bytes(b"\0\5\x16\7")
    assert frames_in_order(tmp_path) == [0, 1, 2, 9, 10, 11, 100]


def test_a_folder_says_which_pictures_are_not_read(tmp_path):
    for name in ("IMG_1.HEIC", "b.tif", "c.txt", "._d.gif"):
        (tmp_path / name).write_bytes(b"x")
    with pytest.raises(CameraError, match=r"those there \(\.heic, \.tif\) are not read, save them as PNG or JPEG"):
        open_camera(str(tmp_path))
    Pictures.new("RGB", (64, 64)).save(tmp_path / "1.png")
    with pytest.warns(UserWarning, match=r"pictures of other kinds: those there \(\.heic, \.tif\) are not read"):
        open_camera(str(tmp_path))
    (tmp_path / "b.tif").unlink()
    (tmp_path / "IMG_1.HEIC").unlink()
    (tmp_path / "0.jpg").write_bytes(b"\0\0\0\x18ftypheic\0\0\0\0mif1heic")
    with pytest.raises(CameraError, match=r"the image .*0\.jpg cannot be read as PNG, JPEG or WebP: it is a HEIC"):
        open_camera(str(tmp_path))


@pytest.fixture
def stream(tmp_path):
    """A stream over TCP for the first who connects, which then falls silent until its second part is called."""
    data = write_video(tmp_path / "stream.ts", brighter(12), format="mpegts").read_bytes()
    with socket.create_server(("127.0.0.1", 0)) as server, ThreadPoolExecutor() as pool:
        stop = threading.Event()

        def send() -> None:
            with server.accept()[0] as connection:
                connection.sendall(data)
                stop.wait(60)

        pool.submit(send)
        yield f"tcp://127.0.0.1:{server.getsockname()[1]}", stop.set
        stop.set()


def test_a_stream_is_read_and_its_silence_is_reported(stream):
    camera = open_camera(stream[0], CameraConfig(silence_s=0.4))
    assert camera.read().image.shape == (256, 256, 3)
    output = over(camera)
    assert "has given no frame for" in output or f"cannot read {stream[0]}" in output
    camera.close()


def test_a_stream_that_is_closed(stream):
    url, hang_up = stream
    camera = open_camera(url)
    hang_up()
    assert over(camera) == f"{url} was closed by the other side"
    camera.close()


def test_what_cannot_be_opened(tmp_path):
    (tmp_path / "empty").mkdir()
    text = tmp_path / "notes.mp4"
    text.write_text("no video\n" * 100)
    sound = tmp_path / "sound.wav"
    with av.open(str(sound), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000, layout="mono")
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), format="s16", layout="mono")
        frame.rate = 8000
        container.mux(stream.encode(frame))
        container.mux(stream.encode())
    broken = tmp_path / "broken"
    broken.mkdir()
    (broken / "a.png").write_bytes(b"not a picture")
    with socket.socket() as nobody:
        nobody.bind(("127.0.0.1", 0))
        for source, output in (
            ("/dev/video-none", "there is no camera /dev/video-none; cameras of this machine:"),
            (str(tmp_path / "no.mp4"), "expected a folder of images, a video file"),
            (str(tmp_path / "empty"), "has no image"),
            (str(broken), "the image .*a.png cannot be read as PNG, JPEG or WebP: it is text that begins with"),
            (str(text), "cannot read .*notes.mp4"),
            (str(sound), "it contains no video"),
            (f"tcp://127.0.0.1:{nobody.getsockname()[1]}", "cannot read tcp://"),
        ):
            with pytest.raises(CameraError, match=output):
                open_camera(source)


class Pictured:
    """Frames at given times; it is read a twentieth of a second after each."""

    def __init__(self, *frames: tuple[float, int]) -> None:
        self._frames = list(frames)

    def read(self) -> Shot:
        at, brightness = self._frames.pop(0)
        return Shot(np.full((256, 256, 3), brightness, np.uint8), at, 0.05)

    def close(self) -> None:
        self._frames = []


def test_a_camera_that_repeats_one_frame_grows_old():
    camera = WatchedCamera(Pictured((1.0, 7), (1.1, 7), (1.6, 7), (1.7, 8), (1.8, 8), (2.0, 8), (2.1, 8)))
    assert [camera.read().age_s for _ in range(2)] == pytest.approx([0.05, 0.05])  # on the ground
    camera.active = True
    assert [camera.read().age_s for _ in range(4)] == pytest.approx([0.55, 0.05, 0.15, 0.35])
    camera.active = False
    assert camera.read().age_s == pytest.approx(0.05)


def test_a_stream_that_stalls_is_told_in_our_words(monkeypatch):
    def stalls(*_, **__):
        raise av.error.ExitError(1414092869, "Immediate exit requested", "rtsp://drone/")

    monkeypatch.setattr(av, "open", stalls)
    with pytest.raises(CameraError, match=r"it sent nothing for 1\.5 s; is it still connected\?"):
        open_camera("rtsp://127.0.0.1:1/", CameraConfig(silence_s=1.5))
