"""Shared pieces of the tests of OpenVLA."""

from pathlib import Path

import pytest


@pytest.fixture(scope="module", autouse=True)
def _everywhere(one_thread: None) -> None:
    """All of these tests run tiny networks."""


@pytest.fixture(scope="session")
def made_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tiny checkpoint with a head for chunks of 5. For reading only."""
    from openvla_files import write_checkpoint

    return write_checkpoint(tmp_path_factory.mktemp("openvla"), chunk=5)
