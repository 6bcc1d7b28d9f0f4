"""Fixtures over synthetic flights; the flights are made in factory.py, stores of them in made_stores.py."""

import sys
from pathlib import Path

import pytest

from cognitivedrone.data.episode import Episode
from cognitivedrone.data.formats import EXPORTS

# Tests and the processes they start load factory.py and made_stores.py by their names.
sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(scope="session")
def flights() -> list[Episode]:
    """Forty short flights of lengths 2 to 5, all families four times."""
    from factory import make_episode

    return [make_episode(index, length=2 + index % 4, encoding="png") for index in range(40)]


@pytest.fixture(scope="session")
def sound_store(tmp_path_factory: pytest.TempPathFactory, flights: list[Episode]) -> Path:
    """A finished store of `flights`. For reading only: tests that harm a store copy it."""
    from made_stores import write_store

    return write_store(tmp_path_factory.mktemp("stores") / "sound", flights)


@pytest.fixture(params=EXPORTS)
def to(request: pytest.FixtureRequest) -> str:
    """Every format of an export in turn."""
    return str(request.param)
