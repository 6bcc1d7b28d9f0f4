"""The plans of the commands `fly` and `sim`; the docstrings of the fields are their help. Imports nothing heavy."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from cognitivedrone.errors import LinkError
from cognitivedrone.plan import Options, PilotSpec, SafetySpec, Scenario, VehicleSpec
from cognitivedrone.ranges import Amount, Index, Port, Range
from cognitivedrone.system import CAMERA
from cognitivedrone.text.printable import unprintable

TimeLimit = Annotated[float, Range(0.1, unit="s")]
AUTO = "auto"
"""Suite name: choose a suite that shows what the instruction asks for."""
SHOWN = Scenario(suite=AUTO, appearance="photo")
"""What is flown for people to watch: in photographed places. The benchmark stays plain, as published."""


@dataclass(frozen=True, slots=True)
class FlyPlan(Options):
    """Fly a drone by an instruction."""

    instruction: tyro.conf.Positional[str] = ""
    """What to do; in a simulated scene, the scene's own instruction by default."""
    scenario: Scenario = SHOWN
    pilot: PilotSpec = PilotSpec(reasoner="small")
    vehicle: VehicleSpec = VehicleSpec()
    safety: SafetySpec = SafetySpec()
    episode: Index | None = None
    """Task of the suite, from 0; by default the first, or, for an instruction of your own, the one that fits it best.
    The suite auto means open-v1:smoke, by default its task 27, or, for an instruction of your own, a suite that shows
    what it asks for."""
    gates: Amount = 1
    """With mavlink: land after this many gates, by the pilot's own estimate; 0 flies on until the time limit."""
    time_limit: TimeLimit = 60.0
    """Land after this many seconds of flight."""
    out: Path | None = None
    """New folder for log, film and page; flights/DATE-TIME by default."""
    record: Literal["mcap"] | None = None
    """mcap: also write a ROS 2 bag, for Foxglove and ros2 bag; needs the extra ros."""
    film: bool = True
    """Make flight.mp4 and flight.html after the flight."""
    page: bool = False
    """Show the flight on a page of this machine's browser, too: what the pilot sees and thinks, and a box to speak."""
    page_port: Port = 8090
    """Port of the page; 0 picks a free one."""
    view: bool = True
    """Draw the live view if there is a terminal; otherwise print a line for each event."""

    def check(self) -> None:
        """Raise `LinkError` for an instruction, vehicle and camera that do not go together."""
        if problem := unprintable(self.instruction):
            raise LinkError(f"the instruction contains {problem}; leave that out")
        real, camera = self.vehicle.kind == "mavlink", self.safety.camera
        if real and not self.instruction.strip():
            raise LinkError('give an instruction, such as: cognitivedrone fly --link ... "Fly through the red gate"')
        if real and not camera:
            raise LinkError(
                f"a vehicle needs --camera: {CAMERA}, an rtsp:// or http:// URL, a video file, a folder, gazebo:TOPIC"
            )
        if camera and not real:
            raise LinkError(f"--link {self.vehicle.link} has its own camera; leave --camera out")
        drawn = self.vehicle.kind in ("sim", "sitl")  # others have surroundings of their own
        if not drawn and self.scenario.appearance == "photo" and not self.scenario.place:
            object.__setattr__(self, "scenario", self.scenario.changed(appearance="plain"))


@dataclass(frozen=True, slots=True)
class SimPlan(Options):
    """Serve the simulator as a vehicle."""

    mavlink: bool = False
    """Serve a MAVLink vehicle that behaves like an ArduCopter. Required: there is no other protocol yet."""
    links: tuple[str, ...] = ("udpout:127.0.0.1:14550", "tcpin:127.0.0.1:5760")
    """Endpoints: udpout:HOST:PORT sends first; udpin and tcpin listen. There is no authentication."""
    camera_port: Port | None = None
    """Serve the first-person view as motion JPEG at this port of 127.0.0.1; 0 picks a free one."""
    camera_hz: Annotated[float, Range(0.1, 60, "Hz")] = 20.0
    """Camera frame rate, Hz of wall time."""
    scenario: Scenario = Scenario(suite="open-v1:smoke")
    episode: Index = 0
    """Task of the suite, from 0."""
    speed: float = 1.0
    """Simulation speed relative to the wall clock, up to 100."""
