"""How long it takes from a fault in flight to a safe command, over a loopback socket and with the default rules.

Run: python benchmarks/fault_times.py

Seven flights for each fault against the scripted vehicle of the tests, which reports its state and mode 50 times a
second. A silent policy is at fault from when its next command is due, 0.1 s after its last.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "vehicles"))

from peer import MODES, Peer, StillCamera, playing
from test_hazards import FAULTS as VEHICLE_FAULTS
from test_hazards import NAMES

from cognitivedrone.control.safety import Guard
from cognitivedrone.vehicles.mavlink.client.drone import MavlinkDrone

FORWARD = np.array([1, 0, 0, 0], dtype=np.float32)
FLIGHTS = 7


def fly_on(drone: MavlinkDrone, seconds: float) -> None:
    """A good policy, for a while."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        drone.observe()
        drone.send(FORWARD)
        time.sleep(0.05)


def stopped(peer: Peer, since: float) -> float:
    """When the vehicle got the first zero velocity since then."""
    while not any(not any(velocity) for velocity in peer.setpoints_since(since)):
        time.sleep(0.001)
    times: Iterator[float] = (
        at for at, s in peer.heard if at >= since and s.get_type() == "SET_POSITION_TARGET_LOCAL_NED" and s.vx == 0
    )
    return next(times)


def not_a_number(peer: Peer, drone: MavlinkDrone) -> float:
    fault = time.monotonic()
    drone.send(np.full(4, np.nan, dtype=np.float32))
    return stopped(peer, fault) - fault


def silent_policy(peer: Peer, drone: MavlinkDrone) -> float:
    drone.send(FORWARD)
    last = time.monotonic()
    time.sleep(0.02)
    return stopped(peer, last + 0.02) - (last + 0.1)


def link_cut(peer: Peer, drone: MavlinkDrone) -> float:
    fault = time.monotonic()
    peer.part.mute = True
    fly_on(drone, 0.4)
    peer.part.mute = False
    return stopped(peer, fault) - fault


def mode_change(peer: Peer, drone: MavlinkDrone) -> float:
    fault = time.monotonic()
    peer.part.mode = MODES["LOITER"]
    while drone.over is None:
        time.sleep(0.001)
    return time.monotonic() - fault


FAULTS: tuple[Callable[[Peer, MavlinkDrone], float], ...] = (not_a_number, silent_policy, link_cut, mode_change)


def of_the_vehicle(
    inject: Callable[[Peer], None],
) -> Callable[[Peer, MavlinkDrone], float]:
    """From a fault of the vehicle to the decision not to fly on, under the rules as they come."""

    def fault(peer: Peer, drone: MavlinkDrone) -> float:
        began = time.monotonic()
        inject(peer)
        while drone.decision is not None and drone.decision.kind == "fly":
            drone.observe()
            drone.send(FORWARD)
            time.sleep(0.005)
        return time.monotonic() - began

    return fault


def timed(name: str, fault: Callable[[Peer, MavlinkDrone], float], flights: int) -> None:
    """Print how long it takes until something safe is done."""
    times = []
    for _ in range(flights):
        with playing() as peer, MavlinkDrone(f"udpout:127.0.0.1:{peer.port}", StillCamera(), Guard()) as drone:
            drone.take_off(lambda _: True)
            fly_on(drone, 0.4)
            times.append(1000 * fault(peer, drone))
    print(f"{name:<16} median {statistics.median(times):4.0f} ms, worst {max(times):4.0f} ms", flush=True)


def main() -> None:
    flights = int(sys.argv[1]) if len(sys.argv) > 1 else FLIGHTS
    for fault in FAULTS:
        timed(fault.__name__, fault, flights)
    for name, (inject, *_) in zip(NAMES, VEHICLE_FAULTS, strict=True):
        timed(name, of_the_vehicle(inject), flights)


if __name__ == "__main__":
    main()
