"""The obstacle eye is trained, and its file says what the network says."""

from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
import torch
from quick_trainings import train_here

from cognitivedrone.models.eyes.obstacle_eye import DEPTHS_M, EYE_FILE, PARTS, ObstacleEye
from cognitivedrone.models.eyes.obstacle_network import occupied_and_depth
from cognitivedrone.training.obstacles import DEBUG_OBSTACLES, ObstacleLoss, ObstacleTraining
from cognitivedrone.training.trainer.checkpoint import read_checkpoint, restore
from cognitivedrone.training.trainer.training_task import Given

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def task() -> ObstacleTraining:
    return DEBUG_OBSTACLES.training(Given())


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
