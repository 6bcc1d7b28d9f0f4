"""Keyboard input during a flight: new instructions, and "land"."""

from __future__ import annotations

import codecs
import os
import select
import signal
import termios
import threading
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TextIO

from cognitivedrone.apps.values import Ending

LAND = frozenset({"land", "stop"})
LONGEST = 500
"""Maximum length of an instruction in characters; the rest is dropped."""
_BACKSPACE, _LINE_ENDS = ("\x7f", "\b"), ("\n", "\r")


class Orders:
    """The latest instruction and whether to land; set by any thread or signal handler, read by the control loop."""

    def __init__(self) -> None:
        # Each is replaced as a whole, without a lock: a signal handler could find the lock taken by its own thread.
        self._given: tuple[int, str] = (0, "")
        self._ending: Ending | None = None

    @property
    def given(self) -> tuple[int, str]:
        """Number of instructions given in flight, and the latest; "" if there was none."""
        return self._given

    @property
    def ending(self) -> Ending | None:
        """Why to land, if requested."""
        return self._ending

    def say(self, line: str) -> None:
        """Process a line: "land" lands, any other non-blank line is a new instruction."""
        line = " ".join(line.split())[:LONGEST]
        if line.casefold() in LAND:
            self.land(Ending("told", f"{line!r} was typed"))
        elif line:
            self._given = (self._given[0] + 1, line)

    def land(self, ending: Ending) -> None:
        """Request a landing; the first reason is kept."""
        self._ending = self._ending or ending


@contextmanager
def landing_on_interrupt(orders: Orders) -> Iterator[None]:
    """In the block, ctrl-C and SIGTERM request a landing; a second one raises `KeyboardInterrupt`.

    Only possible in the main thread; elsewhere nothing is changed.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def handler(number: int, _: FrameType | None) -> None:
        if orders.ending is not None:
            raise KeyboardInterrupt
        orders.land(Ending("interrupted", "ctrl-C" if number == signal.SIGINT else "asked to terminate"))

    before = {number: signal.signal(number, handler) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)


class Keyboard:
    """Reads lines in a thread, from a terminal or a pipe. Use it as a context manager.

    A terminal is read key by key, so that a live view can show the line being typed (`typed`); its settings are
    restored at the end.
    """

    def __init__(self, stream: TextIO, update: Callable[[str], None]) -> None:
        self.typed = ""
        """The line so far."""
        self._hear = update
        self._stopping = threading.Event()
        self._before: list[object] | None = None
        try:
            self._file = stream.fileno()
        except (OSError, ValueError):  # no file descriptor, or closed
            self._file = -1
        self._thread = threading.Thread(target=self._run, name="keyboard", daemon=True)

    def __enter__(self) -> Keyboard:
        if self._file >= 0:
            if os.isatty(self._file):
                self._before = termios.tcgetattr(self._file)
                tty.setcbreak(self._file)
            self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()
        if self._before is not None:
            termios.tcsetattr(self._file, termios.TCSADRAIN, self._before)  # type: ignore[arg-type]

    def _run(self) -> None:
        decoder = codecs.getincrementaldecoder("utf-8")(errors="replace")
        while not self._stopping.is_set():
            if not select.select([self._file], [], [], 0.1)[0]:
                continue
            data = os.read(self._file, 4096)
            if not data:
                break
            for character in decoder.decode(data):
                self._press(character)
        self._press("\n")  # the last line may lack its newline

    def _press(self, key: str) -> None:
        if key in _LINE_ENDS:
            line, self.typed = self.typed, ""
            if line:
                self._hear(line)
        elif key in _BACKSPACE:
            self.typed = self.typed[:-1]
        elif key.isprintable() and len(self.typed) < LONGEST:
            self.typed += key
