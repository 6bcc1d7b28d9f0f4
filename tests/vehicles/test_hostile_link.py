"""Whatever arrives at either end of a link: nothing but what the vehicle itself says changes what we hold true.

All that the rules judge by is decoded, nothing grows without end, and nothing steers.
"""

import random
import tracemalloc
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from fuzz import BEAT, STRANGER, VEHICLE, connected, packed, random_packet, strangers
from peer import FORWARD, MODES, connect, playing
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as m

from cognitivedrone.control.safety import Memory, SafetyConfig, decide, order, shape
from cognitivedrone.errors import LinkError
from cognitivedrone.sim.simulator import Simulator
from cognitivedrone.vehicles.mavlink.client import connection
from cognitivedrone.vehicles.mavlink.client.connection import MavlinkConnection
from cognitivedrone.vehicles.mavlink.client.health import Asked, Baseline, health_of
from cognitivedrone.vehicles.mavlink.client.traffic import (
    NEEDED,
    OTHERS_HZ,
    MessageDecoder,
    Traffic,
    noticed,
    number_of,
)
from cognitivedrone.vehicles.mavlink.server.modes import Mode
from cognitivedrone.vehicles.mavlink.server.vehicle import SimulatedVehicle, VehicleConfig

COUNT = 10_000
GCS_BEAT = m.MAVLink_heartbeat_message(m.MAV_TYPE_GCS, m.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)


@pytest.mark.parametrize("wire", ["MAVLink 1", "signed"])
def test_a_vehicle_is_flown_whatever_kind_of_packet_it_sends(wire):
    with playing(wire=wire) as peer:
        with connect(peer) as drone:
            drone.take_off(lambda checklist: not checklist.bad)
            sent = drone.send(FORWARD)
            assert drone.decision.kind == "fly"
            assert sent[0] > 0
        assert (peer.part.mode, peer.part.armed) == (MODES["LAND"], False)


def test_a_vehicle_that_takes_signed_packets_alone_is_said_to(monkeypatch):
    monkeypatch.setattr("cognitivedrone.vehicles.mavlink.client.connection.ACK_S", 0.1)
    with playing(wire="signed only") as peer:
        with pytest.raises(LinkError, match=r"did not answer to .*; it signs its packets, and may ignore ours"):
            connect(peer)
        assert not peer.part.armed


FLOODS: dict[str, Callable[[int], bytes]] = {
    "parameters": lambda n: packed(m.MAVLink_param_value_message(f"P{n}".encode(), 1.0, 9, COUNT, n)),
    "acknowledgements": lambda n: packed(m.MAVLink_command_ack_message(n, 0)),
    "mission items": lambda n: packed(
        m.MAVLink_mission_item_int_message(255, 191, n, 3, 16, 2, 1, *[0] * 4, 1, 2, 3.0)
    ),
    "ground stations": lambda n: packed(GCS_BEAT, 2 + n % 250, 1 + n // 250),
    "status texts": lambda n: packed(m.MAVLink_statustext_message(3, f"text {n}".encode())),
}
"""Packets that reach a connection, by their numbers."""


def held() -> int:
    """Bytes that the code of links holds of what was allocated since tracing began, without that of other tests."""
    ours = [tracemalloc.Filter(True, pattern) for pattern in ("*/cognitivedrone/*", "*/pymavlink/*")]
    return sum(line.size for line in tracemalloc.take_snapshot().filter_traces(ours).statistics("filename"))


@pytest.mark.parametrize("kind", FLOODS)
def test_a_flood_at_the_client_fills_no_memory(kind):
    link, transport = connected()
    packets = [FLOODS[kind](number) for number in range(COUNT)]

    try:
        for number, packet in enumerate(packets):
            if number == COUNT // 10:
                tracemalloc.start()
            transport.hear(packet)
        grown = held()
    finally:
        tracemalloc.stop()
        link.close()
    assert grown < 400_000


def test_an_answer_that_was_asked_for_is_kept_in_a_flood():
    link, transport = connected()
    link.send_parameter("FS_OPTIONS", 16.0)
    for number in range(100):
        transport.hear(FLOODS["parameters"](number))
    transport.hear(packed(m.MAVLink_param_value_message(b"FS_OPTIONS", 16.0, 9, 1, 0)))
    assert link.reported_parameter("FS_OPTIONS") == 16.0
    assert link.reported_parameter("P1") is None
    link.send_parameter("FS_OPTIONS", 16.0)
    for value in (float("nan"), float("inf")):
        transport.hear(packed(m.MAVLink_param_value_message(b"FS_OPTIONS", value, 9, 1, 0)))
        assert link.reported_parameter("FS_OPTIONS") is None  # as if it had not answered
    link.close()


def test_who_hides_our_silence_is_seen_behind_a_crowd_of_ground_stations():
    traffic, decoder = Traffic(), m.MAVLink(None)
    for system, component in [*((2 + number, 190) for number in range(100)), (255, 190), (255, 189)]:
        (beat,) = decoder.parse_buffer(packed(GCS_BEAT, system, component))
        traffic = noticed(traffic, beat, (1, 1), 7.0)
    assert traffic.masks == ((255, 190),)
    assert len(traffic.ground_stations) <= 17


@pytest.fixture(scope="module")
def simulator() -> Simulator:
    return Simulator(render=False)


@pytest.mark.parametrize("wire", ["MAVLink 1", "MAVLink 2", "signed"])
def test_the_simulated_vehicle_is_steered_by_no_mission_item_and_filled_by_no_flood(simulator, wire):
    with SimulatedVehicle(simulator, VehicleConfig(links=("udpin:127.0.0.1:0",))) as vehicle:
        link = mavutil.mavlink_connection(
            f"udpout:127.0.0.1:{vehicle.addresses[0][1]}", source_system=255, force_connected=True
        )
        if wire == "signed":
            link.setup_signing(b"k" * 32, allow_unsigned_callback=lambda _mav, _number: True)

        def say(*messages: m.MAVLink_message) -> None:
            for message in messages:
                link.mav.send(message, force_mavlink1=wire == "MAVLink 1")
            vehicle.step()

        say(GCS_BEAT)
        say(m.MAVLink_command_long_message(1, 1, m.MAV_CMD_DO_SET_MODE, 0, 1, Mode.GUIDED, 0, 0, 0, 0, 0))
        say(m.MAVLink_command_long_message(1, 1, m.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0))
        say(m.MAVLink_command_long_message(1, 1, m.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 0, 2))
        vehicle.step(600)
        before, parameters = vehicle.state().position.copy(), {n: vehicle.parameters[n] for n in vehicle.parameters}
        assert before[2] > 1.5

        def attack(rounds: int) -> None:
            for number in range(rounds):
                say(
                    m.MAVLink_mission_count_message(1, 1, 60_000),
                    m.MAVLink_mission_item_message(1, 1, number, 3, 16, 2, 1, 0, 0, 0, 0, 9, 9, 9.0),
                    m.MAVLink_mission_item_int_message(1, 1, number, 6, 16, 2, 1, 0, 0, 0, 0, 9, 9, 9.0),
                    m.MAVLink_param_set_message(1, 1, f"P{number}".encode(), 1.0, 9),
                    m.MAVLink_param_request_list_message(1, 1),
                    m.MAVLink_param_request_read_message(1, 1, f"P{number}".encode(), -1),
                    GCS_BEAT,
                )

        attack(50)
        tracemalloc.start()
        attack(200)
        grown = held()
        tracemalloc.stop()
        link.close()
        assert grown < 400_000
        assert np.linalg.norm(vehicle.state().position - before) < 0.2
        assert (vehicle.modes.mode, vehicle.modes.armed) == (Mode.GUIDED, True)
        assert {n: vehicle.parameters[n] for n in vehicle.parameters} == parameters


# What changes what we hold true.


LOITER = m.MAVLink_heartbeat_message(2, 3, 0x81, 5, 4, 3)


def test_a_vehicle_may_move_but_what_queued_up_during_a_stop_of_ours_is_no_move(monkeypatch):
    link, transport = connected()

    def hear(message: m.MAVLink_message, peer: int) -> str:
        transport.hear(packed(message), peer)
        return link.telemetry.mode

    monkeypatch.setattr(connection, "MOVED_S", 0.0)
    assert hear(LOITER, STRANGER) == "GUIDED"
    assert hear(BEAT, VEHICLE) == "GUIDED"
    assert hear(LOITER, STRANGER) == "GUIDED"
    monkeypatch.setattr(connection, "ALONE_S", 0.0)
    assert hear(LOITER, STRANGER) == "LOITER"
    link.close()


def held_true(link: MavlinkConnection) -> tuple[object, ...]:
    telemetry = replace(link.telemetry, received_at=0, heartbeat_at=0, position=np.zeros(3), velocity=np.zeros(3))
    traffic = replace(link.traffic, ignored=0, broken=0, impostor_at=0)
    known = np.isfinite(link.telemetry.position).all()
    return str(telemetry), known, traffic, link.vehicle, {k: v for k, v in link._replies.items() if k != "HEARTBEAT"}


def test_nothing_but_counters_change():
    link, transport = connected()
    before = held_true(link)
    for number, (packet, peer) in enumerate(strangers(random.Random(5), 2000)):
        if number % 20 == 0:
            transport.hear(packed(BEAT))
        transport.hear(packet, peer)
        link.check()
    assert held_true(link) == before
    assert link.traffic.broken > 500
    assert link.traffic.ignored > 200
    assert link.traffic.impostor_at > 0
    link.close()


def test_whatever_the_vehicle_itself_says_the_rules_have_an_answer():
    link, transport = connected()
    rng, memory, config = random.Random(6), Memory(), SafetyConfig()
    for number in range(2000):
        transport.hear(random_packet(rng, 1, 1, set()))
        link.check()
        asked = Asked(number * 0.02, np.ones(4), 0.0, 0.0, frozenset({link.telemetry.mode}))
        health = health_of(link.telemetry, link.traffic, Baseline(), asked, link.telemetry.received_at)
        decision, memory = decide(health, memory, config)
        order(decision, health, config)
        assert np.isfinite(shape(health, np.zeros(4), 0.1, config)).all()
    assert memory.floor.kind in ("brake", "land", "hands_off")
    link.close()


# What is decoded: all that the rules judge by, and only so much of the rest.


TEXT = m.MAVLink_statustext_message(3, b"again")
NAMES = {
    *("HEARTBEAT", "SYS_STATUS", "ATTITUDE", "LOCAL_POSITION_NED", "RC_CHANNELS", "COMMAND_ACK", "TIMESYNC"),
    *("POSITION_TARGET_LOCAL_NED", "EKF_STATUS_REPORT", "ESTIMATOR_STATUS", "EXTENDED_SYS_STATE"),
}


def test_what_is_always_decoded_is_what_the_rules_judge_by():
    assert {m.mavlink_map[number].msgname for number in NEEDED} == NAMES


@pytest.mark.parametrize("old", [True, False])
def test_the_number_of_a_packet_is_read_without_decoding_it(old):
    for message in (BEAT, TEXT, m.MAVLink_extended_sys_state_message(0, 1)):
        packet = bytes(message.pack(m.MAVLink(None), force_mavlink1=old))
        assert number_of(packet) == message.get_msgId()
        assert number_of(packet + b"\0") is None
        assert number_of(packet[:-1]) is None
    assert number_of(b"") is None


def test_a_signed_packet_is_read_as_well():
    mav = m.MAVLink(None)
    mav.signing.secret_key, mav.signing.sign_outgoing = b"k" * 32, True
    assert number_of(bytes(TEXT.pack(mav))) == 253


def test_a_flood_of_texts_is_dropped_and_every_heartbeat_between_them_is_decoded():
    decoder, texts, beats = MessageDecoder(datagrams=True), 0, 0
    for step in range(5000):
        now = 100 + step / 5000
        texts += len(list(decoder.messages(packed(TEXT), now)))
        if step % 10 == 0:
            beats += len(list(decoder.messages(packed(BEAT), now)))
    assert beats == 500
    assert OTHERS_HZ <= texts <= 2 * OTHERS_HZ + 1
    assert decoder.dropped == 5000 - texts
    parameter = packed(m.MAVLink_param_value_message(b"FS_OPTIONS", 16.0, 9, 1, 0))
    assert len(list(decoder.messages(parameter, 101.0))) == 1  # another kind
    assert len(list(decoder.messages(packed(TEXT), 102.0))) == 1


def test_a_stream_is_decoded_across_its_reads():
    decoder, data = MessageDecoder(datagrams=False), packed(BEAT) + packed(TEXT)
    found = [message.get_type() for byte in data for message in decoder.messages(bytes([byte]), 0.0)]
    assert found == ["HEARTBEAT", "STATUSTEXT"]
