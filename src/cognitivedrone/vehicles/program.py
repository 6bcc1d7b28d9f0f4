"""A program of somebody else that runs beside us: an autopilot or a simulator."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from cognitivedrone.files import create, open_regular

_STARTER = "import ctypes, os, sys; ctypes.CDLL(None).prctl(1, 9); os.execvp(sys.argv[1], sys.argv[1:])"
_DIES_WITH_US = (sys.executable, "-I", "-S", "-c", _STARTER) if sys.platform == "linux" else ()
"""What starts a program that Linux kills when we end, however we end (PR_SET_PDEATHSIG): left alone, ArduCopter would
wait for its next step of physics for ever, and keep its ports."""
_END_S = 5.0


class Program:
    """A running program, in `folder`; what it prints goes to the file `output`. `close` ends it and all it started.

    It has a session of its own: ctrl-C is for us, and lands the drone, before an autopilot may end. Raises `OSError` if
    it cannot be started.
    """

    def __init__(self, command: Sequence[str], folder: Path, output: Path) -> None:
        self.output = output
        with create(output) as file:
            self._process = subprocess.Popen(  # noqa: S603
                [*_DIES_WITH_US, *command],
                cwd=folder,
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=file,
                start_new_session=True,
            )

    @property
    def exit_code(self) -> int | None:
        """None while it runs."""
        return self._process.poll()

    def printed(self) -> list[str]:
        """The lines that it has printed, without empty ones."""
        with open_regular(self.output) as file:
            lines = file.read().decode(errors="replace").split("\n")
        return [line.strip() for line in lines if line.strip()]

    def last_words(self) -> str:
        """The last line that it printed, as a clause to end an error with."""
        printed = self.printed()
        return f", its last line of output: {printed[-1]}" if printed else ""

    def send(self, number: signal.Signals) -> None:
        """Send a signal to the program and all that it started."""
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, number)

    def close(self) -> None:
        """End it: ask, then kill what is left."""
        self.send(signal.SIGTERM)
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_END_S)
        self.send(signal.SIGKILL)
        self._process.wait()
