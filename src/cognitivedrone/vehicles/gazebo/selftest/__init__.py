"""`gazebo selftest`: the checks of tests/external/gazebo.md, run in the Gazebo of this machine.

It exports a track, starts Gazebo on it, and measures what a flight depends on: files, poses, clock, camera, pictures,
stages and, with an ArduCopter, the vehicle. Every check becomes a `Check`; what cannot be run is skipped, with the
reason. Gazebo and ArduCopter are ended however it ends.
"""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Final, Literal

from cognitivedrone import checkout
from cognitivedrone.errors import CognitiveDroneError, GazeboError, LinkError
from cognitivedrone.files import replace_file
from cognitivedrone.labels import load_pack
from cognitivedrone.tasks import open_suite
from cognitivedrone.vehicles.gazebo.bindings import RELEASES, Bindings, load_bindings, simulator_versions
from cognitivedrone.vehicles.gazebo.live import GazeboWorld
from cognitivedrone.vehicles.gazebo.selftest.checks import (
    Finding,
    GazeboScene,
    camera_rate,
    clock,
    leftovers,
    loading,
    parsing,
    pictures,
    places,
    stages,
)
from cognitivedrone.vehicles.gazebo.selftest.checks_in_flight import FLIGHT_CHECKS, Airborne, RunningAutopilot
from cognitivedrone.vehicles.gazebo.server import NO_PLUGIN, GazeboServer, find_gazebo, own_partition
from cognitivedrone.vehicles.gazebo.worlds.export import PARAMETERS_FILE, find_track, stages_of, write
from cognitivedrone.vehicles.sitl.arducopter import BINARY_VARIABLE, ArduCopter, find_binary, port_is_free

Outcome = Literal["passed", "failed", "skipped"]

RESULTS_FILE: Final = "selftest.json"
_SUITE: Final = "open-v1:track"
CHECKS: Final[tuple[tuple[str, Callable[[GazeboScene], Finding]], ...]] = (
    ("places", places),
    ("clock", clock),
    ("camera", camera_rate),
    ("pictures", pictures),
    ("stages", stages),
)
"""Of a running world, in order."""
_WAY_OUT: Final = f"name one by --arducopter PATH or {BINARY_VARIABLE}=PATH"


@dataclass(frozen=True, slots=True)
class Check:
    """The result of one check."""

    name: str
    outcome: Outcome
    figure: str = ""
    """What was measured, as text."""
    reason: str = ""
    """Why it failed or was skipped."""
    values: dict[str, float] = field(default_factory=dict)
    """What was measured, as numbers."""


class Report:
    """The checks so far; `report_check` receives each."""

    def __init__(self, report_check: Callable[[Check], None]) -> None:
        self.checks: list[Check] = []
        self._report = report_check

    @property
    def failed(self) -> bool:
        """Whether a check failed."""
        return any(check.outcome == "failed" for check in self.checks)

    def run(self, name: str, measure: Callable[[], Finding]) -> None:
        """Run a check: failed if it finds a problem or cannot finish."""
        try:
            found = measure()
        except CognitiveDroneError as error:
            found = Finding("", str(error))
        outcome: Outcome = "skipped" if found.skipped else "failed" if found.problem else "passed"
        self._add(Check(name, outcome, found.figure, found.skipped or found.problem, dict(found.values)))

    def skip(self, names: tuple[str, ...], reason: str) -> None:
        """Checks that cannot be run."""
        for name in names:
            self._add(Check(name, "skipped", reason=reason))

    def _add(self, check: Check) -> None:
        self.checks.append(check)
        self._report(check)


def selftest(
    out: Path,
    *,
    arducopter: Path | None = None,
    report_check: Callable[[Check], None] = lambda _: None,
    bindings: Bindings | None = None,
    autopilot: Callable[[Path], RunningAutopilot] | None = None,
) -> Report:
    """Run all checks; writes `selftest.json`, pictures, logs and the exported world into the new folder `out`.

    `arducopter` is a SITL binary; by default the one of the environment variable ARDUCOPTER. `autopilot` starts another
    one in a folder. Raises `GazeboError` if Gazebo or its Python bindings are missing or `out` cannot be written,
    `LinkError` for an ArduCopter that cannot be run.
    """
    find_gazebo()
    bindings = bindings or load_bindings()
    start, lacking = (autopilot, "") if autopilot else _autopilot(arducopter)
    found = find_track(open_suite(_SUITE), track="0")
    exported = write(found, out / "world", load_pack(), RELEASES[bindings.release.name])
    scene = GazeboScene(out, exported.worlds, stages_of(found), load_pack())
    report = Report(report_check)
    with ExitStack() as stack:
        stack.callback(lambda: _save(report, out, bindings))
        stack.callback(scene.close)
        report.run("parser", lambda: parsing(scene))
        stack.enter_context(own_partition())
        server = stack.enter_context(GazeboServer(exported.worlds[0], out / "gazebo.log"))

        def load() -> Finding:
            world = server.connect(lambda: GazeboWorld(out / "spawned", bindings=bindings))
            scene.open(stack.enter_context(world), server)
            return loading(scene)

        report.run("world", load)
        rest = tuple(name for name, _ in CHECKS)
        in_flight = tuple(name for name, _ in FLIGHT_CHECKS)
        if not scene.opened:
            report.skip((*rest, *in_flight, "log"), "the world did not start")
            return report
        for name, check in CHECKS:
            report.run(name, lambda check=check: check(scene))  # type: ignore[misc]
        if start is None or any(NO_PLUGIN in line for line in server.complaints()):
            report.skip(in_flight, lacking or "Gazebo does not find ArduPilot's plugin: set GZ_SIM_SYSTEM_PLUGIN_PATH")
        else:
            _fly(scene, start, report)
        report.run("log", lambda: leftovers(scene))
    return report


def _fly(scene: GazeboScene, start: Callable[[Path], RunningAutopilot], report: Report) -> None:
    """The checks in flight, in order; once the vehicle is lost, the rest is skipped."""
    folder = scene.out / "arducopter"
    folder.mkdir()
    with start(folder) as autopilot, Airborne(scene, autopilot) as flight:
        for name, check in FLIGHT_CHECKS:
            if flight.lost:
                report.skip((name,), "the vehicle is not in the air")
            else:
                report.run(name, lambda check=check: check(flight))  # type: ignore[misc]


def _autopilot(named: Path | None) -> tuple[Callable[[Path], RunningAutopilot] | None, str]:
    """What starts ArduCopter in a folder; none without one, with the reason."""
    if named is None and not os.environ.get(BINARY_VARIABLE):
        return None, f"no ArduCopter: {_WAY_OUT}"
    binary = find_binary(named, _WAY_OUT)
    if not port_is_free(0):
        raise LinkError("TCP port 5760 is taken, where ArduCopter would listen; stop the other autopilot first")
    tree = Path(*binary.parts[:-4], "Tools", "autotest", "default_params", "copter.parm")
    if not tree.is_file():
        raise LinkError(f"there is no {tree}: leave ArduCopter in the tree that it was built in (build/sitl/bin)")

    def start(folder: Path) -> RunningAutopilot:
        parameters = (folder.parent / "world" / PARAMETERS_FILE).read_text(encoding="utf-8")
        return ArduCopter(binary, folder, defaults=[tree], airframe=None, parameters=parameters)

    return start, ""


def _save(report: Report, out: Path, bindings: Bindings) -> None:
    """Write the results, also of a test that was interrupted."""
    results = {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "cognitivedrone": metadata.version("cognitivedrone"),
        "commit": checkout.commit(),
        "gazebo": list(simulator_versions()),
        "bindings": bindings.release.name,
        "machine": f"{platform.platform()}, {os.cpu_count()} cores",
        "checks": [asdict(check) for check in report.checks],
    }
    try:
        replace_file(out / RESULTS_FILE, f"{json.dumps(results, indent=2)}\n".encode())
    except OSError as error:
        raise GazeboError(f"cannot write {out / RESULTS_FILE}: {error.strerror or error}") from None
