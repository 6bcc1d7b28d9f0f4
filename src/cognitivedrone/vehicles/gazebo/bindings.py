"""gz-transport's Python bindings, for every supported release of Gazebo.

    bindings = load_bindings()             # the newest installed ones
    node = bindings.new_node()             # to subscribe; services are called by `services.py`
    Pose = bindings.message("Pose")

Interface: https://gazebosim.org/api/transport/13/python.html; the messages are protobuf classes of gz-msgs.
"""

from __future__ import annotations

import importlib
import re
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from cognitivedrone.errors import GazeboError
from cognitivedrone.vehicles.gazebo.release import RELEASES, Release, release_named
from cognitivedrone.vehicles.gazebo.services import ServiceProcess, Services

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
    new_services: Callable[[], Services]
    """What calls services: a node of ours cannot while it, or another, is subscribed to a topic."""

    def message(self, name: str) -> Any:
        """The class of a message, one of `MODULES`."""
        return getattr(self.load(f"{self.release.messages}.{MODULES[name]}"), name)


def load_bindings(
    release: str | None = None,
    load: Callable[[str], Any] = importlib.import_module,
    services: Callable[[str], Services] = ServiceProcess,
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
    majors = {int(version.partition(".")[0]) for version in simulator_versions()}
    return frozenset(release.name for release in RELEASES.values() if release.sim in majors)


def simulator_versions() -> tuple[str, ...]:
    """The installed versions of the simulator, as `gz sim --versions` prints them; empty without Gazebo."""
    command = shutil.which("gz")
    if command is None:
        return ()
    try:
        done = subprocess.run(  # noqa: S603 - no part of the command comes from outside
            (command, "sim", "--versions"), check=False, capture_output=True, text=True, timeout=_VERSIONS_S
        )
    except (OSError, subprocess.TimeoutExpired):
        return ()
    return tuple(re.findall(r"^(\d+\.\d+\S*)", done.stdout, flags=re.MULTILINE))
