"""The plans of the commands `fly` and `sim`; the docstrings of the fields are their help. Imports nothing heavy."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from cognitivedrone.errors import LinkError
from cognitivedrone.plan import Options, PilotSpec, SafetySpec, Scenario, VehicleSpec
from cognitivedrone.printable import unprintable

AUTO = "auto"
"""Name that stands for whichever suite shows what the instruction asks for."""


@dataclass(frozen=True, slots=True)
class FlyPlan(Options):
    """Fly a drone by an instruction."""

    instruction: tyro.conf.Positional[str] = ""
    """What to do; in a simulated scene, the scene's own instruction where it is left out."""
    scenario: Scenario = Scenario(suite=AUTO)
    pilot: PilotSpec = PilotSpec(reasoner="small")
    vehicle: VehicleSpec = VehicleSpec()
    safety: SafetySpec = SafetySpec()
    episode: int | None = None
    """Which task of the suite, from 0; left out the first, or for an instruction of your own the one that fits it
    best. The suite auto is open-v1:smoke, or for an instruction of your own whichever shows what it asks for."""
    hold_below: float = 0.5
    """Hover while the reasoner is less sure than this, 0 to 1, that what is asked for is there; 0 never hovers."""
    gates: int = 1
    """With mavlink: land after so many gates, by the pilot's own estimate; 0 flies on until the time limit."""
    time_limit: float = 60.0
    """Seconds of flight, then it lands."""
    out: Path | None = None
    """New folder for log and film; flights/DATE-TIME by default."""
    record: Literal["mcap"] | None = None
    """mcap: write a ROS 2 bag beside log and film, for Foxglove and ros2 bag; needs the extra ros."""
    view: bool = True
    """Draw the live view, where there is a terminal; a line for each event otherwise."""

    def __post_init__(self) -> None:
        if not 0 < self.time_limit < float("inf"):
            raise LinkError(f"--time-limit is {self.time_limit}; it is a number of seconds above 0")
        if self.gates < 0:
            raise LinkError(f"--gates is {self.gates}; give 1 or more, or 0 to fly on until the time limit")
        if not 0 <= self.hold_below <= 1:
            raise LinkError(f"--hold-below is {self.hold_below}; it is a confidence from 0 to 1")
        if problem := unprintable(self.instruction):
            raise LinkError(f"the instruction holds {problem}; say it without")
        real, camera = self.vehicle.kind == "mavlink", self.safety.camera
        if real and not self.instruction.strip():
            raise LinkError('say what to do, such as: cognitivedrone fly --link ... "Fly through the red gate"')
        if real and not camera:
            raise LinkError(
                "a vehicle needs --camera: /dev/videoN, an rtsp:// or http:// URL, a video file, a folder, gazebo:TOPIC"
            )
        if camera and not real:
            raise LinkError(f"--link {self.vehicle.link} has its own camera; leave --camera out")


@dataclass(frozen=True, slots=True)
class SimPlan(Options):
    """Serve the simulator as a vehicle."""

    mavlink: bool = False
    """As a MAVLink vehicle that answers like an ArduCopter; there is no other way yet, so it must be given."""
    links: tuple[str, ...] = ("udpout:127.0.0.1:14550", "tcpin:127.0.0.1:5760")
    """How it is reached: udpout:HOST:PORT speaks first, udpin and tcpin wait. There is no authentication."""
    camera_port: int | None = None
    """Serve the first-person view as motion JPEG at this port of 127.0.0.1; 0 takes any free one."""
    camera_hz: float = 20.0
    """Frames a second of the wall clock."""
    scenario: Scenario = Scenario(suite="open-v1:smoke")
    episode: int = 0
    """Which of its tasks, from 0."""
    speed: float = 1.0
    """How many times as fast as the wall clock, up to 100."""
