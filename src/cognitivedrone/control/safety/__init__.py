"""What a flying drone may do, decided from how everything around it is doing. Pure functions; nothing here does I/O.

A `Health` goes in, a `Decision` comes out: fly on, hold (zero velocity), brake (zero velocity for good), land, or hands
off. `order` makes of it what is sent, `shape` of the policy's wish the command. Whoever holds the link asks many times
a second, whether the policy does or not. The rules, worst first:

1. The pilot wins. A mode that we did not order, or stopped motors, is hands off: nothing is sent any more, for good.
   Until that is sure, since one heartbeat proves nothing, the drone is held.
2. A stick that is moved, or a remote control that is switched on, while we fly, brakes: the pilot wants something.
3. A battery that stays low lands, and so does a state estimator that stays bad.
4. What stays silent (policy, camera, vehicle, its state, mode, battery or remote control, the way to it) is held at
   once, braked after a while, landed after that. A state of numbers that are none counts as silent.
5. Who else commands the vehicle, a position that jumps, a clock that goes back and a tilt that no flight has brake, and
   land after that.
6. Outside the fence the outward part of every command is removed; who does not come back is held, then landed.

What brakes or lands never flies again in this run: trust that was lost is given back by a person.

**Nothing here orders a mode but LAND (or RTL), and that only while the vehicle's mode is known**: where the last
heartbeat is old, or shows what nobody ordered, the pilot may have taken over. Then the drone is stopped, and brought
down, by velocities, which only GUIDED obeys (PX4: OFFBOARD). It also never orders ArduCopter's BRAKE: that counts there
as a mode that a pilot flies, in which the ground-station failsafe does nothing as `FS_OPTIONS` comes. In GUIDED and
LAND it acts.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from cognitivedrone.choices import DecisionKind
from cognitivedrone.control.safety.fence import Fence, keep_inside, outside_by
from cognitivedrone.control.safety.health import VELOCITY_MODES, Health
from cognitivedrone.types import ACTION_LIMITS, Action, Commands, FloatArray, Vector

Kind = DecisionKind
SEVERITY: tuple[Kind, ...] = ("fly", "hold", "brake", "land", "hands_off")
"""From the mildest to the strongest; where several rules speak, the strongest is done."""


@dataclass(frozen=True, slots=True)
class Decision:
    """What to do now, and why."""

    kind: Kind
    reason: str
    """A description for the operator."""


@dataclass(frozen=True, slots=True)
class Order:
    """What is sent to the vehicle for a decision; nothing where both are none."""

    setpoint: Action | None = None
    """(4,) velocity in the heading frame, m/s and rad/s, which only GUIDED obeys."""
    mode: str | None = None


@dataclass(frozen=True, slots=True)
class Limits:
    """The most that is ever asked of the vehicle."""

    speed: tuple[float, float, float, float] = ACTION_LIMITS
    """Largest magnitude of vx, vy, vz in m/s and yaw rate in rad/s."""
    slew: tuple[float, float, float, float] = (5.0, 5.0, 3.0, 5.0)
    """Largest change a second of each: m/s2 and rad/s2. Above ArduCopter's own shaping (2.5 and 1 m/s2), so that it
    catches jumps and does not slow a good policy."""
    longest_step_s: float = 0.2
    """A command that comes later than this after the last one changes no more than after this time."""

    def __post_init__(self) -> None:
        for name, values in (("speed", self.speed), ("slew", self.slew)):
            if len(values) != 4 or not all(0 < value < np.inf for value in values):
                raise ValueError(f"{name} limits must be four finite numbers above zero, not {values}")


@dataclass(frozen=True, slots=True)
class Timeouts:
    """How long something may be silent."""

    hold_s: float
    brake_s: float

    def __post_init__(self) -> None:
        if not 0 <= self.hold_s <= self.brake_s:
            raise ValueError(f"hold_s {self.hold_s} must be at least 0 and at most brake_s {self.brake_s}")


@dataclass(frozen=True, slots=True)
class SafetyConfig:
    """Every number of the rules; `docs/real-drone.md` explains them."""

    limits: Limits = field(default_factory=Limits)
    fence: Fence = field(default_factory=Fence)
    policy: Timeouts = Timeouts(0.2, 1.0)
    """For commands, which come every 0.1 s: one that is missed is held."""
    first_command: Timeouts = Timeouts(0.0, 10.0)
    """For the first command: a policy may load before it flies."""
    camera: Timeouts = Timeouts(0.5, 1.5)
    link: Timeouts = Timeouts(0.15, 1.0)
    """For any message; attitude and position come 20 times a second."""
    state: Timeouts = Timeouts(0.3, 1.0)
    """For attitude and position, late ones and such of numbers that are none."""
    heartbeat: Timeouts = Timeouts(0.5, 1.0)
    """For the vehicle's mode, reported 10 times a second. From `hold_s` on no mode is ordered."""
    uplink: Timeouts = Timeouts(1.0, 2.0)
    """For the vehicle's answer to what we ask it 5 times a second."""
    estimator: Timeouts = Timeouts(0.3, 1.0)
    """For a bad state estimator, which lands instead of braking: ArduCopter itself lands after 1 s."""
    estimator_report: Timeouts = Timeouts(1.0, 3.0)
    """For the vehicle's report of its estimator, 5 times a second."""
    battery_report: Timeouts = Timeouts(3.0, 10.0)
    remote: Timeouts = Timeouts(0.5, 2.0)
    """For the remote control, where there was one at take-off."""
    tilt: Timeouts = Timeouts(0.1, 0.3)
    """For a tilt beyond `most_tilt_rad`."""
    most_tilt_rad: float = float(np.radians(60))
    """ArduCopter's `ANGLE_MAX` is 30 degrees."""
    most_jump_m: float = 1.0
    """A step of the position this much longer than its speed explains brakes: the fence's middle has moved."""
    descent_m_s: float = 0.5
    """Landing speed by velocities, while the vehicle's mode is not known; ArduCopter's `LAND_SPEED`."""
    land_after_brake_s: float = 4.0
    """Braked for as long as this, it lands."""
    low_battery: float = 0.2
    """Below this part of a full battery it lands."""
    low_battery_s: float = 2.0
    """If it stays there as long as this: under load the reading dips."""


@dataclass(frozen=True, slots=True)
class Memory:
    """What one decision must know of those before it."""

    floor: Decision = Decision("fly", "")
    """The strongest latched decision: braking, landing and hands off."""
    land_at: float = np.inf
    """When braking turns into landing, by the clock of `Health.time`."""
    outside_since: float | None = None
    low_battery_since: float | None = None
    unknown_since: float | None = None
    """Since when the state is no finite numbers."""
    bad_estimator_since: float | None = None
    tilted_since: float | None = None


def decide(health: Health, memory: Memory, config: SafetyConfig) -> tuple[Decision, Memory]:
    """What to do now, and what to remember for the next time."""
    if memory.floor.kind == "hands_off":
        return memory.floor, memory
    now = health.time
    memory = replace(
        memory,
        outside_since=_since(memory.outside_since, not outside_by(health.position, config.fence) <= 0, now),
        low_battery_since=_since(memory.low_battery_since, _low(health, config), now),
        unknown_since=_since(memory.unknown_since, not health.state_known, now),
        bad_estimator_since=_since(memory.bad_estimator_since, bool(health.estimator), now),
        tilted_since=_since(memory.tilted_since, not health.tilt_rad <= config.most_tilt_rad, now),
    )
    # The first of equals: the rules come worst first, and a latched reason stays the reason.
    latched = () if memory.floor.kind == "fly" else (memory.floor,)
    decisions = (*latched, *_findings(health, memory, config), Decision("fly", ""))
    decision = max(decisions, key=lambda d: SEVERITY.index(d.kind))
    if SEVERITY.index(decision.kind) < SEVERITY.index("brake") or decision == memory.floor:
        return decision, memory
    by_pilot = decision.kind == "brake" and (health.stick_moved or health.remote_appeared)
    land_at = np.inf if by_pilot else min(memory.land_at, health.time + config.land_after_brake_s)
    return decision, replace(memory, floor=decision, land_at=land_at)


def _findings(health: Health, memory: Memory, config: SafetyConfig) -> Iterator[Decision]:
    """The decisions of all rules that apply."""
    if not health.armed:
        yield Decision("hands_off", "the motors were stopped")
    if health.mode not in health.ordered_modes:
        reason = (
            f"the vehicle's heartbeats show {health.mode}, again and again, which was not ordered here: its pilot or a"
            " failsafe of its own flies"
        )
        yield Decision("hands_off", reason)
    if memory.floor.kind == "brake" and health.time >= memory.land_at:
        yield Decision("land", f"still braking because {memory.floor.reason}")
    if memory.low_battery_since is not None and health.time - memory.low_battery_since >= config.low_battery_s:
        yield Decision("land", f"the battery is below {config.low_battery:.0%}")
    if health.stick_moved:
        yield Decision("brake", "the pilot moved a stick; a change of mode gives control")
    if health.remote_appeared:
        yield Decision("brake", "a remote control was switched on; a change of mode gives control")
    if health.intruder:
        yield Decision("brake", health.intruder)
    if health.restarted:
        yield Decision("brake", "the vehicle's clock went back: it restarted, or two vehicles answer as one")
    if not health.jump_m <= config.most_jump_m:
        yield Decision("brake", f"the position jumped by {health.jump_m:.1f} m more than its speed explains")
    if health.suspicion:
        yield Decision("hold", health.suspicion)
    if health.command is None:
        yield Decision("hold", "the policy has not asked for anything yet")
    elif not np.isfinite(health.command).all():
        yield Decision("hold", "the policy asked for a velocity that is not a number")
    yield from _silences(health, memory, config)
    yield from _outside(health, memory, config.fence)


def _silences(health: Health, memory: Memory, config: SafetyConfig) -> Iterator[Decision]:
    """What has been silent, or bad, for too long."""
    policy = config.first_command if health.command is None else config.policy
    last: Kind
    for who, age, patience, last in (
        ("no message from the vehicle", health.link_age_s, config.link, "brake"),
        ("no attitude or position from the vehicle", health.state_age_s, config.state, "brake"),
        ("a state that is not a number", _age(memory.unknown_since, health.time), config.state, "brake"),
        ("no heartbeat from the vehicle: its mode is unknown", health.heartbeat_age_s, config.heartbeat, "brake"),
        ("no answer from the vehicle: commands may not arrive", health.uplink_age_s, config.uplink, "brake"),
        (
            f"the vehicle's state estimator: {health.estimator}",
            _age(memory.bad_estimator_since, health.time),
            config.estimator,
            "land",
        ),
        ("no report of the state estimator", health.estimator_age_s, config.estimator_report, "brake"),
        ("no report of the battery", health.battery_age_s, config.battery_report, "brake"),
        ("the remote control is lost", health.remote_age_s, config.remote, "brake"),
        ("a tilt that no flight has", _age(memory.tilted_since, health.time), config.tilt, "brake"),
        ("no new command from the policy", health.command_age_s, policy, "brake"),
        ("no new camera frame", health.frame_age_s, config.camera, "brake"),
    ):
        # An age that is not a number is no proof of life.
        if not age <= patience.brake_s:
            yield Decision(last, f"{who} for {age:.1f} s")
        elif age > patience.hold_s:
            yield Decision("hold", f"{who} for {age:.2f} s")
    if not health.state_known:
        yield Decision("hold", "the vehicle's position, velocity or heading is not a number")


def _outside(health: Health, memory: Memory, fence: Fence) -> Iterator[Decision]:
    """What being outside the fence leads to."""
    if memory.outside_since is None:
        return
    depth, time = outside_by(health.position, fence), health.time - memory.outside_since
    reason = f"{depth:.1f} m outside the fence for {time:.1f} s"
    if time >= fence.land_after_s:
        yield Decision("land", reason)
    elif time >= fence.hold_after_s or not depth <= fence.margin_m:
        yield Decision("hold", reason)
    else:
        yield Decision("fly", f"{reason}: only inwards")


def order(decision: Decision, health: Health, config: SafetyConfig, landing: str = "LAND") -> Order:
    """What is sent for any decision but to fly.

    `landing` is the mode that lands, LAND or RTL. Without a fresh heartbeat, or after one that shows something else, no
    mode is ordered, over a pilot who may have taken over: the drone descends by velocities, which only GUIDED obeys.
    """
    if decision.kind in ("hold", "brake"):
        return Order(setpoint=_STOP) if health.mode in VELOCITY_MODES else Order()
    if decision.kind != "land" or health.mode == landing:
        return Order()
    if health.heartbeat_age_s <= config.heartbeat.hold_s and not health.suspicion:
        return Order(mode=landing)
    return Order(setpoint=np.array([0, 0, -config.descent_m_s, 0], dtype=np.float32))


_STOP: Action = np.zeros(4, dtype=np.float32)


def shape(health: Health, previous: Commands, step_s: float, config: SafetyConfig) -> Action:
    """The policy's command (4,) as it may be sent: within speed and slew limits, and nothing outwards at the fence.

    `previous` (4,) is what was sent `step_s` seconds ago. The fence comes last and outranks the slew limits: what it
    removes is removed at once. Zeros where the wish or the state is no finite number, so that every result is one.
    """
    if health.command is None or not (np.isfinite(health.command).all() and health.state_known):
        return np.zeros(4, dtype=np.float32)
    command = limit(health.command, previous, step_s, config.limits)
    return fence_in(command, health.position, health.velocity, health.yaw, config, health.speed_limit_m_s)


def fence_in(
    command: Action,
    position: Vector,
    velocity: Vector,
    yaw: float,
    config: SafetyConfig,
    speed_limit_m_s: float = np.inf,
) -> Action:
    """`command` (4,), less what would lead out of the fence from a place (3,) ENU m, at a velocity (3,) ENU m/s.

    No faster than `speed_limit_m_s` either.
    """
    allowed = keep_inside(command[:3], position, velocity, yaw, config.fence)
    # Turned away from the fence, a component may have grown beyond its limit; shortening all keeps the direction.
    over = float((np.abs(allowed) / np.array(config.limits.speed[:3])).max(initial=1.0))
    over = max(over, float(np.linalg.norm(allowed)) / speed_limit_m_s)
    return np.append(allowed / over, command[3]).astype(np.float32)


def limit(command: FloatArray, previous: Commands, step_s: float, limits: Limits) -> Action:
    """`command` (4,) within the speed limits, and no farther from `previous` than the slew limits allow."""
    speed = np.array(limits.speed)
    change = np.array(limits.slew) * min(max(step_s, 0.0), limits.longest_step_s)
    # A previous command beyond the limits cannot be, but must not let this one be so either.
    near = np.clip(command, previous - change, previous + change)
    return np.clip(near, -speed, speed).astype(np.float32)


class Guard:
    """The rules with their memory: what the link asks. Not for several threads at once."""

    def __init__(self, config: SafetyConfig | None = None) -> None:
        self.config = config or SafetyConfig()
        self._memory = Memory()
        self._sent = np.zeros(4, dtype=np.float32)
        self._sent_at = -np.inf

    def judge(self, health: Health) -> Decision:
        """What to do now."""
        decision, self._memory = decide(health, self._memory, self.config)
        if decision.kind != "fly":
            self._sent = np.zeros(4, dtype=np.float32)
        return decision

    def shape(self, health: Health) -> Action:
        """The command (4,) to send now, after a decision to fly; counted as sent."""
        step = health.time - self._sent_at
        self._sent = shape(health, self._sent, step, self.config)
        self._sent_at = health.time
        return self._sent

    def order(self, decision: Decision, health: Health, landing: str) -> Order:
        """What to send for a decision but to fly."""
        return order(decision, health, self.config, landing)

    def land(self, reason: str) -> None:
        """Decide to land from now on, unless the drone is landing already or no longer ours."""
        if SEVERITY.index(self._memory.floor.kind) < SEVERITY.index("land"):
            self._memory = replace(self._memory, floor=Decision("land", reason))


def _low(health: Health, config: SafetyConfig) -> bool:
    return health.battery is not None and health.battery < config.low_battery


def _age(since: float | None, now: float) -> float:
    """For how long something has held, s; 0 where it does not."""
    return 0.0 if since is None else now - since


def _since(since: float | None, holds: bool, now: float) -> float | None:
    """Since when something holds without a break."""
    if not holds:
        return None
    return now if since is None else since
