"""The folder of a run while it flies: run.json says which run it is, episodes.jsonl what has been flown so far.

Every episode is one line, on the disk before the next one counts, with a checksum of its own. A line that a kill cut
short is dropped when the run is resumed, and its episode is flown again.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Final

from cognitivedrone.benchmark.codec import decode, dumps, encode
from cognitivedrone.benchmark.results import RunFacts, write_whole
from cognitivedrone.benchmark.run_types import Rollout, Trace
from cognitivedrone.errors import RunError
from cognitivedrone.files import take_lock, writing
from cognitivedrone.types import EpisodeResult

RUN_FILE: Final = "run.json"
EPISODES_FILE: Final = "episodes.jsonl"
PRODUCTS: Final = ("results.json", "report.html", "error.txt")
"""What else a run writes into its folder."""
ERRORS_FOLDER: Final = "errors"
"""Tracebacks of policies and reasoners, a file an episode."""


@dataclass(frozen=True, slots=True)
class Record:
    """One line of episodes.jsonl."""

    result: EpisodeResult
    trace: Trace
    renderer: str


class RunFolder:
    """An open run folder; no other process can write to it until it is closed.

    Raises `RunError`, and changes nothing, where the folder holds another run, or this one and neither `resume` nor
    `overwrite` says what to do with it.
    """

    def __init__(self, path: Path, facts: RunFacts, *, resume: bool = False, overwrite: bool = False) -> None:
        self.path = path
        with writing(path, RunError, "give another --out"):
            self._open(facts, resume=resume, overwrite=overwrite)

    def _open(self, facts: RunFacts, *, resume: bool, overwrite: bool) -> None:
        path = self.path
        exists = _check(path, facts, resume=resume, overwrite=overwrite)
        path.mkdir(parents=True, exist_ok=True)
        self._file = _lock(path / EPISODES_FILE)
        try:
            self._prepare(facts, keep=exists and resume)
        except BaseException:
            self._file.close()
            raise

    def _prepare(self, facts: RunFacts, *, keep: bool) -> None:
        if keep:
            self.records, length = _read(self._file, self.path / EPISODES_FILE)
            self._file.truncate(length)
            return
        self.records = {}
        self._file.truncate(0)
        for name in PRODUCTS:
            (self.path / name).unlink(missing_ok=True)
        shutil.rmtree(self.path / ERRORS_FOLDER, ignore_errors=True)
        write_whole(self.path / RUN_FILE, dumps(facts, indent=1) + "\n")

    records: dict[int, Record]
    """By episode, as they stand in the file."""

    def append(self, flown: Rollout, renderer: str) -> None:
        """Put one episode on the disk."""
        line = _line(Record(flown.result, flown.trace, renderer))
        kept = "make room there, then the same command with --resume goes on: what was flown before is kept"
        with writing(self.path / EPISODES_FILE, RunError, kept):
            self._file.write(line)
            self._file.flush()
            os.fsync(self._file.fileno())
        # What is kept is what a later resume would read, to the last digit.
        self.records[flown.result.episode] = _parse(line, "the record just written")

    def close(self) -> None:
        """Let other processes write to the folder."""
        # What a full disk did not take is offered to it once more here; `append` has told of it.
        with contextlib.suppress(OSError):
            self._file.close()

    def __enter__(self) -> RunFolder:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def check_folder(path: Path, facts: RunFacts, *, resume: bool = False, overwrite: bool = False) -> frozenset[int]:
    """The episodes that a `RunFolder` opened so would have on record. Changes nothing, and raises as that would."""
    with writing(path, RunError, "give another --out"):
        exists = _check(path, facts, resume=resume, overwrite=overwrite)
    return frozenset(read_records(path)) if exists and resume and (path / EPISODES_FILE).exists() else frozenset()


def _check(path: Path, facts: RunFacts, *, resume: bool, overwrite: bool) -> bool:
    """Whether a run is in the folder; raises `RunError` where a run of these facts must not be written there."""
    if resume and overwrite:
        raise RunError("--resume and --overwrite contradict each other; give one of them")
    exists = _holds_run(path)
    if exists and not overwrite:
        if not resume:
            raise RunError(
                f"{path} already holds a run; give --resume to go on with it, --overwrite to throw it away, "
                "or another --out"
            )
        _same_run(path, facts)
    return exists


def read_records(path: Path) -> dict[int, Record]:
    """The records of a run folder, by episode, without opening it for writing; a line cut short is left out."""
    file = path / EPISODES_FILE
    try:
        with file.open("rb") as stream:
            return _read(stream, file)[0]
    except OSError as error:
        raise RunError(f"{file} cannot be read: {error.strerror}; give the --out folder of a run") from None


def _holds_run(path: Path) -> bool:
    """Whether a run is in the folder. Raises `RunError` where something else is."""
    if not path.exists():
        return False
    if not path.is_dir():
        raise RunError(f"{path} is a file; give a folder as --out")
    names = {entry.name for entry in path.iterdir()}
    if RUN_FILE in names:
        return True
    # A kill in the first instants of a run leaves these.
    begun = {RUN_FILE + ".tmp"} | ({EPISODES_FILE} if (path / EPISODES_FILE).is_file() else set())
    if names - begun or (EPISODES_FILE in names and (path / EPISODES_FILE).stat().st_size):
        raise RunError(f"{path} is not empty and holds no run ({RUN_FILE} is missing); give another --out")
    return False


def _same_run(path: Path, facts: RunFacts) -> None:
    """Raise `RunError` unless run.json tells of this very run."""
    file = path / RUN_FILE
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise RunError(f"{file} cannot be read ({error}); give another --out, or --overwrite") from None
    there, here = _flat(found), _flat(encode(facts))
    differing = [key for key in {**here, **there} if there.get(key) != here.get(key)]
    if differing:
        listed = ", ".join(f"{key} is {there.get(key)!r} there and {here.get(key)!r} here" for key in differing[:3])
        raise RunError(f"{path} holds another run: {listed}; give another --out, or --overwrite")


def _flat(value: Any, prefix: str = "") -> dict[str, Any]:
    """Nested objects as one, with dotted names."""
    if not isinstance(value, dict):
        return {prefix.rstrip("."): value}
    return {name: item for key, part in value.items() for name, item in _flat(part, f"{prefix}{key}.").items()}


def _lock(path: Path) -> BinaryIO:
    file = path.open("a+b")
    if not take_lock(file.fileno()):
        file.close()
        raise RunError(f"another run is writing to {path.parent} right now; wait for it, or give another --out")
    return file


def _line(record: Record) -> bytes:
    body = dumps(record)
    return f'{{"crc32":"{zlib.crc32(body.encode()):08x}","record":{body}}}\n'.encode()


def _parse(line: bytes, where: str) -> Record:
    """One line of the file. Raises `RunError` where its checksum or its content is wrong."""
    try:
        document = json.loads(line)
        body, stated = document["record"], document["crc32"]
    except (ValueError, KeyError, TypeError):
        raise RunError(f"{where} is not a record; repeat the run with --overwrite") from None
    if f"{zlib.crc32(dumps(body).encode()):08x}" != stated:
        raise RunError(f"{where} does not match its checksum; repeat the run with --overwrite")
    return decode(Record, body, where)


def _read(file: BinaryIO, path: Path) -> tuple[dict[int, Record], int]:
    """The records, and the length in bytes of the sound part of the file."""
    file.seek(0)
    lines = file.read().splitlines(keepends=True)
    records: dict[int, Record] = {}
    length = 0
    for number, line in enumerate(lines, start=1):
        if number == len(lines) and not line.endswith(b"\n"):
            break
        record = _parse(line, f"{path} line {number}")
        if record.result.episode in records:
            raise RunError(f"{path} line {number} repeats episode {record.result.episode}; give --overwrite")
        records[record.result.episode] = record
        length += len(line)
    return records, length
