"""A user's own formats, named as module:attribute: what does not look like a reader or writer is not called."""

from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest

from cognitivedrone.data.episode import Episode, Split
from cognitivedrone.data.formats import export, import_
from cognitivedrone.errors import DataError


def writer(episodes: Iterable[tuple[Split, Episode]], out: Path) -> int:
    return len([*episodes])


def reader(path):
    yield from ()


@pytest.mark.parametrize("name", ["os:system", "os:mkdir", "shutil:rmtree", "subprocess:run", "builtins:exec"])
def test_what_is_no_reader_or_writer_is_not_called(name, tmp_path):
    with pytest.raises(DataError, match="is not called"):
        export([], name, tmp_path / "out")
    with pytest.raises(DataError, match="is not called"):
        import_(tmp_path, name)
    assert not (tmp_path / "out").exists()


def test_own_ones_are_called(tmp_path):
    assert export([], f"{__name__}:writer", tmp_path) == 0
    back: Iterator[tuple[Split, Episode]] = import_(tmp_path, f"{__name__}:reader")
    assert [*back] == []
