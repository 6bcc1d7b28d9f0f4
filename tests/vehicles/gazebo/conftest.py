"""Makes `reading` and `fake_gazebo` importable by their names, and writes one world for all."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(scope="session")
def track_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A track of the shipped suite, exported. For reading only."""
    from cognitivedrone.vehicles.gazebo.worlds.export import export

    return export("open-v1:track", track="0", out=tmp_path_factory.mktemp("gazebo") / "track").out
