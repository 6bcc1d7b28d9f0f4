"""Looks closer where the reasoner is unsure, and then lets it choose: the pilot's doubt, wherever it flies.

From the start of a stage the panels are small. Where the answers leave the pilot in doubt, the drone flies some way
forward and turns to either side, so that the reasoner reads every panel larger than before. Its answer at the last of
these places counts, that no gate matches included. Then the drone goes back some way, and turns to the gate that was
chosen, from where the policy flies on. A drone that makes no headway, because the gate that it flew to has left the
view, looks closer, too. The places are known by dead reckoning alone.

Only boxes of the panels tell how near they are. Where a reasoner gives none, as a language model that answers in words,
the drone stays where it is, and waits for one more answer.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Self

import numpy as np

from cognitivedrone.control.async_reasoner import Answer
from cognitivedrone.types import Action, FloatArray, Observation

_MOST = 2  # looks in a segment: the second only for a gate that is out of sight


@dataclass(frozen=True, slots=True)
class LookRule:
    """When to look closer, and from where."""

    below: float = 0.6
    """It looks closer below this mean certainty of the answers; 0 means never. The certainty of an answer is its
    confidence times the probability that the scene shows what is asked for, 0 to 1."""
    answers: int = 2
    """Answers needed before it looks closer; at each place it waits for one."""
    newest: float = 0.5
    """Weight of the newest answer in the mean."""
    places: tuple[tuple[float, float], ...] = ((2.5, 0.0), (2.5, 1.05), (2.5, -1.05))
    """The places, in order: how far ahead of where the stage began, m, and the heading there, rad to the left. From the
    middle of the published start box, panels are then 3.5 to 4.7 m away, not 6 to 6.4."""
    back: tuple[float, float] = (1.0, 0.5)
    """Where the policy takes over: so far ahead, m, and turned by so much to the side of the gate, rad."""
    largest_px: float = 70.0
    """It goes no nearer to a panel of this height in the image, which is one of the published size 2.7 m away."""
    speed_m_s: float = 1.2
    yaw_rate_rad_s: float = 1.0
    near: float = 0.15
    """A place is reached this near to it, m and rad."""
    patience_s: float = 4.0
    """Maximum time on the way to a place; and for the answer there, without which the look ends as if in vain."""
    headway_m: float = 0.8
    headway_s: float = 6.0
    """A drone that stays within this of a place for so long has lost its gate."""


class CloserLook:
    """The doubt of one flight. The control loop tells it what is seen and answered, and asks it for commands."""

    def __init__(self, rule: LookRule | None = None) -> None:
        self.rule = rule or LookRule()
        self.active = False
        """Whether it looks closer now: the drone then flies by `command`."""
        self.given_up = False
        """Whether the drone hovers, and declines, because nobody understands the instruction."""
        self.sure = 1.0
        """Mean certainty of the answers so far; 1 before the first."""
        self.reason = ""
        """The reasoner's newest reason for its doubt, as text."""
        self.ended = False
        """Whether the newest answer ended the look."""
        self._segment: int | None = None
        self._answers = 0
        self._looks = 0
        """In this segment."""
        self._pose = np.zeros(3)
        """x and y, m, and yaw, rad, since the stage began, in the heading frame of then."""
        self._time: float | None = None
        self._anchor, self._anchored = np.zeros(3), 0.0
        """Where it was last seen to make headway, and when."""
        self._left: list[tuple[float, float, float]] = []
        """The places that are left, x, y and yaw."""
        self._since, self._arrived, self._returns = 0.0, False, False
        self._sees = self._near = False
        """Whether the reasoner tells where the panels are, and whether one is as near as may be."""

    @classmethod
    def of(cls, option: Literal["yes", "no"]) -> Self:
        """The doubt of a pilot that looks closer, or never does."""
        return cls(LookRule() if option == "yes" else LookRule(below=0.0))

    @property
    def described(self) -> str:
        """What it does, for logs."""
        doubt = f"{self.sure:.0%} sure that the scene shows what is asked for"
        return f"looking closer, {self.reason or doubt}" if self.active else f"looked closer, {doubt}"

    @property
    def ahead(self) -> bool:
        """Whether it is on the way to the first place, or there, where what is in the way has not been seen yet."""
        return self.active and self._sees and not self._returns and len(self._left) == len(self.rule.places)

    @property
    def listens(self) -> bool:
        """Whether the reasoner is to be asked about the newest frame: not while the drone turns, or goes back."""
        return not self.active or self.ahead or (self._arrived and not self._returns)

    def begin_stage(self) -> None:
        """A stage begins here."""
        self._pose, self._anchor, self._anchored = np.zeros(3), np.zeros(3), self._time or 0.0

    def begin(self, segment: int) -> None:
        """If this is a new segment, forget the last."""
        if segment != self._segment:
            self._segment, self._answers, self._looks, self._left = segment, 0, 0, []
            self.active, self.given_up, self.sure, self.reason = False, False, 1.0, ""
            self._anchor, self._anchored = self._pose.copy(), self._time or 0.0

    def give_up(self, reason: str) -> None:
        """Hover from now on, and decline."""
        self.active, self.given_up, self.reason = False, True, reason

    def see(self, observation: Observation, *, waits: bool = False) -> None:
        """The newest observation, for dead reckoning; `waits`: the drone hovers because that is right."""
        step = 0.0 if self._time is None else observation.time - self._time
        self._time = now = observation.time
        cos, sin = np.cos(self._pose[2]), np.sin(self._pose[2])
        vx, vy = float(observation.velocity[0]), float(observation.velocity[1])
        self._pose += step * np.array([cos * vx - sin * vy, sin * vx + cos * vy, observation.yaw_rate])
        moved = float(np.hypot(*(self._pose - self._anchor)[:2])) > self.rule.headway_m
        if moved or waits or self.active or not self._answers:
            self._anchor, self._anchored = self._pose.copy(), now
        elif now - self._anchored > self.rule.headway_s and self.rule.below > 0 and self._looks < _MOST:
            self._look("the gate that it flew to is out of sight")

    def hear(self, answer: Answer) -> bool:
        """Take an answer; whether the control loop is to follow it: on the way, answers only ripen.

        After a look, an answer that names a gate out of sight is not followed, and the one before it goes on to count.
        Faults that say nothing about the scene are not counted.
        """
        guidance, self.ended = answer.guidance, False
        if self.given_up:
            return False
        self.reason = answer.message or self.reason
        if guidance is not None:
            value = guidance.confidence * (1.0 if guidance.present is None else guidance.present)
        elif answer.certainty is not None or answer.fault == "unsure":
            value = answer.certainty or 0.0
        else:
            return not self.active
        heights = [panel.box[2] for panel in answer.seen if panel.box is not None]
        self._sees, self._near = self._sees or bool(heights), max(heights, default=0.0) >= self.rule.largest_px
        if not self.active:
            self._answers += 1
            self.sure = value if self._answers == 1 else self.sure + self.rule.newest * (value - self.sure)
            if self._answers >= self.rule.answers and self.sure < self.rule.below and not self._looks:
                self._look()
            elif self._answers == 1 and self.rule.below > 0 and heights and _out_of_sight(answer):
                self._look("the gate is out of sight")
            # No policy flies to what it does not see: after a look it flies on to the gate before it.
            return not self.active and not (self._looks and _out_of_sight(answer))
        if not self._arrived or answer.question.time < self._since:
            return False
        self.sure = value
        self._next(0 if guidance is None or guidance.gate is None else 1 - guidance.gate)
        return self.ended

    def command(self) -> Action:
        """What leads to the next place, (4,), or holds the position there; only while it looks closer."""
        now, rule = self._time or 0.0, self.rule
        if now - self._since > rule.patience_s:
            if self._arrived and not self._returns:
                self._return(0)
            else:
                self._arrive(now)
        if not self.active:
            return np.zeros(4, np.float32)
        x, y, yaw = self._left[0]
        cos, sin = np.cos(self._pose[2]), np.sin(self._pose[2])
        dx, dy = x - self._pose[0], y - self._pose[1]
        if dx > 0 and self._near:
            dx = 0.0
        turn = (yaw - self._pose[2] + np.pi) % (2 * np.pi) - np.pi
        way = float(np.hypot(dx, dy))
        if not self._arrived and max(way, abs(turn)) < rule.near:
            self._arrive(now)
        return _towards(np.array([cos * dx + sin * dy, cos * dy - sin * dx]), way, turn, rule)

    def _look(self, reason: str = "") -> None:
        self.active, self._looks, self.reason = True, self._looks + 1, reason or self.reason
        ahead = [(x, 0.0, yaw) for x, yaw in self.rule.places]
        self._left, self._returns = ahead if self._sees else [self._here], False
        self._since, self._arrived = self._time or 0.0, False

    def _arrive(self, now: float) -> None:
        self._arrived, self._since = True, now
        if self._returns:
            self.active, self._anchor, self._anchored = False, self._pose.copy(), now

    def _next(self, side: int) -> None:
        """Leave for the next place; from the last one back, turned to the gate on a `side`: left 1, right -1."""
        self._left = self._left[1:]
        self._since, self._arrived = self._time or 0.0, False
        if not self._left:
            self.ended = True
            self._return(side)

    def _return(self, side: int) -> None:
        back, turn = self.rule.back
        self._left = [(back, 0.0, side * turn)] if self._sees else [self._here]
        self._since, self._arrived, self._returns = self._time or 0.0, False, True

    @property
    def _here(self) -> tuple[float, float, float]:
        x, y, yaw = self._pose.tolist()
        return x, y, yaw


def _out_of_sight(answer: Answer) -> bool:
    """Whether an answer names a gate that its frame does not show."""
    gate = None if answer.guidance is None else answer.guidance.gate
    return gate is not None and gate < len(answer.seen) and answer.seen[gate].box is None


def _towards(offset: FloatArray, way: float, turn: float, rule: LookRule) -> Action:
    """The command (4,) that leads by `offset` (2,), `way` m long, in the heading frame, and turns by `turn` rad."""
    speed = min(rule.speed_m_s, 1.2 * way) / max(way, 1e-6)
    rate = float(np.clip(2.0 * turn, -rule.yaw_rate_rad_s, rule.yaw_rate_rad_s))
    return np.array([*(speed * offset), 0.0, rate], np.float32)
