"""Keys from a terminal, or lines from a pipe, on Linux, macOS and Windows."""

from __future__ import annotations

import os
import select
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Final

if sys.platform == "win32":
    import _winapi
    import msvcrt
else:
    import fcntl
    import termios
    import tty

_CHECK_S: Final = 0.05


def input_trouble(file: int) -> str:
    """Why an open standard input cannot be read, as part of a sentence; empty if it can. Raises `OSError`."""
    if sys.platform == "win32":
        return ""
    if fcntl.fcntl(file, fcntl.F_GETFL) & os.O_ACCMODE == os.O_WRONLY:
        return "can only be written"
    if os.isatty(file):
        try:
            termios.tcgetattr(file)
        except termios.error as error:
            raise OSError(*error.args) from None
        # Its settings are changed for the flight, for which the kernel stops a job in the background.
        with suppress(OSError):  # one that does not control this process has no jobs
            if os.tcgetpgrp(file) != os.getpgrp():
                return "is a terminal that another job has"
    return ""


def keeping_settings(terminal: int) -> Callable[[], None]:
    """What puts the settings of a terminal back; nothing for one that has gone, and on Windows, which changes none."""
    if sys.platform == "win32":
        return lambda: None
    try:
        before = termios.tcgetattr(terminal)
    except termios.error:
        return lambda: None

    def put_back() -> None:
        with suppress(termios.error):
            termios.tcsetattr(terminal, termios.TCSADRAIN, before)

    return put_back


def read_key_by_key(terminal: int) -> None:
    """Have a terminal give each key at once and show none; Windows' consoles are read so by `read_input` itself."""
    if sys.platform != "win32":
        with suppress(termios.error):  # one that has gone
            tty.setcbreak(terminal)


def read_input(file: int, timeout_s: float) -> bytes | None:
    """What came in, from a terminal, pipe or file; b"" at its end, None if nothing has come in that time."""
    if sys.platform == "win32":
        until = time.monotonic() + timeout_s
        while not (msvcrt.kbhit() if os.isatty(file) else _has_bytes(file)):
            if time.monotonic() >= until:
                return None
            time.sleep(_CHECK_S)
        return msvcrt.getwch().encode(errors="replace") if os.isatty(file) else os.read(file, 4096)
    return os.read(file, 4096) if select.select([file], [], [], timeout_s)[0] else None


def _has_bytes(pipe: int) -> bool:
    """Whether reading a pipe of Windows would not wait; a file never waits, nor does a pipe whose writer has gone."""
    if sys.platform == "win32":
        with suppress(OSError):
            return _winapi.PeekNamedPipe(msvcrt.get_osfhandle(pipe), 0)[0] > 0
    return True
