"""One shard of a store: a self-describing Parquet file.

One row per control step, one row group per episode, so that a single frame is read without its neighbours.
Numbers are compressed with zstd; frames are already compressed and stored as they are. Facts about a whole
episode (task, conditions, encoding, end) are JSON in the file's footer, in the order of the row groups.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from cognitivedrone import files
from cognitivedrone.data.episode import Conditions, Episode
from cognitivedrone.data.manifest import MAX_SHARD_BYTES, MAX_TEXT_BYTES, check_footer, clear_errors, write_atomically
from cognitivedrone.data.statistics import Flown
from cognitivedrone.errors import CognitiveDroneError, DataError
from cognitivedrone.tasks.format import task_from_json, task_to_json
from cognitivedrone.text.json_text import parse_json
from cognitivedrone.types import Task

FOOTER_KEY: Final = "cognitivedrone"
MIN_FRAME_BYTES: Final = 20
"""Of any encoded picture; one pixel as WebP has 30."""
MAX_ROW_BYTES: Final = 128
"""Of a step in one column of numbers, with what Parquet adds."""
_PAGE_BYTES: Final = 4096  # of headers, in a column of one row group
WIDTHS: Final[dict[str, tuple[str, int]]] = {
    "action": ("float32", 4),
    "sent": ("float32", 4),
    "velocity": ("float32", 3),
    "height": ("float32", 1),
    "yaw_rate": ("float32", 1),
    "position": ("float64", 3),
    "quaternion": ("float64", 4),
}
"""Type and width of every array of an episode; a width of one is a plain column."""


def _arrow_type(dtype: str, width: int) -> Any:
    scalar = pa.float32() if dtype == "float32" else pa.float64()
    return scalar if width == 1 else pa.list_(pa.field("element", scalar, nullable=False), width)


DOWN: Final = "image_down"
"""Column of the frames of the camera that looks down, only in shards whose episodes have them."""
SCHEMA: Final = pa.schema(
    [pa.field("episode", pa.int64(), nullable=False), pa.field("step", pa.int32(), nullable=False)]
    + [pa.field("image", pa.binary(), nullable=False)]
    + [pa.field(name, _arrow_type(*WIDTHS[name]), nullable=False) for name in WIDTHS]
)
DOWN_SCHEMA: Final = SCHEMA.insert(SCHEMA.names.index("image") + 1, SCHEMA.field("image").with_name(DOWN))
_ORDER: Final = ("episode", "step")
"""Columns that say which step of which episode a row is."""
COMPRESSION: Final = {"episode": "zstd", "step": "zstd", "image": "none", DOWN: "none"} | {
    name if width == 1 else f"{name}.list.element": "zstd" for name, (_, width) in WIDTHS.items()
}
"""Compression by Parquet's column paths."""


def write_shard_file(path: Path, episodes: Sequence[Episode], dropped: Mapping[str, int]) -> None:
    """Write a shard of complete episodes: same episodes, same bytes. Raises `DataError` and leaves `path` unchanged."""
    for episode in episodes:
        check_episode(episode)
        check_cameras(episode, down=bool(episodes[0].down))
    schema = DOWN_SCHEMA if episodes and episodes[0].down else SCHEMA
    footer = {"episodes": [_facts(episode) for episode in episodes], "dropped": dict(sorted(dropped.items()))}

    def write(temporary: Path) -> None:
        with pq.ParquetWriter(
            temporary, schema, compression=COMPRESSION, use_dictionary=False, write_statistics=False
        ) as writer:
            writer.add_key_value_metadata({FOOTER_KEY: json.dumps(footer, ensure_ascii=False, allow_nan=False)})
            for episode in episodes:
                writer.write_table(_table(episode, schema), row_group_size=len(episode))

    write_atomically(path, write)


def check_episode(episode: Episode) -> None:
    """Raise `DataError` unless every array has the type and shape for an episode of this length."""
    where = f"episode {episode.index}"
    if len(episode) == 0:
        raise DataError(f"{where}: has no step; a recorded flight has at least one")
    if len(episode.down) not in (0, len(episode)):
        raise DataError(f"{where}: has {len(episode.down)} frames that look down; it must be one a step, or none")
    for name, (dtype, width) in WIDTHS.items():
        array = getattr(episode, name)
        shape = (len(episode),) if width == 1 else (len(episode), width)
        if array.shape != shape or array.dtype != dtype:
            raise DataError(f"{where}: {name} is {array.dtype} {array.shape}; it must be {dtype} {shape}")
    if episode.final_position.shape != (3,):
        raise DataError(f"{where}: final_position has shape {episode.final_position.shape}; it must be (3,)")
    unfit = [name for name in ("action", "sent") if not np.isfinite(getattr(episode, name)).all()]
    if unfit:
        raise DataError(f"{where}: {unfit[0]} holds a number that is not finite; such a flight cannot be learned from")


def check_cameras(episode: Episode, *, down: bool) -> None:
    """Raise `DataError` unless it has frames of the camera that looks down, or has none, like the rest of its set."""
    if bool(episode.down) != down:
        there = "no frames" if down else "frames"
        raise DataError(
            f"episode {episode.index}: has {there} of the camera that looks down, unlike those before it; keep flights"
            " with them in a set of their own"
        )


def _table(episode: Episode, schema: Any) -> Any:
    length = len(episode)
    columns = [
        pa.array(np.full(length, episode.index, np.int64)),
        pa.array(np.arange(length, dtype=np.int32)),
        pa.array(episode.images, pa.binary()),
    ]
    if DOWN in schema.names:
        columns.append(pa.array(episode.down, pa.binary()))
    for name, (_, width) in WIDTHS.items():
        flat = pa.array(np.ascontiguousarray(getattr(episode, name)).reshape(-1))
        columns.append(flat if width == 1 else pa.FixedSizeListArray.from_arrays(flat, type=schema.field(name).type))
    return pa.Table.from_arrays(columns, schema=schema)


def _facts(episode: Episode) -> dict[str, Any]:
    """The footer's entry for an episode."""
    return {
        "index": episode.index,
        "length": len(episode),
        "suite": episode.suite,
        "encoding": episode.encoding,
        "conditions": episode.conditions.facts(),
        "final_position": episode.final_position.tolist(),
        "task": task_to_json(episode.task),
    }


def check_unpacked_size(metadata: Any, file_bytes: int) -> None:
    """Raise `ValueError`, by its footer, for a shard that would be much larger in memory than on disk.

    Frames are stored as they are, each in at least `MIN_FRAME_BYTES`, so the file bounds the number of rows; and the
    numbers of a row have less than `MAX_ROW_BYTES`, however well they are compressed.
    """
    if metadata.num_rows * MIN_FRAME_BYTES > file_bytes:
        raise ValueError(f"its {metadata.num_rows:,} steps do not fit into {file_bytes:,} bytes")
    for number in range(metadata.num_row_groups):
        group = metadata.row_group(number)
        for column in map(group.column, range(group.num_columns)):
            if column.path_in_schema in ("image", DOWN):
                packed = column.compression != "UNCOMPRESSED" or column.has_dictionary_page
                if packed or column.total_uncompressed_size > file_bytes:
                    raise ValueError(f"the frames of row group {number} are compressed a second time")
            elif (size := unpacked_bytes(column)) > group.num_rows * MAX_ROW_BYTES + _PAGE_BYTES:
                unpacked = f"{size:,} bytes for {group.num_rows:,} steps"
                raise ValueError(f"column {column.path_in_schema} of row group {number} unpacks to {unpacked}")


def unpacked_bytes(chunk: Any) -> int:
    """At most so many bytes has a column chunk in memory: of a dictionary, every row may name the longest entry."""
    repeats = chunk.num_values if chunk.has_dictionary_page and chunk.physical_type == "BYTE_ARRAY" else 1
    return int(repeats * chunk.total_uncompressed_size)


class ShardFile:
    """A shard opened for reading, memory-mapped. Do not share it between threads."""

    def __init__(self, path: Path) -> None:
        self.path = path
        with clear_errors(path, "read"):
            files.check_regular(path, MAX_SHARD_BYTES)
            self._file = pq.ParquetFile(path, memory_map=True)
            check_unpacked_size(self._file.metadata, path.stat().st_size)
            self._schema = DOWN_SCHEMA if DOWN in self._file.schema_arrow.names else SCHEMA
            held = (self._file.metadata.metadata or {}).get(FOOTER_KEY.encode(), b"")
            footer = parse_json(held, max_bytes=MAX_TEXT_BYTES)
            self._check_columns()
        check_footer(footer, path)
        self.facts: list[dict[str, Any]] = footer["episodes"]
        self.dropped: dict[str, int] = footer["dropped"]
        self._row_groups = {facts["index"]: number for number, facts in enumerate(self.facts)}
        if self._file.num_row_groups != len(self.facts):
            raise DataError(f"{path}: lists {len(self.facts)} episodes but holds {self._file.num_row_groups}")
        for number, facts in enumerate(self.facts):
            rows = self._file.metadata.row_group(number).num_rows
            if rows != facts["length"]:
                raise DataError(f"{path}, episode {facts['index']}: has {facts['length']} steps but {rows} rows")

    def _check_columns(self) -> None:
        found = self._file.schema_arrow
        for column in self._schema:
            kind = found.field(column.name).type if column.name in found.names else "missing"
            if not (kind == column.type or str(kind) == str(column.type)):
                raise DataError(f"{self.path}: the column {column.name} is {kind}; it must be {column.type}")

    @property
    def down_camera(self) -> bool:
        """Whether its episodes have frames of the camera that looks down."""
        return DOWN in self._schema.names

    def images(self, index: int) -> Any:
        """The encoded frames of an episode as an Arrow binary array, in order of time."""
        with clear_errors(self.path, f"read at episode {index}"):
            table = self._file.read_row_group(self._row_groups[index], columns=[*_ORDER, "image"], use_threads=False)
        self._check_order(table, [(index, table.num_rows)])
        return table["image"].combine_chunks()

    def numbers(self, names: Iterable[str]) -> dict[str, NDArray[Any]]:
        """Whole columns of the shard, (steps,) or (steps, width), episode after episode."""
        with clear_errors(self.path, "read"):
            table = self._file.read(columns=[*_ORDER, *names], use_threads=False)
        self._check_order(table, [(facts["index"], facts["length"]) for facts in self.facts])
        with clear_errors(self.path, "read"):
            return {name: _to_numpy(table[name], name) for name in names}

    def _check_order(self, table: Any, lengths: Sequence[tuple[int, int]]) -> None:
        """Raise `DataError` unless the rows are those of these episodes, step by step, with all of their values."""
        if any(table[name].null_count for name in table.column_names):
            raise DataError(f"{self.path}: lacks values; collect it again with --resume")
        found = [table[name].to_numpy() for name in _ORDER]
        meant = [np.repeat([index for index, _ in lengths], [length for _, length in lengths])]
        meant.append(np.concatenate([np.empty(0, np.int64), *(np.arange(length) for _, length in lengths)]))
        if not all(map(np.array_equal, found, meant)):
            raise DataError(f"{self.path}: the rows of an episode are those of another; collect it again with --resume")

    def rows(self) -> Iterator[tuple[dict[str, Any], slice]]:
        """The facts of each episode, and where its steps stand in what `numbers` gives."""
        first = 0
        for facts in self.facts:
            yield facts, slice(first, first + facts["length"])
            first += facts["length"]

    def episode(self, index: int) -> Episode:
        """A whole episode; raises `DataError`."""
        number = self._row_groups[index]
        facts = self.facts[number]
        with clear_errors(self.path, f"read at episode {index}"):
            table = self._file.read_row_group(number, columns=self._schema.names, use_threads=False)
        self._check_order(table, [(index, facts["length"])])
        with clear_errors(self.path, f"read at episode {index}"):
            arrays: dict[str, Any] = {name: _to_numpy(table[name], name) for name in WIDTHS}
            conditions = facts["conditions"]
            return Episode(
                index=index,
                suite=facts["suite"],
                task=self.task(facts),
                conditions=Conditions(
                    **conditions | {name: tuple(conditions[name]) for name in ("start_position", "wind")}
                ),
                encoding=facts["encoding"],
                images=tuple(table["image"].to_pylist()),
                final_position=np.array(facts["final_position"], np.float64),
                down=tuple(table[DOWN].to_pylist()) if self.down_camera else (),
                **arrays,
            )

    def task(self, facts: Mapping[str, Any]) -> Task:
        """The task of an episode of this shard, from its entry in `facts`; raises `DataError`."""
        try:
            return task_from_json(facts["task"], where=f"{self.path}, episode {facts['index']}")
        except CognitiveDroneError as error:
            raise DataError(str(error)) from None


def _to_numpy(column: Any, name: str) -> NDArray[Any]:
    _, width = WIDTHS[name]
    whole = column.combine_chunks()
    if width == 1:
        return np.array(whole.to_numpy(zero_copy_only=False))
    return np.array(whole.flatten().to_numpy(zero_copy_only=False)).reshape(-1, width)


def flown_in(shards: Sequence[ShardFile]) -> list[Flown]:
    """Actions, states and families of all episodes, in order of index."""
    flown = []
    for shard in shards:
        columns = shard.numbers(["action", "velocity", "height", "yaw_rate"])
        state = np.column_stack([columns["velocity"], columns["height"], columns["yaw_rate"]])
        for facts, rows in shard.rows():
            task = facts["task"]
            flown.append(Flown(facts["index"], task["family"], task["category"], columns["action"][rows], state[rows]))
    return sorted(flown, key=lambda episode: episode.index)


def tasks_in(shards: Sequence[ShardFile]) -> list[Task]:
    """The tasks of all episodes, in order of index. Raises `DataError`."""
    found = {facts["index"]: shard.task(facts) for shard in shards for facts in shard.facts}
    return [found[index] for index in sorted(found)]
