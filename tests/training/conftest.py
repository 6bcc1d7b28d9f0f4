"""What several tests of training start from."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def policy_checkpoint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    import torch

    from cognitivedrone.training.common.checkpoint import CHECKPOINT, save_checkpoint
    from cognitivedrone.training.recipes import RECIPES
    from cognitivedrone.training.small_vla import policy

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(policy, "_SENTENCES", 100)
        training_task = RECIPES["debug"].training()
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("policy") / CHECKPOINT
    save_checkpoint(
        path, training_task.network(), None, training_task.identity() | training_task.facts() | {"seed": 0, "step": 6}
    )
    return path
