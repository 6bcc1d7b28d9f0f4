import ctypes
import os
import subprocess
import sys
import threading
from types import ModuleType, SimpleNamespace

import pytest

from cognitivedrone.errors import RenderError
from cognitivedrone.sim.drawing import contexts, gl


@pytest.fixture
def fresh(monkeypatch):
    """A process that knows of no backend yet."""
    monkeypatch.setattr(gl, "_chosen", None)
    for name in (gl._REMEMBERED, "MUJOCO_GL"):
        monkeypatch.setenv(name, "")
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    return monkeypatch


def absent(name: str, without: object = ()) -> str:
    raise RenderError(f"{name} is not there")


def test_the_probe_finds_what_really_works():
    name = gl.backend().name
    assert gl._probe(name) == gl.renderer_name()
    with pytest.raises(RenderError, match=r"No module named 'mujoco.nonsense'"):
        gl._probe("nonsense")


def test_egl_first_then_osmesa(fresh):
    tried = []

    def probe(name):
        tried.append(name)
        return "softpipe" if name == "osmesa" else absent(name)

    fresh.setattr(gl, "_probe", probe)
    assert gl.backend() == gl.Backend("osmesa", "softpipe")
    assert tried == ["egl", "osmesa"]
    assert gl.renderer_name() == "softpipe"
    assert tried == ["egl", "osmesa"]


def test_children_learn_from_the_environment(fresh):
    fresh.setattr(gl, "_probe", lambda name: f"a {name}: fast")
    found = gl.backend()
    assert os.environ[gl._REMEMBERED]
    fresh.setattr(gl, "_chosen", None)
    fresh.setattr(gl, "_probe", lambda name: pytest.fail("probed again"))
    assert gl.backend() == found


def test_the_users_choice_counts(fresh):
    fresh.setattr(gl, "_probe", lambda name: "any")
    assert gl.backend().name == "egl"
    fresh.setenv("MUJOCO_GL", "OSMesa")
    assert gl.backend().name == "osmesa"
    fresh.setenv("MUJOCO_GL", "glfw")
    with pytest.raises(RenderError, match="MUJOCO_GL=glfw cannot render without a screen; unset it"):
        gl.backend()


def test_no_opengl_is_one_sentence_with_its_own_error_and_the_line_to_type(fresh):
    for name in [name for name in os.environ if gl._STEERING.match(name)]:
        fresh.delenv(name)
    fresh.setattr(gl, "_probe", absent)
    with pytest.raises(
        RenderError,
        match=r"egl: egl is not there; osmesa: osmesa is not there\).*apt-get install -y libegl1 libgl1-mesa-dri",
    ) as caught:
        gl.backend()
    assert "\n" not in str(caught.value)
    assert "variables" not in str(caught.value)


@pytest.mark.parametrize(
    ("variable", "value", "own_error"),
    [("MUJOCO_EGL_DEVICE_ID", "3", "must be an integer between 0 and"), ("LIBGL_DRIVERS_PATH", "/nowhere", "/nowhere")],
)
def test_a_variable_that_keeps_opengl_from_starting_is_named(fresh, variable, value, own_error):
    fresh.setenv(variable, value)
    fresh.setenv("MESA_DEBUG", "silent")  # steers it too, and does no harm
    try:
        renderer = gl._probe("egl")
    except RenderError:
        pass
    else:
        pytest.skip(f"this machine's OpenGL does not mind: {renderer}")
    with pytest.raises(RenderError) as caught:
        gl.backend()
    said = str(caught.value)
    assert said.startswith(f"OpenGL does not start with {variable}={value} (egl: ")
    assert "unset it, without it it starts here" in said
    assert own_error in said or variable == "LIBGL_DRIVERS_PATH"  # in the words of the driver
    assert "install" not in said
    assert "\n" not in said


def test_variables_without_which_it_does_not_start_either_are_named_beside_the_installation(fresh):
    fresh.setattr(gl, "_probe", absent)
    fresh.setenv("LIBGL_DRIVERS_PATH", "/no\x1bwhere")
    with pytest.raises(RenderError) as caught:
        gl.backend()
    assert r"LIBGL_DRIVERS_PATH=/no\x1bwhere" in str(caught.value)
    assert "check them first" in str(caught.value)
    assert "If it is not installed: apt-get install" in str(caught.value)


def test_a_backend_that_fails_late_is_one_sentence_too():
    with pytest.raises(RenderError, match=r"OpenGL does not start \(nonsense: No module named.*apt-get install"):
        gl.create_context("nonsense", 16, 16)


def test_a_context_lives_in_a_thread_of_its_own():
    thread = gl.GLThread(16, 16)
    try:
        assert thread.call(threading.get_ident).result() == thread.call(threading.get_ident).result()
        assert thread.call(threading.get_ident).result() != threading.get_ident()
        with pytest.raises(ZeroDivisionError):
            thread.call(lambda: 1 // 0).result()
        assert thread.call(lambda: "goes on").result() == "goes on"
    finally:
        thread.stop()
    thread.stop()
    with pytest.raises(RenderError, match="closed"):
        thread.call(threading.get_ident)


def test_without_a_second_display_threads_share_the_first(monkeypatch):
    def missing(renderer):
        raise RuntimeError(f"no second display for {renderer}")

    monkeypatch.setattr(gl, "SecondDisplay", missing)
    thread = gl.GLThread(16, 16, display=1)
    try:
        assert type(thread._context).__module__ == f"mujoco.{gl.backend().name}"
    finally:
        thread.stop()


def test_a_second_display_has_the_same_renderer_or_is_none():
    thread = gl.GLThread(16, 16)
    try:
        refused = thread.call(lambda: gl.SecondDisplay("another renderer")).exception()
        assert isinstance(refused, Exception)
    finally:
        thread.stop()


def test_quitting_without_closing_prints_nothing():
    program = "from cognitivedrone.sim.drawing.camera import Cameras; c = Cameras(2, 32, threads=2); print(c.size)"
    child = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert (child.returncode, child.stdout, child.stderr) == (0, "32\n", "")


@pytest.mark.parametrize("name", ["nonsense", "osmesa"])
def test_a_broken_choice_of_the_users_breaks_nothing_until_something_is_drawn(name):
    program = (
        "import sys\n"
        "sys.modules['OpenGL.osmesa'] = None  # also where it is installed\n"
        "from cognitivedrone.cli import main\n"
        "from cognitivedrone.sim.drawing import gl\n"
        "def absent(name, without=()): raise gl.RenderError(name + ' is not there')\n"
        "gl._probe = absent\n"
        "main(['list'])\n"
        "main(['view'])\n"
    )
    environment = {**os.environ, "MUJOCO_GL": name, gl._REMEMBERED: ""}
    child = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=environment, timeout=60)
    assert child.returncode == 2
    assert "--reasoner" in child.stdout
    assert f"MUJOCO_GL={name}" in child.stderr
    assert child.stderr.count("\n") == 1


def test_the_users_choice_that_is_not_installed_says_what_installs_it(fresh):
    fresh.setattr(gl, "_probe", lambda name, without=(): "llvmpipe" if name == "egl" else absent(name))
    fresh.setenv("MUJOCO_GL", "osmesa")
    with pytest.raises(
        RenderError,
        match=r"with MUJOCO_GL=osmesa \(osmesa: osmesa is not there\); unset it, .*, or install it: .* libosmesa6",
    ):
        gl.backend()


def test_a_test_that_runs_out_of_time_says_nothing_of_an_installation(fresh):
    """A machine that is busy has an OpenGL, too."""

    def slow(command, **_):
        raise subprocess.TimeoutExpired(command, gl._PROBE_S)

    fresh.setattr(subprocess, "run", slow)
    fresh.setattr(gl, "_SLOW", "as while nobody is logged in at the Mac's own screen: log in there")
    with pytest.raises(RenderError, match=r"not known whether OpenGL starts \(egl: .* within 120 s;") as caught:
        gl.backend()
    assert "install" not in str(caught.value)
    assert "nobody is logged in at the Mac's own screen: log in there; try again" in str(caught.value)


def test_a_limit_of_memory_is_named_where_the_driver_says_nothing_of_it(fresh):
    fresh.setattr(gl, "tight_limit", lambda: "raise it first")
    fresh.setenv("LIBGL_DRIVERS_PATH", "/nowhere")
    with pytest.raises(RenderError, match=r"OpenGL does not start \(nonsense: .*\); raise it first$"):
        gl.create_context("nonsense", 16, 16)


class FakeCgl:
    """Of MuJoCo's bindings of macOS, what a context calls, and the calls."""

    class CGLPixelFormatAttribute:
        CGLPFAOpenGLProfile, CGLPFAColorSize, CGLPFAAlphaSize, CGLPFADepthSize, CGLPFAStencilSize = 99, 8, 11, 12, 13

    class CGLOpenGLProfile:
        CGLOGLPVersion_Legacy = 0x1000

    CGLContextObj = CGLPixelFormatObj = ctypes.c_void_p
    GLint = ctypes.c_int

    def __init__(self, works: bool) -> None:
        self.works = works
        self.wanted: list[int] = []

    def CGLChoosePixelFormat(self, wanted, pixels, count) -> None:  # noqa: N802
        self.wanted = [*wanted]
        pixels._obj.value = 7 if self.works else None

    def CGLCreateContext(self, pixels, share, context) -> None:  # noqa: N802
        context._obj.value = pixels.value + 1


@pytest.mark.parametrize("works", [True, False])
def test_a_mac_draws_with_or_without_a_card(monkeypatch, works):
    made, cgl = ModuleType("mujoco.cgl"), FakeCgl(works)
    made.GLContext, made.cgl = type("GLContext", (), {}), cgl
    monkeypatch.setitem(sys.modules, "mujoco.cgl", made)
    if works:
        context = contexts.create("cgl", 16, 16)
        assert (context._pix.value, context._context.value) == (7, 8)
        assert isinstance(context, made.GLContext)  # whose way to be current and to be freed is MuJoCo's
    else:
        with pytest.raises(RuntimeError, match="no pixel format"):
            contexts.create("cgl", 16, 16)
    assert cgl.wanted[-1] == 0
    assert 73 not in cgl.wanted  # CGLPFAAccelerated


def test_a_window_that_cannot_be_made_is_said(monkeypatch):
    glfw, made = ModuleType("glfw"), ModuleType("mujoco.glfw")
    glfw.get_error = lambda: (65542, b"WGL: The driver does not support OpenGL")
    made.GLContext = lambda width, height: SimpleNamespace(_context=None)
    monkeypatch.setitem(sys.modules, "glfw", glfw)
    monkeypatch.setitem(sys.modules, "mujoco.glfw", made)
    with pytest.raises(RuntimeError, match=r"GLFW makes no window .*The driver does not support OpenGL"):
        contexts.create("wgl", 16, 16)
