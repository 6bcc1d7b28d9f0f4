"""A Gazebo that is not there: it speaks the Python interface of gz-transport, and records what it was asked.

Messages are real protobuf classes with the fields of gz-msgs that are used, and travel as bytes, so that what cannot be
set or sent in truth cannot be set or sent here. Like the real one it answers a command when it is queued, and carries
it out a little later.
"""

import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Self

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from sdf_reading import parse, values

from cognitivedrone.vehicles.gazebo.bindings import MODULES, RELEASES, Bindings, ServiceProcess, load_bindings

FIELD = descriptor_pb2.FieldDescriptorProto
TEXT, BYTES, BOOL, NUMBER = FIELD.TYPE_STRING, FIELD.TYPE_BYTES, FIELD.TYPE_BOOL, FIELD.TYPE_DOUBLE
INT, UINT, LONG = FIELD.TYPE_INT32, FIELD.TYPE_UINT32, FIELD.TYPE_INT64
FIELDS: dict[str, list[tuple[str, Any]]] = {
    "Time": [("sec", LONG), ("nsec", INT)],
    "Header": [("stamp", "Time")],
    "Vector3d": [(axis, NUMBER) for axis in "xyz"],
    "Quaternion": [(axis, NUMBER) for axis in "xyzw"],
    "Pose": [("header", "Header"), ("name", TEXT), ("position", "Vector3d"), ("orientation", "Quaternion")],
    "Pose_V": [("header", "Header"), ("pose", ["Pose"])],
    "Boolean": [("data", BOOL)],
    "Empty": [("unused", BOOL)],
    "Entity": [("name", TEXT), ("type", INT)],
    "EntityFactory": [("sdf", TEXT), ("name", TEXT), ("allow_renaming", BOOL), ("pose", "Pose")],
    "Image": [
        *((name, UINT) for name in ("width", "height", "step")),
        ("pixel_format_type", INT),
        ("data", BYTES),
        ("header", "Header"),
    ],
    "Light": [("name", TEXT)],
    "Model": [("name", TEXT), ("pose", "Pose")],
    "Scene": [("name", TEXT), ("model", ["Model"]), ("light", ["Light"])],
    "StringMsg_V": [("data", [TEXT])],
}


def make_messages() -> dict[str, Any]:
    """The message classes by their names."""
    file = descriptor_pb2.FileDescriptorProto(name="stand_in.proto", package="gz.msgs", syntax="proto3")
    for name, fields in FIELDS.items():
        message = file.message_type.add(name=name)
        for number, (field, kind) in enumerate(fields, start=1):
            repeated = isinstance(kind, list)
            kind = kind[0] if repeated else kind
            added = message.field.add(name=field, number=number)
            added.label = FIELD.LABEL_REPEATED if repeated else FIELD.LABEL_OPTIONAL
            added.type = FIELD.TYPE_MESSAGE if isinstance(kind, str) else kind
            if isinstance(kind, str):
                added.type_name = f".gz.msgs.{kind}"
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return {name: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"gz.msgs.{name}")) for name in FIELDS}


MESSAGES = make_messages()


def pose_message(time_s: float, position: Any, quaternion: Any = (1.0, 0.0, 0.0, 0.0), name: str = "iris") -> Any:
    """Where a model is, among links that are relative to it."""
    message = MESSAGES["Pose_V"]()
    message.header.stamp.sec, message.header.stamp.nsec = int(time_s), round((time_s % 1) * 1e9)
    message.pose.add(name="base_link").orientation.w = 1.0
    pose = message.pose.add(name=name)
    p, o = pose.position, pose.orientation
    p.x, p.y, p.z = map(float, position)
    o.w, o.x, o.y, o.z = map(float, quaternion)
    for index in range(4):
        message.pose.add(name=f"rotor_{index}").orientation.w = 1.0
    return message


class FakeGazebo:
    """A running Gazebo of one release, with one world in it."""

    def __init__(self, release: str = "harmonic", world: str = "cognitivedrone", models: tuple[str, ...] = ()) -> None:
        self.release = RELEASES[release]
        self.world = world
        self.poses: dict[str, tuple[list[float], float]] = {name: ([0.0, 0.0, 0.0], 0.0) for name in models}
        """Position and yaw of what stands."""
        self.lights: set[str] = {"sun"}
        self.asked: list[tuple[str, Any]] = []
        """Service and request, without those that only look."""
        self.silent: set[str] = set()
        """Ends of services that do not answer."""
        self.refusing: set[str] = set()
        """Ends of services that answer no."""
        self.dead: set[str] = set()
        """Ends of services that answer yes and do nothing."""
        self.lag = 2
        """Steps of the simulation before a command is carried out."""
        self.callers = 0
        """Processes that call services."""
        self.broken: list[Exception] = []
        self._running = threading.Event()
        self.listeners: dict[str, list[tuple[Any, Callable[[Any], None]]]] = {}
        self._waiting: list[tuple[int, Callable[[], None]]] = []

    def load(self, module: str) -> Any:
        """What `importlib.import_module` does on a machine with this release's bindings."""
        if module == self.release.transport:
            return SimpleNamespace(Node=lambda: Node(self))
        for name, file in MODULES.items():
            if module == f"{self.release.messages}.{file}":
                return SimpleNamespace(**{name: MESSAGES[name]})
        raise ModuleNotFoundError(f"No module named {module!r}", name=module)

    def bindings(self) -> Bindings:
        """This release's bindings in our process, with another one to call services."""
        return load_bindings(load=self.load, services=lambda release: OtherProcess(self))

    def publish(self, topic: str, message: Any) -> None:
        """Send a message to whoever listens."""
        for kind, callback in list(self.listeners.get(topic, ())):
            copy = kind()
            copy.ParseFromString(message.SerializeToString())
            callback(copy)

    def answer(self, service: str, request: Any, answer: str) -> Any | None:
        """What a service says; none for nothing."""
        end = service.rpartition("/")[2]
        if end in self.silent:
            return None
        if service == "/gazebo/worlds" and answer == "StringMsg_V":
            return MESSAGES["StringMsg_V"](data=[self.world])
        if not service.startswith(f"/world/{self.world}/"):
            return None
        if end == "info" and answer == "Scene":
            scene = MESSAGES["Scene"](name=self.world, light=[MESSAGES["Light"](name=name) for name in self.lights])
            scene.model.extend(MESSAGES["Model"](name=name) for name in self.poses)
            return scene
        if answer != "Boolean":
            return None
        self.asked.append((end, request))
        if end in self.refusing:
            return MESSAGES["Boolean"](data=False)
        if end not in self.dead:
            self._waiting.append((self.lag, lambda: self._do(end, request)))
        return MESSAGES["Boolean"](data=True)

    @contextmanager
    def running(self) -> Iterator[Self]:
        """Simulates in a thread of its own: carries out commands, and tells where everything is."""
        thread = threading.Thread(target=self._run)
        self._running.set()
        thread.start()
        try:
            yield self
        finally:
            self._running.clear()
            thread.join()
        assert not self.broken

    def _run(self) -> None:
        try:
            while self._running.is_set():
                self.step()
                time.sleep(0.002)
        except Exception as error:
            self.broken.append(error)

    def step(self) -> None:
        waiting, self._waiting = self._waiting, []
        for left, do in waiting:
            if left > 0:
                self._waiting.append((left - 1, do))
            else:
                do()
        message = MESSAGES["Pose_V"]()
        for name, ((x, y, z), yaw) in self.poses.items():
            pose = message.pose.add()
            pose.name = name
            pose.position.x, pose.position.y, pose.position.z = x, y, z
            pose.orientation.w, pose.orientation.z = math.cos(yaw / 2), math.sin(yaw / 2)
        # Then come links and visuals, relative to their parents and under names of their own, and lights.
        for name in (*("link" for _ in self.poses), *("visual" for _ in self.poses), *self.lights):
            message.pose.add(name=name).orientation.w = 1.0
        self.publish(f"/world/{self.world}/pose/info", message)

    def _do(self, end: str, request: Any) -> None:
        if end == "create":
            assert request.name not in self.poses.keys() | self.lights
            (element,) = parse(request.sdf)
            assert element.get("name") == request.name
            for tag in ("uri", "albedo_map", "emissive_map"):
                for file in element.iter(tag):
                    assert file.text.startswith("file:///")
                    assert Path(file.text.removeprefix("file://")).is_file()
            if element.tag == "light":
                self.lights.add(request.name)
            else:
                *position, _, _, yaw = values(element, "pose") if element.find("pose") is not None else [0.0] * 6
                self.poses[request.name] = position, yaw
        elif end == "remove" and request.type == 1:
            self.lights.remove(request.name)
        elif end == "remove":
            assert request.type == 2
            del self.poses[request.name]
        elif end == "set_pose":  # of models alone: nothing else is moved by it
            p, q = request.position, request.orientation
            assert request.name in self.poses
            self.poses[request.name] = [p.x, p.y, p.z], 2 * math.atan2(q.z, q.w)


class Node:
    """As `gz.transport13.Node`."""

    def __init__(self, gazebo: FakeGazebo) -> None:
        self._gazebo = gazebo
        self._own: dict[str, tuple[Any, Callable[[Any], None]]] = {}

    def subscribe(self, kind: Any, topic: str, callback: Callable[[Any], None]) -> bool:
        if " " in topic:
            return False
        self._own[topic] = (kind, callback)
        self._gazebo.listeners.setdefault(topic, []).append(self._own[topic])
        return True

    def unsubscribe(self, topic: str) -> bool:
        self._gazebo.listeners[topic].remove(self._own.pop(topic))
        return True

    def request(self, service: str, request: Any, asks: Any, answers: Any, timeout: int) -> tuple[bool, Any]:
        """It keeps the interpreter's lock, and the reply waits behind any message for us, which needs it."""
        assert isinstance(timeout, int)
        if any(self._gazebo.listeners.values()):
            return False, answers()
        sent = asks()
        sent.ParseFromString(request.SerializeToString())
        reply = answers()
        expected = self._gazebo.answer(service, sent, answers.DESCRIPTOR.name)
        if expected is not None:
            reply.ParseFromString(expected.SerializeToString())
        return expected is not None, reply


class OtherProcess(ServiceProcess):
    """A process that subscribes to nothing."""

    def __init__(self, gazebo: FakeGazebo) -> None:
        self._gazebo = gazebo
        gazebo.callers += 1

    def request(self, service: str, request: bytes, asks: str, answers: str, timeout_ms: int) -> bytes | None:
        assert isinstance(timeout_ms, int)
        expected = self._gazebo.answer(service, MESSAGES[asks].FromString(request), answers)
        return None if expected is None else expected.SerializeToString()

    def close(self) -> None:
        self._gazebo.callers -= 1
