"""Checks of a vehicle that flies in Gazebo: take-off, hover, velocity, yaw rate, estimate, lock-step and landing.

They fly by `GazeboFlight`, as the benchmark does. Times are Gazebo's.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Final, Protocol, TypeVar

import numpy as np

from cognitivedrone.errors import LinkError
from cognitivedrone.frames import wrap_angle, yaw_of
from cognitivedrone.sim.drone_world import TICKS_PER_CONTROL, Start
from cognitivedrone.types import CONTROL_HZ, DroneState, FloatArray
from cognitivedrone.vehicles.gazebo.flight import GazeboFlight, take_off
from cognitivedrone.vehicles.gazebo.selftest.checks import Finding, GazeboScene
from cognitivedrone.vehicles.gazebo.worlds.vehicle import ground_clearance
from cognitivedrone.vehicles.mavlink.client.drone import MavlinkDrone

T = TypeVar("T")

HEIGHT_M: Final = 1.0
"""Height of the checks."""
HOVER_S, HOVER_M, HOVER_RAD = 5.0, 0.15, math.radians(5)
"""Duration of a hover, and how far the vehicle may move and turn in it."""
FORWARD_M_S, FORWARD_S, FORWARD_OFF = 1.0, 3.0, 0.1
"""Velocity setpoint, its duration, and the relative tolerance of the speed in the last second."""
HALF_S, HALF_OFF_S = 0.59, 0.15
"""Time to half the velocity as recorded from ArduCopter (docs/vehicles.md), and its tolerance, s."""
YAW_RAD_S, YAW_S, YAW_OFF = 0.5, 3.0, 0.1
"""Yaw rate setpoint, as above."""
ESTIMATE_M: Final = 0.15
"""Between the autopilot's estimate of the way it flew and the true one, m."""
STOPPED_S: Final = 2.0
"""For how long of the wall clock the autopilot is stopped."""
STOPPED_PASSES_S: Final = 0.1
"""Gazebo's time that may pass meanwhile."""
LANDED_M: Final = 0.05


class RunningAutopilot(AbstractContextManager["RunningAutopilot"], Protocol):
    """A running autopilot."""

    def connect(self, make: Callable[[str], T]) -> T:
        """What `make(url)` makes, once it listens."""
        ...

    def pause(self) -> None:
        """Stop its process."""
        ...

    def resume(self) -> None:
        """Let it go on."""
        ...


class Airborne:
    """The vehicle of a running world, with its autopilot. Use it as a context manager: it lands at the end."""

    def __init__(self, scene: GazeboScene, autopilot: RunningAutopilot) -> None:
        self.autopilot = autopilot
        self.drone: MavlinkDrone | None = None
        self._scene = scene
        self._path = scene.world.path()
        camera = scene.world.camera()
        self.flight = GazeboFlight(scene.world, self._path, camera, self._connect)
        self._close = (self.flight.close, camera.close, self._path.close)
        self.lost = False

    def __enter__(self) -> Airborne:
        return self

    def __exit__(self, *exception: object) -> None:
        for close in self._close:
            close()

    def fly(self, seconds: float, action: tuple[float, float, float, float]) -> list[DroneState]:
        """Hold a command; returns the true states at the end of every control step. Raises `LinkError` if lost."""
        states = []
        for _ in range(round(seconds * CONTROL_HZ)):
            self.flight.command(np.array(action))
            self.flight.advance(TICKS_PER_CONTROL)
            if self.flight.diverged:
                self.lost = True
                raise LinkError(f"the vehicle was lost: {self.flight.trouble}")
            states.append(self.flight.state())
        return states

    def truth(self) -> tuple[float, FloatArray]:
        """Gazebo's time, s, and the vehicle's true position (3,) there, m."""
        sample = self._path.newest()
        return sample.time, sample.state.position

    def _connect(self) -> MavlinkDrone:
        self.drone = self.autopilot.connect(lambda url: take_off(url, self._scene.world))
        return self.drone


def rises(flight: Airborne) -> Finding:
    """It arms, takes off, and comes to a hover at the height asked for."""
    began, ground = flight.truth()
    flight.lost = True
    flight.flight.begin(Start((0.0, 0.0, HEIGHT_M)))
    flight.lost = False
    now, position = flight.truth()
    off = abs(float(position[2]) - HEIGHT_M)
    figure = f"hovers {position[2]:.2f} m up, {now - began:.0f} s after its start"
    drifted = float(np.linalg.norm(position[:2] - ground[:2]))
    problem = f"{off:.2f} m from the height asked for" if off > HOVER_M else ""
    return Finding(figure, problem, {"height_off_m": off, "seconds": now - began, "drift_m": drifted})


def hovers(flight: Airborne) -> Finding:
    """It keeps its place and heading."""
    states = flight.fly(HOVER_S, (0.0, 0.0, 0.0, 0.0))
    moved = float(np.linalg.norm(states[-1].position - states[0].position))
    turned = _turned(states)
    figure = f"moves {moved:.2f} m, turns {math.degrees(turned):.1f} deg in {HOVER_S:g} s"
    problem = "it drifts" if moved > HOVER_M or abs(turned) > HOVER_RAD else ""
    return Finding(figure, problem, {"moved_m": moved, "turned_rad": turned})


def flies_forward(flight: Airborne) -> Finding:
    """It answers a velocity as ArduCopter did where our simulator's responses come from."""
    states = flight.fly(FORWARD_S, (FORWARD_M_S, 0.0, 0.0, 0.0))
    heading = np.array([math.cos(yaw_of(states[0].quaternion)), math.sin(yaw_of(states[0].quaternion))])
    speeds = np.array([float(state.velocity[:2] @ heading) for state in states])
    flight.fly(2.0, (0.0, 0.0, 0.0, 0.0))
    speed = float(speeds[-CONTROL_HZ:].mean())
    reached = int(np.argmax(speeds >= FORWARD_M_S / 2))
    half = (reached + 1) / CONTROL_HZ if speeds.max() >= FORWARD_M_S / 2 else math.inf
    figure = f"{speed:.2f} of {FORWARD_M_S:g} m/s, half of it after {half:.1f} s"
    problem = ""
    if abs(speed - FORWARD_M_S) > FORWARD_OFF * FORWARD_M_S:
        problem = f"it flies {speed:.2f} m/s"
    elif abs(half - HALF_S) > HALF_OFF_S + 1 / CONTROL_HZ:
        problem = f"half the speed after {half:.2f} s, not {HALF_S:g}"
    return Finding(figure, problem, {"speed_m_s": speed, "half_s": half})


def turns(flight: Airborne) -> Finding:
    """It answers a yaw rate."""
    states = flight.fly(YAW_S, (0.0, 0.0, 0.0, YAW_RAD_S))
    last = states[-CONTROL_HZ - 1 :]
    rate = _turned(last) / ((len(last) - 1) / CONTROL_HZ)
    flight.fly(1.0, (0.0, 0.0, 0.0, 0.0))
    problem = f"it turns by {rate:.2f} rad/s" if abs(rate - YAW_RAD_S) > YAW_OFF * YAW_RAD_S else ""
    return Finding(f"{rate:.2f} of {YAW_RAD_S:g} rad/s", problem, {"rate_rad_s": rate})


def knows_its_place(flight: Airborne) -> Finding:
    """The autopilot's estimate of a short way agrees with Gazebo's truth."""
    drone = flight.drone
    if drone is None:
        raise LinkError("there is no vehicle")
    flight.fly(1.0, (0.0, 0.0, 0.0, 0.0))
    offset = flight.truth()[1] - drone.telemetry.position
    flight.fly(2.0, (-FORWARD_M_S, 0.0, 0.0, 0.0))
    flight.fly(2.0, (0.0, 0.0, 0.0, 0.0))
    off = float(np.linalg.norm(flight.truth()[1] - drone.telemetry.position - offset))
    problem = f"the estimate is {off:.2f} m off" if off > ESTIMATE_M else ""
    return Finding(f"estimate and truth differ by {off:.3f} m after 1.5 m", problem, {"off_m": off})


def waits(flight: Airborne) -> Finding:
    """Gazebo's time stands still while the autopilot is stopped, and the vehicle hovers on afterwards."""
    flight.autopilot.pause()
    try:
        time.sleep(STOPPED_S / 4)  # what is under way is carried out
        began, _ = flight.truth()
        time.sleep(STOPPED_S)
        passed = flight.truth()[0] - began
    finally:
        flight.autopilot.resume()
    states = flight.fly(2.0, (0.0, 0.0, 0.0, 0.0))
    moved = float(np.linalg.norm(states[-1].position - states[0].position))
    figure = f"{passed:.2f} s pass while ArduPilot is stopped for {STOPPED_S:g} s; then it moves {moved:.2f} m"
    problem = "Gazebo does not wait for the autopilot" if passed > STOPPED_PASSES_S else ""
    problem = problem or ("it drifts afterwards" if moved > 2 * HOVER_M else "")
    return Finding(figure, problem, {"passed_s": passed, "moved_m": moved})


def lands(flight: Airborne) -> Finding:
    """It lands, and its motors stop."""
    drone = flight.drone
    if drone is None:
        raise LinkError("there is no vehicle")
    began, _ = flight.truth()
    flight.lost = True
    drone.land()
    now, position = flight.truth()
    above = float(position[2]) - ground_clearance()
    figure = f"on the ground after {now - began:.0f} s, motors stopped"
    problem = f"its motors stopped {above:.2f} m above the ground" if abs(above) > LANDED_M else ""
    return Finding(figure, problem, {"seconds": now - began, "above_m": above})


FLIGHT_CHECKS: Final[tuple[tuple[str, Callable[[Airborne], Finding]], ...]] = (
    ("take-off", rises),
    ("hover", hovers),
    ("velocity", flies_forward),
    ("yaw rate", turns),
    ("estimate", knows_its_place),
    ("lock-step", waits),
    ("landing", lands),
)
"""In order."""


def _turned(states: list[DroneState]) -> float:
    """Change of heading, rad."""
    return float(wrap_angle(yaw_of(states[-1].quaternion) - yaw_of(states[0].quaternion)))
