"""Commands that fly: fly, sim, and those of `gazebo`."""

from __future__ import annotations

import sys
import threading
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from tyro.conf import OmitArgPrefixes as Flat

from cognitivedrone.apps.config import FlyPlan, SimPlan
from cognitivedrone.play.config import PlayPlan
from cognitivedrone.sim.drawing.gl import look_ahead
from cognitivedrone.text.printable import visible, wrapped

if TYPE_CHECKING:
    from cognitivedrone.play.flight import FlightPage


def fly(plan: Annotated[Flat[FlyPlan], tyro.conf.arg(name="")]) -> None:
    """Fly a drone by an instruction, in real time: our simulator, ArduPilot SITL or a vehicle over MAVLink.

    During the flight, type a new instruction, or "land"; ctrl-C lands, too, and a second one ends the command once the
    drone is safe. Steps, events and a film are recorded. Exit
    code 0: through the right gate or one that only you can judge, declined rightly, or landed by order; 1: any other
    end; 130: ctrl-C. Examples:

      cognitivedrone fly --policy colour_seeker --reasoner oracle --suite open-v1:test --episode 3
      cognitivedrone fly --policy colour_seeker --reasoner none "Fly through the red gate"
      cognitivedrone fly --link mavlink:udp:127.0.0.1:14550 --camera http://127.0.0.1:8090/ "Fly through the red gate"

    Before you fly a real drone, read docs/real-drone.md.
    """
    from cognitivedrone.apps.fly import fly_mission
    from cognitivedrone.apps.view import summary_table
    from cognitivedrone.apps.watchdog import end_lingering
    from cognitivedrone.terminal import console

    screen, threads, code = console(), frozenset(threading.enumerate()), 2
    try:
        with ExitStack() as stack:
            page = stack.enter_context(_page(plan)) if plan.page else None
            if page is None:
                summary = fly_mission(plan, console=screen)
            else:
                summary = fly_mission(plan, console=screen, orders=page.orders, page=page.board)
        code = summary.exit_code
        screen.print(summary_table(summary))
        sys.exit(code)
    finally:
        end_lingering(threads, code)


def _page(plan: FlyPlan) -> AbstractContextManager[FlightPage]:
    from cognitivedrone.play.flight import page_of_flight

    return page_of_flight(plan, lambda address: print(f"the page is at {address}", flush=True))  # noqa: T201


def play(plan: Annotated[Flat[PlayPlan], tyro.conf.arg(name="")]) -> None:
    """Open the live page: type a sentence, watch the drone think and fly; put your own pictures on the gates.

    The page is served on this machine, at http://127.0.0.1:8090/, until ctrl-C. Examples:

      cognitivedrone play
      cognitivedrone play --suite open-v2:words --policy small --reasoner none
      cognitivedrone play results/small results/r1
    """
    look_ahead()
    from cognitivedrone.apps.orders import ending_on_signals
    from cognitivedrone.play.app import play as open_page

    def ready(address: str) -> None:
        print(visible(f"the page is at {address}  (ctrl-C ends)"), flush=True)  # noqa: T201

    with ending_on_signals():
        open_page(plan, ready)


def sim(plan: Annotated[Flat[SimPlan], tyro.conf.arg(name="")]) -> None:
    """Serve the simulator as a MAVLink vehicle, until ctrl-C: ground stations and `fly` connect to it.

    Needs the extra `mavlink`. Example:

      cognitivedrone sim --mavlink --camera-port 8090 --suite open-v1:test --episode 3
    """
    from cognitivedrone.apps.vehicle import serve_vehicle
    from cognitivedrone.system.interrupts import until_asked

    with until_asked() as stop:
        lost = serve_vehicle(plan, stop, lambda served: print(wrapped(str(served), sys.stdout), flush=True))  # noqa: T201
    print(f"stopped; the vehicle fell {lost:.1f} s behind the clock")  # noqa: T201


def export_world(
    out: Path,
    suite: str = "open-v1:smoke",
    tasks: Path | None = None,
    task: str | None = None,
    track: str | None = None,
    version: str = "harmonic",
    labels: str = "open-v1",
) -> None:
    """Write a task, or the stages of a track, as SDF worlds with meshes, textures and an ArduPilot vehicle.

    For example:

      cognitivedrone gazebo export --suite open-v1:test --task open-v1:test/0007 --out gazebo/0007
      cognitivedrone gazebo export --suite open-v1:track --track 3 --out gazebo/track3

    Args:
        out: New folder to write.
        suite: Name of a suite of tasks.
        tasks: Task file, or folder of them, instead of a suite.
        task: Id of one task.
        track: Number of a track, from 0, or the id of a task in it.
        version: Gazebo release that the folder's README says to install: harmonic, ionic or jetty.
        labels: Label pack, or a folder of pictures.
    """
    from cognitivedrone.vehicles.gazebo.worlds.export import export as export_to

    done = export_to(suite, tasks=tasks, out=out, task=task, track=track, version=version, labels=labels)
    for world, shown in zip(done.worlds, done.track, strict=True):
        right = "no gate" if shown.target is None else f"gate {shown.target + 1}"
        print(visible(f"{world}: {shown.instruction}  (right: {right})"))  # noqa: T201


def check_world(files: tyro.conf.Positional[tuple[Path, ...]]) -> None:
    """Check SDF files with libsdformat, Gazebo's own parser.

    Args:
        files: Worlds or models.
    """
    from cognitivedrone.vehicles.gazebo.worlds.export import check as check_files

    print(visible(f"{len(files)} passed {check_files(files)}"))  # noqa: T201
