"""Whatever arrives on the link, nothing but what the vehicle itself says changes what we hold true."""

from __future__ import annotations

import random
from dataclasses import replace

import numpy as np
from fuzz import BEAT, STRANGER, VEHICLE, connected, packed, random_packet, strangers
from pymavlink.dialects.v20 import ardupilotmega as m

from cognitivedrone.control.safety import Memory, SafetyConfig, decide, order, shape
from cognitivedrone.vehicles.mavlink.client.health import Asked, Baseline, health_of
from cognitivedrone.vehicles.mavlink.client.link import connection
from cognitivedrone.vehicles.mavlink.client.link.connection import MavlinkConnection

LOITER = m.MAVLink_heartbeat_message(2, 3, 0x81, 5, 4, 3)


def test_a_vehicle_may_move_but_what_queued_up_during_a_stop_of_ours_is_no_move(monkeypatch):
    link, transport = connected()

    def hear(message: m.MAVLink_message, peer: int) -> str:
        transport.feed(packed(message), peer)
        link.step(0.0)
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
            transport.feed(packed(BEAT), VEHICLE)
            link.step(0.0)
        transport.feed(packet, peer)
        link.step(0.0)
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
        transport.feed(random_packet(rng, 1, 1, set()), VEHICLE)
        link.step(0.0)
        link.check()
        asked = Asked(number * 0.02, np.ones(4), 0.0, 0.0, frozenset({link.telemetry.mode}))
        health = health_of(link.telemetry, link.traffic, Baseline(), asked, link.telemetry.received_at)
        decision, memory = decide(health, memory, config)
        order(decision, health, config)
        assert np.isfinite(shape(health, np.zeros(4), 0.1, config)).all()
    assert memory.floor.kind in ("brake", "land", "hands_off")
    link.close()
