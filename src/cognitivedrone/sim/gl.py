"""Off-screen OpenGL: choice of the rendering library, and threads that own a context.

MuJoCo picks a backend on import and fails late, with an unclear error, if that does not work. Here a child
process tries EGL and then OSMesa, once; the result is stored in this process and, in an environment variable, for
its children. A user's own `MUJOCO_GL` takes precedence.
"""

from __future__ import annotations

import atexit
import importlib
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from queue import SimpleQueue
from typing import Any, Final, TypeVar

from cognitivedrone.errors import RenderError

BACKENDS: Final = ("egl", "osmesa")
_REMEMBERED: Final = "COGNITIVEDRONE_GL"
_INSTALL: Final = "apt-get install -y libegl1 libgl1-mesa-dri libopengl0"
_INSTALLS: Final = {"egl": _INSTALL, "osmesa": "apt-get install -y libosmesa6"}
_EGL_PLATFORM_SURFACELESS_MESA: Final = 0x31DD  # EGL_MESA_platform_surfaceless
_PROBE: Final = """
import sys
from cognitivedrone.sim import gl
context = gl.create_context(sys.argv[1], 16, 16)
from OpenGL import GL
print("renderer:", GL.glGetString(GL.GL_RENDERER).decode())
context.free()
"""

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Backend:
    """A rendering backend that was tested to work."""

    name: str
    """egl or osmesa."""
    renderer: str
    """OpenGL's renderer name, for reports: "llvmpipe (LLVM 19.1.7, 256 bits)"."""


_chosen: Backend | None = None


def backend() -> Backend:
    """The rendering backend: `MUJOCO_GL` if the user set it, else the first of EGL and OSMesa that works.

    llvmpipe is set to render in the calling thread, which is faster for small images, unless the user's
    `LP_NUM_THREADS` says otherwise. Raises `RenderError` with the command to install it if nothing works.
    """
    global _chosen
    os.environ.setdefault("LP_NUM_THREADS", "0")  # the library reads it on loading
    wanted = os.environ.get("MUJOCO_GL", "").strip().lower()
    if wanted and wanted not in BACKENDS:
        raise RenderError(f"MUJOCO_GL={wanted} cannot render without a screen; unset it, or set it to egl or osmesa.")
    if _chosen is None or (wanted and wanted != _chosen.name):
        _chosen = _remembered(wanted) or _find(wanted)
        os.environ[_REMEMBERED] = f"{_chosen.name}:{_chosen.renderer}"
    return _chosen


def renderer_name() -> str:
    """OpenGL's renderer name on this machine, for reports."""
    return backend().renderer


def create_context(name: str, width: int, height: int) -> Any:
    """A current OpenGL context of backend `name` for the calling thread, with `make_current()` and `free()`."""
    try:
        context = importlib.import_module(f"mujoco.{name}").GLContext(width, height)
        context.make_current()
    except Exception as error:  # ctypes, PyOpenGL and MuJoCo each fail in their own way
        raise RenderError(f"OpenGL by {name} does not start ({error}). To install it: {_INSTALL}") from None
    return context


class SecondDisplay:
    """An EGL context of the calling thread on a display other than MuJoCo's.

    llvmpipe draws for one context per display at a time, so two threads are twice as fast on two displays
    (`benchmarks/rendering.py`). Raises if there is no such display or another renderer draws it.
    """

    def __init__(self, renderer: str) -> None:
        from mujoco.egl import EGL_ATTRIBUTES
        from mujoco.egl import egl_ext as egl
        from OpenGL import GL

        self._egl = egl
        self._context = None
        self._display = egl.eglGetPlatformDisplayEXT(_EGL_PLATFORM_SURFACELESS_MESA, None, None)
        if not egl.eglInitialize(self._display, None, None):
            raise RuntimeError("no surfaceless display")
        config, count = (egl.EGLConfig * 1)(), egl.EGLint()
        egl.eglChooseConfig(self._display, EGL_ATTRIBUTES, config, 1, count)
        egl.eglBindAPI(egl.EGL_OPENGL_API)
        self._context = egl.eglCreateContext(self._display, config[0], egl.EGL_NO_CONTEXT, None)
        self.make_current()
        if GL.glGetString(GL.GL_RENDERER).decode() != renderer:
            self.free()
            raise RuntimeError("the surfaceless display has another renderer")

    def make_current(self) -> None:
        """Bind the context to the calling thread."""
        surface = self._egl.EGL_NO_SURFACE
        self._egl.eglMakeCurrent(self._display, surface, surface, self._context)

    def free(self) -> None:
        """Unbind and destroy the context; the display is kept for the next one."""
        if self._context is not None:
            surface = self._egl.EGL_NO_SURFACE
            self._egl.eglMakeCurrent(self._display, surface, surface, self._egl.EGL_NO_CONTEXT)
            self._egl.eglDestroyContext(self._display, self._context)
            self._context = None


class GLThread:
    """A thread with an OpenGL context that no other thread ever touches.

    One thread can render while another computes or renders, because MuJoCo releases the interpreter lock meanwhile.
    Threads that render at the same time use different displays (0 or 1).
    """

    def __init__(self, width: int, height: int, display: int = 0) -> None:
        chosen = backend()
        self._jobs: SimpleQueue[tuple[Callable[[], Any], Future[Any]] | None] = SimpleQueue()
        self._process = os.getpid()
        self._stopped = False
        self._thread = threading.Thread(target=_serve, args=(self._jobs,), name="cognitivedrone-gl", daemon=True)
        self._thread.start()
        self._context = self.call(partial(_thread_context, chosen, width, height, display)).result()
        # Registered after MuJoCo's own handler, so it runs first: contexts are freed before the display.
        atexit.register(self.stop)

    def call(self, job: Callable[[], T]) -> Future[T]:
        """Run `job` in the thread, after earlier jobs."""
        if self._stopped:
            raise RenderError("this OpenGL thread is closed; make a new one.")
        if os.getpid() != self._process:
            raise RenderError("OpenGL does not survive a fork; make a camera in each process.")
        future: Future[T] = Future()
        self._jobs.put((job, future))
        return future

    def stop(self) -> None:
        """Free the context and end the thread, once."""
        if self._stopped or os.getpid() != self._process:
            return
        freed = self.call(self._context.free)
        self._stopped = True
        self._jobs.put(None)
        self._thread.join()
        atexit.unregister(self.stop)
        freed.result()


def _thread_context(chosen: Backend, width: int, height: int, display: int) -> Any:
    """A context on the requested display or, with an older Mesa, on the only display."""
    if display > 0 and chosen.name == "egl" and "llvmpipe" in chosen.renderer:
        with suppress(Exception):
            return SecondDisplay(chosen.renderer)
    return create_context(chosen.name, width, height)


def _serve(jobs: SimpleQueue[tuple[Callable[[], Any], Future[Any]] | None]) -> None:
    while (item := jobs.get()) is not None:
        job, future = item
        try:
            future.set_result(job())
        except BaseException as error:  # passed on to the waiting caller
            future.set_exception(error)
        del item, job, future


def _remembered(wanted: str) -> Backend | None:
    """The backend that a parent process found, if it is the wanted one."""
    name, _, renderer = os.environ.get(_REMEMBERED, "").partition(":")
    return Backend(name, renderer) if name in BACKENDS and wanted in ("", name) else None


def _find(wanted: str) -> Backend:
    """The first backend that works in a child process; if one is wanted, only that one."""
    names = (wanted,) if wanted else BACKENDS
    for name in names:
        renderer = _probe(name)
        if renderer is not None:
            return Backend(name, renderer)
    if wanted:
        raise RenderError(
            f"MUJOCO_GL={wanted} does not start on this machine; unset it, or install it: {_INSTALLS[wanted]}"
        )
    raise RenderError(f"no OpenGL to render with: tried {' and '.join(names)}. To install it: {_INSTALL}")


def _probe(name: str) -> str | None:
    """The renderer's name, or None if the backend does not work. A crash only affects a child process."""
    command = [sys.executable, "-c", _PROBE, name]
    try:
        child = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)  # noqa: S603
    except (subprocess.SubprocessError, OSError):
        return None
    lines = [line.removeprefix("renderer:").strip() for line in child.stdout.splitlines() if "renderer:" in line]
    return lines[-1] if lines else None
