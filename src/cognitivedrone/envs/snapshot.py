"""A picture of one task: what the drone sees at the start, a chase view and the stage from above, side by side."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image as PillowImage

from cognitivedrone.envs.course import Course, CourseConfig, episode_rng
from cognitivedrone.errors import RunError, TaskError
from cognitivedrone.labels import load_pack
from cognitivedrone.sim.simulator import Simulator
from cognitivedrone.tasks import Suite
from cognitivedrone.types import IMAGE_SIZE, Image, Task

SCALE = 2
"""The views from outside are drawn at this many times the first-person view's size."""


def snapshot(suite: Suite, episode: int, out: Path, *, look: str, labels: str, seed: int) -> Task:
    """Write the picture to `out` and return the task that it shows."""
    if not 0 <= episode < len(suite.tracks):
        raise TaskError(f"suite {suite.name!r} has episodes 0 to {len(suite.tracks) - 1}, not {episode}")
    if not out.parent.is_dir():
        raise RunError(f"cannot write {out}: there is no folder {out.parent}")
    simulator = Simulator(1)
    course = Course(simulator, 0, load_pack(labels), CourseConfig(look=look))
    course.begin(suite.tracks[episode], episode_rng(suite.digest, episode, seed))
    PillowImage.fromarray(triptych(simulator, course)).save(out)
    simulator.close()
    return course.task


def triptych(simulator: Simulator, course: Course) -> Image:
    """First-person, chase and top view of one world, (2 * 256, 6 * 256, 3)."""
    if simulator.cameras is None:
        raise ValueError("this simulator was made without cameras")
    side = SCALE * IMAGE_SIZE
    state = simulator.state(course.world)
    own = simulator.frames(worlds=[course.world])[0].repeat(SCALE, axis=0).repeat(SCALE, axis=1)
    chase = simulator.cameras.chase(course.world, state, (side, side))
    top = simulator.cameras.top(course.world, state, (side, side))
    return np.concatenate([own, chase, top], axis=1)
