"""Gazebo as a program of ours: started on a world without a window, in a partition of its own, and ended.

with own_partition(), GazeboServer(Path("gazebo/0007/world.sdf"), Path("gazebo.log")) as server:
    world = server.connect(lambda: GazeboWorld(folder))
"""

from __future__ import annotations

import os
import re
import secrets
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final, TypeVar

from cognitivedrone.errors import GazeboError
from cognitivedrone.vehicles.program import Program

T = TypeVar("T")

START_S: Final = 120.0
"""For the server to load a world and answer; the first start of a software renderer compiles its shaders."""
NO_PLUGIN: Final = "Failed to load system plugin [ArduPilotPlugin]"
_COMPLAINT = re.compile(r"\[(Err|Wrn|error|warning|critical)\]|^(Error|Warning)\b|^Library error", re.IGNORECASE)
_STYLE = re.compile(r"\x1b\[[0-9;]*m")
_LOOK_AGAIN_S = 0.2


@contextmanager
def own_partition() -> Iterator[str]:
    """A new partition of gz-transport for this process and what it starts, until the end of the block; gives its name.

    Other Gazebos on this machine and network stay unseen: unless GZ_IP is set, all traffic is on the loopback.
    """
    ours = {"GZ_PARTITION": f"cognitivedrone-{secrets.token_hex(4)}", "GZ_IP": os.environ.get("GZ_IP", "127.0.0.1")}
    before = {name: os.environ.get(name) for name in ours}
    os.environ.update(ours)
    try:
        yield ours["GZ_PARTITION"]
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def find_gazebo() -> str:
    """The `gz` command; raises `GazeboError` without it."""
    command = shutil.which("gz")
    if command is None:
        raise GazeboError(
            "there is no command `gz` on this machine; install Gazebo as docs/gazebo.md describes (Harmonic: apt-get"
            " install gz-harmonic), or put it on the PATH"
        )
    return command


class GazeboServer:
    """A running `gz sim` of a world, which prints to the file `output`. Use it as a context manager, or call `close`.

    Raises `GazeboError` if there is no Gazebo, or it cannot be started.
    """

    def __init__(self, world: Path, output: Path) -> None:
        world = world.resolve()
        command = [find_gazebo(), "sim", "-s", "-r", "--headless-rendering", "-v", "3", str(world)]
        try:
            self._program = Program(command, world.parent, output)
        except OSError as error:
            raise GazeboError(f"cannot run {command[0]}: {error.strerror}") from None

    def __enter__(self) -> GazeboServer:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def check(self) -> None:
        """Raise `GazeboError`, with its last line of output, if it has ended."""
        code = self._program.exit_code
        if code is not None:
            raise GazeboError(f"gz sim ended with {code}{self._program.last_words()}")

    def connect(self, make: Callable[[], T]) -> T:
        """What `make()` makes, tried again while it raises `GazeboError` and the server is still starting."""
        deadline = time.monotonic() + START_S
        while True:
            try:
                return make()
            except GazeboError as error:
                self.check()
                if time.monotonic() > deadline:
                    raise GazeboError(f"{error}{self._program.last_words()}") from None
                time.sleep(_LOOK_AGAIN_S)

    def complaints(self) -> list[str]:
        """The errors and warnings that it has printed, without colours."""
        return [line for line in (_STYLE.sub("", line) for line in self._program.printed()) if _COMPLAINT.search(line)]

    def close(self) -> None:
        """End it, and everything that it started."""
        self._program.close()
