"""Collections without worker processes: a generator flies in this one."""

import hashlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from cognitivedrone.collect.collector import Job
from cognitivedrone.collect.fleet import Fleet, FlownEpisode

Fly = Callable[[Fleet, Sequence[Sequence[int]]], Iterator[FlownEpisode]]


def forwards(fleet: Fleet, batches: Sequence[Sequence[int]]) -> Iterator[FlownEpisode]:
    """Batch by batch."""
    for batch in batches:
        yield from fleet.fly(batch)


def flying(fly: Fly) -> Any:
    """In place of `collector.pool_of`."""

    @contextmanager
    def pool_of(job: Job, config: object, most: int) -> Iterator[Any]:
        fleet = job.open()
        try:
            yield SimpleNamespace(fly=lambda batches: ((flown, "") for flown in fly(fleet, batches)))
        finally:
            fleet.close()

    return pool_of


def digests(folder: Path) -> dict[str, str]:
    """The hash of every file of a folder, by name."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}
