"""A program of somebody else that runs beside us: an autopilot or a simulator."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Literal

from cognitivedrone import system
from cognitivedrone.files import create, open_regular

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
                system.ending_with_us(command),
                cwd=folder,
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=file,
                **system.own_session(),
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

    def send(self, what: Literal["TERM", "KILL", "STOP", "CONT"]) -> None:
        """Send a signal to the program and all that it started."""
        system.tell_session(self._process.pid, what)

    def close(self) -> None:
        """End it: ask, then kill what is left."""
        self.send("TERM")
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_END_S)
        self.send("KILL")
        self._process.wait()
