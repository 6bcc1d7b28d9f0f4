"""A camera, a reasoner, a policy and a vehicle that tests can foresee."""

import io
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar, TextIO

import numpy as np
import pyarrow.parquet as pq
from rich.console import Console

from cognitivedrone.apps.config import FlyPlan, SimPlan
from cognitivedrone.apps.fly import fly_mission
from cognitivedrone.apps.orders import Orders
from cognitivedrone.apps.values import Summary
from cognitivedrone.apps.vehicle import FrameServer, Served, serve_vehicle
from cognitivedrone.interfaces import Reasoner
from cognitivedrone.pilot import Pilot
from cognitivedrone.policies.baselines import Hover
from cognitivedrone.types import ActionChunk, EpisodeContext, Guidance, Image, Observation, SeenPanel
from cognitivedrone.vehicles.contract import Pace


def quiet() -> Console:
    return Console(file=io.StringIO(), width=100)


def flown(
    typed: str = "",
    *,
    keyboard: TextIO | None = None,
    console: Console | None = None,
    pace: Pace = "wall",
    orders: Orders | None = None,
    pilot: Pilot | None = None,
    **options: Any,
) -> Summary:
    """A flight without a film by a plan's options, with a keyboard on which `typed` was typed."""
    return fly_mission(
        FlyPlan.of(film=False, **options),
        console=console or quiet(),
        keyboard=keyboard or io.StringIO(typed),
        pace=pace,
        orders=orders,
        pilot=pilot,
    )


def events_of(out: Path) -> list[dict[str, Any]]:
    return pq.read_table(out / "events.parquet").to_pylist()


def steps_of(out: Path) -> dict[str, list[Any]]:
    return pq.read_table(out / "steps.parquet").to_pydict()


class Echo:
    """Directs to the gate of the instruction's last word but "gate"."""

    def refine(self, image: Image, instruction: str) -> Guidance:
        return Guidance(f"Fly through the {instruction.removesuffix(' gate').split()[-1]} gate", None, 0.9)


class Doubtful(Reasoner):
    """Sure of cats alone; directs to the red gate, and says where it is."""

    seen = (SeenPanel("red", (128.0, 60.0, 30.0), "", ()),)

    def refine(self, image: Image, instruction: str) -> Guidance:
        return Guidance("Fly through the red gate", None, 0.9 if "cat" in instruction else 0.2)


class Typist(Hover):
    """Stays where it is, and types lines when it has decided so often: {decisions: line}."""

    lines: ClassVar[dict[int, bytes]] = {}
    keyboard: ClassVar[int] = -1
    """A file to write to."""

    def __init__(self) -> None:
        self.decisions = 0

    def act(self, observation: Observation) -> ActionChunk:
        self.decisions += 1
        if self.decisions in self.lines:
            os.write(self.keyboard, self.lines[self.decisions])
        return super().act(observation)


class Eager(Typist):
    """Types as well, but flies slowly forward."""

    def act(self, observation: Observation) -> ActionChunk:
        super().act(observation)
        return np.array([[0.5, 0.0, 0.0, 0.0]], dtype=np.float32)


class Broken:
    """Flies twice, then asks for NaN."""

    def reset(self, context: EpisodeContext) -> None:
        self.left = 2

    def act(self, observation: Observation) -> ActionChunk:
        self.left -= 1
        return np.full((1, 4), 0.0 if self.left >= 0 else np.nan, dtype=np.float32)


class Hangs(Hover):
    """Decides a few times, and then never again, in Python."""

    def __init__(self) -> None:
        self.left = 3

    def act(self, observation: Observation) -> ActionChunk:
        self.left -= 1
        if self.left < 0:
            threading.Event().wait()
        return super().act(observation)


class NeverCloses(Hover):
    """A good policy that leaves a thread behind, and does not close."""

    def __init__(self) -> None:
        threading.Thread(target=threading.Event().wait, name="left behind").start()

    def close(self) -> None:
        threading.Event().wait()


class LeavesThread(NeverCloses):
    """As that, but closes."""

    def close(self) -> None:
        pass


@contextmanager
def served(config: SimPlan) -> Iterator[Served]:
    """The simulated vehicle in a thread."""
    stopping, ready, reported = threading.Event(), threading.Event(), list[Served]()

    def announce(what: Served) -> None:
        reported.append(what)
        ready.set()

    thread = threading.Thread(target=serve_vehicle, args=(config, stopping.is_set, announce))
    thread.start()
    try:
        assert ready.wait(60)
        yield reported[0]
    finally:
        stopping.set()
        thread.join()


GREY = np.full((256, 256, 3), 128, np.uint8)


@contextmanager
def camera(picture: Image = GREY) -> Iterator[str]:
    """The address of a view that never changes, at 20 frames a second."""
    stopping = threading.Event()
    with FrameServer(0) as frames:

        def film() -> None:
            while not stopping.wait(0.05):
                frames.show(picture)

        thread = threading.Thread(target=film)
        thread.start()
        try:
            yield frames.url
        finally:
            stopping.set()
            thread.join()
