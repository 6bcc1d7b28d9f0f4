"""From what a vehicle reports and what goes on around it to the `Health` that the rules of safety judge."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from cognitivedrone.control.safety import Decision, Guard, Order, SafetyConfig, order
from cognitivedrone.control.safety.health import VELOCITY_MODES, Health
from cognitivedrone.types import Action, FloatArray
from cognitivedrone.vehicles.mavlink.client.heartbeats import Grounded
from cognitivedrone.vehicles.mavlink.client.traffic import Traffic, impostor_of
from cognitivedrone.vehicles.mavlink.telemetry import POSITION_IGNORED, Telemetry, stick_moved

BLIND_M = 1.0
"""So far it may fly without a command: that divided by `GUID_TIMEOUT` (PX4: `COM_OF_LOSS_T`) is the most speed."""
OWN_TARGETS_S = 1.5
"""A velocity that we sent may be the vehicle's reported target for so long."""
TARGET_M_S = 0.5
"""A target this much faster than all that we sent is somebody else's."""
IMPOSTOR_S = 2.0
"""An impostor, another sender with the vehicle's id, counts for so long after its last packet."""


@dataclass(frozen=True, slots=True)
class Baseline:
    """What was so at the end of the take-off, which changes are measured by."""

    home: FloatArray = field(default_factory=lambda: np.zeros(3))
    """(3,) where it stood, ENU from the origin of its estimator, m."""
    taken_at: float = -math.inf
    """By our steady clock, s."""
    sticks: tuple[int, ...] = ()
    remote: bool = False
    """Whether a remote control was received."""
    battery: bool = False
    """Whether the vehicle reported its battery."""
    estimator: bool = False
    """Whether it reported its state estimator."""
    clock_restarts: int = 0
    speed_limit_m_s: float = math.inf

    @classmethod
    def taken(
        cls, telemetry: Telemetry, home: FloatArray, now: float, guided_timeout_s: float | None = None
    ) -> Baseline:
        """The baseline of now; `guided_timeout_s` is the vehicle's `GUID_TIMEOUT`, or PX4's `COM_OF_LOSS_T`."""
        return cls(
            home=home,
            taken_at=now,
            sticks=telemetry.sticks,
            remote=math.isfinite(telemetry.remote_at) and now - telemetry.remote_at < REMOTE_S,
            battery=telemetry.battery is not None,
            estimator=telemetry.ekf is not None,
            clock_restarts=telemetry.clock_restarts,
            speed_limit_m_s=BLIND_M / guided_timeout_s if guided_timeout_s else math.inf,
        )


REMOTE_S = 2.0
"""A remote control that was not received for so long is off."""


@dataclass(frozen=True, slots=True)
class Asked:
    """What the pilot asks for and sees, and what was sent, by the clock that the flight goes by."""

    now: float
    command: FloatArray | None
    command_at: float
    frame_at: float
    ordered_modes: frozenset[str]
    sent: tuple[tuple[float, float], ...] = ()
    """Times by our steady clock and speeds, m/s, of the velocities sent last."""
    suspicion: str = ""
    """What a heartbeat shows that is not believed yet, as a description."""


def health_of(
    telemetry: Telemetry,
    traffic: Traffic,
    baseline: Baseline,
    asked: Asked,
    now: float,
    *,
    patience_s: float = 0.0,
    judges_time: bool = True,
) -> Health:
    """How everything is at `now`, by our steady clock.

    `patience_s` above 0 is for simulators whose time may stand still: so much silence of theirs is forgiven. Without
    `judges_time` their clock is not compared with ours: a busy machine slows it.
    """
    t, b = telemetry, baseline
    lateness = t.late_s if judges_time else 0.0

    def age(since: float) -> float:
        return max(0.0, now - since - patience_s)

    return Health(
        time=asked.now,
        command=asked.command,
        command_age_s=asked.now - asked.command_at,
        frame_age_s=asked.now - asked.frame_at,
        link_age_s=age(t.received_at),
        state_age_s=age(t.state_at) + lateness,
        heartbeat_age_s=age(t.heartbeat_at),
        uplink_age_s=age(traffic.answered_at),
        battery=t.battery,
        battery_age_s=age(t.battery_at) if b.battery else 0.0,
        estimator=t.estimator,
        estimator_age_s=age(t.ekf_at) if b.estimator else 0.0,
        remote_age_s=age(t.remote_at) if b.remote else 0.0,
        remote_appeared=not b.remote and t.remote_at > b.taken_at,
        position=t.position - b.home,
        velocity=t.velocity,
        yaw=t.yaw,
        tilt_rad=t.tilt,
        jump_m=t.jump_m if t.jumped_at > b.taken_at else 0.0,
        restarted=t.clock_restarts > b.clock_restarts,
        mode=t.mode,
        ordered_modes=asked.ordered_modes,
        armed=t.armed,
        suspicion=asked.suspicion,
        stick_moved=stick_moved(b.sticks, t.sticks),
        intruder=intruder(t, traffic, b.taken_at, asked.sent, now, judges_time=judges_time),
        speed_limit_m_s=b.speed_limit_m_s,
    )


def intruder(
    telemetry: Telemetry,
    traffic: Traffic,
    since: float,
    sent: Iterable[tuple[float, float]],
    now: float,
    *,
    judges_time: bool = True,
) -> str:
    """A description of another sender that commands the vehicle or uses its id or ours; empty where there is none."""
    if traffic.commander_at > since:
        return traffic.commander
    if traffic.impostor_at > max(since, now - IMPOSTOR_S):
        return f"{impostor_of(traffic)}: what it reports cannot be trusted"
    if judges_time and telemetry.two_clocks and telemetry.strange[0] > since:
        return "messages of two clocks come as the vehicle's: a second vehicle has its id"
    if traffic.masks:
        return f"another ground station has our system id ({traffic.masks[0][0]}): it hides our silence"
    if foreign_target(telemetry, since, sent):
        return f"the vehicle flies to a target that we did not send ({telemetry.target_speed:.1f} m/s)"
    return ""


ON_GROUND_M, STILL_M_S = 0.5, 0.5
"""A vehicle that is lower above its take-off, and slower, may stand."""


def grounded(telemetry: Telemetry, home: FloatArray, now: float) -> Grounded:
    """Whether the vehicle may stand on the ground, whatever its heartbeats say; `home` (3,) is where it took off."""
    t = telemetry
    if t.landed is not None and now - t.landed_at <= REPORTED_S:
        return "yes" if t.landed else "no"
    low = now - t.position_at <= REPORTED_S and float(t.position[2] - home[2]) <= ON_GROUND_M
    return "yes" if low and float(np.linalg.norm(t.velocity)) <= STILL_M_S else "unproven"


REPORTED_S = 1.0
"""An older report says nothing of now."""


def foreign_target(telemetry: Telemetry, since: float, sent: Iterable[tuple[float, float]]) -> bool:
    """Whether the vehicle flies in GUIDED, or OFFBOARD, to what nobody here has asked for.

    Only reports from some time after the take-off count: until the first velocity arrives, it keeps the take-off's own.
    """
    t = telemetry
    if t.mode not in VELOCITY_MODES or t.target_mask is None or t.target_at < since + OWN_TARGETS_S:
        return False
    if t.target_mask & POSITION_IGNORED != POSITION_IGNORED:
        return True
    # It flies to zero by itself when our commands are late, so that slower is no sign.
    return (
        t.target_speed > max((speed for at, speed in sent if at >= t.target_at - OWN_TARGETS_S), default=0) + TARGET_M_S
    )


class PassThroughGuard:
    """Passes every command while the vehicle is ours and armed: where a gate monitor judges, no rule holds it back.

    Decides `hands_off`, permanently, if the motors stop or a mode appears that we did not order. Wall-clock times mean
    nothing here, where the vehicle's time may stand still.
    """

    def __init__(self) -> None:
        self._landing = self._over = ""

    def judge(self, health: Health) -> Decision:
        """Fly, land, or hands off."""
        if not self._over and not health.armed:
            self._over = "the motors were stopped"
        if not self._over and health.mode not in health.ordered_modes:
            self._over = f"the mode became {health.mode}"
        if self._over:
            return Decision("hands_off", self._over)
        return Decision("land", self._landing) if self._landing else Decision("fly", "")

    def shape(self, health: Health) -> Action:
        """The command, unchanged."""
        return np.zeros(4, dtype=np.float32) if health.command is None else health.command.astype(np.float32)

    def order(self, decision: Decision, health: Health, landing: str) -> Order:
        """To land, as the rules do."""
        return order(decision, health, SafetyConfig(), landing)

    def land(self, reason: str) -> None:
        """Land from now on."""
        self._landing = self._landing or reason


FlightGuard = Guard | PassThroughGuard
"""What decides over every command."""
