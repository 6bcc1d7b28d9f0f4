"""Controls a running Gazebo: places stages (gates, panels, light), and gives the vehicle's camera and true state.

    with GazeboWorld(Path("gazebo/assets")) as world:
        world.show(stage, load_pack())
        world.state()

Flight commands go to ArduPilot, over MAVLink. The services are those of gz-sim's UserCommands and
SceneBroadcaster systems. They answer once a command is queued, so this module watches the poses until the command has
been carried out.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from cognitivedrone.errors import GazeboError
from cognitivedrone.frames import wrap_angle, yaw_of
from cognitivedrone.interfaces import LabelPack
from cognitivedrone.types import DroneState, FloatArray, Stage
from cognitivedrone.vehicles.gazebo.bindings import RELEASES, Bindings, installed_releases, load_bindings
from cognitivedrone.vehicles.gazebo.sensing import GazeboCamera, Topic, TruePath, places_of
from cognitivedrone.vehicles.gazebo.worlds.export import write_meshes, write_pictures
from cognitivedrone.vehicles.gazebo.worlds.sdf import SUN, WORLD, Prop, document, prop_model, sun
from cognitivedrone.vehicles.gazebo.worlds.vehicle import CAMERA_TOPIC, NAME
from cognitivedrone.world.appearance import PLAIN, Appearance

LIGHT, MODEL = 1, 2
"""gz.msgs.Entity.Type."""
PLACE_M, PLACE_RAD = 1e-3, math.radians(0.1)
"""Tolerances of an entity's pose."""
_OURS = re.compile(r"(gate_[123]|panel_[123]|board|floor|room)(_\d+)?")
_SUN = re.compile(rf"{SUN}(_\d+)?")
_LOOK_AGAIN_S = 0.02
_LISTED = 3


@dataclass(frozen=True, slots=True)
class LiveConfig:
    """Time limits, s of the wall clock: a busy machine without a GPU stands still for seconds while it loads meshes or
    ArduPilot starts.
    """

    answer_s: float = 20.0
    """Time limit for a service to answer, and for a stage to be in place."""
    first_s: float = 30.0
    """Time limit for the first message of a topic."""
    silence_s: float = 20.0
    """A topic without messages for this long counts as broken."""


def plan(
    standing: Mapping[str, Prop | None], wanted: Sequence[Prop]
) -> tuple[list[tuple[str, Prop]], list[Prop], list[str]]:
    """The changes after which only `wanted` is in the world: equal props are moved, the rest replaced.

    `standing` maps current entities to their props; none for unknown props. Returns the entities to move, with the prop
    that each becomes, the props to spawn, and the entities to remove.
    """
    left = dict(standing)
    moves: list[tuple[str, Prop]] = []
    spawns: list[Prop] = []
    for prop in wanted:
        same = next((name for name, old in left.items() if old is not None and old.alike(prop)), None)
        if same is None:
            spawns.append(prop)
        else:
            moves.append((same, prop))
            del left[same]
    return moves, spawns, list(left)


def differences(places: Mapping[str, tuple[FloatArray, FloatArray]], wanted: Mapping[str, Prop | None]) -> str:
    """Differences between current and wanted entities, as text; empty if there are none.

    `places` are the positions and quaternions of all entities by name; those that are not ours are ignored.
    """
    ours = {name for name in places if _OURS.fullmatch(name)}
    complaints = [f"{name} is missing" for name in sorted(wanted.keys() - ours)]
    complaints += [f"{name} is still there" for name in sorted(ours - wanted.keys())]
    for name in sorted(ours & wanted.keys()):
        prop, (position, quaternion) = wanted[name], places[name]
        if prop is None:
            continue
        off = float(np.linalg.norm(position - prop.position))
        turned = abs(float(wrap_angle(yaw_of(quaternion) - prop.yaw)))
        if off > PLACE_M or turned > PLACE_RAD:
            complaints.append(f"{name} is {off:.3f} m and {math.degrees(turned):.1f} degrees from its place")
    more = [f"and {len(complaints) - _LISTED} more"] if len(complaints) > _LISTED else []
    return ", ".join(complaints[:_LISTED] + more)


class GazeboWorld:
    """A running world exported by this package. Use it as a context manager, or call `close`.

    Meshes and pictures of spawned models are written to `folder`, which Gazebo reads: both run on the same machine.
    Raises `GazeboError` if the bindings are missing, no Gazebo answers, or it runs another world.
    """

    def __init__(self, folder: Path, config: LiveConfig | None = None, bindings: Bindings | None = None) -> None:
        self.config = config or LiveConfig()
        self.bindings = bindings or load_bindings()
        self._folder = folder.resolve()
        self._serial = 0
        self._path: TruePath | None = None
        self._poses: Topic[dict[str, tuple[FloatArray, FloatArray]]] | None = None
        self._known: frozenset[str] = frozenset()
        self._standing: dict[str, Prop | None] = {}
        self._sun: str | None = None
        self._light = ""
        self._sure = False
        """Whether this record is still valid; false after a stage that failed."""
        self._services = self.bindings.new_services()
        with ExitStack() as undo:
            undo.callback(self.close)
            self._find_server()
            self._look_around()
            try:
                write_meshes(self._folder)
            except OSError as error:
                raise GazeboError(f"cannot write into {self._folder}: {error.strerror or error}") from None
            undo.pop_all()

    def __enter__(self) -> GazeboWorld:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def show(self, stage: Stage, labels: LabelPack, appearance: Appearance = PLAIN) -> None:
        """Replace the current stage, including its light; returns once the new one is in place.

        Raises `LabelError`, or `GazeboError` if Gazebo refuses or takes too long.
        """
        try:
            wanted = write_pictures(stage, labels, appearance, self._folder)
        except OSError as error:
            raise GazeboError(f"cannot write a texture into {self._folder}: {error.strerror or error}") from None
        if not self._sure:
            self._look_around()
        self._sure = False
        moves, spawns, removals = plan(self._standing, wanted)
        for name, prop in moves:
            self.move(name, prop.position, prop.yaw)
            self._standing[name] = prop
        for prop in spawns:
            name = self._new_name(prop.name)
            self.spawn(name, prop_model(prop, f"file://{self._folder}/"))
            self._standing[name] = prop
        for name in removals:
            self.remove(name, MODEL)
            del self._standing[name]
        self._shine(sun(stage, appearance))
        self._await_places()
        self._sure = True

    def spawn(self, name: str, element: ET.Element) -> None:
        """Order a model or light under a name that is not used yet. Raises `GazeboError`, as all changes do."""
        element.set("name", name)
        request = self.bindings.message("EntityFactory")()
        request.sdf = document(element)
        request.name = name
        request.allow_renaming = False
        self._command("create", request, f"spawn {name}")

    def remove(self, name: str, kind: int = MODEL) -> None:
        """Order the removal of a model, or of a light."""
        request = self.bindings.message("Entity")()
        request.name = name
        request.type = kind
        self._command("remove", request, f"remove {name}")

    def move(self, name: str, position: Sequence[float], yaw: float) -> None:
        """Order a model to a position (3,), m, upright, with a heading, rad."""
        request = self.bindings.message("Pose")()
        request.name = name
        request.position.x, request.position.y, request.position.z = position
        request.orientation.w, request.orientation.z = math.cos(yaw / 2), math.sin(yaw / 2)
        self._command("set_pose", request, f"move {name}")

    def entities(self) -> frozenset[str]:
        """Names of the models and lights in the scene."""
        delivered, scene = self._request(f"/world/{WORLD}/scene/info", "Empty", "Scene")
        if not delivered:
            raise GazeboError(
                f"Gazebo did not report its scene within {self.config.answer_s:g} s; does the world load the system"
                " gz-sim-scene-broadcaster-system?"
            )
        return frozenset(entity.name for entity in (*scene.model, *scene.light))

    def places(self) -> dict[str, tuple[FloatArray, FloatArray]]:
        """Position (3,) in m and quaternion (4,) w, x, y, z of all entities now, by name."""
        if self._poses is None:
            topic = f"/world/{WORLD}/pose/info"
            self._poses = Topic(self.bindings, topic, "Pose_V", places_of, self.config.first_s)
        return self._poses.newest(self.config.silence_s)[0]

    def state(self) -> DroneState:
        """The vehicle's true state; rates are finite differences over 0.1 s."""
        self._path = self._path or self.path()
        return self._path.newest().state

    def path(self) -> TruePath:
        """The vehicle's true states from now on; the caller closes it."""
        config = self.config
        topic = f"/world/{WORLD}/dynamic_pose/info"
        return TruePath(self.bindings, topic, NAME, first_s=config.first_s, silence_s=config.silence_s)

    def camera(self) -> GazeboCamera:
        """The vehicle's camera; the caller closes it. Raises `CameraError` if it sends no frames."""
        return GazeboCamera(self.bindings, CAMERA_TOPIC, first_s=self.config.first_s, silence_s=self.config.silence_s)

    def close(self) -> None:
        """Unsubscribe, and call no more; the stage remains in Gazebo."""
        for topic in (self._path, self._poses):
            if topic is not None:
                topic.close()
        self._path = self._poses = None
        self._services.close()

    def _find_server(self) -> None:
        """Check that Gazebo runs our world."""
        delivered, reply = self._request("/gazebo/worlds", "Empty", "StringMsg_V")
        if not delivered:
            raise GazeboError(f"no Gazebo answers within {self.config.answer_s:g} s; {self._advice()}")
        running = list(reply.data)
        if WORLD not in running:
            others = ", ".join(map(repr, running)) or "(none yet)"
            raise GazeboError(
                f"Gazebo already runs the world {others}, not {WORLD!r};"
                " stop it and start ours, or give each a GZ_PARTITION of its own"
            )

    def _look_around(self) -> None:
        """Read the current entities: at the start, and after a stage that failed."""
        self._known = self.entities()
        if NAME not in self._known:
            raise GazeboError(
                f"the world {WORLD!r} has no model {NAME!r}; start one made by: cognitivedrone gazebo export"
            )
        self._standing = {name: None for name in self._known if _OURS.fullmatch(name)}
        self._sun = next((name for name in sorted(self._known) if _SUN.fullmatch(name)), None)
        self._light = ""
        self._sure = True

    def _advice(self) -> str:
        """What to do if no Gazebo answers."""
        ours, installed = self.bindings.release.name, installed_releases()
        if installed and ours not in installed:
            others = " and ".join(name.capitalize() for name in sorted(installed))
            packages = " or ".join(RELEASES[name].bindings for name in sorted(installed))
            return (
                f"the simulator here is Gazebo {others}, but the Python bindings are of {ours.capitalize()}:"
                f" apt-get install {packages}"
            )
        return "start it with: gz sim -r world.sdf, on this machine and with the same GZ_PARTITION"

    def _shine(self, light: ET.Element) -> None:
        """Replace the light unless it is the same: gz-sim can only move models."""
        text = document(light)
        if text != self._light:
            name = self._new_name(SUN)
            self.spawn(name, light)
            if self._sun is not None:
                self.remove(self._sun, LIGHT)
            self._sun, self._light = name, text

    def _command(self, service: str, request: Any, what: str) -> None:
        """Request a change of the world."""
        delivered, reply = self._request(f"/world/{WORLD}/{service}", request, "Boolean")
        if not delivered:
            raise GazeboError(f"Gazebo did not answer when asked to {what}; is it still running?")
        if not reply.data:
            raise GazeboError(f"Gazebo refuses to {what}; its own output says why (gz sim -v 4)")

    def _request(self, service: str, request: Any, answer: str) -> tuple[bool, Any]:
        """Call a service: whether it answered in time, and the answer. `request` is a message, or its type if empty."""
        message = self.bindings.message(request)() if isinstance(request, str) else request
        asks, timeout_ms = type(message).DESCRIPTOR.name, round(1000 * self.config.answer_s)
        data = self._services.request(service, message.SerializeToString(), asks, answer, timeout_ms)
        reply = self.bindings.message(answer)()
        reply.ParseFromString(data or b"")
        return data is not None, reply

    def _await_places(self) -> None:
        """Wait until exactly the wanted entities of ours are in place."""
        self.places()
        end = time.monotonic() + self.config.answer_s
        while problem := differences(self.places(), self._standing):
            if time.monotonic() > end:
                raise GazeboError(
                    f"{self.config.answer_s:g} s after the stage was ordered, {problem}; is the simulation running?"
                    " Its own output says more (gz sim -v 4)"
                )
            time.sleep(_LOOK_AGAIN_S)

    def _new_name(self, kind: str) -> str:
        """An unused entity name: a removed entity may still be there for a while."""
        while True:
            self._serial += 1
            name = f"{kind}_{self._serial}"
            if name not in self._known:
                return name
