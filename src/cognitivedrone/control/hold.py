"""Holding: while the reasoner is not sure that what is asked for is there, the drone hovers.

A `Hold` listens to a mind and stands between the control loop and the drone:

    hold = Hold()
    fly(HeldDrone(drone, hold), policy, clock, mission, mind=HoldAwareReasoner(mind, hold))

The policy goes on thinking meanwhile, so that the flight goes on at once where an answer becomes sure. The benchmark
flies without one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cognitivedrone.control.async_reasoner import Answer, AsyncReasoner, Question
from cognitivedrone.interfaces import Drone
from cognitivedrone.types import Action, Observation


@dataclass(frozen=True, slots=True)
class HoldRule:
    """When the drone hovers, and when it flies on.

    How sure an answer is: its confidence times how likely what is asked for is shown at all, 0 to 1. Answers are
    averaged, newer ones weigh more. An answer that is missing since the view is too poor ("unsure") counts as 0 until
    the first answer came: close to a gate, what was read before has left the view.
    """

    below: float = 0.5
    """Below this mean it hovers; 0 never."""
    margin: float = 0.15
    """So much above `below` it flies on, so that it does not do both in turn."""
    newest: float = 0.5
    """Weight of the newest answer in the mean."""
    answers: int = 2
    """It takes that many answers to hover, so that one hesitant glance from afar changes nothing."""


class Hold:
    """Whether to hover, of one leg at a time."""

    def __init__(self, rule: HoldRule | None = None) -> None:
        self.rule = rule or HoldRule()
        self.active = False
        """Whether the drone is to hover now."""
        self.sure = 1.0
        """Mean of the answers of this leg; 1 before the first."""
        self._segment: int | None = None
        self._heard = 0
        self._answered = False

    def begin(self, segment: int) -> None:
        """Forget the last leg where this is another one, and fly."""
        if segment != self._segment:
            self._segment, self._heard, self._answered = segment, 0, False
            self.active, self.sure = False, 1.0

    def update(self, answer: Answer) -> None:
        """Take an answer; those of other legs, and faults that tell nothing of the scene, say nothing."""
        guidance = answer.guidance
        if answer.question.segment != self._segment:
            return
        if guidance is not None:
            value = guidance.confidence * (1.0 if guidance.present is None else guidance.present)
            self._answered = True
        elif answer.fault == "unsure" and not self._answered:
            value = 0.0
        else:
            return
        self.sure = value if self._heard == 0 else self.sure + self.rule.newest * (value - self.sure)
        self._heard += 1
        if self.active:
            self.active = self.sure < min(1.0, self.rule.below + self.rule.margin)
        else:
            self.active = self._heard >= self.rule.answers and self.sure < self.rule.below


class HoldAwareReasoner:
    """A mind whose answers are heard by a `Hold` as well."""

    def __init__(self, async_reasoner: AsyncReasoner, hold: Hold) -> None:
        self._async_reasoner, self._hold = async_reasoner, hold

    def idle(self, now: float) -> bool:
        """As the mind."""
        return self._async_reasoner.idle(now)

    def ask(self, question: Question) -> None:
        """A question of another leg begins anew."""
        self._hold.begin(question.segment)
        self._async_reasoner.ask(question)

    def answer(self, now: float) -> Answer | None:
        """As the mind."""
        answer = self._async_reasoner.answer(now)
        if answer is not None:
            self._hold.update(answer)
        return answer

    def close(self) -> None:
        """As the mind."""
        self._async_reasoner.close()


class HeldDrone:
    """A drone that is sent zero velocity while a `Hold` is active."""

    def __init__(self, drone: Drone, hold: Hold) -> None:
        self._drone, self._hold = drone, hold

    def observe(self) -> Observation:
        """As the drone."""
        return self._drone.observe()

    def send(self, action: Action) -> Action:
        """The action, or no velocity at all."""
        return self._drone.send(np.zeros_like(action) if self._hold.active else action)

    def close(self) -> None:
        """As the drone."""
        self._drone.close()
