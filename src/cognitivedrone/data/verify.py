"""Verification of a store: finds files that are missing, truncated or altered, frames that cannot be shown, numbers
that cannot be used, and inconsistent content.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import numpy as np
from PIL import Image as PillowImage

from cognitivedrone.data.episode import Encoding, Episode
from cognitivedrone.data.manifest import (
    MANIFEST,
    MAX_TEXT_BYTES,
    PARTIAL,
    SHARDS,
    STATISTICS,
    SUMS,
    TASKS,
    check_format,
    check_manifest,
    head_of,
    making_of,
    read_json,
    read_manifest,
    read_sums,
    read_text,
    receipt_name,
    receipt_text,
    sha256_of,
)
from cognitivedrone.data.shards import WIDTHS, ShardFile, flown_in, tasks_in
from cognitivedrone.data.statistics import draw_splits, statistics
from cognitivedrone.errors import CognitiveDroneError, DataError
from cognitivedrone.system import cores
from cognitivedrone.tasks.format import read_tasks
from cognitivedrone.types import IMAGE_SIZE

START_M: Final = 1e-3
"""Largest distance between the first position and that of the conditions; there is none in flights of ours."""
STEP_M: Final = 1.0
"""Largest distance between the last position and the end of the flight, a step later; drones here reach 2.5 m/s."""
UNIT: Final = 1e-3
"""Largest difference between the norm of an attitude's quaternion and 1."""


def faults_of(shard: ShardFile) -> Iterator[str]:
    """What is wrong with the episodes of an open shard, at most one fault for each."""
    with ThreadPoolExecutor(cores()) as pool:
        for facts in shard.facts:
            where = f"episode {facts['index']}"
            try:
                episode = shard.episode(facts["index"])
            except DataError as error:
                yield f"{where}: {error}"
                continue
            steps = [f"frame {step}" for step in range(len(episode))]
            names = steps + [f"{step} of the camera that looks down" for step in steps if episode.down]
            frames = episode.images + episode.down
            checks = pool.map(_fault_of_frame, frames, [episode.encoding] * len(frames))
            frame = next((f"{name} {fault}" for name, fault in zip(names, checks, strict=True) if fault), None)
            if fault := _fault_of_numbers(episode) or frame:
                yield f"{where}: {fault}"


def _fault_of_numbers(episode: Episode) -> str | None:
    arrays = {name: getattr(episode, name) for name in (*WIDTHS, "final_position")}
    for name, values in arrays.items():
        if not np.isfinite(values).all():
            return f"{name} holds a number that is not finite"
    if np.abs(np.linalg.norm(episode.quaternion, axis=1) - 1).max() > UNIT:
        return "quaternion holds one that is no rotation, whose norm is not 1"
    if np.linalg.norm(episode.position[0] - episode.conditions.start_position) > START_M:
        return "its positions do not begin where its conditions say; they are those of another flight"
    ours = episode.conditions.look != "published"
    if ours and np.linalg.norm(episode.final_position - episode.position[-1]) > STEP_M:
        return "its positions do not lead to its end; they are those of another flight"
    return None


def _fault_of_frame(data: bytes, encoding: Encoding) -> str | None:
    """Decodes the whole frame, once its header says that it has the size of ours."""
    try:
        with PillowImage.open(BytesIO(data), formats=("JPEG", "PNG", "WEBP")) as picture:
            if picture.size != (IMAGE_SIZE, IMAGE_SIZE):
                return f"has {picture.width} x {picture.height} pixels, not {IMAGE_SIZE} x {IMAGE_SIZE}"
            if (picture.format or "").lower() != encoding:
                return f"is {picture.format}, and the episode says {encoding}"
            picture.load()
    except PillowImage.DecompressionBombError:
        return f"has far more than {IMAGE_SIZE} x {IMAGE_SIZE} pixels"
    except Exception as error:  # Pillow raises many kinds for broken files
        return f"is no whole image ({' '.join(str(error).split())[:80] or type(error).__name__})"
    return None


TOLERANCE = 1e-9
"""Relative tolerance; other NumPy releases may sum in another order."""

_Hashes = Callable[[str], str | None]
"""The hash of a file by its name in the store; None if it is missing."""


@dataclass(frozen=True, slots=True)
class Problem:
    """One fault of a store."""

    file: str
    """Path relative to the store."""
    message: str

    def __str__(self) -> str:
        return f"{self.file}: {self.message}"


def verify(path: Path | str) -> list[Problem]:
    """All faults of the store at `path`; an empty list if it is intact.

    Reads every byte, and requires a checksum for every file. Frames are decoded, numbers must be finite, and rows those
    of their episode. Content computed from the shards (statistics, splits, tasks) is compared only if the files
    themselves are intact. Raises `DataError` if there is no finished store of this version.
    """
    root = Path(path)

    @cache
    def hash_of(name: str) -> str | None:
        file = root / name
        if Path(name).is_absolute() or ".." in Path(name).parts or not file.is_file():
            return None  # a store has no files outside of its folder
        too_large = file.suffix != ".parquet" and file.stat().st_size > MAX_TEXT_BYTES
        return "too large" if too_large else sha256_of(file)

    sums, problems = _checksums(root)
    manifest = _manifest(root, sums, hash_of)
    if isinstance(manifest, Problem):
        return [*problems, manifest, *_altered(sums, hash_of, {MANIFEST})]
    try:
        problems += [*_shard_problems(root, manifest, hash_of), *_receipt_problems(root, manifest)]
        problems += [*_stray_files(root, manifest), *_episode_problems(manifest)]
        problems += _sum_problems(manifest, sums, hash_of, problems)
        return problems or list(_derived_problems(root, manifest))
    except (LookupError, TypeError, AttributeError, ValueError, ArithmeticError) as error:
        return [Problem(MANIFEST, f"is damaged (no usable {error})")]


def _checksums(root: Path) -> tuple[dict[str, str], list[Problem]]:
    """Hashes by file, and their faults."""
    if not (root / SUMS).exists():
        return {}, [Problem(SUMS, "is missing")]
    try:
        return read_sums(root), []
    except DataError:
        return {}, [Problem(SUMS, "is damaged")]


def _manifest(root: Path, sums: Mapping[str, str], hash_of: _Hashes) -> dict[str, Any] | Problem:
    """The manifest, or its faults. Raises `DataError` if the folder is not a finished store."""
    if not (root / SUMS).exists() and not (root / SHARDS).is_dir():
        return read_manifest(root)
    if hash_of(MANIFEST) is None:
        return Problem(MANIFEST, "is missing")
    try:
        manifest: Any = read_json(root / MANIFEST)
    except DataError:
        return Problem(MANIFEST, "is damaged: it is not JSON")
    if isinstance(manifest, dict) and manifest.get("complete") is False:
        return read_manifest(root)  # raises the error that it is not finished
    if sums and sums.get(MANIFEST) != hash_of(MANIFEST):
        return Problem(MANIFEST, f"is altered: its content does not match the hash in {SUMS}")
    check_format(root, manifest)
    if manifest.get("complete") is not True:
        return Problem(MANIFEST, "is damaged (no usable 'complete')")
    try:
        check_manifest(manifest, "is damaged")
    except DataError as error:
        return Problem(MANIFEST, str(error))
    return dict(manifest)


def _shard_problems(root: Path, manifest: dict[str, Any], hash_of: _Hashes) -> Iterator[Problem]:
    for receipt in manifest["shards"]:
        name = receipt["file"]
        size = (root / name).stat().st_size if (root / name).is_file() else 0
        if receipt["bytes"] < size:  # before it is hashed, however large it is
            yield Problem(name, f"is altered: it has {size} bytes, not {receipt['bytes']}")
        elif hash_of(name) is None:
            yield Problem(name, "is missing")
        elif size < receipt["bytes"]:
            yield Problem(name, f"is truncated: {size} of {receipt['bytes']} bytes")
        elif hash_of(name) != receipt["sha256"]:
            yield Problem(name, "is altered: its content does not match the hash in the manifest")
        else:
            yield from _content_problems(root / name, receipt)


def _content_problems(file: Path, receipt: dict[str, Any]) -> Iterator[Problem]:
    """Faults of a shard whose hash is right: differences between manifest and content, and episodes of no use."""
    try:
        shard = ShardFile(file)
    except DataError as error:
        yield Problem(receipt["file"], str(error))
        return
    found = [(fact["index"], fact["length"]) for fact in shard.facts]
    if found != list(zip(receipt["episodes"], receipt["lengths"], strict=True)):
        yield Problem(receipt["file"], "holds other episodes, or other lengths, than the manifest says")
        return
    for fault in faults_of(shard):
        yield Problem(receipt["file"], fault)


def _receipt_problems(root: Path, manifest: dict[str, Any]) -> Iterator[Problem]:
    making = making_of(head_of(manifest))
    for receipt in manifest["shards"]:
        file = root / receipt_name(receipt["file"])
        name = file.relative_to(root).as_posix()
        if not file.is_file():
            yield Problem(name, "is missing")
            continue
        try:
            content = read_text(file)
        except DataError as error:
            yield Problem(name, str(error))
            continue
        if content != receipt_text(receipt, making):
            yield Problem(name, "is altered: it does not say what the manifest says")


def _stray_files(root: Path, manifest: dict[str, Any]) -> Iterator[Problem]:
    shards = {receipt["file"] for receipt in manifest["shards"]}
    known = shards | {receipt_name(name) for name in shards}
    for file in sorted((*root.glob(f"{SHARDS}/shard-*"), *root.glob(f"{PARTIAL}/*"))):
        name = file.relative_to(root).as_posix()
        if name not in known:
            yield Problem(name, "is not in the manifest")
    for file in sorted((*root.glob(".*.tmp"), *root.glob(f"{SHARDS}/.*.tmp"))):
        yield Problem(file.relative_to(root).as_posix(), "was left by a writer that was killed")
    for name in sorted(known | {MANIFEST, STATISTICS, SUMS, TASKS}):
        if (root / name).is_symlink():
            yield Problem(name, "is a link: its content can change without the data set; put the file itself here")


def _episode_problems(manifest: dict[str, Any]) -> Iterator[Problem]:
    count = Counter(index for receipt in manifest["shards"] for index in receipt["episodes"])
    for index, times in sorted(count.items()):
        if times > 1:
            yield Problem(MANIFEST, f"lists episode {index} {times} times")
    listed = sum(count.values())
    if listed != manifest["episodes"]:
        yield Problem(MANIFEST, f"lists {listed} episodes in its shards, but counts {manifest['episodes']}")


def _sum_problems(
    manifest: dict[str, Any], sums: Mapping[str, str], hash_of: _Hashes, found: list[Problem]
) -> Iterator[Problem]:
    """Faults of checksums, for files without other faults."""
    if not sums:
        return
    shards = {receipt["file"] for receipt in manifest["shards"]}
    shards |= {receipt_name(name) for name in shards}
    if sums.keys() != {MANIFEST, STATISTICS, TASKS, *shards}:
        yield Problem(SUMS, "lists other files than the data set has")
    for problem in _altered(sums, hash_of, {problem.file for problem in found}):
        wrong = problem.file in shards  # the manifest confirms it
        yield Problem(SUMS, f"has another hash of {problem.file} than the manifest") if wrong else problem


def _altered(sums: Mapping[str, str], hash_of: _Hashes, known: set[str]) -> Iterator[Problem]:
    """Files other than the `known` ones that do not match their checksums."""
    for name, digest in sums.items():
        if name not in known and hash_of(name) is None:
            yield Problem(name, "is missing")
        elif name not in known and hash_of(name) != digest:
            yield Problem(name, f"is altered: its content does not match the hash in {SUMS}")


def _derived_problems(root: Path, manifest: dict[str, Any]) -> Iterator[Problem]:
    shards = [ShardFile(root / receipt["file"]) for receipt in manifest["shards"]]
    flown = flown_in(shards)
    families = {episode.index: episode.family for episode in flown}
    if draw_splits(manifest["suite"]["digest"], families) != manifest["splits"]:
        yield Problem(MANIFEST, "its val split is not the one that suite and indices give")
    if sum(len(episode.action) for episode in flown) != manifest["steps"]:
        yield Problem(MANIFEST, f"counts {manifest['steps']} steps, but the shards hold another number")
    try:
        if not _alike(read_json(root / STATISTICS), statistics(flown, manifest["splits"]["val"])):
            yield Problem(STATISTICS, "does not follow from the shards")
    except DataError as error:
        yield Problem(STATISTICS, str(error))
    try:
        if read_tasks(root / TASKS) != tasks_in(shards):
            yield Problem(TASKS, "does not list the tasks of the shards")
    except CognitiveDroneError as error:
        yield Problem(TASKS, str(error))


def _alike(a: Any, b: Any) -> bool:
    """Equal JSON, up to rounding of numbers."""
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(_alike(a[key], b[key]) for key in a)
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(_alike, a, b))
    if isinstance(a, float) and isinstance(b, float):
        return math.isclose(a, b, rel_tol=TOLERANCE, abs_tol=TOLERANCE)
    return bool(a == b)
