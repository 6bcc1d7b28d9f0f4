"""The limits and the geofence of `control.safety` as a wrapper of any drone, to measure what they cost in score.

On a vehicle the guard holds the link, and has more rules; those ask how everything around a drone is doing, which in a
simulation is always well. Here are the two that change a command, with the numbers that a vehicle is flown by.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from cognitivedrone.control.safety import SafetyConfig, fence_in, limit
from cognitivedrone.frames import yaw_of
from cognitivedrone.interfaces import Clock, Drone
from cognitivedrone.types import Action, DroneState, GuardReport, Observation


class GuardedDrone:
    """A drone that is only sent what limits and fence allow; `report` counts what they changed.

    `state` returns its true state; the fence stands around where it was when this was made, its floor and ceiling
    above the ground. `clock` is the one that the drone is flown by. `landing` says whether a pad is to be landed on
    now: the fence then has no floor.
    """

    def __init__(
        self,
        drone: Drone,
        clock: Clock,
        state: Callable[[], DroneState],
        config: SafetyConfig | None = None,
        *,
        landing: Callable[[], bool] = lambda: False,
    ) -> None:
        self.report = GuardReport()
        self._drone, self._clock, self._state = drone, clock, state
        self._config = config or SafetyConfig()
        self._landing = landing
        self._to_the_ground = replace(self._config, fence=replace(self._config.fence, floor_m=-math.inf))
        self._home = state().position * np.array([1.0, 1.0, 0.0])
        self._sent = np.zeros(4, dtype=np.float32)
        self._sent_s = -np.inf

    def observe(self) -> Observation:
        """As the drone."""
        return self._drone.observe()

    def send(self, action: Action) -> Action:
        """Send the action as it may be sent."""
        config = self._to_the_ground if self._landing() else self._config
        state, now = self._state(), self._clock.now()
        slower = np.clip(action, *(sign * np.array(config.limits.speed, dtype=np.float32) for sign in (-1, 1)))
        smoother = limit(action, self._sent, now - self._sent_s, config.limits)
        inside = fence_in(
            smoother, state.position - self._home, state.velocity, float(yaw_of(state.quaternion)), config
        )
        self._count(action, slower, smoother, inside)
        self._sent, self._sent_s = inside, now
        return self._drone.send(inside)

    def close(self) -> None:
        """As the drone."""
        self._drone.close()

    def _count(self, action: Action, slower: Action, smoother: Action, inside: Action) -> None:
        speed, slew, fence = (
            not np.array_equal(a, b) for a, b in ((action, slower), (slower, smoother), (smoother, inside))
        )
        now = self.report
        self.report = replace(
            now,
            touched=now.touched + (speed or slew or fence),
            speed=now.speed + speed,
            slew=now.slew + slew,
            fence=now.fence + fence,
        )
