"""Fixtures that several rooms' tests share."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

# Tests load models/tiny.py and what lies in support/ by their names.
for folder in ("models", "support"):
    sys.path.insert(0, str(Path(__file__).parent / folder))


@pytest.fixture(scope="session")
def tiny_model_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A whole model file of a network that answers what tests can foresee. For reading only."""
    from tiny import tiny_model

    return tiny_model(tmp_path_factory.mktemp("models") / "tiny.onnx")
