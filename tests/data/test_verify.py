"""`verify` finds every kind of damage and says which file has it."""

import contextlib
import hashlib
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_stores import files_of, seal, writer_at

from cognitivedrone.data.store import Store
from cognitivedrone.data.verify import Problem, verify
from cognitivedrone.errors import DataError

SHARD = "shards/shard-00002.parquet"


def edit(path: Path, change: Callable[[Any], object]) -> None:
    """Forge a file of a store, its checksum too."""
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n")
    seal(path.parent if path.parent.name != "shards" else path.parents[1])


@pytest.fixture
def store(sound_store, tmp_path):
    """A copy to harm."""
    return shutil.copytree(sound_store, tmp_path / "store")


@pytest.mark.parametrize(
    "name", ["SHA256SUMS", "manifest.json", "statistics.json", "tasks.json", SHARD, "shards/shard-00002.json"]
)
@pytest.mark.parametrize("what", ["a pipe", "a device", "a folder", "a link to itself", "far too large"])
def test_what_is_no_file_or_far_too_large_is_not_waited_for_and_not_read_whole(store, name, what):
    file = store / name
    if what == "far too large":
        os.truncate(file, 5 * 10**12)
    else:
        file.unlink()
        {
            "a pipe": lambda: os.mkfifo(file),
            "a device": lambda: file.symlink_to("/dev/zero"),
            "a folder": file.mkdir,
            "a link to itself": lambda: file.symlink_to(file.name),
        }[what]()
    try:
        problems = verify(store)
    except DataError as error:
        problems = [Problem(name, str(error))]
    assert problems
    with contextlib.suppress(DataError):  # of some files, reading the episodes needs nothing
        list(Store.open(store).labelled())


@pytest.mark.parametrize("name", ["SHA256SUMS", "manifest.json", "tasks.json", SHARD])
def test_a_file_that_is_a_link_to_the_right_content_is_told(store, name):
    (store / name).rename(store.parent / "elsewhere")
    (store / name).symlink_to(store.parent / "elsewhere")
    [problem] = verify(store)
    assert problem.file == name
    assert problem.message.startswith("is a link")


@pytest.mark.parametrize("name", ["../outside.json", "/etc/hostname", "shards/../../outside.json"])
def test_no_file_outside_of_the_store_is_hashed(store, name):
    (store.parent / "outside.json").write_text("{}")
    sums = (store / "SHA256SUMS").read_text()
    lines = sorted([*sums.splitlines(), f"{'0' * 64}  {name}"], key=lambda line: line[66:])
    (store / "SHA256SUMS").write_text("".join(f"{line}\n" for line in lines))
    assert Problem(name, "is missing") in verify(store)


def test_a_missing_a_truncated_and_a_stray_shard(store):
    shard, whole, stray = store / SHARD, (store / SHARD).read_bytes(), "shards/shard-00077.parquet"
    shard.unlink()
    assert verify(store) == [Problem(SHARD, "is missing")]
    shard.write_bytes(whole[:-1])
    assert verify(store) == [Problem(SHARD, f"is truncated: {len(whole) - 1} of {len(whole)} bytes")]
    shard.write_bytes(whole)
    shutil.copy(shard, store / stray)
    assert verify(store) == [Problem(stray, "is not in the manifest")]


@settings(max_examples=10)
@given(data=st.data())
def test_any_altered_byte(sound_store, data):
    whole = (sound_store / SHARD).read_bytes()
    at = data.draw(st.integers(0, len(whole) - 1))
    try:
        (sound_store / SHARD).write_bytes(whole[:at] + bytes([whole[at] ^ 0x10]) + whole[at + 1 :])
        (problem,) = verify(sound_store)
    finally:
        (sound_store / SHARD).write_bytes(whole)
    assert problem.file == SHARD
    assert "altered" in problem.message


def test_a_shard_in_the_place_of_another_with_its_hash_forged(store):
    shutil.copy(store / "shards/shard-00001.parquet", store / SHARD)
    content = (store / SHARD).read_bytes()
    forged = {"sha256": hashlib.sha256(content).hexdigest(), "bytes": len(content)}
    edit(store / "manifest.json", lambda manifest: manifest["shards"][2].update(forged))
    problems = verify(store)
    assert [problem.file for problem in problems] == [SHARD, "shards/shard-00002.json"]
    assert "other episodes" in problems[0].message


def test_a_duplicated_episode(store):
    edit(store / "manifest.json", lambda manifest: manifest["shards"].append(manifest["shards"][1]))
    problems = [str(problem) for problem in verify(store)]
    assert "manifest.json: lists episode 8 2 times" in problems
    assert "manifest.json: lists 48 episodes in its shards, but counts 40" in problems


def test_statistics_that_do_not_follow(store):
    edit(store / "statistics.json", lambda content: content["val"]["action"]["mean"].__setitem__(2, 0.25))
    assert verify(store) == [Problem("statistics.json", "does not follow from the shards")]
    (store / "statistics.json").unlink()
    (problem,) = verify(store)
    assert problem.file == "statistics.json"


def test_tasks_and_splits_that_do_not_follow(store):
    edit(store / "tasks.json", lambda tasks: tasks[3].update(prompt="Fly home"))
    assert verify(store) == [Problem("tasks.json", "does not list the tasks of the shards")]
    edit(store / "manifest.json", lambda manifest: manifest["splits"].update(val=[0]))
    assert verify(store)[0] == Problem("manifest.json", "its val split is not the one that suite and indices give")


def test_a_manifest_that_is_no_json_or_gone(store):
    (store / "manifest.json").write_text('{"format": ')
    assert verify(store) == [Problem("manifest.json", "is damaged: it is not JSON")]
    (store / "manifest.json").unlink()
    assert verify(store) == [Problem("manifest.json", "is missing")]


FILES = ("manifest.json", "statistics.json", "tasks.json", "SHA256SUMS", SHARD, "shards/shard-00002.json")
SPOILT: dict[str, Callable[[Path], object]] = {
    "empty": lambda path: path.write_bytes(b""),
    "deleted": lambda path: path.unlink(),
    "another digit": lambda path: path.write_bytes(path.read_bytes().replace(b"3", b"4", 1)),
}


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("how", SPOILT)
def test_every_file_is_checked_and_mended(store, flights, name, how):
    whole = files_of(store)
    SPOILT[how](store / name)
    named = {problem.file for problem in verify(store)}
    assert name in named or (name == "SHA256SUMS" and named)  # a wrong hash may be blamed on what it is of
    assert go_on(store, flights) == ([2] if name.startswith("shards/") else [])
    assert files_of(store) == whole
    assert verify(store) == []


@pytest.mark.parametrize(
    ("name", "read"), [("manifest.json", lambda _: None), ("statistics.json", lambda opened: opened.statistics())]
)
def test_an_altered_manifest_or_statistics_is_not_read(store, name, read):
    SPOILT["another digit"](store / name)
    with pytest.raises(DataError, match=rf"{name}: does not match its checksum in SHA256SUMS"):
        read(Store.open(store))


def test_what_a_killed_writer_left_is_told_and_removed(store):
    whole = files_of(store)
    (store / ".statistics.json.77.tmp").write_text("half")
    (store / "shards/.shard-00001.parquet.77.tmp").write_text("half")
    shutil.copytree(store / "shards", store / "partial")
    shutil.copy(store / "shards/shard-00001.json", store / "shards/shard-00009.json")
    assert len(verify(store)) == 2 + 11 + 1
    writer_at(store, resume=True).finish(5)
    assert files_of(store) == whole
    assert not (store / "partial").exists()


def test_a_manifest_is_not_made_up_for_the_shards_of_another_set(store):
    (store / "manifest.json").unlink()
    before = files_of(store)
    with pytest.raises(DataError, match="the shards beside it were not made with these settings"):
        writer_at(store, resume=True, seed=4)
    with pytest.raises(DataError, match="holds a data set already"):
        writer_at(store)
    (store / "manifest.json").write_text("{}")
    (store / "thesis.txt").write_text("mine")
    with pytest.raises(DataError, match="is not the manifest of a data set of this package"):
        writer_at(store, resume=True)
    (store / "manifest.json").unlink()
    (store / "thesis.txt").unlink()
    assert files_of(store) == before


def test_a_shard_of_another_set_is_not_taken_for_ours(tmp_path, flights):
    ours, theirs = writer_at(tmp_path / "ours"), writer_at(tmp_path / "theirs", seed=4)
    for writer in (ours, theirs):
        for number in (0, 1):
            writer.write_shard(number, flights[8 * number : 8 * number + 8], {})
    for name in ("shard-00001.parquet", "shard-00001.json"):
        shutil.copy(theirs.path / "shards" / name, ours.path / "shards" / name)
    assert writer_at(tmp_path / "ours", resume=True).missing_shards(2) == [1]


@pytest.mark.parametrize("folder", ["shards", "partial"])
def test_nothing_is_removed_or_written_through_a_link(store, tmp_path, flights, folder):
    theirs = tmp_path / "theirs"
    shutil.copytree(store / "shards", theirs)
    (theirs / ".shard-00001.parquet.77.tmp").write_text("of another collection")
    before = files_of(theirs)
    if folder == "shards":
        shutil.rmtree(store / "shards")
    opened = writer_at(store, resume=True) if folder == "partial" else None
    (store / folder).symlink_to(theirs)
    with pytest.raises(DataError, match=f"'{folder}' is a link or in one"):
        writer_at(store, resume=True)
    if opened is not None:  # the link came later
        for attempt in (lambda: opened.finish(4), lambda: opened.keep(1, flights[:2], {})):
            with pytest.raises(DataError, match=" is a link or in one"):
                attempt()
    assert files_of(theirs) == before


@pytest.mark.parametrize("name", ["manifest.json", "SHA256SUMS", "shards/shard-00001.parquet"])
def test_a_pipe_in_a_store_is_refused_when_it_is_resumed_and_a_sparse_file_is_written_anew(store, flights, name):
    whole = files_of(store)
    (store / name).unlink()
    os.mkfifo(store / name)
    with pytest.raises(DataError, match="it is a pipe"):
        go_on(store, flights)
    (store / name).unlink()
    (store / name).touch()
    os.truncate(store / name, 2**38)
    go_on(store, flights)
    assert files_of(store) == whole


def go_on(store, flights):
    """Collect again what is missing there; returns which shards."""
    writer = writer_at(store, resume=True)
    missing = writer.missing_shards(5)
    for number in missing:
        writer.write_shard(number, flights[8 * number : 8 * number + 8], {"collision": number})
    writer.finish(5)
    return missing
