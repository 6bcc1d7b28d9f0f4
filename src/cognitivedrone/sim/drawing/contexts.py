"""OpenGL contexts that draw without a window, by system. Also run by its path, before the package is imported.

| | |
|---|---|
| `egl`, `osmesa` | Linux; MuJoCo's own |
| `cgl` | macOS; MuJoCo's, but any renderer will do: in a virtual machine Apple has only one in software |
| `wgl` | Windows; that of a GLFW window which is never shown |
"""

from __future__ import annotations

import importlib
import threading
from typing import Any

_one_at_a_time = threading.Lock()


def create(name: str, width: int, height: int) -> Any:
    """A context of the calling thread with `make_current()` and `free()`. Raises whatever the libraries raise."""
    if name == "cgl":
        return _cgl()
    if name == "wgl":
        with _one_at_a_time:  # GLFW is not made for several threads
            return _window(width, height)
    return importlib.import_module(f"mujoco.{name}").GLContext(width, height)


def _cgl() -> Any:
    import ctypes

    from mujoco.cgl import GLContext, cgl

    attribute = cgl.CGLPixelFormatAttribute

    class Context(GLContext):  # type: ignore[misc]
        """Without multisampling, which framebuffers have of their own, and without the demand for a card."""

        def __init__(self) -> None:
            wanted = (
                attribute.CGLPFAOpenGLProfile, cgl.CGLOpenGLProfile.CGLOGLPVersion_Legacy,
                attribute.CGLPFAColorSize, 24, attribute.CGLPFAAlphaSize, 8,
                attribute.CGLPFADepthSize, 24, attribute.CGLPFAStencilSize, 8, 0,
            )  # fmt: skip
            self._context, self._pix, count = cgl.CGLContextObj(), cgl.CGLPixelFormatObj(), cgl.GLint()
            cgl.CGLChoosePixelFormat(
                (ctypes.c_int * len(wanted))(*wanted), ctypes.byref(self._pix), ctypes.byref(count)
            )
            if not self._pix:
                raise RuntimeError("macOS has no pixel format with 24 bits of colour and of depth")
            cgl.CGLCreateContext(self._pix, 0, ctypes.byref(self._context))

    return Context()


def _window(width: int, height: int) -> Any:
    import glfw
    from mujoco.glfw import GLContext

    context = GLContext(width, height)
    if not context._context:
        code, reason = glfw.get_error()
        said = reason.decode(errors="replace") if isinstance(reason, bytes) else reason
        raise RuntimeError(f"GLFW makes no window ({said or code})")
    return context
