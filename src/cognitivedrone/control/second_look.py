"""Looks again from a better place while the drone hovers in doubt, and in the end declines. For simulated vehicles.

In doubt the drone goes back to where the stage began, from where all gates are in view, and then some way forward, from
where panels are larger. At each place the reasoner's answers are averaged anew. If none is sure enough, the pilot gives
up. It looks again, too, where it makes no headway, because the gate that it flew to has left the view. The places are
known by dead reckoning alone: the way back is the way that it came.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cognitivedrone.control.hold import Hold
from cognitivedrone.interfaces import Drone
from cognitivedrone.types import Action, FloatArray, Observation


@dataclass(frozen=True, slots=True)
class LookRule:
    """Where to look from, and for how long."""

    forward_m: tuple[float, ...] = (0.0, 1.5, 2.5)
    """The places: so far ahead of where the stage began."""
    height_m: float = 1.0
    near_m: float = 0.2
    """A place is reached at this distance from it."""
    speed_m_s: float = 0.8
    answers: int = 4
    """At each place."""
    patience_s: float = 6.0
    """Maximum time for a place."""
    headway_m: float = 0.8
    headway_s: float = 6.0
    """A drone that stays within this of a place for so long has lost its gate: it turns, or waits for it."""


class SecondLook:
    """A drone that looks again while a `Hold` is active."""

    def __init__(self, drone: Drone, hold: Hold, rule: LookRule | None = None) -> None:
        self.rule = rule or LookRule()
        self._drone, self._hold = drone, hold
        self._pose = np.zeros(3)
        """x and y, m, and yaw, rad, since the stage began, in the heading frame of then."""
        self._height = 0.0
        self._time: float | None = None
        self._anchor, self._anchored = np.zeros(3), 0.0
        """Where it was last seen to make headway, and when."""
        self._left: list[float] | None = None
        self._since = 0.0
        self._arrived = False

    def begin_stage(self) -> None:
        """The stage begins here."""
        self._pose, self._left, self._anchor = np.zeros(3), None, np.zeros(3)

    def observe(self) -> Observation:
        """As `Drone`."""
        seen = self._drone.observe()
        step = 0.0 if self._time is None else seen.time - self._time
        self._time, self._height = seen.time, seen.height
        cos, sin = np.cos(self._pose[2]), np.sin(self._pose[2])
        vx, vy = float(seen.velocity[0]), float(seen.velocity[1])
        self._pose += step * np.array([cos * vx - sin * vy, sin * vx + cos * vy, seen.yaw_rate])
        return seen

    def send(self, action: Action) -> Action:
        """Send the action, or, in doubt, what leads to the next place."""
        now = self._time or 0.0
        if self._hold.active or float(np.hypot(*(self._pose - self._anchor)[:2])) > self.rule.headway_m:
            self._anchor, self._anchored = self._pose.copy(), now
        elif now - self._anchored > self.rule.headway_s:
            self._hold.doubt("the gate that it flew to is out of sight")
        if not self._hold.active:
            if self._arrived and self._left:  # sure for now: the next doubt looks from the next place
                self._left.pop(0)
            self._start()
            return self._drone.send(action)
        return self._drone.send(self._command())

    def close(self) -> None:
        """As `Drone`."""
        self._drone.close()

    def _command(self) -> Action:
        if self._left is None:
            ahead = float(np.hypot(*self._pose[:2]))
            # Where it has hardly moved, the first place is where it is.
            self._left = [x for x in self.rule.forward_m if x > 0 or ahead > 3 * self.rule.near_m]
            self._start()
        now = self._time or 0.0
        if self._hold.given_up or not self._left:
            self._hold.give_up()
            return np.zeros(4, np.float32)
        there = self._offset()
        if not self._arrived and (
            np.hypot(*there[:2]) < self.rule.near_m or now - self._since > self.rule.patience_s / 2
        ):
            self._arrived = True
            self._hold.look_anew()
        settled = self._hold.answers >= self.rule.answers
        if self._arrived and (settled or now - self._since > self.rule.patience_s):
            self._left.pop(0)
            self._start()
        return self._towards(there) if not self._arrived else np.zeros(4, np.float32)

    def _start(self) -> None:
        self._since, self._arrived = self._time or 0.0, False

    def _offset(self) -> FloatArray:
        """x, y, z in the heading frame of now, m, and yaw, rad, to the next place."""
        dx, dy = (self._left or [0.0])[0] - self._pose[0], -self._pose[1]
        cos, sin = np.cos(self._pose[2]), np.sin(self._pose[2])
        yaw = (-self._pose[2] + np.pi) % (2 * np.pi) - np.pi
        return np.array([cos * dx + sin * dy, cos * dy - sin * dx, self.rule.height_m - self._height, yaw])

    def _towards(self, offset: FloatArray) -> Action:
        way = float(np.hypot(*offset[:2]))
        speed = min(self.rule.speed_m_s, 1.2 * way) / max(way, 1e-6)
        return np.array(
            [*(speed * offset[:2]), np.clip(offset[2], -0.4, 0.4), np.clip(1.5 * offset[3], -0.8, 0.8)], np.float32
        )
