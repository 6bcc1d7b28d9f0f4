"""What only a card can show of training: make test-card. It trains there, tells its waits, and says when it is full."""

import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from quick_trainings import TINY_READER, train_here

from cognitivedrone.errors import TrainingError
from cognitivedrone.models.compiling import in_memory
from cognitivedrone.training.trainer.checkpoint import METRICS, read_rows
from cognitivedrone.training.trainer.training_task import Given

pytestmark = [pytest.mark.card, pytest.mark.usefixtures("made_small")]


@pytest.mark.usefixtures("no_accelerator")
def test_a_training_on_a_card_tells_what_it_waited(tmp_path: Path) -> None:
    before = torch.cuda.max_memory_allocated()
    train_here(tmp_path, replace(TINY_READER, steps=4).training(Given()))
    assert torch.cuda.max_memory_allocated() > before
    rows = read_rows(tmp_path / METRICS)
    assert [row["step"] for row in rows] == [2, 4]
    for row in rows:
        assert 0 <= row["waiting"] <= 1
        assert row["steps_per_s"] > 0
        assert math.isfinite(row["train loss"])


def test_a_full_card_is_a_sentence() -> None:
    with (
        pytest.raises(TrainingError, match=r"^training: the card's memory is full: end what else uses it"),
        in_memory(TrainingError, "training", ""),
    ):
        torch.empty(10**13, dtype=torch.uint8, device="cuda")
