"""The folder of a run in progress: run.json identifies the run, episodes.jsonl records what has been flown.

Every episode is one line with its own checksum, on disk before the next one counts. If the run is killed, an incomplete
line is dropped on resume, and its episode is flown again.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import shutil
import stat
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Final

from cognitivedrone.benchmark.scores.codec import decode, dumps, encode, loads
from cognitivedrone.benchmark.scores.results import RunFacts, write_whole
from cognitivedrone.benchmark.scores.run_types import Rollout, Trace
from cognitivedrone.errors import RunError
from cognitivedrone.files import check_regular, read_regular, reason_of, writing
from cognitivedrone.locks import take_lock
from cognitivedrone.types import EpisodeResult

RUN_FILE: Final = "run.json"
EPISODES_FILE: Final = "episodes.jsonl"
PRODUCTS: Final = ("results.json", "report.html", "error.txt")
"""Other files that a run writes into its folder."""
MAX_RUN_BYTES: Final = 2**20
"""Largest run.json."""
ERRORS_FOLDER: Final = "errors"
"""Tracebacks of policies and reasoners, one file per episode."""


@dataclass(frozen=True, slots=True)
class Record:
    """One line of episodes.jsonl."""

    result: EpisodeResult
    trace: Trace
    renderer: str


class RunFolder:
    """An open run folder, locked against other processes until it is closed.

    Raises `RunError`, without changes, if the folder contains another run, or this run and neither `resume` nor
    `overwrite` is set.
    """

    def __init__(self, path: Path, facts: RunFacts, *, resume: bool = False, overwrite: bool = False) -> None:
        self.path = path
        with writing(path, RunError, "give another --out"):
            self._open(facts, resume=resume, overwrite=overwrite)

    def _open(self, facts: RunFacts, *, resume: bool, overwrite: bool) -> None:
        path = self.path
        exists = _check(path, facts, resume=resume, overwrite=overwrite)
        created = not path.exists()
        path.mkdir(parents=True, exist_ok=True)
        try:
            self._file = _lock(path / EPISODES_FILE)
        except BaseException:
            if created:
                with contextlib.suppress(OSError):
                    path.rmdir()
            raise
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
    """By episode, as in the file."""

    def append(self, flown: Rollout, renderer: str) -> None:
        """Write one episode to disk."""
        line = _line(Record(flown.result, flown.trace, renderer))
        kept = "free disk space, then continue with the same command and --resume; flown episodes are kept"
        with writing(self.path / EPISODES_FILE, RunError, kept):
            self._file.write(line)
            self._file.flush()
            os.fsync(self._file.fileno())
        # Keep exactly what a later resume would read, to the last digit.
        self.records[flown.result.episode] = _parse(line, "the record just written")

    def close(self) -> None:
        """Release the folder's lock."""
        # Closing flushes again what a full disk did not take; `append` has already raised the error.
        with contextlib.suppress(OSError):
            self._file.close()

    def __enter__(self) -> RunFolder:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def check_folder(path: Path, facts: RunFacts, *, resume: bool = False, overwrite: bool = False) -> frozenset[int]:
    """The episodes that a `RunFolder` with these arguments would have on record. Same errors, no changes."""
    with writing(path, RunError, "give another --out"):
        exists = _check(path, facts, resume=resume, overwrite=overwrite)
    return frozenset(read_records(path)) if exists and resume and (path / EPISODES_FILE).exists() else frozenset()


def _check(path: Path, facts: RunFacts, *, resume: bool, overwrite: bool) -> bool:
    """Whether the folder contains a run; raises `RunError` if a run with these facts must not be written there."""
    exists = _holds_run(path)
    if exists and not overwrite:
        if not resume:
            raise RunError(
                f"{path} already contains a run; give --resume to continue it, --overwrite to delete it, "
                "or another --out"
            )
        _same_run(path, facts)
    return exists


def read_records(path: Path) -> dict[int, Record]:
    """The records of a run folder by episode, read-only; an incomplete line is skipped."""
    file = path / EPISODES_FILE
    try:
        check_regular(file)  # opening a pipe would wait for a writer
        with file.open("rb") as stream:
            return _read(stream, file)[0]
    except OSError as error:
        raise RunError(f"{file} cannot be read: {reason_of(error)}; give the --out folder of a run") from None


def _holds_run(path: Path) -> bool:
    """Whether the folder contains a run. Raises `RunError` if it contains anything else."""
    if not path.exists():
        return False
    if not path.is_dir():
        raise RunError(f"{path} is a file; give a folder as --out")
    entries = [*path.iterdir()]
    if links := [entry.name for entry in entries if entry.is_symlink()]:
        raise RunError(f"{path} contains the link {min(links)!r}, through which nothing is written; give another --out")
    names = {entry.name for entry in entries}
    if RUN_FILE in names:
        return True
    # Left by a run that was killed right after its start.
    begun = {RUN_FILE + ".tmp"} | ({EPISODES_FILE} if (path / EPISODES_FILE).is_file() else set())
    if names - begun or (EPISODES_FILE in names and (path / EPISODES_FILE).stat().st_size):
        raise RunError(f"{path} is not empty and contains no run ({RUN_FILE} is missing); give another --out")
    return False


def _same_run(path: Path, facts: RunFacts) -> None:
    """Raise `RunError` unless run.json describes the same run."""
    file = path / RUN_FILE
    try:
        found = loads(read_regular(file, MAX_RUN_BYTES).decode("utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise RunError(f"{file} cannot be read ({error}); give another --out, or --overwrite") from None
    if differing := differences(found, encode(facts)):
        raise RunError(f"{path} contains another run: {differing}; give another --out, or --overwrite")


def differences(there: Any, here: Any, in_there: str = "there", in_here: str = "here") -> str:
    """How two runs' identities (`RunFacts`, or the content of run.json) differ, as part of a sentence; else empty."""
    a, b = _flat(encode(there)), _flat(encode(here))
    differing = [key for key in {**b, **a} if a.get(key) != b.get(key)]
    return ", ".join(f"{key} is {a.get(key)!r} {in_there} and {b.get(key)!r} {in_here}" for key in differing[:3])


def _flat(value: Any, prefix: str = "") -> dict[str, Any]:
    """Nested objects flattened, with dotted names."""
    if not isinstance(value, dict):
        return {prefix.rstrip("."): value}
    return {name: item for key, part in value.items() for name, item in _flat(part, f"{prefix}{key}.").items()}


def _lock(path: Path) -> BinaryIO:
    # Neither a pipe, which would wait, nor a file elsewhere, which would be emptied.
    created = not path.exists()
    descriptor = os.open(
        path, os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, 0o666
    )
    file = open(descriptor, "a+b")  # noqa: PTH123, SIM115 - of a descriptor; closed with the folder
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        file.close()
        raise OSError(errno.EINVAL, "it is not a file", str(path))
    try:
        free = take_lock(file.fileno(), path.parent, RunError)
    except BaseException:
        file.close()
        if created:
            path.unlink(missing_ok=True)
        raise
    if not free:
        file.close()
        raise RunError(f"another run is writing to {path.parent} right now; wait for it, or give another --out")
    return file


def _line(record: Record) -> bytes:
    body = dumps(record)
    return f'{{"crc32":"{zlib.crc32(body.encode()):08x}","record":{body}}}\n'.encode()


def _parse(line: bytes, where: str) -> Record:
    """Parse one line of the file. Raises `RunError` if its checksum or content is wrong."""
    try:
        document = json.loads(line)
        body, stated = document["record"], document["crc32"]
    except (ValueError, KeyError, TypeError, RecursionError):
        raise RunError(f"{where} is not a record; repeat the run with --overwrite") from None
    if f"{zlib.crc32(dumps(body).encode()):08x}" != stated:
        raise RunError(f"{where} does not match its checksum; repeat the run with --overwrite")
    return decode(Record, body, where)


def _read(file: BinaryIO, path: Path) -> tuple[dict[int, Record], int]:
    """The records, and the length in bytes of the intact part of the file."""
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
