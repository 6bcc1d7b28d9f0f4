"""What a real ArduCopter does when something goes wrong in a flight of ours: every case flown, its end judged.

Run: ARDUCOPTER=path/to/arducopter python benchmarks/sitl_faults.py [--core | --only NAME ...] [--times N] [--at-once N]
[--out FILE]

Every case is a fresh ArduCopter on our physics in real time, a guard process over UDP as a real vehicle has it (rules
on the wall clock; parameters are set with consent unless the case says otherwise), and a pilot process that flies
circles of 4 m at 1 m/s. "Stopped" is the first true speed below 0.25 m/s, "mode" the first change of mode, "down" the
motors' stop, all in s after the fault; "way" is how far it still flew over the ground, in m. Exit code 1 where a case
does not end as it must: landed softly and in time, in the mode that the pilot chose, or refused before arming.

A case is one entry of `CASES`.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from sitl_vehicle import MODES, Vehicle, come_first

from cognitivedrone.benchmark.measurements import OUT_HELP, keep
from cognitivedrone.errors import CognitiveDroneError
from cognitivedrone.vehicles.sitl.arducopter import BINARY_VARIABLE

TESTS = Path(__file__).parents[1] / "tests" / "vehicles"
STILL_M_S, SOFT_M_S, FENCE_M, CEILING_M = 0.25, 1.0, 30.0, 10.0
FAILSAFE_S = 5.0
"""FS_GCS_TIMEOUT as the program sets it."""
DOWN_S = 12.0
"""From 1.5 m, at 0.5 m/s, and until it notices that it stands."""
DISMISSED_S, WATCHED_S = 6.0, 18.0
"""After a take-over: when the guard is told to leave, and how long the vehicle is watched."""
PILOT = """
import signal, sys, time
from pathlib import Path
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # also under nohup, and in a shell's background
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.path.insert(0, {tests!r})
import numpy as np
from peer import StillCamera
from cognitivedrone.control.safety import SafetyConfig
from cognitivedrone.errors import CognitiveDroneError
from cognitivedrone.vehicles.mavlink.client.handshake import MavlinkConfig
from cognitivedrone.vehicles.mavlink.guard.drone import SupervisedDrone

config = MavlinkConfig(set_parameters={consent}, tlog=Path({log!r}))
try:
    with SupervisedDrone({url!r}, StillCamera(), SafetyConfig(), config) as drone:
        print("guard", drone.process, flush=True)
        drone.take_off(lambda checklist: True)
        print("flying", flush=True)
        due = time.monotonic()
        while drone.over is None and drone.now() < {seconds}:
            drone.observe()
            drone.send(np.array([1, 0, 0, 0.5], np.float32))
            due += 0.1
            time.sleep(max(0.0, due - time.monotonic()))
        print("over", drone.over, flush=True)
    print("landed", drone.over, flush=True)
except CognitiveDroneError as error:
    print("failed", " ".join(str(error).split()), flush=True)
"""


@dataclass
class Flight:
    """A vehicle, and who flies it."""

    vehicle: Vehicle
    pilot: subprocess.Popen[str]
    guard: int | None = None
    """Process id, once the guard has started."""
    words: list[str] = field(default_factory=list)
    """What the pilot process has printed."""

    def line(self) -> str:
        """The next line of the pilot process."""
        line = self.pilot.stdout.readline().strip() if self.pilot.stdout is not None else ""
        self.words.append(line)
        return line

    def signal_guard(self, number: int) -> None:
        with suppress(ProcessLookupError):
            if self.guard is not None:
                os.kill(self.guard, number)


@dataclass(frozen=True)
class Case:
    """One row."""

    inject: Callable[[Flight], None]
    end: Literal["landed", "pilot", "refused"] = "landed"
    within_s: float = FAILSAFE_S + DOWN_S
    """From the fault until the motors stop."""
    when: Literal["flight", "climb", "landing"] = "flight"
    before: dict[str, float] = field(default_factory=dict)
    """Parameters of the vehicle that are not its defaults."""
    mode: str = ""
    """What the pilot's switch selects, and the vehicle must keep."""
    seconds: float = 60.0
    """The pilot process lands after so long."""
    consent: bool = True
    log: str = ""


@dataclass(frozen=True)
class Outcome:
    """What happened."""

    name: str
    good: bool
    end: str
    stopped_s: float | None = None
    mode_s: float | None = None
    down_s: float | None = None
    way_m: float = 0.0
    touchdown_m_s: float | None = None
    who: str = ""
    """What ended it: the first failsafe that the vehicle reports, an order of the guard, and the guard's reason."""


# What goes wrong.


def kill(*who: str) -> Callable[[Flight], None]:
    """End processes, without a word: -9."""

    def inject(flight: Flight) -> None:
        if "guard" in who:
            flight.signal_guard(signal.SIGKILL)
        if "pilot" in who:
            flight.pilot.kill()

    return inject


def tell(number: int) -> Callable[[Flight], None]:
    """Send the pilot process a signal."""
    return lambda flight: flight.pilot.send_signal(number)


def stop_for(who: tuple[str, ...], seconds: float) -> Callable[[Flight], None]:
    """Stop processes, as a machine that swaps does."""

    def inject(flight: Flight) -> None:
        for number in (signal.SIGSTOP, signal.SIGCONT):
            if "guard" in who:
                flight.signal_guard(number)
            if "pilot" in who:
                flight.pilot.send_signal(number)
            if number == signal.SIGSTOP:
                time.sleep(seconds)

    return inject


def silence(*, up: bool, down: bool) -> Callable[[Flight], None]:
    """Cut the link in these directions."""

    def inject(flight: Flight) -> None:
        flight.vehicle.relay.up, flight.vehicle.relay.down = not up, not down

    return inject


def downlink_then_uplink(flight: Flight) -> None:
    """The downlink is silent for long enough to be stopped for, then we are not received any more."""
    flight.vehicle.relay.down = False
    time.sleep(2.5)
    flight.vehicle.relay.up = False


def parameters(*alternatives: dict[str, float]) -> Callable[[Flight], None]:
    """Set parameters of the vehicle in flight; the first alternative whose names it knows."""

    def inject(flight: Flight) -> None:
        for values in alternatives:
            if all(flight.vehicle.observer.set(name, value) for name, value in values.items()):
                return
        raise CognitiveDroneError(f"the vehicle knows none of {alternatives}")

    return inject


def other_id_then_kill(flight: Flight) -> None:
    flight.vehicle.observer.set("SYSID_MYGCS", 7)
    kill("pilot", "guard")(flight)


def take_over(flight: Flight) -> None:
    flight.vehicle.remote.take_over()


def take_over_and_kill(flight: Flight) -> None:
    take_over(flight)
    time.sleep(1.0)
    kill("pilot", "guard")(flight)


def move_stick(flight: Flight) -> None:
    """The pilot wants something: we stop."""
    flight.vehicle.remote.hold(roll=1700)
    time.sleep(1.5)


def move_stick_and_kill(flight: Flight) -> None:
    move_stick(flight)
    kill("pilot", "guard")(flight)


def move_stick_land_and_kill(flight: Flight) -> None:
    move_stick(flight)
    flight.pilot.send_signal(signal.SIGTERM)
    deadline = time.monotonic() + 5
    while flight.vehicle.observer.mode != "LAND" and time.monotonic() < deadline:
        time.sleep(0.02)
    kill("pilot", "guard")(flight)


def nothing(_: Flight) -> None:
    """It ends as it should."""


BOTH = kill("pilot", "guard")
WHO = ((("pilot",), "pilot process"), (("guard",), "guard"), (("pilot", "guard"), "both"))
SIGNALS = {"SIGHUP": signal.SIGHUP, "SIGTERM": signal.SIGTERM, "SIGINT": signal.SIGINT}
BLOCKED: dict[str, dict[str, float]] = {
    "SYSID_MYGCS 7": {"SYSID_MYGCS": 7},
    "FS_GCS_ENABLE 0": {"FS_GCS_ENABLE": 0},
    "FS_GCS_ENABLE 1": {"FS_GCS_ENABLE": 1},
    "FS_GCS_ENABLE 7": {"FS_GCS_ENABLE": 7},
    "FS_GCS_TIMEOUT 30": {"FS_GCS_TIMEOUT": 30},
    "FS_GCS_TIMEOUT 120": {"FS_GCS_TIMEOUT": 120},
    "GUID_TIMEOUT 3": {"GUID_TIMEOUT": 3},
    "ARMING_CHECK 0": {"ARMING_CHECK": 0},
    "FENCE_ACTION 0": {"FENCE_ACTION": 0},
}
GOOD = {
    "SYSID_MYGCS": 255, "FS_GCS_ENABLE": 5, "FS_GCS_TIMEOUT": 5, "FS_OPTIONS": 16, "GUID_TIMEOUT": 0.3,
    "ARMING_CHECK": 1, "FENCE_ENABLE": 1, "FENCE_ACTION": 2, "BATT_FS_LOW_ACT": 1, "BATT_LOW_VOLT": 10.5,
}  # fmt: skip
"""A vehicle that needs nothing to be set."""
CASES: dict[str, Case] = {
    "nothing goes wrong": Case(nothing, seconds=8, within_s=8 + DOWN_S),
    **{
        f"take-over into {mode}": Case(take_over, "pilot", before={"FLTMODE1": MODES[mode]}, mode=mode)
        for mode in MODES
        if mode not in ("AUTO", "GUIDED", "SPORT")  # no mission; ours; not in a build for SITL
    },
    "switch to GUIDED: nothing changes": Case(take_over, before={"FLTMODE1": 4}, seconds=10, within_s=8 + DOWN_S),
    "take-over into LOITER in the climb": Case(take_over, "pilot", when="climb", before={"FLTMODE1": 5}, mode="LOITER"),
    "take-over into LOITER, FS_OPTIONS was 0": Case(
        take_over, "pilot", before={"FLTMODE1": 5, "FS_OPTIONS": 0}, mode="LOITER"
    ),
    "take-over into LOITER, then both killed (-9)": Case(
        take_over_and_kill, "pilot", before={"FLTMODE1": 5, **GOOD}, mode="LOITER"
    ),
    **{
        f"{name} killed (-9) in the {when}": Case(kill(*who), when=when)
        for who, name in WHO
        for when in ("climb", "flight", "landing")
    },
    **{
        f"{name} stopped for {seconds} s": Case(stop_for(who, seconds), within_s=seconds + DOWN_S)
        for who, name in WHO
        for seconds in (3, 10)
    },
    **{
        f"{name} in the {when}": Case(tell(number), when=when, within_s=DOWN_S)
        for name, number in SIGNALS.items()
        for when in ("climb", "flight")
    },
    "disk of the log full": Case(nothing, seconds=8, within_s=8 + DOWN_S, log="/dev/full"),
    "link silent both ways": Case(silence(up=True, down=True)),
    "link silent both ways in the climb": Case(silence(up=True, down=True), when="climb"),
    "downlink silent": Case(silence(up=False, down=True), within_s=25),
    "uplink silent": Case(silence(up=True, down=False)),
    "downlink silent, uplink after 2.5 s": Case(downlink_then_uplink, within_s=2.5 + FAILSAFE_S + DOWN_S),
    "GPS lost": Case(parameters({"SIM_GPS1_ENABLE": 0}, {"SIM_GPS_DISABLE": 1}), within_s=25),
    "GPS jumps by 100 m": Case(parameters({"SIM_GPS1_GLTCH_X": 0.001}, {"SIM_GPS_GLITCH_X": 0.001}), within_s=25),
    "GPS jumps by 3 m": Case(parameters({"SIM_GPS1_GLTCH_X": 0.00003}, {"SIM_GPS_GLITCH_X": 0.00003}), within_s=75),
    "GPS speed noise of 4 m/s": Case(
        parameters({"SIM_GPS1_VERR_X": 4, "SIM_GPS1_VERR_Y": 4}, {"SIM_GPS_VERR_X": 4, "SIM_GPS_VERR_Y": 4}),
        within_s=75,
    ),
    "battery: voltage low (BATT_FS_LOW_ACT)": Case(parameters({"BATT_LOW_VOLT": 13}), within_s=10 + DOWN_S),
    "battery: charge below 20 %": Case(parameters({"BATT_CAPACITY": 20}), within_s=4 + DOWN_S),
    "battery: charge not reported any more": Case(parameters({"BATT_CAPACITY": 10}), within_s=15 + DOWN_S),
    "remote control lost": Case(parameters({"SIM_RC_FAIL": 1}), within_s=5 + DOWN_S, before={"FS_THR_ENABLE": 3}),
    "stick moved, then both killed (-9)": Case(move_stick_and_kill),
    "stick moved, LAND, then both killed (-9)": Case(move_stick_land_and_kill),
    "SYSID_MYGCS changed in flight, both killed (-9)": Case(other_id_then_kill),
    **{
        f"{name} at start, without consent": Case(nothing, "refused", before={**GOOD, **values}, consent=False)
        for name, values in BLOCKED.items()
    },
    "FS_GCS_ENABLE 1 and RTL_ALT 300, both killed (-9)": Case(
        BOTH, before={**GOOD, "FS_GCS_ENABLE": 1, "RTL_ALT": 300}, consent=False, within_s=50
    ),
    **{
        f"{name} at start, set, both killed (-9)": Case(BOTH, before={**GOOD, **values})
        for name, values in BLOCKED.items()
        if "ARMING_CHECK" not in values
    },
    "ARMING_CHECK 0 at start, set: its checks have not run yet": Case(
        nothing, "refused", before={**GOOD, "ARMING_CHECK": 0}
    ),
}
CORE = (
    "nothing goes wrong",
    "take-over into LOITER",
    "pilot process killed (-9) in the flight",
    "guard killed (-9) in the flight",
    "both killed (-9) in the flight",
    "link silent both ways",
    "GPS lost",
    "battery: charge below 20 %",
    "ARMING_CHECK 0 at start, without consent",
    "FS_GCS_ENABLE 1 and RTL_ALT 300, both killed (-9)",
)
"""The cases that a release of ArduCopter has to pass before the program is said to fly it: one of each kind."""


def fly(name: str) -> Outcome:
    """Fly one case."""
    case = CASES[name]
    with tempfile.TemporaryDirectory(prefix="sitl-faults-") as folder:
        os.environ["XDG_STATE_HOME"] = folder
        come_first()
        try:
            vehicle = Vehicle(Path(folder), case.before)
        except CognitiveDroneError as error:
            return Outcome(name, good=False, end=str(error))
        log = Path(folder) / "flight.tlog"
        if case.log:
            log.symlink_to(case.log)
        code = PILOT.format(
            tests=str(TESTS), consent=case.consent, log=str(log), url=vehicle.relay.url, seconds=case.seconds
        )
        pilot = subprocess.Popen(
            [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
            start_new_session=True,
        )  # fmt: skip
        flight = Flight(vehicle, pilot)
        try:
            return _flown(name, case, flight)
        finally:
            flight.signal_guard(signal.SIGKILL)
            pilot.kill()
            pilot.communicate()
            vehicle.close()


def _flown(name: str, case: Case, flight: Flight) -> Outcome:
    vehicle, observer = flight.vehicle, flight.vehicle.observer
    line = flight.line()
    if not line.startswith("guard "):
        return Outcome(name, good=False, end=line)
    flight.guard = int(line.split()[1])
    if case.end == "refused":
        line = flight.line()
        refused = "[bad ]" in line or "refused arming" in line
        return Outcome(name, refused and not observer.armed, _bad_row(line) if "[bad ]" in line else line)
    if case.when == "climb":
        _until(lambda: observer.armed and vehicle.height > 0.3, 60)
    else:
        if (line := flight.line()) != "flying":
            return Outcome(name, good=False, end=line)
        time.sleep(3.0)
    if case.when == "landing":
        flight.pilot.send_signal(signal.SIGTERM)
        _until(lambda: observer.mode == "LAND", 10)
    at = time.monotonic()
    case.inject(flight)
    if case.end == "pilot":
        time.sleep(DISMISSED_S)
        flight.signal_guard(signal.SIGTERM)
        _until(lambda: not observer.armed, WATCHED_S - DISMISSED_S)
    else:
        _until(lambda: not observer.armed, at + case.within_s + 20 - time.monotonic())
    return _judged(name, case, flight, at)


def _judged(name: str, case: Case, flight: Flight, at: float) -> Outcome:
    observer = flight.vehicle.observer
    times, positions, velocities = flight.vehicle.flown(at)
    speed = np.linalg.norm(velocities, axis=1)
    still = np.flatnonzero(speed < STILL_M_S)
    changes = [(when - at, mode) for when, mode, _ in observer.modes if when >= at]
    start_mode = [mode for when, mode, _ in observer.modes if when < at][-1]
    changed = next((when for when, mode in changes if mode != start_mode), None)
    down = None if observer.armed else observer.modes[-1][0] - at
    near_ground = positions[:, 2] < 0.25
    touchdown = float(-velocities[near_ground, 2].min()) if down is not None and near_ground.any() else None
    way = float(np.linalg.norm(np.diff(positions[:, :2], axis=0), axis=1).sum())
    modes = [start_mode, *(mode for _, mode in changes if mode != start_mode)]
    if case.end == "pilot":
        foreign = [mode for mode in modes[1:] if mode != case.mode]
        put_back = observer.get("FS_GCS_ENABLE") == case.before.get("FS_GCS_ENABLE", 0)
        good = observer.mode == case.mode and not foreign and put_back
        end = f"in the pilot's hand: {observer.mode}" if observer.armed else f"landed in {observer.mode}"
        end += "" if put_back else ", FS_GCS_ENABLE NOT PUT BACK"
        end += f", foreign modes {foreign}" if foreign else ""
    else:
        on_ground = down is not None and positions[-1, 2] < 0.25
        soft = touchdown is None or touchdown < SOFT_M_S
        inside = float(np.linalg.norm(positions[:, :2], axis=1).max()) < FENCE_M and positions[:, 2].max() < CEILING_M
        in_time = down is not None and down <= case.within_s
        good = bool(on_ground and soft and inside and in_time)
        trouble = [
            word
            for word, holds in (("hard", soft), ("outside", inside), ("late", in_time), ("in the air", on_ground))
            if not holds
        ]
        end = " ".join(["landed" if on_ground else "NOT LANDED", "in", observer.mode, *trouble])
        end += "" if good else f", {positions[-1, 2]:.1f} m above the ground"
    ordered = next((f"guard: {mode}" for when, mode in flight.vehicle.relay.orders if when >= at - 1), "")
    reported = next((text for when, text in observer.texts if when >= at and "ailsafe" in text), "")
    return Outcome(
        name, good, end,
        stopped_s=_rounded(times[still[0]] - at) if len(still) else None,
        mode_s=_rounded(changed), down_s=_rounded(down), way_m=round(way, 1), touchdown_m_s=_rounded(touchdown),
        who="; ".join(part for part in (reported, ordered, _reason(flight)) if part),
    )  # fmt: skip


def _reason(flight: Flight) -> str:
    """The guard's reason for the end, as the pilot process prints it; empty where that was killed."""
    if flight.vehicle.observer.armed:
        return ""
    try:
        words, _ = flight.pilot.communicate(timeout=20)
    except subprocess.TimeoutExpired:
        return ""
    lines = [line.partition(" ")[2] for line in words.splitlines() if line.startswith(("over ", "landed ", "failed "))]
    return next((line for line in lines if line != "None"), "")


def _bad_row(line: str) -> str:
    """The first row of the checklist that blocks, in a line that quotes it."""
    return "refused: " + line.partition("[bad ]")[2].strip()[:60]


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(float(value), 2)


def _until(holds: Callable[[], bool], timeout_s: float) -> bool:
    deadline = time.monotonic() + timeout_s
    while not holds():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.02)
    return True


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", nargs="*", default=[], help="cases whose name holds one of these")
    parser.add_argument("--core", action="store_true", help="the cases of CORE alone")
    parser.add_argument("--times", type=int, default=1, help="how often each is flown")
    parser.add_argument("--at-once", type=int, default=1)
    parser.add_argument("--out", type=Path, help=OUT_HELP)
    options = parser.parse_args()
    names = [name for name in CASES if not options.only or any(part in name for part in options.only)]
    names = (list(CORE) if options.core else names) * options.times
    print(f"{len(names)} cases, {options.at_once} at once")
    print(f"{'case':<48} {'stopped':>7} {'mode':>6} {'down':>6} {'way':>5}  end")
    outcomes = []
    with ProcessPoolExecutor(options.at_once) as pool:
        for outcome in pool.map(fly, names):
            outcomes.append(outcome)
            times = (outcome.stopped_s, outcome.mode_s, outcome.down_s)
            shown = " ".join("     -" if each is None else f"{each:6.2f}" for each in times)
            print(
                f"{outcome.name:<48}  {shown} {outcome.way_m:5.1f}  {'ok' if outcome.good else 'FAILED':<6}"
                f" {outcome.end}{f' ({outcome.who})' if outcome.who else ''}",
                flush=True,
            )
    rows = [asdict(outcome) for outcome in outcomes]
    keep(
        options.out,
        "Faults in flight on a real ArduCopter on our Iris, in real time",
        rows,
        variables=(BINARY_VARIABLE,),
    )
    return 0 if all(outcome.good for outcome in outcomes) else 1


if __name__ == "__main__":
    sys.exit(main())
