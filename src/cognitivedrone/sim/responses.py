"""Step responses to velocity setpoints, and their standard metrics.

`ARDUCOPTER` holds the figures of a real ArduCopter 4.6.3 (stock code in SITL, Iris-like plant, GUIDED by body-frame
velocity setpoints at 10 Hz): the reference for this project's autopilot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cognitivedrone.frames import world_to_heading, yaw_of
from cognitivedrone.sim.airframe import Airframe
from cognitivedrone.sim.dynamics import BatchedFlight
from cognitivedrone.sim.simulator import Start
from cognitivedrone.types import DroneState, FloatArray

SETTLE_S = 3.0
"""Recording time after the command went back to zero, s."""


@dataclass(frozen=True, slots=True)
class StepResponse:
    """A command held for a while, then zero."""

    action: tuple[float, float, float, float]
    """Heading-frame vx, vy, vz in m/s and yaw rate in rad/s."""
    duration: float
    """s."""
    axis: int
    """The measured component of the action."""


@dataclass(frozen=True, slots=True)
class Figures:
    """The metrics of a step response."""

    t10: float
    """Time to 10 % of the command, s; likewise 50 % and 90 % for the next two."""
    t50: float
    t90: float
    overshoot: float
    """Peak beyond the command, relative to the command; negative if the command is not reached."""
    stop: float
    """Distance from the end of the command to the position `SETTLE_S` later, m (for yaw: rad)."""
    max_tilt: float
    """rad."""


@dataclass(frozen=True, slots=True)
class ResponseTrace:
    """A response, sampled at 100 Hz; the first sample is the state on arrival of the command."""

    time: FloatArray
    """(k,) s."""
    response: FloatArray
    """(k, 4): heading-frame velocity in m/s and body yaw rate in rad/s."""
    position: FloatArray
    """(k, 3) world, m."""
    heading: FloatArray
    """(k,) rad, unwrapped."""
    tilt: FloatArray
    """(k,) rad."""


STEPS: dict[str, StepResponse] = {
    "forward 1 m/s": StepResponse((1.0, 0.0, 0.0, 0.0), 4.0, 0),
    "forward 2 m/s": StepResponse((2.0, 0.0, 0.0, 0.0), 4.0, 0),
    "left 1 m/s": StepResponse((0.0, 1.0, 0.0, 0.0), 4.0, 1),
    "climb 0.5 m/s": StepResponse((0.0, 0.0, 0.5, 0.0), 3.0, 2),
    "yaw 0.5 rad/s": StepResponse((0.0, 0.0, 0.0, 0.5), 3.0, 3),
    "forward 1.5 m/s, yaw 0.4 rad/s": StepResponse((1.5, 0.0, 0.0, 0.4), 5.0, 0),
}

ARDUCOPTER: dict[str, Figures] = {
    "forward 1 m/s": Figures(0.33, 0.59, 1.10, 0.008, 0.705, math.radians(10.2)),
    "forward 2 m/s": Figures(0.40, 0.73, 1.25, 0.010, 1.688, math.radians(17.4)),
    "left 1 m/s": Figures(0.33, 0.59, 1.13, 0.006, 0.703, math.radians(10.1)),
    "climb 0.5 m/s": Figures(0.23, 0.44, 0.69, 0.104, 0.180, math.radians(0.1)),
    "yaw 0.5 rad/s": Figures(0.11, 0.18, 0.23, 0.455, 0.029, math.radians(0.1)),
    "forward 1.5 m/s, yaw 0.4 rad/s": Figures(0.37, 0.67, 1.32, -0.052, 1.143, math.radians(14.0)),
}


class Motion(Protocol):
    """A drone in motion, such as `vehicles.simulated.ExternalFlight`."""

    def begin(self, start: Start) -> None:
        """Hover at `start`."""

    def command(self, action: FloatArray) -> None:
        """Fly by a velocity (4,), heading frame, m/s and rad/s."""

    def advance(self, ticks: int) -> FloatArray:
        """Fly on by ticks of `BatchedFlight.TICK_S`; the way there, (samples, 3), world, m."""

    def state(self) -> DroneState:
        """The true state."""


class OwnMotion:
    """One drone under our own autopilot."""

    def __init__(self, airframe: Airframe) -> None:
        self._flight = BatchedFlight(1, airframe)

    def begin(self, start: Start) -> None:
        """Hover at `start`."""
        self._flight.reset(0, np.array(start.position), start.yaw, wind=np.array(start.wind))

    def command(self, action: FloatArray) -> None:
        """Fly by a velocity (4,)."""
        self._flight.command_one(0, action)

    def advance(self, ticks: int) -> FloatArray:
        """Fly on by ticks."""
        path: FloatArray = self._flight.advance(ticks)[0]
        return path

    def state(self) -> DroneState:
        """The true state."""
        return self._flight.state(0)


def fly(step: StepResponse, drone: Motion) -> ResponseTrace:
    """Fly a step from hover, with setpoints at 10 Hz."""
    drone.begin(Start((0.0, 0.0, 1.5)))
    count = round((step.duration + SETTLE_S) * 100)
    response, position, heading, tilt = np.empty((count + 1, 4)), np.empty((count + 1, 3)), np.empty(count + 1), []
    for k in range(count + 1):
        state = drone.state()
        heading[k] = yaw_of(state.quaternion)
        response[k, :3] = world_to_heading(state.velocity, heading[k])
        response[k, 3] = state.body_rates[2]
        position[k] = state.position
        _, x, y, _ = state.quaternion
        tilt.append(math.acos(min(1.0, 1 - 2 * (x * x + y * y))))
        if k % 10 == 0:
            drone.command(np.array(step.action if k < round(step.duration * 100) else (0.0,) * 4))
        drone.advance(BatchedFlight.SAMPLE_TICKS)
    return ResponseTrace(np.arange(count + 1) * 0.01, response, position, np.unwrap(heading), np.array(tilt))


def measure(step: StepResponse, trace: ResponseTrace) -> Figures:
    """The figures of a response."""
    wanted = step.action[step.axis]
    reached = trace.response[:, step.axis] / wanted
    on = trace.time < step.duration
    end = int(np.argmax(~on))

    def first(share: float) -> float:
        there = reached >= share
        return float(trace.time[np.argmax(there)]) if there.any() else math.inf

    if step.axis == 3:
        stop = abs(float(trace.heading[-1] - trace.heading[end]))
    else:
        stop = float(np.linalg.norm(trace.position[-1] - trace.position[end]))
    return Figures(
        first(0.1), first(0.5), first(0.9), float(reached[on].max()) - 1, stop, max_tilt=float(trace.tilt.max())
    )
