"""Records a flight as a ROS 2 bag in MCAP, for Foxglove and `ros2 bag`, while it flies.

The topics of `data/formats/mcap.py` with wall-clock stamps: the vehicle's estimated position and heading (`/pose`, if
known), images and commands, instruction and directive whenever they change; and in addition

| topic | type | |
|---|---|---|
| /event | std_msgs/String | segments, answers of the reasoner, missed deadlines, decisions of the guard: JSON |
| /flight | std_msgs/String | the options of the flight: JSON, at the start |
"""

from __future__ import annotations

import json
import queue
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from cognitivedrone.apps.values import Step
from cognitivedrone.data.episode import encode_image
from cognitivedrone.data.formats.mcap import (
    CAMERA,
    COMMAND,
    DIRECTIVE,
    FLIGHT_TOPICS,
    FRAME,
    HEIGHT,
    INSTRUCTION,
    POSE,
    TEXT_TYPE,
    VELOCITY,
    Bag,
    Ros,
)
from cognitivedrone.errors import RunError
from cognitivedrone.frames import quaternion_from_yaw
from cognitivedrone.types import CONTROL_HZ, Event

EVENT, FLIGHT = "/event", "/flight"
TOPICS = {**FLIGHT_TOPICS, EVENT: TEXT_TYPE, FLIGHT: TEXT_TYPE}
_QUEUED = 5 * CONTROL_HZ


class BagLog:
    """Writes to a new folder. Always call `close`: the bag is complete only then.

    A thread encodes and writes: a slow disk drops steps (`dropped`) but never delays a command. Raises `RunError` if
    the folder cannot be made.
    """

    def __init__(self, folder: Path, ros: Ros, about: Mapping[str, Any]) -> None:
        self.dropped = 0
        """Number of steps and events missing from the bag because the disk was too slow or full."""
        self._ros = ros
        self._start_ns = time.time_ns()
        self._latest: dict[str, str] = {}
        self._waiting: queue.Queue[Step | Event | None] = queue.Queue(_QUEUED)
        self._stack = ExitStack()
        try:
            if folder.exists():
                raise FileExistsError(None, "it exists already")
            self._bag: Bag = self._stack.enter_context(ros.create(folder, TOPICS))
        except OSError as error:
            raise RunError(
                f"cannot write a bag to {folder}: {error.strerror}; give another folder with --out"
            ) from None
        self._bag.write(FLIGHT, self._start_ns, ros.text(json.dumps(dict(about), default=str)))
        self._broken = False
        self._thread = threading.Thread(target=self._run, name="bag", daemon=True)
        self._thread.start()

    def step(self, step: Step) -> None:
        """Record a control step."""
        self._add(replace(step, observation=replace(step.observation, image=step.observation.image.copy())))

    def event(self, event: Event) -> None:
        """Record an event."""
        self._add(event)

    def close(self) -> None:
        """Write what is pending, and finish the bag."""
        self._waiting.put(None)
        self._thread.join()
        with suppress(OSError):
            self._stack.close()

    def _add(self, item: Step | Event) -> None:
        try:
            self._waiting.put_nowait(item)
        except queue.Full:
            self.dropped += 1

    def _run(self) -> None:
        while (item := self._waiting.get()) is not None:
            if not self._broken:
                self._write(item)
            self.dropped += self._broken

    def _write(self, item: Step | Event) -> None:
        """Write the messages of a step or event; a full disk ends the bag, not the flight."""
        stamp = self._start_ns + round(item.time * 1e9)
        try:
            for topic, message in self._messages(item, stamp):
                self._bag.write(topic, stamp, message)
        except OSError:
            self._broken = True

    def _messages(self, item: Step | Event, stamp: int) -> Iterator[tuple[str, Any]]:
        """Topics and messages of a step or event."""
        ros = self._ros
        if isinstance(item, Event):
            yield EVENT, ros.text(json.dumps(asdict(item), ensure_ascii=False))
            return
        seen, status = item.observation, item.status
        for topic, text in ((INSTRUCTION, item.instruction), (DIRECTIVE, seen.instruction)):
            if self._latest.get(topic) != text:
                self._latest[topic] = text
                yield topic, ros.text(text)
        yield FRAME, ros.frame(stamp, encode_image(seen.image, "jpeg"), "jpeg")
        yield CAMERA, ros.camera(stamp)
        if status.position is not None and not np.isnan(status.yaw):
            yield POSE, ros.pose(stamp, status.position, quaternion_from_yaw(status.yaw))
        yield VELOCITY, ros.twist(stamp, np.append(seen.velocity, seen.yaw_rate))
        yield HEIGHT, ros.number(seen.height)
        yield COMMAND, ros.twist(stamp, item.sent)
