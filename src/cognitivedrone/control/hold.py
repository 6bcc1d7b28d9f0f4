"""Hovers while the reasoner is unsure that the scene shows what the instruction asks for.

A `Hold` receives the reasoner's answers and overrides the commands of the control loop:

    hold = Hold()
    fly(HeldDrone(drone, hold), policy, clock, mission, reasoner=HoldAwareReasoner(reasoner, hold))

An answer about a view that was doubted already is no new evidence: while the view stays the same, certainty only falls.
The policy keeps running meanwhile, so that the flight continues at once when an answer is sure. The benchmark does not
use it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cognitivedrone.control.async_reasoner import Answer, AsyncReasoner, Question
from cognitivedrone.interfaces import Drone
from cognitivedrone.types import Action, Image, Observation


@dataclass(frozen=True, slots=True)
class HoldRule:
    """When the drone hovers, and when it flies on.

    The certainty of an answer is its confidence times the probability that the scene shows what is asked for, 0 to 1.
    A fault may have a certainty too. Answers are averaged; newer ones weigh more. The fault "unsure" without one (the
    view is too poor) counts as 0 until the first answer; not later, because close to a gate the panels have left the
    view.
    """

    below: float = 0.5
    """It hovers below this mean; 0 means never."""
    margin: float = 0.15
    """It flies on at this much above `below` (hysteresis)."""
    newest: float = 0.5
    """Weight of the newest answer in the mean."""
    answers: int = 2
    """Answers needed before it hovers, so that a single unsure answer from afar changes nothing."""
    moved: float = 4.0
    """Two frames show the same view if they differ by less than this on average, of 255."""


class Hold:
    """Whether to hover, for one segment at a time."""

    def __init__(self, rule: HoldRule | None = None) -> None:
        self.rule = rule or HoldRule()
        self.active = False
        """Whether the drone must hover now."""
        self.sure = 1.0
        """Mean certainty of this segment's answers; 1 before the first."""
        self.given_up = False
        """Whether the pilot declines, because it stayed in doubt or did not understand the instruction."""
        self.reason = ""
        """The reasoner's newest reason for its doubt, as text."""
        self.answers = 0
        """Number of answers to this segment, or since `look_anew`."""
        self._segment: int | None = None
        self._answered = False
        self._anew = False
        self._doubted: Image | None = None
        """The view that was doubted."""

    def begin(self, segment: int) -> None:
        """Start a segment: if it is a new one, forget the last and fly."""
        if segment != self._segment:
            self._segment, self.answers, self._answered = segment, 0, False
            self.active, self.given_up, self.sure, self.reason = False, False, 1.0, ""
            self._anew, self._doubted = False, None

    def look_anew(self) -> None:
        """Forget the answers so far: the view is another one. It keeps hovering until one is sure."""
        self.answers, self._answered, self._doubted, self._anew = 0, False, None, True

    def doubt(self, reason: str) -> None:
        """Hover for another reason than the answers so far."""
        self.active, self.sure, self.reason = True, 0.0, reason
        self.look_anew()

    def give_up(self, reason: str = "") -> None:
        """Hover from now on, and decline."""
        self.active = self.given_up = True
        self.reason = reason or self.reason

    def _margin(self) -> float:
        """The hysteresis; none for several answers from another place, which are as good as the first ones were."""
        return 0.0 if self._anew and self.answers > self.rule.answers else self.rule.margin

    def update(self, answer: Answer) -> None:
        """Process an answer; those of other segments, and faults that say nothing about the scene, are ignored."""
        guidance = answer.guidance
        if answer.question.segment != self._segment or self.given_up:
            return
        self.reason = answer.message or self.reason
        if guidance is not None:
            value = guidance.confidence * (1.0 if guidance.present is None else guidance.present)
            self._answered = True
        elif answer.certainty is not None:
            value = answer.certainty
            self._answered = True
        elif answer.fault == "unsure" and not self._answered:
            value = 0.0
        else:
            return
        self.answers += 1
        mean = value if self.answers == 1 else self.sure + self.rule.newest * (value - self.sure)
        image = answer.question.image
        if not self.active:
            self.sure = mean
            self.active = self.answers >= self.rule.answers and mean < self.rule.below
            self._doubted = image if self.active else None
            return
        if self._doubted is not None and _difference(image, self._doubted) < self.rule.moved:
            mean = min(mean, self.sure)
        elif self._doubted is not None:
            self._doubted = image
        self.sure = mean
        # Only what names a gate ends the doubt: an undecided answer leaves the directive of before.
        sure = guidance is not None and mean >= min(1.0, self.rule.below + self._margin())
        self.active = not sure or self.answers < self.rule.answers


class HoldAwareReasoner:
    """An `AsyncReasoner` whose answers also go to a `Hold`."""

    def __init__(self, async_reasoner: AsyncReasoner, hold: Hold) -> None:
        self._async_reasoner, self._hold = async_reasoner, hold

    def idle(self, now: float) -> bool:
        """As `AsyncReasoner`."""
        return self._async_reasoner.idle(now)

    def ask(self, question: Question) -> None:
        """Ask; a question of a new segment resets the hold."""
        self._hold.begin(question.segment)
        self._async_reasoner.ask(question)

    def answer(self, now: float) -> Answer | None:
        """As `AsyncReasoner`."""
        answer = self._async_reasoner.answer(now)
        if answer is not None:
            self._hold.update(answer)
        return answer

    def close(self) -> None:
        """As `AsyncReasoner`."""
        self._async_reasoner.close()


def _difference(a: Image, b: Image) -> float:
    """The mean difference of two frames, coarsely."""
    return float(np.abs(a[::8, ::8].astype(np.int16) - b[::8, ::8]).mean())


class HeldDrone:
    """A drone that is sent zero velocity while a `Hold` is active."""

    def __init__(self, drone: Drone, hold: Hold) -> None:
        self._drone, self._hold = drone, hold

    def observe(self) -> Observation:
        """As `Drone`."""
        return self._drone.observe()

    def send(self, action: Action) -> Action:
        """Send the action, or zero velocity while the hold is active."""
        return self._drone.send(np.zeros_like(action) if self._hold.active else action)

    def close(self) -> None:
        """As `Drone`."""
        self._drone.close()
