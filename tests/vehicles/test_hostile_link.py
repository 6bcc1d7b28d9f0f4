"""Packets of other kinds, and floods of them, at both ends of a link: nothing grows without end, and nothing steers."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator

import numpy as np
import pytest
from fuzz import VEHICLE, connected, packed
from peer import FORWARD, MODES, connect, playing
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as m

from cognitivedrone.errors import LinkError
from cognitivedrone.sim.simulator import Simulator
from cognitivedrone.vehicles.mavlink.client.link.traffic import Traffic, noticed
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
    monkeypatch.setattr("cognitivedrone.vehicles.mavlink.client.link.connection.ACK_S", 0.1)
    with playing(wire="signed only") as peer:
        with pytest.raises(LinkError, match=r"did not answer to .*; it signs its packets, and may ignore ours"):
            connect(peer)
        assert not peer.part.armed


def flood(kind: str) -> Iterator[tuple[bytes, int]]:
    """Packets that reach a connection, with their senders."""
    for number in range(COUNT):
        match kind:
            case "parameters":
                yield packed(m.MAVLink_param_value_message(f"P{number}".encode(), 1.0, 9, COUNT, number)), VEHICLE
            case "acknowledgements":
                yield packed(m.MAVLink_command_ack_message(number, 0)), VEHICLE
            case "mission items":
                item = m.MAVLink_mission_item_int_message(255, 191, number, 3, 16, 2, 1, 0, 0, 0, 0, 1, 2, 3.0)
                yield packed(item), VEHICLE
            case "ground stations":
                yield packed(GCS_BEAT, 2 + number % 250, 1 + number // 250), VEHICLE
            case "status texts":
                yield packed(m.MAVLink_statustext_message(3, f"text {number}".encode())), VEHICLE


@pytest.mark.parametrize("kind", ["parameters", "acknowledgements", "mission items", "ground stations", "status texts"])
def test_a_flood_at_the_client_fills_no_memory(kind):
    link, transport = connected()
    packets = list(flood(kind))

    def take(some: list[tuple[bytes, int]]) -> None:
        for packet, peer in some:
            transport.feed(packet, peer)
            link.step(0.0)

    try:
        take(packets[: COUNT // 10])
        tracemalloc.start()
        take(packets[COUNT // 10 :])
        grown, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
        link.close()
    assert grown < 400_000


def test_an_answer_that_was_asked_for_is_kept_in_a_flood():
    link, transport = connected()
    link.send_parameter("FS_OPTIONS", 16.0)
    for packet, peer in list(flood("parameters"))[:100]:
        transport.feed(packet, peer)
        link.step(0.0)
    transport.feed(packed(m.MAVLink_param_value_message(b"FS_OPTIONS", 16.0, 9, 1, 0)), VEHICLE)
    link.step(0.0)
    assert link.reported_parameter("FS_OPTIONS") == 16.0
    assert link.reported_parameter("P1") is None
    link.send_parameter("FS_OPTIONS", 16.0)
    for value in (float("nan"), float("inf")):
        transport.feed(packed(m.MAVLink_param_value_message(b"FS_OPTIONS", value, 9, 1, 0)), VEHICLE)
        link.step(0.0)
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
        grown, _ = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        link.close()
        assert grown < 400_000
        assert np.linalg.norm(vehicle.state().position - before) < 0.2
        assert (vehicle.modes.mode, vehicle.modes.armed) == (Mode.GUIDED, True)
        assert {n: vehicle.parameters[n] for n in vehicle.parameters} == parameters
