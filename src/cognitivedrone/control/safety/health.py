"""How everything around a flying drone is doing at one moment: what the rules of `control/safety` decide by."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from cognitivedrone.types import FloatArray, Vector

VELOCITY_MODES: Final = frozenset({"GUIDED", "OFFBOARD"})
"""Modes in which a vehicle flies by the velocities that it is sent: ArduCopter's and PX4's."""


@dataclass(frozen=True, slots=True)
class Health:
    """Ages count from when a thing was last good, s. What has a default is good where nobody reports it."""

    time: float
    """Of a steady clock, s."""
    command: FloatArray | None
    """(4,) what the policy asked for last, heading frame, m/s and rad/s, NaN and all; none before it first did."""
    command_age_s: float
    """Of the last command of finite numbers; before there was one, since the policy took over."""
    frame_age_s: float
    """Of the newest camera frame that differs from the one before."""
    link_age_s: float
    """Of the last message from the vehicle, whatever it was."""
    state_age_s: float
    """Of the older of attitude and position, by the vehicle's clock: a message that was long on its way, or repeats an
    old time, is old."""
    battery: float | None
    """What is left, 0 to 1; none where the vehicle does not report it."""
    position: Vector
    """(3,) from where it took off, ENU, m."""
    velocity: Vector
    """(3,) ENU, m/s."""
    yaw: float
    """Heading, from east to the left, rad."""
    mode: str
    """The vehicle's flight mode, by its heartbeats."""
    ordered_modes: frozenset[str]
    """The mode that we ordered and, until the vehicle shows it, the one before."""
    armed: bool
    """Whether the motors may turn, by its heartbeats."""
    stick_moved: bool
    """Whether a stick of the remote control has left its place since we took over."""
    suspicion: str = ""
    """A description of what a heartbeat shows that was not ordered, while `mode` and `armed` are what is believed: it
    may be the pilot, or somebody else's packet. Empty where there is none."""
    heartbeat_age_s: float = 0.0
    """Of the vehicle's last heartbeat that is believed: so old are `mode` and `armed`."""
    uplink_age_s: float = 0.0
    """Since we sent the newest request that the vehicle has answered."""
    battery_age_s: float = 0.0
    """Of the last report of the battery; 0 where there was none at take-off."""
    estimator: str = ""
    """What is wrong with the vehicle's state estimator; empty where it is healthy."""
    estimator_age_s: float = 0.0
    """Of its last report; 0 where there was none at take-off."""
    remote_age_s: float = 0.0
    """Since the remote control was last received; 0 where there was none at take-off."""
    remote_appeared: bool = False
    """Whether a remote control that was off at take-off has been switched on."""
    tilt_rad: float = 0.0
    """Between the drone's up and the world's."""
    jump_m: float = 0.0
    """The largest step of the position since take-off beyond what its speed explains."""
    restarted: bool = False
    """Whether the vehicle's clock has gone back since take-off."""
    intruder: str = ""
    """A description of another sender that commands the vehicle, or uses its id or ours; empty where there is none."""
    speed_limit_m_s: float = np.inf
    """The fastest that keeps the way flown without commands short, by the vehicle's own time limit for them."""

    @property
    def state_known(self) -> bool:
        """Whether position, velocity and heading are numbers that a drone can have."""
        values = (*self.position, *self.velocity, self.yaw)
        return all(-_FARTHEST < value < _FARTHEST for value in values)


_FARTHEST = 1e6
"""m, and m/s: beyond it, and where it is not a number, a state is none."""
