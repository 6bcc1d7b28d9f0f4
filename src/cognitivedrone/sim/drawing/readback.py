"""Reading frames from an OpenGL context, the top row first. Everything here runs in the context's own thread.

OpenGL's first row is the lowest. Mesa turns the rows round while it reads (GL_MESA_pack_invert). A card's driver reads
into two buffers by turns: while it fills one, the frame before is copied from the other, which turns the rows round at
no cost. Drawing upside down would give other bits: rounding is not symmetric.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterable, Iterator
from typing import Any, Final, Protocol

import numpy as np

from cognitivedrone.sim.drawing.renderers import on_processor
from cognitivedrone.types import Image, Images
from cognitivedrone.world.engine import mujoco

_PACK_INVERT: Final = 0x8758  # GL_PACK_INVERT_MESA
_CHANNELS: Final = 3


class Readback(Protocol):
    """Reads the frames that are drawn in one context."""

    def frames(self, drawn: Iterable[int], out: Images) -> Iterator[int]:
        """Read every frame of which `drawn`, by drawing it, yields the index in `out`; yields it when it is there."""


def readback(renderer: str, context: Any, width: int, height: int) -> Readback:
    """The way to read frames (height, width, 3) that serves best with what draws."""
    return OneByOne(context, width, height) if on_processor(renderer) else TwoBuffers(context, width, height)


class OneByOne:
    """Reads each frame as soon as it is drawn."""

    def __init__(self, context: Any, width: int, height: int) -> None:
        from OpenGL.raw.GL.VERSION.GL_1_0 import glPixelStorei

        self._store = glPixelStorei
        self._context = context
        self._viewport = mujoco.MjrRect(0, 0, width, height)
        self._rows = None if _turns_rows() else np.empty((height, width, _CHANNELS), np.uint8)

    def frames(self, drawn: Iterable[int], out: Images) -> Iterator[int]:
        """As `Readback.frames`."""
        for index in drawn:
            self.read(out[index])
            yield index

    def read(self, out: Image) -> None:
        """Read the frame that was drawn last into `out` (height, width, 3)."""
        if self._rows is None:
            self._store(_PACK_INVERT, 1)
            mujoco.mjr_readPixels(out, None, self._viewport, self._context)
            self._store(_PACK_INVERT, 0)  # other ways to read from this context turn the rows themselves
        else:
            mujoco.mjr_readPixels(self._rows, None, self._viewport, self._context)
            out[:] = self._rows[::-1]


class TwoBuffers:
    """Reads each frame while the next one is drawn."""

    def __init__(self, context: Any, width: int, height: int) -> None:
        from OpenGL import GL
        from OpenGL.raw.GL.VERSION.GL_1_0 import glReadPixels

        self._gl = GL
        self._read_pixels = glReadPixels  # without PyOpenGL's search for an array
        self._context = context
        self._size = (width, height)
        self._bytes = width * height * _CHANNELS
        GL.glPixelStorei(GL.GL_PACK_ALIGNMENT, 1)
        self._buffers = [int(number) for number in GL.glGenBuffers(2)]
        for buffer in self._buffers:
            GL.glBindBuffer(GL.GL_PIXEL_PACK_BUFFER, buffer)
            GL.glBufferData(GL.GL_PIXEL_PACK_BUFFER, self._bytes, None, GL.GL_STREAM_READ)
        GL.glBindBuffer(GL.GL_PIXEL_PACK_BUFFER, 0)

    def frames(self, drawn: Iterable[int], out: Images) -> Iterator[int]:
        """As `Readback.frames`, one frame later."""
        last: int | None = None
        filling, filled = self._buffers
        for index in drawn:
            self._begin(filling)
            if last is not None:
                self._copy(filled, out[last])
                yield last
            last, filling, filled = index, filled, filling
        if last is not None:
            self._copy(filled, out[last])
            yield last

    def _begin(self, buffer: int) -> None:
        """Have the driver fill a buffer; returns at once."""
        gl, (width, height) = self._gl, self._size
        gl.glBindFramebuffer(gl.GL_READ_FRAMEBUFFER, self._context.offFBO)
        gl.glReadBuffer(gl.GL_COLOR_ATTACHMENT0)
        gl.glBindBuffer(gl.GL_PIXEL_PACK_BUFFER, buffer)
        start = ctypes.c_void_p(0)  # of the buffer
        self._read_pixels(0, 0, width, height, gl.GL_RGB, gl.GL_UNSIGNED_BYTE, start)
        gl.glBindBuffer(gl.GL_PIXEL_PACK_BUFFER, 0)  # MuJoCo's own reads go to memory

    def _copy(self, buffer: int, out: Image) -> None:
        """Copy what is in a buffer, once it is filled."""
        gl, (width, height) = self._gl, self._size
        gl.glBindBuffer(gl.GL_PIXEL_PACK_BUFFER, buffer)
        address = gl.glMapBufferRange(gl.GL_PIXEL_PACK_BUFFER, 0, self._bytes, gl.GL_MAP_READ_BIT)
        rows = np.ctypeslib.as_array((ctypes.c_uint8 * self._bytes).from_address(int(address)))
        out[:] = rows.reshape(height, width, _CHANNELS)[::-1]
        gl.glUnmapBuffer(gl.GL_PIXEL_PACK_BUFFER)
        gl.glBindBuffer(gl.GL_PIXEL_PACK_BUFFER, 0)


def _turns_rows() -> bool:
    """Whether the current context can return the top row first."""
    from OpenGL import GL

    return "GL_MESA_pack_invert" in (GL.glGetString(GL.GL_EXTENSIONS) or b"").decode().split()
