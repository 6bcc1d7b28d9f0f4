"""Shared pieces of the tests of OpenVLA."""

from collections.abc import Iterator
from pathlib import Path

import pytest


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    """Tiny networks are slower on many threads than on one, by far where the machine is busy."""
    torch = pytest.importorskip("torch")
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture(scope="session")
def made_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tiny checkpoint with a head for chunks of 5. For reading only."""
    pytest.importorskip("torch")
    pytest.importorskip("transformers")
    from openvla_files import write_checkpoint

    return write_checkpoint(tmp_path_factory.mktemp("openvla"), chunk=5)
