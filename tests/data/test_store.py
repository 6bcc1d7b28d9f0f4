"""The store gives back every bit, is the same whoever wrote it, and says what is wrong in one sentence."""

import errno
import json
import os
import pickle
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from factory import assert_same_episode, make_episode
from made_stores import RECIPE, files_of, seal, write_store, writer_at
from tests.test_pictures import png_of
from typechecked import unchecked

from cognitivedrone.data.episode import decode_image, encode_image
from cognitivedrone.data.manifest import MANIFEST
from cognitivedrone.data.shards import FOOTER_KEY, SCHEMA, ShardFile
from cognitivedrone.data.store import Store
from cognitivedrone.data.store_writer import StoreWriter
from cognitivedrone.data.verify import verify
from cognitivedrone.errors import DataError
from cognitivedrone.files.locks import LOCK_FILE
from cognitivedrone.tasks.format import read_tasks


def test_every_bit_comes_back(sound_store, flights):
    store = Store.open(sound_store)
    assert len(store) == len(flights)
    assert store.n_steps == sum(len(flight) for flight in flights)
    for flight, stored in zip(flights, store.episodes(), strict=True):
        assert_same_episode(flight, stored)


@pytest.mark.parametrize("encoding", ["jpeg", "png", "webp"])
def test_frames_are_stored_as_encoded(tmp_path, encoding):
    flight = make_episode(0, length=3, encoding=encoding)
    store = Store.open(write_store(tmp_path / "store", [flight]))
    assert store.episode(0).images == flight.images
    shard = pq.ParquetFile(tmp_path / "store/shards/shard-00000.parquet")
    codecs = {
        shard.metadata.row_group(0).column(k).path_in_schema: shard.metadata.row_group(0).column(k).compression
        for k in range(shard.metadata.num_columns)
    }
    assert codecs.pop("image") == "UNCOMPRESSED"
    assert set(codecs.values()) == {"ZSTD"}


def test_frames_of_the_camera_that_looks_down_come_back_and_change_nothing_else(tmp_path):
    front, both = ([make_episode(index, 3, down=down) for index in range(10)] for down in (False, True))
    without, store = (Store.open(write_store(tmp_path / name, made)) for name, made in (("1", front), ("2", both)))
    assert (without.down_camera, store.down_camera) == (False, True)
    for flight, stored in zip(both, store.episodes(), strict=True):
        assert_same_episode(flight, stored)
    assert verify(tmp_path / "2") == []
    for one, other in zip(without.steps(range(9)).values(), store.steps(range(9)).values(), strict=True):
        np.testing.assert_array_equal(one, other)


def test_one_store_has_one_kind_of_camera(tmp_path):
    writer = writer_at(tmp_path / "store")
    one, other = make_episode(0), make_episode(1, down=True)
    with pytest.raises(DataError, match="episode 1: has frames of the camera that looks down, unlike those before it"):
        writer.write_shard(0, [one, other], {})
    writer.write_shard(0, [one], {})
    writer.write_shard(1, [other], {})
    with pytest.raises(DataError, match="only some shards have frames of the camera that looks down"):
        writer.finish()


def test_shards_may_be_written_in_any_order_by_any_process(tmp_path, sound_store, flights):
    other = tmp_path / "other"
    writer = pickle.loads(pickle.dumps(writer_at(other)))  # noqa: S301
    for number in (3, 0, 4, 1, 2):
        writer.write_shard(number, flights[8 * number : 8 * number + 8][::-1], {"collision": number})
    writer_at(other, resume=True).finish()
    assert files_of(other) == files_of(sound_store)


def test_steps_are_the_frames_actions_and_words_of_their_flights(sound_store, flights):
    store = Store.open(sound_store)
    where = [(flight, t) for flight in flights for t in range(len(flight))]
    numbers = np.random.default_rng(0).integers(0, store.n_steps, 50)
    for threads in (1, 2):
        batch = pickle.loads(pickle.dumps(store)).steps(numbers, threads)  # noqa: S301
        for row, number in enumerate(numbers):
            flight, t = where[number]
            np.testing.assert_array_equal(batch["image"][row], decode_image(flight.images[t]))
            np.testing.assert_array_equal(batch["action"][row], flight.action[t])
            np.testing.assert_array_equal(batch["state"][row], flight.state[t])
            assert batch["instruction"][row] == flight.task.instruction
            assert batch["directive"][row] == flight.task.directive


def test_splits_part_the_episodes(sound_store):
    store = Store.open(sound_store)
    train, val = store.indices("train"), store.indices("val")
    assert sorted(train + val) == store.indices()
    assert len(val) == 2
    assert len({store.episode(i).task.family for i in val}) == 2
    steps = np.concatenate([store.step_numbers("train"), store.step_numbers("val")])
    np.testing.assert_array_equal(np.sort(steps), np.arange(store.n_steps))
    assert [(split, episode.index) for split, episode in store.labelled()] == [
        (store.split_of(index), index) for index in store.indices()
    ]


def test_the_task_list_is_a_task_file(sound_store, flights):
    assert read_tasks(sound_store / "tasks.json") == [flight.task for flight in flights]


def test_dropped_flights_are_counted(sound_store):
    assert Store.open(sound_store).manifest["dropped"] == {"collision": 0 + 1 + 2 + 3 + 4}


WRITER_SCRIPT = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
import factory, made_stores
flights = [factory.make_episode(i, length=2 + i % 4, encoding="png") for i in range(40)]
writer = made_stores.writer_at(Path(sys.argv[2]), resume=True)
print("ready", flush=True)
for number in writer.missing_shards(5):
    writer.write_shard(number, flights[8 * number : 8 * number + 8], {"collision": number})
    print(number, flush=True)
writer.finish()
"""


def test_kill_9_at_any_moment_loses_nothing(tmp_path, sound_store):
    path = tmp_path / "store"
    command = [sys.executable, "-c", WRITER_SCRIPT, str(Path(__file__).parent), str(path)]
    deaths = 0
    while deaths < 2:  # each time a little later, in the middle of whatever it does then
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            for line in process.stdout:
                if line.strip() == ("ready" if deaths == 0 else str(deaths - 1)):
                    os.kill(process.pid, signal.SIGKILL)
                    break
            else:
                pytest.fail("the writer finished before it was killed")
        deaths += 1
    subprocess.run(command, check=True, capture_output=True)
    assert files_of(path) == files_of(sound_store)
    assert verify(path) == []


def test_a_full_disk_leaves_no_shard(tmp_path, flights, monkeypatch):
    path = tmp_path / "store"
    writer = writer_at(path)

    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(pq.ParquetWriter, "write_table", full)
        with pytest.raises(DataError, match=r"shard-00000\.parquet: cannot be written \(No space left on device\)"):
            writer.write_shard(0, flights[:8], {})
    assert sorted(files_of(path)) == ["manifest.json"]
    assert writer.missing_shards(1) == [0]
    with pytest.raises(DataError, match="shard 0 is missing"):
        writer.finish()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"recipe": {**RECIPE, "kick_rate": 0.2}}, r"another recipe \(kick_rate: 0.1 there, 0.2 here\)"),
        ({"suite_name": "open-v1:test"}, "another suite .*name: 'open-v1:train' there, 'open-v1:test' here"),
        ({"suite_digest": "ff"}, "another suite .*digest"),
        ({"seed": 4}, r"another seed \(3 there, 4 here\)"),
        ({"episodes_per_shard": 16}, "another episodes per shard"),
    ],
)
def test_another_making_is_refused(sound_store, change, message):
    before = files_of(sound_store)
    making = {"recipe": RECIPE, "suite_name": "open-v1:train", "suite_digest": "d1" * 32, "seed": 3}
    making |= {"episodes_per_shard": 8} | change
    with pytest.raises(DataError, match=message):
        StoreWriter(sound_store, resume=True, **making)
    assert files_of(sound_store) == before


def test_the_lock_of_a_folder_on_a_network_is_none_of_its_content(tmp_path, flights):
    (tmp_path / LOCK_FILE).touch()
    write_store(tmp_path, flights[:1])
    (tmp_path / MANIFEST).unlink()
    writer_at(tmp_path, resume=True).finish()
    assert (tmp_path / MANIFEST).exists()


def test_a_folder_in_use_is_refused(tmp_path, sound_store):
    with pytest.raises(DataError, match="holds a data set already; go on with --resume"):
        writer_at(sound_store)
    (tmp_path / "thesis.txt").write_text("mine")
    with pytest.raises(DataError, match="is not empty"):
        writer_at(tmp_path, resume=True)
    assert sorted(files_of(tmp_path)) == ["thesis.txt"]


def test_unfinished_and_foreign_folders_do_not_open(tmp_path):
    with pytest.raises(DataError, match="is not a data set"):
        Store.open(tmp_path)
    for path in (tmp_path / "nosuch", Path(__file__)):
        with pytest.raises(DataError, match="there is no such folder; give that of a data set"):
            Store.open(path)
        with pytest.raises(DataError, match="there is no such folder; give that of a data set"):
            verify(path)
    writer_at(tmp_path / "store")
    with pytest.raises(DataError, match=r"is not finished; go on with .*--resume"):
        Store.open(tmp_path / "store")


def test_another_version_does_not_open(tmp_path, flights):
    path = write_store(tmp_path / "store", flights[:8])
    manifest = path / "manifest.json"
    manifest.write_text(json.dumps(json.loads(manifest.read_text()) | {"version": 7}))
    seal(path)
    with pytest.raises(DataError, match=r"manifest\.json: the store has version 7, this release reads 1"):
        Store.open(path)
    with pytest.raises(DataError, match="version 7"):
        writer_at(path, resume=True)


def test_a_shard_cut_off_or_gone_is_named(tmp_path, flights):
    path = write_store(tmp_path / "store", flights[:16])
    shard = path / "shards/shard-00001.parquet"
    whole = shard.read_bytes()
    shard.write_bytes(whole[:5000])
    with pytest.raises(DataError, match=r"shard-00001\.parquet: has 5000 bytes instead of"):
        Store.open(path)
    shard.write_bytes(whole[: len(whole) // 2] + bytes(len(whole) - len(whole) // 2))
    with pytest.raises(DataError, match=r"shard-00001\.parquet: cannot be read"):
        Store.open(path).episode(8)
    shard.unlink()
    with pytest.raises(DataError, match=r"shard-00001\.parquet: is missing"):
        Store.open(path)


@pytest.mark.parametrize(
    ("encoding", "spoilt", "why"),
    [
        *((encoding, lambda frame: frame[: len(frame) // 2], "") for encoding in ("jpeg", "png", "webp")),
        ("png", lambda _: encode_image(np.zeros((64, 80, 3), np.uint8), "png"), r"\(it is 80x64, not 256x256\)"),
        *(
            ("png", lambda _, n=n: png_of(n, n), r"\(.*a frame has at most 2048 pixels a side")
            for n in (12_000, 30_000)
        ),
    ],
)
@pytest.mark.filterwarnings("error")
def test_a_broken_or_unfit_frame_is_named(tmp_path, encoding, spoilt, why):
    """A huge one before it is decoded."""
    good = make_episode(0, length=3, encoding=encoding)
    first, second, third = good.images
    store = Store.open(write_store(tmp_path / "store", [replace(good, images=(first, spoilt(second), third))]))
    assert len(store.steps([0, 2])["image"]) == 2
    with pytest.raises(DataError, match=rf"shard-00000\.parquet: the frame of episode 0, step 1, is broken {why}"):
        store.steps([0, 1], threads=2)


def test_the_example_of_the_documentation_runs(sound_store):
    page = (Path(__file__).parents[2] / "docs" / "data.md").read_text(encoding="utf-8")
    example = (
        page.partition("\n## The store\n")[2]
        .partition("```python\n")[2]
        .partition("```")[0]
        .replace("data/debug", str(sound_store))
    )
    scope: dict[str, Any] = {}
    exec(example, scope)  # noqa: S102
    assert scope["batch"]["image"].shape == (64, 256, 256, 3)
    assert scope["episode"].index == 17


def test_what_is_not_there_cannot_be_read(sound_store):
    store = Store.open(sound_store)
    with pytest.raises(DataError, match="has no episode 40; its 40 episodes are 0 to 39"):
        store.episode(40)
    for number in (-1, store.n_steps):
        with pytest.raises(DataError, match="a step number lies outside"):
            store.steps([0, number])
    with pytest.raises(DataError, match="unknown split 'vall'; did you mean 'val'"):
        store.step_numbers("vall")  # type: ignore[arg-type]


def test_flights_that_do_not_fit_are_refused(tmp_path, flights):
    writer = writer_at(tmp_path / "store")
    flight = flights[0]
    nan = flight.action.copy()
    nan[0, 0] = np.nan
    with unchecked():
        misfits = [
            (replace(flight, action=flight.action[1:]), "episode 0: action is float32"),
            (replace(flight, position=flight.position.astype(np.float32)), "episode 0: position is float32"),
            (replace(flight, images=()), "episode 0: has no step"),
            (replace(flight, down=flight.images[1:]), "episode 0: has 1 frames that look down; it must be one a step"),
            (replace(flight, action=nan), "episode 0: action holds a number that is not finite"),
        ]
    for bad, message in misfits:
        with pytest.raises(DataError, match=message):
            writer.write_shard(0, [bad], {})
    with pytest.raises(DataError, match=r"shard-00000\.parquet: episode 0 is repeated"):
        writer.write_shard(0, [flight, flight], {})
    writer.write_shard(0, [flight], {})
    writer.write_shard(1, [flight], {})
    with pytest.raises(DataError, match=r"episode 0 is in shards/shard-00000\.parquet and in shards/shard-00001"):
        writer.finish()
    assert writer.missing_shards(3) == [2]


REPEATED = pa.array([bytes(2**24)] * 2, pa.binary())
LONG = pa.array([[0.0] * 2**20] * 2, pa.list_(pa.float32()))
TEXTS = pa.array(["x" * 4096] * 40)


@pytest.mark.parametrize(
    ("steps", "change", "compression", "dictionary", "says"),
    [
        (2, lambda table: pa.concat_tables([table.slice(0, 1)] * 20_000).combine_chunks(),
         "zstd", True, "its 20,000 steps do not fit into"),
        (2, lambda table: table.set_column(2, SCHEMA.field("image"), REPEATED),
         "zstd", True, "the frames of row group 0 are compressed a second time"),
        (2, lambda table: table.set_column(3, "action", LONG), {"image": "none", "action.list.element": "zstd"}, False,
         "column action.list.element of row group 0 unpacks to .* bytes for 2 steps"),
        (40, lambda table: table.append_column("more", TEXTS), {"image": "none", "more": "zstd"}, ["more"],
         "column more of row group 0 unpacks to .* bytes for 40 steps"),
    ],
    ids=["rows", "frames", "numbers", "texts"],
)  # fmt: skip
def test_what_unpacks_to_more_than_there_can_be_is_not_read(tmp_path, steps, change, compression, dictionary, says):
    """Other rows, or otherwise compressed, under the footer that the shard had."""
    path = write_store(tmp_path / "store", [make_episode(0, length=steps)]) / "shards/shard-00000.parquet"
    before = pq.ParquetFile(path)
    footer = {FOOTER_KEY: before.metadata.metadata[FOOTER_KEY.encode()]}
    table = change(before.read()).replace_schema_metadata(footer)
    pq.write_table(table, path, compression=compression, use_dictionary=dictionary)
    assert len(table) <= 40 or path.stat().st_size < 400_000
    with pytest.raises(DataError, match=says):
        ShardFile(path)
