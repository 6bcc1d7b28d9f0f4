"""Standard input, output and error of a command, whatever the shell, cron or a service started it with."""

from __future__ import annotations

import io
import os
import sys

_ERRORS = "backslashreplace"


def prepare_streams() -> None:
    """Let every stream be open, and let no character be an error.

    A stream that is closed is replaced by the null device: otherwise the next file that is opened gets its number, and
    what a child process prints goes there. `sys.stdin` stays None, so that who waits for input can tell. A character
    that the encoding of the output lacks is printed as an escape sequence, here and in child interpreters.
    """
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest free number, which is this one
            os.set_inheritable(number, True)
        if number and getattr(sys, name) is None:
            setattr(sys, name, open(number, mode, encoding="utf-8", closefd=False))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a notebook's is none
            stream.reconfigure(errors=_ERRORS)
            if not stream.encoding.lower().startswith("utf"):
                os.environ["PYTHONIOENCODING"] = f"{stream.encoding}:{_ERRORS}"
