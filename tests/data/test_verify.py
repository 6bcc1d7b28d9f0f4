"""`verify` finds every kind of damage and says which file has it."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cognitivedrone.data.verify import Problem, verify
from cognitivedrone.errors import DataError

SHARD = "shards/shard-00002.parquet"


def edit(path: Path, change: Callable[[Any], object]) -> None:
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


@pytest.fixture
def store(sound_store: Path, tmp_path: Path) -> Path:
    """A copy to harm."""
    return shutil.copytree(sound_store, tmp_path / "store")


def test_a_sound_store_has_no_problem(sound_store: Path) -> None:
    assert verify(sound_store) == []


def test_a_missing_shard(store: Path) -> None:
    (store / SHARD).unlink()
    assert verify(store) == [Problem(SHARD, "is missing")]


def test_a_truncated_shard(store: Path) -> None:
    whole = (store / SHARD).read_bytes()
    (store / SHARD).write_bytes(whole[:-1])
    assert verify(store) == [Problem(SHARD, f"is truncated: {len(whole) - 1} of {len(whole)} bytes")]


@settings(max_examples=25)
@given(data=st.data())
def test_any_altered_byte(sound_store: Path, data: st.DataObject) -> None:
    whole = (sound_store / SHARD).read_bytes()
    at = data.draw(st.integers(0, len(whole) - 1))
    try:
        (sound_store / SHARD).write_bytes(whole[:at] + bytes([whole[at] ^ 0x10]) + whole[at + 1 :])
        (problem,) = verify(sound_store)
    finally:
        (sound_store / SHARD).write_bytes(whole)
    assert problem.file == SHARD
    assert "altered" in problem.message


def test_a_stray_shard(store: Path) -> None:
    shutil.copy(store / SHARD, store / "shards/shard-00077.parquet")
    assert verify(store) == [Problem("shards/shard-00077.parquet", "is not in the manifest")]


def test_a_shard_in_the_place_of_another_with_its_hash_forged(store: Path) -> None:
    shutil.copy(store / "shards/shard-00001.parquet", store / SHARD)
    content = (store / SHARD).read_bytes()
    forged = {"sha256": hashlib.sha256(content).hexdigest(), "bytes": len(content)}
    edit(store / "manifest.json", lambda manifest: manifest["shards"][2].update(forged))
    (problem,) = verify(store)
    assert problem.file == SHARD
    assert "other episodes" in problem.message


def test_a_duplicated_episode(store: Path) -> None:
    edit(store / "manifest.json", lambda manifest: manifest["shards"].append(manifest["shards"][1]))
    problems = [str(problem) for problem in verify(store)]
    assert "manifest.json: lists episode 8 2 times" in problems
    assert "manifest.json: lists 48 episodes in its shards, but counts 40" in problems


def test_statistics_that_do_not_follow(store: Path) -> None:
    edit(store / "statistics.json", lambda content: content["val"]["action"]["mean"].__setitem__(2, 0.25))
    assert verify(store) == [Problem("statistics.json", "does not follow from the shards")]
    (store / "statistics.json").unlink()
    (problem,) = verify(store)
    assert problem.file == "statistics.json"


def test_tasks_and_splits_that_do_not_follow(store: Path) -> None:
    edit(store / "tasks.json", lambda tasks: tasks[3].update(prompt="Fly home"))
    assert verify(store) == [Problem("tasks.json", "does not list the tasks of the shards")]
    edit(store / "manifest.json", lambda manifest: manifest["splits"].update(val=[0]))
    assert verify(store)[0] == Problem("manifest.json", "its val split is not the one that suite and indices give")


def test_a_damaged_manifest(store: Path) -> None:
    edit(store / "manifest.json", lambda manifest: manifest.pop("splits"))
    assert verify(store) == [Problem("manifest.json", "is damaged (no usable 'splits')")]
    (store / "manifest.json").write_text('{"format": ')
    with pytest.raises(DataError, match=r"manifest\.json: cannot be read"):
        verify(store)
