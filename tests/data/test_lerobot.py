import json
import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from factory import make_episode
from ruamel.yaml import YAML

from cognitivedrone.data.episode import Episode, Split
from cognitivedrone.data.formats import exchange, export, import_, lerobot
from cognitivedrone.data.formats.lerobot_files import image_stats, number_stats
from cognitivedrone.errors import DataError
from cognitivedrone.models.words.text_encoder import hash_instruction

FLIGHTS: list[tuple[Split, Episode]] = [
    ("val" if index == 1 else "train", make_episode(index, 3 + index)) for index in range(4)
]
DATA = "data/chunk-000/file-000.parquet"
VAL = "data/chunk-000/file-001.parquet"


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    out = tmp_path_factory.mktemp("lerobot") / "set"
    assert export(iter(FLIGHTS), "lerobot", out) == len(FLIGHTS)
    return out


@pytest.fixture(scope="module")
def exported_video(tmp_path_factory):
    out = tmp_path_factory.mktemp("lerobot_video") / "set"
    assert export(iter(FLIGHTS), "lerobot-video", out) == len(FLIGHTS)
    return out


@pytest.fixture
def copied(exported, tmp_path):
    return Path(shutil.copytree(exported, tmp_path / "copy"))


def test_with_words_every_step_has_the_instruction_as_a_vector_and_all_comes_back(tmp_path):
    assert export(iter(FLIGHTS), "lerobot-words", tmp_path / "set") == len(FLIGHTS)
    key = lerobot.WORDS_KEY
    rows = pq.read_table(tmp_path / "set" / DATA).to_pylist()
    _, first = FLIGHTS[0]
    assert np.array_equal(np.float32(rows[0][key]), hash_instruction(first.task.instruction))
    assert json.loads((tmp_path / "set/meta/info.json").read_text())["features"][key]["shape"] == [256]
    assert len(json.loads((tmp_path / "set/meta/stats.json").read_text())[key]["mean"]) == 256
    back = next(each for _, each in import_(tmp_path / "set", "lerobot"))
    assert (back.task, back.images) == (first.task, first.images)
    assert np.array_equal(back.action, first.action)


def test_the_folder_holds_the_layout_and_nothing_else(exported):
    files = {str(path.relative_to(exported)) for path in exported.rglob("*") if path.is_file()}
    meta = {"meta/info.json", "meta/stats.json", "meta/tasks.parquet", "meta/episodes/chunk-000/file-000.parquet"}
    assert files == meta | {DATA, VAL, "README.md"}


def test_info_counts_and_declares_every_column(exported):
    info = json.loads((exported / "meta/info.json").read_text())
    frames = sum(len(episode) for _, episode in FLIGHTS)
    assert (info["codebase_version"], info["fps"]) == ("v3.0", 10)
    assert (info["total_episodes"], info["total_frames"]) == (4, frames)
    assert info["splits"] == {"train": "0:3", "val": "3:4"}
    schema = pq.read_schema(exported / DATA)
    assert schema.names == list(info["features"])
    assert {"directive", "category", "family", "place", "correct_gate", "seed"} <= set(schema.names)


def test_a_plain_reader_finds_the_types_of_the_columns_and_the_files_of_the_splits(exported, exported_video):
    """As the library `datasets` looks for them: types in the schema's metadata, splits in the card's YAML."""
    for folder, pictures in ((exported, True), (exported_video, False)):
        for split, file in (("train", DATA), ("val", VAL)):
            schema = pq.read_schema(folder / file)
            types = json.loads(schema.metadata[b"huggingface"])["info"]["features"]
            assert list(types) == schema.names
            assert types.get(lerobot.IMAGE_KEY) == ({"_type": "Image"} if pictures else None)
            assert types["action"] == {
                "feature": {"dtype": "float32", "_type": "Value"}, "length": 4, "_type": "Sequence",
            }  # fmt: skip
            assert types["timestamp"] == {"dtype": "float32", "_type": "Value"}
            assert types["directive"] == {"dtype": "string", "_type": "Value"}
            names = set(pq.read_table(folder / file)["episode_index"].to_pylist())
            assert names == ({3} if split == "val" else {0, 1, 2})
        card = (folder / "README.md").read_text("utf-8")
        assert card.startswith("---\n")
        header = YAML(typ="safe").load(card.split("---")[1])
        files = {"split": "train", "path": [DATA]}, {"split": "val", "path": [VAL]}
        assert header["configs"] == [{"config_name": "default", "data_files": list(files)}]


def test_rows_count_frames_episodes_and_tasks(exported):
    table = pa.concat_tables(pq.read_table(exported / file) for file in (DATA, VAL))
    assert table["index"].to_pylist() == list(range(len(table)))
    tasks = pq.read_table(exported / "meta/tasks.parquet")
    sentences = tasks["__index_level_0__"].to_pylist()
    assert sentences[table["task_index"][0].as_py()] == FLIGHTS[0][1].task.instruction
    pandas = json.loads(tasks.schema.metadata[b"pandas"])
    assert pandas["index_columns"] == ["__index_level_0__"]
    for row in pq.read_table(exported / "meta/episodes/chunk-000/file-000.parquet").to_pylist():
        part = table.slice(row["dataset_from_index"], row["length"])
        assert set(part["episode_index"].to_pylist()) == {row["episode_index"]}
        assert part["frame_index"].to_pylist() == list(range(row["length"]))
        np.testing.assert_allclose(part["timestamp"].to_numpy(), np.arange(row["length"]) / 10, rtol=1e-6)


def test_statistics_follow_from_the_steps(exported):
    stats = json.loads((exported / "meta/stats.json").read_text())
    actions = np.concatenate([episode.action for _, episode in FLIGHTS]).astype(np.float64)
    np.testing.assert_allclose(stats["action"]["mean"], actions.mean(0))
    np.testing.assert_allclose(stats["action"]["q99"], np.quantile(actions, 0.99, axis=0))
    assert stats["action"]["count"] == [len(actions)]
    assert np.shape(stats[lerobot.IMAGE_KEY]["mean"]) == (3, 1, 1)
    assert "directive" not in stats


@pytest.mark.parametrize("to", ["lerobot", "lerobot-video"])
def test_the_camera_that_looks_down_is_a_second_image_key(tmp_path, to):
    out = tmp_path / "set"
    export([("train", make_episode(0, 3, down=True)), ("val", make_episode(1, 3, down=True))], to, out)
    keys = ["observation.images.front", "observation.images.down"]
    info = json.loads((out / "meta/info.json").read_text())
    assert [name for name in info["features"] if "images" in name] == keys
    assert info["features"][keys[0]] == info["features"][keys[1]]
    stats = json.loads((out / "meta/stats.json").read_text())
    assert stats[keys[0]]["count"] == stats[keys[1]]["count"] == [6]
    schema = pq.read_schema(out / DATA)
    row = pq.read_table(out / "meta/episodes/chunk-000/file-000.parquet").to_pylist()[1]
    if to == "lerobot":
        assert schema.names == list(info["features"])
        types = json.loads(schema.metadata[b"huggingface"])["info"]["features"]
        assert types[keys[1]] == {"_type": "Image"}
    else:
        assert (out / "videos" / keys[1] / "chunk-000/file-001.mp4").is_file()
        assert (row[f"videos/{keys[1]}/file_index"], row[f"videos/{keys[1]}/to_timestamp"]) == (1, 0.3)


def test_picture_statistics_are_those_of_the_pixels():
    rng = np.random.default_rng(0)
    pixels = rng.integers(3, 200, (3, 10_000))
    stats = image_stats(np.stack([np.bincount(channel, minlength=256) for channel in pixels]), 7)
    numbers = number_stats(pixels.T / 255)
    for name in ("min", "max", "mean", "std"):
        np.testing.assert_allclose(np.ravel(stats[name]), numbers[name])
    for name in ("q01", "q50", "q99"):
        np.testing.assert_allclose(np.ravel(stats[name]), numbers[name], atol=1 / 255)
    assert stats["count"] == [7]


def test_files_are_cut_where_they_grow(tmp_path, monkeypatch):
    monkeypatch.setattr(lerobot, "FILE_MB", 0)
    monkeypatch.setattr(lerobot, "CHUNK_SIZE", 3)
    export(FLIGHTS, "lerobot", tmp_path / "set")
    names = sorted(str(path.relative_to(tmp_path / "set/data")) for path in (tmp_path / "set/data").rglob("*.parquet"))
    assert names == [*(f"chunk-000/file-00{i}.parquet" for i in range(3)), "chunk-001/file-000.parquet"]
    assert [episode.index for _, episode in import_(tmp_path / "set", "lerobot")] == [0, 2, 3, 1]


def test_a_truncated_video_is_named(exported_video, tmp_path):
    assert lerobot.IMAGE_KEY not in pq.read_schema(exported_video / DATA).names
    copy = Path(shutil.copytree(exported_video, tmp_path / "copy"))
    path = copy / "videos/observation.images.front/chunk-000/file-000.mp4"
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(DataError, match=r"file-000\.mp4: not a whole video"):
        list(import_(copy, "lerobot"))


@pytest.mark.parametrize("name", [DATA, "meta/episodes/chunk-000/file-000.parquet"])
@pytest.mark.parametrize("damage", ["truncate", "remove"])
def test_broken_parquet_is_named(copied, name, damage):
    path = copied / name
    if damage == "truncate":
        path.write_bytes(path.read_bytes()[:-100])
    else:
        path.unlink()
    with pytest.raises(DataError, match=r"file-000\.parquet: (not a whole parquet file|cannot be read)"):
        list(import_(copied, "lerobot"))


def test_tables_that_would_fill_the_memory_are_not_read(copied, monkeypatch):
    table = pq.read_table(copied / DATA).slice(0, 1)
    pq.write_table(pa.concat_tables([table] * 500).combine_chunks(), copied / DATA, compression="zstd")
    for limit in ("MAX_ROWS", "MAX_UNPACKED_BYTES"):
        with monkeypatch.context() as patched:
            patched.setattr(exchange, limit, 400)
            with pytest.raises(DataError, match=r"file-000\.parquet: has .* rows and .* bytes when unpacked; at most"):
                list(import_(copied, "lerobot"))


def test_a_frame_that_thousands_of_rows_share_is_not_read_once_for_each(copied, monkeypatch):
    table = pq.read_table(copied / DATA)
    frame = pa.array([{"bytes": bytes(2**22), "path": None}], table.schema.field(lerobot.IMAGE_KEY).type)
    few = table.slice(0, 1).set_column(table.column_names.index(lerobot.IMAGE_KEY), lerobot.IMAGE_KEY, frame)
    rows = pa.concat_tables([few] * 40).combine_chunks()  # 40 frames of 4 MB, stored once
    pq.write_table(rows, copied / DATA, compression="zstd")
    assert (copied / DATA).stat().st_size < 10**5
    monkeypatch.setattr(exchange, "MAX_UNPACKED_BYTES", 2**27)
    with pytest.raises(DataError, match=r"has 40 rows and .* bytes when unpacked; at most"):
        list(import_(copied, "lerobot"))


def with_a_broken_picture(table: pa.Table) -> pa.Table:
    images = table[lerobot.IMAGE_KEY].to_pylist()
    images[1]["bytes"] = b"no picture"
    return table.set_column(0, lerobot.IMAGE_KEY, pa.array(images, table.schema.field(lerobot.IMAGE_KEY).type))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda table: table.slice(1), "episode 0: holds 2 of 3 steps"),
        (with_a_broken_picture, "episode 0: frame 1 is broken"),
    ],
)
def test_missing_steps_are_counted_and_a_broken_picture_is_named(copied, change, says):
    pq.write_table(change(pq.read_table(copied / DATA)), copied / DATA)
    with pytest.raises(DataError, match=says):
        list(import_(copied, "lerobot"))


def test_other_versions_are_refused(copied):
    info = json.loads((copied / "meta/info.json").read_text()) | {"codebase_version": "v2.1"}
    (copied / "meta/info.json").write_text(json.dumps(info))
    with pytest.raises(
        DataError, match=r"info\.json: layout v2\.1 cannot be read, only v3; convert it first with LeRobot's"
    ):
        list(import_(copied, "lerobot"))


def test_an_export_comes_back_after_lerobots_tools_have_written_its_episodes_anew(copied):
    """As `delete_episodes` does: episodes numbered anew with known columns alone, steps with all of theirs."""
    before = [episode for _, episode in lerobot.read(copied)]
    path = next(copied.glob("meta/episodes/*/*.parquet"))
    table = pq.read_table(path).drop_columns(["record", "category", "family"])
    kept = table.slice(1)
    numbers = pa.array(range(len(kept)), pa.int64())
    kept = kept.set_column(kept.column_names.index("episode_index"), "episode_index", numbers)
    pq.write_table(kept, path)
    for file in copied.glob("data/*/*.parquet"):
        steps = pq.read_table(file)
        left = steps.filter(pc.greater(steps["episode_index"], 0))
        moved = pc.subtract(left["episode_index"], 1)
        pq.write_table(left.set_column(left.column_names.index("episode_index"), "episode_index", moved), file)
    after = [episode for _, episode in lerobot.read(copied)]
    assert [episode.task for episode in after] == [episode.task for episode in before[1:]]
    assert all((a.action == b.action).all() for a, b in zip(after, before[1:], strict=True))
