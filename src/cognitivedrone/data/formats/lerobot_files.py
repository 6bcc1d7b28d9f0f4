"""Parts of a LeRobot data set: its columns for LeRobot, for parquet, and for Hugging Face's `datasets`; its card; its
statistics, per episode and overall; and H.264 videos with the frames of many episodes in sequence.

Statistics of numbers are exact. Pictures are sampled, as in LeRobot: a few frames per episode, every fourth pixel in
each direction, accumulated in one histogram per channel, which gives exact quantiles of the sample in constant memory.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from cognitivedrone.data.episode import Episode, Split, decode_image
from cognitivedrone.data.formats.exchange import check_file, plain_facts
from cognitivedrone.errors import DataError
from cognitivedrone.models.words.text_encoder import VECTOR_SIZE, hash_instruction
from cognitivedrone.pictures import MAX_SIDE
from cognitivedrone.types import CONTROL_HZ, IMAGE_SIZE, Image

IMAGE_KEY = "observation.images.front"
DOWN_KEY = "observation.images.down"
"""Of the camera that looks down, only in exports of flights that have it."""
MOTION = ["vx", "vy", "vz", "yaw_rate"]
FLOATS: dict[str, tuple[str, list[str]]] = {
    "observation.state": ("float32", ["vx", "vy", "vz", "height", "yaw_rate"]),
    "action": ("float32", MOTION),
    "sent": ("float32", MOTION),
    "position": ("float64", ["x", "y", "z"]),
    "quaternion": ("float64", ["w", "x", "y", "z"]),
}
WORDS_KEY = "observation.environment_state"
"""The instruction as a vector (`hash_instruction`), for policies that read no text; only in exports that ask for it."""
INTEGERS = ("frame_index", "episode_index", "index", "task_index", "correct_gate", "seed")
TEXTS = ("directive", "category", "family", "place", "record")
"""`record` is the rest of an episode, at its first step: LeRobot's tools drop unknown columns of episodes alone."""
_CARD_TEXT = (
    "# Flights of CognitiveDrone in the layout of LeRobot v3",
    "",
    "`LeRobotDataset` opens this folder; `datasets.load_dataset` reads its steps as a plain table. Actions and states"
    " are velocities in m/s, a height in m and a yaw rate in rad/s, ten times a second.",
)


def cameras_of(episode: Episode) -> dict[str, tuple[bytes, ...]]:
    """The T encoded frames of each camera by its key."""
    return {IMAGE_KEY: episode.images} | ({DOWN_KEY: episode.down} if episode.down else {})


def floats_of(*, words: bool) -> dict[str, tuple[str, list[str]]]:
    """The columns of numbers of an export, their types, and the names of their components."""
    return FLOATS | ({WORDS_KEY: ("float32", [f"word_{n}" for n in range(VECTOR_SIZE)])} if words else {})


def feature_spec(cameras: Sequence[str] = (IMAGE_KEY,), *, video: bool, words: bool = False) -> dict[str, Any]:
    """`features` of info.json."""
    image: dict[str, Any] = {
        "dtype": "video" if video else "image",
        "shape": [IMAGE_SIZE, IMAGE_SIZE, 3],
        "names": ["height", "width", "channels"],
    }
    if video:
        image["info"] = {
            "video.height": IMAGE_SIZE,
            "video.width": IMAGE_SIZE,
            "video.codec": "h264",
            "video.pix_fmt": PIXELS,
            "video.is_depth_map": False,
            "video.fps": CONTROL_HZ,
            "video.channels": 3,
            "has_audio": False,
        }
    features = dict.fromkeys(cameras, image)
    for name, (dtype, names) in floats_of(words=words).items():
        features[name] = {"dtype": dtype, "shape": [len(names)], "names": names}
    scalars = {"timestamp": "float32"} | dict.fromkeys(INTEGERS, "int64") | dict.fromkeys(TEXTS, "string")
    return features | {name: {"dtype": dtype, "shape": [1], "names": None} for name, dtype in scalars.items()}


def schema_of(cameras: Sequence[str] = (IMAGE_KEY,), *, video: bool, words: bool = False) -> pa.Schema:
    """Schema of the data files: columns in the order of `feature_spec`, none for the frames of a video."""
    frame = pa.struct({"bytes": pa.binary(), "path": pa.string()})
    fields = [] if video else [pa.field(key, frame) for key in cameras]
    for name, (dtype, names) in floats_of(words=words).items():
        fields.append(pa.field(name, pa.list_(pa.type_for_alias(dtype), len(names))))
    fields.append(pa.field("timestamp", pa.float32()))
    fields += [pa.field(name, pa.int64()) for name in INTEGERS]
    fields += [pa.field(name, pa.string()) for name in TEXTS]
    types = {field.name: _plain_type(field) for field in fields}
    return pa.schema(fields, {"huggingface": json.dumps({"info": {"features": types}})})


def _plain_type(field: pa.Field) -> dict[str, Any]:
    """A column's type as the library `datasets` writes it. "Sequence" is read by all its versions, "List" from 4 on."""
    if field.name in (IMAGE_KEY, DOWN_KEY):
        return {"_type": "Image"}
    if pa.types.is_fixed_size_list(field.type):
        value = pa.field(field.name, field.type.value_type)
        return {"feature": _plain_type(value), "length": field.type.list_size, "_type": "Sequence"}
    return {"dtype": {"float": "float32", "double": "float64"}.get(str(field.type), str(field.type)), "_type": "Value"}


def columns_of(episode: Episode, number: int, first: int, task_index: int, record: str) -> dict[str, NDArray[Any]]:
    """The columns of an episode's steps but its pictures, by name; `record` is at the first step."""
    length = len(episode)
    facts = plain_facts(episode) | {"episode_index": number, "task_index": task_index}
    frame = np.arange(length)
    return {
        "observation.state": episode.state,
        **{name: getattr(episode, name) for name in FLOATS if name != "observation.state"},
        WORDS_KEY: np.tile(hash_instruction(episode.task.instruction), (length, 1)),
        "timestamp": (frame / CONTROL_HZ).astype(np.float32),
        "frame_index": frame,
        "index": first + frame,
        **{name: np.full(length, facts[name]) for name in (*INTEGERS, *TEXTS) if name in facts and name != "index"},
        "record": np.array([record, *[""] * (length - 1)], dtype=object),
    }


def table_of(columns: dict[str, NDArray[Any]], cameras: dict[str, tuple[bytes, ...]], schema: pa.Schema) -> pa.Table:
    """The rows of an episode, for a data file."""
    arrays = []
    for field in schema:
        if field.name in cameras:
            arrays.append(pa.array([{"bytes": image, "path": None} for image in cameras[field.name]], field.type))
        elif pa.types.is_fixed_size_list(field.type):
            values = np.ascontiguousarray(columns[field.name])
            arrays.append(pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1]))
        else:
            arrays.append(pa.array(columns[field.name], field.type))
    return pa.Table.from_arrays(arrays, schema=schema)


def task_table(tasks: list[str]) -> pa.Table:
    """tasks.parquet: the sentence is the index of a pandas table, which only the schema's metadata can express."""
    index = "__index_level_0__"
    table = pa.table({"task_index": pa.array(range(len(tasks)), pa.int64()), index: pa.array(tasks, pa.string())})

    def column(name: str | None, field: str, kind: str, numpy_kind: str) -> dict[str, Any]:
        return {"name": name, "field_name": field, "pandas_type": kind, "numpy_type": numpy_kind, "metadata": None}

    pandas = {
        "index_columns": [index],
        "column_indexes": [column(None, "None", "unicode", "object") | {"metadata": {"encoding": "UTF-8"}}],
        "columns": [column("task_index", "task_index", "int64", "int64"), column(None, index, "unicode", "object")],
        "pandas_version": "2.0.0",
        "creator": {"library": "pyarrow", "version": pa.__version__},
    }
    return table.replace_schema_metadata({"pandas": json.dumps(pandas)})


def card(files: Mapping[Split, Sequence[str]]) -> str:
    """README.md: which files are data, for `datasets.load_dataset` and the Hub; without, it would read `meta` too."""
    lines = ["---", "tags:", "- LeRobot", "- cognitivedrone", "configs:", "- config_name: default", "  data_files:"]
    for split, paths in files.items():
        lines += [f"  - split: {split}", "    path:", *(f"    - {path}" for path in paths)]
    return "\n".join([*lines, "---", "", *_CARD_TEXT, ""])


Stats = dict[str, list[Any]]

QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
FRAMES_AN_EPISODE = 4
PIXEL_STRIDE = 4


class Statistics:
    """Accumulates episodes; `total` covers all of them."""

    def __init__(self) -> None:
        self._columns: dict[str, list[NDArray[Any]]] = {}
        self._histograms: dict[str, NDArray[np.int64]] = {}
        self._frames = 0

    def add(self, numbers: Mapping[str, NDArray[Any]], cameras: Mapping[str, tuple[bytes, ...]]) -> dict[str, Stats]:
        """Add the step arrays (T, ...) and each camera's T frames of an episode; returns its own statistics."""
        for name, values in numbers.items():
            self._columns.setdefault(name, []).append(values)
        stats = {name: number_stats(values) for name, values in numbers.items()}
        length = len(next(iter(cameras.values())))
        sampled = np.unique(np.linspace(0, length - 1, FRAMES_AN_EPISODE).astype(int)).tolist()
        self._frames += len(sampled)
        for key, images in cameras.items():
            histogram = sum((_histogram(images[step]) for step in sampled), np.zeros((3, 256), np.int64))
            self._histograms[key] = self._histograms.get(key, 0) + histogram
            stats[key] = image_stats(histogram, len(sampled))
        return stats

    def total(self) -> dict[str, Stats]:
        """Statistics of all added episodes."""
        stats = {name: number_stats(np.concatenate(parts)) for name, parts in self._columns.items()}
        return stats | {key: image_stats(histogram, self._frames) for key, histogram in self._histograms.items()}


def number_stats(values: NDArray[Any]) -> Stats:
    """Statistics of (T,) or (T, n) numbers, each a list of n (of one for scalars)."""
    table = values.reshape(len(values), -1).astype(np.float64)
    stats: Stats = {
        "min": table.min(0).tolist(),
        "max": table.max(0).tolist(),
        "mean": table.mean(0).tolist(),
        "std": table.std(0).tolist(),
        "count": [len(table)],
    }
    quantiles = np.quantile(table, list(QUANTILES.values()), axis=0)
    return stats | {name: row.tolist() for name, row in zip(QUANTILES, quantiles, strict=True)}


def image_stats(histogram: NDArray[np.int64], frames: int) -> Stats:
    """Statistics of a (3, 256) histogram of pixel values, scaled to 0..1; each has shape (3, 1, 1)."""
    level = np.arange(256) / 255
    share = histogram / histogram.sum(1, keepdims=True)
    mean = share @ level
    seen = histogram > 0
    stats = {
        "min": level[seen.argmax(1)],
        "max": level[255 - seen[:, ::-1].argmax(1)],
        "mean": mean,
        "std": np.sqrt(np.maximum(share @ level**2 - mean**2, 0)),
    }
    below = share.cumsum(1)
    stats |= {name: level[(below < q - 1e-12).sum(1).clip(max=255)] for name, q in QUANTILES.items()}
    shaped: Stats = {name: value.reshape(3, 1, 1).tolist() for name, value in stats.items()}
    return shaped | {"count": [frames]}


def _histogram(image: bytes) -> NDArray[np.int64]:
    pixels = decode_image(image)[::PIXEL_STRIDE, ::PIXEL_STRIDE].reshape(-1, 3)
    return np.stack([np.bincount(pixels[:, channel], minlength=256) for channel in range(3)])


CODEC, PIXELS = "libx264", "yuv420p"
CRF = 18
"""Constant quality factor; 18 is hard to tell from the original."""
KEYFRAME_EVERY = 2
"""Distance in frames; training reads at random, so a reader must decode little to reach one frame."""


class VideoWriter:
    """One MP4 file that grows episode by episode."""

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self.frames = 0
        self._container = av.open(str(path), "w")
        options = {"crf": str(CRF), "g": str(KEYFRAME_EVERY), "preset": "veryfast"}
        self._stream = self._container.add_stream(CODEC, rate=CONTROL_HZ, options=options)
        self._stream.width = self._stream.height = IMAGE_SIZE
        self._stream.pix_fmt = PIXELS
        self._stream.codec_context.time_base = Fraction(1, CONTROL_HZ)

    def add(self, images: Iterable[bytes]) -> None:
        """Append encoded frames."""
        for image in images:
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(decode_image(image)), format="rgb24")
            frame.pts = self.frames
            frame.time_base = Fraction(1, CONTROL_HZ)
            self._container.mux(self._stream.encode(frame))
            self.frames += 1

    def close(self) -> None:
        """Write the encoder's remaining frames, and the index."""
        self._container.mux(self._stream.encode(None))
        self._container.close()


def read_frames(path: Path) -> Iterator[Image]:
    """The frames of a file in order, (256, 256, 3) RGB; `DataError` if it cannot be decoded."""
    check_file(path)
    try:
        limit = {"max_pixels": str(MAX_SIDE**2)}  # also while FFmpeg looks for the size
        with av.open(str(path), options=limit) as container:
            size = container.streams.video[0].codec_context
            size.options = limit
            if max(size.width, size.height) > MAX_SIDE:
                raise DataError(
                    f"{path}: has {size.width} x {size.height} pixels; a frame has at most {MAX_SIDE} a side"
                )
            for frame in container.decode(video=0):
                yield frame.to_ndarray(format="rgb24")
    except (OSError, ValueError, IndexError) as error:
        raise DataError(f"{path}: not a whole video ({error}); copy or export it again") from None
