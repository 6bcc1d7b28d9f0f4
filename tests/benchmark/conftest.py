"""Shared pieces of the benchmark's tests."""

import sys
from pathlib import Path

import pytest

from cognitivedrone.benchmark.config import Plan

# Worker processes load the fake flyers by name, so their module must be importable; new processes inherit the path.
sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture
def config(tmp_path: Path) -> Plan:
    """Twenty quick episodes in this process, without films."""
    return Plan.of(policy="fake", suite="open-v1:train", episodes=20, workers=0, out=tmp_path / "run", clips=0)
