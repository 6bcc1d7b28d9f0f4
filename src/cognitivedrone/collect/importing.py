"""Import of data sets in other formats into a store."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from itertools import count, islice
from pathlib import Path

from cognitivedrone.collect.config import EPISODES_PER_SHARD
from cognitivedrone.data.formats import import_
from cognitivedrone.data.manifest import WRITING
from cognitivedrone.data.store_writer import StoreWriter
from cognitivedrone.errors import DataError
from cognitivedrone.files.locks import sole_writer


def import_set(source: Path, form: str, out: Path, columns: str = "") -> int:
    """Read the data set `source` of the format `form` into a new store `out`; returns the number of episodes.

    `columns` maps the numbers of others' data sets. Episodes are renumbered in order of arrival, and splits are drawn
    anew. Raises `DataError` with the name of the file that is missing or broken; the store is then not readable.
    """
    if not source.exists():
        raise DataError(f"{source}: there is no such file or folder")
    name = f"{form}:{source.resolve().name}"
    recipe = {"name": "imported", "format": form, "source": source.resolve().name}
    flights = import_(source, form, columns)
    taken = 0
    with sole_writer(out, DataError, WRITING):
        digest = hashlib.sha256(name.encode()).hexdigest()
        writer = StoreWriter(out, recipe, name, digest, seed=0, episodes_per_shard=EPISODES_PER_SHARD)
        for number in count():
            read = [episode for _, episode in islice(flights, EPISODES_PER_SHARD)]
            shard = [replace(episode, index=taken + offset) for offset, episode in enumerate(read)]
            if not shard:
                break
            writer.write_shard(number, shard, {})
            taken += len(shard)
        writer.finish()
    return taken
