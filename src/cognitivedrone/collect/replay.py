"""What comes from flights that were recorded elsewhere: another format as a store, and an episode flown once more."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from itertools import count, islice
from pathlib import Path

import numpy as np

from cognitivedrone.collect.config import EPISODES_PER_SHARD
from cognitivedrone.data.episode import Episode
from cognitivedrone.data.formats import import_
from cognitivedrone.data.manifest import WRITING
from cognitivedrone.data.store_writer import StoreWriter
from cognitivedrone.errors import DataError, did_you_mean
from cognitivedrone.files.locks import sole_writer
from cognitivedrone.sim.airframe import AIRFRAMES
from cognitivedrone.sim.dynamics import BatchedFlight
from cognitivedrone.sim.simulator import TICKS_PER_CONTROL


@dataclass(frozen=True, slots=True)
class ReplayReport:
    """Differences between a replay and its record."""

    index: int
    steps: int
    end_error_m: float
    """Distance between the ends of replay and record."""
    path_error_m: float
    """Maximum distance between replay and record over all steps."""
    same_bits: bool
    """Whether every recorded position and attitude, and the end, are bit-identical."""


def replay(episode: Episode) -> ReplayReport:
    """Fly the commands that were sent, from the recorded conditions, in fresh physics; a flight that was imported from
    the published layout, of an airframe unknown, by ours.

    Raises `DataError` for an airframe that this version does not have.
    """
    start = episode.conditions
    name = "racer" if start.airframe == "published" else start.airframe
    if name not in AIRFRAMES:
        raise DataError(
            f"episode {episode.index} was flown by airframe {name!r}, unknown here; {did_you_mean(name, AIRFRAMES)}"
        )
    flight = BatchedFlight(1, AIRFRAMES[name])
    flight.reset(0, np.array(start.start_position), start.start_yaw, wind=np.array(start.wind))
    positions, quaternions = [], []
    for action in episode.sent:
        positions.append(flight.position[0])
        quaternions.append(flight.quaternion[0])
        flight.command_one(0, action)
        flight.advance(TICKS_PER_CONTROL)
    end = flight.position[0]
    path = np.array(positions)
    same = (path, np.array(quaternions), end), (episode.position, episode.quaternion, episode.final_position)
    return ReplayReport(
        index=episode.index,
        steps=len(episode),
        end_error_m=float(np.linalg.norm(end - episode.final_position)),
        path_error_m=float(np.linalg.norm(path - episode.position, axis=1).max()),
        same_bits=all(np.array_equal(ours, theirs) for ours, theirs in zip(*same, strict=True)),
    )


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
