"""Plans: the options of a command as one frozen value, made where the command starts and passed on whole.

A plan is a dataclass of dataclasses: `Scenario` (what is flown), `PilotSpec` (who flies), `VehicleSpec` (where), and
the command's own options. Each field is an option of the command line: its name is the flag, its docstring the help.
A run's identity, the command line that repeats it and its JSON are derived from the fields, so a new option is added
here and nowhere else. This module imports nothing heavy, so that `--help` is fast.

Field metadata: `identity` is the key among the options of run.json and results.json; a field without it does not affect
the results. `written` is "always", or "where set" to omit the key at the default. `command` says when the command line
that repeats a run includes the option: "always", "where set" or "never".
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, Field, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, get_type_hints

from cognitivedrone.choices import AppearanceName as AppearanceName
from cognitivedrone.errors import AppearanceError, LinkError, UnknownOption, UsageError, did_you_mean
from cognitivedrone.ranges import WIND, Range, Seed, check_arguments, fitted
from cognitivedrone.system import refusal
from cognitivedrone.text.printable import shown_address

Rule = Literal["through", "within_1m"]
"""`through`: the drone's centre crosses the right gate's plane inside its opening. `within_1m`: the published rule, the
drone comes within 1 m of the right gate's centre."""

VEHICLE_KINDS = ("sim", "sitl", "gazebo", "mavlink")
"""Names of the registry of vehicles, `cognitivedrone.vehicles`."""
LOOPBACK = ("127.", "localhost:", "::1:", "[::1]:")

_Written = Literal["always", "where set", "never"]
_Value = TypeVar("_Value")
_Self = TypeVar("_Self", bound="Options")


def _option(
    default: _Value, *, identity: str | None = None, written: _Written = "always", command: _Written = "where set"
) -> _Value:
    """A field of a plan, with the metadata described in the module docstring."""
    metadata = {"identity": identity, "written": written, "command": command}
    made: _Value = field(default=default, metadata=metadata)
    return made


class _Leaf(NamedTuple):
    """One option of a plan."""

    field: Field[Any]
    default: Any
    value: Any


class Options:
    """Base of plans and their parts: access to options by name, at any depth.

    A plan that exists is valid: making one raises `UsageError` for a number out of its range, and what `check` raises.
    """

    __slots__ = ()

    def __post_init__(self) -> None:
        hints = get_type_hints(type(self), include_extras=True)
        for each in dataclasses.fields(self):  # type: ignore[arg-type]
            value = getattr(self, each.name)
            if (fit := fitted(each.name, hints[each.name], value)) is not value:
                object.__setattr__(self, each.name, fit)
        check_arguments(type(self), {each.name: getattr(self, each.name) for each in dataclasses.fields(self)})  # type: ignore[arg-type]
        self.check()

    def check(self) -> None:
        """Raise one of the package's errors for options that contradict each other."""

    @classmethod
    def of(cls: type[_Self], **values: Any) -> _Self:
        """A plan from options, or whole parts, by name. Raises `UnknownOption` for an unknown name."""
        made = _build(cls, None, values)
        _refuse(values, made)
        return made

    def changed(self: _Self, **values: Any) -> _Self:
        """A copy with some options, or whole parts, changed. Raises `UnknownOption` for an unknown name."""
        made = _build(type(self), self, values)
        _refuse(values, made)
        return made

    def values(self) -> dict[str, Any]:
        """Every option by name."""
        return {name: leaf.value for name, leaf in _leaves(self)}

    def changes(self) -> dict[str, Any]:
        """The options that affect the results and differ from their defaults."""
        return {
            name: leaf.value
            for name, leaf in _leaves(self)
            if leaf.field.metadata.get("command") != "never" and leaf.value != leaf.default
        }

    def identity(self, resolved: Mapping[str, object]) -> dict[str, Any]:
        """The options that affect the results, by their keys in run.json.

        `resolved` maps options to what is recorded instead of their value, such as a file's hash.
        """
        found = {}
        for name, leaf in _leaves(self):
            metadata = leaf.field.metadata
            key = metadata.get("identity")
            value = resolved.get(name, leaf.value)
            if key and (metadata["written"] == "always" or value != leaf.default):
                found[key] = value
        return found

    @classmethod
    def identity_options(cls) -> dict[str, tuple[Any, Any]]:
        """Type and default of every option that is part of the identity, by its key."""
        found: dict[str, tuple[Any, Any]] = {}
        hints = get_type_hints(cls)
        for each in dataclasses.fields(cls):  # type: ignore[arg-type]
            usual = _default(each)
            if isinstance(usual, Options):
                found |= type(usual).identity_options()
            elif key := each.metadata.get("identity"):
                found[key] = hints[each.name], usual
        return found

    @classmethod
    def identity_names(cls) -> dict[str, str]:
        """Name of every option that is part of the identity, by its key."""
        found: dict[str, str] = {}
        for each in dataclasses.fields(cls):  # type: ignore[arg-type]
            usual = _default(each)
            if isinstance(usual, Options):
                found |= type(usual).identity_names()
            elif key := each.metadata.get("identity"):
                found[key] = each.name
        return found

    def words(self) -> list[str]:
        """The command-line options that repeat this plan, without those that do not affect the results."""
        values, words = self.values(), list[str]()
        for name, leaf in _leaves(self):
            when = leaf.field.metadata.get("command", "where set")
            if when == "never" or (when == "where set" and leaf.value == leaf.default):
                continue
            if name == "suite" and values.get("tasks") is not None:
                continue
            flag = f"--{name.replace('_', '-')}"
            if isinstance(leaf.value, bool):
                words += [flag if leaf.value else f"--no-{name}"]
            else:
                words += [flag, *map(str, leaf.value if isinstance(leaf.value, tuple) else (leaf.value,))]
        return words


@dataclass(frozen=True, slots=True)
class TaskSource(Options):
    """Tasks and the pictures on their panels."""

    suite: str = _option("open-v1:test", command="always")
    """Name of a suite of tasks."""
    tasks: Path | None = _option(None)
    """Task file, or folder of them, in place of a suite."""
    labels: Path | None = _option(None, identity="labels")
    """Folder of label images that take precedence over the shipped ones."""
    seed: Seed = _option(0, identity="seed", command="always")
    """Seed of all random numbers. Same seed, same results."""

    @property
    def title(self) -> str:
        """Name of the suite, or of the task file."""
        return self.suite if self.tasks is None else self.tasks.stem


@dataclass(frozen=True, slots=True)
class Scenario(TaskSource):
    """What is flown."""

    track: bool = _option(False, identity="track")
    """Chain single tasks into tracks of five, flown without a stop."""
    appearance: AppearanceName = _option("plain", identity="appearance")
    """How the room looks: plain, as published; varied from episode to episode; or photo: photographed places."""
    place: str = _option("", identity="place", written="where set")
    """Where to fly: training or kept (one of those places, from episode to episode), a name of `cognitivedrone list`,
    or a panorama of your own, twice as wide as high. Without it, photo means training."""
    airframe: str = _option("racer", identity="airframe")
    """The drone that flies."""
    wind: Annotated[float, WIND] = _option(0.0, identity="wind_m_s")
    """Speed of a steady wind, m/s; every episode draws its direction."""

    def check(self) -> None:
        """Raise `AppearanceError` for a place in a room without places. A place alone asks for photo."""
        if self.place and self.appearance == "varied":
            raise AppearanceError(f"--place {self.place} is photographed; leave out --appearance varied")
        if self.place and self.appearance == "plain":
            object.__setattr__(self, "appearance", "photo")


@dataclass(frozen=True, slots=True)
class PilotSpec(Options):
    """Who flies."""

    policy: str = _option("small", command="always")
    """Policy: a name, small:MODEL.onnx for a model file, or your own as module:attribute."""
    reasoner: str = _option("none", command="always")
    """Reasoner: a name, none to give the policy the raw instruction, or your own as module:attribute."""
    look: Literal["yes", "no"] = _option("yes", identity="look", written="where set")
    """Whether the drone looks closer where the reasoner is unsure, before it chooses."""

    def check(self) -> None:
        """Raise `UsageError` for another answer than yes or no."""
        if self.look not in ("yes", "no"):
            raise UsageError(f"--look is {self.look!r}; it must be yes or no")

    @property
    def shown(self) -> PilotSpec:
        """As it is printed and stored: addresses of servers without their secrets."""
        return replace(self, policy=shown_address(self.policy), reasoner=shown_address(self.reasoner))


@dataclass(frozen=True, slots=True)
class VehicleSpec(Options):
    """Where it flies."""

    link: str = _option("sim", identity="link", written="where set")
    """sim: the simulator. sitl: a real ArduCopter on our physics (docs/vehicles.md). gazebo: ArduPilot in the Gazebo
    running on this machine, in Gazebo's time; needs --airframe iris (docs/gazebo.md). mavlink:URL: a vehicle, such as
    mavlink:udp:127.0.0.1:14550, mavlink:tcp:HOST:PORT or mavlink:serial:DEVICE:BAUD; `fly` only."""
    sitl: Path | None = _option(None, command="never")
    """With sitl: the ArduCopter binary; the environment variable ARDUCOPTER by default."""

    def check(self) -> None:
        """Raise `LinkError` for a link that cannot be read."""
        if self.kind not in VEHICLE_KINDS or (self.kind == "mavlink" and not self.url):
            raise LinkError(
                f"cannot read --link {self.link!r}: expected sim, sitl, gazebo or mavlink:URL such as"
                f" mavlink:udp:127.0.0.1:14550; {did_you_mean(self.kind, VEHICLE_KINDS)}"
            )
        if self.kind != "mavlink" and self.link != self.kind:
            raise LinkError(f"--link {self.kind} takes no address, {self.link!r} was given")
        if self.kind != "sim" and (refused := refusal(f"--link {self.kind}")):
            raise LinkError(refused)

    @property
    def kind(self) -> str:
        """Name in the registry of vehicles."""
        return self.link.partition(":")[0]

    @property
    def url(self) -> str:
        """Address of a MAVLink vehicle; empty for others."""
        return self.link.partition(":")[2]

    @property
    def on_loopback(self) -> bool:
        """Whether a MAVLink vehicle's address is on this machine."""
        kind, _, address = self.url.partition(":")
        return kind != "serial" and address.startswith(LOOPBACK)


@dataclass(frozen=True, slots=True)
class SafetySpec(Options):
    """How a MAVLink vehicle is flown, and its safety limits."""

    camera: str = _option("")
    """With mavlink: /dev/videoN (on a Mac avfoundation:N), an rtsp:// or http:// URL, a video file, a folder of images,
    or gazebo:TOPIC of a running Gazebo, such as gazebo:/cognitivedrone/camera."""
    takeoff_height: float = _option(1.0)
    """Take-off height, m above the ground."""
    fence_radius: Annotated[float, Range(0.1, unit="m")] = _option(30.0)
    """Geofence radius, m around the take-off point."""
    ceiling: float = _option(10.0)
    """Maximum height, m above the take-off point."""
    policy_patience: Annotated[float, Range(0.1, 5, "s")] = _option(0.2)
    """Seconds without a command before the vehicle is stopped; raise it for slower policies."""
    set_parameters: bool = _option(False)
    """Allow parameters of the vehicle that are not safe to fly to be set for the flight, and restored after it."""
    clock: Literal["wall", "vehicle"] = _option("wall")
    """With mavlink: fly by the vehicle's own time, for simulators that run faster or slower than real time."""
    sitl_defaults: tuple[Path, ...] = _option(())
    """With sitl: parameter files to load before ours."""
    sitl_instance: Annotated[int, Range(0, 5000)] = _option(0)
    """With sitl: instance number; shifts the ports, so that several can run at once."""
    i_understand_this_flies_a_real_drone: bool = _option(False)
    """Required for any vehicle that is not known to be simulated."""

    def check(self) -> None:
        """Raise `LinkError` for a take-off beyond the ceiling."""
        if not 0 < self.takeoff_height < self.ceiling:
            raise LinkError(
                f"--takeoff-height {self.takeoff_height} must be above 0 and below --ceiling {self.ceiling}"
            )


def _build(kind: type[_Self], base: _Self | None, values: dict[str, Any]) -> _Self:
    """A plan of `kind`: `base`, or the defaults, changed by the options in `values`, which are removed from it."""
    given: dict[str, Any] = {}
    for each in dataclasses.fields(kind):  # type: ignore[arg-type]
        current = _default(each) if base is None else getattr(base, each.name)
        if each.name in values:
            given[each.name] = values.pop(each.name)
        elif isinstance(current, Options):
            given[each.name] = _build(type(current), current, values)
        elif current is not MISSING:
            given[each.name] = current
    return kind(**given)


def _refuse(values: Mapping[str, Any], made: Options) -> None:
    if values:
        name = min(values)
        hint = did_you_mean(name, made.values())
        raise UnknownOption(f"{type(made).__name__} got an unexpected keyword argument {name!r}; {hint}")


def _default(each: Field[Any]) -> Any:
    return each.default if each.default_factory is MISSING else each.default_factory()


def _leaves(plan: Options, default: Options | None = None) -> Iterator[tuple[str, _Leaf]]:
    """The options of a plan by name, in field order."""
    for each in dataclasses.fields(plan):  # type: ignore[arg-type]
        value = getattr(plan, each.name)
        usual = _default(each) if default is None else getattr(default, each.name)
        if isinstance(value, Options):
            yield from _leaves(value, usual)
        else:
            yield each.name, _Leaf(each, usual, value)
