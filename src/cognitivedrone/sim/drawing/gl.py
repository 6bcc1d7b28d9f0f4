"""Off-screen OpenGL: choice of the rendering library, and threads that own a context.

MuJoCo picks a backend on import and fails late, with an unclear error, if that does not work. Here a child
process tries what this system has (`system.OPENGL`: on Linux EGL and then OSMesa), once; the result is stored in this
process and, in an environment variable, for its children. A user's own `MUJOCO_GL` takes precedence.
"""

from __future__ import annotations

import atexit
import ctypes
import os
import re
import signal
import subprocess
import sys
import threading
import weakref
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from queue import SimpleQueue
from typing import Any, Final, TypeVar

from cognitivedrone.errors import FirstFrameError, RenderError
from cognitivedrone.sim.drawing import contexts, renderers
from cognitivedrone.system import OPENGL, OPENGL_TEST, after_fork, c_library
from cognitivedrone.system.processes import environment
from cognitivedrone.system.shortages import tight_limit, way_out_of
from cognitivedrone.text.printable import visible

BACKENDS: Final = tuple(OPENGL)
_REMEMBERED: Final = renderers.REMEMBERED
_INSTALL: Final = next(iter(OPENGL.values()))
_EGL_PLATFORM_SURFACELESS_MESA: Final = 0x31DD  # EGL_MESA_platform_surfaceless
_PROBE: Final = f"""
import runpy, sys
context = runpy.run_path({contexts.__file__!r})["create"](sys.argv[1], 16, 16)
context.make_current()
from OpenGL import GL
print("renderer:", GL.glGetString(GL.GL_RENDERER).decode())
context.free()
"""
_PROBE_S, _SLOW = OPENGL_TEST
FIRST_FRAME_S: Final = 60.0
"""Time that a card may take for the first frame of a context, s; processes that draw on one card have hung in it."""
_TOO_SLOW: Final = f"its test did not end within {_PROBE_S:g} s"
_MOST_DEVICES: Final = 16  # of EGL that are tried, where the first is not the one that was chosen
_LINES: Final = 3
_LONGEST: Final = 400  # characters of somebody else's error
_STEERING: Final = re.compile(
    r"(MUJOCO_GL|MUJOCO_EGL|PYOPENGL|LIBGL|MESA|GALLIUM|LP|EGL|GBM|__EGL|__GLX|__GL|__GLVND|DRI|LD_LIBRARY_PATH|LD_PRELOAD)(_|$)"
)
"""Variables by which OpenGL, its drivers, PyOpenGL and MuJoCo are steered."""

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Backend:
    """A rendering backend that was tested to work."""

    name: str
    """A name of `system.OPENGL`, such as egl or osmesa."""
    renderer: str
    """OpenGL's renderer name, for reports: "llvmpipe (LLVM 19.1.7, 256 bits)"."""
    device: int | None = None
    """MuJoCo's number of EGL's device, where it is not the first."""


_chosen: Backend | None = None
_choosing = threading.Lock()


def look_ahead() -> None:
    """Look for the backend in another thread, while this one still imports what needs it."""
    threading.Thread(target=_look, name="OpenGL", daemon=True).start()


def _look() -> None:
    with suppress(RenderError):  # drawing raises it again
        backend()


def backend() -> Backend:
    """The rendering backend: `MUJOCO_GL` if the user set it, else the first of `system.OPENGL` that works.

    llvmpipe is set to render in the calling thread, which is faster for small images, unless the user's
    `LP_NUM_THREADS` says otherwise. Raises `RenderError` with the command to install it if nothing works.
    """
    global _chosen
    os.environ.setdefault("LP_NUM_THREADS", "0")  # the library reads it on loading
    wanted = os.environ.get("MUJOCO_GL", "").strip().lower()
    if wanted and wanted not in BACKENDS:
        raise RenderError(
            f"MUJOCO_GL={wanted} cannot render without a screen; unset it, or set it to {' or '.join(BACKENDS)}."
        )
    with _choosing:
        if _chosen is None or (wanted and wanted != _chosen.name):
            _chosen = _remembered(wanted) or _find(wanted)
            os.environ[_REMEMBERED] = f"{_chosen.name}:{_chosen.renderer}"
            if _chosen.device is not None:
                os.environ[renderers.DEVICE] = str(_chosen.device)  # MuJoCo reads it at the first context
        return _chosen


def renderer_name() -> str:
    """OpenGL's renderer name on this machine, for reports."""
    return backend().renderer


def create_context(name: str, width: int, height: int) -> Any:
    """A current OpenGL context of backend `name` for the calling thread, with `make_current()` and `free()`."""
    try:
        context = contexts.create(name, width, height)
        context.make_current()
    except Exception as error:  # ctypes, PyOpenGL and MuJoCo each fail in their own way
        raise RenderError(_advice({name: _one_line(error)}, _INSTALL)) from None
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
        self._kept: list[object] = []
        self._thread = threading.Thread(target=_serve, args=(self._jobs,), name="cognitivedrone-gl", daemon=True)
        self._thread.start()
        self._context = self.call(partial(_thread_context, chosen, width, height, display)).result()
        _threads.add(self)
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

    def first(self, draw: Callable[[], None]) -> None:
        """Draw the first frame in the thread. Raises `FirstFrameError` if it does not come; the thread is then lost."""
        try:
            self.call(draw).result(FIRST_FRAME_S)
        except TimeoutError:
            self._stopped = True  # nothing waits for it any more, not even the end of the process
            atexit.unregister(self.stop)
            _lost.append(self)
            raise FirstFrameError(
                f"{backend().renderer} drew no frame within {FIRST_FRAME_S:g} s; let fewer processes draw on it "
                f"(--workers), or set {renderers.CHOICE}=cpu."
            ) from None

    def keep(self, made: T) -> T:
        """What was made in the context, unchanged; a forked child, which has no such thread, will never free it."""
        self._kept.append(made)
        return made

    def release(self, made: Any) -> None:
        """Run `free()` of what is kept, in the thread; a forked child has nothing to free, and nothing is done."""
        if os.getpid() == self._process and not self._stopped:
            self.call(made.free).result()
            self._kept = [kept for kept in self._kept if kept is not made]

    def stop(self) -> None:
        """Free the context and end the thread, once."""
        if self._stopped or os.getpid() != self._process:
            return
        freed = self.call(self._context.free)
        self._stopped = True
        self._jobs.put(None)
        self._thread.join()
        self._kept.clear()
        atexit.unregister(self.stop)
        freed.result()

    def abandon(self) -> None:
        """In a forked child: let nothing of it ever be freed, not even at the end of the process, which would crash."""
        for made in (self._context, *self._kept):
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(made))


_threads: weakref.WeakSet[GLThread] = weakref.WeakSet()
_lost: list[GLThread] = []
"""Threads that hang. What they hold must not be freed in another thread."""


def _in_a_forked_child() -> None:
    """Keep the child from freeing what is its parent's, now and at its end.

    At the end of a process, Mesa waits for its own threads, which a child has not, and crashes: there the C library's
    functions for the end, from outside Python, are left out.
    """
    if _chosen is None:
        return
    for thread in _threads:
        thread.abandon()
    library = c_library()
    if hasattr(library, "on_exit"):  # they are called in reverse: the output of C is still written
        library.on_exit(library._exit, None)
        library.__cxa_atexit(library.fflush, None, None)


after_fork(_in_a_forked_child)


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
    return Backend(name, renderer) if name in BACKENDS and wanted in ("", name) and renderers.suits(renderer) else None


def _find(wanted: str) -> Backend:
    """The first backend that works in a child process and suits the person's choice; if one is wanted, only that one.

    Raises `RenderError` if none works, or none is what the person chose.
    """
    failures: dict[str, str] = {}
    others: list[Backend] = []
    for name in (wanted,) if wanted else BACKENDS:
        try:
            found = Backend(name, _probe(name))
        except RenderError as error:
            failures[name] = str(error)
            continue
        if renderers.suits(found.renderer):
            return found
        if name == "egl" and not os.environ.get(renderers.DEVICE):
            for device in range(_MOST_DEVICES):
                try:
                    renderer = _probe(name, device=device)
                except RenderError:  # there are no more
                    break
                if renderers.suits(renderer):
                    return Backend(name, renderer, device)
        others.append(found)
    if not others:
        raise RenderError(_advice(failures, OPENGL[wanted] if wanted else _INSTALL))
    renderers.check(others[0].renderer)
    return others[0]


def _probe(name: str, without: Collection[str] = (), device: int | None = None) -> str:
    """The renderer's name in a child process, which may crash, started without some of the environment's variables.

    On EGL's device of a number, if one is given. Raises `RenderError` with OpenGL's own error.
    """
    variables = {variable: value for variable, value in environment().items() if variable not in without}
    if device is not None:
        variables[renderers.DEVICE] = str(device)
    try:
        child = subprocess.run(  # noqa: S603
            [sys.executable, "-c", _PROBE, name],
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            timeout=_PROBE_S,
            check=False,
            env=variables,
        )
    except subprocess.TimeoutExpired:
        raise RenderError(_TOO_SLOW) from None
    except OSError as error:
        raise RenderError(_one_line(error)) from None
    found = [line.removeprefix("renderer:").strip() for line in child.stdout.splitlines() if "renderer:" in line]
    if child.returncode == 0 and found:
        return found[-1]
    ending = [f"ended by {signal.Signals(-child.returncode).name}"] if child.returncode < 0 else []
    lines = [line.strip() for line in child.stderr.splitlines() if line.strip() and not line.startswith((" ", "Trace"))]
    raise RenderError(_one_line("; ".join(dict.fromkeys([*lines[-_LINES:], *ending])) or "no error was reported"))


def _one_line(error: object) -> str:
    """An error of somebody else as a part of a sentence."""
    return visible(" ".join(str(error).split()))[:_LONGEST].rstrip(".") or type(error).__name__


def _advice(failures: Mapping[str, str], install: str) -> str:
    """What OpenGL itself says, and the way out: variables without which it starts, or else its installation."""
    reasons = "; ".join(f"{name}: {reason}" for name, reason in failures.items())
    if _TOO_SLOW in failures.values():
        return f"it is not known whether OpenGL starts ({reasons}), {_SLOW}; try again"
    if way_out := way_out_of(reasons) or tight_limit():
        return f"OpenGL does not start ({reasons}); {way_out}"
    steering = [name for name in os.environ if _STEERING.match(name) and not _is_ours(name)]
    if guilty := _guilty(failures, steering):
        shown = " and ".join(_shown(name) for name in guilty)
        them = "them" if len(guilty) > 1 else "it"
        way_out = f"unset {them}, without {them} it starts here" + (
            f", or install it: {install}" if "MUJOCO_GL" in guilty else ""
        )
        return f"OpenGL does not start with {shown} ({reasons}); {way_out}"
    also = f"; these variables steer it, check them first: {', '.join(map(_shown, steering))}" if steering else ""
    return f"OpenGL does not start ({reasons}){also}. If it is not installed: {install}"


def _guilty(failures: Iterable[str], steering: Sequence[str]) -> Sequence[str]:
    """The variable, or all of them, without which one of the backends starts; none if none starts."""
    for guilty in filter(None, [[name] for name in steering] + [steering]):
        chosen = "MUJOCO_GL" in guilty
        for name in BACKENDS if chosen else failures:
            with suppress(RenderError):
                _probe(name, [*guilty, "PYOPENGL_PLATFORM"] if chosen else guilty)  # to which MuJoCo sets the other
                return guilty
    return ()


def _shown(variable: str) -> str:
    return f"{variable}={visible(os.environ[variable])[:80]}"


def _is_ours(variable: str) -> bool:
    """Whether we set this variable ourselves, or it is set to nothing."""
    return not os.environ[variable] or (variable, os.environ[variable]) == ("LP_NUM_THREADS", "0")


def enlarge_only(context: Any, texture: int) -> None:
    """Draw a texture of an `MjrContext`, which is current, without smaller copies of it: a fifth faster on a CPU.

    For pictures that are never seen smaller than they are.
    """
    from OpenGL import GL

    GL.glBindTexture(GL.GL_TEXTURE_2D, int(context.texture[texture]))
    GL.glTexParameteri(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_MIN_FILTER, GL.GL_LINEAR)
