"""The simulator as a `Drone` with its own `Clock`, for the same control loop as a real drone."""

from __future__ import annotations

import time

import numpy as np

from cognitivedrone.envs.track_runner import TrackRunner
from cognitivedrone.frames import world_to_heading, yaw_of
from cognitivedrone.sim.dynamics import Flight
from cognitivedrone.types import ACTION_LIMITS, Action, Commands, DroneState, FloatArray, Observation

_KEEP_UP_S = 0.02  # between two steps of a world that keeps up with the wall clock


class SimulatedDrone:
    """The drone of a simulated world, flown through a track. Time stands still between calls of `sleep_until`: it is
    drone and clock in one.
    """

    def __init__(self, track_runner: TrackRunner, *, down: bool = False) -> None:
        """With `down`, observations hold the view of the camera that looks down, too."""
        self.track_runner = track_runner
        self.world = track_runner.world
        self._down = down

    def observe(self) -> Observation:
        """The current frame and state."""
        velocity, height, yaw_rate = proprioception(self.world.state())
        return Observation(
            image=self.world.frame(),
            instruction=self.track_runner.instruction,
            velocity=velocity,
            height=height,
            yaw_rate=yaw_rate,
            time=self.world.time(),
            down=self.world.frame(down=True) if self._down else None,
        )

    def send(self, action: Action) -> Action:
        """Set the velocity setpoint, clipped to `ACTION_LIMITS`."""
        sent = clip_action(action)
        self.world.command(sent)
        return sent

    def close(self) -> None:
        """Do nothing: there is nothing to land."""

    def now(self) -> float:
        """Simulated seconds since the flight began."""
        return self.world.time()

    def sleep_until(self, time_s: float) -> None:
        """Advance the world, holding the last command, until `time_s` or the end of the flight."""
        ticks = round((time_s - self.now()) / Flight.TICK_S)
        if ticks > 0 and not self.track_runner.finished:
            self.track_runner.update(self.world.advance(ticks))


class PacedDrone:
    """A simulated drone on the wall clock, drone and clock in one: it flies on during inference.

    The simulation catches up with the wall clock at every observation and command.
    """

    def __init__(self, drone: SimulatedDrone) -> None:
        self.drone = drone
        self._start = time.perf_counter()

    def observe(self) -> Observation:
        """The current frame and state."""
        self.drone.sleep_until(self.now())
        return self.drone.observe()

    def send(self, action: Action) -> Action:
        """Set the velocity setpoint from now on, clipped to `ACTION_LIMITS`."""
        self.drone.sleep_until(self.now())
        return self.drone.send(action)

    def close(self) -> None:
        """Do nothing: there is nothing to land."""

    def now(self) -> float:
        """Wall-clock seconds since creation."""
        return time.perf_counter() - self._start

    def sleep_until(self, time_s: float) -> None:
        """Wait, while the world keeps up: what it had to catch up at the end would be late."""
        while (wait := time_s - self.now()) > 0:
            time.sleep(min(wait, _KEEP_UP_S))
            self.drone.sleep_until(self.now())
        self.drone.sleep_until(self.now())


def proprioception(state: DroneState) -> tuple[FloatArray, float, float]:
    """Heading-frame velocity (3,) float32 in m/s, height in m, yaw rate in rad/s."""
    velocity = world_to_heading(state.velocity, yaw_of(state.quaternion)).astype(np.float32)
    return velocity, float(state.position[2]), float(state.body_rates[2])


def clip_action(action: Commands) -> Commands:
    """The action (..., 4) within `ACTION_LIMITS`, float32."""
    limit = np.array(ACTION_LIMITS, dtype=np.float32)
    return np.clip(np.asarray(action, dtype=np.float32), -limit, limit)
