"""Every plug-in interface of the project.

`Policy` and `Reasoner` are base classes, with defaults for what few need; a user's class may inherit them, or have only
the methods of `PolicyLike` or `ReasonerLike`. The others are Protocols: a class fits by its methods. Beside them stands
`Health`, what links tell the rules of safety: neither room may know the other.
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
    """What policies and reasoners have in common. A class that inherits it overrides only what it needs."""

    needs_ground_truth: bool = False
    """Whether contexts hold the ground truth, for oracles and teachers: only a simulator has it."""
    needs_seed: bool = False
    """Whether it draws random numbers: contexts then hold a seed of its own."""

    def reset(self, context: EpisodeContext) -> None:
        """A stage begins; with `context.stage` 0 a new flight, and everything before it is forgotten."""

    def check(self) -> None:
        """Called once before take-off: raises `PolicyError` where it could not fly, as without its server."""

    def close(self) -> None:
        """Let go of what is held open, such as a connection: called once, after the last flight."""


class Policy(PlugIn, ABC):
    """Image and text in, velocity commands out. `reset` begins every stage."""

    @abstractmethod
    def act(self, observation: Observation) -> ActionChunk:
        """Commands for the next k >= 1 control steps, (k, 4) float32 in the heading frame, m/s and rad/s."""


class Reasoner(PlugIn, ABC):
    """Turns the user's instruction into a plain directive, looking at the scene.

    `reset` comes before the first question of a stage. With `context.stage` above 0 what was answered last was the
    answer for the stage that has ended.
    """

    @abstractmethod
    def refine(self, image: Image, instruction: str) -> Guidance:
        """The directive for what `image` shows; raises `ReasonerError` where it has none to give this time."""


class PolicyLike(Protocol):
    """The least that a policy of the user's has; `adapters.as_policy` completes it."""

    def reset(self, context: EpisodeContext) -> None:
        """A stage begins."""
        ...

    def act(self, observation: Observation) -> ActionChunk:
        """As `Policy.act`."""
        ...


class ReasonerLike(Protocol):
    """The least that a reasoner of the user's has; `adapters.as_reasoner` completes it."""

    def refine(self, image: Image, instruction: str) -> Guidance:
        """As `Reasoner.refine`."""
        ...


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
    """Where the loop takes its time from: the wall, or the simulation.

    One whose time goes on in steps, as a vehicle tells it, has the length of a step in s as `resolution_s`: so much
    late is in time.
    """

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
