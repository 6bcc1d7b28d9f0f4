"""Flights of the simulated vehicle with a random fault every 20 s: no unsafe end, and no memory that grows.

Run: python benchmarks/random_faults.py [--minutes 60] [--at-once 1] [--every 20] [--seed 0]
    [--out results/random_faults.json]

A guard process flies the simulated vehicle over UDP, in real time, through a relay that loses, cuts and adds packets.
A pilot asks for a random velocity ten times a second, up to twice what the limits allow, and back to its take-off
where it comes near the fence. After `--every` seconds in the air one fault of `FAULTS`, drawn at random, happens. Some
pass, and the flight must go on; some must end it, on the ground or in the pilot's hand, and the next flight begins.
`--minutes` counts time in the air; `--at-once` vehicles share it. Unsafe are: flying on, or still in the air 30 s
after a fault that must end the flight; landing for one that must not; a speed beyond the limits; more than 3 m outside
the fence; a touchdown faster than 1 m/s; a mode that changes after the pilot has chosen one. Exit code 1 where there
was any.
"""

from __future__ import annotations

import os
import random
import signal
import socket
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "vehicles"))

from peer import StillCamera
from sitl_vehicle import come_first

from cognitivedrone.benchmark.measurements import keep
from cognitivedrone.control.safety import SafetyConfig
from cognitivedrone.control.safety.fence import Fence, outside_by
from cognitivedrone.errors import LinkError
from cognitivedrone.frames import world_to_heading, yaw_of
from cognitivedrone.sim.simulator import Simulator
from cognitivedrone.types import DroneState, FloatArray
from cognitivedrone.vehicles.mavlink.client.handshake import MavlinkConfig
from cognitivedrone.vehicles.mavlink.guard.drone import GuardedDrone
from cognitivedrone.vehicles.mavlink.server.modes import Mode
from cognitivedrone.vehicles.mavlink.server.vehicle import SimulatedVehicle, VehicleConfig, serve

FENCE = Fence(radius_m=8.0, ceiling_m=4.0)
END_S, FAST_M_S, SOFT_M_S, OUTSIDE_M = 30.0, 4.6, 1.0, 3.0
"""The limits allow (3, 3, 1.5) m/s, 4.5 m/s in all; a gust of the controller's own comes on top."""
NEAR_M, LOW_M, HIGH_M = 3.5, 0.8, 2.8
"""Farther from the take-off, or lower or higher, the pilot asks for the way back: the fence ends flights outside."""
PASSES_S = 3.0
"""After a fault that passes, the drone must be flown again within so long."""


@dataclass(frozen=True)
class Config:
    """How long, and how many."""

    minutes: float = 60.0
    at_once: int = 1
    every: float = 20.0
    seed: int = 0
    out: Path | None = None
    """File for the figures."""


class Relay:
    """Between the guard and the vehicle: drops what it is told to, and adds noise."""

    def __init__(self, vehicle: tuple[str, int]) -> None:
        self.up = self.down = True
        self.noise = 0.0
        """How many packets of noise come with every packet of the vehicle."""
        self._vehicle = vehicle
        self._sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)]
        for each in self._sockets:
            each.bind(("127.0.0.1", 0))
            each.settimeout(0.1)
        self.url = f"udpout:127.0.0.1:{self._sockets[0].getsockname()[1]}"
        self._guard: Any = None
        self._stop = threading.Event()
        self._threads = [threading.Thread(target=each, daemon=True) for each in (self._upwards, self._downwards)]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        self._stop.set()
        for thread in self._threads:
            thread.join()
        for each in self._sockets:
            each.close()

    def _upwards(self) -> None:
        while not self._stop.is_set():
            with suppress(OSError):
                data, self._guard = self._sockets[0].recvfrom(4096)
                if self.up:
                    self._sockets[1].sendto(data, self._vehicle)

    def _downwards(self) -> None:
        while not self._stop.is_set():
            with suppress(OSError):
                data = self._sockets[1].recv(4096)
                if self.down and self._guard is not None:
                    self._sockets[0].sendto(data, self._guard)
                    if random.random() < self.noise:
                        self._sockets[0].sendto(random.randbytes(random.randrange(1, 300)), self._guard)


@dataclass
class Flight:
    """What a fault can reach."""

    vehicle: SimulatedVehicle
    relay: Relay
    drone: GuardedDrone
    draw: random.Random
    silent_until: float = 0.0
    """The pilot sends nothing until then."""
    mode: Mode | None = None
    """What the pilot with the remote control has chosen."""
    unsafe: list[str] = field(default_factory=list)


Inject = Callable[[Flight], None]


def _for_a_while(flight: Flight, seconds: float, **relay: Any) -> None:
    before = {name: getattr(flight.relay, name) for name in relay}
    for name, value in relay.items():
        setattr(flight.relay, name, value)

    def restore() -> None:
        for name, value in before.items():
            setattr(flight.relay, name, value)

    threading.Timer(seconds, restore).start()


def _signal(flight: Flight, number: int) -> None:
    with suppress(ProcessLookupError):
        os.kill(flight.drone.process, number)


def _stop_guard(flight: Flight, seconds: float) -> None:
    _signal(flight, signal.SIGSTOP)
    time.sleep(seconds)
    _signal(flight, signal.SIGCONT)


def _take_over(flight: Flight) -> None:
    flight.mode = flight.draw.choice([Mode.STABILIZE, Mode.ALT_HOLD, Mode.LOITER, Mode.BRAKE, Mode.RTL, Mode.LAND])
    flight.vehicle.pilot(flight.mode)


def _nan(flight: Flight) -> None:
    with suppress(LinkError):
        flight.drone.send(np.array([np.nan, np.inf, 0, 0], np.float32))


def _nonsense(flight: Flight, messages: int) -> None:
    for _ in range(messages):
        with suppress(OSError):
            flight.drone._socket.send(flight.draw.randbytes(flight.draw.randrange(1, 200)))


def _battery(flight: Flight) -> None:
    flight.vehicle.battery = 0.1


def _silent(flight: Flight, seconds: float) -> None:
    flight.silent_until = time.monotonic() + seconds


PASSING: dict[str, Inject] = {
    "commands late by 0.6 s": lambda f: _silent(f, 0.6),
    "a command that is not a number": _nan,
    "three messages of nonsense": lambda f: _nonsense(f, 3),
    "downlink lost for 0.4 s": lambda f: _for_a_while(f, 0.4, down=False),
    "uplink lost for 0.4 s": lambda f: _for_a_while(f, 0.4, up=False),
    "link lost for 0.3 s": lambda f: _for_a_while(f, 0.3, up=False, down=False),
    "noise on the link for 5 s": lambda f: _for_a_while(f, 5.0, noise=0.5),
    "guard stopped for 0.2 s": lambda f: _stop_guard(f, 0.2),
}
ENDING: dict[str, Inject] = {
    "pilot silent": lambda f: _silent(f, 1e9),
    "nonsense without end": lambda f: _nonsense(f, 100),
    "downlink lost for 8 s": lambda f: _for_a_while(f, 8.0, down=False),
    "uplink lost for 8 s": lambda f: _for_a_while(f, 8.0, up=False),
    "link lost for 8 s": lambda f: _for_a_while(f, 8.0, up=False, down=False),
    "guard stopped for 2 s": lambda f: _stop_guard(f, 2.0),
    "guard killed (-9)": lambda f: _signal(f, signal.SIGKILL),
    "SIGTERM to the guard": lambda f: _signal(f, signal.SIGTERM),
    "SIGHUP to the guard": lambda f: _signal(f, signal.SIGHUP),
    "battery low": _battery,
    "take-over": _take_over,
}
FAULTS = PASSING | ENDING
BY_THE_FENCE = "landed because it stayed outside the fence"


@dataclass
class Result:
    """Of one vehicle."""

    air_s: float = 0.0
    faults: Counter[str] = field(default_factory=Counter)
    unsafe: list[str] = field(default_factory=list)
    guards_mb: list[tuple[float, float]] = field(default_factory=list)
    """Resident memory of each guard, at take-off and at its end."""
    own_mb: list[float] = field(default_factory=list)
    """Of this process with vehicle, relay and pilot, after each flight."""


def fly_all(config: Config, seed: int) -> Result:
    """Fly until there was enough time in the air."""
    draw, result = random.Random(seed), Result()
    come_first()
    with tempfile.TemporaryDirectory() as folder, sky() as vehicle:
        os.environ["XDG_STATE_HOME"] = folder
        relay = Relay(vehicle.addresses[0])
        while result.air_s < 60 * config.minutes / config.at_once:
            vehicle.battery = 1.0
            _fly(config, vehicle, relay, draw, result)
            result.own_mb.append(_resident_mb(os.getpid()))
        relay.close()
    return result


def _fly(config: Config, vehicle: SimulatedVehicle, relay: Relay, draw: random.Random, result: Result) -> None:
    """One flight, from take-off until it is on the ground."""
    relay.up = relay.down = True
    mavlink = MavlinkConfig(set_parameters=True, takeoff_height_m=1.5, ceiling_m=FENCE.ceiling_m)
    drone = GuardedDrone(relay.url, StillCamera(), SafetyConfig(fence=FENCE), mavlink)
    flight = Flight(vehicle, relay, drone, draw)
    try:
        drone.take_off(lambda _: True)
        home, began, first_mb = vehicle.state().position.copy(), time.monotonic(), _resident_mb(drone.process)
        last_mb, name = first_mb, ""
        while name not in ENDING:
            _pilot(flight, home, time.monotonic() + config.every)
            if "outside the fence" in (drone.over or ""):  # where the random velocities have taken it
                name = BY_THE_FENCE
                break
            if not flight.unsafe and (drone.over or not vehicle.modes.armed):
                flight.unsafe.append(f"ended by itself, or by {name or 'nothing'}: {drone.over}")
            if flight.unsafe:
                break
            last_mb = _resident_mb(drone.process)
            name = draw.choice(list(FAULTS))
            result.faults[name] += 1
            FAULTS[name](flight)
            if name in PASSING:
                _pilot(flight, home, time.monotonic() + PASSES_S)
        result.guards_mb.append((first_mb, last_mb))
        result.faults[BY_THE_FENCE] += name == BY_THE_FENCE
        _end(flight, home, name)
        result.air_s += time.monotonic() - began
        result.unsafe += [f"{name}: {what}" for what in flight.unsafe]
    finally:
        vehicle.pilot(Mode.LAND)
        _wait(lambda: not vehicle.modes.armed, END_S)
        _signal(flight, signal.SIGKILL)
        with suppress(LinkError):
            drone.close()
        time.sleep(1.0)  # its mode is its own again


def _pilot(flight: Flight, home: FloatArray, done_at: float) -> None:
    """Ask for velocities until then, and see that nothing is unsafe."""
    wish, until = np.zeros(4, np.float32), 0.0
    while time.monotonic() < done_at and not flight.unsafe:
        now = time.monotonic()
        if now > until:
            top = 2 * np.array([1.5, 1.5, 0.7, 0.6])
            wish = np.array([flight.draw.uniform(-each, each) for each in top], np.float32)
            until = now + flight.draw.uniform(0.5, 3.0)
        if (back := _way_back(flight.vehicle.state(), home)) is not None:
            wish = back
        if now > flight.silent_until:
            with suppress(LinkError):
                flight.drone.observe()
                flight.drone.send(wish)
        _watch(flight, home)
        time.sleep(max(0.0, now + 0.1 - time.monotonic()))


def _way_back(state: DroneState, home: FloatArray) -> NDArray[np.float32] | None:
    """A velocity (4,) toward the take-off, at 1 m/s, for a drone that is near the fence."""
    away = state.position - home
    if np.hypot(*away[:2]) < NEAR_M and LOW_M < state.position[2] < HIGH_M:
        return None
    forward, left = world_to_heading(-away[:2] / max(1.0, float(np.hypot(*away[:2]))), yaw_of(state.quaternion))
    climb = float(np.clip((LOW_M + HIGH_M) / 2 - state.position[2], -0.5, 0.5))
    return np.array([forward, left, climb, 0.0], np.float32)


def _watch(flight: Flight, home: FloatArray) -> None:
    state = flight.vehicle.state()
    speed, place = float(np.linalg.norm(state.velocity)), state.position - home
    if speed > FAST_M_S:
        flight.unsafe.append(f"{speed:.1f} m/s")
    sides = outside_by(np.array([place[0], place[1], 1.0]), FENCE)
    if flight.mode is None and sides > OUTSIDE_M:
        flight.unsafe.append(f"{sides:.1f} m outside the fence")


def _end(flight: Flight, home: FloatArray, name: str) -> None:
    """See that it ends, on the ground or in the pilot's hand, and how."""
    vehicle, fastest, deadline = flight.vehicle, 0.0, time.monotonic() + END_S
    while vehicle.modes.armed and not flight.unsafe:
        now = time.monotonic()
        if flight.mode is not None:
            if vehicle.modes.mode != flight.mode:
                flight.unsafe.append(f"the pilot's {flight.mode.name} became {vehicle.modes.mode.name}")
            if now > deadline - END_S + 12:
                return
        elif now > deadline:
            flight.unsafe.append(f"not down {END_S:g} s after it, in {vehicle.modes.mode.name}")
        if now > flight.silent_until:
            with suppress(LinkError):
                flight.drone.observe()
                flight.drone.send(np.array([0.5, 0, 0, 0.3], np.float32))
        state = vehicle.state()
        if state.position[2] < 0.25:
            fastest = max(fastest, -float(state.velocity[2]))
        _watch(flight, home)
        time.sleep(0.02)
    if fastest > SOFT_M_S:
        flight.unsafe.append(f"touched the ground at {fastest:.1f} m/s after {name}")


@contextmanager
def sky() -> Iterator[SimulatedVehicle]:
    """The simulated vehicle, in a thread."""
    vehicle = SimulatedVehicle(Simulator(render=False), VehicleConfig(links=("udpin:127.0.0.1:0",)))
    stop = threading.Event()
    thread = threading.Thread(target=serve, args=(vehicle, stop.is_set), daemon=True)
    thread.start()
    try:
        yield vehicle
    finally:
        stop.set()
        thread.join()
        vehicle.close()


def _wait(holds: Callable[[], bool], timeout_s: float) -> None:
    deadline = time.monotonic() + timeout_s
    while not holds() and time.monotonic() < deadline:
        time.sleep(0.05)


def _resident_mb(process: int) -> float:
    with suppress(OSError):
        for line in Path(f"/proc/{process}/status").read_text().splitlines():
            if line.startswith("VmRSS"):
                return int(line.split()[1]) / 1024
    return float("nan")


def main(config: Config) -> int:
    seeds = [config.seed * 1000 + n for n in range(config.at_once)]
    with ProcessPoolExecutor(config.at_once) as pool:
        results = list(pool.map(partial(fly_all, config), seeds))
    faults = sum((result.faults for result in results), Counter[str]())
    unsafe = [each for result in results for each in result.unsafe]
    air_min, flights = sum(result.air_s for result in results) / 60, sum(len(result.guards_mb) for result in results)
    fenced = faults.pop(BY_THE_FENCE, 0)
    print(f"{air_min:.1f} minutes in the air in {flights} flights, {faults.total()} faults, {len(unsafe)} unsafe ends")
    print(f"  {fenced:4d} {BY_THE_FENCE}")
    for name in FAULTS:
        print(f"  {faults[name]:4d} {name}{'' if name in PASSING else ' (must end the flight)'}")
    ends = [end for result in results for _, end in result.guards_mb]
    grown = [end - first for result in results for first, end in result.guards_mb]
    print(f"guard: {min(ends):.1f} to {max(ends):.1f} MB resident at its end, {max(grown):+.1f} MB in flight at most")
    for result in results:
        settled = result.own_mb[len(result.own_mb) // 4 :]
        print(
            f"vehicle and pilot: {settled[0]:.1f} MB resident after a quarter of its flights, {settled[-1]:.1f} at last"
        )
    for each in unsafe:
        print(f"UNSAFE {each}")
    row: dict[str, object] = {
        "air_min": round(air_min, 1),
        "flights": flights,
        "faults": faults.total(),
        "kinds": len(+faults),
    }
    row |= {"fenced": fenced, "unsafe": len(unsafe), "guard_mb": round(max(ends), 1), "grown_mb": round(max(grown), 1)}
    row |= {"settled_mb": [round(r.own_mb[len(r.own_mb) // 4], 1) for r in results]}
    row |= {"last_mb": [round(r.own_mb[-1], 1) for r in results]}
    keep(config.out, "Flights with a random fault every few seconds", [row], seed=config.seed)
    return 1 if unsafe else 0


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Config)))
