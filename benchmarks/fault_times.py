"""How long it takes from a fault in flight to a safe command at the vehicle, over loopback sockets, default rules.

Run: python benchmarks/fault_times.py [--flights N] [--at-once N] [--load N] [--only NAME ...]
    [--out results/fault_times.json]

Every flight is a pilot process with its guard process, as `fly` has them, and the scripted vehicle of the tests, which
reports its state 50 times a second and notes when each packet arrives. `--load` busy processes run beside them, one for
every core by default; `--at-once` flights share the machine with them. "Safe" is the first zero velocity, or what
brings it down; "down" the first order to land or, where the vehicle's mode is not known and none is ordered, the first
velocity straight down. What falls silent is at fault from when its next message is due: 0.1 s after the last command. A
row that must only go on counts from the fault to the next command that is flown. Only the vehicle is run before others,
where that is permitted: a real one is on another machine. Exit code 1 where a row is not within its time.

A fault is one entry of `FAULTS`.
"""

from __future__ import annotations

import argparse
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "vehicles"))

from peer import MODES, Peer, playing
from test_hazards import FAULTS as VEHICLE_FAULTS
from test_hazards import NAMES

from cognitivedrone.benchmark.measurements import OUT_HELP, keep

TESTS = Path(__file__).parents[1] / "tests" / "vehicles"
PERIOD_S = 0.1
"""Of the pilot's commands."""
ATTEMPTS = 5
"""To begin a flight."""
LATEST_S = 25.0
"""What has not happened by then is not counted as having happened."""
PILOT = """
import os, re, signal, sys, threading, time
from pathlib import Path
sys.path.insert(0, {tests!r})
import numpy as np
from peer import StillCamera
from cognitivedrone.control.safety import SafetyConfig
from cognitivedrone.errors import CameraError
from cognitivedrone.vehicles.mavlink.client.handshake import MavlinkConfig
from cognitivedrone.vehicles.mavlink.guard.drone import GuardedDrone
from cognitivedrone.vehicles.mavlink.guard.messages import Kind, pack

signal.signal(signal.SIGHUP, signal.SIG_DFL)  # also under nohup

def fault():
    print(time.monotonic(), flush=True)

class Camera(StillCamera):
    closes_at = float("inf")
    def read(self):
        if time.monotonic() > self.closes_at:
            fault()
            raise CameraError("the camera was closed")
        return super().read()

camera = Camera()
config = MavlinkConfig(takeoff_timeout_s=30, tlog={log})
began = time.monotonic()
with GuardedDrone("udpout:127.0.0.1:{port}", camera, SafetyConfig(), config) as drone:
    print(drone.process, time.monotonic() - began, flush=True)
    drone.take_off(lambda _: True)
    due = began = time.monotonic()
    while True:
        drone.observe()
        drone.send(np.array([1, 0, 0, 0], np.float32))
        due += {period}
        time.sleep(max(0.0, due - time.monotonic()))
        if time.monotonic() > began + 0.6:
            {does}
"""


class NotBegunError(Exception):
    """The flight did not come to the fault's moment: the machine was too busy to start it in time."""


@dataclass
class Flight:
    """A vehicle, and who flies it."""

    peer: Peer
    pilot: subprocess.Popen[str]
    guard: int
    """Process id."""
    start_s: float
    """Until the guard had met the vehicle."""

    def told(self) -> float:
        """When the pilot process began to do wrong, as it says itself."""
        return float(self.pilot.stdout.readline()) if self.pilot.stdout is not None else 0.0

    def commands(self) -> list[tuple[float, bool]]:
        """When a velocity arrived, and whether it was zero."""
        return [(at, not any((s.vx, s.vy, s.vz, s.yaw_rate))) for at, s in self._setpoints()]

    def landing(self, since: float) -> float | None:
        """When the first order to land since then arrived, or the first velocity straight down."""
        orders = [(at, c) for at, c in list(self.peer.received) if c.get_type() == "COMMAND_LONG"]
        modes = [at for at, c in orders if c.command == 176 and c.param2 == MODES["LAND"]]
        downwards = [at for at, s in self._setpoints() if s.vz > 0 and not any((s.vx, s.vy, s.yaw_rate))]
        return min((at for at in modes + downwards if at >= since), default=None)

    def _setpoints(self) -> list[tuple[float, Any]]:
        return [(at, s) for at, s in list(self.peer.received) if s.get_type() == "SET_POSITION_TARGET_LOCAL_NED"]

    def stopped(self, since: float) -> float | None:
        """When the first zero velocity since then arrived."""
        return next((at for at, zero in self.commands() if at >= since and zero), None)

    def due(self) -> float:
        """When the pilot's next command is due, after the last one so far."""
        flown = [at for at, zero in self.commands() if not zero]
        if not flown:
            raise NotBegunError("no command has reached the vehicle")
        return max(flown) + PERIOD_S


@dataclass(frozen=True)
class Fault:
    """One row."""

    inject: Callable[[Flight], float]
    """Makes it happen; returns when it did."""
    safe_s: float = 0.2
    land_s: float | None = 0.2
    """To what brings it down; none where it must not land: the flight goes on."""
    does: str = "pass"
    """What the pilot process does after some commands."""
    vehicle: dict[str, object] = field(default_factory=dict)
    """What is special about the vehicle."""
    log: str = ""
    """Where the tlog is written."""


def to_pilot(number: int) -> Callable[[Flight], float]:
    """Send the pilot process a signal."""

    def inject(flight: Flight) -> float:
        now = time.monotonic()
        flight.pilot.send_signal(number)
        return now

    return inject


def to_guard(number: int) -> Callable[[Flight], float]:
    """Send the guard process a signal."""

    def inject(flight: Flight) -> float:
        now = time.monotonic()
        os.kill(flight.guard, number)
        return now

    return inject


def stop_pilot(flight: Flight) -> float:
    flight.pilot.send_signal(signal.SIGSTOP)
    state = Path(f"/proc/{flight.pilot.pid}/stat")
    while state.read_text().rpartition(")")[2].split()[0] != "T":  # it must have its turn on a core to stop
        time.sleep(0.001)
    time.sleep(0.01)
    return flight.due()


def stop_guard(flight: Flight) -> float:
    os.kill(flight.guard, signal.SIGSTOP)
    time.sleep(1.0)
    now = time.monotonic()  # it may land before this process has its next turn
    os.kill(flight.guard, signal.SIGCONT)
    return now


def hold_the_interpreter(flight: Flight) -> float:
    flight.told()
    time.sleep(0.02)
    return flight.due()


def told(flight: Flight) -> float:
    return flight.told()


def cut_downlink(flight: Flight) -> float:
    flight.peer.part.mute = True
    return time.monotonic()


def of_the_vehicle(change: Callable[[Peer], None]) -> Callable[[Flight], float]:
    """Let the vehicle do something."""

    def inject(flight: Flight) -> float:
        now = time.monotonic()
        change(flight.peer)
        return now

    return inject


def go_on(flight: Flight) -> float:
    return time.monotonic()


_SPIN = 'fault(); re.match("(a+)+$", "a" * 60 + "b")'
_FLOOD = (
    "fault(); n = drone._sequence\n"
    "            while True:\n"
    "                n += 1\n"
    "                try: drone._socket.send(pack(Kind.FRAME, n, time.monotonic_ns()))\n"
    "                except OSError: pass"
)
_NONSENSE = "fault()\n            for _ in range(20): drone._socket.send(os.urandom(80))\n            time.sleep(30)"
DYING_S = 1.0
"""A process that is killed needs its turn on a core to end."""
SILENT_S = 0.35
"""In flight its silence is noticed before: it may have sent a command just then, the next one is due after 0.1 s, and
is waited for as long again."""
FAULTS: dict[str, Fault] = {
    "pilot process killed (-9)": Fault(to_pilot(signal.SIGKILL), SILENT_S, DYING_S),
    "pilot process killed (-9) in the climb": Fault(
        to_pilot(signal.SIGKILL), DYING_S, DYING_S, vehicle={"climbs": False}
    ),
    "pilot process holds the interpreter in C": Fault(hold_the_interpreter, land_s=6.0, does=_SPIN),
    "pilot process stopped (SIGSTOP)": Fault(stop_pilot, land_s=6.0),
    "SIGHUP to the pilot process": Fault(to_pilot(signal.SIGHUP), SILENT_S, DYING_S),
    "SIGTERM to the pilot process": Fault(to_pilot(signal.SIGTERM), SILENT_S, DYING_S),
    "SIGHUP to the pilot process in the climb": Fault(
        to_pilot(signal.SIGHUP), DYING_S, DYING_S, vehicle={"climbs": False}
    ),
    "SIGTERM to the pilot process in the climb": Fault(
        to_pilot(signal.SIGTERM), DYING_S, DYING_S, vehicle={"climbs": False}
    ),
    "SIGHUP to the guard": Fault(to_guard(signal.SIGHUP)),
    "SIGTERM to the guard": Fault(to_guard(signal.SIGTERM)),
    "SIGTERM to the guard in the climb": Fault(to_guard(signal.SIGTERM), vehicle={"climbs": False}),
    "guard stopped for 1 s, from when it goes on": Fault(stop_guard),
    "pilot process floods the guard": Fault(told, does=_FLOOD),
    "pilot process sends nonsense": Fault(told, does=_NONSENSE),
    "pilot process sends NaN": Fault(
        told, land_s=6.0, does="fault(); drone.send(np.full(4, np.nan, np.float32)); time.sleep(30)"
    ),
    "camera closed": Fault(told, does="camera.closes_at = 0.0"),
    "downlink cut": Fault(cut_downlink, land_s=7.0),
    "disk of the log full": Fault(go_on, land_s=None, log="/dev/full"),
}
PATIENT_S: dict[str, float] = {"silent_status": 3.0, "silent_battery": 3.0}
"""Where the default rules wait longer than those of the tests."""
FAULTS |= {
    f"vehicle: {name.replace('_', ' ')}": Fault(
        of_the_vehicle(inject), safe_s=PATIENT_S.get(name, within_s) + 0.2, land_s=20.0
    )
    for name, (inject, _, _, within_s) in zip(NAMES, VEHICLE_FAULTS, strict=True)
}


@contextmanager
def flying(fault: Fault) -> Iterator[Flight]:
    """A flight that has come to the fault's moment."""
    with tempfile.TemporaryDirectory() as folder, playing(**fault.vehicle) as peer:
        with suppress(OSError):  # a thread does not inherit it
            os.sched_setscheduler(peer.thread_id, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(1))
        log = Path(folder) / "flight.tlog"
        if fault.log:
            log.symlink_to(fault.log)
        code = PILOT.format(
            tests=str(TESTS), port=peer.port, period=PERIOD_S, does=fault.does, log=f"Path({str(log)!r})"
        )
        pilot = subprocess.Popen(
            [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        guard = -1
        try:
            words = pilot.stdout.readline().split() if pilot.stdout is not None else []
            if not words:
                raise NotBegunError
            guard = int(words[0])
            flight = Flight(peer, pilot, guard, float(words[1]))
            if fault.vehicle.get("climbs", True):
                begun = wait(lambda: len(flight.commands()) >= 4 or None)
            else:
                begun = wait(lambda: any(c.command == 22 for c in peer.of("COMMAND_LONG")) or None)
            if not begun:
                raise NotBegunError
            yield flight
        finally:
            for process in (pilot.pid, guard):
                with suppress(ProcessLookupError):
                    if process > 0:
                        os.kill(process, signal.SIGKILL)
            pilot.communicate()


def wait(found: Callable[[], float | bool | None]) -> float | None:
    """What is found, once it is; none after `LATEST_S`."""
    end = time.monotonic() + LATEST_S
    while time.monotonic() < end:
        if (result := found()) is not None:
            return result
        time.sleep(0.02)  # what counts is when the vehicle noted it, and looking costs it time
    return None


def once(fault: Fault) -> tuple[float, float]:
    """Seconds from the fault to a safe command, and to what brings it down; infinite where it did not come."""
    with flying(fault) as flight:
        at = fault.inject(flight)
        if fault.land_s is None:
            time.sleep(1.0)
            moved = next((when for when, zero in flight.commands() if when >= at and not zero), None)
            ended = flight.landing(at) is not None or flight.stopped(at) is not None
            return (float("inf") if ended or moved is None else moved - at), 0.0
        landed = wait(lambda: flight.landing(at))
        stopped = flight.stopped(at)
        first = min((when for when in (stopped, landed) if when is not None), default=float("inf"))
        return first - at, (float("inf") if landed is None else landed - at)


def times_of(name: str) -> tuple[float, float]:
    """`once`, for a row; a flight that did not begin is flown again."""
    for _ in range(ATTEMPTS):
        with suppress(NotBegunError):
            return once(FAULTS[name])
    raise NotBegunError(name)


@contextmanager
def busy(processes: int) -> Iterator[None]:
    """Processes that never rest."""
    running = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(processes)]
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--flights", type=int, default=7)
    parser.add_argument("--at-once", type=int, default=1)
    parser.add_argument("--load", type=int, default=os.cpu_count())
    parser.add_argument("--only", nargs="*", default=[], help="rows whose name holds one of these")
    parser.add_argument("--out", type=Path, help=OUT_HELP)
    options = parser.parse_args()
    kept: list[dict[str, Any]] = []
    rows = {n: f for n, f in FAULTS.items() if not options.only or any(part in n for part in options.only)}
    print(
        f"{options.flights} flights a row, {options.at_once} at once beside {options.load} busy processes on"
        f" {os.cpu_count()} cores; ms"
    )
    print(f"{'fault':<44} {'safe: median worst limit':>26}   {'down: median worst limit':>26}")
    failed = 0
    with busy(options.load), ProcessPoolExecutor(options.at_once) as flights:
        with flying(Fault(go_on)) as flight:
            status = Path(f"/proc/{flight.guard}/status").read_text()
            print(f"the guard met the vehicle after {flight.start_s:.1f} s, and holds {_resident_mb(status):.0f} MB")
        for name, fault in rows.items():
            times = list(flights.map(times_of, [name] * options.flights))
            safe, land = ([1000 * column for column in columns] for columns in zip(*times, strict=True))
            limit_s = fault.land_s
            good = max(safe) <= 1000 * fault.safe_s and (limit_s is None or max(land) <= 1000 * limit_s)
            failed += not good
            shown = "flies on" if limit_s is None else _row(land, limit_s)
            print(f"{name:<44} {_row(safe, fault.safe_s):>26}   {shown:>26}  {'ok' if good else 'FAILED'}", flush=True)
            down = "with it" if land == safe else None if limit_s is None else _figures(land, limit_s)
            kept.append({"fault": name, "safe_ms": _figures(safe, fault.safe_s), "down_ms": down})
    keep(options.out, f"Time from a fault in flight to a safe command, {options.flights} flights a row", kept)
    return 1 if failed else 0


def _resident_mb(status: str) -> float:
    return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS")) / 1024


def _figures(times: list[float], limit_s: float) -> list[float]:
    """Median, worst and limit, ms."""
    return [statistics.median(times), max(times), 1000 * limit_s]


def _row(times: list[float], limit_s: float) -> str:
    return f"{statistics.median(times):6.0f} {max(times):5.0f} {1000 * limit_s:5.0f}"


if __name__ == "__main__":
    sys.exit(main())
