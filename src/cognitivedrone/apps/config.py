"""The options of the commands `fly` and `sim`; the docstrings of the fields are their help. Imports nothing heavy."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from cognitivedrone.errors import LinkError, did_you_mean
from cognitivedrone.printable import unprintable

LINKS = ("sim", "sitl", "mavlink")
LOOPBACK = ("127.", "localhost:", "::1:", "[::1]:")
_MAVLINK = "mavlink:"


@dataclass(frozen=True, slots=True)
class FlyConfig:
    """Fly a drone by an instruction."""

    instruction: tyro.conf.Positional[str] = ""
    """What to do; in a simulated scene, the scene's own instruction where it is left out."""
    link: str = "sim"
    """sim: our simulator, in real time. sitl: ArduCopter on our physics. mavlink:URL, such as
    mavlink:udp:127.0.0.1:14550, mavlink:tcp:HOST:PORT or mavlink:serial:DEVICE:BAUD: a vehicle."""
    policy: str = "small"
    """Name of a policy, small:MODEL.onnx for a model file, or your own as module:attribute."""
    reasoner: str = "small"
    """Name of a reasoner, none to fly by the instruction as it is, or your own as module:attribute."""
    camera: str = ""
    """With mavlink: /dev/videoN, an rtsp:// or http:// URL, a video file, a folder of images, or gazebo:TOPIC of a
    running Gazebo, such as gazebo:/cognitivedrone/camera."""
    suite: str | None = None
    """With sim and sitl: the suite that the scene is from; open-v1:smoke, or for an instruction of your own whichever
    shows what it asks for."""
    tasks: Path | None = None
    """Task file, or folder of them, instead of a suite."""
    labels: Path | None = None
    """Folder of label images that come before the shipped ones."""
    episode: int | None = None
    """Which of its tasks, from 0; left out the first, or for an instruction of your own the one that fits it best."""
    seed: int = 0
    """Draws start and look of the scene, and which of several that fit."""
    hold_below: float = 0.5
    """Hover while the reasoner is less sure than this, 0 to 1, that what is asked for is there; 0 never hovers."""
    time_limit: float = 60.0
    """Seconds of flight, then it lands."""
    out: Path | None = None
    """New folder for log and film; flights/DATE-TIME by default."""
    record: Literal["mcap"] | None = None
    """mcap: write a ROS 2 bag beside log and film, for Foxglove and ros2 bag; needs the extra ros."""
    view: bool = True
    """Draw the live view, where there is a terminal; a line for each event otherwise."""
    takeoff_height: float = 1.0
    """Metres above where the vehicle stands."""
    fence_radius: float = 30.0
    """Metres around the place of take-off that are not left."""
    ceiling: float = 10.0
    """Metres above the place of take-off that are not exceeded."""
    policy_patience: float = 0.2
    """Seconds without a command until the vehicle is stopped; a policy that thinks longer needs more."""
    set_parameters: bool = False
    """Consent to set GUID_TIMEOUT and FS_GCS_ENABLE of the vehicle where they are not fit to fly."""
    clock: Literal["wall", "vehicle"] = "wall"
    """With mavlink: fly by the vehicle's own time, for simulators that run faster or slower than real time."""
    sitl: Path | None = None
    """With sitl: the ArduCopter binary; the environment variable ARDUCOPTER by default."""
    sitl_defaults: tuple[Path, ...] = ()
    """With sitl: parameter files that are loaded before ours."""
    sitl_instance: int = 0
    """With sitl: shifts its ports, so that several fly side by side."""
    i_understand_this_flies_a_real_drone: bool = False
    """Needed for everything that is not known to be simulated."""

    def __post_init__(self) -> None:
        kind = self.link.partition(":")[0]
        if kind not in LINKS or (kind == "mavlink") != self.link.startswith(_MAVLINK):
            raise LinkError(
                f"cannot read --link {self.link!r}: expected sim, sitl or mavlink:URL such as"
                f" mavlink:udp:127.0.0.1:14550; {did_you_mean(kind, LINKS)}"
            )
        if kind != "mavlink" and self.link != kind:
            raise LinkError(f"--link {kind} takes nothing behind a colon, {self.link!r} was given")
        if not 0 < self.time_limit < float("inf"):
            raise LinkError(f"--time-limit is {self.time_limit}; it is a number of seconds above 0")
        if not 0 < self.takeoff_height < self.ceiling:
            raise LinkError(
                f"--takeoff-height {self.takeoff_height} must be above 0 and below --ceiling {self.ceiling}"
            )
        if not self.fence_radius > 0:
            raise LinkError(f"--fence-radius is {self.fence_radius}; it is a number of metres above 0")
        if not 0 <= self.hold_below <= 1:
            raise LinkError(f"--hold-below is {self.hold_below}; it is a confidence from 0 to 1")
        if not 0.1 <= self.policy_patience <= 5:
            raise LinkError(f"--policy-patience is {self.policy_patience}; give 0.1 to 5 seconds")
        if problem := unprintable(self.instruction):
            raise LinkError(f"the instruction holds {problem}; say it without")
        if self.is_mavlink and not self.instruction.strip():
            raise LinkError('say what to do, such as: cognitivedrone fly --link ... "Fly through the red gate"')
        if self.is_mavlink and not self.camera:
            raise LinkError(
                "a vehicle needs --camera: /dev/videoN, an rtsp:// or http:// URL, a video file, a folder, gazebo:TOPIC"
            )
        if self.camera and not self.is_mavlink:
            raise LinkError(f"--link {self.link} has its own camera; leave --camera out")

    @property
    def is_mavlink(self) -> bool:
        """Whether a vehicle outside is flown."""
        return self.link.startswith(_MAVLINK)

    @property
    def url(self) -> str:
        """Of the vehicle."""
        return self.link.removeprefix(_MAVLINK)

    @property
    def on_loopback(self) -> bool:
        """Whether the vehicle is reached inside this machine."""
        kind, _, address = self.url.partition(":")
        return kind != "serial" and address.startswith(LOOPBACK)


@dataclass(frozen=True, slots=True)
class SimConfig:
    """Serve the simulator as a vehicle."""

    mavlink: bool = False
    """As a MAVLink vehicle that answers like an ArduCopter; there is no other way yet, so it must be given."""
    links: tuple[str, ...] = ("udpout:127.0.0.1:14550", "tcpin:127.0.0.1:5760")
    """How it is reached: udpout:HOST:PORT speaks first, udpin and tcpin wait. There is no authentication."""
    camera_port: int | None = None
    """Serve the first-person view as motion JPEG at this port of 127.0.0.1; 0 takes any free one."""
    camera_hz: float = 20.0
    """Frames a second of the wall clock."""
    suite: str = "open-v1:smoke"
    """The suite that the scene is from."""
    tasks: Path | None = None
    """Task file, or folder of them, instead of a suite."""
    labels: Path | None = None
    """Folder of label images that come before the shipped ones."""
    episode: int = 0
    """Which of its tasks, from 0."""
    seed: int = 0
    """Draws start and look of the scene."""
    speed: float = 1.0
    """How many times as fast as the wall clock, up to 100."""
