"""Calls of Gazebo's services, from a process of their own.

gz-transport's Python binding of `request` keeps the interpreter's lock until the reply is there. The thread that
receives replies also delivers subscribed messages, and waits for that lock: in a process that is subscribed to a topic,
a call ends with its time limit as soon as a message comes before the reply. So the caller is another process, which
subscribes to nothing.
"""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from contextlib import suppress
from typing import Final, Protocol

from cognitivedrone.errors import GazeboError
from cognitivedrone.system import own_session
from cognitivedrone.system.processes import environment
from cognitivedrone.text.json_text import parse_json

_PROGRAM: Final = "cognitivedrone.vehicles.gazebo.caller"

_END_S: Final = 5.0


class Services(Protocol):
    """Something that calls services."""

    def request(self, service: str, request: bytes, asks: str, answers: str, timeout_ms: int) -> bytes | None:
        """Call a service with a message, of the type named `asks`; returns the one of type `answers`, none if late."""
        ...

    def close(self) -> None:
        """Call no more."""
        ...


class ServiceProcess:
    """A process that calls services of gz-transport, one at a time. Call `close` at the end.

    It has the environment of its start, so the partition, too. Threads may share it.
    """

    def __init__(self, release: str) -> None:
        self._process = subprocess.Popen(  # noqa: S603 - no part of the command comes from outside
            [sys.executable, "-m", _PROGRAM, release],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment(),
            **own_session(),  # ctrl-C is for us
        )
        self._one_at_a_time = threading.Lock()

    def request(self, service: str, request: bytes, asks: str, answers: str, timeout_ms: int) -> bytes | None:
        """As `Services`; raises `GazeboError` if the process has ended."""
        call = json.dumps([service, request.hex(), asks, answers, timeout_ms])
        inlet, outlet = self._process.stdin, self._process.stdout
        if inlet is None or outlet is None:
            raise GazeboError("the process that calls Gazebo's services has no input or output")
        with self._one_at_a_time:
            try:
                inlet.write(call + "\n")
                inlet.flush()
                reply = outlet.readline()
            except (OSError, ValueError):
                reply = ""
        if not reply:
            raise GazeboError(
                f"the process that calls Gazebo's services ended with {self._process.poll()};"
                " what it printed above says why"
            )
        data = parse_json(reply)
        return None if data is None else bytes.fromhex(data)

    def close(self) -> None:
        """End it."""
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
