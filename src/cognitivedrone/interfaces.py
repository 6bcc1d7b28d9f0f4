"""Every plug-in interface of the project.

`Policy` and `Reasoner` are base classes with defaults for rarely needed methods. A user's class may inherit them, or
define only the methods of `PolicyLike` or `ReasonerLike`. The others are Protocols: a class fits by its methods.
`Health` is here because vehicles fill it in and the safety rules read it, and neither package may import the other.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Protocol

from cognitivedrone.types import (
    Action,
    ActionChunk,
    EpisodeContext,
    Event,
    FloatArray,
    Guidance,
    Image,
    Observation,
    Vector,
)


class PlugIn:
    """Common base of policies and reasoners. A subclass overrides only what it needs."""

    needs_ground_truth: bool = False
    """Whether contexts include the ground truth, for oracles and teachers. Only simulators have it."""
    needs_seed: bool = False
    """Whether it draws random numbers. If so, contexts include a seed of its own."""

    def reset(self, context: EpisodeContext) -> None:
        """Start a stage. `context.stage` is 0 for a new flight: forget everything before it."""

    def check(self) -> None:
        """Check once before take-off; raises `PolicyError` if it cannot fly, for example without its server."""

    def close(self) -> None:
        """Release resources such as connections. Called once, after the last flight."""


class Policy(PlugIn, ABC):
    """Image and text in, velocity commands out. `reset` is called at the start of every stage."""

    @abstractmethod
    def act(self, observation: Observation) -> ActionChunk:
        """Commands for the next k >= 1 control steps, (k, 4) float32 in the heading frame, m/s and rad/s."""


class Reasoner(PlugIn, ABC):
    """Turns the user's instruction and an image of the scene into a plain directive.

    `reset` is called before the first question of a stage. If `context.stage` is above 0, the last answer was the one
    for the previous stage.
    """

    @abstractmethod
    def refine(self, image: Image, instruction: str) -> Guidance:
        """The directive for the scene in `image`; raises `ReasonerError` if it has no answer this time."""


class PolicyLike(Protocol):
    """The minimum that a user's policy defines; `adapters.as_policy` adds the rest."""

    def reset(self, context: EpisodeContext) -> None:
        """Start a stage."""
        ...

    def act(self, observation: Observation) -> ActionChunk:
        """As `Policy.act`."""
        ...


class ReasonerLike(Protocol):
    """The minimum that a user's reasoner defines; `adapters.as_reasoner` adds the rest."""

    def refine(self, image: Image, instruction: str) -> Guidance:
        """As `Reasoner.refine`."""
        ...


class Drone(Protocol):
    """Something that flies by velocity setpoints: the simulator, ArduPilot, a real vehicle."""

    def observe(self) -> Observation:
        """The newest frame and state."""
        ...

    def send(self, action: Action) -> Action:
        """Set the velocity setpoint; returns it as sent, after limits."""
        ...

    def close(self) -> None: ...


class Clock(Protocol):
    """The loop's time source: wall clock or simulation.

    A clock that advances in steps, such as a vehicle's time by its telemetry, may have `resolution_s`, the length of a
    step; a deadline missed by less than that is met.
    """

    def now(self) -> float: ...

    def sleep_until(self, time_s: float) -> None: ...


class Recorder(Protocol):
    """Receives everything that happens in a flight."""

    def record(self, observation: Observation, action: Action, guidance: Guidance | None) -> None:
        """One control step: the observation, the command sent, and the directive in effect."""
        ...

    def note(self, event: Event) -> None:
        """Any other event, as it happens."""
        ...


@dataclass(frozen=True, slots=True)
class Health:
    """Health of a drone and its links at one moment. Ages are seconds since a source last delivered good data."""

    time: float
    """Of a steady clock, s."""
    command: FloatArray | None
    """(4,) the policy's last command, heading frame, m/s and rad/s, NaN included; none before the first."""
    command_age_s: float
    """Of the last finite command; before the first one, time since the policy took over."""
    frame_age_s: float
    """Of the newest camera frame."""
    link_age_s: float
    """Of the last message of any type from the vehicle."""
    state_age_s: float
    """Of attitude or position, whichever is older."""
    battery: float | None
    """Remaining charge, 0 to 1; none if the vehicle does not report it."""
    position: Vector
    """(3,) relative to the take-off point, ENU, m."""
    velocity: Vector
    """(3,) ENU, m/s."""
    yaw: float
    """Heading, counter-clockwise from east, rad."""
    mode: str
    """The flight mode that the vehicle reports."""
    ordered_modes: frozenset[str]
    """The mode that we ordered and, until the vehicle reports it, the previous one."""
    armed: bool
    """Whether the motors are armed."""
    stick_moved: bool
    """Whether a stick of the remote control has moved since we took over."""


class LabelPack(Protocol):
    """Supplies the pictures on panels."""

    def image(self, reference: str) -> Image:
        """The picture for a label reference `kind/concept@style`; raises `LabelError` with near names."""
        ...
