"""The content of a vehicle's messages, in this project's frames and units: pure functions of immutable values.

Times are of this machine's steady clock (`time.monotonic`), s, unless they are called vehicle time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from cognitivedrone.errors import import_extra
from cognitivedrone.frames import enu_to_ned, flu_to_frd, world_to_heading
from cognitivedrone.text.printable import visible
from cognitivedrone.types import FloatArray
from cognitivedrone.vehicles.mavlink.autopilot import ARDUPILOT, AutopilotKind

COPTER_TYPES = frozenset({2, 3, 4, 13, 14, 15, 29})
"""MAV_TYPE: quadrotor, coaxial, helicopter, hexarotor, octorotor, tricopter, dodecarotor."""
GROUND_STATION = 6
"""MAV_TYPE_GCS."""
ARMED_FLAG, PREARM_BIT, REMOTE_BIT = 0x80, 0x1000_0000, 0x1_0000
"""Of base_mode; of SYS_STATUS: the checks before arming, the receiver of the remote control."""
EKF_NEEDED, EKF_CONST_POSITION = 0x07, 0x80
"""Flags of EKF_STATUS_REPORT and of PX4's ESTIMATOR_STATUS: attitude, horizontal and vertical velocity; and "does not
know where it is"."""
EKF_POSITION = 0x18
"""Relative or absolute horizontal position: one of the two."""
EKF_MOST = 0.8
"""Of its variances (test ratios): ArduCopter's `FS_EKF_THRESH`."""
POSITION_IGNORED = 0x07
"""In the type mask of POSITION_TARGET_LOCAL_NED: it flies by velocity."""
CLOCK_BACK_S = 1.0
"""A vehicle's clock that goes back by more than this has started again; less is a message that was overtaken."""
CLOCK_DRIFT = 0.001
"""So much slower than ours may a vehicle's clock run without its messages counting as late."""
AHEAD_S, AHEAD_COUNT = 0.1, 5
"""A message so far ahead of the vehicle's clock is another's, or a mistake, until so many in a row say the same: then
the way here has become faster."""
STRANGE, STRANGE_S = 10, 2.0
"""So many messages of another clock in so long are a second vehicle's."""
JUMP_M_S = 2.0
"""Speed that a position may have beyond what the vehicle reports of its velocity."""
SIMULATED = b"CogDrone"
"""The `flight_custom_version` of this project's simulated vehicle."""
STICKS = (1, 2, 3, 4)
STICK_MOVED_US = 120
"""A stick that is this far from where it was, in microseconds of 1000 to 2000, was moved by somebody."""
TEXTS_KEPT = 20
LANDED_UNKNOWN, LANDED = 0, 1
"""MAV_LANDED_STATE of EXTENDED_SYS_STATE."""


def dialect() -> Any:
    """The module of ArduPilot's messages in pymavlink; raises `MissingExtra` where it is not installed."""
    return import_extra("pymavlink.dialects.v20.ardupilotmega", "mavlink", "pymavlink")


_VARIANCES = ("velocity", "position", "height", "compass")


@dataclass(frozen=True, slots=True)
class Text:
    """A status text of the vehicle."""

    time: float
    severity: int
    """0 emergency to 7 debug; 4 is a warning."""
    text: str


@dataclass(frozen=True, slots=True)
class Telemetry:
    """The newest values that a vehicle has reported; a time of -inf is never."""

    mode: str = ""
    armed: bool = False
    received_at: float = -math.inf
    """Any message."""
    heartbeat_at: float = -math.inf
    position: FloatArray = field(default_factory=lambda: np.full(3, np.nan))
    """(3,) ENU from the origin of its estimator, m."""
    velocity: FloatArray = field(default_factory=lambda: np.zeros(3))
    """(3,) ENU, m/s."""
    position_at: float = -math.inf
    yaw: float = 0.0
    """From east to the left, rad."""
    yaw_rate: float = 0.0
    """Positive to the left, rad/s."""
    tilt: float = 0.0
    """Between its up and the world's, rad."""
    attitude_at: float = -math.inf
    vehicle_time: float = 0.0
    """Since its start, s."""
    attitude_time: float = -math.inf
    position_time: float = -math.inf
    """Vehicle time of attitude and position."""
    clock_offset: float = math.inf
    """Our time less the vehicle's, with the messages that came fastest; a little more as time passes (CLOCK_DRIFT)."""
    offset_at: float = -math.inf
    ahead: tuple[float, ...] = ()
    """The same of the last messages in a row that came faster, `AHEAD_COUNT` at most: one alone proves nothing."""
    strange: tuple[float, ...] = ()
    """When the last messages came whose time is not believed, `STRANGE` at most."""
    clock_restarts: int = 0
    """How many times its time went back."""
    jump_m: float = 0.0
    """The last step of the position beyond what its speed explains, m."""
    jumped_at: float = -math.inf
    battery: float | None = None
    """What is left, 0 to 1."""
    battery_at: float = -math.inf
    """When it last reported its charge."""
    status_at: float = -math.inf
    """SYS_STATUS."""
    landed: bool | None = None
    """Whether it says that it stands on the ground; none where it does not say."""
    landed_at: float = -math.inf
    prearm: bool | None = None
    """Whether its own checks before arming pass; none where it is not reported."""
    ekf: int | None = None
    """Flags of its state estimator; none where they are not reported."""
    ekf_variances: tuple[float, ...] = ()
    """Of velocity, horizontal position, height and compass: 1 is the limit of what it trusts."""
    ekf_at: float = -math.inf
    remote_at: float = -math.inf
    """When the remote control was last known to be received."""
    receiver: bool = False
    """Whether it reports its receiver's state. If so, the channels alone prove nothing: they keep their last values."""
    target_mask: int | None = None
    """Type mask of the target that the vehicle reports; none where it reports none."""
    target_speed: float = 0.0
    """Of what it flies to, m/s."""
    target_at: float = -math.inf
    sticks: tuple[int, ...] = ()
    """Channels 1 to 4 of the remote control, us; empty where there is none."""
    texts: tuple[Text, ...] = ()
    """The last ones, oldest first."""

    @property
    def state_at(self) -> float:
        """When the older of attitude and position came."""
        return min(self.attitude_at, self.position_at)

    @property
    def late_s(self) -> float:
        """How much later than the fastest message the older of attitude and position came."""
        late = (self.attitude_at - self.attitude_time, self.position_at - self.position_time)
        return max(0.0, max(late) - self.clock_offset) if math.isfinite(self.state_at) else 0.0

    @property
    def estimator(self) -> str:
        """What is wrong with its state estimator; empty where it is healthy or not reported."""
        if self.ekf is None:
            return ""
        if not self.estimating:
            return f"it does not know where it is (flags {self.ekf:#x})"
        high = [
            f"{name} {variance:.1f}"
            for name, variance in zip(_VARIANCES, self.ekf_variances, strict=False)
            if not variance < EKF_MOST
        ]
        velocity = self.ekf_variances[0] if self.ekf_variances else 0.0
        # As ArduCopter's own check: two of them, or the velocity at twice the limit. NaN is high.
        return f"it diverges ({', '.join(high)})" if len(high) >= 2 or not velocity < 2 * EKF_MOST else ""

    @property
    def two_clocks(self) -> bool:
        """Whether messages of another clock come between the vehicle's."""
        return len(self.strange) == STRANGE and self.strange[-1] - self.strange[0] <= STRANGE_S

    @property
    def heading_velocity(self) -> FloatArray:
        """(3,) float32, heading frame, m/s."""
        return world_to_heading(self.velocity, self.yaw).astype(np.float32)

    @property
    def estimating(self) -> bool:
        """Whether it has a position estimate; where the estimator is not reported, whether it reports a position."""
        if not math.isfinite(self.state_at):
            return False
        if self.ekf is None:
            return True
        return (
            self.ekf & EKF_NEEDED == EKF_NEEDED and bool(self.ekf & EKF_POSITION) and not self.ekf & EKF_CONST_POSITION
        )


def updated(before: Telemetry, message: Any, now: float, autopilot: AutopilotKind = ARDUPILOT) -> Telemetry:
    """The telemetry after one more message of the vehicle; one without useful content only proves the link."""
    t = replace(before, received_at=now)
    match message.get_type():
        case "HEARTBEAT":
            armed = bool(message.base_mode & ARMED_FLAG)
            return replace(t, mode=autopilot.mode(message.custom_mode), armed=armed, heartbeat_at=now)
        case "LOCAL_POSITION_NED":
            return _with_position(t, message, now)
        case "ATTITUDE":
            return _with_attitude(t, message, now)
        case "POSITION_TARGET_LOCAL_NED":
            speed = math.sqrt(message.vx**2 + message.vy**2 + message.vz**2)
            return replace(t, target_mask=message.type_mask, target_speed=speed, target_at=now)
        case "SYS_STATUS":
            present, healthy = message.onboard_control_sensors_present, message.onboard_control_sensors_health
            left = message.battery_remaining
            # With ARMING_CHECK 0, ArduCopter has them present, not enabled and not healthy.
            checks = present & message.onboard_control_sensors_enabled & PREARM_BIT
            return replace(
                t,
                status_at=now,
                battery=left / 100 if left >= 0 else None,
                battery_at=now if left >= 0 else t.battery_at,
                prearm=bool(healthy & PREARM_BIT) if checks or autopilot.reports_prearm else None,
                receiver=t.receiver or bool(present & REMOTE_BIT),
                remote_at=now if present & healthy & REMOTE_BIT else t.remote_at,
            )
        case "EKF_STATUS_REPORT":
            m = message
            variances = (m.velocity_variance, m.pos_horiz_variance, m.pos_vert_variance, m.compass_variance)
            return replace(t, ekf=m.flags, ekf_variances=variances, ekf_at=now)
        case "ESTIMATOR_STATUS":
            m = message
            ratios = (m.vel_ratio, m.pos_horiz_ratio, m.pos_vert_ratio, m.mag_ratio)
            return replace(t, ekf=m.flags, ekf_variances=ratios, ekf_at=now)
        case "EXTENDED_SYS_STATE":
            state = message.landed_state
            return replace(t, landed=None if state == LANDED_UNKNOWN else state == LANDED, landed_at=now)
        case "RC_CHANNELS":
            sticks = tuple(getattr(message, f"chan{channel}_raw") for channel in STICKS)
            sticks = sticks if all(0 < pulse < 0xFFFF for pulse in sticks) else ()
            return replace(t, sticks=sticks, remote_at=now if sticks and not t.receiver else t.remote_at)
        case "STATUSTEXT":
            text = Text(now, message.severity, visible(message.text.rstrip("\0")))
            return replace(t, texts=(*t.texts, text)[-TEXTS_KEPT:])
    return t


def stick_moved(before: tuple[int, ...], now: tuple[int, ...]) -> bool:
    """Whether any stick is elsewhere than it was; where there is no remote control, none is."""
    return any(abs(b - n) > STICK_MOVED_US for b, n in zip(before, now, strict=False))


def last_words(telemetry: Telemetry, since: float) -> str:
    """The vehicle's status texts since then, as a clause that ends an error message."""
    texts = list(dict.fromkeys(text.text for text in telemetry.texts if text.time >= since))
    return f"; it reports: {'; '.join(texts[-4:])}" if texts else ""


LANDING_SILENT_S = 15.0
"""A landing vehicle that has shown no heartbeat for so long is not waited for: nobody would see that it has landed."""


def unlanded(telemetry: Telemetry, ordered: str, waited_s: float, now: float) -> str:
    """Why a landing is not waited for any more, after so long, as an error message."""
    silent_s = now - telemetry.heartbeat_at
    if silent_s > LANDING_SILENT_S:
        seen = f"no heartbeat of the vehicle for {silent_s:.0f} s, {ordered} was ordered: whether it landed is not seen"
    else:
        seen = f"not landed {waited_s:g} s after {ordered} was ordered: the vehicle is in {telemetry.mode}"
    return f"{seen}{last_words(telemetry, now - 5)}; take over by hand"


def is_vehicle(message: Any) -> bool:
    """Whether a heartbeat comes from an autopilot, and not from a ground station, a gimbal or another companion."""
    return bool(message.autopilot != 8 and message.get_srcComponent() == 1)  # 8: MAV_AUTOPILOT_INVALID


def _with_position(t: Telemetry, message: Any, now: float) -> Telemetry:
    """Numbers that are none are no position: the last one grows old."""
    position = enu_to_ned(np.array([message.x, message.y, message.z], dtype=np.float64))
    velocity = enu_to_ned(np.array([message.vx, message.vy, message.vz], dtype=np.float64))
    if not (np.isfinite(position).all() and np.isfinite(velocity).all()):
        return t
    t, time = _timed(t, message, now)
    if time is None or time < t.position_time:
        return t
    passed = max(0.0, time - t.position_time)
    if math.isfinite(passed):
        speed = max(float(np.linalg.norm(velocity)), float(np.linalg.norm(t.velocity))) + JUMP_M_S
        beyond = float(np.linalg.norm(position - t.position)) - speed * passed
        if beyond > JUMP_LEAST_M:
            t = replace(t, jump_m=beyond, jumped_at=now)
    return replace(t, position=position, velocity=velocity, position_at=now, position_time=time)


JUMP_LEAST_M = 0.5
"""Smaller steps of the position are an estimator's corrections."""


def _with_attitude(t: Telemetry, message: Any, now: float) -> Telemetry:
    angles = (message.roll, message.pitch, message.yaw, message.rollspeed, message.pitchspeed, message.yawspeed)
    if not all(map(math.isfinite, angles)):
        return t
    t, time = _timed(t, message, now)
    if time is None or time < t.attitude_time:
        return t
    nose = enu_to_ned(np.array([math.cos(message.yaw), math.sin(message.yaw), 0.0]))
    rates = flu_to_frd(np.array(angles[3:], dtype=np.float64))
    return replace(
        t,
        yaw=math.atan2(nose[1], nose[0]),
        yaw_rate=float(rates[2]),
        tilt=math.acos(max(-1.0, min(1.0, math.cos(message.roll) * math.cos(message.pitch)))),
        attitude_at=now,
        attitude_time=time,
    )


def _timed(t: Telemetry, message: Any, now: float) -> tuple[Telemetry, float | None]:
    """With the vehicle's clock: how it runs against ours, and whether it went back; and the message's time, s.

    None is a time that is not believed. A message that is older than one that came before it was overtaken.
    """
    time = message.time_boot_ms / 1000
    if time < t.vehicle_time - CLOCK_BACK_S:
        restarted = replace(
            t,
            vehicle_time=time,
            clock_restarts=t.clock_restarts + 1,
            clock_offset=now - time,
            offset_at=now,
            ahead=(),
            attitude_time=-math.inf,
            position_time=-math.inf,
        )
        return restarted, time
    if not math.isfinite(t.offset_at):
        return replace(t, vehicle_time=time, clock_offset=now - time, offset_at=now), time
    offset, drifted = now - time, t.clock_offset + CLOCK_DRIFT * (now - t.offset_at)
    # One that is on time again ends the row.
    row = t.ahead if not t.ahead or offset <= t.ahead[-1] + AHEAD_S else ()
    ahead = (*row, offset)[-AHEAD_COUNT:] if offset < drifted else ()
    sure = len(ahead) == AHEAD_COUNT
    clock = max(ahead) if sure else drifted
    t = replace(t, clock_offset=clock, offset_at=now, ahead=ahead)
    # A simulation that runs fast is ahead by as much with every step; a mistake is so at once.
    if clock - offset > AHEAD_S + (3 * max(0.0, ahead[0] - ahead[2]) if sure else 0.0):
        return replace(t, strange=(*t.strange, now)[-STRANGE:]), None
    return replace(t, vehicle_time=max(time, t.vehicle_time)), time  # messages of one moment come in either order
