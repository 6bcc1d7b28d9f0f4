"""What holds for every format: each is whole or absent, streams, and carries the facts; and a user's own formats."""

import re
import resource
import weakref
from collections.abc import Iterable, Iterator
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from factory import assert_same_episode, make_episode

from cognitivedrone.data.episode import Episode, Split, decode_image
from cognitivedrone.data.formats import FRONT_ONLY, IMPORTS, export, import_
from cognitivedrone.errors import DataError


def made(index: int) -> Episode:
    """A flight; every fourth one was in a photographed place."""
    episode = make_episode(index, 2, encoding="jpeg")
    there = replace(episode.conditions, look="photo", place="hall")
    return replace(episode, conditions=there) if index % 4 == 2 else episode


FLIGHTS: list[tuple[Split, Episode]] = [("val" if index % 3 == 1 else "train", made(index)) for index in range(10)]


class Tracked(np.ndarray):
    """An array that a weak set can hold."""

    __hash__ = object.__hash__  # type: ignore[assignment]


def reader_of(to):
    return to.partition("-")[0]


def test_an_export_comes_back_to_the_bit(tmp_path, to):
    """The frames of a video excepted, which look alike. An import may order episodes by split."""
    assert export(FLIGHTS, to, tmp_path / "set") == len(FLIGHTS)
    back = {episode.index: (split, episode) for split, episode in import_(tmp_path / "set", reader_of(to))}
    assert len(back) == len(FLIGHTS)
    for split, before in FLIGHTS:
        assert back[before.index][0] == split
        after = back[before.index][1]
        for one, other in zip(before.images, after.images, strict=True):
            assert np.abs(decode_image(one).astype(int) - decode_image(other)).mean() < 4
        images, encoding = (after.images, after.encoding) if to.endswith("-video") else (before.images, before.encoding)
        assert_same_episode(after, replace(before, images=images, encoding=encoding))


def test_frames_of_the_camera_that_looks_down_come_back_where_there_is_a_place_for_them(tmp_path, to):
    flights: list[tuple[Split, Episode]] = [
        ("val" if index == 1 else "train", make_episode(index, 2, down=True)) for index in range(3)
    ]
    export(flights, to, tmp_path / "set")
    back = {episode.index: episode for _, episode in import_(tmp_path / "set", reader_of(to))}
    for _, flight in flights:
        down = back[flight.index].down
        assert len(down) == (0 if to in FRONT_ONLY else len(flight))
        for before, after in zip(flight.down, down, strict=False):
            assert np.abs(decode_image(before).astype(int) - decode_image(after)).mean() < 4


@pytest.mark.parametrize("to", ["rlds", "lerobot", "lerobot-video"])
def test_flights_with_and_without_a_camera_that_looks_down_are_not_mixed(tmp_path, to):
    flights: list[tuple[Split, Episode]] = [("train", make_episode(index, 2, down=index < 2)) for index in range(3)]
    with pytest.raises(DataError, match="episode 2: has no frames of the camera that looks down, unlike those before"):
        export(flights, to, tmp_path / "set")
    assert not list(tmp_path.iterdir())


def test_records_from_before_there_were_places_are_read(tmp_path, to):
    split, episode = FLIGHTS[0]
    before = {name: value for name, value in asdict(episode.conditions).items() if name != "place"}
    assert episode.conditions.facts() == before
    assert export([(split, episode)], to, tmp_path) == 1  # an empty folder is taken
    assert [back.conditions.place for _, back in import_(tmp_path, reader_of(to))] == [""]


def test_the_same_episodes_give_the_same_bytes(tmp_path, to):
    written = []
    for name in ("a", "b"):
        export(FLIGHTS, to, tmp_path / name)
        files = (path for path in sorted((tmp_path / name).rglob("*")) if path.is_file())
        written.append({path.relative_to(tmp_path / name): path.read_bytes() for path in files})
    assert written[0] == written[1]


def test_one_episode_is_in_memory_at_a_time(tmp_path, to):
    alive: weakref.WeakSet[Tracked] = weakref.WeakSet()

    def flights():
        for index in range(8):
            episode = make_episode(index, 2)
            object.__setattr__(episode, "final_position", episode.final_position.view(Tracked))
            alive.add(episode.final_position)
            assert len(alive) <= 3, "the writer hoards episodes"
            yield "train" if index % 2 else "val", episode
            del episode

    export(flights(), to, tmp_path / "set")


def test_nothing_is_overwritten(tmp_path, to):
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "precious").write_text("mine")
    with pytest.raises(DataError, match="set: exists already; give a new or an empty folder"):
        export(FLIGHTS, to, tmp_path / "set")
    with pytest.raises(DataError, match="precious: exists already"):
        export(FLIGHTS, to, tmp_path / "set" / "precious")
    assert [path.name for path in tmp_path.rglob("*")] == ["set", "precious"]
    assert (tmp_path / "set" / "precious").read_text() == "mine"


@pytest.mark.parametrize("failure", [DataError("shard-3 is broken"), KeyboardInterrupt()])
def test_an_export_that_fails_leaves_nothing(tmp_path, to, failure):
    def broken():
        yield from FLIGHTS[:3]
        raise failure

    with pytest.raises(type(failure)):
        export(broken(), to, tmp_path / "set")
    with pytest.raises(DataError, match="no episode to export"):
        export([], to, tmp_path / "set")
    assert not list(tmp_path.iterdir())


def test_what_cannot_be_written_is_told_and_leaves_nothing(tmp_path, to):
    """A limit on the size of files fails in the midst of one, as a full disk does."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, hard))
    try:
        with pytest.raises(DataError, match=r"cannot be written \(.*File too large.*\); nothing was left at .*set"):
            export(FLIGHTS, to, tmp_path / "set")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not list(tmp_path.iterdir())


def test_unwritable_folders_are_named(tmp_path, to):
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match=r"file.*: cannot be written"):
        export(FLIGHTS, to, tmp_path / "file" / "set")


@pytest.mark.parametrize("form", IMPORTS)
def test_a_folder_that_is_no_set_is_reported(tmp_path, form):
    with pytest.raises(DataError, match=re.escape(str(tmp_path))):
        list(import_(tmp_path, form))


def test_unknown_formats_have_near_names(tmp_path):
    with pytest.raises(DataError, match=r"unknown export format 'rlsd' .*; did you mean 'rlds'"):
        export(FLIGHTS, "rlsd", tmp_path / "set")
    with pytest.raises(DataError, match=r"unknown import format 'lerobt' .*; did you mean 'lerobot'"):
        import_(tmp_path, "lerobt")


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
