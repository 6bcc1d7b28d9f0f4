"""Replay of a recorded episode: the commands that were sent, from the recorded start."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cognitivedrone.data.episode import Episode
from cognitivedrone.errors import DataError, did_you_mean
from cognitivedrone.sim.airframe import AIRFRAMES
from cognitivedrone.sim.drone_world import TICKS_PER_CONTROL
from cognitivedrone.sim.dynamics import BatchedFlight


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
