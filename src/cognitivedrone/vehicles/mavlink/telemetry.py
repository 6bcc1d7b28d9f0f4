"""What a vehicle's messages say, in this project's frames and units: pure functions of immutable values.

Times are of this machine's steady clock (`time.monotonic`), s, unless they are called vehicle time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from cognitivedrone.errors import import_extra
from cognitivedrone.frames import enu_to_ned, flu_to_frd, world_to_heading
from cognitivedrone.types import FloatArray

MODES = {
    0: "STABILIZE", 1: "ACRO", 2: "ALT_HOLD", 3: "AUTO", 4: "GUIDED", 5: "LOITER", 6: "RTL", 7: "CIRCLE", 9: "LAND",
    11: "DRIFT", 13: "SPORT", 14: "FLIP", 15: "AUTOTUNE", 16: "POSHOLD", 17: "BRAKE", 18: "THROW", 19: "AVOID_ADSB",
    20: "GUIDED_NOGPS", 21: "SMART_RTL", 22: "FLOWHOLD", 23: "FOLLOW", 24: "ZIGZAG", 25: "SYSTEMID", 26: "AUTOROTATE",
    27: "AUTO_RTL", 28: "TURTLE",
}  # fmt: skip
"""ArduCopter's flight modes by number (its parameter FLTMODE1)."""
MODE_NUMBERS = {name: number for number, name in MODES.items()}

COPTER_TYPES = frozenset({2, 3, 4, 13, 14, 15, 29})
"""MAV_TYPE: quadrotor, coaxial, helicopter, hexarotor, octorotor, tricopter, dodecarotor."""
ARDUPILOT, GROUND_STATION = 3, 6
"""MAV_AUTOPILOT_ARDUPILOTMEGA, MAV_TYPE_GCS."""
ARMED_FLAG, PREARM_BIT = 0x80, 0x1000_0000
EKF_NEEDED, EKF_CONST_POSITION = 0x07, 0x80
"""Flags of EKF_STATUS_REPORT: attitude, horizontal and vertical velocity; and "does not know where it is"."""
EKF_POSITION = 0x18
"""Relative or absolute horizontal position: one of the two."""
SIMULATED = b"CogDrone"
"""What this project's simulated vehicle tells as its `flight_custom_version`."""
STICKS = (1, 2, 3, 4)
STICK_MOVED_US = 120
"""A stick that is this far from where it was, in microseconds of 1000 to 2000, was moved by somebody."""
TEXTS_KEPT = 20


def dialect() -> Any:
    """The module of ArduPilot's messages in pymavlink; raises `MissingExtra` where it is not installed."""
    return import_extra("pymavlink.dialects.v20.ardupilotmega", "mavlink", "pymavlink")


@dataclass(frozen=True, slots=True)
class Text:
    """A status text, as the vehicle said it."""

    time: float
    severity: int
    """0 emergency to 7 debug; 4 is a warning."""
    text: str


@dataclass(frozen=True, slots=True)
class Telemetry:
    """The newest of everything that a vehicle has said; -inf is never."""

    mode: str = ""
    armed: bool = False
    heard_at: float = -math.inf
    """Any message."""
    position: FloatArray = field(default_factory=lambda: np.full(3, np.nan))
    """(3,) ENU from the origin of its estimator, m."""
    velocity: FloatArray = field(default_factory=lambda: np.zeros(3))
    """(3,) ENU, m/s."""
    position_at: float = -math.inf
    yaw: float = 0.0
    """From east to the left, rad."""
    yaw_rate: float = 0.0
    """Positive to the left, rad/s."""
    attitude_at: float = -math.inf
    vehicle_time: float = 0.0
    """Since its start, s."""
    battery: float | None = None
    """What is left, 0 to 1."""
    prearm: bool | None = None
    """Whether its own checks before arming pass; none where it does not say."""
    ekf: int | None = None
    """Flags of its state estimator; none where it does not say."""
    sticks: tuple[int, ...] = ()
    """Channels 1 to 4 of the remote control, us; empty where there is none."""
    texts: tuple[Text, ...] = ()
    """The last ones, oldest first."""

    @property
    def state_at(self) -> float:
        """When the older of attitude and position came."""
        return min(self.attitude_at, self.position_at)

    @property
    def heading_velocity(self) -> FloatArray:
        """(3,) float32, heading frame, m/s."""
        return world_to_heading(self.velocity, self.yaw).astype(np.float32)

    @property
    def estimating(self) -> bool:
        """Whether it knows where it is; where it does not tell of its estimator, whether it tells a position."""
        if not math.isfinite(self.state_at):
            return False
        if self.ekf is None:
            return True
        return (
            self.ekf & EKF_NEEDED == EKF_NEEDED and bool(self.ekf & EKF_POSITION) and not self.ekf & EKF_CONST_POSITION
        )


def heard(before: Telemetry, message: Any, now: float) -> Telemetry:
    """The telemetry after one more message of the vehicle; one that says nothing of use only proves the link."""
    t = replace(before, heard_at=now)
    match message.get_type():
        case "HEARTBEAT":
            mode = MODES.get(message.custom_mode, f"mode {message.custom_mode}")
            return replace(t, mode=mode, armed=bool(message.base_mode & ARMED_FLAG))
        case "LOCAL_POSITION_NED":
            position = enu_to_ned(np.array([message.x, message.y, message.z]))
            velocity = enu_to_ned(np.array([message.vx, message.vy, message.vz]))
            return _timed(replace(t, position=position, velocity=velocity, position_at=now), message)
        case "ATTITUDE":
            nose = enu_to_ned(np.array([math.cos(message.yaw), math.sin(message.yaw), 0.0]))
            rates = flu_to_frd(np.array([message.rollspeed, message.pitchspeed, message.yawspeed]))
            yaw = math.atan2(nose[1], nose[0])
            return _timed(replace(t, yaw=yaw, yaw_rate=float(rates[2]), attitude_at=now), message)
        case "SYS_STATUS":
            left = message.battery_remaining
            checks = message.onboard_control_sensors_present & PREARM_BIT
            prearm = bool(message.onboard_control_sensors_health & PREARM_BIT) if checks else None
            return replace(t, battery=left / 100 if left >= 0 else None, prearm=prearm)
        case "EKF_STATUS_REPORT":
            return replace(t, ekf=message.flags)
        case "RC_CHANNELS":
            sticks = tuple(getattr(message, f"chan{channel}_raw") for channel in STICKS)
            return replace(t, sticks=sticks if all(0 < pulse < 0xFFFF for pulse in sticks) else ())
        case "STATUSTEXT":
            said = Text(now, message.severity, message.text.rstrip("\0"))
            return replace(t, texts=(*t.texts, said)[-TEXTS_KEPT:])
    return t


def stick_moved(before: tuple[int, ...], now: tuple[int, ...]) -> bool:
    """Whether any stick is elsewhere than it was; where there is no remote control, none is."""
    return any(abs(b - n) > STICK_MOVED_US for b, n in zip(before, now, strict=False))


def last_words(telemetry: Telemetry, since: float) -> str:
    """What the vehicle has said since then, as a clause to end an error with."""
    said = list(dict.fromkeys(text.text for text in telemetry.texts if text.time >= since))
    return f"; it says: {'; '.join(said[-4:])}" if said else ""


def is_vehicle(message: Any) -> bool:
    """Whether a heartbeat comes from an autopilot, and not from a ground station, a gimbal or another companion."""
    return bool(message.autopilot != 8 and message.get_srcComponent() == 1)  # 8: MAV_AUTOPILOT_INVALID


def _timed(telemetry: Telemetry, message: Any) -> Telemetry:
    return replace(telemetry, vehicle_time=message.time_boot_ms / 1000)
