"""Heartbeats that are not the vehicle's, or not its newest: one proves nothing, and a pilot's are believed in time."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fuzz import packed
from peer import CALM, FORWARD, MODES, MavlinkDrone, Peer, StillCamera, connect, playing
from peer import flying as in_flight
from pymavlink.dialects.v20 import ardupilotmega as m
from waiting import soon

from cognitivedrone.control.safety import Guard, SafetyConfig
from cognitivedrone.errors import LinkError
from cognitivedrone.vehicles.mavlink import telemetry
from cognitivedrone.vehicles.mavlink.autopilot import PX4
from cognitivedrone.vehicles.mavlink.client import core
from cognitivedrone.vehicles.mavlink.client.handshake import ENDS_BY_ITSELF, MavlinkConfig, must_beat
from cognitivedrone.vehicles.mavlink.client.health import grounded
from cognitivedrone.vehicles.mavlink.client.heartbeats import (
    LASTS_IN_DOUBT_S,
    UNPROVEN_S,
    Flown,
    Heartbeats,
    Shown,
    heard,
)
from cognitivedrone.vehicles.mavlink.guard import drone as guard_drone
from cognitivedrone.vehicles.mavlink.guard.drone import SupervisedDrone
from cognitivedrone.vehicles.mavlink.telemetry import Telemetry

GUIDED = Flown(frozenset({"GUIDED"}), armed=True, grounded="unproven")
FLYING = replace(GUIDED, grounded="no")
LANDING = Flown(frozenset({"LAND"}), armed=True, grounded="yes")


class Ear:
    """Hears heartbeats, each 0.1 s after the one before unless it is given; whose sequence numbers go on by ten."""

    def __init__(self, flown: Flown = GUIDED) -> None:
        self.beats, self.flown, self.now, self.sequence = Heartbeats(), flown, 100.0, 0

    def hears(
        self, mode: str, *, armed: bool = True, after: float = 0.1, sequence: int | None = None, chained: bool = True
    ) -> bool:
        """Whether it is believed."""
        self.now += after
        if sequence is None:
            sequence = self.sequence = (self.sequence + 10) % 256
        shown = Shown(mode, armed, sequence, chained)
        self.beats = heard(self.beats, shown, self.flown, self.now)
        return self.beats.accepts(shown)

    @property
    def suspicion(self) -> str:
        return self.beats.suspicion(self.now)

    @property
    def contradicted(self) -> bool:
        return self.beats.contradicted_at == self.now


def flying(flown: Flown = GUIDED) -> Ear:
    ear = Ear(flown)
    assert all(ear.hears("GUIDED") for _ in range(10))
    return ear


@pytest.mark.parametrize(("mode", "armed"), [("LOITER", True), ("mode 999999", True), ("GUIDED", False)])
def test_one_that_says_otherwise_is_not_believed_and_the_next_contradicts_it(mode, armed):
    ear = flying()
    assert not ear.hears(mode, armed=armed, after=0.05, chained=False)
    assert mode in ear.suspicion
    assert ear.hears("GUIDED", after=0.05)
    assert ear.contradicted
    assert mode in ear.beats.contradiction
    assert ear.suspicion == ""


def test_a_burst_between_two_of_the_vehicles_is_not_believed():
    ear = flying()
    assert not any(ear.hears("LOITER", after=0.004) for _ in range(20))
    assert ear.hears("GUIDED", after=0.02)
    assert ear.contradicted


def test_a_pilots_mode_is_believed_within_its_time():
    ear = flying()
    switched = ear.now
    while not ear.hears("LOITER"):
        assert ear.now - switched < 0.5
    assert ear.now - switched == pytest.approx(0.3)
    assert not ear.contradicted
    assert ear.hears("ALT_HOLD")  # any further one


def test_beside_a_second_vehicle_a_pilot_is_believed_a_little_later():
    ear = flying()
    for _ in range(20):
        assert not ear.hears("LOITER", after=0.05)
        assert ear.hears("GUIDED", after=0.05)
    switched = ear.now
    while not ear.hears("ALT_HOLD", after=0.05):
        ear.hears("LOITER", after=0.05)
        assert ear.now - switched < LASTS_IN_DOUBT_S + 0.3


def test_a_pilot_is_believed_by_the_vehicles_own_sequence_where_another_shows_our_mode():
    ear = flying()
    switched = ear.now
    while not ear.hears("LOITER", after=0.05):
        believed = ear.hears("GUIDED", after=0.05, chained=False)
        assert ear.suspicion  # no mode is ordered
        assert ear.now - switched < 2.0
    assert believed
    assert not ear.hears("GUIDED", after=0.05, chained=False)
    assert ear.beats.believed


def test_no_mode_is_ordered_while_it_is_not_clear_which_heartbeats_are_the_vehicles():
    for chained, suspect in ((False, False), (True, True)):
        ear = flying()
        for _ in range(20):
            ear.hears("LOITER", after=0.05, chained=chained)
            ear.hears("GUIDED", after=0.05)
            assert bool(ear.suspicion) == suspect
        for _ in range(12):
            ear.hears("GUIDED")
        assert ear.suspicion == ""


def test_two_that_are_lost_do_not_let_a_second_vehicle_be_believed_once_it_is_known():
    ear = flying()
    ear.hears("LOITER")
    ear.hears("GUIDED")
    assert not any(ear.hears("LOITER", after=0.05) for _ in range(10))


def test_stopped_motors_of_a_vehicle_that_reports_that_it_flies_are_never_believed():
    ear = flying(FLYING)
    assert not any(ear.hears("GUIDED", armed=False) for _ in range(200))
    assert ear.contradicted
    assert "those of a flight" in ear.beats.contradiction


def test_stopped_motors_far_above_the_take_off_are_believed_late():
    """A slope or a roof; the vehicle does not report whether it stands."""
    ear = flying()
    began = ear.now
    while not ear.hears("GUIDED", armed=False):
        assert ear.now - began < UNPROVEN_S + 0.5
    assert ear.now - began >= UNPROVEN_S


def test_a_landing_is_believed_when_it_was_shown_more_than_once():
    ear = Ear(LANDING)
    ear.hears("LAND")
    assert not ear.hears("LAND", armed=False)
    assert not ear.hears("LAND", armed=False)
    assert ear.hears("LAND", armed=False)


def test_a_landing_beside_another_that_shows_a_mode_is_a_landing():
    ear = Ear(LANDING)
    for _ in range(20):
        ear.hears("LAND", after=0.05)
        ear.hears("LOITER", after=0.05, chained=False)
    while not ear.hears("LAND", armed=False, after=0.05):
        assert not ear.hears("LOITER", after=0.05, chained=False)


def stale(ear: Ear, *sequences: int) -> None:
    """Heartbeats of before the take-off, overtaken."""
    for sequence in sequences:
        assert not ear.hears("STABILIZE", armed=False, after=0.03, sequence=sequence)


def test_heartbeats_that_were_overtaken_at_take_off_are_nobodys():
    ear = Ear(Flown())
    for _ in range(5):
        assert ear.hears("STABILIZE", armed=False)
    assert ear.hears("GUIDED", armed=False)
    stale(ear, 40, 30)
    ear.flown = Flown(frozenset({"GUIDED"}))
    stale(ear, 50, 20, 10)
    assert ear.hears("GUIDED")
    ear.flown = GUIDED
    assert not ear.hears("GUIDED", armed=False, sequence=60, after=0.01)
    stale(ear, 50)
    assert ear.hears("GUIDED")
    assert ear.suspicion == ear.beats.contradiction == ""


def test_sequence_numbers_that_begin_again_are_newer():
    ear = Ear(Flown())
    ear.sequence = 230
    ear.hears("STABILIZE")
    ear.hears("GUIDED")
    ear.flown = GUIDED
    assert not ear.hears("STABILIZE", sequence=3)
    assert "STABILIZE" in ear.suspicion
    assert not ear.hears("STABILIZE", sequence=13)
    assert ear.hears("STABILIZE", sequence=23)  # the pilot's, in the mode of before


def test_two_vehicles_on_the_ground_are_noticed_and_a_switch_that_is_tried_is_not():
    ear = Ear(Flown())
    for mode in ("STABILIZE", "ALT_HOLD", "LOITER", "ALT_HOLD", "STABILIZE"):
        assert ear.hears(mode, after=0.3)
    assert ear.beats.contradiction == ""
    for _ in range(4):
        ear.hears("STABILIZE", after=0.05)
        ear.hears("LOITER", after=0.05)
    assert "LOITER" in ear.beats.contradiction


@pytest.mark.parametrize("counts", [True, False])
@pytest.mark.parametrize("ahead", range(0, 256, 15))
def test_two_vehicles_on_the_ground_are_noticed_wherever_their_sequence_numbers_are(ahead, counts):
    ear, began = Ear(Flown()), 100.0
    while not ear.beats.contradiction:
        ear.hears("STABILIZE", armed=False, after=0.05)
        own = ear.sequence
        ear.hears("LOITER", armed=False, after=0.05, sequence=(own + ahead if counts else ahead) % 256)
        assert ear.now - began < 6.0


@pytest.mark.parametrize(
    ("reported", "stands"),
    [
        (Telemetry(landed=True, landed_at=9.5), "yes"),
        (Telemetry(landed=False, landed_at=9.5), "no"),
        (Telemetry(landed=False, landed_at=8.5), "unproven"),  # and no position
        (Telemetry(position=np.array([3.0, 0, 0.4]), position_at=9.9), "yes"),
        (Telemetry(position=np.array([3.0, 0, 0.6]), position_at=9.9), "unproven"),
        (Telemetry(position=np.array([3.0, 0, 0.1]), position_at=8.9), "unproven"),
        (Telemetry(position=np.zeros(3), velocity=np.array([0.6, 0, 0]), position_at=9.9), "unproven"),
        (Telemetry(position=np.full(3, np.nan), position_at=9.9), "unproven"),
    ],
)
def test_whether_a_vehicle_may_stand(reported, stands):
    assert grounded(reported, np.zeros(3), 10.0) == stands


def test_our_heartbeats_go_on_only_where_silence_would_act_against_the_pilot():
    flown = Telemetry(mode="LOITER", armed=True)
    assert not must_beat(flown, (), 0.0)
    assert not must_beat(flown, ("GUID_TIMEOUT",), 0.0)
    assert must_beat(flown, ("FS_GCS_ENABLE",), 1.0)
    assert not must_beat(flown, ("FS_GCS_ENABLE",), 4.0)
    assert must_beat(replace(flown, armed=False), (), 9.0)
    for mode in ENDS_BY_ITSELF:
        assert must_beat(replace(flown, mode=mode), (), 99.0)
    # Which acts when our velocities stop, and in a pilot's mode when our heartbeats do.
    assert must_beat(replace(flown, mode="POSCTL"), (), 99.0, PX4)


# Over a socket.

FAST = MavlinkConfig(ready_timeout_s=5, takeoff_timeout_s=5, landing_timeout_s=10)
RULES = replace(CALM, land_after_brake_s=0.3)
COPTER, ARDUPILOT = m.MAV_TYPE_QUADROTOR, m.MAV_AUTOPILOT_ARDUPILOTMEGA


def beat(mode: int = MODES["GUIDED"], *, armed: bool = True, kind: int = COPTER, autopilot: int = ARDUPILOT) -> Any:
    return m.MAVLink_heartbeat_message(kind, autopilot, 0x81 if armed else 1, mode, 4, 3)


@contextmanager
def in_the_air(peer: Peer, safety: SafetyConfig = RULES) -> Iterator[MavlinkDrone]:
    with in_flight(peer, safety, FAST) as drone:
        drone.send(FORWARD)
        yield drone


def fly_until(drone: MavlinkDrone, holds: Callable[[], object]) -> None:
    """Fly on with a good policy until it holds."""
    deadline = time.monotonic() + 60
    while not holds():
        assert time.monotonic() < deadline, drone.decision
        drone.observe()
        drone.send(FORWARD)
        time.sleep(0.005)


ATTACKS = {
    "disarmed": (beat(armed=False), "contradict"),
    "LOITER": (beat(MODES["LOITER"]), "contradict"),
    "another type": (beat(MODES["LOITER"], armed=False, kind=m.MAV_TYPE_FIXED_WING), "MAV_TYPE 1 "),
    "another autopilot": (beat(autopilot=m.MAV_AUTOPILOT_PX4), "MAV_AUTOPILOT 12"),
}


@pytest.mark.parametrize("attack", ATTACKS)
def test_one_heartbeat_of_another_brings_it_down_and_is_said_to_be_that(attack):
    packet, words = ATTACKS[attack]
    with playing() as peer:
        with in_the_air(peer) as drone:
            fly_until(drone, lambda: not drone.link.heartbeats.left)  # else it may be one that was overtaken
            peer.say_as_another(packet)
            fly_until(drone, lambda: drone.over)
            assert drone.decision.kind == "land"
            assert "sends as the vehicle" in drone.over
            assert words in drone.over
        assert (peer.part.mode, peer.part.armed) == (MODES["LAND"], False)


def test_one_in_our_landing_is_no_landing():
    with playing() as peer, in_the_air(peer) as drone:
        peer.part.deaf_to = frozenset({m.MAV_CMD_DO_SET_MODE})
        drone._core.land("enough")
        soon(lambda: drone.decision.kind == "land")
        peer.say_as_another(*[beat(armed=False)] * 3)
        beats = drone.telemetry.heartbeat_at
        soon(lambda: drone.telemetry.heartbeat_at > beats + 0.3)
        assert (drone._core.phase, drone.telemetry.armed, peer.part.armed) == ("flying", True, True)
        peer.part.deaf_to = frozenset()
        fly_until(drone, lambda: drone._core.phase == "released")
        assert not peer.part.armed


def test_one_in_the_climb_brings_it_down():
    with playing(climbs=False) as peer:
        with connect(peer, FAST, RULES) as drone:
            say = peer._do

            def do(message: Any) -> None:
                say(message)
                if message.command == m.MAV_CMD_NAV_TAKEOFF:
                    peer.say_as_another(beat(MODES["LOITER"]))

            peer._do = do
            with pytest.raises(
                LinkError,
                match=r"landing was ordered during take-off: somebody else sends as the vehicle.*LOITER, then",
            ):
                drone.take_off(lambda _: True)
            soon(lambda: drone.over)
            assert "contradict" in drone.over
        assert (peer.part.mode, peer.part.armed) == (MODES["LAND"], False)


def test_a_second_vehicle_on_the_ground_is_a_bad_row():
    loiter = beat(MODES["LOITER"], armed=False)
    with playing() as peer:
        with connect(peer, FAST, RULES) as drone:
            peer.part.also = (packed(loiter),)
            soon(lambda: drone.link.traffic.impostor)
            with pytest.raises(LinkError, match=r"(?s)\[bad \] sender.*contradict each other"):
                drone.take_off(lambda _: True)
        assert not peer.part.armed


def test_a_second_vehicle_that_never_ends_does_not_take_the_drone():
    with playing() as peer:
        with in_the_air(peer) as drone:
            other = m.MAVLink(None, srcSystem=1, srcComponent=1)
            peer.part.also = tuple(bytes(beat(MODES["LOITER"], armed=armed).pack(other)) for armed in (True, False))
            fly_until(drone, lambda: drone.over)
            assert drone.decision.kind == "land"
            fly_until(drone, lambda: peer.part.mode == MODES["LAND"])
            peer.part.also = ()
        assert not peer.part.armed


def test_while_a_heartbeat_is_doubted_no_mode_is_ordered_and_the_drone_is_stopped():
    with playing() as peer, in_the_air(peer, replace(RULES, land_after_brake_s=60.0)) as drone:
        peer.part.quiet = frozenset({"HEARTBEAT"})
        soon(lambda: time.monotonic() - drone.telemetry.heartbeat_at > 0.1)
        peer.say_as_another(beat(MODES["LOITER"]))
        fly_until(drone, lambda: drone.decision.kind == "hold")
        assert "LOITER" in drone.decision.reason
        before = time.monotonic()
        drone._core.land("enough")
        fly_until(drone, lambda: [s for s in peer.setpoints_since(before) if s[2] > 0])
        assert peer.modes_ordered(since=before) == []
        peer.part.quiet = frozenset()
        fly_until(drone, lambda: peer.part.mode == MODES["LAND"])


@pytest.mark.parametrize("guarded", [True, False])
def test_a_landing_that_nobody_can_see_ends_with_a_sentence(monkeypatch, guarded):
    for module in (core, guard_drone):
        monkeypatch.setattr(module, "LANDING_SILENT_S", 0.5)
        monkeypatch.setattr(telemetry, "LANDING_SILENT_S", 0.5)
    with playing() as peer:
        url, camera = f"udpout:127.0.0.1:{peer.port}", StillCamera()
        drone = SupervisedDrone(url, camera, RULES, FAST) if guarded else MavlinkDrone(url, camera, Guard(RULES), FAST)
        try:
            drone.take_off(lambda _: True)
            peer.part.quiet = frozenset({"HEARTBEAT", "ATTITUDE", "LOCAL_POSITION_NED", "SYS_STATUS"})
            peer.part.also = (packed(m.MAVLink_statustext_message(3, b"a text")),) * 10
            with pytest.raises(LinkError, match=r"no heartbeat of the vehicle for \d+ s.*take over by hand"):
                drone.close()
        finally:
            if isinstance(drone, SupervisedDrone):
                drone._process.kill()
                drone._process.wait()
