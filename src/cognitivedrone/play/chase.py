"""The chase view in a process of its own, of low priority: a flight beside it misses no deadline."""

from __future__ import annotations

import io
import multiprocessing
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any, Final

import PIL.Image

from cognitivedrone.errors import CognitiveDroneError, RenderError
from cognitivedrone.film.frame import Scene
from cognitivedrone.sim.airframe import Airframe
from cognitivedrone.sim.drawing.chase import LIVE_SIZE, ChaseView
from cognitivedrone.system import let_others_first
from cognitivedrone.system.processes import end_with_parent, starting
from cognitivedrone.types import FloatArray, Image

QUALITY: Final = 82
"""Of JPEGs on the page."""
_NICENESS: Final = 10
_ANSWER_S: Final = 60.0  # with the start of the process, on a busy machine
_END_S: Final = 5.0


class ChaseProcess:
    """Draws a `ChaseView` elsewhere, as JPEGs; one thread may use it. Call `close` at the end."""

    def __init__(self, airframe: Airframe) -> None:
        context = multiprocessing.get_context("spawn")
        with starting():
            self._pipe, theirs = context.Pipe()
            self._process = context.Process(target=_draw, args=(theirs, airframe), name="chase view", daemon=True)
            self._process.start()
        theirs.close()

    def place(self, scene: Scene) -> None:
        """Show a scene; the next frame begins behind the drone."""
        self._ask(scene)

    def frame(self, position: FloatArray, quaternion: FloatArray, seconds: float, time: float) -> bytes:
        """The drone at a pose, as `ChaseView.frame`: a JPEG. Raises `RenderError` without OpenGL."""
        found: bytes = self._ask((position, quaternion, seconds, time))
        return found

    def close(self) -> None:
        """End the process; may be called repeatedly."""
        self._pipe.close()
        self._process.join(_END_S)
        if self._process.is_alive():
            self._process.kill()

    def _ask(self, order: object) -> Any:
        try:
            self._pipe.send(order)
            answer = self._pipe.recv() if self._pipe.poll(_ANSWER_S) else None
        except (OSError, EOFError):
            raise RenderError("the process that draws the chase view has ended; open the page again") from None
        if answer is None:
            raise RenderError(f"the chase view was not drawn within {_ANSWER_S:g} s; open the page again")
        if isinstance(answer, CognitiveDroneError):
            raise answer
        return answer


def jpeg(image: Image) -> bytes:
    """A picture (height, width, 3) uint8 RGB, for the page."""
    buffer = io.BytesIO()
    PIL.Image.fromarray(image).save(buffer, "JPEG", quality=QUALITY)
    return buffer.getvalue()


def _draw(pipe: Connection, airframe: Airframe) -> None:
    """The process: answers scenes and poses until the pipe is closed."""
    end_with_parent()
    let_others_first(_NICENESS)
    view: ChaseView | None = None
    with suppress(OSError, EOFError):  # the page has gone
        while True:
            order = pipe.recv()
            try:
                if not isinstance(order, Scene):
                    assert view is not None  # noqa: S101  (a scene comes first)
                    pipe.send(jpeg(view.frame(*order)))
                    continue
                if view is None:
                    view = ChaseView(order.stage, order.scenery, *LIVE_SIZE, airframe=airframe)
                else:
                    view.place(order.stage, order.scenery)
                    view.cut()
                pipe.send(b"")
            except CognitiveDroneError as error:
                pipe.send(error)
