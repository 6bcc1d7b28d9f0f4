"""The film and the page of a flight, made from its log once it is over."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Literal

import av
from rich.console import Console

from cognitivedrone.apps.config import FlyPlan
from cognitivedrone.apps.log import FlightLog
from cognitivedrone.apps.values import EndKind, Summary
from cognitivedrone.apps.view import SILENT, say
from cognitivedrone.errors import CognitiveDroneError
from cognitivedrone.film.frame import Film, FilmFrame, Scene, Verdict
from cognitivedrone.film.movie import write_flight
from cognitivedrone.sim.airframe import find_airframe
from cognitivedrone.tasks.missions import is_mission, sub_goals
from cognitivedrone.terminal import console as stderr_console
from cognitivedrone.terminal.progress import counted

_HEADLINES: dict[EndKind, str] = {
    "passed": "Passed", "flown": "Flown: you judge", "missed": "Failed", "unsure": "Unsure: it hovered",
    "ordered": "Landed by order", "time": "Out of time", "vehicle": "Ended by the vehicle",
    "interrupted": "Interrupted",
}  # fmt: skip


def verdict_of_flight(summary: Summary) -> Verdict:
    """How a flight ended, in a few words."""
    kind, reason = summary.ending.kind, summary.ending.reason
    rating: Literal["good", "bad", "open"] = "open"
    if kind in ("passed", "missed", "unsure", "vehicle"):
        rating = "good" if kind == "passed" else "bad"
    lines = tuple(filter(None, (reason, f"{summary.seconds:.1f} s flown")))
    return Verdict(rating, _HEADLINES[kind], lines)


def film_flight(plan: FlyPlan, log: FlightLog, scenes: Sequence[Scene], summary: Summary, console: Console) -> None:
    """Write flight.mp4 and flight.html beside the log. A failure is reported, and the flight counts without them."""
    pilot = plan.pilot.shown
    film = Film(
        f"{pilot.policy} + {pilot.reasoner} on {plan.vehicle.link}"
        + (f": {plan.instruction}" if is_mission(sub_goals(plan.instruction)) else ""),
        _counted(log, summary.steps),
        scenes,
        verdict_of_flight(summary),
        [event for event in log.events if event.kind not in SILENT],
    )
    try:
        write_flight(log.out, film, find_airframe(plan.scenario.airframe))
    except (CognitiveDroneError, av.error.FFmpegError) as error:
        say(console, f"no film: {error}")
    except KeyboardInterrupt:
        say(console, "no film: stopped")


def _counted(log: FlightLog, steps: int) -> Iterator[FilmFrame]:
    """The frames, with a bar on a terminal."""
    return iter(counted(log.frames(), "filming", steps, show=stderr_console(stderr=True).is_terminal))
