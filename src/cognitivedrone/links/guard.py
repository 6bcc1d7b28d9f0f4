"""What a link asks of whoever decides about safety, so that it need not know the rules."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

from cognitivedrone.types import Action, FloatArray


@dataclass(frozen=True, slots=True)
class Health:
    """What the guard is told, see `cognitivedrone.flight.safety.Health` for each."""

    time: float
    command: FloatArray | None
    command_age_s: float
    frame_age_s: float
    link_age_s: float
    state_age_s: float
    battery: float | None
    position: FloatArray
    velocity: FloatArray
    yaw: float
    mode: str
    ordered_modes: frozenset[str]
    armed: bool
    stick_moved: bool


class Decision(Protocol):
    """What a guard says."""

    @property
    def kind(self) -> Literal["fly", "hold", "brake", "land", "hands_off"]:
        """What to do."""
        ...

    @property
    def reason(self) -> str:
        """Why, in words."""
        ...


class Guard(Protocol):
    """The rules of safety: `cognitivedrone.flight.safety.Guard`."""

    def judge(self, health: Health) -> Decision:
        """What to do now."""
        ...

    def shape(self, health: Health) -> Action:
        """The command (4,) to send now, after a decision to fly."""
        ...

    def land(self, reason: str) -> None:
        """Decide to land from now on."""
        ...
