"""What several tests of training start from."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest


@pytest.fixture(scope="module")
def made_small() -> Iterator[None]:
    """Few sentences, pictures and frames where a real training draws thousands."""
    with small():
        yield


@contextmanager
def small() -> Iterator[None]:
    from quick_trainings import make_small

    with pytest.MonkeyPatch.context() as patch:
        make_small(patch)
        yield


@pytest.fixture(scope="session")
def reader_checkpoint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tiny reader with random weights."""
    from quick_trainings import TINY_READER, saved

    from cognitivedrone.training.common.training_task import Given

    return saved(TINY_READER.training(Given()), tmp_path_factory.mktemp("reader"))


@pytest.fixture(scope="session")
def policy_checkpoint(tmp_path_factory: pytest.TempPathFactory, reader_checkpoint: Path) -> Path:
    """A tiny policy with random weights, and that reader."""
    from quick_trainings import saved

    from cognitivedrone.training.common.training_task import Given
    from cognitivedrone.training.recipes import RECIPES

    with small():
        return saved(RECIPES["debug"].training(Given(start=reader_checkpoint)), tmp_path_factory.mktemp("policy"))


@pytest.fixture(scope="session")
def policy_file(tmp_path_factory: pytest.TempPathFactory, policy_checkpoint: Path) -> Path:
    """That policy as a model file."""
    from cognitivedrone.training.small_vla.export import export

    path = tmp_path_factory.mktemp("file") / "model.onnx"
    with small():
        export(policy_checkpoint, path, scores={"open-v1:test": 0.5})
    return path
