"""Fixtures that several rooms' tests share."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

# Tests load models/tiny.py and what lies in support/ by their names.
for folder in ("models", "support"):
    sys.path.insert(0, str(Path(__file__).parent / folder))

# A busy machine makes no example wrong.
settings.register_profile("no deadline", deadline=None)
settings.load_profile("no deadline")


@pytest.fixture(scope="session")
def tiny_model_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A whole model file of a network that answers what tests can foresee. For reading only."""
    from tiny import tiny_model

    return tiny_model(tmp_path_factory.mktemp("models") / "tiny.onnx")


@pytest.fixture(scope="module")
def one_thread() -> Iterator[None]:
    """PyTorch on one thread: faster for tiny networks, by far where the machine is busy; and sums have one order."""
    torch = pytest.importorskip("torch")
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture
def no_vlm_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing in the environment says which chat API to ask, or with which key."""
    for name in ("COGNITIVEDRONE_VLM_URL", "COGNITIVEDRONE_VLM_MODEL", "COGNITIVEDRONE_VLM_KEY"):
        monkeypatch.delenv(name, raising=False)
    for name in ("OPENAI_API_KEY", "OPENAI_BASE_URL"):
        monkeypatch.delenv(name, raising=False)
