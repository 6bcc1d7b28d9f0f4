"""Frames among obstacles, and how far away these are said to be."""

from dataclasses import replace

import numpy as np
import pytest

from cognitivedrone.frames import quaternion_from_yaw, rotate_yaw
from cognitivedrone.models.eyes.obstacle_eye import PARTS
from cognitivedrone.training.obstacles import DEBUG_OBSTACLES, ObstacleFlights, obstacle_depth
from cognitivedrone.training.perception.ground_truth import project
from cognitivedrone.types import IMAGE_SIZE, Gate, Obstacle, Stage
from cognitivedrone.world import geometry

STAGE = Stage(
    gates=(Gate("small", "round", "red"), Gate("small", "square", "green"), Gate("small", "round", "blue")),
    labels=("number/1@inter", "number/2@inter", "number/3@inter"),
)
TURNED = replace(STAGE, origin=(12.0, -7.0), yaw=2.0)
PIXELS = IMAGE_SIZE // PARTS
CALM = replace(DEBUG_OBSTACLES.stream, obstacles=1.0, wander=0.0, rolling=0.0, off_track=0.0, places=0.0, varied=0.0)


@pytest.mark.parametrize("stage", [STAGE, TURNED])
def test_obstacles_are_where_they_are_in_the_image_and_gates_are_none(stage: Stage) -> None:
    x, y, z = geometry.START
    low = Obstacle("wall", x + 2.0, y + 0.4, 0.5, z + 0.3, 0.1)
    beam = Obstacle("beam", x + 3.0, y, 3.0, 0.2, 0.1, above=z + 1.0)
    place = rotate_yaw(np.array([x, y, z]), stage.yaw) + np.array([*stage.origin, 0.0])
    quaternion = quaternion_from_yaw(stage.yaw)
    assert np.isinf(obstacle_depth(place, quaternion, stage)).all()
    depth = obstacle_depth(place, quaternion, replace(stage, obstacles=(low, beam)))
    assert depth.shape == (PARTS, PARTS)
    front = np.array([[place + rotate_yaw(np.array([1.95, 0.4, -0.5]), stage.yaw)]])
    u, v, far = project(front, place[None], quaternion[None])[0, 0]
    assert depth[int(v // PIXELS), int(u // PIXELS)] == pytest.approx(far, rel=0.01)
    assert depth.min() == pytest.approx(far, rel=0.01)
    assert np.isinf(depth[-1, -4:]).all()
    above = np.array([[place + rotate_yaw(np.array([2.95, 0.0, 1.1]), stage.yaw)]])
    u, v, far = project(above, place[None], quaternion[None])[0, 0]
    assert depth[int(v // PIXELS), int(u // PIXELS)] == pytest.approx(far, rel=0.01)


def outcomes(headlong: float, flights: int) -> list[str]:
    """How flights without disturbance end."""
    stream = ObstacleFlights(replace(CALM, headlong=headlong))
    ended: list[str] = []
    try:
        batches = stream((0,))
        advance = stream._worlds.advance

        def watched() -> list:
            results = advance()
            ended.extend(result.outcome for result in results if result is not None)
            return results

        stream._worlds.advance = watched
        while len(ended) < flights:
            batch = next(batches)
            assert batch["depth"].shape == (CALM.batch, PARTS, PARTS)
    finally:
        stream.close()
    return ended


def test_the_expert_flies_around_obstacles_or_headlong_into_them() -> None:
    assert {*outcomes(0.0, 8)} <= {"passed", "wrong_gate"}  # half are flown at another gate
    assert "collision" in outcomes(1.0, 8)


def test_the_same_seed_makes_the_same_frames() -> None:
    made = []
    for seed in (1, 1, 2):
        stream = ObstacleFlights(DEBUG_OBSTACLES.stream)
        try:
            made.append(next(iter(stream((seed,)))))
        finally:
            stream.close()
    for name in ("image", "depth"):
        np.testing.assert_array_equal(made[0][name], made[1][name])
    assert not np.array_equal(made[0]["image"], made[2]["image"])
