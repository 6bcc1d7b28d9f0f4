"""What a link asks of whoever decides about safety, so that it need not know the rules."""

from __future__ import annotations

from typing import Protocol

from cognitivedrone.choices import DecisionKind
from cognitivedrone.control.health import Health
from cognitivedrone.control.safety import Order
from cognitivedrone.types import Action


class Decision(Protocol):
    """What a guard says."""

    @property
    def kind(self) -> DecisionKind:
        """What to do."""
        ...

    @property
    def reason(self) -> str:
        """Why, in words."""
        ...


class Guard(Protocol):
    """The rules of safety: `cognitivedrone.control.safety.Guard`."""

    def judge(self, health: Health) -> Decision:
        """What to do now."""
        ...

    def shape(self, health: Health) -> Action:
        """The command (4,) to send now, after a decision to fly."""
        ...

    def order(self, decision: Decision, health: Health, landing: str) -> Order:
        """What to send for a decision but to fly; `landing` is the mode that lands."""
        ...

    def land(self, reason: str) -> None:
        """Decide to land from now on."""
        ...
