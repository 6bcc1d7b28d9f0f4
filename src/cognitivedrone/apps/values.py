"""The values of a flight that a person watches: frozen dataclasses."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

from cognitivedrone.types import Action, Event, Guidance, Observation
from cognitivedrone.vehicles.contract import Status

EndKind = Literal["passed", "flown", "missed", "unsure", "told", "time", "vehicle", "interrupted"]
"""Through the right gate; through a gate of which nobody but the user knows whether it was meant; the scene was ended
otherwise; by the time limit while it hovered, unsure; landed by order; by the time limit; by the rules of safety, by
the vehicle or its pilot; by ctrl-C or a request to terminate."""
EXIT_CODES: dict[EndKind, int] = {
    "passed": 0, "flown": 0, "told": 0, "time": 0, "missed": 1, "unsure": 1, "vehicle": 1, "interrupted": 130
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Ending:
    """Why a flight is over."""

    kind: EndKind
    reason: str
    """In words."""


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
    """Its `instruction` is what the policy was told: the directive, where there is one."""
    sent: Action
    guidance: Guidance | None
    policy_s: float | None
    """How long the policy thought; none where a step of an earlier chunk was flown."""
    status: Status


class Instrument(Protocol):
    """What is told of a flight: the log, the view."""

    def step(self, step: Step) -> None:
        """A control step was flown."""
        ...

    def event(self, event: Event) -> None:
        """Something happened."""
        ...


@dataclass(frozen=True, slots=True)
class Summary:
    """What is left of a flight."""

    ending: Ending
    steps: int
    seconds: float
    late: int
    """Deadlines that were missed."""
    policy_ms: tuple[float, float]
    """Median and 95th percentile of the policy's thinking; NaN where it never did."""
    reasoner_ms: tuple[float, float]
    """Of the age of the reasoner's answers at their arrival; NaN where there was none."""
    out: Path
    """Folder of the log."""

    @property
    def exit_code(self) -> int:
        """For the shell."""
        return EXIT_CODES[self.ending.kind]
