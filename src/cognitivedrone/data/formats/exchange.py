"""Shared parts of all exchange formats: the facts beside the steps, and folders that are complete or absent."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage

from cognitivedrone.data.episode import Conditions, Encoding, Episode, Split
from cognitivedrone.data.shards import WIDTHS, check_cameras, unpacked_bytes
from cognitivedrone.errors import DataError, TaskError
from cognitivedrone.files import check_regular, create, read_regular, reason_of, remove, replacing_folder
from cognitivedrone.files.locks import LOCK_FILE, holds_files, sole_writer
from cognitivedrone.pictures import MAX_SIDE, open_picture
from cognitivedrone.tasks import task_from_json, task_to_json
from cognitivedrone.text.json_text import parse_json

MAX_JSON_BYTES = 256 * 2**20
MAX_ROWS = 10_000_000
"""Of one file that is read; ours have less than a million."""
MAX_UNPACKED_BYTES = 4 * 2**30
"""Of the columns of one file that are read."""

STEP_ARRAYS = tuple(WIDTHS)
"""Numeric arrays of a step: names in `Episode`."""


@contextmanager
def new_folder(out: Path) -> Iterator[Path]:
    """A folder to write into that becomes `out` on success, and is removed on failure.

    Raises `DataError` if `out` is not empty, cannot be written, or another process is exporting to it.
    """
    if out.exists() and (not out.is_dir() or holds_files(out)):
        raise DataError(f"{out}: exists already; give a new or an empty folder, nothing is overwritten")
    with sole_writer(out, DataError, "exporting to it"):
        yield from _filled(out)


def _filled(out: Path) -> Iterator[Path]:
    partial = out
    try:
        with replacing_folder(out) as partial:
            yield partial
            remove(out, LOCK_FILE)
    except OSError as error:
        place = str(error.filename or out).replace(str(partial), str(out))
        raise DataError(f"{place}: cannot be written ({reason_of(error)}); nothing was left at {out}") from error
    except (UnicodeEncodeError, UnicodeDecodeError) as error:
        raise DataError(f"{out}: cannot be written, a text of the data has no UTF-8 ({error.reason})") from None


def same_cameras(episodes: Iterable[tuple[Split, Episode]]) -> Iterator[tuple[Split, Episode]]:
    """The same episodes; raises `DataError` where one has another number of cameras than the first."""
    down: bool | None = None
    for split, episode in episodes:
        down = bool(episode.down) if down is None else down
        check_cameras(episode, down=down)
        yield split, episode


def record_of(split: Split, episode: Episode) -> dict[str, Any]:
    """Plain JSON facts of an episode beyond its steps; `episode_from` reads them back exactly."""
    return {
        "split": split,
        "suite": episode.suite,
        "index": episode.index,
        "task": task_to_json(episode.task),
        "conditions": episode.conditions.facts(),
        "final_position": episode.final_position.tolist(),
    }


def plain_facts(episode: Episode) -> dict[str, str | int]:
    """Flat facts for filtering: `correct_gate` counts from 1 like published task files; 0 is none. `place` is where the
    flight was, empty in a plain or varied room.
    """
    task = episode.task
    return {
        "directive": task.directive,
        "category": task.category,
        "family": task.family,
        "correct_gate": 0 if task.target is None else task.target + 1,
        "place": episode.conditions.place,
        "seed": episode.conditions.seed,
        "suite": episode.suite,
        "index": episode.index,
    }


def episode_from(
    record: object,
    images: tuple[bytes, ...],
    arrays: Mapping[str, NDArray[Any]],
    where: str,
    down: tuple[bytes, ...] = (),
) -> tuple[Split, Episode]:
    """The episode of facts, frames and step arrays (T, ...); `DataError` names the place of a mismatch.

    `down` has the frames of the camera that looks down, if there are any.
    """
    try:
        facts = cast(dict[str, Any], record)
        conditions = dict(facts["conditions"])
        for name in ("start_position", "wind"):
            conditions[name] = tuple(float(value) for value in conditions[name])
        shaped = {
            name: np.ascontiguousarray(arrays[name], dtype).reshape(len(images), *((width,) if width > 1 else ()))
            for name, (dtype, width) in WIDTHS.items()
        }
        encoding = encoding_of(images, where)
        below = f"{where}, camera that looks down"
        if down and (len(down), encoding_of(down, below)) != (len(images), encoding):
            raise DataError(f"{below}: its frames differ from the others in number or encoding; export them again")
        episode = Episode(
            index=int(facts["index"]),
            suite=str(facts["suite"]),
            task=task_from_json(facts["task"], where=where),
            conditions=Conditions(**conditions),
            encoding=encoding,
            images=images,
            final_position=np.array(facts["final_position"], np.float64).reshape(3),
            down=down,
            **cast(dict[str, Any], shaped),
        )
    except TaskError as error:
        raise DataError(str(error)) from None
    except (LookupError, TypeError, ValueError, ArithmeticError, AttributeError) as error:
        raise DataError(f"{where}: not an episode of this format ({type(error).__name__}: {brief(error)})") from None
    if facts.get("split") not in ("train", "val"):
        raise DataError(f"{where}: split is {facts.get('split')!r}; it must be train or val")
    return facts["split"], episode


def encoding_of(images: tuple[bytes, ...], where: str) -> Encoding:
    """The common encoding of the frames, by their first bytes."""
    if not images:
        raise DataError(f"{where}: holds no frame")
    found = {_magic(image) for image in images}
    if len(found) > 1 or None in found:
        first = _magic(images[0])
        number = next(i for i, image in enumerate(images) if first is None or _magic(image) != first)
        raise DataError(f"{where}: frame {number} is broken or encoded unlike the first; export the episode again")
    for number, image in enumerate(images):
        check_size(image, f"{where}, frame {number}")
    return cast(Encoding, found.pop())


def check_image(data: bytes, where: str) -> None:
    """Raise `DataError` if a frame is too large, by its header, or cannot be fully decoded."""
    try:
        with _opened(data, where) as picture:
            picture.load()
    except DataError:
        raise
    except Exception as error:  # Pillow raises many kinds for broken files
        raise DataError(f"{where}: not a whole image ({brief(error)})") from None


def check_size(data: bytes, where: str) -> None:
    """Raise `DataError` if a frame is not an image, or too large; reads only its header."""
    try:
        _opened(data, where).close()
    except DataError:
        raise
    except Exception as error:  # as above
        raise DataError(f"{where}: not an image ({brief(error)})") from None


def brief(error: Exception) -> str:
    """A library's message in one short line."""
    return " ".join(str(error).split())[:100] or type(error).__name__


def _opened(data: bytes, where: str) -> PillowImage.Image:
    try:
        picture = open_picture(data, ("JPEG", "PNG", "WEBP"), max_side=MAX_SIDE)
    except ValueError as error:
        raise DataError(f"{where}: {error}") from None
    if picture.mode.startswith("I"):  # 16 bits of grey, which would be white
        raise DataError(f"{where}: has pixels of 16 bits; a frame has 8 bits a colour, so convert them")
    return picture


def read_json(path: Path) -> Any:
    """The content of a JSON file; `DataError` if it is missing, not a regular file, too large or malformed."""
    try:
        return parse_json(read_regular(path, MAX_JSON_BYTES).decode("utf-8"))
    except OSError as error:
        raise DataError(
            f"{path}: cannot be read ({reason_of(error)}); is this the folder of a whole data set?"
        ) from None
    except ValueError as error:
        raise DataError(f"{path}: not JSON ({brief(error)})") from None


def check_file(path: Path) -> None:
    """Raise `DataError` unless `path` is a regular file, because libraries might block on anything else."""
    try:
        check_regular(path)
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({reason_of(error)}); copy or export the data set again") from None


def check_unpacked_size(metadata: Any, path: Path, columns: Collection[str]) -> None:
    """Raise `DataError`, by its footer, for a file whose columns would fill the memory."""
    groups = [metadata.row_group(number) for number in range(metadata.num_row_groups)]
    chunks = [group.column(number) for group in groups for number in range(group.num_columns)]
    within = tuple(f"{name}." for name in columns)  # names have dots as well
    unpacked = sum(unpacked_bytes(chunk) for chunk in chunks if f"{chunk.path_in_schema}.".startswith(within))
    if metadata.num_rows > MAX_ROWS or unpacked > MAX_UNPACKED_BYTES:
        raise DataError(
            f"{path}: has {metadata.num_rows:,} rows and {unpacked:,} bytes when unpacked; at most {MAX_ROWS:,} rows"
            f" and {MAX_UNPACKED_BYTES:,} bytes of one file are read"
        )


def write_json(path: Path, content: Any) -> None:
    """A JSON file, indented, UTF-8."""
    with create(path) as file:  # in a new folder, which is whole or not there
        file.write(f"{json.dumps(content, indent=2, ensure_ascii=False)}\n".encode())


def _magic(data: bytes) -> Encoding | None:
    if data.startswith(b"\xff\xd8\xff"):
        return "jpeg"
    if data.startswith(b"\x89PNG\r\n\x1a\n"):
        return "png"
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        return "webp"
    return None
