"""The values of a flight of the command `fly`: frozen dataclasses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

from cognitivedrone.interfaces import Drone
from cognitivedrone.pilot import Pilot
from cognitivedrone.types import Action, Event, Guidance, Observation, StageResult, SubGoal, Track
from cognitivedrone.vehicles.contract import Status, Vehicle

EndKind = Literal["passed", "flown", "missed", "unsure", "ordered", "time", "vehicle", "interrupted"]
"""How a flight ended, in order: through the right gate; through a gate that is not judged; any other end of the scene;
at the time limit while it hovered, unsure; landed by order; at the time limit; by the safety rules, the vehicle or its
pilot; by ctrl-C or SIGTERM."""
EXIT_CODES: dict[EndKind, int] = {
    "passed": 0, "flown": 0, "ordered": 0, "time": 0, "missed": 1, "unsure": 1, "vehicle": 1, "interrupted": 130
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Ending:
    """Why a flight is over."""

    kind: EndKind
    reason: str
    """As text."""


@dataclass(frozen=True, slots=True)
class Step:
    """One control step."""

    time: float
    """Since the start of the flight, s."""
    segment: int
    """Counts the instructions, from 0."""
    instruction: str
    """The user's."""
    observation: Observation
    """Its `instruction` is the policy's input: the directive, if there is one."""
    sent: Action
    guidance: Guidance | None
    policy_s: float | None
    """Duration of the policy's inference; none for later steps of a chunk."""
    status: Status
    stage: int = 0
    """Index in the track of a simulated scene."""


class Instrument(Protocol):
    """Receives the steps and events of a flight: the log, the view."""

    def step(self, step: Step) -> None:
        """Process a control step."""

    def event(self, event: Event) -> None:
        """Process an event."""


class Page(Instrument, Protocol):
    """Shows a flight to people, who may steer it. Nothing of it may wait."""

    def begin(self, vehicle: Vehicle, pilot: Pilot, goals: Sequence[SubGoal]) -> None:
        """Show a flight that begins now; `goals` are the sub-goals of its mission, if that is one."""

    def steer(self, action: Action) -> Action:
        """The command to send instead of the pilot's: a person's, who has taken over, or the same."""


class SteeredDrone:
    """A drone that a person at a page may take over."""

    def __init__(self, drone: Drone, page: Page) -> None:
        self._drone, self._page = drone, page

    def observe(self) -> Observation:
        """As `Drone`."""
        return self._drone.observe()

    def send(self, action: Action) -> Action:
        """Send the person's command, if there is one, else the pilot's."""
        return self._drone.send(self._page.steer(action))

    def close(self) -> None:
        """As `Drone`."""
        self._drone.close()


@dataclass(frozen=True, slots=True)
class Summary:
    """Summary of a flight."""

    ending: Ending
    steps: int
    seconds: float
    late: int
    """Number of missed deadlines."""
    policy_ms: tuple[float, float]
    """Median and 95th percentile of the policy's inference time; NaN if it never ran."""
    reasoner_ms: tuple[float, float]
    """Median and 95th percentile of the age of the reasoner's answers at arrival; NaN if there was none."""
    out: Path
    """Folder of the log."""
    track: Track = ()
    """Tasks of the scene, in simulation."""
    results: tuple[StageResult, ...] = ()
    """How its stages ended."""

    @property
    def exit_code(self) -> int:
        """Exit code of the command."""
        return EXIT_CODES[self.ending.kind]
