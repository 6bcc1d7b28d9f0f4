"""A running Gazebo: the gates, panels and light of the next stage, the vehicle's camera and its true state.

    with GazeboWorld(Path("gazebo/assets")) as world:
        world.show(stage, load_pack())
        drone = MavlinkDrone("tcp:127.0.0.1:5760", world.camera(), Guard(), MavlinkConfig(clock="vehicle"))
        world.state()

Commands go to ArduPilot, by `MavlinkDrone`; here is only what Gazebo knows. Services are those of gz-sim's UserCommands
and SceneBroadcaster systems. They answer once a command is queued, so the scene is asked whether it was carried out.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cognitivedrone.interfaces import LabelPack
from cognitivedrone.links.gazebo.bindings import Bindings, installed_releases, load_bindings
from cognitivedrone.links.gazebo.export import write_meshes, write_pictures
from cognitivedrone.links.gazebo.release import RELEASES, GazeboError
from cognitivedrone.links.gazebo.sdf import SUN, WORLD, Prop, document, prop_model, sun_pose
from cognitivedrone.links.gazebo.sight import GazeboCamera, GazeboTruth
from cognitivedrone.links.gazebo.vehicle import CAMERA_TOPIC, NAME
from cognitivedrone.types import DroneState, Stage
from cognitivedrone.world.look import PLAIN, Look

MODEL = 2
"""gz.msgs.Entity.MODEL."""
_OURS = re.compile(r"(gate_[123]|panel_[123]|board|floor|room)(_\d+)?")
_LOOK_AGAIN_S = 0.02


@dataclass(frozen=True, slots=True)
class LiveConfig:
    """Which Gazebo, and how long it may take."""

    world: str = WORLD
    vehicle: str = NAME
    camera_topic: str = CAMERA_TOPIC
    release: str | None = None
    """Whose bindings to use; the newest that are installed otherwise."""
    answer_s: float = 5.0
    """For a service to answer, and for a command to show in the scene."""
    first_s: float = 10.0
    """For the first message of a topic."""
    silence_s: float = 3.0
    """A topic that brings nothing for as long as this is taken for broken."""


@dataclass(frozen=True, slots=True)
class Plan:
    """How one set of props becomes another."""

    moves: tuple[tuple[str, Prop], ...]
    """Entities that stay, and the prop that each becomes."""
    spawns: tuple[Prop, ...]
    removals: tuple[str, ...]
    """Entities."""


def plan(standing: Mapping[str, Prop | None], wanted: Sequence[Prop]) -> Plan:
    """What to do so that only `wanted` stands: what is the same gate, panel or room is moved, the rest replaced.

    `standing` maps the entities that stand to their props; none where what they look like is not known.
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
    return Plan(tuple(moves), tuple(spawns), tuple(left))


class GazeboWorld:
    """A running world that was exported from here. Use it as a context manager, or call `close`.

    Meshes and pictures of what it spawns are written into `folder`, which Gazebo reads: both run on one machine. Raises
    `GazeboError` without bindings, without a Gazebo that answers, or with another world than ours in it.
    """

    def __init__(self, folder: Path, config: LiveConfig | None = None, bindings: Bindings | None = None) -> None:
        self.config = config or LiveConfig()
        self.bindings = bindings or load_bindings(self.config.release)
        self._folder = folder.resolve()
        self._node = self.bindings.new_node()
        self._serial = 0
        self._truth: GazeboTruth | None = None
        self._meet()
        models = self._models()
        if self.config.vehicle not in models:
            raise GazeboError(
                f"the world {self.config.world!r} has no model {self.config.vehicle!r}; start one made by:"
                " cognitivedrone gazebo export"
            )
        self._standing: dict[str, Prop | None] = {name: None for name in models if _OURS.fullmatch(name)}
        try:
            write_meshes(self._folder)
        except OSError as error:
            raise GazeboError(f"cannot write into {self._folder}: {error.strerror or error}") from None

    def __enter__(self) -> GazeboWorld:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def show(self, stage: Stage, labels: LabelPack, look: Look = PLAIN) -> None:
        """Make a stage stand in place of what stands, its light included; returns once the scene shows it.

        Raises `LabelError`, or `GazeboError` where Gazebo refuses or does not do it in time.
        """
        try:
            wanted = write_pictures(stage, labels, look, self._folder)
        except OSError as error:
            raise GazeboError(f"cannot write a texture into {self._folder}: {error.strerror or error}") from None
        steps = plan(self._standing, wanted)
        for name, prop in steps.moves:
            self._move(name, prop.position, prop.yaw)
            self._standing[name] = prop
        for prop in steps.spawns:
            name = self._new_name(prop)
            self._spawn(name, prop)
            self._standing[name] = prop
        for name in steps.removals:
            self._remove(name)
            del self._standing[name]
        self._move(SUN, *sun_pose(stage))
        self._await_scene()

    def state(self) -> DroneState:
        """The vehicle's true state; rates are differences over a tenth of a second."""
        if self._truth is None:
            topic = f"/world/{self.config.world}/dynamic_pose/info"
            self._truth = GazeboTruth(
                self.bindings,
                topic,
                self.config.vehicle,
                first_s=self.config.first_s,
                silence_s=self.config.silence_s,
            )
        return self._truth.state()

    def camera(self) -> GazeboCamera:
        """The vehicle's camera, for a `MavlinkDrone`, which closes it; raises `CameraError` where it stays silent."""
        return GazeboCamera(
            self.bindings, self.config.camera_topic, first_s=self.config.first_s, silence_s=self.config.silence_s
        )

    def close(self) -> None:
        """Listen no longer; what stands stays."""
        if self._truth is not None:
            self._truth.close()
            self._truth = None

    def _meet(self) -> None:
        """See that our world is the one that runs."""
        delivered, reply = self._request("/gazebo/worlds", "Empty", "StringMsg_V")
        if not delivered:
            raise GazeboError(f"no Gazebo answers within {self.config.answer_s:g} s; {self._advice()}")
        running = list(reply.data)
        if self.config.world not in running:
            others = ", ".join(map(repr, running)) or "(none yet)"
            raise GazeboError(
                f"Gazebo already runs the world {others}, not {self.config.world!r};"
                " stop it and start ours, or give each a GZ_PARTITION of its own"
            )

    def _advice(self) -> str:
        """What to do where nobody answers."""
        ours, installed = self.bindings.release.name, installed_releases()
        if installed and ours not in installed:
            others = " and ".join(name.capitalize() for name in sorted(installed))
            packages = " or ".join(RELEASES[name].bindings for name in sorted(installed))
            return (
                f"the simulator here is Gazebo {others}, but the Python bindings are of {ours.capitalize()}:"
                f" apt-get install {packages}"
            )
        return "start it with: gz sim -r world.sdf, on this machine and with the same GZ_PARTITION"

    def _spawn(self, name: str, prop: Prop) -> None:
        model = prop_model(prop, f"file://{self._folder}/")
        model.set("name", name)
        request = self.bindings.message("EntityFactory")()
        request.sdf = document(model)
        request.name = name
        request.allow_renaming = False
        self._command("create", request, f"spawn {name}")

    def _remove(self, name: str) -> None:
        request = self.bindings.message("Entity")()
        request.name = name
        request.type = MODEL
        self._command("remove", request, f"remove {name}")

    def _move(self, name: str, position: tuple[float, float, float], yaw: float) -> None:
        request = self.bindings.message("Pose")()
        request.name = name
        request.position.x, request.position.y, request.position.z = position
        request.orientation.w, request.orientation.z = math.cos(yaw / 2), math.sin(yaw / 2)
        self._command("set_pose", request, f"move {name}")

    def _command(self, service: str, request: Any, what: str) -> None:
        """Ask for a change of the world."""
        delivered, reply = self._request(f"/world/{self.config.world}/{service}", request, "Boolean")
        if not delivered:
            raise GazeboError(f"Gazebo did not answer when asked to {what}; is it still running?")
        if not reply.data:
            raise GazeboError(f"Gazebo refuses to {what}; its own output says why (gz sim -v 4)")

    def _request(self, service: str, request: Any, answer: str) -> tuple[bool, Any]:
        """Whether a service answered in time, and what; `request` is a message, or the name of an empty one."""
        message = self.bindings.message(request)() if isinstance(request, str) else request
        timeout_ms = round(1000 * self.config.answer_s)
        delivered, reply = self._node.request(
            service, message, type(message), self.bindings.message(answer), timeout_ms
        )
        return bool(delivered), reply

    def _models(self) -> frozenset[str]:
        """Names of the models in the scene."""
        delivered, scene = self._request(f"/world/{self.config.world}/scene/info", "Empty", "Scene")
        if not delivered:
            raise GazeboError(
                f"Gazebo does not tell of its scene within {self.config.answer_s:g} s; does the world load the system"
                " gz-sim-scene-broadcaster-system?"
            )
        return frozenset(model.name for model in scene.model)

    def _await_scene(self) -> None:
        """Wait until the scene holds of ours what it should, and no more."""
        wanted = frozenset(self._standing)

        def there() -> frozenset[str]:
            return frozenset(name for name in self._models() if _OURS.fullmatch(name))

        seen = _until(there, wanted, self.config.answer_s)
        if seen != wanted:
            late = ", ".join(sorted(wanted - seen)) or "nothing"
            extra = ", ".join(sorted(seen - wanted)) or "nothing"
            raise GazeboError(
                f"{self.config.answer_s:g} s after the stage was ordered, the scene still lacks {late} and has {extra}"
                " too many; is the simulation running? Its own output says more (gz sim -v 4)"
            )

    def _new_name(self, prop: Prop) -> str:
        """A name that no entity has: one that was just removed may still be there."""
        while True:
            self._serial += 1
            name = f"{prop.name}_{self._serial}"
            if name not in self._standing:
                return name


def _until(look: Callable[[], frozenset[str]], wanted: frozenset[str], limit_s: float) -> frozenset[str]:
    """Look again and again until it is as wanted, or the time is up; the last that was seen."""
    end = time.monotonic() + limit_s
    while (seen := look()) != wanted and time.monotonic() < end:
        time.sleep(_LOOK_AGAIN_S)
    return seen
