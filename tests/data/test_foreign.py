"""RLDS and LeRobot sets that this package did not make, or that lack their descriptions."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest
from factory import make_episode

from cognitivedrone.cli import main
from cognitivedrone.data.episode import Episode, Split
from cognitivedrone.data.formats import export, import_
from cognitivedrone.data.formats.foreign import Columns, has_scene
from cognitivedrone.data.formats.tfrecord import encode_example, write_record
from cognitivedrone.errors import DataError

FLIGHTS: list[tuple[Split, Episode]] = [
    ("train", make_episode(index, 5 + index, encoding="jpeg")) for index in range(3)
]


def shard(path, width=4, **more):
    """A shard of two episodes in the published names; actions are backward displacements over three samples."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        for _, episode in FLIGHTS[:2]:
            actions = np.zeros((len(episode), width), np.float32)
            actions[:, 0] = -0.3 * episode.action[:, 0]
            actions[:, 2] = -0.3 * episode.action[:, 2]
            features = {
                "steps/observation/image": list(episode.images),
                "steps/action": actions.ravel(),
                "steps/language_instruction": [b"Fly through the gate with ten"] * len(episode),
                "steps/language_instruction_simple": [b"Fly through the small round green gate"] * len(episode),
                "episode_metadata/type": [b"Digits"],
                **more,
            }
            write_record(file, encode_example(features))


def test_shards_alone_are_read_by_their_records(tmp_path):
    shard(tmp_path / "cognitive_drone-train.tfrecord-00003-of-00128")
    with pytest.warns(UserWarning, match=r"only 1 of 128 shards .* poses and scenes are not recorded") as said:
        found = list(import_(tmp_path, "rlds", "published"))
    assert "dataset_info.json and features.json are missing" in str(said[0].message)
    for (split, episode), (_, original) in zip(found, FLIGHTS, strict=False):
        assert (split, episode.task.family, episode.task.category) == ("train", "digits", "symbol_understanding")
        assert episode.task.instruction == "Fly through the gate with ten"
        assert episode.task.gates[episode.task.target].color == "green"
        assert episode.images == original.images
        assert not has_scene(episode.task)
        np.testing.assert_allclose(episode.action[:, [0, 2]], original.action[:, [0, 2]], atol=1e-5)


def test_our_own_export_without_its_descriptions_is_read_exactly(tmp_path):
    export(iter(FLIGHTS), "rlds", tmp_path / "set")
    for name in ("dataset_info.json", "features.json"):
        (tmp_path / "set/cognitivedrone/1.0.0" / name).unlink()
    with pytest.warns(UserWarning, match="3 episodes were read by their records"):
        found = list(import_(tmp_path / "set", "rlds"))
    for (_, back), (_, original) in zip(found, FLIGHTS, strict=True):
        assert back.task == original.task
        np.testing.assert_array_equal(back.sent, original.sent)


def test_other_widths_are_mapped_by_columns_and_the_error_shows_the_line(tmp_path):
    shard(tmp_path / "a.tfrecord", width=7)
    with pytest.raises(DataError, match=r"has 7 numbers a step, not 4; .* --columns 'action=0\+1\+2\+3 state="):
        list(import_(tmp_path, "rlds"))
    with pytest.raises(DataError, match="lead backward on average; add `published`"):
        list(import_(tmp_path, "rlds", "action=0+1+2+5"))
    with pytest.warns(UserWarning, match="not recorded"):
        ((_, first), _) = import_(tmp_path, "rlds", "velocities action=0+1+2+5")
    assert (first.action[:, 0] < 0).all()
    assert first.action.shape == (5, 4)
    for wrong in ("action", "action=0+1", "speed=0+1+2+3", "action=a+b+c+d"):
        with pytest.raises(DataError, match="--columns"):
            Columns.parse(wrong)
    with pytest.raises(DataError, match="--columns is for lerobot, rlds, not 'published'"):
        import_(tmp_path, "published", "action=0+1+2+3")


@pytest.mark.parametrize(
    ("features", "says"),
    [
        ({"steps/observation/image": []}, "0 frames"),
        ({"steps/action": np.zeros(3, np.float32)}, "do not fit its 5 frames"),
        ({"steps/action": np.full(20, np.nan, np.float32)}, "finite"),
        ({"steps/language_instruction": [b""]}, "prompt"),
    ],
)
def test_broken_records_are_named(tmp_path, features, says):
    shard(tmp_path / "a.tfrecord", **features)
    with pytest.raises(DataError, match=rf"a\.tfrecord, record 0.*{says}"):
        list(import_(tmp_path, "rlds", "published"))


def test_what_no_scene_is_known_of_is_not_scored(tmp_path, capsys):
    shard(tmp_path / "shards/a.tfrecord")
    command = f"data import {tmp_path}/shards --from rlds --columns published --out {tmp_path}/in"
    with pytest.warns(UserWarning, match="not recorded"):
        main(command.split())
    for words in ("reason --reasoner", "predict --policy"):
        with pytest.raises(SystemExit):
            main([*words.split(), "oracle", "--flights", str(tmp_path / "in")])
        assert "2 of 2 flights record no scene" in capsys.readouterr().err


def test_a_folder_without_shards_is_refused(tmp_path):
    with pytest.raises(DataError, match=r"holds no \*\.tfrecord shard"):
        list(import_(tmp_path, "rlds"))


@pytest.fixture
def lerobot(tmp_path):
    """A LeRobot set of others: seven actions, another camera's name, no record of ours."""
    export(iter(FLIGHTS), "lerobot", tmp_path / "set")
    (episodes,) = tmp_path.glob("set/meta/episodes/*/*.parquet")
    pq.write_table(pq.read_table(episodes).drop_columns(["record"]), episodes)
    (data,) = tmp_path.glob("set/data/*/*.parquet")
    table = pq.read_table(data).drop_columns(["record"])
    wide = [[*row, 0.0, 0.0, 0.0] for row in table["action"].to_pylist()]
    table = table.set_column(table.column_names.index("action"), "action", [wide])
    names = {"observation.images.front": "observation.images.cam"}
    pq.write_table(table.rename_columns([names.get(name, name) for name in table.column_names]), data)
    info = tmp_path / "set/meta/info.json"
    content = json.loads(info.read_text())
    del content["features"]["record"]
    content["features"] = {names.get(name, name): value for name, value in content["features"].items()}
    info.write_text(json.dumps(content))
    return tmp_path / "set"


def test_a_lerobot_set_of_others_is_mapped(lerobot):
    with pytest.warns(UserWarning, match="no export of this package"), pytest.raises(DataError, match="7 numbers"):
        list(import_(lerobot, "lerobot"))
    with pytest.warns(UserWarning, match="no export of this package"):
        found = list(import_(lerobot, "lerobot", "action=0+1+2+3"))
    for (_, back), (_, original) in zip(found, FLIGHTS, strict=True):
        np.testing.assert_array_equal(back.action, original.action)
        np.testing.assert_array_equal(back.height, original.height)
        assert back.images == original.images
        assert back.task.instruction == original.task.instruction
