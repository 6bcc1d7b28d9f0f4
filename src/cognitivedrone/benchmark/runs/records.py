"""The folder of a run in progress: run.json identifies the run, episodes.jsonl records what has been flown.

Every episode is one line with its own checksum and the digest of its run, on disk before the next one counts. If
the run is killed, an incomplete line is dropped on resume, and its episode is flown again.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Final

from cognitivedrone.benchmark.scores.results import RunFacts, decode, dumps, encode, write_whole
from cognitivedrone.benchmark.scores.run_types import Rollout, Trace, impossible
from cognitivedrone.errors import RunError
from cognitivedrone.files import (
    append,
    is_left_over,
    open_regular,
    read_regular,
    reason_of,
    remove,
    remove_left_over,
    writing,
)
from cognitivedrone.files.locks import take_lock
from cognitivedrone.text.json_text import parse_json
from cognitivedrone.types import EpisodeResult, Track

RUN_FILE: Final = "run.json"
EPISODES_FILE: Final = "episodes.jsonl"
PRODUCTS: Final = ("results.json", "report.html", "error.txt")
"""Other files that a run writes into its folder."""
MAX_RUN_BYTES: Final = 2**20
"""Largest run.json."""
MAX_EPISODES_BYTES: Final = 2**30
"""Largest episodes.jsonl."""
MAX_LINE_BYTES: Final = 64 * 2**20
"""Largest record."""
ERRORS_FOLDER: Final = "errors"
"""Tracebacks of policies and reasoners, one file per episode."""


@dataclass(frozen=True, slots=True)
class Record:
    """One line of episodes.jsonl."""

    result: EpisodeResult
    trace: Trace
    renderer: str


class RunFolder:
    """The folder of a run: checked and read, and from entering its context on locked and written.

    Raises `RunError`, without changes, if the folder contains another run, or this run and neither `resume` nor
    `overwrite` is set; also for records of other flights than those through the suite's `tracks`, if they are given.
    """

    records: dict[int, Record]
    """By episode, as in the file."""

    def __init__(
        self,
        path: Path,
        facts: RunFacts,
        *,
        tracks: Sequence[Track] = (),
        resume: bool = False,
        overwrite: bool = False,
    ) -> None:
        self.path, self._facts, self._digest = path, facts, digest_of_run(facts)
        self.records, self._length, self._size = {}, 0, 0
        with writing(path, RunError, "give another --out"):
            self._kept = _check(path, facts, resume=resume, overwrite=overwrite) and resume
        if self._kept and (path / EPISODES_FILE).exists():
            file = path / EPISODES_FILE
            self.records, self._length, self._size = _read(_content(file), file, self._digest)
            check_records(self.records, facts, tracks, str(file))

    def __enter__(self) -> RunFolder:
        path = self.path
        with writing(path, RunError, "give another --out"):
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
                self._prepare()
            except BaseException:
                self._file.close()
                raise
        return self

    def _prepare(self) -> None:
        remove_left_over(self.path)
        if self._kept and self._file.seek(0, os.SEEK_END) != self._size:
            raise _busy(self.path)  # it has written since the records were read
        self._file.truncate(self._length)
        if not self._kept:
            for name in (*PRODUCTS, ERRORS_FOLDER):
                remove(self.path, name)
            write_whole(self.path / RUN_FILE, dumps(self._facts, indent=1) + "\n")

    def append(self, flown: Rollout, renderer: str) -> None:
        """Write one episode to disk."""
        body = encode(Record(flown.result, flown.trace, renderer))
        kept = "free disk space, then continue with the same command and --resume; flown episodes are kept"
        with writing(self.path / EPISODES_FILE, RunError, kept):
            self._file.write(_line(dumps(body), self._digest))
            self._file.flush()
            os.fsync(self._file.fileno())
        # Keep exactly what a later resume would read, to the last digit.
        self.records[flown.result.episode] = decode(Record, body, "the record just written")

    def __exit__(self, *error: object) -> None:
        # Closing flushes again what a full disk did not take; `append` has already raised the error.
        with contextlib.suppress(OSError):
            self._file.close()


def digest_of_run(facts: RunFacts) -> str:
    """What its records say of a run: 16 hexadecimal digits of the SHA-256 of its identity."""
    given = {name: value for name, value in _flat(encode(facts)).items() if value is not None}
    text = json.dumps(given, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def check_records(records: Mapping[int, Record], facts: RunFacts, tracks: Sequence[Track], where: str) -> None:
    """Raise `RunError` for records of flights that this run's suite, with these tracks, does not have.

    Without tracks, which are not known of a suite from files that are elsewhere, only the seed is looked at.
    """
    for episode, record in records.items():
        if problem := _unlike(record.result, facts, tracks):
            raise RunError(f"{where}: episode {episode} is none of this run, {problem}; give --overwrite")


def _unlike(result: EpisodeResult, facts: RunFacts, tracks: Sequence[Track]) -> str | None:
    if result.seed != facts.option("seed"):
        return f"its seed is {result.seed}, and the run's {facts.option('seed')}"
    if not tracks:
        return None
    if not 0 <= result.episode < len(tracks):
        return f"the suite has the episodes 0 to {len(tracks) - 1}"
    track = tracks[result.episode]
    for task, stage in zip(track, result.stages, strict=False):
        for name, found, meant in (
            ("task_id", stage.task_id, task.id),
            ("category", stage.category, task.category),
            ("family", stage.family, task.family),
            ("target", stage.target, task.target),
        ):
            if found != meant:
                return f"its {name} is {found!r:.60}, and {meant!r} in the suite"
    return impossible(track, [(stage.outcome, stage.chosen) for stage in result.stages])


def _check(path: Path, facts: RunFacts, *, resume: bool, overwrite: bool) -> bool:
    """Whether the folder contains a run; raises `RunError` if a run with these facts must not be written there."""
    exists = _holds_run(path)
    if exists and not overwrite:
        if not resume:
            raise RunError(
                f"{path} already contains a run; give --resume to continue it, --overwrite to delete it, "
                "or another --out"
            )
        if differing := differences(_content_of(path / RUN_FILE), encode(facts)):
            raise RunError(f"{path} contains another run: {differing}; give another --out, or --overwrite")
    return exists


def read_records(path: Path, facts: RunFacts | None = None) -> dict[int, Record]:
    """The records of a run folder by episode, read-only; an incomplete line is skipped.

    Raises `RunError` for records of another run than that of these facts; by default, those of the folder's run.json.
    """
    file = path / EPISODES_FILE
    return _read(_content(file), file, digest_of_run(_facts_in(path) if facts is None else facts))[0]


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
    begun = {EPISODES_FILE} if (path / EPISODES_FILE).is_file() else set()
    others = {name for name in names - begun if not is_left_over(name)}
    if others or (EPISODES_FILE in names and (path / EPISODES_FILE).stat().st_size):
        raise RunError(f"{path} is not empty and contains no run ({RUN_FILE} is missing); give another --out")
    return False


def _content_of(file: Path) -> Any:
    """The content of run.json; raises `RunError`."""
    try:
        return parse_json(read_regular(file, MAX_RUN_BYTES).decode("utf-8"))
    except (OSError, ValueError) as error:
        raise RunError(f"{file} cannot be read ({reason_of(error)}); give another --out, or --overwrite") from None


def _facts_in(path: Path) -> RunFacts:
    """The identity of the run in a folder; raises `RunError`."""
    return decode(RunFacts, _content_of(path / RUN_FILE), str(path / RUN_FILE))


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
    created = not path.exists()
    file = append(path)  # closed with the folder
    try:
        free = take_lock(file.fileno(), path.parent, RunError)
    except BaseException:
        file.close()
        if created:
            remove(path.parent, path.name)
        raise
    if not free:
        file.close()
        raise _busy(path.parent)
    return file


def _busy(path: Path) -> RunError:
    return RunError(f"another run is writing to {path} right now; wait for it, or give another --out")


def _line(body: str, run: str) -> bytes:
    return f'{{"crc32":"{_checksum(run, body)}","run":"{run}","record":{body}}}\n'.encode()


def _checksum(run: str, body: str) -> str:
    return f"{zlib.crc32(f'{run} {body}'.encode()):08x}"


def _parse(line: bytes, run: str, where: str) -> Record:
    """Parse one line of the file of a run. Raises `RunError` if its checksum, run or content is wrong."""
    try:
        document = parse_json(line, max_bytes=MAX_LINE_BYTES)
        body, stated, of = document["record"], document["crc32"], document.get("run")
    except (ValueError, LookupError, TypeError, AttributeError):
        raise RunError(f"{where} is not a record; repeat the run with --overwrite") from None
    if of is None:
        raise RunError(f"{where} does not say of which run it is, as records of this version do; give --overwrite")
    if _checksum(str(of), dumps(body)) != stated:
        raise RunError(f"{where} does not match its checksum; repeat the run with --overwrite")
    if of != run:
        raise RunError(f"{where} is of another run; take the line out, or repeat the run with --overwrite")
    return decode(Record, body, where)


def _content(path: Path) -> bytes:
    try:
        with open_regular(path, MAX_EPISODES_BYTES) as file:
            return file.read(MAX_EPISODES_BYTES)
    except OSError as error:
        raise RunError(f"{path} cannot be read: {reason_of(error)}; give the --out folder of a run") from None


def _read(content: bytes, path: Path, run: str) -> tuple[dict[int, Record], int, int]:
    """The records of a file, the length in bytes of its intact part, and that of all of it. Raises `RunError`."""
    lines = content.splitlines(keepends=True)
    if lines and not lines[-1].endswith(b"\n"):
        lines.pop()
    records: dict[int, Record] = {}
    for number, line in enumerate(lines, start=1):
        record = _parse(line, run, f"{path} line {number}")
        if record.result.episode in records:
            raise RunError(f"{path} line {number} repeats episode {record.result.episode}; give --overwrite")
        records[record.result.episode] = record
    return records, sum(map(len, lines)), len(content)
