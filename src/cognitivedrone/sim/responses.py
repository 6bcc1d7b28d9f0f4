"""Step responses to velocity setpoints, and their standard metrics.

`ARDUCOPTER` holds the figures of a real ArduCopter 4.6.3 (stock code in SITL, Iris-like plant, GUIDED by body-frame
velocity setpoints at 10 Hz): the reference for this project's autopilot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cognitivedrone.frames import world_to_heading
from cognitivedrone.sim.airframe import Airframe
from cognitivedrone.sim.dynamics import Flight
from cognitivedrone.sim.flying import Flying
from cognitivedrone.types import FloatArray

SETTLE_S = 3.0
"""Recording time after the command went back to zero, s."""


@dataclass(frozen=True, slots=True)
class Step:
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
class Trace:
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


STEPS: dict[str, Step] = {
    "forward 1 m/s": Step((1.0, 0.0, 0.0, 0.0), 4.0, 0),
    "forward 2 m/s": Step((2.0, 0.0, 0.0, 0.0), 4.0, 0),
    "left 1 m/s": Step((0.0, 1.0, 0.0, 0.0), 4.0, 1),
    "climb 0.5 m/s": Step((0.0, 0.0, 0.5, 0.0), 3.0, 2),
    "yaw 0.5 rad/s": Step((0.0, 0.0, 0.0, 0.5), 3.0, 3),
    "forward 1.5 m/s, yaw 0.4 rad/s": Step((1.5, 0.0, 0.0, 0.4), 5.0, 0),
}

ARDUCOPTER: dict[str, Figures] = {
    "forward 1 m/s": Figures(0.33, 0.59, 1.10, 0.008, 0.705, math.radians(10.2)),
    "forward 2 m/s": Figures(0.40, 0.73, 1.25, 0.010, 1.688, math.radians(17.4)),
    "left 1 m/s": Figures(0.33, 0.59, 1.13, 0.006, 0.703, math.radians(10.1)),
    "climb 0.5 m/s": Figures(0.23, 0.44, 0.69, 0.104, 0.180, math.radians(0.1)),
    "yaw 0.5 rad/s": Figures(0.11, 0.18, 0.23, 0.455, 0.029, math.radians(0.1)),
    "forward 1.5 m/s, yaw 0.4 rad/s": Figures(0.37, 0.67, 1.32, -0.052, 1.143, math.radians(14.0)),
}


def fly(step: Step, airframe: Airframe, flight: Flying | None = None) -> Trace:
    """Fly a step from hover, with setpoints at 10 Hz; on our own autopilot unless another `flight` is given."""
    flight = flight or Flight(1, airframe)
    flight.reset(0, np.array([0.0, 0.0, 1.5]))
    count = round((step.duration + SETTLE_S) * 100)
    response, position, heading, tilt = np.empty((count + 1, 4)), np.empty((count + 1, 3)), np.empty(count + 1), []
    for k in range(count + 1):
        response[k, :3] = world_to_heading(flight.velocity[0], flight.yaw[0])
        response[k, 3] = flight.body_rates[0, 2]
        position[k], heading[k] = flight.position[0], flight.yaw[0]
        _, x, y, _ = flight.quaternion[0]
        tilt.append(math.acos(min(1.0, 1 - 2 * (x * x + y * y))))
        if k % 10 == 0:
            flight.command(np.array([step.action if k < round(step.duration * 100) else (0.0,) * 4]))
        flight.advance(Flight.SAMPLE_TICKS)
    return Trace(np.arange(count + 1) * 0.01, response, position, np.unwrap(heading), np.array(tilt))


def measure(step: Step, trace: Trace) -> Figures:
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
