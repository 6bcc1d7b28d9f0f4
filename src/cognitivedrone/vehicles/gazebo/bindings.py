"""Gazebo's own Python: its supported releases, its bindings, and calls of its services from a process of their own."""

from __future__ import annotations

import importlib
import json
import os
import re
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

from cognitivedrone.errors import GazeboError, did_you_mean
from cognitivedrone.system import own_session
from cognitivedrone.system.processes import environment
from cognitivedrone.text.json_text import parse_json


@dataclass(frozen=True, slots=True)
class Release:
    """One release of Gazebo."""

    name: str
    sim: int
    """Major version of gz-sim, as `gz sim --versions` prints it."""
    package: str
    """Debian package of the complete release."""
    bindings: str
    """Debian packages of the Python bindings."""
    transport: str
    """Module of gz-transport."""
    messages: str
    """Package of the modules of gz-msgs."""


RELEASES: dict[str, Release] = {
    release.name: release
    for release in (
        Release("jetty", 10, "gz-jetty", "python3-gz-transport15 python3-gz-msgs12", "gz.transport", "gz.msgs"),
        Release("ionic", 9, "gz-ionic", "python3-gz-transport14 python3-gz-msgs11", "gz.transport14", "gz.msgs11"),
        Release(
            "harmonic", 8, "gz-harmonic", "python3-gz-transport13 python3-gz-msgs10", "gz.transport13", "gz.msgs10"
        ),
    )
}
"""By name, newest first. The same worlds work with all of them; Harmonic and Jetty have long-term support."""


def release_named(name: str) -> Release:
    """The release with this name; raises `GazeboError` with similar names."""
    if name not in RELEASES:
        raise GazeboError(f"unknown Gazebo release {name!r}; {did_you_mean(name, RELEASES)}")
    return RELEASES[name]


_END_S: Final = 5.0


class ServiceProcess:
    """A process that calls services of gz-transport, one at a time. Call `close` at the end.

    It has the environment of its start, so the partition, too. Threads may share it.
    """

    def __init__(self, release: str) -> None:
        self._process = subprocess.Popen(  # noqa: S603 - no part of the command comes from outside
            [sys.executable, "-m", "cognitivedrone.vehicles.gazebo.bindings", release],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment(),
            **own_session(),  # ctrl-C is for us
        )
        self._one_at_a_time = threading.Lock()

    def request(self, service: str, request: bytes, asks: str, answers: str, timeout_ms: int) -> bytes | None:
        """Call a service with a message, of the type named `asks`; returns the one of type `answers`, none if late.

        Raises `GazeboError` if the process has ended.
        """
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


MODULES = {
    "Boolean": "boolean_pb2",
    "Empty": "empty_pb2",
    "Entity": "entity_pb2",
    "EntityFactory": "entity_factory_pb2",
    "Image": "image_pb2",
    "Pose": "pose_pb2",
    "Pose_V": "pose_v_pb2",
    "Scene": "scene_pb2",
    "StringMsg_V": "stringmsg_v_pb2",
}
"""The messages used, with their modules."""
_VERSIONS_S = 10.0


@dataclass(frozen=True, slots=True)
class Bindings:
    """The bindings of one release."""

    release: Release
    new_node: Callable[[], Any]
    """A `gz.transport` node: `subscribe` and `unsubscribe`."""
    load: Callable[[str], Any]
    new_services: Callable[[], ServiceProcess]
    """What calls services: a node of ours cannot while it, or another, is subscribed to a topic."""

    def message(self, name: str) -> Any:
        """The class of a message, one of `MODULES`."""
        return getattr(self.load(f"{self.release.messages}.{MODULES[name]}"), name)


def load_bindings(
    release: str | None = None,
    load: Callable[[str], Any] = importlib.import_module,
    services: Callable[[str], ServiceProcess] = ServiceProcess,
) -> Bindings:
    """The bindings of a release, or the newest installed ones.

    `load` imports a module by name, `services` makes what calls the services of a release. Raises `GazeboError` that
    says what to install.
    """
    asked = list(RELEASES.values()) if release is None else [release_named(release)]
    for candidate in asked:
        try:
            transport = load(candidate.transport)
            load(f"{candidate.messages}.{MODULES['Empty']}")
        except (ImportError, TypeError) as error:  # protobuf raises TypeError for generated code that is too old
            if isinstance(error, ModuleNotFoundError) and (error.name or "gz").startswith("gz"):
                continue
            raise GazeboError(
                f"the Python bindings of Gazebo {candidate.name.capitalize()} are installed, but this Python cannot"
                f" load them ({error}); use the Python that they were built for, with its protobuf: /usr/bin/python3"
            ) from None
        return Bindings(candidate, transport.Node, load, partial(services, candidate.name))
    wanted = "; ".join(f"{r.name.capitalize()}: apt-get install {r.bindings}" for r in asked)
    raise GazeboError(
        f"gz-transport's Python bindings are not installed; they come with Gazebo's own packages ({wanted}), and a"
        " virtual environment can use them if it was made with --system-site-packages"
    )


def installed_releases() -> frozenset[str]:
    """Names of the installed simulator releases; empty without Gazebo."""
    command = shutil.which("gz")
    if command is None:
        return frozenset()
    try:
        done = subprocess.run(  # noqa: S603 - no part of the command comes from outside
            (command, "sim", "--versions"), check=False, capture_output=True, text=True, timeout=_VERSIONS_S
        )
    except (OSError, subprocess.TimeoutExpired):
        return frozenset()
    majors = {int(major) for major in re.findall(r"^(\d+)\.\d+", done.stdout, flags=re.MULTILINE)}
    return frozenset(release.name for release in RELEASES.values() if release.sim in majors)


def replies(release: str, calls: Iterable[str]) -> Iterator[str]:
    """The reply to each call, as lines of JSON: a message in hexadecimal digits, or null."""
    bindings = load_bindings(release)
    node = bindings.new_node()
    for call in calls:
        service, data, asks, answers, timeout_ms = parse_json(call)
        kind = bindings.message(asks)
        request = kind()
        request.ParseFromString(bytes.fromhex(data))
        delivered, reply = node.request(service, request, kind, bindings.message(answers), timeout_ms)
        yield json.dumps(reply.SerializeToString().hex() if delivered else None)


def main() -> None:
    """The program behind `ServiceProcess`: a call per line of its input, a reply per line, until the input ends."""
    # gz-transport prints complaints to the standard output; only replies may go there.
    with os.fdopen(os.dup(sys.stdout.fileno()), "w") as out:
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
        for reply in replies(sys.argv[1], sys.stdin):
            print(reply, file=out, flush=True)


if __name__ == "__main__":
    main()
