"""Stores that were forged with care, checksums and all: what is of no use in them is found, and not read."""

import io
import json
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from factory import make_episode
from made_stores import seal, write_store
from PIL import Image as PillowImage

from cognitivedrone.data.episode import Episode
from cognitivedrone.data.manifest import head_of, making_of, receipt_text
from cognitivedrone.data.shards import COMPRESSION, FOOTER_KEY
from cognitivedrone.data.store import Store
from cognitivedrone.data.verify import verify
from cognitivedrone.errors import DataError

Columns = dict[str, list[Any]]
SHARD = "shards/shard-00000.parquet"


def forge(store: Path, change: Callable[[list[Columns], dict[str, Any]], object], drop: str = "") -> None:
    """Change the columns of the first shard, by episode, and its footer, and write every hash anew."""
    file = pq.ParquetFile(store / SHARD)
    schema, tables = file.schema_arrow, [file.read_row_group(number) for number in range(file.num_row_groups)]
    footer = json.loads(file.metadata.metadata[FOOTER_KEY.encode()])
    columns = [{name: table[name].to_pylist() for name in table.column_names} for table in tables]
    change(columns, footer)
    fields = [pa.field(each.name, each.type) for each in schema if each.name != drop]
    packed = {name: how for name, how in COMPRESSION.items() if name != drop}
    with pq.ParquetWriter(store / SHARD, pa.schema(fields), compression=packed, use_dictionary=False) as writer:
        writer.add_key_value_metadata({FOOTER_KEY: json.dumps(footer)})
        for each in columns:
            arrays = [pa.array(each[field.name], field.type) for field in fields]
            writer.write_table(pa.Table.from_arrays(arrays, schema=pa.schema(fields)), row_group_size=10_000)
    manifest = json.loads((store / "manifest.json").read_text())
    content = (store / SHARD).read_bytes()
    manifest["shards"][0].update(sha256=sha256(content).hexdigest(), bytes=len(content))
    (store / "manifest.json").write_text(json.dumps(manifest))
    receipt = receipt_text(manifest["shards"][0], making_of(head_of(manifest)))
    (store / SHARD).with_suffix(".json").write_text(receipt)
    seal(store)


@pytest.fixture
def store(tmp_path: Path, flights: list[Episode]) -> Path:
    """Ten flights of lengths 2, 3, 4, 5, 2, ..."""
    return write_store(tmp_path / "store", flights[:10])


def picture(width: int, height: int) -> bytes:
    made = io.BytesIO()
    PillowImage.new("RGB", (width, height)).save(made, "PNG")
    return made.getvalue()


def swap(columns: list[Columns], names: tuple[str, ...]) -> None:
    for name in names:
        columns[0][name], columns[4][name] = columns[4][name], columns[0][name]


DATA = ("image", "action", "sent", "velocity", "height", "yaw_rate", "position", "quaternion")


def test_a_forged_store_without_changes_is_sound(store: Path) -> None:
    forge(store, lambda columns, footer: None)
    assert verify(store) == []


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda c, f: c[1]["image"].__setitem__(1, b""), "episode 1: frame 1 is no whole image"),
        (lambda c, f: c[1]["image"].__setitem__(1, picture(64, 64)), "frame 1 has 64 x 64 pixels, not 256 x 256"),
        (lambda c, f: c[1]["image"].__setitem__(0, c[1]["image"][0][:300]), "frame 0 is no whole image"),
        (lambda c, f: f["episodes"][2].update(encoding="jpeg"), "episode 2: frame 0 is PNG"),
        (lambda c, f: c[1]["position"].__setitem__(1, [np.nan, 0, 1]), "position holds a number that is not finite"),
        (lambda c, f: c[1]["velocity"].__setitem__(1, [np.inf, 0, 1]), "velocity holds a number that is not finite"),
        (lambda c, f: c[1]["quaternion"].__setitem__(1, [0, 0, 0, 0]), "no rotation"),
        (lambda c, f: swap(c, DATA), "its positions do not begin where its conditions say"),
        (lambda c, f: f["episodes"][0].update(final_position=[9, 9, 9]), "its positions do not lead to its end"),
        (lambda c, f: swap(c, ("episode", *DATA)), "the rows of an episode are those of another"),
        (lambda c, f: c[3]["step"].reverse(), "the rows of an episode are those of another"),
    ],
)
def test_verify_looks_at_what_it_vouches_for(store: Path, change: Any, reason: str) -> None:
    forge(store, change)
    problems = verify(store)
    assert problems
    assert {problem.file for problem in problems} == {SHARD}
    assert any(reason in problem.message for problem in problems)


def test_rows_of_another_episode_are_not_read(store: Path) -> None:
    forge(store, lambda columns, footer: swap(columns, ("episode", *DATA)))
    opened = Store(store)
    for read in (lambda: opened.episode(0), lambda: opened.steps([0]), lambda: opened.actions()):
        with pytest.raises(DataError, match="are those of another"):
            read()


def test_verify_looks_at_the_frames_of_the_camera_that_looks_down(tmp_path: Path) -> None:
    store = write_store(tmp_path / "store", [make_episode(index, 2, down=True) for index in range(3)])
    forge(store, lambda columns, footer: columns[1]["image_down"].__setitem__(1, picture(64, 64)))
    (problem,) = verify(store)
    assert "episode 1: frame 1 of the camera that looks down has 64 x 64 pixels" in problem.message


@pytest.mark.parametrize("name", ["image", "episode", "position"])
def test_a_shard_without_a_column_is_not_read(store: Path, name: str) -> None:
    forge(store, lambda columns, footer: None, drop=name)
    assert f"the column {name} is missing" in verify(store)[0].message
    with pytest.raises(DataError, match=f"the column {name} is missing"):
        Store(store).episode(0)


FOOTERS: list[tuple[Any, str]] = [
    (lambda c, f: f.pop("episodes"), "episodes is missing"),
    (lambda c, f: f.update(episodes=7), "must be a list"),
    (lambda c, f: f["episodes"].__setitem__(0, 7), "must be an object"),
    (lambda c, f: f["episodes"][0].update(index=True), "must be a whole number, not True"),
    (lambda c, f: f["episodes"][0].update(length="x"), "must be a whole number, not 'x'"),
    (lambda c, f: f["episodes"][0].update(length=10**12), "has 1000000000000 steps but 2 rows"),
    (lambda c, f: f["episodes"][0].update(final_position=[1, 2]), "has 2 items; it must have 3"),
    (lambda c, f: f["episodes"][0].update(final_position=[1, 2, None]), "a position, heading or wind is missing"),
    (lambda c, f: f["episodes"][0].update(task=[]), "must be an object"),
    (lambda c, f: f["episodes"][1].update(index=0), "lists an episode twice"),
    (lambda c, f: f.update(dropped=[1]), "must be an object"),
]


@pytest.mark.parametrize(("change", "reason"), FOOTERS)
def test_a_footer_of_another_form_is_told_in_one_sentence(store: Path, change: Any, reason: str) -> None:
    forge(store, change)
    assert any(reason in problem.message for problem in verify(store))
    with pytest.raises(DataError, match=reason):
        Store(store).episode(0)


MANIFESTS: list[tuple[Any, str]] = [
    (lambda m: m.update(version=True), "has version True"),
    (lambda m: m.pop("shards"), "shards is missing"),
    (lambda m: m.update(shards=[7]), "must be an object"),
    (lambda m: m.update(splits=[]), "splits must be an object"),
    (lambda m: m["splits"].update(val=[[1]]), "must be a whole number"),
    (lambda m: m["shards"][0].update(file="../../other.parquet"), "names the file '../../other.parquet'"),
    (lambda m: m["shards"][0].update(file=7), "must be text"),
    (lambda m: m["shards"][0].update(bytes=None), "must be a whole number"),
    (lambda m: m["shards"][0].update(sha256="x"), "must be 64 hexadecimal digits"),
    (lambda m: m["shards"][0]["lengths"].pop(), "lists 8 episodes and 7 lengths"),
    (lambda m: m["shards"][0]["lengths"].__setitem__(0, -1), "without steps"),
]


@pytest.mark.parametrize(("change", "reason"), MANIFESTS)
def test_a_manifest_of_another_form_is_told_in_one_sentence(store: Path, change: Any, reason: str) -> None:
    manifest = json.loads((store / "manifest.json").read_text())
    change(manifest)
    (store / "manifest.json").write_text(json.dumps(manifest))
    seal(store)
    with pytest.raises(DataError, match=reason):
        Store(store)
    if "version" not in reason:  # of which verify knows nothing else
        assert any(reason in problem.message for problem in verify(store))


@pytest.mark.parametrize(
    "text",
    [
        "[" * 2000 + "]" * 2000,
        '{"format": "cognitivedrone-store", "version": 1, "version": 1}',
        '{"version": 1e400}',
        "[]",
    ],
)
def test_a_manifest_that_is_no_plain_json_is_told_in_one_sentence(store: Path, text: str) -> None:
    (store / "manifest.json").write_text(text)
    seal(store)
    with pytest.raises(DataError, match=r"manifest\.json"):
        Store(store)
