"""Cost of a frame of the chase view, beside that of the policy's camera, in CPU time of the thread that draws.

Run: python benchmarks/chase.py [--frames 40]
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import tyro

from cognitivedrone.envs.track_runner import scenery_of, stage_of
from cognitivedrone.frames import quaternion_from_yaw
from cognitivedrone.labels import load_pack
from cognitivedrone.sim.drawing.camera import Cameras
from cognitivedrone.sim.drawing.chase import FILM_SIZE, LIVE_SIZE, ChaseView
from cognitivedrone.sim.drawing.gl import GLThread, renderer_name
from cognitivedrone.tasks import load_suite
from cognitivedrone.world.appearance import PLAIN

LEVEL = quaternion_from_yaw(0.0)


@dataclass(frozen=True)
class Config:
    """What is measured."""

    frames: int = 40


def main(config: Config) -> None:
    """Print CPU milliseconds a frame."""
    stage = stage_of(load_suite("open-v1:test").tracks[3][0])
    scenery = scenery_of(stage, load_pack("open-v1"), PLAIN)
    print(renderer_name())
    with Cameras(1) as cameras:
        cameras.set_stage(0, stage, scenery.panels)
        policy = _cost(cameras._threads[0], lambda x: cameras.first_person([[x, 0, 1]], [LEVEL]), config.frames)
    print(f"policy's camera, 256 x 256: {policy:.1f} ms")
    for width, height in ((480, 270), LIVE_SIZE, FILM_SIZE):
        for samples in (0, 4):
            with ChaseView(stage, scenery, width, height, samples=samples) as view:
                cost = _cost(view._thread, partial(_drawn, view), config.frames)
            print(f"chase, {width} x {height}, {samples} samples: {cost:.1f} ms, {cost / policy:.1f} times")


def _drawn(view: ChaseView, x: float) -> object:
    return view.frame((x, 0, 1), LEVEL)


def _cost(thread: GLThread, draw: Callable[[float], object], frames: int) -> float:
    """CPU ms a frame; the first two are not counted."""
    for index in range(2):
        draw(0.1 * index)
    began: float = thread.call(time.thread_time).result()
    for index in range(frames):
        draw(0.1 * index)
    return float(1e3 * (thread.call(time.thread_time).result() - began) / frames)


if __name__ == "__main__":
    main(tyro.cli(Config))
