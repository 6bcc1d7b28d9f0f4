"""Every plug-in interface of the project.

`Policy` and `Reasoner` are base classes with defaults for rarely needed methods. A user's class may inherit them, or
define only the methods of `PolicyLike` or `ReasonerLike`. The others are Protocols: a class fits by its methods.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Protocol, Self, TypeVar

from cognitivedrone.system.interrupts import is_ctrl_c
from cognitivedrone.types import (
    Action,
    ActionChunk,
    EpisodeContext,
    Event,
    Guidance,
    Image,
    Observation,
    SeenPanel,
    SubGoal,
)

_Input = TypeVar("_Input")
_Result = TypeVar("_Result")


class PlugIn:
    """Common base of policies and reasoners. A subclass overrides only what it needs."""

    needs_ground_truth: bool = False
    """Whether contexts include the ground truth, for oracles and teachers. Only simulators have it."""
    needs_seed: bool = False
    """Whether it draws random numbers. If so, contexts include a seed of its own."""

    needs_down_camera: bool = False
    """Whether observations hold the view of a camera that looks down, too (`Observation.down`); of policies. Simulators
    have one: ours, and ArduPilot's on our physics, but in real time."""

    on_card: bool = False
    """Whether each object holds a network on a graphics card where there is one, unless its argument `device` is cpu.
    By default, no more processes than cards then fly."""

    reads_english_only: bool = False
    """Whether it knows English sentences alone. A person's sentence without one known word is not flown then."""

    def reset(self, context: EpisodeContext) -> None:
        """Start a stage. `context.stage` is 0 for a new flight: forget everything before it."""

    def fork(self) -> Self | None:
        """Another one, for a flight at the same time: it shares the weights, and nothing that a flight changes.

        None if that is not possible; then a server makes a new one by name for every client.
        """
        return None

    def check(self) -> None:
        """Check once before take-off; raises `PolicyError` if it cannot fly, for example without its server."""

    def close(self) -> None:
        """Release resources such as connections. Called once, after the last flight."""


def attempt(call: Callable[[_Input], _Result], value: _Input) -> _Result | Exception:
    """What `call(value)` returns, or the exception that it raises."""
    try:
        return call(value)
    except Exception as error:  # a user's policy may raise anything
        return error
    except SystemExit as error:
        return RuntimeError(f"it called sys.exit({error.code!r})")
    except BaseException as error:
        if is_ctrl_c(error):
            raise
        return RuntimeError(f"it raised {type(error).__name__}")


class Policy(PlugIn, ABC):
    """Image and text in, velocity commands out. `reset` is called at the start of every stage."""

    declines: bool = False
    """Whether the policy reports, with its latest commands, that no gate matches the instruction. It must then
    hover."""

    present: float | None = None
    """Its own probability, 0 to 1, that a gate shows what the sentence asks for, with its latest commands; none if it
    has no opinion. A reasoner's "Hold position" counts while the policy doubts it, too (`control.FilterRule`)."""

    trouble: str = ""
    """Why its latest commands only hold the position, such as a server that does not answer; empty otherwise."""

    @abstractmethod
    def act(self, observation: Observation) -> ActionChunk:
        """Commands for the next k >= 1 control steps, (k, 4) float32 in the heading frame, m/s and rad/s."""

    def act_batch(
        self, sessions: Sequence[Policy], observations: Sequence[Observation]
    ) -> Sequence[ActionChunk | Exception]:
        """The commands of several flights at once, each by a `fork` of this policy: what its own `act` returns.

        An exception of one is returned in its place, so that it does not disturb the others. By default they act one
        after the other; a policy that computes faster in batches overrides this.
        """
        return [attempt(session.act, seen) for session, seen in zip(sessions, observations, strict=True)]

    def around(self, action: Action) -> Action:
        """A command (4,) that is not its own, changed so that it leads around what the policy has seen in the way."""
        return action


class Reasoner(PlugIn, ABC):
    """Turns the user's instruction and an image of the scene into a plain directive.

    It declines by the directive "Hold position": no gate matches the instruction, and the drone hovers.

    `reset` is called before the first question of a stage. If `context.stage` is above 0, the last answer was the one
    for the previous stage.
    """

    seen: Sequence[SeenPanel] = ()
    """What it has read of the panels, gates from left to right, for displays; empty if it does not say. Replaced as a
    whole, so that other threads may read it."""

    @abstractmethod
    def refine(self, image: Image, instruction: str) -> Guidance:
        """The directive for the scene in `image`; raises `ReasonerError` if it has no answer this time."""

    def plan(self, mission: str) -> tuple[SubGoal, ...] | None:  # noqa: ARG002
        """The sub-goals of a mission in their order, asked for on the ground; none if it leaves that to the words.

        Raises `ReasonerError` if it has none that can be flown; nothing is flown then.
        """
        return None


class PolicyLike(Protocol):
    """The minimum that a user's policy defines; `adapters.as_policy` adds the rest."""

    def reset(self, context: EpisodeContext) -> None:
        """Start a stage."""

    def act(self, observation: Observation) -> ActionChunk:
        """As `Policy.act`."""


class ReasonerLike(Protocol):
    """The minimum that a user's reasoner defines; `adapters.as_reasoner` adds the rest."""

    def refine(self, image: Image, instruction: str) -> Guidance:
        """As `Reasoner.refine`."""


class Drone(Protocol):
    """Something that flies by velocity setpoints: the simulator, ArduPilot, a real vehicle."""

    def observe(self) -> Observation:
        """The newest frame and state."""

    def send(self, action: Action) -> Action:
        """Set the velocity setpoint; returns it as sent, after limits."""

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

    def note(self, event: Event) -> None:
        """Any other event, as it happens."""


class LabelPack(Protocol):
    """Supplies the pictures on panels."""

    def image(self, reference: str) -> Image:
        """The picture for a label reference `kind/concept@style`; raises `LabelError` with near names."""
