"""Every plug-in interface of the project. Plain Protocols: a class fits by its methods, it inherits nothing.

Beside them stands `Health`, what links tell the rules of safety: neither room may know the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from cognitivedrone.types import (
    Action,
    ActionChunk,
    Event,
    FloatArray,
    Guidance,
    Image,
    Observation,
    Truth,
    Vector,
)


class Policy(Protocol):
    """Image and text in, velocity commands out."""

    def reset(self, instruction: str) -> None:
        """Forget the last flight; the next `act` starts a new one."""
        ...

    def act(self, observation: Observation) -> ActionChunk:
        """Commands for the next k >= 1 control steps, (k, 4) float32 in the heading frame, m/s and rad/s."""
        ...


class Reasoner(Protocol):
    """Turns the user's instruction into a plain directive, looking at the scene."""

    def refine(self, image: Image, instruction: str) -> Guidance:
        """The directive for what `image` shows; raises `ReasonerError` where it has none to give this time."""
        ...


@runtime_checkable
class StatefulReasoner(Protocol):
    """A reasoner that looks more than once: at several frames of a stage, and back at earlier stages of a track."""

    def new_flight(self) -> None:
        """Forget everything; the first stage begins."""
        ...

    def new_stage(self) -> None:
        """The next stage begins: what was answered last was the answer for the one that has ended."""
        ...


@runtime_checkable
class Privileged(Protocol):
    """A policy or reasoner that asks for the truth: oracles and teachers. Only the simulator can tell it."""

    def brief(self, truth: Truth) -> None:
        """Called at the start of every stage, after a policy's `reset`."""
        ...


@runtime_checkable
class Checked(Protocol):
    """A policy or reasoner that depends on something outside: a server, a key."""

    def check(self) -> None:
        """Called once before take-off; raises `PolicyError` where it could not fly."""
        ...


@runtime_checkable
class Seeded(Protocol):
    """A policy or reasoner that draws random numbers: seeded once an episode, before `reset`."""

    def seed(self, seed: int) -> None: ...


class Drone(Protocol):
    """Something that flies by velocity setpoints: the simulator, ArduPilot, a real vehicle."""

    def observe(self) -> Observation:
        """The newest frame and state."""
        ...

    def send(self, action: Action) -> Action:
        """Set the velocity setpoint; returns it as really sent, after limits."""
        ...

    def close(self) -> None: ...


class Clock(Protocol):
    """Where the loop takes its time from: the wall, or the simulation."""

    def now(self) -> float: ...

    def sleep_until(self, time_s: float) -> None: ...


class Recorder(Protocol):
    """Sees everything that happens in a flight."""

    def record(self, observation: Observation, action: Action, guidance: Guidance | None) -> None:
        """One control step: what was seen, what was sent, and the directive that was flown by."""
        ...

    def note(self, event: Event) -> None:
        """Anything else, as it happens."""
        ...


@dataclass(frozen=True, slots=True)
class Health:
    """How everything around a drone is doing at one moment. Ages count from when a thing was last good, s."""

    time: float
    """Of a steady clock, s."""
    command: FloatArray | None
    """(4,) what the policy asked for last, heading frame, m/s and rad/s, NaN and all; none before it first did."""
    command_age_s: float
    """Of the last command of finite numbers; before there was one, since the policy took over."""
    frame_age_s: float
    """Of the newest camera frame."""
    link_age_s: float
    """Of the last message from the vehicle, whatever it was."""
    state_age_s: float
    """Of the older of attitude and position."""
    battery: float | None
    """What is left, 0 to 1; none where the vehicle does not say."""
    position: Vector
    """(3,) from where it took off, ENU, m."""
    velocity: Vector
    """(3,) ENU, m/s."""
    yaw: float
    """Heading, from east to the left, rad."""
    mode: str
    """The vehicle's flight mode, as it says."""
    ordered_modes: frozenset[str]
    """The mode that we ordered and, until the vehicle shows it, the one before."""
    armed: bool
    """Whether the motors may turn."""
    stick_moved: bool
    """Whether a stick of the remote control has left its place since we took over."""


class LabelPack(Protocol):
    """Knows what panels show."""

    def image(self, reference: str) -> Image:
        """The picture for a label reference `kind/concept@style`; raises `LabelError` with near names."""
        ...
