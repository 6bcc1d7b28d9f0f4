"""An ArduCopter process on our physics: found, started in a folder of its own, connected to, and ended.

The binary is built for SITL from ArduPilot's tree (docs/ardupilot.md). It asks `links.sitl.SitlServer` for every step
of physics, and listens for MAVLink on TCP. Options of its command line:
https://ardupilot.org/dev/docs/sitl-simulator-software-in-the-loop.html.
"""

from __future__ import annotations

import os
import socket
import subprocess
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TypeVar

from cognitivedrone.errors import LinkError

T = TypeVar("T")

BINARY_VARIABLE = "ARDUCOPTER"
PARAMETERS = """\
FRAME_CLASS 1
FRAME_TYPE 1
MOT_THST_HOVER 0.28
MOT_BAT_VOLT_MIN 9.6
MOT_BAT_VOLT_MAX 12.8
BATT_MONITOR 4
ATC_RAT_YAW_P 1.0
ATC_RAT_YAW_I 0.1
ATC_RAT_YAW_FLTE 10
COMPASS_OFS_X 5
COMPASS_OFS_Y 13
COMPASS_OFS_Z -18
COMPASS_OFS2_X 5
COMPASS_OFS2_Y 13
COMPASS_OFS2_Z -18
COMPASS_OFS3_X 5
COMPASS_OFS3_Y 13
COMPASS_OFS3_Z -18
AHRS_EKF_TYPE 3
"""
"""What fits ArduCopter's defaults to our airframe, tells it the offsets of the compasses that it simulates, and keeps
its estimator the real one (docs/ardupilot.md)."""
PARAMETERS_FILE, OUTPUT_FILE = "cognitivedrone.parm", "arducopter.log"
FIRST_PORT, PORT_STEP = 5760, 10
"""TCP port of the first autopilot, and from one instance to the next."""
START_S = 60.0
"""For the process to open its port, s."""


def find_binary(named: Path | None, way_out: str) -> Path:
    """The binary that is named, or that the environment variable `ARDUCOPTER` names.

    `way_out` ends the sentence of the `LinkError` where there is none, or it cannot be run: how to name one.
    """
    named = named or (Path(os.environ[BINARY_VARIABLE]) if os.environ.get(BINARY_VARIABLE) else None)
    if named is None:
        raise LinkError(
            f"--link sitl needs an ArduCopter binary: {way_out}; docs/ardupilot.md says how to build and fly it"
        )
    if not (named.is_file() and os.access(named, os.X_OK)):
        raise LinkError(f"{named} is not a program that can be run: {way_out}")
    return named.resolve()


def port_is_free(instance: int) -> bool:
    """Whether the TCP port of an instance can be had."""
    with socket.socket() as probe:
        # As ArduCopter asks for it: a port whose last connection has only just ended can be had.
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", FIRST_PORT + PORT_STEP * instance))
        except OSError:
            return False
        return True


class ArduCopter:
    """A running process. Use it as a context manager, or call `close`.

    `folder` is where it leaves its files, and what it prints in `arducopter.log`. `defaults` are parameter files that
    are loaded before ours, `parameters` lines that come after. `speed` is how many times as fast as the wall clock it
    flies at most. Raises `LinkError` where it cannot be started.
    """

    def __init__(
        self,
        binary: Path,
        folder: Path,
        *,
        instance: int = 0,
        defaults: Sequence[Path] = (),
        parameters: str = "",
        speed: float = 1.0,
    ) -> None:
        missing = [path for path in defaults if not path.is_file()]
        if missing:
            raise LinkError(f"there is no parameter file {missing[0]}")
        self.binary = binary
        self.url = f"tcp:127.0.0.1:{FIRST_PORT + PORT_STEP * instance}"
        """Where it listens for MAVLink; it does nothing until somebody connects."""
        self.output = folder.resolve() / OUTPUT_FILE
        ours = folder.resolve() / PARAMETERS_FILE
        ours.write_text(PARAMETERS + parameters)
        options = {
            "model": "JSON:127.0.0.1",
            "instance": f"{instance}",
            "speedup": f"{speed:g}",
            "defaults": ",".join(str(path) for path in (*(path.resolve() for path in defaults), ours)),
        }
        command = [str(binary), *(word for name, value in options.items() for word in (f"--{name}", value))]
        with ExitStack() as undo:
            output = undo.enter_context(self.output.open("wb"))
            try:
                # A session of its own: ctrl-C is for us, and lands it, before the autopilot may end.
                self._process = subprocess.Popen(  # noqa: S603
                    command, cwd=folder, stdin=subprocess.DEVNULL, stdout=output, stderr=output, start_new_session=True
                )
            except OSError as error:
                raise LinkError(f"cannot run {binary}: {error.strerror}") from None

    def __enter__(self) -> ArduCopter:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def check(self) -> None:
        """Raise `LinkError`, with its last words, where the process has ended."""
        if self._process.poll() is not None:
            code = self._process.returncode
            raise LinkError(f"{self.binary} ended with {code}{self.last_words()}")

    def last_words(self) -> str:
        """The last line that it printed, as a clause to end an error with."""
        lines = self.output.read_text(encoding="utf-8", errors="replace").split("\n")
        said = [line.strip() for line in lines if line.strip()]
        return f", its last words: {said[-1]}" if said else ""

    def connect(self, make: Callable[[str], T]) -> T:
        """What `make(url)` makes, tried again while it raises `LinkError` and the process is still opening its port."""
        deadline = time.monotonic() + START_S
        while True:
            try:
                return make(self.url)
            except LinkError as error:
                self.check()
                if time.monotonic() > deadline:
                    raise LinkError(f"{error}{self.last_words()}") from None
                time.sleep(0.1)

    def close(self) -> None:
        """End the process."""
        self._process.terminate()
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
