"""What draws, how many contexts it gets, and how frames are read from it. The names of cards are pretended ones."""

import threading

import numpy as np
import pytest

from cognitivedrone.benchmark.reports import catalogue
from cognitivedrone.errors import FirstFrameError, RenderError
from cognitivedrone.sim.drawing import camera, gl, readback, renderers
from cognitivedrone.sim.drawing.camera import Cameras
from cognitivedrone.types import DroneState, Gate, Images, Stage
from cognitivedrone.world.engine import mujoco
from cognitivedrone.world.geometry import START

LLVMPIPE = "llvmpipe (LLVM 19.1.7, 256 bits)"
CARD = "NVIDIA H100 80GB HBM3/PCIe/SSE2"
OTHER_CARD = "AMD Radeon RX 7900 XTX (radeonsi, navi31)"
STAGE = Stage(
    gates=(Gate("big", "round", "red"), Gate("small", "square", "green"), Gate("big", "triangle", "blue")),
    labels=("number/1@inter", "number/2@inter", "number/3@inter"),
)
PICTURES = [np.full((64, 64, 3), shade, np.uint8) for shade in (40, 128, 220)]


@pytest.fixture
def fresh(monkeypatch):
    """A process that knows of no backend yet, and a person who has chosen nothing."""
    monkeypatch.setattr(gl, "_chosen", None)
    for name in (gl._REMEMBERED, "MUJOCO_GL", renderers.CHOICE, renderers.DEVICE):
        monkeypatch.setenv(name, "")
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    return monkeypatch


def devices(fresh: pytest.MonkeyPatch, *names: str) -> list[int | None]:
    """Pretend that EGL has devices, whose renderers are `names`, and that there is no OSMesa; which are tried."""
    tried: list[int | None] = []

    def probe(name: str, without: object = (), device: int | None = None) -> str:
        if name != "egl" or (device or 0) >= len(names):
            raise RenderError(f"{name} is not there")
        tried.append(device)
        return names[device or 0]

    fresh.setattr(gl, "_probe", probe)
    return tried


@pytest.mark.parametrize(
    ("name", "found"),
    [(LLVMPIPE, True), ("softpipe", True), ("Software Rasterizer", True), (CARD, False), (OTHER_CARD, False)],
)
def test_who_draws_on_the_processor(name, found):
    assert renderers.on_processor(name) is found


@pytest.mark.parametrize(
    ("name", "slots", "threads", "found"),
    [(LLVMPIPE, 16, 8, 8), (CARD, 16, 16, 1), (OTHER_CARD, 200, 2, 1), (CARD, 201, 8, 2), (CARD, 1, 1, 1)],
)
def test_a_card_gets_as_few_contexts_as_hold_the_slots(name, slots, threads, found):
    assert renderers.contexts_for(name, slots, threads, 200) == found


def drawn(cameras: Cameras) -> Images:
    for slot in range(cameras.slots):
        cameras.set_stage(slot, STAGE, PICTURES[slot % 3 :] + PICTURES[: slot % 3])
    places = START + np.linspace(0, 0.5, cameras.slots)[:, None]
    return cameras.first_person(places, np.tile([1.0, 0.0, 0.0, 0.0], (cameras.slots, 1)))


def test_cameras_on_a_card_share_a_context_and_draw_the_same(monkeypatch):
    with Cameras(5, 48, threads=2) as cameras:
        frames = drawn(cameras)
        assert len(cameras._threads) == 2
    monkeypatch.setattr(camera, "renderer_name", lambda: CARD)
    with Cameras(5, 48, threads=2) as cameras:
        assert len(cameras._threads) == 1
        assert isinstance(cameras._renderers[0]._readback, readback.TwoBuffers)
        np.testing.assert_array_equal(drawn(cameras), frames)
    assert frames.std(axis=(1, 2, 3)).min() > 10


@pytest.mark.parametrize("size", [48, 37])  # rows of 111 bytes fit no alignment
@pytest.mark.parametrize("way", ["Mesa turns the rows", "we do", "two buffers"])
def test_every_way_to_read_gives_the_same_bits(way, size, monkeypatch):
    """As OpenGL gives them, with the lowest row first, turned round."""
    with Cameras(3, size) as cameras:
        thread, renderer = cameras._threads[0], cameras._renderers[0]
        if way != "Mesa turns the rows":
            monkeypatch.setattr(readback, "_turns_rows", lambda: False)

        kind = readback.TwoBuffers if way == "two buffers" else readback.OneByOne
        renderer._readback = thread.call(lambda: kind(renderer._context, size, size)).result()
        for slot in range(3):
            cameras.set_stage(slot, STAGE, PICTURES)
        level = np.array([1.0, 0.0, 0.0, 0.0])
        cameras.top(0, DroneState(START.copy(), np.zeros(3), level, np.zeros(3)))  # reads in a way of its own
        frames = drawn(cameras)

        def reference():
            rows = np.empty((size, size, 3), np.uint8)
            mujoco.mjr_render(renderer._viewport, renderer._scenes[2], renderer._context)
            mujoco.mjr_readPixels(rows, None, renderer._viewport, renderer._context)
            return rows[::-1]

        np.testing.assert_array_equal(frames[2], thread.call(reference).result())


def test_a_failed_frame_leaves_nothing_to_the_next_call(monkeypatch):
    monkeypatch.setattr(camera, "renderer_name", lambda: CARD)
    with Cameras(2, 32) as cameras:
        cameras.set_stage(0, STAGE, PICTURES)
        places, level = np.tile(START, (2, 1)), np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))
        alone = cameras.first_person(places[:1], level[:1])
        with pytest.raises(RenderError, match="no stage yet"):
            cameras.first_person(places, level)
        np.testing.assert_array_equal(cameras.first_person(places[:1], level[:1]), alone)


def test_a_choice_between_processor_and_card(fresh):
    tried = devices(fresh, CARD, OTHER_CARD, LLVMPIPE)
    assert gl.backend() == gl.Backend("egl", CARD)
    assert tried == [None]
    assert renderers.why(CARD) == f"OpenGL's first card; {renderers.CHOICE}=cpu draws on the processor"
    fresh.setenv(renderers.CHOICE, "cpu")
    fresh.setattr(gl, "_chosen", None)  # a child, which knows what its parent found without that choice
    assert gl.backend() == gl.Backend("egl", LLVMPIPE, 2)
    assert gl.os.environ[renderers.DEVICE] == "2"
    assert renderers.why(LLVMPIPE) == f"{renderers.CHOICE}=cpu"
    assert tried == [None, None, 0, 1, 2]


def test_a_card_behind_the_processor_is_found(fresh):
    devices(fresh, LLVMPIPE, CARD)
    fresh.setenv(renderers.CHOICE, "gpu")
    assert gl.backend() == gl.Backend("egl", CARD, 1)


@pytest.mark.parametrize(
    ("names", "choice", "device", "says"),
    [
        ([LLVMPIPE], "gpu", "", "gpu, but OpenGL finds no graphics card here, only llvmpipe.*DRIVER_CAPABILITIES"),
        ([CARD], "cpu", "", "cpu, but OpenGL draws by NVIDIA H100.* alone; unset it, or install Mesa: apt-get"),
        ([CARD, LLVMPIPE], "cpu", "0", "cpu, but MUJOCO_EGL_DEVICE_ID=0 draws by NVIDIA.*; unset one of the two"),
        ([CARD], "vulkan", "", "COGNITIVEDRONE_RENDERER=vulkan is no renderer; unset it, or set it to cpu or gpu"),
    ],
)
def test_a_choice_that_is_not_there_is_one_sentence(fresh, names, choice, device, says):
    devices(fresh, *names)
    fresh.setenv(renderers.CHOICE, choice)
    fresh.setenv(renderers.DEVICE, device)
    with pytest.raises(RenderError, match=says) as caught:
        gl.backend()
    assert "\n" not in str(caught.value)


def test_a_card_that_another_program_holds_is_left_alone(fresh):
    for hidden in ("", "-1"):
        fresh.setenv("CUDA_VISIBLE_DEVICES", hidden)
        fresh.setattr(gl, "_chosen", None)
        devices(fresh, CARD, LLVMPIPE)
        assert gl.backend() == gl.Backend("egl", LLVMPIPE, 1)
        assert renderers.why(LLVMPIPE) == "CUDA_VISIBLE_DEVICES hides all cards"
        for name in (renderers.DEVICE, gl._REMEMBERED):
            fresh.setenv(name, "")
    fresh.setattr(gl, "_chosen", None)
    devices(fresh, CARD)
    assert gl.backend() == gl.Backend("egl", CARD)  # it is a setting for computing, after all
    assert renderers.why(CARD) == "CUDA_VISIBLE_DEVICES hides all cards, but nothing else draws here"


def test_why_names_what_decided(fresh, tmp_path):
    assert renderers.why(LLVMPIPE, tmp_path / "no driver") == "OpenGL finds no graphics card"
    assert renderers.why(LLVMPIPE, tmp_path) == (  # CUDA is there, OpenGL is not
        "OpenGL does not find the graphics card of this machine: install the card's OpenGL, in a container by"
        " NVIDIA_DRIVER_CAPABILITIES=all"
    )
    fresh.setenv("CUDA_VISIBLE_DEVICES", "GPU-1a2b")
    assert "does not know the names in CUDA_VISIBLE_DEVICES; MUJOCO_EGL_DEVICE_ID chooses" in renderers.why(CARD)
    fresh.setenv("MUJOCO_GL", "osmesa")
    assert renderers.why("softpipe") == "MUJOCO_GL=osmesa"


def test_the_list_of_names_says_what_draws_and_why(fresh):
    fresh.setattr(catalogue, "renderer_name", lambda: CARD)
    assert catalogue._renderer() == (
        f"Renderer (COGNITIVEDRONE_RENDERER=cpu|gpu): {CARD} "
        "(OpenGL's first card; COGNITIVEDRONE_RENDERER=cpu draws on the processor)"
    )

    def none():
        raise RenderError("OpenGL does not start")

    fresh.setattr(catalogue, "renderer_name", none)
    assert catalogue._renderer() == "Renderer: none. OpenGL does not start"


@pytest.fixture
def stuck():
    """What a hanging read-back waits for, until the test ends."""
    event = threading.Event()
    yield event
    event.set()


def test_a_first_frame_that_does_not_come_ends_the_wait(stuck, monkeypatch):
    monkeypatch.setattr(gl, "FIRST_FRAME_S", 0.0)
    monkeypatch.setattr(gl, "_lost", [])
    thread = gl.GLThread(16, 16)

    def hang():
        stuck.wait(60)

    with pytest.raises(FirstFrameError, match=r"drew no frame within 0 s; let fewer processes draw.*RENDERER=cpu"):
        thread.first(hang)
    thread.stop()  # waits for nothing
    stuck.set()
    thread._stopped = False
    thread.stop()
