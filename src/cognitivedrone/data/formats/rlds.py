"""RLDS: episodes in the form that TensorFlow Datasets reads, written without TensorFlow.

The folder is `OUT/cognitivedrone/1.0.0/{dataset_info.json, features.json, cognitivedrone-SPLIT.tfrecord-I-of-N}`, so
that `tfds.builder("cognitivedrone", data_dir=OUT)` opens it, and `tfds.builder_from_directory` the inner folder.
One `tf.train.Example` per episode holds the flattened steps, as TFDS stores a `Dataset` feature:
https://www.tensorflow.org/datasets/external_tfrecord. Beside the usual fields, every step has
`recorded/{sent, position, quaternion}`, which trainers ignore and which make the import exact. Only WebP frames become
PNG, because TensorFlow does not decode WebP.
"""

from __future__ import annotations

import json
import re
import warnings
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from cognitivedrone.data.episode import Episode, Split, decode_image, encode_image
from cognitivedrone.data.formats.exchange import (
    brief,
    check_file,
    episode_from,
    new_folder,
    plain_facts,
    read_json,
    record_of,
    same_cameras,
    write_json,
)
from cognitivedrone.data.formats.foreign import MISSING, Columns, foreign_episode
from cognitivedrone.data.formats.tfrecord import Feature, decode_example, encode_example, read_records, write_record
from cognitivedrone.errors import DataError
from cognitivedrone.files import create, own_files
from cognitivedrone.text.json_text import parse_json
from cognitivedrone.types import IMAGE_SIZE

NAME = "cognitivedrone"
DOWN = "image_down"
"""Feature of an observation with the frame of the camera that looks down, only in exports of flights that have it."""
VERSION = "1.0.0"
INFO = "dataset_info.json"
SHARD_BYTES = 256 * 2**20
"""A shard is closed once it exceeds this size."""

_OF = re.compile(r"-of-(\d+)")
_PREFIX = "tensorflow_datasets.core.features."
_TEMPLATE = "{DATASET}-{SPLIT}.{FILEFORMAT}-{SHARD_X_OF_Y}"


def export(episodes: Iterable[tuple[Split, Episode]], out: Path) -> int:
    """Write the episodes as an RLDS data set; returns their number.

    One episode is in memory at a time. Raises `DataError` if `out` is not empty or cannot be written.
    """
    with new_folder(out) as partial:
        folder = partial / NAME / VERSION
        folder.mkdir(parents=True)
        splits: tuple[Split, ...] = ("train", "val")
        writers = {split: _SplitWriter(folder, split) for split in splits}
        only_jpeg, down = True, False
        with ExitStack() as closing:  # all of them, even if the disk is full and closing one fails
            for writer in writers.values():
                closing.callback(writer.close)
            for split, episode in same_cameras(episodes):
                writers[split].write(encode_example(_features_of(split, episode)))
                only_jpeg &= episode.encoding == "jpeg"
                down = bool(episode.down)
        write_json(folder / "features.json", feature_spec("jpeg" if only_jpeg else "png", down=down))
        described = [writer.describe() for writer in writers.values() if writer.lengths]
        write_json(folder / INFO, _info(described))
    return sum(sum(writer.lengths) for writer in writers.values())


def read(path: Path, *, columns: str = "") -> Iterator[tuple[Split, Episode]]:
    """The episodes of an export, train first. Of other folders with shards, all that their records hold.

    `columns` says which numbers of others' actions and states are ours (`foreign.Columns`). Raises `DataError` with the
    shard and record that cannot be read; a warning says what is missing.
    """
    described = _inner(path) / INFO
    info = read_json(described) if described.exists() or described.is_symlink() else {"name": ""}
    if isinstance(info, dict) and info.get("name", NAME) != NAME:
        return _others(path, Columns.parse(columns))
    return _ours(path)


def _others(path: Path, columns: Columns) -> Iterator[tuple[Split, Episode]]:
    """The episodes of all shards below a folder: ours exactly, others with what their records lack filled in."""
    shards = [shard for shard in own_files(path, "**/*.tfrecord*") if shard.is_file()]
    if not shards:
        raise DataError(f"{path}: holds no *.tfrecord shard, and no {INFO} of ours; give the folder of the shards")
    absent = [name for name in (INFO, "features.json") if not own_files(path, f"**/{name}")]
    expected = max((int(found[1]) for shard in shards if (found := _OF.search(shard.name))), default=len(shards))
    lacks = [f"{' and '.join(absent)} {'is' if len(absent) == 1 else 'are'} missing"] if absent else []
    lacks += [f"only {len(shards)} of {expected} shards are there"] if len(shards) < expected else []
    foreign, number = False, 0
    for shard in shards:
        split: Split = "val" if re.search("val|test", shard.name.partition(".tfrecord")[0]) else "train"
        for count, payload in enumerate(read_records(shard)):
            where = f"{shard}, record {count}"
            try:
                features = decode_example(payload)
            except ValueError as error:
                raise DataError(f"{where}: not an episode ({brief(error)})") from None
            if "episode_metadata/record" in features:
                yield _episode_of(payload, where)
            else:
                foreign = True
                yield split, _foreign(features, number, columns, where)
            number += 1
    notes = [*lacks, *([MISSING] if foreign else [])]
    if notes:
        warnings.warn(f"{path}: {number} episodes were read by their records; {'; '.join(notes)}", stacklevel=1)


def _foreign(features: dict[str, Any], number: int, columns: Columns, where: str) -> Episode:
    def text(*names: str) -> str:
        found = next((features[name] for name in names if name in features and len(features[name])), [b""])
        return bytes(found[0]).decode("utf-8", "replace")

    cameras = ["steps/observation/image", *sorted(name for name in features if re.search("observation/.*image", name))]
    images = next((features[name] for name in cameras if name in features), None)
    if images is None or "steps/action" not in features:
        there = ", ".join(sorted(features))[:200]
        raise DataError(f"{where}: has no steps/observation/image or no steps/action; it has {there}")
    try:
        action = np.asarray(features["steps/action"], np.float32).reshape(len(images), -1)
        state = np.asarray(features.get("steps/observation/state", ()), np.float32).reshape(len(images), -1)
    except ValueError as error:
        raise DataError(f"{where}: its numbers do not fit its {len(images)} frames ({brief(error)})") from None
    return foreign_episode(
        number,
        images,
        text("steps/language_instruction", "steps/observation/natural_language_instruction"),
        columns.action(action, where),
        where,
        state=columns.state(state, where),
        directive=text("steps/language_instruction_simple", "episode_metadata/directive"),
        kind=text("episode_metadata/type"),
    )


def _ours(path: Path) -> Iterator[tuple[Split, Episode]]:
    """The episodes of an export; `path` is the folder given to `export` or the inner one."""
    folder = _inner(path)
    info = read_json(folder / INFO)
    if not isinstance(info, dict) or info.get("name") != NAME:
        name = info.get("name") if isinstance(info, dict) else None
        raise DataError(f"{folder}: is data set {name!r}; only exports of this package, named {NAME!r}, can be read")
    for name, lengths in _splits(info, folder / INFO):
        for number, length in enumerate(lengths):
            shard = folder / _shard_name(name, number, len(lengths))
            check_file(shard)
            count = 0
            for count, payload in enumerate(read_records(shard), 1):
                yield _episode_of(payload, f"{shard}, record {count - 1}")
            if count != length:
                raise DataError(f"{shard}: holds {count} of {length} episodes; copy or export it again")


def _splits(info: dict[str, Any], where: Path) -> list[tuple[Split, list[int]]]:
    """Name and episodes of every shard of each split; raises `DataError`. The names become parts of paths."""
    try:
        found = [(split["name"], [int(length) for length in split["shardLengths"]]) for split in info["splits"]]
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        raise DataError(
            f"{where}: does not list its splits ({type(error).__name__}: {brief(error)}); export again"
        ) from None
    for name, _ in found:
        if name not in ("train", "val"):
            raise DataError(f"{where}: has a split {str(name)[:40]!r}; only train and val can be imported")
    return found


def _inner(path: Path) -> Path:
    return path if (path / INFO).exists() else path / NAME / VERSION


class _SplitWriter:
    """The shards of one split; their names contain their number, so they are named last."""

    def __init__(self, folder: Path, split: Split) -> None:
        self._folder = folder
        self._split = split
        self._file: BinaryIO | None = None
        self._written = 0
        self._payload = 0
        self.lengths: list[int] = []

    def write(self, payload: bytes) -> None:
        if self._file is None or self._written > SHARD_BYTES:
            self._close_shard()
            self._file = create(self._folder / f"{self._split}-{len(self.lengths)}.part")
            self._written = 0
            self.lengths.append(0)
        self._written += write_record(self._file, payload)
        self._payload += len(payload)
        self.lengths[-1] += 1

    def close(self) -> None:
        """Close the last shard and name all shards."""
        self._close_shard()
        for number in range(len(self.lengths)):
            part = self._folder / f"{self._split}-{number}.part"
            part.replace(self._folder / _shard_name(self._split, number, len(self.lengths)))

    def describe(self) -> dict[str, Any]:
        """The entry of the split in dataset_info.json."""
        return {
            "filepathTemplate": _TEMPLATE,
            "name": self._split,
            "numBytes": str(self._payload),
            "shardLengths": [str(length) for length in self.lengths],
        }

    def _close_shard(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None


def _shard_name(split: str, number: int, total: int) -> str:
    return f"{NAME}-{split}.tfrecord-{number:05d}-of-{total:05d}"


def _features_of(split: Split, episode: Episode) -> dict[str, Feature]:
    """The flat features of an episode of T steps: steps are the first axis, as in TFDS."""
    length = len(episode)
    last = np.zeros(length, np.int64)
    last[-1] = 1
    cameras = {"image": episode.images} | ({DOWN: episode.down} if episode.down else {})
    if episode.encoding == "webp":
        cameras = {
            name: tuple(encode_image(decode_image(image), "png") for image in images)
            for name, images in cameras.items()
        }
    features: dict[str, Feature] = {
        **{f"steps/observation/{name}": images for name, images in cameras.items()},
        "steps/observation/state": episode.state.ravel(),
        "steps/action": episode.action.ravel(),
        "steps/language_instruction": [episode.task.instruction.encode()] * length,
        "steps/is_first": np.eye(1, length, dtype=np.int64)[0],
        "steps/is_last": last,
        "steps/is_terminal": last,
        "steps/reward": last.astype(np.float32),
        "steps/discount": np.ones(length, np.float32),
        "steps/recorded/sent": episode.sent.ravel(),
        "steps/recorded/position": [row.astype("<f8").tobytes() for row in episode.position],
        "steps/recorded/quaternion": [row.astype("<f8").tobytes() for row in episode.quaternion],
    }
    facts = plain_facts(episode) | {"record": json.dumps(record_of(split, episode), ensure_ascii=False)}
    for name, value in facts.items():
        feature: Feature = [value.encode()] if isinstance(value, str) else np.array([value], np.int64)
        features[f"episode_metadata/{name}"] = feature
    return features


def _episode_of(payload: bytes, where: str) -> tuple[Split, Episode]:
    try:
        features: dict[str, Any] = decode_example(payload)
        (record,) = features["episode_metadata/record"]
        images = tuple(features["steps/observation/image"])
        down = tuple(features.get(f"steps/observation/{DOWN}", ()))
        state = features["steps/observation/state"].reshape(len(images), 5)
        doubles = {name: b"".join(features[f"steps/recorded/{name}"]) for name in ("position", "quaternion")}
        arrays = {name: np.frombuffer(data, "<f8") for name, data in doubles.items()} | {
            "action": features["steps/action"],
            "sent": features["steps/recorded/sent"],
            "velocity": state[:, :3],
            "height": state[:, 3],
            "yaw_rate": state[:, 4],
        }
        facts = parse_json(record)
    except (KeyError, ValueError, TypeError, AttributeError, IndexError) as error:
        raise DataError(f"{where}: not an episode that this package exported ({brief(error)})") from None
    return episode_from(facts, images, arrays, where, down)


def feature_spec(image_format: str, *, down: bool = False) -> dict[str, Any]:
    """features.json, as TFDS writes it for the same features; with `down`, of two cameras."""
    image = {
        "pythonClassName": _PREFIX + "image_feature.Image",
        "image": {"dtype": "uint8", "encodingFormat": image_format, "shape": _shape(IMAGE_SIZE, IMAGE_SIZE, 3)},
    }
    cameras = {"image": image} | ({DOWN: image} if down else {})
    steps = {
        "observation": _dict({**cameras, "state": _tensor("float32", 5)}),
        "action": _tensor("float32", 4),
        "language_instruction": _text(),
        "is_first": _scalar("bool"),
        "is_last": _scalar("bool"),
        "is_terminal": _scalar("bool"),
        "reward": _scalar("float32"),
        "discount": _scalar("float32"),
        "recorded": _dict(
            {
                "sent": _tensor("float32", 4),
                "position": _tensor("float64", 3, encoding="bytes"),
                "quaternion": _tensor("float64", 4, encoding="bytes"),
            }
        ),
    }
    texts = ("directive", "category", "family", "place", "suite", "record")
    numbers = ("correct_gate", "seed", "index")
    metadata = {name: _text() for name in texts} | {name: _scalar("int64") for name in numbers}
    dataset = {
        "pythonClassName": _PREFIX + "dataset_feature.Dataset",
        "sequence": {"feature": _dict(steps), "length": "-1"},
    }
    return _dict({"steps": dataset, "episode_metadata": _dict(metadata)})


def _info(splits: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "name": NAME,
        "version": VERSION,
        "description": (
            "Flights through the right one of three labelled gates, named by a sentence. Actions are vx, vy, vz in m/s "
            "and yaw rate in rad/s, in the heading frame (forward, left, up), at 10 Hz."
        ),
        "fileFormat": "tfrecord",
        "splits": splits,
    }


def _dict(features: dict[str, Any]) -> dict[str, Any]:
    return {"pythonClassName": _PREFIX + "features_dict.FeaturesDict", "featuresDict": {"features": features}}


def _text() -> dict[str, Any]:
    return {"pythonClassName": _PREFIX + "text_feature.Text", "text": {}}


def _scalar(dtype: str) -> dict[str, Any]:
    return {"pythonClassName": _PREFIX + "scalar.Scalar", "tensor": {"dtype": dtype, "encoding": "none", "shape": {}}}


def _tensor(dtype: str, size: int, encoding: str = "none") -> dict[str, Any]:
    return {
        "pythonClassName": _PREFIX + "tensor_feature.Tensor",
        "tensor": {"dtype": dtype, "encoding": encoding, "shape": _shape(size)},
    }


def _shape(*sizes: int) -> dict[str, list[str]]:
    return {"dimensions": [str(size) for size in sizes]}
