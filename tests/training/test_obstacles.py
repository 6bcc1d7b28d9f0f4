"""The obstacle eye: its frames among obstacles, how it is trained, and that its file says what the network says."""

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from quick_trainings import train_here

from cognitivedrone.frames import quaternion_from_yaw, rotate_yaw
from cognitivedrone.models.eyes.obstacle_eye import DEPTHS_M, EYE_FILE, PARTS, ObstacleEye
from cognitivedrone.models.eyes.obstacle_network import occupied_and_depth
from cognitivedrone.training.obstacles import (
    DEBUG_OBSTACLES,
    ObstacleFlights,
    ObstacleLoss,
    ObstacleTraining,
    obstacle_depth,
)
from cognitivedrone.training.perception.ground_truth import project
from cognitivedrone.training.trainer.checkpoint import read_checkpoint, restore
from cognitivedrone.training.trainer.training_task import Given
from cognitivedrone.types import IMAGE_SIZE, Gate, Obstacle, Stage
from cognitivedrone.world import geometry

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def task() -> ObstacleTraining:
    return replace(DEBUG_OBSTACLES, steps=2).training(Given())


def test_a_trained_eye_is_written_and_sees_what_the_network_sees(task: ObstacleTraining, tmp_path: Path) -> None:
    checkpoint = train_here(tmp_path, task)
    task.export(checkpoint, tmp_path)
    tensors, facts = read_checkpoint(checkpoint)
    assert facts["recipe"]["name"] == "debug-obstacles"
    network = task.network()
    restore(tensors, network, None)
    images = np.random.default_rng(0).integers(0, 255, (2, 256, 256, 3), np.uint8)
    with torch.no_grad():
        expected = [each.numpy() for each in network.eval()(torch.from_numpy(images))]
    for found, wanted in zip(ObstacleEye.load(tmp_path / EYE_FILE).look(images), expected, strict=True):
        np.testing.assert_allclose(found, wanted, rtol=5e-3, atol=5e-3)  # weights of half precision


def test_distances_are_classified_to_the_nearest_and_what_is_far_to_none(task: ObstacleTraining) -> None:
    loss = ObstacleLoss(task.network())
    depth = torch.tensor([0.1, *DEPTHS_M, 5.5, 6.0, float("inf")])
    assert torch.bucketize(depth, loss.edges).tolist() == [0, *range(len(DEPTHS_M)), 7, 8, 8]


def test_what_the_measures_of_a_perfect_and_a_blind_eye_are(
    task: ObstacleTraining, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = ObstacleLoss(task.network())
    depth = torch.full((2, PARTS, PARTS), float("inf"))
    depth[:, 4:8, 4:8] = 1.2
    batch = {"image": np.zeros((2, 256, 256, 3), np.uint8), "depth": depth.numpy()}
    known = torch.nn.functional.one_hot(torch.bucketize(depth, module.edges), len(DEPTHS_M) + 1).permute(0, 3, 1, 2)
    monkeypatch.setattr(module.network, "logits", lambda _: known * 20.0)
    row = task.validate(module, [batch], nullcontext)
    assert row == pytest.approx({"obstacles": 0.0, "found": 1.0, "right": 1.0, "distance error": 0.0}, abs=1e-3)
    nothing = torch.zeros_like(known)
    nothing[:, -1] = 1
    monkeypatch.setattr(module.network, "logits", lambda _: nothing * 20.0)
    row = task.validate(module, [batch], nullcontext)
    assert (row["found"], row["right"]) == (0, 0)
    assert row["obstacles"] > 1


def test_depths_are_means_of_what_is_likely_if_anything_is_there() -> None:
    logits = torch.full((1, len(DEPTHS_M) + 1, 1, 1), -30.0)
    logits[0, [2, 3]] = 0.0
    logits[0, -1] = np.log(6.0)
    occupied, depth = occupied_and_depth(logits, torch.tensor(DEPTHS_M).log())
    assert occupied.item() == pytest.approx(0.25)
    assert depth.item() == pytest.approx((DEPTHS_M[2] * DEPTHS_M[3]) ** 0.5)


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
    """How flights without disturbance end; no more are flown once one has hit something."""
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
        while len(ended) < flights and "collision" not in ended:
            batch = next(batches)
            assert batch["depth"].shape == (CALM.batch, PARTS, PARTS)
    finally:
        stream.close()
    return ended


def test_the_expert_flies_around_obstacles_or_headlong_into_them() -> None:
    assert {*outcomes(0.0, 4)} <= {"passed", "wrong_gate"}  # half are flown at another gate
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
