"""Flights with a second vehicle of the same system id on the link, or somebody who sends as the vehicle: how they end.

Run: python benchmarks/second_vehicle.py [--only NAME ...] [--times N] [--out results/second_vehicle.json]
     python benchmarks/second_vehicle.py --arducopter path/to/arducopter [...]

Every flight is a pilot process with its guard process, as `fly` has them, in real time over UDP, with a relay before
the vehicle, as a router is: what the relay adds comes from the vehicle's address. The vehicle is our simulator or, with
`--arducopter`, a real ArduCopter built for SITL on our physics. Flights must end on the ground with the motors
stopped, or under the pilot who took over; rows that must not end the flight must land when it is over, and say so.
`down` is from the attack to the motors' stop, `ended` to the end of both processes, s. Exit code 1 where one does
not end as it must.

An attack is one entry of `ATTACKS`.
"""

from __future__ import annotations

import argparse
import heapq
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, Protocol

import random_faults
import sitl_vehicle
from pymavlink.dialects.v20 import ardupilotmega as m
from sitl_faults import PILOT, TESTS

from cognitivedrone.benchmark.measurements import OUT_HELP, keep
from cognitivedrone.vehicles.mavlink.server.modes import Mode
from cognitivedrone.vehicles.sitl.arducopter import BINARY_VARIABLE

DOWN_S, ENDED_S = 40.0, 75.0
"""The drone must be down, and both processes have ended, so long after the attack."""
WATCHED_S = 12.0
"""After a take-over: the vehicle must stay in its pilot's mode for so long."""
PASSES_S = 12.0
"""A flight that must go on is over after so long."""
LATE_S = 0.3
GUIDED, LOITER, STABILIZE = 4, 5, 0
COPTER, FIXED_WING = m.MAV_TYPE_QUADROTOR, m.MAV_TYPE_FIXED_WING
ARDUPILOT, PX4 = m.MAV_AUTOPILOT_ARDUPILOTMEGA, m.MAV_AUTOPILOT_PX4


class Craft(Protocol):
    """A vehicle behind a relay."""

    @property
    def url(self) -> str: ...
    @property
    def relay(self) -> Relay: ...
    @property
    def armed(self) -> bool: ...
    @property
    def mode(self) -> str: ...
    @property
    def height(self) -> float: ...
    def take_over(self) -> None:
        """The pilot's switch selects LOITER."""


class Relay(Protocol):
    """What brings the vehicle's packets to the guard."""

    hook: Callable[[bytes], bool]
    """Called with each; true where the relay must not send it."""

    def say(self, data: bytes) -> None:
        """Send the guard a packet from the vehicle's address."""


class _SimulatorRelay(random_faults.Relay):
    """The relay of the random faults, which also says what it is told to."""

    def __init__(self, vehicle: tuple[str, int]) -> None:
        self.hook: Callable[[bytes], bool] = lambda _: False
        super().__init__(vehicle)

    def say(self, data: bytes) -> None:
        if self._guard is not None:
            self._sockets[0].sendto(data, self._guard)

    def _downwards(self) -> None:
        while not self._stop.is_set():
            with suppress(OSError):
                data = self._sockets[1].recv(4096)
                if self._guard is not None and not self.hook(data):
                    self.say(data)


class _Simulator:
    """Our simulator as a vehicle."""

    def __init__(self, vehicle: Any, relay: _SimulatorRelay) -> None:
        self.url, self.relay, self._vehicle = relay.url, relay, vehicle
        self._floor = float(vehicle.state().position[2])

    @property
    def armed(self) -> bool:
        return bool(self._vehicle.modes.armed)

    @property
    def mode(self) -> str:
        return str(self._vehicle.modes.mode.name)

    @property
    def height(self) -> float:
        return float(self._vehicle.state().position[2]) - self._floor

    def take_over(self) -> None:
        self._vehicle.pilot(Mode.LOITER)


class _SitlRelay:
    """The same before a real ArduCopter."""

    def __init__(self, inner: sitl_vehicle.Relay) -> None:
        self._inner = inner
        self.hook: Callable[[bytes], bool] = lambda _: False
        inner.hook = lambda data: self.hook(data)

    def say(self, data: bytes) -> None:
        self._inner.say(data)


class _ArduCopter:
    """A real one on our physics."""

    def __init__(self, vehicle: sitl_vehicle.Vehicle) -> None:
        self.url, self.relay, self._vehicle = vehicle.relay.url, _SitlRelay(vehicle.relay), vehicle

    @property
    def armed(self) -> bool:
        return self._vehicle.observer.armed

    @property
    def mode(self) -> str:
        return self._vehicle.observer.mode

    @property
    def height(self) -> float:
        return self._vehicle.height

    def take_over(self) -> None:
        self._vehicle.remote.take_over()


@contextmanager
def simulator(folder: Path) -> Iterator[Craft]:
    with random_faults.sky() as vehicle:
        relay = _SimulatorRelay(vehicle.addresses[0])
        try:
            yield _Simulator(vehicle, relay)
        finally:
            relay.close()


@contextmanager
def arducopter(folder: Path) -> Iterator[Craft]:
    vehicle = sitl_vehicle.Vehicle(folder, {"FLTMODE1": LOITER})
    try:
        yield _ArduCopter(vehicle)
    finally:
        vehicle.close()


@dataclass
class Flight:
    """What an attack can reach."""

    craft: Craft
    pilot: subprocess.Popen[str]
    guard: int
    """Process id."""
    stop: threading.Event = field(default_factory=threading.Event)
    other: Any = field(default_factory=lambda: m.MAVLink(None, srcSystem=1, srcComponent=1))
    """The encoder of the second vehicle, with sequence numbers of its own."""
    draw: random.Random = field(default_factory=lambda: random.Random(7))
    threads: list[threading.Thread] = field(default_factory=list)

    def say(self, *messages: Any) -> None:
        for message in messages:
            self.craft.relay.say(bytes(message.pack(self.other)))
            self.other.seq = (self.other.seq + 1) % 256

    def keep_saying(self, make: Callable[[], Sequence[Any]], rate_hz: float) -> None:
        """Until the flight has ended."""

        def run() -> None:
            due = time.monotonic()
            while not self.stop.is_set():
                self.say(*make())
                due = max(due + 1 / rate_hz, time.monotonic() - 0.1)
                if (left := due - time.monotonic()) > 0.001:
                    self.stop.wait(left)

        self.begin(run)

    def begin(self, run: Callable[[], None]) -> None:
        self.threads.append(threading.Thread(target=run, daemon=True))
        self.threads[-1].start()


def beat(mode: int = GUIDED, *, armed: bool = True, kind: int = COPTER, autopilot: int = ARDUPILOT) -> Any:
    return m.MAVLink_heartbeat_message(kind, autopilot, 0x81 if armed else 1, mode, 4, 3)


# What the second vehicle does.

Inject = Callable[[Flight], None]


def once(*messages: Any) -> Inject:
    return lambda flight: flight.say(*messages)


def always(rate_hz: float, *messages: Any) -> Inject:
    return lambda flight: flight.keep_saying(lambda: messages, rate_hz)


def burst(count: int, seconds: float, message: Any) -> Inject:
    def inject(flight: Flight) -> None:
        for _ in range(count):
            flight.say(message)
            time.sleep(seconds / count)

    return inject


def random_modes(flight: Flight) -> None:
    flight.keep_saying(lambda: [beat(flight.draw.randrange(30), armed=flight.draw.random() < 0.5)], 100)


def telemetry(*, flies: bool) -> Inject:
    """All that a whole vehicle reports: it stands beside ours, or flies in GUIDED somewhere else."""

    def inject(flight: Flight) -> None:
        began = time.monotonic() - 777.0

        def report() -> Sequence[Any]:
            ms = round(1000 * (time.monotonic() - began))
            place = (9.0, 9.0, -3.0) if flies else (1.0, 1.0, 0.0)
            return (
                beat(GUIDED if flies else STABILIZE, armed=flies),
                m.MAVLink_attitude_message(ms, 0, 0, 1, 0, 0, 0),
                m.MAVLink_local_position_ned_message(ms, *place, 0, 0, 0),
                m.MAVLink_extended_sys_state_message(0, 2 if flies else 1),
            )

        flight.keep_saying(report, 10)

    return inject


def ahead(seconds: float) -> Inject:
    """One ATTITUDE with a time of the future: by that of the vehicle's next one."""

    def inject(flight: Flight) -> None:
        decoder = m.MAVLink(None)
        decoder.robust_parsing = True
        said = threading.Event()

        def hook(data: bytes) -> bool:
            for message in decoder.parse_buffer(data) or ():
                if message.get_type() == "ATTITUDE" and not said.is_set():
                    said.set()
                    flight.say(
                        m.MAVLink_attitude_message(message.time_boot_ms + round(1000 * seconds), 0, 0, 0, 0, 0, 0)
                    )
            return False

        flight.craft.relay.hook = hook

    return inject


def texts(flight: Flight) -> None:
    count = iter(range(10**9))
    flight.keep_saying(lambda: [m.MAVLink_statustext_message(3, b"text %d" % next(count))], 5000)


def names(flight: Flight) -> None:
    count = iter(range(10**9))
    flight.keep_saying(lambda: [m.MAVLink_param_value_message(b"P%d" % next(count), 1.0, 9, 9999, 1)], 5000)


def texts_in_place_of_telemetry(flight: Flight) -> None:
    flight.craft.relay.hook = lambda _: True
    texts(flight)


def take_over(flight: Flight) -> None:
    flight.craft.take_over()


def take_over_beside_another(flight: Flight) -> None:
    always(10, beat(GUIDED))(flight)
    time.sleep(0.5)
    flight.craft.take_over()


def late(delay: Callable[[random.Random], float], *, copies: bool) -> Inject:
    """From before the take-off on: every packet comes so late, or a copy of it does."""

    def inject(flight: Flight) -> None:
        waiting: list[tuple[float, int, bytes]] = []
        news, count = threading.Condition(), iter(range(10**9))

        def hook(data: bytes) -> bool:
            with news:
                heapq.heappush(waiting, (time.monotonic() + delay(flight.draw), next(count), data))
                news.notify()
            return not copies

        def deliver() -> None:
            while not flight.stop.is_set():
                with news:
                    left = waiting[0][0] - time.monotonic() if waiting else 0.1
                    if left > 0:
                        news.wait(min(left, 0.1))
                        continue
                    data = heapq.heappop(waiting)[2]
                flight.craft.relay.say(data)

        flight.begin(deliver)
        flight.craft.relay.hook = hook

    return inject


@dataclass(frozen=True)
class Attack:
    """One row."""

    inject: Inject
    end: Literal["ground", "pilot", "flies on"] = "ground"
    when: Literal["start", "climb", "flight", "landing"] = "flight"
    seconds: float = 60.0
    """The pilot process lands after so long."""
    guard_stays: bool = False
    """The other one flies on, or the vehicle is not heard any more, so that the guard does not leave."""


ATTACKS: dict[str, Attack] = {
    "one heartbeat: disarmed": Attack(once(beat(armed=False))),
    "one heartbeat: LOITER": Attack(once(beat(LOITER))),
    "one heartbeat: mode 999999": Attack(once(beat(999_999))),
    "one heartbeat of a fixed wing": Attack(once(beat(LOITER, kind=FIXED_WING))),
    "one heartbeat of a PX4": Attack(once(beat(LOITER, autopilot=PX4))),
    "one heartbeat in the climb: disarmed": Attack(once(beat(armed=False)), when="climb"),
    "one heartbeat in the climb: LOITER": Attack(once(beat(LOITER)), when="climb"),
    "one heartbeat in our LAND: disarmed": Attack(once(beat(9, armed=False)), when="landing"),
    "one heartbeat in our LAND: LOITER": Attack(once(beat(LOITER)), when="landing"),
    "5 in 10 ms: disarmed": Attack(burst(5, 0.01, beat(armed=False))),
    "20 in 0.1 s: LOITER": Attack(burst(20, 0.1, beat(LOITER))),
    "disarmed once a second": Attack(always(1, beat(armed=False))),
    "disarmed 10 times a second": Attack(always(10, beat(armed=False))),
    "LOITER 10 times a second": Attack(always(10, beat(LOITER))),
    "LOITER and disarmed, 50 times a second each": Attack(always(50, beat(LOITER), beat(armed=False))),
    "random modes, 100 times a second": Attack(random_modes),
    "a whole vehicle that stands": Attack(telemetry(flies=False)),
    "a whole vehicle that flies in GUIDED": Attack(telemetry(flies=True), seconds=PASSES_S, guard_stays=True),
    "5000 texts a second in place of telemetry": Attack(texts_in_place_of_telemetry, guard_stays=True),
    "a take-over, beside GUIDED 10 times a second": Attack(take_over_beside_another, "pilot"),
    "a take-over": Attack(take_over, "pilot"),
    "5000 texts a second beside telemetry": Attack(texts, "flies on"),
    "5000 new parameters a second": Attack(names, "flies on"),
    "one ATTITUDE 0.9 s ahead": Attack(ahead(0.9), "flies on"),
    "one ATTITUDE 9 s ahead": Attack(ahead(9.0), "flies on"),
    "a copy of every packet 0.3 s late": Attack(late(lambda _: LATE_S, copies=True), "flies on", "start"),
    "every packet up to 0.3 s late, out of order": Attack(
        late(lambda draw: draw.uniform(0, LATE_S), copies=False), "flies on", "start"
    ),
}


@dataclass(frozen=True)
class Outcome:
    """What happened."""

    attack: str
    good: bool
    end: str
    down_s: float | None = None
    ended_s: float | None = None
    who: str = ""
    """What the pilot process says."""


def fly(name: str, attack: Attack, start: Callable[[Path], Any]) -> Outcome:
    """Fly one."""
    with tempfile.TemporaryDirectory(prefix="second-vehicle-") as folder, start(Path(folder)) as craft:
        sitl_vehicle.come_first()
        os.environ["XDG_STATE_HOME"] = folder
        seconds = PASSES_S if attack.end == "flies on" else attack.seconds
        log = str(Path(folder) / "flight.tlog")
        code = PILOT.format(tests=str(TESTS), consent=True, log=log, url=craft.url, seconds=seconds)
        pilot = subprocess.Popen(
            [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
            start_new_session=True,
        )  # fmt: skip
        lines: list[str] = []
        reader = threading.Thread(target=lambda: lines.extend(_each(pilot)), daemon=True)
        words = pilot.stdout.readline().split() if pilot.stdout is not None else []
        if not words or words[0] != "guard":
            pilot.wait()
            return Outcome(name, good=False, end=" ".join(words))
        flight = Flight(craft, pilot, int(words[1]))
        try:
            if attack.when == "start":
                attack.inject(flight)
            reader.start()
            return _flown(name, attack, flight, lines)
        finally:
            flight.stop.set()
            for process in (flight.guard, pilot.pid):
                with suppress(ProcessLookupError):
                    os.kill(process, signal.SIGKILL)
            pilot.wait()
            for thread in flight.threads:
                thread.join()


def _each(pilot: subprocess.Popen[str]) -> Iterator[str]:
    for line in pilot.stdout or ():
        yield line.strip()


def _flown(name: str, attack: Attack, flight: Flight, lines: list[str]) -> Outcome:
    craft, pilot = flight.craft, flight.pilot

    def ended() -> bool:
        gone = attack.guard_stays or not Path(f"/proc/{flight.guard}").exists()
        return pilot.poll() is not None and gone

    if attack.when == "climb":
        _until(lambda: craft.height > 0.3 or ended(), 90)
        time.sleep(0.3)
    else:
        _until(lambda: "flying" in lines or ended(), 90)
        time.sleep(1.5)
    if attack.when == "landing":
        pilot.send_signal(signal.SIGTERM)
        _until(lambda: craft.mode == "LAND", 20)
        time.sleep(0.3)
    if not craft.armed:
        return Outcome(name, good=False, end="the flight had ended before the attack", who=_last(lines))
    at = time.monotonic()
    if attack.when != "start":
        attack.inject(flight)
    if attack.end == "pilot":
        _until(lambda: craft.mode == "LOITER", 5)
        kept = not _until(lambda: craft.mode != "LOITER", WATCHED_S)
        return Outcome(name, kept and craft.armed, f"in the pilot's hand: {craft.mode}", who=_last(lines))
    down = (lambda: time.monotonic() - at) if _until(lambda: not craft.armed, DOWN_S) else lambda: None
    down_s, mode, height = down(), craft.mode, craft.height
    _until(ended, ENDED_S - (time.monotonic() - at))
    ended_s = time.monotonic() - at if ended() else None
    time.sleep(0.2)
    words = _last(lines)
    good = down_s is not None and height < 0.25 and ended_s is not None
    if attack.end == "flies on":
        good = good and words == "landed the flight is over"
    end = (
        f"on the ground, from {mode}"
        if down_s is not None and height < 0.25
        else f"IN THE AIR, {height:.1f} m, in {mode}"
    )
    end += "" if ended_s is not None else ", the program goes on"
    return Outcome(name, good, end, _rounded(down_s), _rounded(ended_s), words)


def _last(lines: list[str]) -> str:
    return lines[-1] if lines else ""


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 1)


def _until(holds: Callable[[], bool], timeout_s: float) -> bool:
    deadline = time.monotonic() + timeout_s
    while not holds():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.02)
    return True


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", nargs="*", default=[], help="attacks whose name holds one of these")
    parser.add_argument("--times", type=int, default=1, help="how often each is flown")
    parser.add_argument("--arducopter", type=Path, help="a real ArduCopter, built for SITL, in place of our simulator")
    parser.add_argument("--out", type=Path, help=OUT_HELP)
    options = parser.parse_args()
    start = simulator
    if options.arducopter is not None:
        os.environ[BINARY_VARIABLE], start = str(options.arducopter.resolve()), arducopter
    outcomes = []
    for name, attack in list(ATTACKS.items()) * options.times:
        if options.only and not any(part in name for part in options.only):
            continue
        outcome = fly(name, attack, start)
        outcomes.append(outcome)
        times = " ".join("    -" if each is None else f"{each:5.1f}" for each in (outcome.down_s, outcome.ended_s))
        shown = "ok" if outcome.good else "FAILED"
        print(f"{name:<48} {times}  {shown:<6} {outcome.end} ({outcome.who})", flush=True)
    good = sum(outcome.good for outcome in outcomes)
    print(f"{good} of {len(outcomes)} end on the ground, or under the pilot, as they must")
    what = "a real ArduCopter" if options.arducopter else "our simulator"
    keep(
        options.out,
        f"Flights with a second vehicle of the same id, {what} as the vehicle",
        [asdict(outcome) for outcome in outcomes],
        variables=(BINARY_VARIABLE,),
    )
    return 0 if good == len(outcomes) else 1


if __name__ == "__main__":
    sys.exit(main())
