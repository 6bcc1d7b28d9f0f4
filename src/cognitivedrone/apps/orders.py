"""Keyboard input during a flight: new instructions, and "land"."""

from __future__ import annotations

import codecs
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from types import FrameType
from typing import TextIO

from cognitivedrone.apps.values import Ending
from cognitivedrone.errors import RunError
from cognitivedrone.system import ENDED, keys
from cognitivedrone.system.interrupts import handling, undone_at_the_end

LAND = frozenset({"land", "stop"})
LONGEST = 500
"""Maximum length of an instruction in characters; the rest is dropped."""
_WAY_OUT = "fly reads instructions from it: run it in a terminal's foreground, or give it a pipe or </dev/null"
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
            self.land(Ending("ordered", f"{line!r} was typed"))
        elif line:
            self._given = (self._given[0] + 1, line)

    def land(self, ending: Ending) -> None:
        """Request a landing; the first reason is kept."""
        self._ending = self._ending or ending


@contextmanager
def ending_on_signals() -> Iterator[None]:
    """In the block, SIGTERM and a terminal that hangs up (SIGHUP) raise `KeyboardInterrupt` as ctrl-C does, once.

    So what is open is closed, and a drone in the climb is landed. Only possible in the main thread; elsewhere nothing
    is changed. A signal that is ignored already, as SIGHUP by nohup, stays ignored.
    """
    raised = False

    def handler(number: int, _: FrameType | None) -> None:
        nonlocal raised
        if not raised:
            raised = True
            raise KeyboardInterrupt(ENDED[number])

    with handling(handler, [number for number in ENDED if number != signal.SIGINT]):
        yield


@contextmanager
def landing_on_interrupt(orders: Orders, *, at_once: bool = False) -> Iterator[None]:
    """In the block, ctrl-C, SIGTERM and SIGHUP request a landing; a second ctrl-C raises `KeyboardInterrupt`.

    `at_once`: nothing real is in the air, so even the kernel may answer a second ctrl-C. Only possible in the main
    thread; elsewhere nothing is changed.
    """

    def handler(number: int, _: FrameType | None) -> None:
        if orders.ending is not None and number == signal.SIGINT:
            raise KeyboardInterrupt
        orders.land(Ending("interrupted", ENDED[number]))

    with handling(handler, kernel=at_once):
        yield


def readable(stream: TextIO | None) -> TextIO:
    """The stream, where `Keyboard` will be able to read it: asked before the flight. Raises `RunError`."""
    if stream is None or stream.closed:
        raise RunError(f"standard input is closed; {_WAY_OUT}")
    try:
        file = stream.fileno()
    except OSError:  # no file descriptor: nothing is typed
        return stream
    try:
        if trouble := keys.input_trouble(file):
            raise RunError(f"standard input {trouble}; {_WAY_OUT}")
    except OSError as error:
        raise RunError(f"standard input cannot be read ({error.args[-1]}); {_WAY_OUT}") from None
    return stream


class Keyboard:
    """Reads lines in a thread, from a terminal or a pipe. Use it as a context manager.

    A terminal is read key by key, so that a live view can show the line being typed (`typed`); its settings are
    restored at the end.
    """

    def __init__(self, stream: TextIO, update: Callable[[str], None]) -> None:
        self.typed = ""
        """The line so far."""
        self._update = update
        self._stopping = threading.Event()
        try:
            self._file = stream.fileno()
        except (OSError, ValueError):  # no file descriptor, or closed
            self._file = -1
        self._thread = threading.Thread(target=self._run, name="keyboard", daemon=True)
        self._undo = ExitStack()

    def __enter__(self) -> Keyboard:
        if self._file >= 0:
            if os.isatty(self._file):
                put_back = keys.keeping_settings(self._file)
                self._undo.callback(put_back)
                self._undo.enter_context(undone_at_the_end(put_back))
                keys.read_key_by_key(self._file)
            self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()
        self._undo.close()

    def _run(self) -> None:
        decoder = codecs.getincrementaldecoder("utf-8")(errors="replace")
        while not self._stopping.is_set():
            try:
                data = keys.read_input(self._file, 0.1)
            except OSError:  # a terminal that has gone
                break
            if data is None:
                continue
            if not data:
                break
            for character in decoder.decode(data):
                self._press(character)
        self._press("\n")  # the last line may lack its newline

    def _press(self, key: str) -> None:
        if key in _LINE_ENDS:
            line, self.typed = self.typed, ""
            if line:
                self._update(line)
        elif key in _BACKSPACE:
            self.typed = self.typed[:-1]
        elif key.isprintable() and len(self.typed) < LONGEST:
            self.typed += key
