"""The interface of the safety rules to the link: the rules themselves, or their replacement in simulations."""

from __future__ import annotations

from typing import Protocol

from cognitivedrone.control.safety import Decision, Order
from cognitivedrone.control.safety.health import Health
from cognitivedrone.types import Action

__all__ = ["Decision", "Guard"]


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
