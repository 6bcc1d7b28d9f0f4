"""The columns of a LeRobot data set: for LeRobot, for parquet, and for Hugging Face's `datasets`; and its card."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import pyarrow as pa

from cognitivedrone.data.episode import Episode, Split
from cognitivedrone.data.formats.lerobot_video import PIXELS
from cognitivedrone.types import CONTROL_HZ, IMAGE_SIZE

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


def feature_spec(cameras: Sequence[str] = (IMAGE_KEY,), *, video: bool) -> dict[str, Any]:
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
    for name, (dtype, names) in FLOATS.items():
        features[name] = {"dtype": dtype, "shape": [len(names)], "names": names}
    scalars = {"timestamp": "float32"} | dict.fromkeys(INTEGERS, "int64") | dict.fromkeys(TEXTS, "string")
    return features | {name: {"dtype": dtype, "shape": [1], "names": None} for name, dtype in scalars.items()}


def schema_of(cameras: Sequence[str] = (IMAGE_KEY,), *, video: bool) -> pa.Schema:
    """Schema of the data files: columns in the order of `feature_spec`, none for the frames of a video."""
    frame = pa.struct({"bytes": pa.binary(), "path": pa.string()})
    fields = [] if video else [pa.field(key, frame) for key in cameras]
    for name, (dtype, names) in FLOATS.items():
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
    if field.name in FLOATS:
        dtype, names = FLOATS[field.name]
        return {"feature": {"dtype": dtype, "_type": "Value"}, "length": len(names), "_type": "Sequence"}
    return {"dtype": {"float": "float32"}.get(str(field.type), str(field.type)), "_type": "Value"}


def card(files: Mapping[Split, Sequence[str]]) -> str:
    """README.md: which files are data, for `datasets.load_dataset` and the Hub; without, it would read `meta` too."""
    lines = ["---", "tags:", "- LeRobot", "- cognitivedrone", "configs:", "- config_name: default", "  data_files:"]
    for split, paths in files.items():
        lines += [f"  - split: {split}", "    path:", *(f"    - {path}" for path in paths)]
    return "\n".join([*lines, "---", "", *_CARD_TEXT, ""])
