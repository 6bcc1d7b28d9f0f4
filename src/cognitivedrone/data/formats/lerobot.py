"""LeRobot v3: the data set layout of `LeRobotDataset`.

    meta/{info.json, stats.json, tasks.parquet}, meta/episodes/chunk-000/file-000.parquet,
    data/chunk-000/file-000.parquet, README.md, and with video videos/observation.images.front/chunk-000/file-000.mp4

(https://huggingface.co/docs/lerobot/lerobot-dataset-v3). Frames are stored in the parquet files as encoded, or
optionally in H.264 videos. Directive, category, family, right gate and seed are columns; `sent`, `position` and
`quaternion` are too, and each episode's row in `meta/episodes` has a `record` with the rest, so the import is
exact (with video, exact except for the pictures). Flights with a camera that looks down have a second image key,
`observation.images.down`. Split `val` comes after `train`, so that info.json can name both as
ranges, and in files of its own, so that the card can name those.

As a plain data set of Hugging Face's `datasets`, a data file has the types of its columns in the metadata of its
schema, and the card (README.md) says which files are data.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Collection, Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any, cast

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from cognitivedrone.data.episode import Episode, Split, encode_image
from cognitivedrone.data.formats.exchange import (
    brief,
    check_file,
    check_unpacked_size,
    episode_from,
    new_folder,
    plain_facts,
    read_json,
    record_of,
    same_cameras,
    write_json,
)
from cognitivedrone.data.formats.foreign import MISSING, Columns, foreign_episode
from cognitivedrone.data.formats.lerobot_files import (
    DOWN_KEY,
    FLOATS,
    IMAGE_KEY,
    TEXTS,
    WORDS_KEY,
    Statistics,
    VideoWriter,
    cameras_of,
    card,
    columns_of,
    feature_spec,
    read_frames,
    schema_of,
    table_of,
    task_table,
)
from cognitivedrone.data.shards import ShardFile, write_shard_file
from cognitivedrone.errors import DataError
from cognitivedrone.files import remove, replace_file
from cognitivedrone.text.json_text import parse_json
from cognitivedrone.types import CONTROL_HZ

VERSION = "v3.0"
CHUNK_SIZE = 1000
"""Files per folder."""
FILE_MB = 100
"""A data file is closed once its frames exceed this size."""

_FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}"
DATA_PATH = f"data/{_FILE}.parquet"
VIDEO_PATH = f"videos/{{video_key}}/{_FILE}.mp4"
EPISODES_PATH = "meta/episodes/chunk-000/file-000.parquet"
CARD_PATH = "README.md"

_OWN = (
    "read it by a function of your own that maps its columns: data import --from module:function"
    " (docs/data.md#data-of-others)"
)
_OLD = ("v1", "v2")
_OLDER = (
    "convert it first with LeRobot's lerobot.datasets.v30.convert_dataset_v21_to_v30; if it is not an export of this"
    f" package, {_OWN}"
)
_STEP = {IMAGE_KEY, DOWN_KEY, *FLOATS, "frame_index", "episode_index", "record"}
_ROW = {"record", "tasks", "episode_index", "length", "data/chunk_index", "data/file_index"}
"""Columns that are read."""


def export_video(episodes: Iterable[tuple[Split, Episode]], out: Path) -> int:
    """Like `export`, with the frames in H.264 videos."""
    return export(episodes, out, video=True)


def export_words(episodes: Iterable[tuple[Split, Episode]], out: Path) -> int:
    """Like `export`, with the instruction as a vector, for policies that read no text, such as ACT and diffusion."""
    return export(episodes, out, words=True)


def export(episodes: Iterable[tuple[Split, Episode]], out: Path, *, video: bool = False, words: bool = False) -> int:
    """Write the episodes with their frames in the parquet files, losslessly; returns their number.

    One episode is in memory at a time, and the numbers of all for the statistics. Raises `DataError` if `out` is not
    empty or cannot be written.
    """
    with new_folder(out) as partial:
        writer = _Writer(partial, video=video, words=words)
        try:
            for split, episode in _val_last(same_cameras(episodes), partial / "val.part"):
                writer.write(split, episode)
        finally:
            writer.close()
        writer.write_meta()
    return len(writer.rows)


def _val_last(episodes: Iterable[tuple[Split, Episode]], spool: Path) -> Iterator[tuple[Split, Episode]]:
    """The same episodes; those of `val` are buffered on disk until the others are written."""
    spool.mkdir()
    waiting: list[tuple[Path, int]] = []
    for split, episode in episodes:
        if split == "train":
            yield split, episode
        else:
            path = spool / f"{len(waiting)}.parquet"
            write_shard_file(path, [episode], {})
            waiting.append((path, episode.index))
    for path, index in waiting:
        yield "val", ShardFile(path).episode(index)
        remove(path)
    remove(spool)


class _Writer:
    """Files of one data set, written in order; each episode's row group is written at once."""

    def __init__(self, folder: Path, *, video: bool, words: bool) -> None:
        self._folder = folder
        self._is_video = video
        self._has_words = words
        self._cameras: tuple[str, ...] = ()
        self._statistics = Statistics()
        self._tasks: dict[str, int] = {}
        self._frames = 0
        self._file_number = -1
        self._file_bytes = 0
        self._parquet: pq.ParquetWriter | None = None
        self._videos: dict[str, VideoWriter] = {}
        self._files: dict[Split, list[str]] = {}
        self.rows: list[dict[str, Any]] = []

    def write(self, split: Split, episode: Episode) -> None:
        cameras = cameras_of(episode)
        self._cameras = tuple(cameras)
        parquet = self._file(split)
        number, first = len(self.rows), self._frames
        task_index = self._tasks.setdefault(episode.task.instruction, len(self._tasks))
        record = json.dumps(record_of(split, episode), ensure_ascii=False)
        columns = columns_of(episode, number, first, task_index, record)
        left_out = {*TEXTS, *({WORDS_KEY} if not self._has_words else ())}
        stats = self._statistics.add({n: v for n, v in columns.items() if n not in left_out}, cameras)
        place = self._place()
        row: dict[str, Any] = {
            "episode_index": number,
            "tasks": [episode.task.instruction],
            "length": len(episode),
            "dataset_from_index": first,
            "dataset_to_index": first + len(episode),
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
        } | {f"data/{name}": value for name, value in place.items()}
        for key, video in self._videos.items():
            start = video.frames / CONTROL_HZ
            row |= {f"videos/{key}/{name}": value for name, value in place.items()}
            row[f"videos/{key}/from_timestamp"] = start
            row[f"videos/{key}/to_timestamp"] = start + len(episode) / CONTROL_HZ
            video.add(cameras[key])
        row |= plain_facts(episode) | {"record": record}
        row |= {f"stats/{name}/{what}": v for name, values in stats.items() for what, v in values.items()}
        parquet.write_table(table_of(columns, cameras, parquet.schema))
        self._file_bytes += sum(len(image) for images in cameras.values() for image in images)
        self._frames += len(episode)
        self.rows.append(row | {"split": split})

    def close(self) -> None:
        """Close the open files."""
        if self._parquet is not None:
            self._parquet.close()
            self._parquet = None
        while self._videos:
            self._videos.popitem()[1].close()

    def write_meta(self) -> None:
        """Write the folder `meta`, after all episodes."""
        (self._folder / EPISODES_PATH).parent.mkdir(parents=True)
        pq.write_table(pa.Table.from_pylist(self.rows), self._folder / EPISODES_PATH)
        pq.write_table(task_table(list(self._tasks)), self._folder / "meta/tasks.parquet")
        write_json(self._folder / "meta/stats.json", self._statistics.total())
        write_json(self._folder / "meta/info.json", self._info())
        replace_file(self._folder / CARD_PATH, card(self._files).encode())

    def _file(self, split: Split) -> pq.ParquetWriter:
        """The current data file: the open one, or a new one if that is large enough, or of another split."""
        if self._parquet is not None and split in self._files and self._file_bytes <= FILE_MB * 2**20:
            return self._parquet
        self.close()
        self._file_number += 1
        self._file_bytes = 0
        place = self._place()
        path = self._folder / DATA_PATH.format(**place)
        path.parent.mkdir(parents=True, exist_ok=True)
        self._files.setdefault(split, []).append(DATA_PATH.format(**place))
        schema = schema_of(self._cameras, video=self._is_video, words=self._has_words)
        self._parquet = pq.ParquetWriter(path, schema, use_dictionary=list(TEXTS))
        for key in self._cameras if self._is_video else ():
            self._videos[key] = VideoWriter(self._folder / VIDEO_PATH.format(video_key=key, **place))
        return self._parquet

    def _place(self) -> dict[str, int]:
        return {"chunk_index": self._file_number // CHUNK_SIZE, "file_index": self._file_number % CHUNK_SIZE}

    def _info(self) -> dict[str, Any]:
        train = sum(row["split"] == "train" for row in self.rows)
        ranges = {"train": (0, train), "val": (train, len(self.rows))}
        return {
            "codebase_version": VERSION,
            "robot_type": "drone",
            "total_episodes": len(self.rows),
            "total_frames": self._frames,
            "total_tasks": len(self._tasks),
            "chunks_size": CHUNK_SIZE,
            "data_files_size_in_mb": FILE_MB,
            "video_files_size_in_mb": FILE_MB,
            "fps": CONTROL_HZ,
            "splits": {name: f"{start}:{stop}" for name, (start, stop) in ranges.items() if stop > start},
            "data_path": DATA_PATH,
            "video_path": VIDEO_PATH if self._is_video else None,
            "features": feature_spec(self._cameras, video=self._is_video, words=self._has_words),
        }


def read(path: Path, *, columns: str = "") -> Iterator[tuple[Split, Episode]]:
    """The episodes of a data set, in order; one data file is in memory at a time. Frames of videos become JPEG.

    Those of an export of this package are the same as before; of others, what lacks is filled in, and a warning says
    so. `columns` says which numbers of others' actions and states are ours (`foreign.Columns`). Raises `DataError` with
    the file's name for anything missing or broken, and for another version of the layout.
    """
    chosen = Columns.parse(columns)
    info_path = path / "meta/info.json"
    info = read_json(info_path)
    if not isinstance(info, dict):
        raise DataError(f"{info_path}: is not the description of a data set")
    version = str(info.get("codebase_version"))
    if not version.startswith("v3."):
        raise DataError(
            f"{info_path}: layout {version} cannot be read, only v3; {_OLDER if version[:2] in _OLD else _OWN}"
        )
    features = info["features"] if isinstance(info.get("features"), dict) else {}
    keys = [IMAGE_KEY, *sorted(name for name in features if name.startswith("observation.image"))]
    front = next((key for key in keys if key in features), IMAGE_KEY)
    cameras = [front, *({DOWN_KEY} & features.keys())]
    image = features.get(front)
    is_video = isinstance(image, dict) and image.get("dtype") == "video"
    files = sorted(path.glob("meta/episodes/*/*.parquet")) or [path / EPISODES_PATH]
    rows = sorted(
        (row for file in files for row in _read_table(file, _ROW).to_pylist()),
        key=lambda row: row.get("episode_index", 0),
    )
    foreign = bool(rows) and "record" not in rows[0] and "record" not in features
    if foreign:
        warnings.warn(f"{path}: is no export of this package: {MISSING}", stacklevel=1)
    opened: Path | None = None
    for row in rows:
        place = _place_of(row, path / EPISODES_PATH)
        data_path = path / DATA_PATH.format(**place)
        if data_path != opened:
            table, opened = _read_table(data_path, {*_STEP, front}), data_path
            videos = [path / VIDEO_PATH.format(video_key=key, **place) for key in cameras if is_video]
            frames = [read_frames(video) for video in videos]
        try:
            number, length = row["episode_index"], row["length"]
            steps = table.filter(pc.equal(table["episode_index"], number)).sort_by("frame_index")
            # Its tools write the rows of episodes anew, without what they do not know.
            record = None if foreign else parse_json(row.get("record") or steps["record"][0].as_py())
            arrays = {} if foreign else _step_arrays(steps)
        except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError, pa.ArrowException) as error:
            raise DataError(f"{data_path}: not an export of this package ({brief(error)}); export it again") from None
        where = f"{data_path}, episode {number}"
        if len(steps) != length:
            raise DataError(f"{where}: holds {len(steps)} of {length} steps; copy or export it again")
        seen = [] if is_video else [_images(steps, key, where) for key in cameras]
        for video, coming in zip(videos, frames, strict=True):
            seen.append(tuple(encode_image(frame, "jpeg") for frame in islice(coming, len(steps))))
            if len(seen[-1]) != len(steps):
                raise DataError(f"{video}: ends within episode {number}; copy or export it again")
        images, *down = seen
        if foreign:
            yield "train", _foreign(steps, images, row, chosen, where)
        else:
            yield episode_from(record, images, arrays, where, *down)


def _foreign(steps: pa.Table, images: tuple[bytes, ...], row: dict[str, Any], columns: Columns, where: str) -> Episode:
    if "action" not in steps.column_names:
        raise DataError(f"{where}: has no column 'action'; {_OWN}")
    action = columns.action(_matrix(steps, "action"), where)
    there = "observation.state" in steps.column_names
    state = columns.state(_matrix(steps, "observation.state"), where) if there else None
    sentences = row.get("tasks") or [""]
    return foreign_episode(row["episode_index"], images, str(sentences[0]), action, where, state=state)


def _images(steps: pa.Table, key: str, where: str) -> tuple[bytes, ...]:
    """The encoded frames of a camera in an episode; raises `DataError` if they are not in the file."""
    column = steps[key].to_pylist() if key in steps.column_names else [None] * len(steps)
    images = [entry.get("bytes") if isinstance(entry, dict) else None for entry in column]
    if not all(isinstance(image, bytes) for image in images):
        raise DataError(f"{where}: lacks the bytes of its frames; export it again")
    return tuple(cast("list[bytes]", images))


def _place_of(row: dict[str, Any], where: Path) -> dict[str, int]:
    """The file of an episode; raises `DataError`. The numbers become parts of paths."""
    place = {name: row.get(f"data/{name}") for name in ("chunk_index", "file_index")}
    for name, number in place.items():
        if not isinstance(number, int) or number < 0:
            raise DataError(f"{where}: data/{name} is {str(number)[:40]!r}; it must be a number from 0")
    return cast("dict[str, int]", place)


def _read_table(path: Path, columns: Collection[str]) -> pa.Table:
    """These columns of a file, as far as they are there; others may be of any size."""
    check_file(path)
    try:
        check_unpacked_size(pq.read_metadata(path), path, columns)
        return pq.read_table(path, columns=[name for name in pq.read_schema(path).names if name in columns])
    except (OSError, ValueError, pa.ArrowException) as error:
        raise DataError(f"{path}: not a whole parquet file ({brief(error)}); copy or export it again") from None


def _matrix(steps: pa.Table, name: str) -> NDArray[Any]:
    flat = steps[name].combine_chunks().flatten()
    return cast(NDArray[Any], flat.to_numpy(zero_copy_only=False).reshape(len(steps), -1))


def _step_arrays(steps: pa.Table) -> dict[str, NDArray[Any]]:
    state = _matrix(steps, "observation.state")
    arrays = {name: _matrix(steps, name) for name in ("action", "sent", "position", "quaternion")}
    return arrays | {"velocity": state[:, :3], "height": state[:, 3], "yaw_rate": state[:, 4]}
