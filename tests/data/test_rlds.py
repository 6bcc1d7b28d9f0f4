"""RLDS: what the shards hold, byte by byte, what is damaged, and the example that registers the set in OpenVLA."""

import importlib.util
import io
import json
import shutil
import struct
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from factory import make_episode
from hypothesis import given, settings
from hypothesis import strategies as st

from cognitivedrone.data.episode import Episode, Split, decode_image
from cognitivedrone.data.formats import export, import_, rlds, tfrecord
from cognitivedrone.errors import DataError

TENSORFLOW_RECORD = "090000000000000037f97139636f676e69746976651bbcacaf"
TENSORFLOW_EXAMPLE = (
    "0a380a0c0a016112070a050a01780a000a110a0162120c120a0a080000"
    "c03f000000c00a150a016312101a0e0a0cffffffffffffffffff01ac02"
)

FLIGHTS: list[tuple[Split, Episode]] = [
    ("val" if index == 1 else "train", make_episode(index, 3 + index, encoding="jpeg")) for index in range(4)
]


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    out = tmp_path_factory.mktemp("rlds") / "set"
    assert export(iter(FLIGHTS), "rlds", out) == len(FLIGHTS)
    return out


@pytest.fixture
def copied(exported, tmp_path):
    return Path(shutil.copytree(exported, tmp_path / "copy"))


def shard(out, split="train"):
    return out / f"cognitivedrone/1.0.0/cognitivedrone-{split}.tfrecord-00000-of-00001"


def test_info_tells_what_the_shards_hold(exported):
    info = json.loads((exported / "cognitivedrone/1.0.0/dataset_info.json").read_text())
    assert {split["name"]: split["shardLengths"] for split in info["splits"]} == {"train": ["3"], "val": ["1"]}
    size = shard(exported, "val").stat().st_size
    assert int(info["splits"][1]["numBytes"]) == size - tfrecord.FRAME_BYTES


def test_the_facts_travel_as_plain_features(exported):
    (payload,) = tfrecord.read_records(shard(exported, "val"))
    features: dict[str, Any] = dict(tfrecord.decode_example(payload))
    episode = FLIGHTS[1][1]
    assert features["steps/language_instruction"] == [episode.task.instruction.encode()] * len(episode)
    assert features["episode_metadata/directive"] == [episode.task.directive.encode()]
    assert features["episode_metadata/category"] == [episode.task.category.encode()]
    assert features["episode_metadata/family"] == [episode.task.family.encode()]
    assert features["episode_metadata/correct_gate"].tolist() == [episode.task.target + 1]
    assert features["episode_metadata/seed"].tolist() == [episode.conditions.seed]
    assert features["steps/is_first"].tolist() == [1, 0, 0, 0]
    assert features["steps/is_last"].tolist() == features["steps/is_terminal"].tolist() == [0, 0, 0, 1]
    assert features["steps/reward"].tolist() == [0, 0, 0, 1]


@pytest.mark.parametrize("down", [False, True])
def test_every_feature_is_declared(tmp_path, down):
    exported = tmp_path / "set"
    export([("val", make_episode(1, 4, down=down))], "rlds", exported)
    (payload,) = tfrecord.read_records(shard(exported, "val"))

    def names(spec, prefix=""):
        if "featuresDict" in spec:
            for name, inner in spec["featuresDict"]["features"].items():
                yield from names(inner, f"{prefix}/{name}" if prefix else name)
        elif "sequence" in spec:
            yield from names(spec["sequence"]["feature"], prefix)
        else:
            yield prefix

    declared = json.loads((exported / "cognitivedrone/1.0.0/features.json").read_text())
    assert set(names(declared)) == set(tfrecord.decode_example(payload))
    assert ("steps/observation/image_down" in set(names(declared))) == down


@pytest.mark.parametrize(("encoding", "declared"), [("jpeg", "jpeg"), ("png", "png"), ("webp", "png")])
def test_pictures_keep_every_pixel(tmp_path, encoding, declared):
    episode = make_episode(5, 2, encoding=encoding)
    export([("train", episode)], "rlds", tmp_path / "set")
    features = (tmp_path / "set/cognitivedrone/1.0.0/features.json").read_text()
    assert f'"encodingFormat": "{declared}"' in features
    ((_, back),) = import_(tmp_path / "set", "rlds")
    for before, after in zip(episode.images, back.images, strict=True):
        np.testing.assert_array_equal(decode_image(before), decode_image(after))


def test_large_sets_are_cut_into_shards(tmp_path, monkeypatch):
    monkeypatch.setattr(rlds, "SHARD_BYTES", 1)
    export(FLIGHTS, "rlds", tmp_path / "set")
    names = sorted(path.name for path in (tmp_path / "set/cognitivedrone/1.0.0").glob("*train*"))
    assert names == [f"cognitivedrone-train.tfrecord-0000{i}-of-00003" for i in range(3)]
    assert [episode.index for _, episode in import_(tmp_path / "set", "rlds")] == [0, 2, 3, 1]


def first_record(data: bytes) -> bytes:
    return data[: struct.unpack("<Q", data[:8])[0] + tfrecord.FRAME_BYTES]


def of_others(_: bytes) -> bytes:
    file = io.BytesIO()
    tfrecord.write_record(file, tfrecord.encode_example({"steps/action": np.zeros(7, np.float32)}))
    return file.getvalue()


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        *((lambda data, cut=cut: data[:cut], "00000-of-00001: .*again") for cut in (4, 20, -1, -1000)),
        (first_record, "00000-of-00001: holds 1 of 3 episodes"),
        (lambda data: data[:-5000] + bytes([data[-5000] ^ 1]) + data[-4999:], "fails its checksum"),
        (of_others, "record 0: not an episode that this package exported"),
    ],
)
def test_a_damaged_shard_is_named_and_one_of_others_told_apart(copied, damage, says):
    shard(copied).write_bytes(damage(shard(copied).read_bytes()))
    with pytest.raises(DataError, match=rf"cognitivedrone-train\.tfrecord-.*{says}"):
        list(import_(copied, "rlds"))


def test_a_missing_shard_is_named(copied):
    shard(copied, "val").unlink()
    with pytest.raises(DataError, match="cognitivedrone-val"):
        list(import_(copied, "rlds"))


def test_data_sets_of_other_names_are_read_by_their_records(copied):
    path = copied / "cognitivedrone/1.0.0/dataset_info.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"name": "bridge"}))
    assert len(list(import_(copied, "rlds"))) == len(FLIGHTS)


def test_framing_matches_a_record_that_tensorflow_wrote(tmp_path):
    """`tf.io.TFRecordWriter` wrote b"cognitive" so."""
    written = bytes.fromhex(TENSORFLOW_RECORD)
    (tmp_path / "theirs").write_bytes(written)
    assert list(tfrecord.read_records(tmp_path / "theirs")) == [b"cognitive"]
    with (tmp_path / "ours").open("wb") as file:
        tfrecord.write_record(file, b"cognitive")
    assert (tmp_path / "ours").read_bytes() == written


def test_examples_match_what_tensorflow_serialises():
    """`tf.train.Example` with a bytes, a float and an int64 list, `SerializeToString(deterministic=True)`."""
    features: dict[str, Any] = {
        "a": [b"x", b""],
        "b": np.array([1.5, -2], np.float32),
        "c": np.array([-1, 300], np.int64),
    }
    assert tfrecord.encode_example(features).hex() == TENSORFLOW_EXAMPLE


@settings(max_examples=40)
@given(
    st.dictionaries(
        st.text(max_size=8),
        st.lists(st.binary(max_size=300), min_size=1, max_size=4)
        | st.lists(st.integers(-(2**63), 2**63 - 1), min_size=1).map(lambda v: np.array(v, np.int64))
        | st.lists(st.floats(width=32, allow_nan=False), min_size=1).map(lambda v: np.array(v, np.float32)),
        max_size=5,
    )
)
def test_examples_come_back(features):
    back = tfrecord.decode_example(tfrecord.encode_example(features))
    assert back.keys() == features.keys()
    for name, values in features.items():
        np.testing.assert_array_equal(np.array(back[name]), np.array(values))


EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "openvla_registration.py"


@pytest.fixture
def example():
    spec = importlib.util.spec_from_file_location("openvla_registration", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def materialize():
    """Stands in for OpenVLA's module: an own factory, looked up by name at every call."""
    module = ModuleType("materialize")
    module.make_oxe_dataset_kwargs = lambda name, *_args, **_kwargs: {"name": name, "theirs": True}
    return module


def test_our_name_is_registered_and_others_stay(example, materialize):
    example.register(materialize)
    assert materialize.make_oxe_dataset_kwargs("bridge_orig", "data") == {"name": "bridge_orig", "theirs": True}
    kwargs = materialize.make_oxe_dataset_kwargs("cognitivedrone", "data", ("primary",), False, False, True, "q99")
    assert (kwargs["name"], kwargs["data_dir"]) == (rlds.NAME, "data")
    assert kwargs["action_proprio_normalization_type"] == "q99"
    assert "state_obs_keys" not in kwargs


def test_the_keys_are_those_of_the_export(example):
    kwargs = example.dataset_kwargs("data")
    steps = rlds.feature_spec("jpeg")["featuresDict"]["features"]["steps"]["sequence"]["feature"]
    features = steps["featuresDict"]["features"]
    observation = features["observation"]["featuresDict"]["features"]
    assert set(kwargs["image_obs_keys"].values()) <= set(observation)
    assert set(kwargs["state_obs_keys"]) <= set(observation)
    assert kwargs["language_key"] in features
    (size,) = features["action"]["tensor"]["shape"]["dimensions"]
    assert len(kwargs["absolute_action_mask"]) == len(kwargs["action_normalization_mask"]) == int(size)


def test_only_our_camera_can_be_asked_for(example):
    with pytest.raises(ValueError, match="one colour camera"):
        example.dataset_kwargs("data", ("primary", "wrist"))


def test_their_script_runs_with_the_data_set_registered(example, materialize, tmp_path, monkeypatch):
    script = tmp_path / "finetune.py"
    script.write_text(
        "import json, sys\n"
        f"from {example.MATERIALIZE} import make_oxe_dataset_kwargs\n"
        "name = make_oxe_dataset_kwargs('cognitivedrone', 'out')['data_dir']\n"
        f"with open({str(tmp_path / 'seen')!r}, 'w') as file:\n"
        "    json.dump([name, sys.argv[1:], __name__], file)\n"
    )
    parts = example.MATERIALIZE.split(".")
    for depth in range(1, len(parts)):
        monkeypatch.setitem(sys.modules, ".".join(parts[:depth]), ModuleType(parts[depth - 1]))
    monkeypatch.setitem(sys.modules, example.MATERIALIZE, materialize)
    monkeypatch.setattr("sys.argv", [])
    monkeypatch.setattr("sys.path", [])
    example.main(str(script), "--lora_rank", "32")
    assert json.loads((tmp_path / "seen").read_text()) == ["out", ["--lora_rank", "32"], "__main__"]
