"""The live page: its first frame, frames of the chase view per second, and missed deadlines with and without it.

python benchmarks/live_page.py --out results/live_page.json
"""

from __future__ import annotations

import io
import json
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from cognitivedrone.apps.config import FlyPlan
from cognitivedrone.apps.fly import fly_mission
from cognitivedrone.benchmark.measurements import OUT_HELP, keep
from cognitivedrone.pilot import open_pilot
from cognitivedrone.play.board import CHASE, LiveBoard
from cognitivedrone.play.config import PageSpec
from cognitivedrone.play.flight import FlightPage
from cognitivedrone.play.server import Channels, serving_page

SENTENCES = ("fly to the cat", "the elephant please", "go to the banana", "fly through the gate with the bus")


def first_frame_s() -> float:
    """Seconds from the command to the first picture of the drone's camera in a browser that is open already."""
    began = time.perf_counter()
    command = [sys.executable, "-m", "cognitivedrone", "play", "--port", "0", "--no-browser"]
    with tempfile.TemporaryDirectory() as folder:
        process = subprocess.Popen([*command, "--out", f"{folder}/out"], stdout=subprocess.PIPE, text=True)
        try:
            assert process.stdout is not None  # noqa: S101  (a pipe)
            address = process.stdout.readline().partition("http")[2].split()[0]
            with connect("ws" + address + "live") as page:
                while not isinstance(page.recv(timeout=60), bytes):
                    pass
            return time.perf_counter() - began
        finally:
            process.terminate()
            process.wait()


def flights(count: int, *, page: bool) -> dict[str, object]:
    """Missed deadlines of flights in real time; frames of the chase view per second, where a page is open."""
    late = steps = frames = 0
    watched_s = 0.0
    plan = FlyPlan(film=False, view=False)
    with open_pilot(plan.pilot) as pilot, tempfile.TemporaryDirectory() as folder:
        for number in range(count):
            flown = plan.changed(instruction=SENTENCES[number % len(SENTENCES)], out=Path(folder) / str(number))
            if not page:
                summary = fly_mission(flown, console=Console(file=io.StringIO()), keyboard=io.StringIO(), pilot=pilot)
            else:
                channels = Channels()
                board = LiveBoard(channels)
                controls = FlightPage(flown, board, channels)
                with serving_page(PageSpec(port=0, browser=False), channels, controls, None) as address:
                    seen: list[float] = []
                    watching = threading.Thread(target=watch, args=(address, seen))
                    watching.start()
                    summary = fly_mission(
                        flown, console=Console(file=io.StringIO()), keyboard=io.StringIO(), pilot=pilot,
                        orders=controls.orders, page=board,
                    )  # fmt: skip
                board.close()
                watching.join()
                frames += len(seen)
                watched_s += seen[-1] - seen[0]
            late += summary.late
            steps += summary.steps
    rate = {"chase_frames_per_s": round(frames / watched_s, 1)} if page else {}
    return {"late_steps": late, "steps": steps, **rate}


def watch(address: str, seen: list[float]) -> None:
    """A browser: takes everything, and writes down when a frame of the chase view came."""
    with connect(address.replace("http", "ws") + "live") as page:
        try:
            while True:
                message = page.recv(timeout=60)
                if isinstance(message, bytes) and message[:1] == CHASE:
                    seen.append(time.perf_counter())
        except ConnectionClosed:
            return


@dataclass(frozen=True)
class Config:
    """What is measured."""

    flights: int = 8
    repeats: int = 5
    out: Annotated[Path | None, tyro.conf.arg(help=OUT_HELP)] = None


def main(config: Config) -> None:
    """Print and keep the figures."""
    starts = sorted(round(first_frame_s(), 2) for _ in range(config.repeats))
    rows: list[dict[str, object]] = [
        {"what": "without a page", **flights(config.flights, page=False)},
        {"what": "with a page", "first_frame_s": starts[len(starts) // 2], **flights(config.flights, page=True)},
    ]
    for row in rows:
        print(json.dumps(row))
    keep(config.out, "the live page: first frame, chase view, missed deadlines with and without it", rows)


if __name__ == "__main__":
    main(tyro.cli(Config))
